//! Detectors over episodes: every episode is loaded once, passed to all detectors, and dropped.
//!
//! What stays in memory are truths and predictions, about 20 bytes per frame and 10 more per detector, not
//! the sensors' data, of which there is one episode per core at a time.

use std::ops::Range;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, ensure};
use cpu_time::ThreadTime;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::detector::{Detector, Prediction};
use crate::source::Input;
use crate::truth::Truth;

pub struct Candidate<'a> {
    pub name: String,
    /// Candidates of the same family differ by their training seed only; the report gives their spread.
    pub family: String,
    /// Makes one with no state, for one stream.
    pub make: Box<dyn Fn() -> Result<Detector<'a>> + Sync + 'a>,
}

#[derive(Clone, Debug, Default)]
pub struct Run {
    /// Truth of each episode, input by input, in the order of the streams.
    pub(crate) truths: Vec<Truth>,
    /// Episodes of each input, in `truths`.
    pub(crate) of_input: Vec<Range<usize>>,
    /// `[candidate][episode]`.
    pub(crate) predictions: Vec<Vec<Prediction>>,
    /// Processor time of each candidate in all.
    pub(crate) compute: Vec<Duration>,
    /// Of parts: their sum.
    pub(crate) wall: Duration,
}

impl Run {
    /// Mean processor time of a candidate per frame, µs.
    pub(crate) fn us_per_frame(&self, candidate: usize) -> Option<f64> {
        let frames: usize = self.truths.iter().map(Truth::frames).sum();
        (frames > 0).then(|| self.compute[candidate].as_secs_f64() * 1e6 / frames as f64)
    }
}

/// What some of the streams gave, to be [joined](join) with the others.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Part {
    /// Number of the stream, over all inputs, and what it gave.
    streams: Vec<(usize, Stream)>,
    wall: Duration,
}

impl Part {
    /// Written by [`Self::to_bytes`]; `None`: these are no such bytes.
    pub fn from_bytes(bytes: &[u8]) -> Option<Self> {
        postcard::from_bytes(bytes).ok()
    }

    pub fn to_bytes(&self) -> Result<Vec<u8>> {
        Ok(postcard::to_allocvec(self)?)
    }
}

#[derive(Clone, Debug, Serialize, Deserialize)]
struct Stream {
    episodes: Vec<(Truth, Vec<Prediction>)>,
    compute: Vec<Duration>,
}

/// Run all candidates over all inputs, streams in parallel. `done` is called after each episode.
pub fn run(inputs: &[Input], candidates: &[Candidate<'_>], done: &(dyn Fn() + Sync)) -> Result<Run> {
    let part = run_part(inputs, candidates, |_| true, done)?;
    Ok(join(inputs, candidates.len(), vec![part]))
}

fn streams(inputs: &[Input]) -> impl Iterator<Item = (&Input, Range<usize>)> {
    inputs.iter().flat_map(|input| input.streams().into_iter().map(move |stream| (input, stream)))
}

/// Episodes of the streams that `has` names by number.
pub fn episodes_of(inputs: &[Input], has: impl Fn(usize) -> bool) -> usize {
    streams(inputs).enumerate().filter(|(number, _)| has(*number)).map(|(_, (_, stream))| stream.len()).sum()
}

/// Run all candidates over the streams that `has` names by number.
pub fn run_part(
    inputs: &[Input],
    candidates: &[Candidate<'_>],
    has: impl Fn(usize) -> bool,
    done: &(dyn Fn() + Sync),
) -> Result<Part> {
    let start = Instant::now();
    let streams: Vec<_> = streams(inputs).enumerate().filter(|(number, _)| has(*number)).collect();
    let streams = streams
        .into_par_iter()
        .map(|(number, (input, stream))| Ok((number, predict_stream(input, stream, candidates, done)?)))
        .collect::<Result<_>>()?;
    Ok(Part { streams, wall: start.elapsed() })
}

/// The whole run from all its parts.
///
/// # Panics
/// If a stream is missing, or there twice.
pub fn join(inputs: &[Input], candidates: usize, parts: Vec<Part>) -> Run {
    let wall = parts.iter().map(|part| part.wall).sum();
    let mut predicted: Vec<(usize, Stream)> = parts.into_iter().flat_map(|part| part.streams).collect();
    predicted.sort_by_key(|(number, _)| *number);
    let numbers = predicted.iter().map(|(number, _)| *number);
    assert!(numbers.eq(0..streams(inputs).count()), "every stream once");
    let mut run = Run {
        compute: vec![Duration::ZERO; candidates],
        predictions: vec![Vec::new(); candidates],
        wall,
        ..Run::default()
    };
    for input in inputs {
        let first = run.of_input.last().map_or(0, |range| range.end);
        run.of_input.push(first..first + input.episodes.len());
    }
    for (_, stream) in predicted {
        for (truth, predictions) in stream.episodes {
            run.truths.push(truth);
            for (all, prediction) in run.predictions.iter_mut().zip(predictions) {
                all.push(prediction);
            }
        }
        for (sum, time) in run.compute.iter_mut().zip(stream.compute) {
            *sum += time;
        }
    }
    run
}

fn predict_stream(
    input: &Input,
    episodes: Range<usize>,
    candidates: &[Candidate<'_>],
    done: &(dyn Fn() + Sync),
) -> Result<Stream> {
    let mut detectors = candidates.iter().map(|candidate| (candidate.make)()).collect::<Result<Vec<_>>>()?;
    let mut stream = Stream { episodes: Vec::new(), compute: vec![Duration::ZERO; candidates.len()] };
    for handle in &input.episodes[episodes] {
        let (episode, name) = (handle.load()?, handle.name());
        let truth = Truth::new(&episode, &input.name, &name)?;
        let mut predictions = Vec::with_capacity(candidates.len());
        for ((detector, candidate), time) in detectors.iter_mut().zip(candidates).zip(&mut stream.compute) {
            // Time of this thread, which a busy computer does not stretch.
            let start = ThreadTime::now();
            let prediction = detector(&episode);
            *time += start.elapsed();
            let what = format!("detector {} on {}/{name}", candidate.name, input.name);
            let prediction = prediction.with_context(|| what.clone())?;
            let (values, frames) =
                ([prediction.class.len(), prediction.fallback.len(), prediction.score.len()], truth.frames());
            ensure!(values == [frames; 3], "{what}: {values:?} values for {frames} frames");
            let finite = prediction.score.iter().all(|score| score.is_finite());
            ensure!(finite, "{what}: score is not finite");
            predictions.push(prediction);
        }
        stream.episodes.push((truth, predictions));
        done();
    }
    Ok(stream)
}
