//! Learn the frequencies of the raw stream's compression from synthetic training episodes, and write
//! `src/wire/compress/tables.rs`, or check it: `cargo run --release -p slipsense-synth --example compression_tables -- [--check]`.
//!
//! Only the split `train` is looked at, whose objects and grasps no test split shares. A compressed stream can be
//! read with the tables it was written with only: another table is another message version.

use std::error::Error;
use std::fmt::Write;
use std::fs;
use std::path::Path;

use slipsense::wire::compress::{
    SYMBOLS, Sink, TAXEL_CONTEXTS, TAXEL_TABLES, Table, XL_CONTEXTS, XL_TABLES, model, split,
};
use slipsense_synth::splits::EpisodeSet;
use slipsense_synth::{Split, generate_set};

const SEED: u64 = 8;
const FRAMES: usize = 40_000;
/// Of each episode every third frame: neighbours are alike.
const EVERY: usize = 3;
/// What the frequencies of a table sum to.
const TOTAL: u64 = 4096;
/// Observations that the mean of all contexts is worth in each of them, and 1/16 observation for every symbol, so
/// that what a rare context has not shown yet does not become dear.
const PRIOR: u64 = 8;
const SIXTEENTHS: u64 = 16;

/// What begins a table.
const TABLE: &str = "\n#[rustfmt::skip]\n";

type Counts = [u64; SYMBOLS];

/// Counts symbols by context, the taxels' before the accelerometer's; codes nothing.
struct Counter(Vec<Counts>);

impl Sink for Counter {
    fn values(&mut self, values: &[(&'static Table, u32)]) {
        for &(table, value) in values {
            let context = TAXEL_TABLES.iter().chain(&XL_TABLES).position(|known| std::ptr::eq(known, table));
            self.0[context.expect("a table of one of the two")][split(value).0] += 1;
        }
    }

    fn bits(&mut self, _: u32, _: u32) {}
}

fn main() -> Result<(), Box<dyn Error>> {
    let check = match std::env::args().nth(1).as_deref() {
        None => false,
        Some("--check") => true,
        Some(other) => return Err(format!("{other}: only --check is known").into()),
    };
    let recipes: Vec<_> = EpisodeSet::new(Split::Train, SEED, FRAMES)
        .episodes
        .into_iter()
        .map(|episode| episode.recipe)
        .collect();
    let counted = generate_set(&recipes, |_, episode| {
        let mut counter = Counter(vec![[0; SYMBOLS]; TAXEL_CONTEXTS + XL_CONTEXTS]);
        for frame in (0..episode.frames()).step_by(EVERY) {
            for sensor in 0..episode.sensors {
                model(&mut counter, episode.piezo(frame, sensor), episode.xl_batch(frame, sensor));
            }
        }
        counter
    })?;
    let mut all = counted.into_iter();
    let mut sum = all.next().ok_or("no episode")?;
    for one in all {
        for (sums, counts) in sum.0.iter_mut().zip(&one.0) {
            sums.iter_mut().zip(counts).for_each(|(sum, count)| *sum += count);
        }
    }
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../src/wire/compress/tables.rs");
    let old = fs::read_to_string(&path)?;
    // The code above the tables is written by hand.
    let (code, _) = old.split_once(TABLE).ok_or("no tables")?;
    let text = code.to_owned() + &tables(&sum);
    if !check {
        fs::write(&path, text)?;
    } else if old != text {
        return Err(format!("{}: not what the training episodes give", path.display()).into());
    }
    Ok(())
}

fn tables(sum: &Counter) -> String {
    let mut text = String::new();
    let (taxels, xl) = sum.0.split_at(TAXEL_CONTEXTS);
    for (name, contexts, counts) in [("TAXELS", "TAXEL_CONTEXTS", taxels), ("XL", "XL_CONTEXTS", xl)] {
        let mut mean = [0; SYMBOLS];
        counts.iter().for_each(|row| mean.iter_mut().zip(row).for_each(|(mean, count)| *mean += count));
        writeln!(text, "{TABLE}const {name}: [[u16; SYMBOLS]; {contexts}] = [").unwrap();
        for counts in counts {
            let row = frequencies(counts, &mean);
            let rows: Vec<String> = row
                .chunks(SYMBOLS / 2)
                .map(|half| half.iter().map(ToString::to_string).collect::<Vec<_>>().join(", "))
                .collect();
            writeln!(text, "    [{}],", rows.join(",\n     ")).unwrap();
        }
        text.push_str("];\n");
    }
    text
}

/// Shares of [`TOTAL`], at least 1 each; what rounding leaves goes to the largest.
fn frequencies(counts: &Counts, mean: &Counts) -> [u64; SYMBOLS] {
    let all: u64 = mean.iter().sum::<u64>().max(1);
    let weights: Vec<u64> = counts
        .iter()
        .zip(mean)
        .map(|(count, mean)| SIXTEENTHS * count + SIXTEENTHS * PRIOR * mean / all + 1)
        .collect();
    let sum: u64 = weights.iter().sum();
    let mut shares = [0; SYMBOLS];
    shares.iter_mut().zip(&weights).for_each(|(share, w)| *share = 1 + w * (TOTAL - SYMBOLS as u64) / sum);
    let left = TOTAL - shares.iter().sum::<u64>();
    *shares.iter_mut().max().expect("there are symbols") += left;
    shares
}
