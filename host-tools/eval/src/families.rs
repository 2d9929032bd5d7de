//! Families of physics side by side: what pads and accelerometers make of each stage's families, beside recordings.
//!
//! In each panel one stage has another family, all others are the laboratory's. A recording of one's own, labelled,
//! stands beside them: where the families of a stage lie on one side of it, training knows too little.

use std::fmt;

use anyhow::{Context, Result};
use rayon::prelude::*;
use serde::Serialize;
use slipsense::features::{LN_FRAC_BITS, XlFrontEnd};
use slipsense::params::{CONTACT_SUM_MIN, FRAME_RATE_HZ, MEL_BINS, TAXELS, XL_AXES};
use slipsense::sensor::XlSample;
use slipsense_recording::Episode;
use slipsense_recording::label::{NO_CONTACT, NO_SLIP};
use slipsense_recording::score::SLIP;
use slipsense_synth::{FAMILIES, Recipe, ScenarioChoice, Stage, generate};

use crate::metrics::statistics;
use crate::table::{Table, number};

/// Frames before and behind an onset whose pressure is shown: half a second each.
pub const AROUND_ONSET: usize = FRAME_RATE_HZ as usize / 2;
/// Counts from which a taxel bears something.
const LOADED_COUNTS: f64 = 20.0;
/// Where nothing slips, the loudest frames stand for a disturbance: one of 20.
const LOUDEST_OF: usize = 20;

/// One family of a stage, or recordings.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Panel {
    /// None of recordings.
    pub stage: Option<Stage>,
    pub name: String,
    pub episodes: usize,
    /// Mean counts of the first sensor's taxels in the hold.
    pub hold_counts: Vec<f64>,
    /// Sum of the first sensor's taxels around the first onset over its mean before, [`AROUND_ONSET`] frames each way.
    pub onset_pressure: Vec<f64>,
    /// Speed of the interface there, mm/s; none where an episode does not know it.
    pub onset_mm_s: Vec<f64>,
    /// Mean log power of the mel bins in the hold, nat of LSB².
    pub hold_nat: [f64; MEL_BINS],
    /// The same in slip, or in the loudest frames where nothing slips.
    pub event_nat: [f64; MEL_BINS],
    /// Taxels that bear something in the hold.
    pub loaded_taxels: f64,
    /// Standard deviation of the pad's sum over the hold, percent of its mean.
    pub hold_varies_percent: f64,
    /// By how much the event is louder than the hold, nat, mean over the bins.
    pub louder_nat: f64,
    /// Peak over RMS of the samples of a frame in the event, mean.
    pub crest: f64,
    /// How far the shape of the event's spectrum is from that of the recordings, nat RMS; none without recordings.
    pub from_recordings_nat: Option<f64>,
}

/// Every stage's families, then recordings if there are any.
#[derive(Clone, Debug, Serialize)]
pub struct Gallery {
    pub synthetic: Vec<Panel>,
    pub recorded: Option<Panel>,
}

#[derive(Default)]
struct Seen {
    hold: Vec<Frame>,
    event: Vec<Frame>,
    counts: Vec<f64>,
    /// Pressure and speed around it.
    onset: Option<[Vec<f64>; 2]>,
}

/// What one frame of the first sensor shows.
struct Frame {
    sum: f64,
    nat: [f64; MEL_BINS],
    crest: f64,
}

/// Generate `episodes` of every family with seeds from `seed` on, and look at labelled recordings. `done` is called
/// after each family.
pub fn gallery(
    episodes: usize,
    seed: u64,
    recordings: &[Episode],
    done: &(dyn Fn() + Sync),
) -> Result<Gallery> {
    let seen_in = recordings.iter().map(seen).collect::<Result<Vec<_>>>()?;
    let recorded = (!recordings.is_empty()).then(|| Panel::new(None, "recordings".to_owned(), &seen_in));
    let all: Vec<(Stage, usize)> =
        Stage::ALL.iter().flat_map(|&stage| (0..FAMILIES).map(move |place| (stage, place))).collect();
    let families = all.into_par_iter().map(|(stage, place)| {
        // Disturbances are seen best where nothing slips.
        let scenario = match stage {
            Stage::Disturbance => ScenarioChoice::Disturbances,
            _ => ScenarioChoice::SixStep,
        };
        let recipe = |seed| Recipe { scenario, ..Recipe::new(seed) }.with_family(stage, place);
        let seen = (seed..).take(episodes).map(|seed| seen(&generate(&recipe(seed))?));
        let mut panel =
            Panel::new(Some(stage), recipe(seed).family(stage), &seen.collect::<Result<Vec<_>>>()?);
        panel.from_recordings_nat = recorded.as_ref().map(|recorded| shape_distance(&panel, recorded));
        done();
        anyhow::Ok(panel)
    });
    let synthetic = families.collect::<Result<Vec<_>>>()?;
    Ok(Gallery { synthetic, recorded })
}

fn seen(episode: &Episode) -> Result<Seen> {
    let label = episode.label.as_ref().context("array `label` is missing, the comparison needs it")?;
    let mut front_end = XlFrontEnd::new();
    let (mut seen, mut sums) = (Seen { counts: vec![0.0; TAXELS], ..Seen::default() }, Vec::new());
    for (frame, &class) in label.iter().enumerate() {
        let (scan, samples) = (episode.piezo(frame, 0), episode.xl_batch(frame, 0));
        front_end.push(samples);
        let nat = front_end.log_mel().ln_power.map(|x| f64::from(x) / f64::from(1 << LN_FRAC_BITS));
        let sum = f64::from(scan.sum());
        sums.push(sum);
        let of_frame = Frame { sum, nat, crest: crest(samples) };
        match class {
            SLIP => seen.event.push(of_frame),
            NO_SLIP if scan.sum() >= CONTACT_SUM_MIN => {
                let counts = seen.counts.iter_mut().zip(scan.counts());
                counts.for_each(|(sum, &count)| *sum += f64::from(count));
                seen.hold.push(of_frame);
            }
            _ => {}
        }
    }
    let held = seen.hold.len().max(1) as f64;
    seen.counts.iter_mut().for_each(|sum| *sum /= held);
    if seen.event.is_empty() {
        seen.hold.sort_by(|a, b| mean(&a.nat).total_cmp(&mean(&b.nat)));
        let quiet = seen.hold.len() - seen.hold.len() / LOUDEST_OF;
        seen.event = seen.hold.split_off(quiet);
    }
    let onset = (1..label.len()).find(|&frame| label[frame] == SLIP && label[frame - 1] != NO_CONTACT);
    seen.onset = onset.and_then(|onset| {
        let around = onset.checked_sub(AROUND_ONSET)?..onset + AROUND_ONSET;
        let sums = sums.get(around.clone())?;
        let before = mean(&sums[..AROUND_ONSET]).max(1.0);
        let speed = episode.slip_true_mm_s.as_ref().map_or(&[][..], |speed| &speed[around]);
        Some([sums.iter().map(|sum| sum / before).collect(), speed.iter().map(|&x| x.into()).collect()])
    });
    Ok(seen)
}

/// 0 of nothing.
fn mean(values: &[f64]) -> f64 {
    statistics::mean(values).unwrap_or_default()
}

/// Peak over RMS of samples without their mean.
fn crest(samples: &[XlSample]) -> f64 {
    let axis = |axis: usize| samples.iter().map(move |sample| f64::from(sample[axis]));
    let means: [f64; XL_AXES] = std::array::from_fn(|i| axis(i).sum::<f64>() / samples.len().max(1) as f64);
    let squares = samples
        .iter()
        .map(|sample| sample.iter().zip(means).map(|(&x, mean)| (f64::from(x) - mean).powi(2)).sum::<f64>());
    let squares: Vec<f64> = squares.collect();
    let peak = squares.iter().copied().fold(0.0, f64::max);
    (peak / mean(&squares).max(1e-9)).sqrt()
}

/// RMS difference of two spectra's shapes, their levels set aside, nat.
fn shape_distance(a: &Panel, b: &Panel) -> f64 {
    let (level_a, level_b) = (mean(&a.event_nat), mean(&b.event_nat));
    let shapes = a.event_nat.iter().zip(&b.event_nat);
    let squares: Vec<f64> = shapes.map(|(a, b)| (a - level_a - b + level_b).powi(2)).collect();
    mean(&squares).sqrt()
}

impl Panel {
    fn new(stage: Option<Stage>, name: String, seen: &[Seen]) -> Self {
        let frames = |of: fn(&Seen) -> &Vec<Frame>| seen.iter().flat_map(of).collect::<Vec<_>>();
        let (hold, event) = (frames(|seen| &seen.hold), frames(|seen| &seen.event));
        let spectrum = |frames: &[&Frame]| {
            std::array::from_fn(|bin| mean(&frames.iter().map(|frame| frame.nat[bin]).collect::<Vec<_>>()))
        };
        let over_episodes = |value: &dyn Fn(&Seen) -> f64| mean(&seen.iter().map(value).collect::<Vec<_>>());
        let varies = |seen: &Seen| {
            let sums: Vec<f64> = seen.hold.iter().map(|frame| frame.sum).collect();
            100.0 * statistics::standard_deviation(&sums).unwrap_or_default() / mean(&sums).max(1.0)
        };
        let loaded = |seen: &Seen| seen.counts.iter().filter(|&&c| c >= LOADED_COUNTS).count() as f64;
        let (hold_nat, event_nat) = (spectrum(&hold), spectrum(&event));
        let [onset_pressure, onset_mm_s] =
            seen.iter().find_map(|seen| seen.onset.clone()).unwrap_or_default();
        Self {
            stage,
            name,
            episodes: seen.len(),
            hold_counts: seen.first().map(|seen| seen.counts.clone()).unwrap_or_default(),
            onset_pressure,
            onset_mm_s,
            louder_nat: mean(&event_nat) - mean(&hold_nat),
            hold_nat,
            event_nat,
            loaded_taxels: over_episodes(&loaded),
            hold_varies_percent: over_episodes(&varies),
            crest: mean(&event.iter().map(|frame| frame.crest).collect::<Vec<_>>()),
            from_recordings_nat: None,
        }
    }
}

impl fmt::Display for Gallery {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let title = "families of physics (synthetic data), other stages as in the laboratory";
        let table = Table::rows(title, 2, self.synthetic.iter().chain(&self.recorded)).columns(&[
            ("stage", |panel| panel.stage.map_or(String::new(), |stage| format!("{stage:?}").to_lowercase())),
            ("family", |panel| panel.name.clone()),
            ("loaded taxels", |panel| number(Some(panel.loaded_taxels), 0)),
            ("hold varies %", |panel| number(Some(panel.hold_varies_percent), 1)),
            ("event over hold nat", |panel| number(Some(panel.louder_nat), 2)),
            ("crest", |panel| number(Some(panel.crest), 2)),
            ("from recordings nat", |panel| number(panel.from_recordings_nat, 2)),
        ]);
        write!(f, "{table}")?;
        f.write_str(
            "  event: slip, or the loudest twentieth of the hold where nothing slips; from recordings: difference of \
             the event's spectrum in shape",
        )
    }
}
