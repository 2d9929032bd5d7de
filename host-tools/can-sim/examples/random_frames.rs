//! Writes random frames and their bits, one frame a line: extended, format, identifier, length code, data and levels,
//! for the oracle in Python: `cargo run --example random_frames -- COUNT FILE`.

use std::fs::File;
use std::io::{BufWriter, Write};

use slipsense_can_sim::{Format, Frame, Id, Rate, wire_bits};

/// The generator of Numerical Recipes: any will do, it only has to be the same every time.
struct Random(u64);

impl Random {
    fn next(&mut self, below: u32) -> u32 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        ((self.0 >> 32) % u64::from(below)) as u32
    }
}

/// What the frames are, ours twice as often.
const FORMATS: [(&str, Format); 6] = [
    ("classic", Format::Classic),
    ("remote", Format::Remote),
    ("fd", Format::Fd { bit_rate_switch: false, error_passive: false }),
    ("fd-brs", Format::FD),
    ("fd-brs", Format::FD),
    ("fd-brs-esi", Format::Fd { bit_rate_switch: true, error_passive: true }),
];

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let (Some(count), Some(path)) = (arguments.next(), arguments.next()) else {
        return Err("usage: random_frames COUNT FILE".into());
    };
    let count: u32 = count.parse()?;
    let mut out = BufWriter::new(File::create(path)?);
    let mut random = Random(1);
    for _ in 0..count {
        let extended = random.next(2) == 1;
        // Long runs of equal bits as often as random ones.
        let mask = [0, 0x1FFF_FFFF, 0x0FF0_0FF0][random.next(3) as usize];
        let number = random.next(1 << 29) & mask & if extended { u32::MAX } else { 0x7FF };
        let id = if extended { Id::Extended(number) } else { Id::Standard(number as u16) };
        let (name, format) = FORMATS[random.next(6) as usize];
        let Ok(mut frame) = Frame::with_dlc(id, format, random.next(16) as u8) else { continue };
        let style = random.next(4);
        for byte in frame.data_mut() {
            *byte = match style {
                0 => random.next(256) as u8,
                1 => 0,
                2 => 0xFF,
                _ => [0xF8, 0x07, 0x1F, 0x00, 0x83][random.next(5) as usize],
            };
        }
        let data: String = frame.data().iter().map(|byte| format!("{byte:02x}")).collect();
        let (mut levels, mut rates) = (String::new(), String::new());
        wire_bits(&frame, |bit| {
            levels.push(if bit.level { '1' } else { '0' });
            rates.push(match bit.rate {
                Rate::Nominal => 'n',
                Rate::ToData => '>',
                Rate::Data => 'd',
                Rate::ToNominal => '<',
            });
        });
        writeln!(
            out,
            "{} {name} {number:x} {} {} {levels} {rates}",
            u8::from(extended),
            frame.dlc(),
            if data.is_empty() { "-" } else { &data }
        )?;
    }
    out.flush()?;
    Ok(())
}
