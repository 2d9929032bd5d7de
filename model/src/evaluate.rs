//! What the integer pipeline and the float network reach on labelled episodes, and how often they agree.

use anyhow::{Context, Result};
use serde::{Deserialize, Serialize};
use slipsense::fixed::Logit;
use slipsense::net::{Model, SensorFeatures};
use slipsense::params::{FRAME_RATE_HZ, OUTPUTS};
use slipsense::pipeline::{Class, Pipeline};
use slipsense_recording::Episode;
use slipsense_recording::score::{ClassScores, Detection, SLIP, near, runs, score_intervals};
use slipsense_recording::threshold::lowest_threshold;

use crate::data::Features;
use crate::target::Target;
use crate::tract::{Graphs, TractNetwork};

/// Scores over any number of episodes.
#[derive(Clone, Debug, Default)]
pub struct Scores {
    /// Frames by truth and prediction.
    pub classes: ClassScores,
    /// What became of each slip event, in order.
    pub detections: Vec<Detection>,
    pub false_alarms: usize,
    /// Frames in which a flag would be a false alarm.
    pub exposure_frames: u64,
}

impl Scores {
    pub fn new(label: &[u8], class: &[u8]) -> Self {
        let flag: Vec<u8> = class.iter().map(|&class| u8::from(class == SLIP)).collect();
        let slips = runs(label.len(), |frame| label[frame] == SLIP);
        let events = score_intervals(&slips, &flag);
        let exposed = near(&slips, label.len()).into_iter().filter(|near| !near);
        Self {
            classes: ClassScores::new(label, class),
            detections: events.events.iter().map(|event| event.detection).collect(),
            false_alarms: events.false_alarms.len(),
            exposure_frames: exposed.count() as u64,
        }
    }

    pub fn add(&mut self, other: Self) {
        self.classes.add(&other.classes);
        self.detections.extend(other.detections);
        self.false_alarms += other.false_alarms;
        self.exposure_frames += other.exposure_frames;
    }

    pub fn figures(&self) -> Figures {
        let count = |is: fn(&Detection) -> bool| self.detections.iter().filter(|d| is(d)).count();
        let slip_truth: u64 = self.classes.confusion[SLIP as usize].iter().sum();
        let frames = self.classes.frames();
        Figures {
            frames,
            accuracy: self.classes.accuracy(),
            macro_f1: self.classes.macro_f1(),
            slip_f1: self.classes.f1(SLIP as usize),
            fpr_of_non_slip: self.classes.fpr_of_non_slip(),
            slip_frame_share: (frames > 0).then(|| slip_truth as f64 / frames as f64),
            events: self.detections.len(),
            hits: count(|d| matches!(d, Detection::Hit { .. })),
            early: count(|d| matches!(d, Detection::Early { .. })),
            missed: count(|d| *d == Detection::Missed),
            median_latency_frames: median_latency(&self.detections),
            false_alarms: self.false_alarms,
            false_alarms_per_hour: (self.exposure_frames > 0).then(|| {
                self.false_alarms as f64 * 3600.0 * f64::from(FRAME_RATE_HZ) / self.exposure_frames as f64
            }),
        }
    }
}

/// Median delay from onset to flag; missed events count as infinite, early ones not at all. `None` where there is no
/// such event or the median is infinite.
pub fn median_latency(detections: &[Detection]) -> Option<f64> {
    let delay = |d: &Detection| match *d {
        Detection::Hit { delay } => Some(delay as f64),
        Detection::Missed => Some(f64::INFINITY),
        Detection::Early { .. } => None,
    };
    let mut delays: Vec<f64> = detections.iter().filter_map(delay).collect();
    delays.sort_by(f64::total_cmp);
    let upper = *delays.get(delays.len() / 2)?;
    let lower = *delays.get((delays.len() - 1) / 2)?;
    Some((lower + upper) / 2.0).filter(|m| m.is_finite())
}

/// One row of the table. Shares are 0 to 1; `None` where nothing can be counted.
#[derive(Clone, Debug, Serialize)]
pub struct Figures {
    pub frames: u64,
    /// Share of frames whose class is right.
    pub accuracy: Option<f64>,
    /// Unweighted mean of the classes' F1.
    pub macro_f1: Option<f64>,
    pub slip_f1: Option<f64>,
    /// False slip frames as a share of the frames that do not slip.
    pub fpr_of_non_slip: Option<f64>,
    pub slip_frame_share: Option<f64>,
    pub events: usize,
    /// Flagged from the onset on.
    pub hits: usize,
    /// Flagged in the 50 ms before.
    pub early: usize,
    pub missed: usize,
    /// See [`median_latency`], frames of 1/240 s.
    pub median_latency_frames: Option<f64>,
    /// Alarms outside slip ± 50 ms, merged below 200 ms.
    pub false_alarms: usize,
    /// Of the time outside slip ± 50 ms, as `slipsense eval` counts.
    pub false_alarms_per_hour: Option<f64>,
}

/// Integer pipeline and float network side by side.
#[derive(Clone, Debug, Default)]
pub struct Comparison {
    /// The integer pipeline: what the microcontroller does.
    pub integer: Scores,
    /// The float network on the same features, under the same no-contact rule.
    pub float: Scores,
    /// A rule to beat: slip wherever a pad is touched.
    pub always_slip: Scores,
    /// Frames with the same class from both networks.
    pub agreed: u64,
    /// Sum of squares of the float logits that the integers have, and of the integer ones' differences from them.
    pub logit_power: [f64; 2],
}

impl Comparison {
    pub fn add(&mut self, other: Self) {
        self.integer.add(other.integer);
        self.float.add(other.float);
        self.always_slip.add(other.always_slip);
        self.agreed += other.agreed;
        self.logit_power[0] += other.logit_power[0];
        self.logit_power[1] += other.logit_power[1];
    }

    /// Share of frames with the same class, 0 to 1. `None` without frames.
    pub fn agreement(&self) -> Option<f64> {
        let frames = self.integer.classes.frames();
        (frames > 0).then(|| self.agreed as f64 / frames as f64)
    }

    /// Power of the float logits over that of the quantization error, dB.
    pub fn logit_snr_db(&self) -> f64 {
        10.0 * (self.logit_power[0] / self.logit_power[1]).log10()
    }
}

pub fn compare(model: Model<'_>, float_graphs: &Graphs, episode: &Episode) -> Result<Comparison> {
    let label = episode.label.as_deref().context("array label is missing, needed for evaluation")?;
    let mut pipeline = Pipeline::new(model, episode.sensors)?;
    let mut float_network = TractNetwork::new(float_graphs, episode.sensors)?;
    let (mut integer, mut float, mut touched) = (Vec::new(), Vec::new(), Vec::new());
    let mut result = Comparison::default();
    for frame in 0..episode.frames() {
        let inputs = episode.inputs(frame);
        let output = pipeline.step(&inputs[..episode.sensors]);
        let features = output.log_mel.map(|log_mel| log_mel.features());
        let seen = inputs[..episode.sensors].iter().zip(features);
        let seen = seen.map(|(input, xl)| SensorFeatures { piezo: input.piezo, xl: Some(xl) });
        let logits = float_network.step(&seen.collect::<Vec<_>>())?;
        // Log-odds are missing where no pad is touched.
        for (float, integer) in logits.into_iter().zip(output.logits.into_iter().chain(output.log_odds)) {
            let error = f64::from(float) - integer.to_f64();
            result.logit_power[0] += f64::from(float).powi(2);
            result.logit_power[1] += error * error;
        }
        // All pads are there, so the integer pipeline's no-contact is the pads' and not the network's.
        let is_touched = output.class != Class::NoContact;
        integer.push(output.class as u8);
        float.push(decide(is_touched, &logits));
        touched.push(if is_touched { SLIP } else { 0 });
    }
    result.agreed = integer.iter().zip(&float).filter(|(a, b)| a == b).count() as u64;
    result.integer = Scores::new(label, &integer);
    result.float = Scores::new(label, &float);
    result.always_slip = Scores::new(label, &touched);
    Ok(result)
}

/// An episode's outputs under the pipeline's decision.
pub fn score_logits(features: &Features, outputs: &[[f32; OUTPUTS]]) -> Scores {
    Scores::new(&features.label, &classes(features, outputs, true))
}

/// The pipeline's class of every frame by the network's outputs, all pads being there; or, where these do not say what
/// contact is, that of the largest logit.
pub(crate) fn classes(features: &Features, outputs: &[[f32; OUTPUTS]], pads_say_contact: bool) -> Vec<u8> {
    let class = |(touched, outputs): (bool, &[f32; OUTPUTS])| {
        let [no_contact, no_slip, slip, _] = *outputs;
        decide(if pads_say_contact { touched } else { no_contact < no_slip.max(slip) }, outputs)
    };
    features.contacts().zip(outputs).map(class).collect()
}

/// The same of one frame.
pub(crate) fn decide<T: PartialOrd>(touched: bool, [_, no_slip, slip, _]: &[T; OUTPUTS]) -> u8 {
    match (touched, slip > no_slip) {
        (false, _) => 0,
        (true, false) => 1,
        (true, true) => SLIP,
    }
}

/// False alarms per hour at which trainings say what their detectors miss: what minutes of validation can tell.
pub(crate) const VALIDATION_ALARMS_PER_HOUR: f64 = 10.0;

/// What the detector reaches at the threshold that just keeps to a rate of false alarms, frame by frame.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct DetectorFigures {
    /// Share of the sliding events that is missed, 0 to 1.
    pub missed: Option<f64>,
    /// See [`median_latency`], from the frame on in which the contact slides.
    pub median_latency_frames: Option<f64>,
}

/// The detector's figures at `alarms_per_hour`, over episodes with their targets and the log-odds of each frame.
pub fn detector_figures(
    episodes: &[(&Features, Vec<[f32; OUTPUTS]>)],
    alarms_per_hour: f64,
) -> DetectorFigures {
    let (mut slips, mut scores, mut still) = (Vec::new(), Vec::new(), 0);
    for (features, outputs) in episodes {
        let of = |is: &dyn Fn(Target) -> bool| runs(features.frames(), |f| is(features.target[f]));
        // Nothing near sliding is a false alarm.
        slips.push((of(&|target| target == Target::Slides), of(&|target| target != Target::Still)));
        still += features.target.iter().filter(|&&target| target == Target::Still).count();
        let log_odds = |outputs: &[f32; OUTPUTS]| {
            Logit::from_bits((outputs[OUTPUTS - 1] * (1 << Logit::FRAC_BITS) as f32) as i32)
        };
        let of_frames = features.contacts().zip(outputs).map(|(touched, o)| touched.then(|| log_odds(o)));
        scores.push(of_frames.collect::<Vec<_>>());
    }
    let hours = still as f64 / (3600.0 * f64::from(FRAME_RATE_HZ));
    let all: Vec<_> = slips.iter().map(|(_, near)| &near[..]).zip(scores.iter().cloned()).collect();
    let threshold = lowest_threshold(&all, (alarms_per_hour * hours) as u64);
    let mut detections = Vec::new();
    for ((sliding, _), scores) in slips.iter().zip(&scores) {
        let flag: Vec<u8> = scores.iter().map(|s| s.is_some_and(|s| s > threshold).into()).collect();
        detections.extend(score_intervals(sliding, &flag).events.into_iter().map(|event| event.detection));
    }
    let missed = detections.iter().filter(|&&d| d == Detection::Missed).count();
    DetectorFigures {
        missed: (!detections.is_empty()).then(|| missed as f64 / detections.len() as f64),
        median_latency_frames: median_latency(&detections),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_miss_counts_as_infinite_and_an_early_flag_not_at_all() {
        let hit = |delay| Detection::Hit { delay };
        assert_eq!(median_latency(&[hit(4), hit(1), hit(9)]), Some(4.0));
        assert_eq!(median_latency(&[hit(4), hit(1)]), Some(2.5));
        assert_eq!(median_latency(&[hit(4), Detection::Missed, hit(1)]), Some(4.0));
        assert_eq!(median_latency(&[hit(4), Detection::Missed]), None);
        assert_eq!(median_latency(&[hit(4), Detection::Early { lead: 3 }]), Some(4.0));
        assert_eq!(median_latency(&[Detection::Early { lead: 3 }]), None);
    }

    #[test]
    fn figures_by_hand() {
        // 400 frames: slip at 100..200, flagged at 105..200 and at 300..310.
        let mut label = vec![1u8; 400];
        label[100..200].fill(SLIP);
        let mut class = vec![1u8; 400];
        class[105..200].fill(SLIP);
        class[300..310].fill(SLIP);
        let mut scores = Scores::new(&label, &class);
        scores.add(Scores::new(&label, &vec![1u8; 400]));
        let figures = scores.figures();
        assert_eq!((figures.frames, figures.events, figures.hits, figures.missed), (800, 2, 1, 1));
        assert_eq!(figures.accuracy, Some(685.0 / 800.0));
        assert_eq!(figures.fpr_of_non_slip, Some(10.0 / 600.0));
        assert_eq!((figures.false_alarms, figures.median_latency_frames), (1, None));
        // 124 frames of each 400 are slip or within 12 of it.
        assert_eq!(figures.false_alarms_per_hour, Some(3600.0 * 240.0 / 552.0));
    }

    #[test]
    fn the_pads_decide_contact_and_a_tie_does_not_slip() {
        assert_eq!(decide(false, &[-9.0, 0.0, 9.0, 9.0]), 0);
        assert_eq!(decide(true, &[9.0, 0.0, 1.0, -9.0]), 2);
        assert_eq!(decide(true, &[9.0, 0.5, 0.5, 9.0]), 1);
    }
}
