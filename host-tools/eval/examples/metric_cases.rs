//! Writes random labels and decisions with the figures that this crate gives for them, as JSON, to be
//! checked against other software (`tests/python/check_metrics.py`).
//!
//! `cargo run -p slipsense-eval --example metric_cases -- CASES.json`

use std::error::Error;
use std::fs;

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde_json::{Value, json};
use slipsense_eval::metrics::frames::{FrameCounts, FrameFigures};
use slipsense_eval::metrics::statistics::{rate_bound_per_hour, share_interval};
use slipsense_eval::truth::Truth;

const CASES: usize = 200;

fn main() -> Result<(), Box<dyn Error>> {
    let path = std::env::args().nth(1).ok_or("usage: metric_cases CASES.json")?;
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let cases: Vec<Value> = (0..CASES).map(|_| case(&mut rng)).collect();
    fs::write(path, serde_json::to_string(&cases)?)?;
    Ok(())
}

/// Between 1 and 400 frames of any classes, some of which may be missing; decisions of any quality.
fn case(rng: &mut ChaCha8Rng) -> Value {
    let frames = rng.random_range(1..=400);
    let (first, last) = (rng.random_range(0..=1), rng.random_range(1..=2));
    let label: Vec<u8> = (0..frames).map(|_| rng.random_range(first..=last)).collect();
    let right: f64 = rng.random();
    let decide = |&label: &u8| if rng.random::<f64>() < right { label } else { rng.random_range(0..=2) };
    let class: Vec<u8> = label.iter().map(decide).collect();
    let truth = Truth::from_labels(label.clone());
    let figures = FrameFigures::new(&FrameCounts::new(&truth, &class));
    let hits = class.iter().zip(&label).filter(|(class, label)| class == label).count() as u64;
    json!({
        "label": label,
        "class": class,
        "figures": figures,
        "accuracy_interval": share_interval(hits, frames as u64),
        "rate_bound_per_hour": rate_bound_per_hour(hits, 2.5),
    })
}
