//! Seconds on this computer: the pipeline alone on one core, the whole data set over all cores, and the float
//! network on another library.

use std::num::NonZero;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::thread;
use std::time::Instant;

use anyhow::{Context, Result};
use serde::Serialize;
use slipsense::net::Model;
use slipsense::pipeline::Pipeline;
use slipsense::sensor::SensorInput;
use slipsense_recording::Episode;

use super::inputs::demo;
use crate::process::{answer, cargo};

/// Runs of the same work; the median counts.
const RUNS: usize = 5;
/// Passes over the demo episode in one run.
const PASSES: usize = 5;
/// In `slipsense-eval`.
const FLOAT_EXAMPLE: &str = "float_speed";

/// Seconds of this computer, which say nothing about another.
#[derive(Clone, Debug, Serialize)]
pub struct Host {
    pub cores: usize,
    /// The pipeline with one sensor on one core, frames per second, median of the runs.
    pub frames_per_s: f64,
    /// The float network on tract with one sensor on one core, features included.
    pub float_frames_per_s: Option<f64>,
    pub replay: Replay,
}

/// A data set over all cores.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Replay {
    pub frames: usize,
    pub sensors: usize,
    pub wall_s: f64,
}

/// Measure. `tract`: also the float network, which takes minutes to build.
pub fn measure(model: &[u8], replay_frames: usize, tract: bool) -> Result<Host> {
    let model = Model::parse(model).context("the model to measure")?;
    let demo = demo()?;
    let work = PASSES * demo.frames();
    let mut rates = Vec::new();
    for _ in 0..RUNS {
        let start = Instant::now();
        for _ in 0..PASSES {
            pass(model, &demo, 1, demo.frames())?;
        }
        rates.push(work as f64 / start.elapsed().as_secs_f64());
    }
    rates.sort_by(f64::total_cmp);
    let cores = thread::available_parallelism().map_or(1, NonZero::get);
    eprintln!("{replay_frames} frames of {} sensors on {cores} cores", demo.sensors);
    Ok(Host {
        cores,
        frames_per_s: rates[RUNS / 2],
        float_frames_per_s: if tract { Some(float()?) } else { None },
        replay: replay(model, &demo, replay_frames, cores)?,
    })
}

/// The episode once, up to `limit` frames, with a pipeline of its own.
fn pass(model: Model<'_>, episode: &Episode, sensors: usize, limit: usize) -> Result<()> {
    let mut pipeline = Pipeline::new(model, sensors)?;
    for frame in 0..episode.frames().min(limit) {
        let input = |sensor| SensorInput {
            piezo: Some(episode.piezo(frame, sensor)),
            xl: Some(episode.xl_batch(frame, sensor)),
        };
        let inputs: Vec<_> = (0..sensors).map(input).collect();
        std::hint::black_box(pipeline.step(&inputs));
    }
    Ok(())
}

/// Episodes are handed out one by one to a thread for each core.
fn replay(model: Model<'_>, episode: &Episode, frames: usize, cores: usize) -> Result<Replay> {
    let sensors = episode.sensors;
    let next = AtomicUsize::new(0);
    let start = Instant::now();
    let work = || {
        loop {
            let from = next.fetch_add(episode.frames(), Ordering::Relaxed);
            if from >= frames {
                return anyhow::Ok(());
            }
            pass(model, episode, sensors, frames - from)?;
        }
    };
    thread::scope(|scope| {
        let threads: Vec<_> = (0..cores).map(|_| scope.spawn(work)).collect();
        threads.into_iter().try_for_each(|thread| thread.join().expect("a replay does not panic"))
    })?;
    Ok(Replay { frames, sensors, wall_s: start.elapsed().as_secs_f64() })
}

/// From another program, because its libraries take minutes to build.
fn float() -> Result<f64> {
    eprintln!("building the float network on tract");
    let mut example = cargo();
    example.args(["run", "--release", "--quiet", "--package", "slipsense-eval", "--features", "float"]);
    let answer = answer(example.args(["--example", FLOAT_EXAMPLE]));
    let answer = answer.with_context(|| {
        format!("`cargo run --release -p slipsense-eval --features float --example {FLOAT_EXAMPLE}` failed")
    })?;
    answer.parse().with_context(|| format!("{FLOAT_EXAMPLE} printed `{answer}`, which is no number"))
}
