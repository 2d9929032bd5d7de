//! The result of one episode in numbers: what `summary.json` holds and the terminal shows.

use std::borrow::Cow;
use std::fmt::Write;
use std::path::Path;

use serde::Serialize;
use slipsense::net::Model;
use slipsense::net::format::OperatingPoint;
use slipsense::params::FRAME_RATE_HZ;
use slipsense_recording::Episode;
use slipsense_recording::score::{ClassScores, Detection, score_events};

use crate::simulate::Simulation;

/// Version of the layout of `summary.json`.
const FORMAT: u32 = 1;

/// The result of one episode. Frames count from 0; frame f stands at f/240 s.
#[derive(Clone, Debug, Serialize)]
pub struct Summary {
    /// Version of this layout.
    pub format: u32,
    /// What was run.
    pub episode: EpisodeFacts,
    /// By which model.
    pub model: ModelFacts,
    /// What came out.
    pub output: OutputFacts,
    /// How it compares with the labels; `null` where the episode has none.
    pub truth: Option<TruthFacts>,
    /// How fast it went.
    pub speed: SpeedFacts,
}

/// What was run.
#[derive(Clone, Debug, Serialize)]
pub struct EpisodeFacts {
    /// Name of the file, or `bundled`.
    pub name: String,
    /// Does the file say that it was generated?
    pub synthetic: bool,
    /// Where the file says that it comes from.
    pub source: Option<String>,
    /// The object, as the file names it.
    pub object: Option<String>,
    /// Crosshead speed, mm/s, as the file says.
    pub speed_mm_s: Option<f64>,
    /// Sensors.
    pub sensors: usize,
    /// Frames.
    pub frames: usize,
    /// Length, s.
    pub duration_s: f64,
}

/// Which model decided.
#[derive(Clone, Debug, Serialize)]
pub struct ModelFacts {
    /// Name of the file, or `bundled`.
    pub name: String,
    /// The hash that ends the model file (SHA-256 of what stands before it): the model's identity.
    pub hash: String,
    /// When the alarm sounds.
    pub operating_point: PointFacts,
    /// How it was made, as the file says.
    pub provenance: serde_json::Value,
}

/// The model's operating point: the alarm is up while `k` of the last `n` frames are over the threshold.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct PointFacts {
    /// Lead of the slip logit that is not enough yet, nat.
    pub threshold_nat: f64,
    /// Frames that must be over.
    pub k: u8,
    /// Frames looked back over, the current one included.
    pub n: u8,
}

/// What came out of the pipeline.
#[derive(Clone, Debug, Serialize)]
pub struct OutputFacts {
    /// Frames decided as no contact, contact without slip, slip.
    pub class_frames: [u64; 3],
    /// Maximal runs of frames with the slip flag up.
    pub flag_runs: Vec<FrameRun>,
    /// Maximal runs of frames with the alarm up.
    pub alarm_runs: Vec<FrameRun>,
    /// Frames in which a health bit of any sensor was set, by bit.
    pub health_frames: Vec<HealthCount>,
    /// CAN frames in `can.log`.
    pub can_frames: u64,
}

/// Frames `start_frame..end_frame`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct FrameRun {
    /// First frame.
    pub start_frame: usize,
    /// Frame after the last.
    pub end_frame: usize,
    /// Start, s.
    pub start_s: f64,
    /// Length, ms.
    pub duration_ms: f64,
}

/// How often something was wrong.
#[derive(Clone, Debug, Serialize)]
pub struct HealthCount {
    /// What was wrong.
    pub what: &'static str,
    /// Frames in which any sensor reported it.
    pub frames: usize,
}

/// Comparison with the labels.
#[derive(Clone, Debug, Serialize)]
pub struct TruthFacts {
    /// Frames labelled no contact, contact without slip, slip.
    pub class_frames: [u64; 3],
    /// Slip events by the encoder rule.
    pub events: Vec<EventFacts>,
    /// Alarms that belong to no event: runs of flags more than 50 ms away from any, merged when less
    /// than 200 ms apart.
    pub false_alarms: Vec<FrameRun>,
    /// The same of the alarm at the model's operating point.
    pub alarm: AlarmFacts,
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

/// Events and false alarms by the alarm, as [`TruthFacts`] has them by the slip flag.
#[derive(Clone, Debug, Serialize)]
pub struct AlarmFacts {
    /// Slip events.
    pub events: Vec<EventFacts>,
    /// Alarms that belong to no event.
    pub false_alarms: Vec<FrameRun>,
}

/// One slip event and its detection.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct EventFacts {
    /// First frame labelled slip.
    pub onset_frame: usize,
    /// Frame after the last one labelled slip.
    pub end_frame: usize,
    /// Onset, s.
    pub onset_s: f64,
    /// End, s.
    pub end_s: f64,
    /// First flag in the event.
    pub outcome: Outcome,
    /// Frames from the onset to the flag: negative if early, `null` if missed.
    pub delay_frames: Option<i64>,
    /// The same in milliseconds, without computing time.
    pub delay_ms: Option<f64>,
}

/// What became of an event.
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

/// How fast the pipeline ran.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct SpeedFacts {
    /// Frames per second of pipeline time on one core of this computer.
    pub frames_per_s: f64,
    /// The same as a multiple of the sensors' frame rate.
    pub times_real_time: f64,
}

/// Seconds from frame 0 to this frame.
pub fn seconds(frame: usize) -> f64 {
    frame as f64 / f64::from(FRAME_RATE_HZ)
}

fn milliseconds(frames: i64) -> f64 {
    frames as f64 * 1000.0 / f64::from(FRAME_RATE_HZ)
}

fn run(start_frame: usize, end_frame: usize) -> FrameRun {
    let duration_ms = milliseconds((end_frame - start_frame) as i64);
    FrameRun { start_frame, end_frame, start_s: seconds(start_frame), duration_ms }
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
        let frames_per_s = simulation.frames_per_s();
        let times_real_time = frames_per_s / f64::from(FRAME_RATE_HZ);
        Self {
            format: FORMAT,
            episode: EpisodeFacts::new(episode, episode_name),
            model: ModelFacts::new(model, model_name),
            output: OutputFacts::new(simulation),
            truth: episode.label.as_ref().map(|label| TruthFacts::new(label, simulation)),
            speed: SpeedFacts { frames_per_s, times_real_time },
        }
    }
}

impl EpisodeFacts {
    pub(crate) fn new(episode: &Episode, name: &str) -> Self {
        let text = |key: &str| episode.meta.other.get(key).and_then(|v| v.as_str()).map(str::to_owned);
        let says = |key: &str| text(key).is_some_and(|v| v.to_lowercase().contains("synthetic"));
        Self {
            name: name.to_owned(),
            synthetic: says("source") || says("platform"),
            source: text("source"),
            object: text("object"),
            speed_mm_s: episode.meta.other.get("speed_mm_s").and_then(|v| v.as_f64()),
            sensors: episode.sensors,
            frames: episode.frames(),
            duration_s: seconds(episode.frames()),
        }
    }
}

impl ModelFacts {
    pub(crate) fn new(model: &Model<'_>, name: &str) -> Self {
        let mut hash = String::new();
        for byte in model.hash {
            let _ = write!(hash, "{byte:02x}");
        }
        // The format does not demand JSON, so other text is passed on as text.
        let provenance =
            serde_json::from_str(model.provenance).unwrap_or_else(|_| model.provenance.to_owned().into());
        let OperatingPoint { threshold, k, n } = model.point;
        let operating_point = PointFacts { threshold_nat: threshold.to_f64(), k, n };
        Self { name: name.to_owned(), hash, operating_point, provenance }
    }
}

impl OutputFacts {
    fn new(simulation: &Simulation) -> Self {
        use slipsense::health;
        let predictions = &simulation.predictions;
        let bits = [
            ("array missing", health::PIEZO_MISSING),
            ("accelerometer missing", health::XL_MISSING),
            ("accelerometer warming up", health::XL_WARMING_UP),
            ("accelerometer clipped", health::XL_CLIPPED),
            ("taxels saturated", health::TAXELS_SATURATED),
            ("accelerometer samples dropped", health::XL_SAMPLES_DROPPED),
        ];
        let frames_with = |bit: u8| {
            let sensors = simulation.health.chunks_exact(predictions.sensors);
            sensors.filter(|health| health.iter().any(|h| h & bit != 0)).count()
        };
        let counts = bits.map(|(what, bit)| HealthCount { what, frames: frames_with(bit) });
        Self {
            class_frames: count_classes(&predictions.class),
            flag_runs: flag_runs(&predictions.slip),
            alarm_runs: flag_runs(&predictions.alarm),
            health_frames: counts.into_iter().filter(|count| count.frames > 0).collect(),
            can_frames: simulation.can_frames,
        }
    }
}

impl TruthFacts {
    fn new(label: &[u8], simulation: &Simulation) -> Self {
        let predictions = &simulation.predictions;
        let (events, false_alarms) = scored(label, &predictions.slip);
        let (alarm_events, alarm_false_alarms) = scored(label, &predictions.alarm);
        let classes = ClassScores::new(label, &predictions.class);
        Self {
            class_frames: count_classes(label),
            events,
            false_alarms,
            alarm: AlarmFacts { events: alarm_events, false_alarms: alarm_false_alarms },
            confusion: classes.confusion,
            accuracy: classes.accuracy(),
            macro_f1: classes.macro_f1(),
            fpr_of_non_slip: classes.fpr_of_non_slip(),
            fpr_of_all: classes.fpr_of_all(),
        }
    }
}

/// Events and false alarms of a flag.
fn scored(label: &[u8], flag: &[u8]) -> (Vec<EventFacts>, Vec<FrameRun>) {
    let scores = score_events(label, flag);
    let events = scores.events.iter().map(|event| {
        let (outcome, delay_frames) = match event.detection {
            Detection::Hit { delay } => (Outcome::Hit, Some(delay as i64)),
            Detection::Early { lead } => (Outcome::Early, Some(-(lead as i64))),
            Detection::Missed => (Outcome::Missed, None),
        };
        EventFacts {
            onset_frame: event.onset,
            end_frame: event.end,
            onset_s: seconds(event.onset),
            end_s: seconds(event.end),
            outcome,
            delay_frames,
            delay_ms: delay_frames.map(milliseconds),
        }
    });
    (events.collect(), scores.false_alarms.iter().map(|alarm| run(alarm.start, alarm.end)).collect())
}

fn count_classes(classes: &[u8]) -> [u64; 3] {
    std::array::from_fn(|c| classes.iter().filter(|&&class| usize::from(class) == c).count() as u64)
}

fn flag_runs(slip: &[u8]) -> Vec<FrameRun> {
    let mut start = 0;
    let mut runs = Vec::new();
    for same in slip.chunk_by(|a, b| a == b) {
        if same[0] != 0 {
            runs.push(run(start, start + same.len()));
        }
        start += same.len();
    }
    runs
}

impl Summary {
    /// One line: the operating point, and what its alarm made of the episode.
    pub fn alarm_words(&self) -> String {
        let PointFacts { threshold_nat, k, n } = self.model.operating_point;
        let point = format!("{k} of {n} frame{} over {threshold_nat:.3} nat", plural(n.into()));
        let Some(TruthFacts { alarm: AlarmFacts { events, false_alarms }, .. }) = &self.truth else {
            let raised = self.output.alarm_runs.len();
            return format!("{point}: raised {raised} time{}", plural(raised as i64));
        };
        let found = events.iter().filter(|event| event.outcome != Outcome::Missed).count();
        let (slips, alarms) = (events.len(), false_alarms.len());
        let s = [slips, alarms].map(|count| plural(count as i64));
        format!("{point}: {found} of {slips} slip{} found, {alarms} false alarm{}", s[0], s[1])
    }
}

impl EventFacts {
    /// The outcome in words, such as `hit, 3 frames, 12.5 ms`.
    pub fn words(&self) -> String {
        match (self.outcome, self.delay_frames, self.delay_ms) {
            (Outcome::Hit, Some(frames), Some(ms)) => {
                format!("detected after {frames} frame{}, {ms:.1} ms", plural(frames))
            }
            (Outcome::Early, Some(frames), Some(ms)) => {
                format!("early by {} frame{}, {:.1} ms", -frames, plural(-frames), -ms)
            }
            _ => "missed".to_owned(),
        }
    }
}

/// The last part of a path.
pub(crate) fn file_name(path: &str) -> Cow<'_, str> {
    Path::new(path).file_name().map_or(path.into(), |name| name.to_string_lossy())
}

pub(crate) fn plural(count: i64) -> &'static str {
    if count == 1 { "" } else { "s" }
}

impl EpisodeFacts {
    /// One line: what this episode is, without its source.
    pub fn words(&self) -> String {
        let kind = if self.synthetic { "synthetic episode" } else { "episode" };
        let file = file_name(&self.name);
        let mut words = format!("{kind} {file}");
        if let Some(object) = &self.object {
            let _ = write!(words, ", {object}");
        }
        if let Some(speed) = self.speed_mm_s {
            let _ = write!(words, ", {speed} mm/s");
        }
        let sensors = self.sensors;
        let _ = write!(words, ", {sensors} sensor{}, {:.2} s", plural(sensors as i64), self.duration_s);
        words
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
        let event = |outcome, delay: Option<i64>| EventFacts {
            onset_frame: 10,
            end_frame: 20,
            onset_s: seconds(10),
            end_s: seconds(20),
            outcome,
            delay_frames: delay,
            delay_ms: delay.map(milliseconds),
        };
        assert_eq!(event(Outcome::Hit, Some(3)).words(), "detected after 3 frames, 12.5 ms");
        assert_eq!(event(Outcome::Hit, Some(0)).words(), "detected after 0 frames, 0.0 ms");
        assert_eq!(event(Outcome::Early, Some(-1)).words(), "early by 1 frame, 4.2 ms");
        assert_eq!(event(Outcome::Missed, None).words(), "missed");
    }
}
