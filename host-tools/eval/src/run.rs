//! Detectors over episodes: every episode is loaded once, judged by all detectors, and forgotten.
//!
//! What stays in memory are truths and verdicts, about 20 bytes per frame and 10 more per detector, not
//! the sensors' data, of which there is one episode per core at a time.

use std::ops::Range;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, ensure};
use cpu_time::ThreadTime;
use rayon::prelude::*;

use crate::detectors::{Detector, Verdict};
use crate::source::Input;
use crate::truth::Truth;

/// A detector that takes part.
pub struct Entrant<'a> {
    /// Name in the report.
    pub name: String,
    /// Entrants of the same family differ by their training seed only; the report gives their spread.
    pub family: String,
    /// Makes one with no state, for one stream.
    pub make: Box<dyn Fn() -> Result<Box<dyn Detector + 'a>> + Sync + 'a>,
}

/// Everything judged.
#[derive(Clone, Debug, Default)]
pub struct Run {
    /// Truth of each episode, input by input, in the order of the streams.
    pub truths: Vec<Truth>,
    /// Episodes of each input, in `truths`.
    pub of_input: Vec<Range<usize>>,
    /// `[entrant][episode]`.
    pub verdicts: Vec<Vec<Verdict>>,
    /// Processor time that each entrant took in all.
    pub judging: Vec<Duration>,
    /// Time from start to end, loading or generating included.
    pub wall: Duration,
}

impl Run {
    /// Mean processor time of an entrant per frame, µs.
    pub fn us_per_frame(&self, entrant: usize) -> Option<f64> {
        let frames: usize = self.truths.iter().map(Truth::frames).sum();
        (frames > 0).then(|| self.judging[entrant].as_secs_f64() * 1e6 / frames as f64)
    }
}

/// One stream judged.
struct Stream {
    episodes: Vec<(Truth, Vec<Verdict>)>,
    judging: Vec<Duration>,
}

/// Judge all inputs by all entrants, streams in parallel. `done` is called after each episode.
pub fn run(inputs: &[Input], entrants: &[Entrant<'_>], done: &(dyn Fn() + Sync)) -> Result<Run> {
    let start = Instant::now();
    let streams: Vec<(&Input, Range<usize>)> = inputs
        .iter()
        .flat_map(|input| input.streams().into_iter().map(move |stream| (input, stream)))
        .collect();
    let judged = streams
        .into_par_iter()
        .map(|(input, stream)| judge(input, stream, entrants, done))
        .collect::<Result<Vec<Stream>>>()?;

    let mut run = Run {
        judging: vec![Duration::ZERO; entrants.len()],
        verdicts: entrants.iter().map(|_| Vec::new()).collect(),
        ..Run::default()
    };
    for input in inputs {
        let first = run.of_input.last().map_or(0, |range| range.end);
        run.of_input.push(first..first + input.episodes.len());
    }
    for stream in judged {
        for (truth, verdicts) in stream.episodes {
            run.truths.push(truth);
            for (of_entrant, verdict) in run.verdicts.iter_mut().zip(verdicts) {
                of_entrant.push(verdict);
            }
        }
        for (sum, time) in run.judging.iter_mut().zip(stream.judging) {
            *sum += time;
        }
    }
    run.wall = start.elapsed();
    Ok(run)
}

fn judge(
    input: &Input,
    stream: Range<usize>,
    entrants: &[Entrant<'_>],
    done: &(dyn Fn() + Sync),
) -> Result<Stream> {
    let mut detectors = entrants.iter().map(|entrant| (entrant.make)()).collect::<Result<Vec<_>>>()?;
    let mut judged = Stream { episodes: Vec::new(), judging: vec![Duration::ZERO; entrants.len()] };
    for handle in &input.episodes[stream] {
        let (episode, name) = (handle.load()?, handle.name());
        let truth = Truth::new(&episode, &input.name, &name)?;
        let mut verdicts = Vec::with_capacity(entrants.len());
        for ((detector, entrant), time) in detectors.iter_mut().zip(entrants).zip(&mut judged.judging) {
            // Time of this thread, which a busy computer does not stretch.
            let start = ThreadTime::now();
            let verdict = detector.judge(&episode);
            *time += start.elapsed();
            let what = || format!("detector {} on {}/{name}", entrant.name, input.name);
            let verdict = verdict.with_context(what)?;
            let frames = [verdict.class.len(), verdict.fallback.len(), verdict.score.len()];
            ensure!(
                frames == [truth.frames(); 3],
                "{}: {frames:?} values for {} frames",
                what(),
                truth.frames()
            );
            ensure!(verdict.score.iter().all(|score| score.is_finite()), "{}: score is not finite", what());
            verdicts.push(verdict);
        }
        judged.episodes.push((truth, verdicts));
        done();
    }
    Ok(judged)
}
