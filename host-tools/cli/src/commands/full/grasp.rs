//! `slipsense grasp`: a gripper that reacts to the slip flag, in closed loop with the generator's plant.

use std::collections::BTreeMap;
use std::fmt::Write;
use std::path::PathBuf;

use anyhow::{Context, Result, ensure};
use clap::ValueEnum;
use rayon::prelude::*;
use serde_json::{Value, json};
use slipsense_synth::plant::{Hand, LOST_MM, LOST_TURN_RAD, Objects, Trial, trials};

use super::{ModelArg, Print, written};
use crate::grasp::{
    ACTUATOR_MS, Failure, Flag, LoopConfig, Outcome, Reaction, Spread, Totals, TrialResult, TrialSeries,
    inference_us, run,
};
use crate::output::OutputDir;
use crate::picture::{grasp_latencies, grasp_trial};
use crate::summary::counted;

/// Close the loop: a synthetic gripper grips harder when its sensors detect slip
///
/// A hand pulls or twists objects out of the grip, in all directions of the pad. The firmware's pipeline sees what
/// the sensors deliver, its slip messages go over a modelled CAN FD bus, and a controller as the paper's moves the
/// fingers inward while the flag is up. Everything is synthetic: no number here is a claim about a real gripper.
#[derive(clap::Args)]
#[command(after_help = "\
Time passes as on the board: tick, inference (worst on the emulated microcontroller), the message's frame on a
1/8 Mbit/s bus behind the module's own raw messages, then 20 to 40 ms until the commanded force is there. An
object is lost when it has slid 10 mm or turned by 45 degrees, or has left a finger. Slip is that of the whole
contact; it begins with parts of it, so that the flag may come before. The controller's two
parameters were chosen on --objects val; the ten objects reported are in no training and no validation set.

Files written to the output folder:
  trial.svg     one trial: grip, distance slid with and without the reaction, flag
  latency.svg   histograms: from slip to flag, from flag to the largest grip
  grasp.json    every trial and the totals; units are in the keys

Examples:
  slipsense grasp                                        100 trials with the three-finger hand
  slipsense grasp --hand tesollo2 --out out/grasp        two fingers; pictures and numbers
  slipsense grasp --flag slip                            act on the slip flag instead of the class
  slipsense grasp --objects val --seed 7 --gain 2        try other parameters, not on the reported objects
  slipsense grasp --trials 20 --json | jq .totals.kept")]
pub struct Args {
    /// Hand: umi (parallel jaw), tesollo2 or tesollo3 (motorised, two or three fingers)
    #[arg(long, value_name = "NAME", default_value = "tesollo3")]
    hand: Hand,
    /// Objects: unseen (ten that training has never seen) or val (those kept for choosing)
    #[arg(long, value_name = "NAME", default_value = "unseen")]
    objects: Objects,
    /// Flag of the slip message that is acted on
    #[arg(long, value_enum, default_value = "may-begin")]
    flag: Flag,
    /// Number of trials, 1 to 1000
    #[arg(long, value_name = "N", default_value = "100", value_parser = clap::value_parser!(u16).range(1..=1000))]
    trials: u16,
    /// Seed of every draw
    #[arg(long, value_name = "N", default_value = "1")]
    seed: u64,
    /// A motion inward multiplies the grip by this, above 1 to 4
    #[arg(long, value_name = "FACTOR", default_value_t = Reaction::GAIN, value_parser = gain)]
    gain: f64,
    /// How long after a motion the flag is ignored, 0 to 500 ms
    #[arg(long, value_name = "MS", default_value_t = Reaction::SETTLE_MS, value_parser = settle_ms)]
    settle_ms: f64,
    /// From tick to slip message handed over, 0 to 4000 us; the emulated board's worst if not given
    #[arg(long, value_name = "US", value_parser = clap::value_parser!(u64).range(0..=4000))]
    inference_us: Option<u64>,
    /// Load by other nodes' frames, percent of the bus's time
    #[arg(long, value_name = "PERCENT", default_value = "0", value_parser = clap::value_parser!(u8).range(0..=100))]
    foreign: u8,
    #[command(flatten)]
    model: ModelArg,
    /// Trial to draw; the first whose object was kept and would have been lost, if not given
    #[arg(long, value_name = "N", requires = "out")]
    show: Option<usize>,
    /// Folder to write pictures and numbers to; made if it is not there
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    #[command(flatten)]
    print: Print,
}

fn gain(text: &str) -> Result<f64, String> {
    let gain = text.parse::<f64>().ok().filter(|gain| *gain > 1.0 && *gain <= 4.0);
    gain.ok_or_else(|| format!("\"{text}\" must be a number above 1, at most 4"))
}

fn settle_ms(text: &str) -> Result<f64, String> {
    let ms = text.parse::<f64>().ok().filter(|ms| (0.0..=500.0).contains(ms));
    ms.ok_or_else(|| format!("\"{text}\" must be a number from 0 to 500"))
}

impl Args {
    pub fn run(self) -> Result<()> {
        let (json, text) = self.close_loop()?;
        self.print.show(&json, || {
            let files = [("picture", "trial.svg"), ("histograms", "latency.svg"), ("numbers", "grasp.json")];
            let files = self.out.as_ref().map(|folder| format!("\n{}", written(folder, &files)));
            text + &files.unwrap_or_default()
        })
    }

    /// All trials, written to the folder if there is one: as JSON and as text.
    pub fn close_loop(&self) -> Result<(Value, String)> {
        let count = usize::from(self.trials);
        let show = self.show.unwrap_or(0);
        ensure!(show < count, "--show {show}: there are {count} trials, numbered from 0");
        let source = self.model.read()?;
        let model = source.parse()?;
        let out = self.out.as_deref().map(OutputDir::prepare).transpose()?;
        let reaction = Reaction { flag: self.flag, gain: self.gain, settle_ms: self.settle_ms };
        let config = LoopConfig {
            reaction,
            inference_us: self.inference_us.unwrap_or_else(|| inference_us(self.hand.fingers())),
            foreign_percent: self.foreign,
        };
        let trials = trials(self.objects, self.hand, self.seed, count);
        let done = self.print.progress(count, "trials", |bar| {
            let one = |(index, trial): (usize, &Trial)| {
                let (outcome, series) =
                    run(trial, model, &config).with_context(|| format!("trial {index}, {}", trial.object))?;
                bar.inc(1);
                Ok((TrialResult::new(index, trial, outcome), series))
            };
            trials.par_iter().enumerate().map(one).collect::<Result<Vec<_>>>()
        })?;
        let (results, series): (Vec<TrialResult>, Vec<TrialSeries>) = done.into_iter().unzip();
        let totals = Totals::new(&results);
        let json = json!({
            "synthetic": true, "hand": self.hand, "objects": self.objects, "seed": self.seed,
            "reaction": reaction, "inference_us": config.inference_us, "foreign_percent": config.foreign_percent,
            "actuator_ms": ACTUATOR_MS, "lost_mm": LOST_MM, "lost_turn_rad": LOST_TURN_RAD,
            "model": source.name, "totals": totals, "trials": results,
        });
        if let Some(out) = out {
            let headline = self.headline();
            let show = self.show.unwrap_or_else(|| typical(&results));
            out.write("trial.svg", grasp_trial(&results[show], &series[show], &headline))?;
            out.write("latency.svg", grasp_latencies(&results, &totals, &headline))?;
            out.write("grasp.json", serde_json::to_string_pretty(&json)? + "\n")?;
            out.commit()?;
        }
        Ok((json, self.table(&results, &totals)))
    }

    fn headline(&self) -> String {
        let flag = self.flag.to_possible_value().unwrap_or_default();
        let (hand, objects, flag) = (self.hand.name(), self.objects.name(), flag.get_name());
        format!(
            "synthetic; hand {hand}, objects {objects}, flag {flag}, gain {}, seed {}",
            self.gain, self.seed
        )
    }

    fn table(&self, results: &[TrialResult], totals: &Totals) -> String {
        let mut text = format!("{} trials; {}\n\n", totals.trials, self.headline());
        let mut line = |name: &str, what: &str| {
            let _ = writeln!(text, "  {name:<42} {what}");
        };
        let of_trials = |count: usize| format!("{count} of {}", totals.trials);
        let early = format!(", {} of them more than 50 ms before", totals.early);
        line("slips detected", &format!("{} of {}{early}", totals.detected, totals.slips));
        line("objects kept", &of_trials(totals.kept));
        line("objects kept without any reaction", &of_trials(totals.kept_without));
        line("trials with a motion before the pull", &of_trials(totals.with_false_motion));
        line("", "   min  median    90 %     max");
        for (name, spread) in [
            ("slip to the tick of the flag's frame", totals.delay),
            ("that tick to the message at the controller", totals.message),
            ("that tick to the force of the first motion", totals.first),
            ("that tick to the largest grip", totals.peak),
        ] {
            if let Some(Spread { min_ms, median_ms, p90_ms, max_ms }) = spread {
                line(name, &format!("{min_ms:>6.1} {median_ms:>7.1} {p90_ms:>7.1} {max_ms:>7.1} ms"));
            }
        }
        if let Some((median, most)) = totals.slid_kept_mm {
            let slid = format!("median {median:.2} mm, at most {most:.2} mm");
            line("distance slid by the objects that were kept", &slid);
        }
        text += "\n  by object          trials  detected  kept\n";
        let mut by_object: BTreeMap<&str, Vec<TrialResult>> = BTreeMap::new();
        for result in results {
            by_object.entry(&result.object).or_default().push(result.clone());
        }
        for (name, results) in by_object {
            let Totals { trials, detected, kept, .. } = Totals::new(&results);
            let _ = writeln!(text, "  {name:<18} {trials:>6} {detected:>9} {kept:>5}");
        }
        for result in results {
            if let Some(failure) = result.failure {
                let _ = writeln!(text, "\n  lost: {}", lost(result, failure));
            }
        }
        text
    }
}

fn lost(result: &TrialResult, failure: Failure) -> String {
    let TrialResult { trial, object, direction, .. } = result;
    let Outcome { motions, grip_n: (first_n, last_n), slid_mm, .. } = &result.outcome;
    let (speed, why) = (result.speed_mm_s.unwrap_or_default(), failure.words());
    let motions = counted(*motions, "motion");
    format!(
        "trial {trial}, {object}, {direction:?} at {speed} mm/s: {why}; {motions}, grip {first_n:.1} to {last_n:.1} N, \
         slid {slid_mm:.1} mm"
    )
}

/// The first trial whose object was kept and would have been lost.
fn typical(results: &[TrialResult]) -> usize {
    let saved = |result: &TrialResult| {
        result.outcome.lost.is_none()
            && result.outcome.lost_without.is_some()
            && result.outcome.false_motions == 0
    };
    results.iter().position(saved).unwrap_or(0)
}
