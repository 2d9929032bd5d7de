//! Thresholds, class densities and tables of the detectors, fitted on the training splits and nothing else:
//! the paper's baselines on `train`, the detectors that must find no shortcut on `train_anywhere`, too.
//!
//! One pass over the episodes, in parallel, keeps scores and features of every [`Plan::stride`]th frame;
//! everything is then fitted on those, in the order of the episodes, so that the same episodes give the
//! same file. Class shares and the clock count every frame. Detectors start anew with each episode here,
//! which touches the first 16 ms of each.

pub(crate) mod logistic_regression;
mod sample;
mod youden;

use anyhow::{Context, Result, ensure};
use rayon::prelude::*;
use slipsense::params::CLASSES;
use slipsense_recording::score::SLIP;
use slipsense_synth::labels::NO_SLIP;

use crate::detector::{ClassOrder, NEVER};
use crate::detectors::idle;
use crate::fitted::{Cutoff, DataUsed, FORMAT, Fitted, IDLE_FEATURES, IdleFit, MfccFit};
use crate::gaussian::{Gaussian, Scaling};
use crate::source::Handle;
use logistic_regression::logistic_regression;
use sample::{Frame, Sample};
use youden::youden;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Plan {
    /// Of how many frames one is used, at least 1. From 4 on the analysis windows share no sample: of a million training
    /// frames that leaves a quarter of a million, far more than any fit here has numbers.
    pub stride: usize,
    /// Which rule makes the classes first.
    pub class_order: ClassOrder,
}

/// Fit everything on these episodes of the laboratory, and `clock`, `rig-only` and `idle-noise` on those of
/// other families (`anywhere`), too; loaded on all cores and in any order, few at a time. `source` says
/// where they come from; `done` is called after each.
///
/// Refuses an episode that is not of the training split: one whose meta says `split` must say `train`, one
/// that does not must not be of a held-out object (`held_out`).
pub fn fit(
    laboratory: &[Handle],
    anywhere: &[Handle],
    source: &str,
    plan: Plan,
    done: impl Fn() + Sync,
) -> Result<Fitted> {
    ensure!(plan.stride > 0, "the stride must be at least 1");
    let episodes: Vec<_> = laboratory.iter().chain(anywhere).enumerate().collect();
    let samples = episodes.into_par_iter().map(|(n, handle)| {
        let of_laboratory = n < laboratory.len();
        let sample =
            Sample::new(&handle.load()?, of_laboratory, plan.stride).with_context(|| handle.name())?;
        done();
        Ok(sample)
    });
    let samples = samples.collect::<Result<Vec<_>>>()?;
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
    let baseline: Vec<&Frame> = frames.iter().copied().filter(|frame| frame.laboratory).collect();
    let all_frames = class_frames.iter().sum();
    ensure!(baseline.iter().any(|f| f.label == SLIP), "no slip among the training frames");
    ensure!(baseline.iter().any(|f| f.label != SLIP), "nothing but slip among the training frames");

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
        entropy: fit_cutoff(&baseline, &|f| f.entropy, plan.class_order),
        mfcc: fit_mfcc(&baseline, plan.class_order)?,
        clock,
        rig_only: fit_idle(&frames, &|f| f.rig)?,
        idle_noise: fit_idle(&frames, &|f| f.noise)?,
    };
    fitted.validate()?;
    Ok(fitted)
}

/// The threshold with the largest Youden index, and the score's standard deviation.
fn fit_cutoff(frames: &[&Frame], score: &dyn Fn(&Frame) -> f32, order: ClassOrder) -> Cutoff {
    let scores: Vec<f32> = frames.iter().map(|frame| score(frame)).collect();
    let n = frames.len().max(1) as f64;
    let mean = scores.iter().map(|&score| f64::from(score)).sum::<f64>() / n;
    let variance = scores.iter().map(|&score| (f64::from(score) - mean).powi(2)).sum::<f64>() / n;
    let labelled = |(&score, frame): (&f32, &&Frame)| {
        let ruled_out = order == ClassOrder::ContactFirst && !frame.touched;
        (if ruled_out { NEVER } else { score }, frame.label == SLIP)
    };
    let mut labelled: Vec<_> = scores.iter().zip(frames).map(labelled).collect();
    let threshold = youden(&mut labelled).map_or(f32::MAX, |(threshold, _)| threshold);
    Cutoff { threshold, std: if variance > 0.0 { variance.sqrt() as f32 } else { 1.0 } }
}

fn fit_mfcc(frames: &[&Frame], order: ClassOrder) -> Result<MfccFit> {
    let all: Vec<_> = frames.iter().flat_map(|f| f.mfcc.iter().copied()).collect();
    let scaling = Scaling::fit(&all);
    let gaussian = |slip: bool| {
        let class = frames.iter().filter(|f| (f.label == SLIP) == slip);
        let samples: Vec<_> = class.flat_map(|f| f.mfcc.iter().map(|m| scaling.apply(m))).collect();
        Gaussian::fit(&samples)
    };
    let none = Cutoff { threshold: 0.0, std: 1.0 };
    let mut fit = MfccFit { slip: gaussian(true)?, not_slip: gaussian(false)?, scaling, cut: none };
    let ratio = fit.ratio()?;
    let score = |f: &Frame| f.mfcc.iter().map(|m| ratio.ln(m)).fold(f64::from(f32::MIN), f64::max) as f32;
    fit.cut = fit_cutoff(frames, &score, order);
    Ok(fit)
}

/// Features of one frame, `None` without a recipe.
type Features<'a> = &'a dyn Fn(&Frame) -> Option<[f64; IDLE_FEATURES]>;

/// `None` if not every episode has a recipe.
fn fit_idle(frames: &[&Frame], of: Features) -> Result<Option<IdleFit>> {
    let Some(features) = frames.iter().map(|f| of(f)).collect::<Option<Vec<_>>>() else {
        return Ok(None);
    };
    let scaling = Scaling::fit(&features);
    let terms: Vec<_> = features.iter().map(|x| idle::terms(&scaling.apply(x))).collect();
    let odds = |chosen: &dyn Fn(&Frame) -> bool, class: u8| {
        let chosen = frames.iter().zip(&terms).filter(|(f, _)| chosen(f));
        let (terms, positive): (Vec<_>, Vec<_>) = chosen.map(|(f, terms)| (*terms, f.label == class)).unzip();
        logistic_regression(&terms, &positive)
    };
    let slip = odds(&|_| true, SLIP)?;
    let held = odds(&|f| f.label != SLIP, NO_SLIP)?;
    Ok(Some(IdleFit { scaling, slip, held }))
}
