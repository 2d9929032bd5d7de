//! Frames per second of the float network on tract, front end included, with one sensor on one core: one number
//! for `cargo xtask bench --tract`. Needs `--features float`.

use std::path::Path;
use std::time::Instant;

use anyhow::{Context, Result};
use slipsense_eval::detectors::{Setup, by_name};
use slipsense_eval::fitted::Fitted;
use slipsense_recording::Episode;

const DEMO_EPISODE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../cli/demo/episode.npz");
const MODEL: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../model/weights/slipsense.slipnet");
const WEIGHTS: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../model/weights/slipsense.safetensors");
/// Runs of the same work; the median counts.
const RUNS: usize = 5;

fn main() -> Result<()> {
    let fitted = Fitted::bundled()?;
    let model = std::fs::read(MODEL).context(MODEL)?;
    let setup = Setup { fitted: &fitted, model: &model, float_weights: Some(Path::new(WEIGHTS)), dead: None };
    let episode = first_sensor(Episode::read(DEMO_EPISODE)?);
    let mut detector = by_name("float", &setup)?;
    let mut rates = Vec::new();
    for _ in 0..RUNS {
        let start = Instant::now();
        detector(&episode)?;
        rates.push(episode.frames() as f64 / start.elapsed().as_secs_f64());
    }
    rates.sort_by(f64::total_cmp);
    println!("{:.1}", rates[RUNS / 2]);
    Ok(())
}

/// The episode as a board with one sensor would see it.
fn first_sensor(episode: Episode) -> Episode {
    let sensors = episode.sensors;
    Episode {
        sensors: 1,
        piezo: episode.piezo.into_iter().step_by(sensors).collect(),
        xl: episode.xl.into_iter().take(1).collect(),
        xl_end: episode.xl_end.into_iter().step_by(sensors).collect(),
        ..episode
    }
}
