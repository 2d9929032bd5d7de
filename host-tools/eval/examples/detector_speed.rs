//! Frames per second of every detector on one core, two sensors:
//! `cargo run --release -p slipsense-eval --example detector_speed`.

use std::time::Instant;

use anyhow::Result;
use slipsense::net::Aligned;
use slipsense_eval::detectors::{DETECTORS, Setup, by_name};
use slipsense_eval::fitted::Fitted;
use slipsense_synth::{Recipe, generate};

fn main() -> Result<()> {
    let fitted = Fitted::bundled()?;
    let model = &Aligned(*include_bytes!("../../../model/weights/slipsense.slipnet")).0;
    let setup = Setup { fitted: &fitted, model, float_weights: None, dead: None };
    let episodes: Vec<_> = Recipe::new(9).series(4).iter().map(generate).collect::<Result<_, _>>()?;
    let frames: usize = episodes.iter().map(|episode| episode.frames()).sum();
    println!("{frames} frames, two sensors");
    for (name, _) in DETECTORS {
        let Ok(mut detector) = by_name(name, &setup) else { continue };
        let start = Instant::now();
        for episode in &episodes {
            detector(episode)?;
        }
        println!("{name:<17} {:>10.0} frames/s", frames as f64 / start.elapsed().as_secs_f64());
    }
    Ok(())
}
