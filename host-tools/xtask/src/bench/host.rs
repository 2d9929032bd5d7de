//! Frames per second on this computer: the pipeline alone on one core, a data set over all cores.

use std::num::NonZero;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::thread;
use std::time::Instant;

use anyhow::{Context, Result};
use slipsense::net::Model;
use slipsense::pipeline::Pipeline;
use slipsense_recording::Episode;

use super::inputs::demo;
use crate::table::{Table, thousands};

/// Runs of the same work; the median counts.
const RUNS: usize = 5;
const PASSES: usize = 5;

pub fn print(model: &[u8], replay_frames: usize) -> Result<()> {
    let model = Model::parse(model).context("the model to measure")?;
    let demo = demo()?;
    let mut rates = Vec::new();
    for _ in 0..RUNS {
        let start = Instant::now();
        for _ in 0..PASSES {
            pass(model, &demo, 1, demo.frames())?;
        }
        rates.push((PASSES * demo.frames()) as f64 / start.elapsed().as_secs_f64());
    }
    rates.sort_by(f64::total_cmp);
    let cores = thread::available_parallelism().map_or(1, NonZero::get);
    let mut table = Table::new(format!("This computer, {cores} cores"), &["what", "measured"]);
    let rate = |frames_per_s: f64| format!("{} frames/s", thousands(frames_per_s as i64));
    table.row(["pipeline, one sensor, one core".to_owned(), rate(rates[RUNS / 2])]);
    eprintln!("{replay_frames} frames of {} sensors on {cores} cores", demo.sensors);
    let what = format!("{} frames of {} sensors, all cores", thousands(replay_frames as u64), demo.sensors);
    table.row([what, format!("{:.1} s", replay(model, &demo, replay_frames, cores)?)]);
    print!("{table}");
    Ok(())
}

/// The episode once, up to `limit` frames, with a pipeline of its own.
fn pass(model: Model<'_>, episode: &Episode, sensors: usize, limit: usize) -> Result<()> {
    let mut pipeline = Pipeline::new(model, sensors)?;
    for frame in 0..episode.frames().min(limit) {
        std::hint::black_box(pipeline.step(&episode.inputs(frame)[..sensors]));
    }
    Ok(())
}

/// Seconds for as many frames, handed out by episodes to a thread for each core.
fn replay(model: Model<'_>, episode: &Episode, frames: usize, cores: usize) -> Result<f64> {
    let next = AtomicUsize::new(0);
    let start = Instant::now();
    let work = || {
        loop {
            let from = next.fetch_add(episode.frames(), Ordering::Relaxed);
            if from >= frames {
                return anyhow::Ok(());
            }
            pass(model, episode, episode.sensors, frames - from)?;
        }
    };
    thread::scope(|scope| {
        let threads: Vec<_> = (0..cores).map(|_| scope.spawn(work)).collect();
        threads.into_iter().try_for_each(|thread| thread.join().expect("a replay does not panic"))
    })?;
    Ok(start.elapsed().as_secs_f64())
}
