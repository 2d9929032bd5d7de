//! The firmware's pipeline, bit for bit: `network` by its classes, `network-alarm` by the alarm at the model's
//! operating point.

use std::collections::VecDeque;

use anyhow::{Context, Result, ensure};
use slipsense::fixed::Logit;
use slipsense::net::Model;
use slipsense::params::{CONTACT_SUM_MIN, MAX_SENSORS};
use slipsense::pipeline::{Output, Pipeline};
use slipsense_recording::Episode;
use slipsense_recording::score::SLIP;

use crate::detector::{Detector, NEVER, Prediction};

/// Half of a fingertip, as `--drop` names it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Modality {
    Piezo,
    Xl,
}

impl Modality {
    pub const fn name(self) -> &'static str {
        match self {
            Self::Piezo => "piezo",
            Self::Xl => "xl",
        }
    }
}

impl std::str::FromStr for Modality {
    type Err = String;

    fn from_str(name: &str) -> Result<Self, String> {
        let found = [Self::Piezo, Self::Xl].into_iter().find(|modality| modality.name() == name);
        found.ok_or_else(|| format!("no modality is called \"{name}\"; there are: piezo, xl"))
    }
}

/// The pipeline as a module runs it that is never switched off: its state goes on from episode to episode.
/// Another number of sensors starts anew, which a module in use cannot do.
pub(crate) struct PipelineStream<'m> {
    model: Model<'m>,
    dead: Option<Modality>,
    pipeline: Option<Box<Pipeline<'m>>>,
    /// Samples of each accelerometer before the episode: its first ones follow without a gap.
    samples: [u32; MAX_SENSORS],
}

impl<'m> PipelineStream<'m> {
    /// A pipeline whose sensors never deliver the modality `dead`.
    pub(crate) const fn new(model: Model<'m>, dead: Option<Modality>) -> Self {
        Self { model, dead, pipeline: None, samples: [0; MAX_SENSORS] }
    }

    /// Run the frames of the next episode; `each` gets the output of every frame in order. Returns whether the
    /// state went on from the frames before.
    pub(crate) fn run(&mut self, episode: &Episode, mut each: impl FnMut(&Output)) -> Result<bool> {
        let sensors = episode.sensors;
        let kept = self.pipeline.take().filter(|pipeline| pipeline.sensors() == sensors);
        let goes_on = kept.is_some();
        let pipeline = match kept {
            Some(pipeline) => self.pipeline.insert(pipeline),
            None => self.pipeline.insert(Box::new(Pipeline::new(self.model, sensors)?)),
        };
        for frame in 0..episode.frames() {
            let mut inputs = episode.inputs(frame);
            for (input, samples) in inputs.iter_mut().zip(self.samples) {
                input.piezo = input.piezo.filter(|_| self.dead != Some(Modality::Piezo));
                input.xl = input.xl.filter(|_| self.dead != Some(Modality::Xl));
                input.xl_end = input.xl_end.wrapping_add(samples);
            }
            each(&pipeline.step(&inputs[..sensors]));
        }
        if let Some(last) = episode.frames().checked_sub(1) {
            for (sensor, samples) in self.samples.iter_mut().take(sensors).enumerate() {
                *samples = samples.wrapping_add(episode.xl_end(last, sensor));
            }
        }
        Ok(goes_on)
    }
}

/// Log-odds or a difference of logits in nat; an untouched pad does not slip. A number below 2^14 nat is exact in `f32`,
/// and a larger one keeps its sign.
fn score(log_odds: Option<Logit>) -> f32 {
    log_odds.map_or(NEVER, |log_odds| log_odds.to_f64() as f32)
}

/// The class if it is not slip: by the network where a missing array leaves open whether a pad is touched.
fn fallback(output: &Output) -> u8 {
    let [no_contact, no_slip, _] = output.logits;
    let touched = output.contact.iter().any(|pad| pad.sum >= CONTACT_SUM_MIN);
    // Log-odds are missing where no pad is touched.
    u8::from(output.log_odds.is_some() && (touched || no_slip > no_contact))
}

/// By how much slip's logit leads that of the class that competes with it.
fn lead(output: &Output) -> Option<Logit> {
    let [rival, slip] = [fallback(output), SLIP].map(|class| output.logits[usize::from(class)].to_bits());
    output.log_odds.map(|_| Logit::from_bits(slip - rival))
}

/// The pipeline's rule as a score: on a touched pad, slip is where its logit is above the other's. Nat,
/// threshold 0.
pub(super) fn network(model: &[u8], dead: Option<Modality>) -> Result<Detector<'_>> {
    let mut stream = PipelineStream::new(Model::parse(model).context("model")?, dead);
    Ok(Box::new(move |episode| {
        let mut prediction = Prediction::default();
        stream.run(episode, |output| {
            prediction.class.push(output.class as u8);
            prediction.score.push(score(lead(output)));
            prediction.fallback.push(fallback(output));
        })?;
        Ok(prediction)
    }))
}

/// Slip where the alarm is up. The score is the `k`-th largest of the last `n` log-odds, nat; the threshold is
/// the model's.
pub(super) fn network_alarm(model: &[u8], dead: Option<Modality>) -> Result<Detector<'_>> {
    let model = Model::parse(model).context("model")?;
    let mut recent = KthLargest::new(model.point.k, model.point.n);
    let threshold = model.point.threshold;
    let mut stream = PipelineStream::new(model, dead);
    Ok(Box::new(move |episode| {
        let mut frames = Vec::with_capacity(episode.frames());
        let goes_on =
            stream.run(episode, |output| frames.push((output.log_odds, output.slip, fallback(output))))?;
        if !goes_on {
            recent.clear();
        }
        let mut prediction = Prediction { threshold: score(Some(threshold)), ..Prediction::default() };
        for (frame, (margin, alarm, fallback)) in frames.into_iter().enumerate() {
            let largest = recent.push(margin);
            let over = largest.is_some_and(|margin| margin > threshold);
            ensure!(over == alarm, "frame {frame}: the pipeline's alarm is not k of the last n frames");
            prediction.class.push(if alarm { SLIP } else { fallback });
            prediction.score.push(score(largest));
            prediction.fallback.push(fallback);
        }
        Ok(prediction)
    }))
}

/// The k-of-n rule as a score, so that a threshold can be swept over it: at least `k` of the last `n` margins are
/// over a threshold exactly where the `k`-th largest of them is.
#[derive(Clone, Debug)]
pub(crate) struct KthLargest {
    k: usize,
    n: usize,
    recent: VecDeque<Option<Logit>>,
    sorted: Vec<Option<Logit>>,
}

impl KthLargest {
    pub(crate) fn new(k: u8, n: u8) -> Self {
        let (k, n) = (usize::from(k), usize::from(n));
        Self { k, n, recent: VecDeque::with_capacity(n + 1), sorted: Vec::with_capacity(n) }
    }

    /// Take the margin of the next frame. `None`, of a frame and of the result, is below every threshold.
    pub(crate) fn push(&mut self, margin: Option<Logit>) -> Option<Logit> {
        self.recent.push_back(margin);
        if self.recent.len() > self.n {
            self.recent.pop_front();
        }
        self.sorted.clear();
        self.sorted.extend(&self.recent);
        self.sorted.sort_unstable_by(|a, b| b.cmp(a));
        self.sorted.get(self.k - 1).copied().flatten()
    }

    pub(crate) fn clear(&mut self) {
        self.recent.clear();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_score_keeps_the_sign_of_the_smallest_and_the_largest_margin() {
        let score_of = |bits| score(Some(Logit::from_bits(bits)));
        assert_eq!(score_of(1), 1.0 / 1024.0);
        assert_eq!(score_of(0), 0.0);
        assert!(score_of(i32::MIN).is_finite() && score_of(i32::MIN) > NEVER);
        assert!(score_of(i32::MAX) > 0.0);
        assert_eq!(score(None), NEVER);
    }
}
