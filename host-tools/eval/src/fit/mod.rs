//! Thresholds, class densities and tables of the detectors, fitted on the training split and nothing else.
//!
//! One pass over the episodes, in parallel, keeps scores and features of every [`Plan::stride`]th frame;
//! everything is then fitted on those, in the order of the episodes, so that the same episodes give the
//! same file. Class shares and the clock count every frame. Detectors start anew with each episode here,
//! which touches the first 16 ms of each.

mod fitted;
mod irls;
mod json;
mod sample;
mod youden;

pub use fitted::{Cut, DataUsed, FORMAT, Fitted, LogisticFit, MfccFit, Odds, RigFit};
pub use irls::logistic;
pub use youden::{Youden, youden};

use anyhow::{Context, Result, ensure};
use rayon::prelude::*;
use slipsense::params::CLASSES;
use slipsense_recording::score::SLIP;
use slipsense_synth::labels::NO_SLIP;

use crate::detectors::qda::{Gaussian, Scaling};
use crate::detectors::{ClassOrder, rig_terms};
use crate::source::Handle;
use sample::{Frame, Sample};

/// How to fit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Plan {
    /// Of how many frames one is used, at least 1.
    pub stride: usize,
    /// Which rule makes the classes first.
    pub class_order: ClassOrder,
}

impl Default for Plan {
    /// Every fourth frame, after which the analysis windows share no sample: of a million training frames
    /// that leaves a quarter of a million, far more than any fit here has numbers.
    fn default() -> Self {
        Self { stride: 4, class_order: ClassOrder::default() }
    }
}

/// Fit everything on these episodes, loaded on all cores and in any order, few at a time. `source` says
/// where they come from; `done` is called after each.
///
/// Refuses an episode that is not of the training split: one whose meta says `split` must say `train`, one
/// that does not must not be of a held-out object (`held_out`).
pub fn fit(episodes: &[Handle], source: &str, plan: Plan, done: impl Fn() + Sync) -> Result<Fitted> {
    ensure!(plan.stride > 0, "the stride must be at least 1");
    let samples = episodes.par_iter().map(|handle| {
        let sample = Sample::of(&handle.load()?, plan.stride).with_context(|| handle.name())?;
        done();
        Ok(sample)
    });
    from_samples(samples.collect::<Result<Vec<_>>>()?, source, plan)
}

fn from_samples(samples: Vec<Sample>, source: &str, plan: Plan) -> Result<Fitted> {
    let mut class_frames = [0; CLASSES];
    let mut clock: Vec<[u64; CLASSES]> = Vec::new();
    for sample in &samples {
        clock.resize(clock.len().max(sample.clock.len()), [0; CLASSES]);
        for (all, bin) in clock.iter_mut().zip(&sample.clock) {
            for class in 0..CLASSES {
                all[class] += bin[class];
                class_frames[class] += bin[class];
            }
        }
    }
    let frames: Vec<&Frame> = samples.iter().flat_map(|sample| &sample.frames).collect();
    let all_frames = class_frames.iter().sum();
    ensure!(frames.iter().any(|f| f.label == SLIP), "no slip among the training frames");
    ensure!(frames.iter().any(|f| f.label != SLIP), "nothing but slip among the training frames");

    let cut =
        |score: &dyn Fn(&Frame) -> f32| Cut::fit(frames.iter().map(|f| (score(f), *f)), plan.class_order);
    let fitted = Fitted {
        format: FORMAT,
        class_order: plan.class_order,
        data: DataUsed {
            source: source.to_owned(),
            split: "train".to_owned(),
            generator: format!("slipsense-synth {}", env!("CARGO_PKG_VERSION")),
            episodes: samples.len() as u64,
            frames: all_frames,
            stride: plan.stride as u64,
            frames_used: frames.len() as u64,
        },
        class_frames,
        entropy: cut(&|f| f.entropy),
        mfcc: fit_mfcc(&frames, plan.class_order)?,
        energy: cut(&|f| f.energy),
        flux_cusum: cut(&|f| f.flux_cusum),
        band_pass: cut(&|f| f.band_pass),
        logistic: fit_logistic(&frames, plan.class_order)?,
        clock,
        rig_only: fit_rig(&frames)?,
    };
    fitted.validate()?;
    Ok(fitted)
}

fn fit_mfcc(frames: &[&Frame], order: ClassOrder) -> Result<MfccFit> {
    let all: Vec<_> = frames.iter().flat_map(|f| f.mfcc.iter().copied()).collect();
    let scaling = Scaling::fit(&all);
    let of = |slip: bool| {
        let of_class = frames.iter().filter(|f| (f.label == SLIP) == slip);
        let samples: Vec<_> = of_class.flat_map(|f| f.mfcc.iter().map(|m| scaling.apply(m))).collect();
        Gaussian::fit(&samples)
    };
    let none = Cut { threshold: 0.0, std: 1.0 };
    let mut fit = MfccFit { slip: of(true)?, not_slip: of(false)?, scaling, cut: none };
    let ratio = crate::detectors::MfccRatio::new(&fit)?;
    let score = |f: &Frame| f.mfcc.iter().map(|m| ratio.of(m)).fold(f64::from(f32::MIN), f64::max) as f32;
    fit.cut = Cut::fit(frames.iter().map(|f| (score(f), *f)), order);
    Ok(fit)
}

fn fit_logistic(frames: &[&Frame], order: ClassOrder) -> Result<LogisticFit> {
    let raw: Vec<_> = frames.iter().map(|f| f.logistic).collect();
    let scaling = Scaling::fit(&raw);
    let z: Vec<_> = raw.iter().map(|x| scaling.apply(x)).collect();
    let slip: Vec<bool> = frames.iter().map(|f| f.label == SLIP).collect();
    let (weights, intercept) = irls::logistic(&z, &slip)?;
    let cut = Cut { threshold: 0.0, std: 1.0 };
    let mut fit = LogisticFit { scaling, weights: weights.to_vec(), intercept, cut };
    fit.cut = Cut::fit(frames.iter().map(|f| (fit.log_odds(&f.logistic) as f32, *f)), order);
    Ok(fit)
}

/// `None` if not every episode could be made again with only the rig heard.
fn fit_rig(frames: &[&Frame]) -> Result<Option<RigFit>> {
    let Some(heard) = frames.iter().map(|f| f.rig).collect::<Option<Vec<_>>>() else {
        return Ok(None);
    };
    let scaling = Scaling::fit(&heard);
    let terms: Vec<_> = heard.iter().map(|x| rig_terms(&scaling.apply(x))).collect();
    let odds = |of: &dyn Fn(&Frame) -> bool, is: u8| {
        let chosen = frames.iter().zip(&terms).filter(|(f, _)| of(f));
        let (terms, is): (Vec<_>, Vec<_>) = chosen.map(|(f, terms)| (*terms, f.label == is)).unzip();
        irls::logistic(&terms, &is).map(|(weights, intercept)| Odds { weights: weights.to_vec(), intercept })
    };
    let slip = odds(&|_| true, SLIP)?;
    let held = odds(&|f| f.label != SLIP, NO_SLIP)?;
    Ok(Some(RigFit { scaling, slip, held }))
}
