//! Lossless coders of the registry, each at its best effort for one sensor's frame alone.

use std::io::Write;

use anyhow::{Result, anyhow, bail};
use embedded_heatshrink::{HSEFinishRes, HSEPollRes, HSESinkRes, HeatshrinkEncoder};
use flate2::Compression;
use flate2::write::DeflateEncoder;
use rice_golomb::{BitVec, Encoder};
use slipsense::wire::RawFrame;

/// One sensor's frame as coders of bytes and of numbers want it.
pub struct Samples {
    /// The plain message: 12 bits a count.
    packed: Vec<u8>,
    /// The same with 16 bits a count, low bytes first.
    wide: Vec<u8>,
    /// Differences to the taxel to the left, then to the sample before, folded.
    taxels: Vec<u32>,
    xl: Vec<u32>,
}

impl Samples {
    pub fn of(raw: &RawFrame<'_>, packed: Vec<u8>) -> Self {
        let counts: Vec<u16> = raw.input.piezo.iter().flat_map(|piezo| piezo.active()).collect();
        let samples = raw.input.xl.unwrap_or(&[]);
        let axes = (0..3).flat_map(|axis| samples.iter().map(move |sample| sample[axis] as u16));
        let wide = counts.iter().copied().chain(axes).flat_map(u16::to_le_bytes).collect();
        let folded = |values: &mut dyn Iterator<Item = i32>| {
            let fold = |last: &mut i32, value: i32| {
                let difference = value - std::mem::replace(last, value);
                Some((difference << 1 ^ difference >> 31) as u32)
            };
            values.scan(0, fold).collect::<Vec<_>>()
        };
        let taxels = folded(&mut counts.iter().map(|&count| i32::from(count)));
        let xl = (0..3).flat_map(|axis| folded(&mut samples.iter().map(|sample| i32::from(sample[axis]))));
        Self { packed, wide, taxels, xl: xl.collect() }
    }

    /// Bytes of the shorter of the two layouts.
    fn shorter(&self, size: impl Fn(&[u8]) -> Result<usize>) -> Result<usize> {
        Ok(size(&self.packed)?.min(size(&self.wide)?))
    }
}

/// One of them.
pub struct Coder {
    pub name: &'static str,
    pub size: fn(&Samples) -> Result<usize>,
}

pub const CODERS: &[Coder] = &[
    Coder {
        name: "zstd 19",
        size: |samples| samples.shorter(|bytes| Ok(zstd::bulk::compress(bytes, 19)?.len())),
    },
    Coder { name: "deflate 9", size: |samples| samples.shorter(deflate) },
    Coder {
        name: "lz4",
        size: |samples| samples.shorter(|bytes| Ok(lz4_flex::block::compress(bytes).len())),
    },
    Coder { name: "heatshrink 11,4", size: |samples| samples.shorter(heatshrink) },
    Coder {
        name: "Rice, best parameters",
        size: |samples| Ok((rice(&samples.taxels) + rice(&samples.xl)).div_ceil(8)),
    },
];

fn deflate(bytes: &[u8]) -> Result<usize> {
    let mut encoder = DeflateEncoder::new(Vec::new(), Compression::best());
    encoder.write_all(bytes)?;
    Ok(encoder.finish()?.len())
}

fn heatshrink(bytes: &[u8]) -> Result<usize> {
    let mut encoder = HeatshrinkEncoder::new(11, 4).ok_or_else(|| anyhow!("heatshrink refuses 11, 4"))?;
    let mut scratch = [0; 4096];
    let (mut rest, mut size) = (bytes, 0);
    loop {
        if !rest.is_empty() {
            match encoder.sink(rest) {
                HSESinkRes::Ok(taken) => rest = &rest[taken..],
                _ => bail!("heatshrink takes no more"),
            }
        } else if matches!(encoder.finish(), HSEFinishRes::Done) {
            return Ok(size);
        }
        loop {
            match encoder.poll(&mut scratch) {
                HSEPollRes::More(bytes) => size += bytes,
                HSEPollRes::Empty(bytes) => break size += bytes,
                _ => bail!("heatshrink gives nothing out"),
            }
        }
    }
}

/// Bits with the parameter that suits the values best; which one is not counted.
fn rice(values: &[u32]) -> usize {
    fn bits<const K: u32>(values: &[u32]) -> usize {
        let mut store: BitVec<usize> = BitVec::new();
        values.iter().for_each(|value| Encoder::<u32, K>::encode(value, &mut store));
        store.len()
    }
    // A unary part this long is never the best.
    let largest = values.iter().copied().max().unwrap_or(0);
    type Length = fn(&[u32]) -> usize;
    let all: [(u32, Length); 9] = [
        (1, bits::<1>),
        (2, bits::<2>),
        (3, bits::<3>),
        (4, bits::<4>),
        (5, bits::<5>),
        (6, bits::<6>),
        (7, bits::<7>),
        (8, bits::<8>),
        (10, bits::<10>),
    ];
    let useful = all.iter().filter(|(k, _)| largest >> k < 1 << 14);
    useful.map(|(_, bits)| bits(values)).min().unwrap_or(0)
}
