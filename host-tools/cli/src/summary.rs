//! The result of one episode in numbers: what `summary.json` holds and the terminal shows.

use std::fmt::{self, Write};
use std::path::Path;

use serde::Serialize;
use slipsense::net::Model;
use slipsense::net::format::OperatingPoint;
use slipsense::params::FRAME_RATE_HZ;
use slipsense_recording::Episode;
use slipsense_recording::score::{ClassScores, Detection, Interval, runs, score_events};
pub use slipsense_recording::{HEALTH, hex};

use crate::simulate::Simulation;

/// Version of the layout of `summary.json`.
const FORMAT: u32 = 1;

/// The result of one episode. Frames count from 0; frame f is at f/240 s.
#[derive(Clone, Debug, Serialize)]
pub struct Summary {
    pub format: u32,
    pub episode: EpisodeInfo,
    pub model: ModelInfo,
    pub output: OutputInfo,
    /// The comparison with the labels; `null` where the episode has none.
    pub truth: Option<TruthInfo>,
    pub speed: SpeedInfo,
}

#[derive(Clone, Debug, Serialize)]
pub struct EpisodeInfo {
    /// Name of the file, or `bundled`.
    pub name: String,
    /// Does the file say that it was generated?
    pub synthetic: bool,
    /// These three as the file says.
    pub source: Option<String>,
    pub object: Option<String>,
    pub speed_mm_s: Option<f64>,
    pub sensors: usize,
    pub frames: usize,
    pub duration_s: f64,
}

#[derive(Clone, Debug, Serialize)]
pub struct ModelInfo {
    /// Name of the file, or `bundled`.
    pub name: String,
    /// The hash at the end of the model file (SHA-256 of what precedes it): the model's identity.
    pub hash: String,
    pub operating_point: OperatingPointInfo,
    pub provenance: serde_json::Value,
}

/// The slip flag is up while `k` of the last `n` frames, the current one included, are over the threshold.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct OperatingPointInfo {
    /// Lead of the slip logit that is not enough yet, nat.
    pub threshold_nat: f64,
    pub k: u8,
    pub n: u8,
}

#[derive(Clone, Debug, Serialize)]
pub struct OutputInfo {
    /// Frames decided as no contact, contact without slip, slip.
    pub class_frames: [u64; 3],
    pub may_begin_runs: Vec<FrameRun>,
    /// Maximal runs of frames with the slip flag up.
    pub slip_runs: Vec<FrameRun>,
    /// Frames in which any sensor had a health bit set, by bit.
    pub health_frames: Vec<HealthCount>,
    pub can_frames: u64,
}

/// Frames `start_frame..end_frame`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct FrameRun {
    pub start_frame: usize,
    pub end_frame: usize,
    pub start_s: f64,
    pub duration_ms: f64,
}

#[derive(Clone, Debug, Serialize)]
pub struct HealthCount {
    pub what: &'static str,
    pub frames: usize,
}

#[derive(Clone, Debug, Serialize)]
pub struct TruthInfo {
    /// Frames labelled no contact, contact without slip, slip.
    pub class_frames: [u64; 3],
    #[serde(flatten)]
    pub may_begin: FlagScores,
    pub slip: FlagScores,
    /// `confusion[truth][decided]`, frames.
    pub confusion: [[u64; 3]; 3],
    /// Share of frames decided right.
    pub accuracy: Option<f64>,
    /// Unweighted mean of the classes' F1.
    pub macro_f1: Option<f64>,
    /// False positives as a share of frames that do not slip.
    pub fpr_of_non_slip: Option<f64>,
    /// False positives as a share of all frames.
    pub fpr_of_all: Option<f64>,
}

#[derive(Clone, Debug, Serialize)]
pub struct FlagScores {
    /// Slip events by the encoder rule.
    pub events: Vec<EventInfo>,
    /// Alarms outside every event: runs of flags more than 50 ms away from any, merged when less than 200 ms apart.
    pub false_alarms: Vec<FrameRun>,
}

#[derive(Clone, Copy, Debug, Serialize)]
pub struct EventInfo {
    /// First frame labelled slip, and the frame after the last one.
    pub onset_frame: usize,
    pub end_frame: usize,
    pub onset_s: f64,
    pub end_s: f64,
    pub outcome: Outcome,
    /// Frames from the onset to the flag: negative if early, `null` if missed.
    pub delay_frames: Option<i64>,
    /// The same in milliseconds, without computing time.
    pub delay_ms: Option<f64>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Outcome {
    /// Flagged at or after the onset.
    Hit,
    /// Flagged up to 50 ms before the onset.
    Early,
    /// Not flagged in time.
    Missed,
}

#[derive(Clone, Copy, Debug, Serialize)]
pub struct SpeedInfo {
    /// Frames per second of pipeline time on one core of this computer.
    pub frames_per_s: f64,
    /// The same as a multiple of the sensors' frame rate.
    pub times_real_time: f64,
}

pub fn seconds(frame: usize) -> f64 {
    frame as f64 / f64::from(FRAME_RATE_HZ)
}

fn milliseconds(frames: i64) -> f64 {
    frames as f64 * 1000.0 / f64::from(FRAME_RATE_HZ)
}

impl Summary {
    /// Score a simulation. The names stand for the files.
    pub fn new(
        episode: &Episode,
        episode_name: &str,
        model: &Model<'_>,
        model_name: &str,
        simulation: &Simulation,
    ) -> Self {
        let frames_per_s = episode.frames() as f64 / simulation.step_time.as_secs_f64().max(1e-9);
        let times_real_time = frames_per_s / f64::from(FRAME_RATE_HZ);
        Self {
            format: FORMAT,
            episode: EpisodeInfo::new(episode, episode_name),
            model: ModelInfo::new(model, model_name),
            output: OutputInfo::new(simulation),
            truth: episode.label.as_ref().map(|label| TruthInfo::new(label, simulation)),
            speed: SpeedInfo { frames_per_s, times_real_time },
        }
    }

    /// One line: the operating point, and the result.
    pub fn slip_words(&self) -> String {
        let OperatingPointInfo { threshold_nat, k, n } = self.model.operating_point;
        let point = format!("{k} of {} over {threshold_nat:.3} nat", counted(n.into(), "frame"));
        let Some(TruthInfo { slip, .. }) = &self.truth else {
            return format!("{point}: raised {}", counted(self.output.slip_runs.len(), "time"));
        };
        let found = slip.events.iter().filter(|event| event.outcome != Outcome::Missed).count();
        let slips = counted(slip.events.len(), "slip");
        format!("{point}: {found} of {slips} found, {}", counted(slip.false_alarms.len(), "false alarm"))
    }
}

impl EpisodeInfo {
    pub fn new(episode: &Episode, name: &str) -> Self {
        let text = |key: &str| episode.meta.other.get(key).and_then(|v| v.as_str()).map(str::to_owned);
        Self {
            name: name.to_owned(),
            synthetic: episode.meta.is_synthetic(),
            source: text("source"),
            object: text("object"),
            speed_mm_s: episode.meta.other.get("speed_mm_s").and_then(|v| v.as_f64()),
            sensors: episode.sensors,
            frames: episode.frames(),
            duration_s: seconds(episode.frames()),
        }
    }

    pub fn words(&self) -> String {
        let kind = if self.synthetic { "synthetic episode" } else { "episode" };
        let mut words = format!("{kind} {}", file_name(&self.name));
        if let Some(object) = &self.object {
            let _ = write!(words, ", {object}");
        }
        if let Some(speed) = self.speed_mm_s {
            let _ = write!(words, ", {speed} mm/s");
        }
        let _ = write!(words, ", {}, {:.2} s", counted(self.sensors, "sensor"), self.duration_s);
        words
    }
}

impl ModelInfo {
    pub fn new(model: &Model<'_>, name: &str) -> Self {
        // The format does not demand JSON: other text stays text.
        let provenance =
            serde_json::from_str(model.provenance).unwrap_or_else(|_| model.provenance.to_owned().into());
        let OperatingPoint { threshold, k, n } = model.point;
        let operating_point = OperatingPointInfo { threshold_nat: threshold.to_f64(), k, n };
        Self { name: name.to_owned(), hash: hex(&model.hash), operating_point, provenance }
    }
}

impl OutputInfo {
    fn new(simulation: &Simulation) -> Self {
        let predictions = &simulation.predictions;
        let health_frames = HEALTH.map(|(bit, what)| {
            let frames = simulation.health.chunks_exact(predictions.sensors);
            let frames = frames.filter(|sensors| sensors.iter().any(|health| health & bit != 0)).count();
            HealthCount { what, frames }
        });
        Self {
            class_frames: count_classes(&predictions.class),
            may_begin_runs: flag_runs(&predictions.may_begin),
            slip_runs: flag_runs(&predictions.slip),
            health_frames: health_frames.into_iter().filter(|count| count.frames > 0).collect(),
            can_frames: simulation.can_frames,
        }
    }
}

impl TruthInfo {
    fn new(label: &[u8], simulation: &Simulation) -> Self {
        let predictions = &simulation.predictions;
        let classes = ClassScores::new(label, &predictions.class);
        Self {
            class_frames: count_classes(label),
            may_begin: FlagScores::new(label, &predictions.may_begin),
            slip: FlagScores::new(label, &predictions.slip),
            confusion: classes.confusion,
            accuracy: classes.accuracy(),
            macro_f1: classes.macro_f1(),
            fpr_of_non_slip: classes.fpr_of_non_slip(),
            fpr_of_all: classes.fpr_of_all(),
        }
    }
}

impl FlagScores {
    fn new(label: &[u8], flag: &[u8]) -> Self {
        let scores = score_events(label, flag);
        let event = |event: &slipsense_recording::score::EventScore| {
            let (outcome, delay_frames) = match event.detection {
                Detection::Hit { delay } => (Outcome::Hit, Some(delay as i64)),
                Detection::Early { lead } => (Outcome::Early, Some(-(lead as i64))),
                Detection::Missed => (Outcome::Missed, None),
            };
            EventInfo {
                onset_frame: event.onset,
                end_frame: event.end,
                onset_s: seconds(event.onset),
                end_s: seconds(event.end),
                outcome,
                delay_frames,
                delay_ms: delay_frames.map(milliseconds),
            }
        };
        let alarms = scores.false_alarms.iter().map(|&alarm| FrameRun::new(alarm));
        Self { events: scores.events.iter().map(event).collect(), false_alarms: alarms.collect() }
    }
}

impl FrameRun {
    fn new((start_frame, end_frame): Interval) -> Self {
        let duration_ms = milliseconds((end_frame - start_frame) as i64);
        Self { start_frame, end_frame, start_s: seconds(start_frame), duration_ms }
    }
}

pub fn count_classes(classes: &[u8]) -> [u64; 3] {
    std::array::from_fn(|c| classes.iter().filter(|&&class| usize::from(class) == c).count() as u64)
}

fn flag_runs(flag: &[u8]) -> Vec<FrameRun> {
    runs(flag.len(), |frame| flag[frame] != 0).into_iter().map(FrameRun::new).collect()
}

impl EventInfo {
    /// The outcome in words, such as `detected after 3 frames, 12.5 ms`.
    pub fn words(&self) -> String {
        let frames = |count: i64| counted(count as usize, "frame");
        match (self.outcome, self.delay_frames, self.delay_ms) {
            (Outcome::Hit, Some(delay), Some(ms)) => format!("detected after {}, {ms:.1} ms", frames(delay)),
            (Outcome::Early, Some(delay), Some(ms)) => format!("early by {}, {:.1} ms", frames(-delay), -ms),
            _ => "missed".to_owned(),
        }
    }
}

pub fn file_name(path: impl AsRef<Path>) -> String {
    let path = path.as_ref();
    path.file_name().unwrap_or(path.as_os_str()).to_string_lossy().into_owned()
}

/// Such as `1 frame`, `2 frames`.
pub fn counted(count: usize, what: &str) -> String {
    format!("{count} {what}{}", if count == 1 { "" } else { "s" })
}

impl fmt::Display for Summary {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "{}", self.episode.words())?;
        writeln!(f, "source: {}", self.episode.source.as_deref().unwrap_or("not stated"))?;
        writeln!(f, "model:  {}, hash {}…\n", self.model.name, &self.model.hash[..12])?;
        match &self.truth {
            Some(truth) => {
                let FlagScores { events, false_alarms } = &truth.may_begin;
                writeln!(f, "  event     onset       end   may begin")?;
                for (i, event) in events.iter().enumerate() {
                    let EventInfo { onset_s, end_s, .. } = event;
                    writeln!(f, "  {:>5}  {onset_s:>6.3} s  {end_s:>6.3} s   {}", i + 1, event.words())?;
                }
                if events.is_empty() {
                    writeln!(f, "   none")?;
                }
                writeln!(f, "\n  false alarms  {}", false_alarms.len())?;
                for alarm in false_alarms {
                    writeln!(f, "                at {:.3} s for {:.0} ms", alarm.start_s, alarm.duration_ms)?;
                }
                if let (Some(accuracy), Some(f1)) = (truth.accuracy, truth.macro_f1) {
                    let kind = if self.episode.synthetic { ", synthetic data" } else { "" };
                    let percent = 100.0 * accuracy;
                    writeln!(
                        f,
                        "  frames right  {percent:.1} % (macro F1 {f1:.3}, this episode only{kind})"
                    )?;
                }
            }
            None => {
                let runs = &self.output.may_begin_runs;
                writeln!(f, "  no labels, so no delays; slip may begin {}", counted(runs.len(), "time"))?;
                for run in runs {
                    writeln!(f, "    at {:>7.3} s for {:>6.1} ms", run.start_s, run.duration_ms)?;
                }
            }
        }
        writeln!(f, "  slip flag     {}", self.slip_words())?;
        for HealthCount { what, frames } in &self.output.health_frames {
            writeln!(f, "  health        {what} in {frames} frames")?;
        }
        let SpeedInfo { frames_per_s, times_real_time } = self.speed;
        writeln!(f, "  speed         {frames_per_s:.0} frames/s on one core, {times_real_time:.0}× real time")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn flag_runs_by_hand() {
        let runs = flag_runs(&[0, 1, 1, 0, 0, 1]);
        assert_eq!(runs.iter().map(|r| (r.start_frame, r.end_frame)).collect::<Vec<_>>(), [(1, 3), (5, 6)]);
        assert_eq!((runs[0].start_s, runs[0].duration_ms), (1.0 / 240.0, 2000.0 / 240.0));
        assert!(flag_runs(&[]).is_empty());
    }

    #[test]
    fn outcomes_read_as_sentences() {
        for (flagged, words) in [
            (23, "detected after 3 frames, 12.5 ms"),
            (20, "detected after 0 frames, 0.0 ms"),
            (19, "early by 1 frame, 4.2 ms"),
            (0, "missed"),
        ] {
            let (label, mut flag) = ([[0; 20], [2; 20]].concat(), [0; 40]);
            flag[flagged] = 1;
            assert_eq!(FlagScores::new(&label, &flag).events[0].words(), words);
        }
    }
}
