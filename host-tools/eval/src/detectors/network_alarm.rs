//! `network-alarm`: the firmware's pipeline, bit for bit, by the alarm at the model's operating point.

use anyhow::{Context, Result, ensure};
use slipsense::fixed::Logit;
use slipsense::net::Model;
use slipsense_recording::Episode;
use slipsense_recording::score::SLIP;

use super::network::{PipelineStream, score};
use super::{Detector, Modality, NETWORK_ALARM, Verdict};
use crate::tune::KthLargest;

pub(super) struct NetworkAlarm<'m> {
    stream: PipelineStream<'m>,
    recent: KthLargest,
    threshold: Logit,
}

impl<'m> NetworkAlarm<'m> {
    pub(super) fn new(model: &'m [u8], dead: Option<Modality>) -> Result<Self> {
        let model = Model::parse(model).context("model")?;
        let recent = KthLargest::new(model.point.k, model.point.n);
        let threshold = model.point.threshold;
        Ok(Self { stream: PipelineStream::with_dead(model, dead), recent, threshold })
    }
}

impl Detector for NetworkAlarm<'_> {
    fn name(&self) -> &'static str {
        NETWORK_ALARM
    }

    /// Slip where the alarm is up. At least `k` of the last `n` margins are over a threshold exactly where
    /// the `k`-th largest of them is: that one is the score, nat; the threshold is the model's.
    fn judge(&mut self, episode: &Episode) -> Result<Verdict> {
        let mut frames = Vec::with_capacity(episode.frames());
        let goes_on = self.stream.run(episode, |output| frames.push((output.margin, output.alarm)))?;
        if !goes_on {
            self.recent.clear();
        }
        let mut verdict = Verdict { threshold: score(Some(self.threshold)), ..Verdict::default() };
        for (frame, (margin, alarm)) in frames.into_iter().enumerate() {
            let largest = self.recent.push(margin.map(Logit::to_bits)).map(Logit::from_bits);
            let over = largest.is_some_and(|margin| margin > self.threshold);
            ensure!(over == alarm, "frame {frame}: the pipeline's alarm is not k of the last n frames");
            let fallback = u8::from(margin.is_some());
            verdict.class.push(if alarm { SLIP } else { fallback });
            verdict.score.push(score(largest));
            verdict.fallback.push(fallback);
        }
        Ok(verdict)
    }

    fn reset(&mut self) {
        self.stream.reset();
        self.recent.clear();
    }
}
