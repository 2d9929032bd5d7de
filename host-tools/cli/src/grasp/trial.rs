//! One trial of the loop.

use anyhow::{Context, Result, ensure};
use slipsense::fixed::Logit;
use slipsense::net::Model;
use slipsense::params::{FRAME_RATE_HZ, MAX_SENSORS};
use slipsense::pipeline::{FrameStamp, Pipeline};
use slipsense::wire::Origin;
use slipsense_synth::plant::{GRIP_MAX_N, Plant, Trial};

use super::controller::{Controller, Reaction};
use super::link::Link;

/// From a command until the force is there, milliseconds: drawn for each trial.
pub const ACTUATOR_MS: (f64, f64) = (20.0, 40.0);
/// Share of it in which nothing moves yet.
const DEAD_SHARE: f64 = 0.25;

/// Time from a tick until its slip message is in the CAN controller's queue, microseconds: the worst on the emulated
/// STM32H743, one instruction per cycle at 480 MHz (`docs/src/figures.md`, Real time and faults).
pub const fn inference_us(sensors: usize) -> u64 {
    const WORST_US: [u64; MAX_SENSORS] = [961, 1_791, 2_574];
    WORST_US[if sensors > MAX_SENSORS { MAX_SENSORS - 1 } else { sensors.saturating_sub(1) }]
}

#[derive(Clone, Copy, Debug)]
pub struct LoopConfig {
    pub reaction: Reaction,
    /// From tick to slip message handed over, microseconds.
    pub inference_us: u64,
    /// Share of the bus's time that other nodes ask for.
    pub foreign_percent: u8,
}

/// The outcome of a trial. Frames are numbered from 0, times are seconds from the start; the tick of frame `f` is at
/// `(f + 1) / 240`.
#[derive(Clone, Debug, Default, serde::Serialize)]
pub struct Outcome {
    /// Frame at which the object would have begun to slip as a whole, as it was when slip was first flagged of it;
    /// none where it never would have.
    pub onset: Option<usize>,
    /// First frame of the pull whose flag is up before that slip is over.
    pub detected: Option<usize>,
    pub lost: Option<usize>,
    /// Frame at which it would have been lost without any reaction.
    pub lost_without: Option<usize>,
    /// Motions commanded before that: nothing pulled yet, or nothing was going to slip.
    pub false_motions: usize,
    pub motions: usize,
    /// From the tick of `detected` until the message was at the controller.
    pub message_s: Option<f64>,
    /// From the tick of `detected` until the first motion's force was there.
    pub first_s: Option<f64>,
    /// From the same tick until the largest grip was reached, by the last motion.
    pub peak_s: Option<f64>,
    /// Grip of one finger at the start and at its largest, newtons.
    pub grip_n: (f64, f64),
    pub at_limit: bool,
    /// Way slid from the beginning of the pull until the gripper lets go, mm.
    pub slid_mm: f64,
    pub slid_without_mm: f64,
    pub actuator_ms: f64,
}

/// Series of a trial for its picture, one value per frame.
#[derive(Clone, Debug, Default)]
pub struct TrialSeries {
    /// Way slid since the start, mm.
    pub slid_mm: Vec<f64>,
    pub slid_without_mm: Vec<f64>,
    pub grip_n: Vec<f64>,
    pub log_odds_nat: Vec<f64>,
    pub flag: Vec<bool>,
    pub commands_s: Vec<f64>,
}

fn tick_s(frame: usize) -> f64 {
    (frame + 1) as f64 / FRAME_RATE_HZ as f64
}

fn tick_ns(frame: usize) -> u64 {
    (frame as u64 + 1) * 1_000_000_000 / u64::from(FRAME_RATE_HZ)
}

fn sample(plant: &Plant, of: impl Fn(&Plant, usize) -> f64) -> Vec<f64> {
    (0..plant.frames()).map(|frame| of(plant, frame)).collect()
}

pub fn run(trial: &Trial, model: Model<'_>, config: &LoopConfig) -> Result<(Outcome, TrialSeries)> {
    let mut plant = trial.plant()?;
    let mut pipeline = Pipeline::new(model, plant.sensors())?;
    let mut link = Link::new(config.foreign_percent)?;
    let actuator_ms = trial.draw_between(ACTUATOR_MS.0, ACTUATOR_MS.1);
    let actuator_ns = (actuator_ms * 1e6) as u64;
    let first_n = plant.target_n();
    let mut controller = Controller::new(config.reaction, first_n);
    let (lost_without, slid_without) = (plant.lost_at(), sample(&plant, Plant::slid_mm));
    let (held_s, released_s) = plant.held_s();
    let pulled = plant.pulled();

    let mut series = TrialSeries::default();
    let (mut onset, mut detected, mut message_s) = (None, None, None);
    let (mut false_motions, mut motions) = (0, 0);
    let (mut first_at_s, mut peak_at_s) = (None, None);
    for frame in 0..plant.frames() {
        let read = plant.step().context("the plant ends before its last frame")?;
        let output = pipeline.step(read.inputs());
        let stamp = FrameStamp::of_recording(u32::try_from(frame).context("frame number")?);
        // Time passes while the network runs; older messages may arrive meanwhile.
        let mut received = link.advance(tick_ns(frame) + 1000 * config.inference_us)?;
        let raw = read.inputs().iter().enumerate();
        let raw = raw.map(|(sensor, &input)| output.raw_frame(stamp, sensor, input));
        let slip = output.slip_message(stamp, &Origin::default());
        link.send(&slip, raw)?;
        series.log_odds_nat.push(output.log_odds.map_or(0.0, Logit::to_f64));
        series.flag.push(config.reaction.flag.is_up(&slip));
        received.extend(link.advance(tick_ns(frame + 1))?);

        for (at_ns, message) in received {
            let now_s = at_ns as f64 * 1e-9;
            let flagged = message.sequence as usize;
            let (start_s, end_s) = (now_s + DEAD_SHARE * actuator_ms * 1e-3, now_s + actuator_ms * 1e-3);
            // The controller is at work from the complete grasp until it lets go.
            if tick_s(flagged) < held_s || end_s >= released_s {
                continue;
            }
            if config.reaction.flag.is_up(&message) && detected.is_none() && pulled.contains(&flagged) {
                // What lies ahead is what would happen without this message's command.
                let slip = plant.slips().into_iter().find(|slip| flagged < slip.end);
                if let Some(slip) = slip {
                    (onset, detected) = (Some(slip.start), Some(flagged));
                    message_s = Some(now_s - tick_s(flagged));
                }
            }
            if let Some(grip_n) = controller.receive(&message, at_ns, actuator_ns) {
                ensure!(start_s >= plant.earliest_s(), "frame {flagged}: its command acts in what is past");
                plant.command(start_s, end_s, grip_n)?;
                motions += 1;
                false_motions += usize::from(detected.is_none());
                if detected.is_some() {
                    first_at_s = first_at_s.or(Some(end_s));
                    peak_at_s = Some(end_s);
                }
                series.commands_s.push(now_s);
            }
        }
    }
    series.slid_mm = sample(&plant, Plant::slid_mm);
    series.grip_n = sample(&plant, |plant, frame| plant.grip_n(tick_s(frame)));
    let last = pulled.end - 1;
    let slid = |values: &[f64]| values[last] - values[pulled.start];
    let since_detected =
        |at_s: Option<f64>| detected.zip(at_s).map(|(frame, at_s): (usize, f64)| at_s - tick_s(frame));
    let outcome = Outcome {
        onset: onset.or_else(|| plant.slips().first().map(|slip| slip.start)),
        detected,
        lost: plant.lost_at(),
        lost_without,
        false_motions,
        motions,
        message_s,
        first_s: since_detected(first_at_s),
        peak_s: since_detected(peak_at_s),
        grip_n: (first_n, plant.target_n()),
        at_limit: plant.target_n() >= GRIP_MAX_N,
        slid_mm: slid(&series.slid_mm),
        slid_without_mm: slid(&slid_without),
        actuator_ms,
    };
    series.slid_without_mm = slid_without;
    Ok((outcome, series))
}
