//! The detectors that are compared, by name.

pub(crate) mod network;
#[cfg(feature = "float")]
mod float;
pub(crate) mod paper;
pub(crate) mod idle;
pub(crate) mod limits;

use std::path::Path;

use anyhow::{Context, Result, bail};
use slipsense_synth::VibrationContent;

use crate::detector::{Detector, thresholded};
use crate::fitted::Fitted;

pub use network::Modality;
use paper::{both, entropy, mfcc_qda};

/// The integer network, the one that ships.
pub const NETWORK: &str = "network";
/// The float network that it is made from and compared with.
pub const FLOAT: &str = "float";
pub const NETWORK_ALARM: &str = "network-alarm";

#[derive(Clone, Copy, Debug)]
pub struct Setup<'a> {
    /// Thresholds and tables fitted on the training split.
    pub fitted: &'a Fitted,
    pub model: &'a [u8],
    /// Weights file of the float network, needed for `float` only.
    pub float_weights: Option<&'a Path>,
    /// What is dead in all sensors, for `network` and `network-alarm` only.
    pub dead: Option<Modality>,
}

/// Names on the command line with what they are, in the order of the report.
pub const DETECTORS: [(&str, &str); 13] = [
    (NETWORK, "the firmware's pipeline, integers, by its classes"),
    (NETWORK_ALARM, "the same by its alarm, at the model's operating point"),
    (FLOAT, "the network before quantization, run by tract (needs the feature `train`)"),
    ("entropy", "entropy of the pressure changes; the paper's piezo baseline"),
    ("mfcc-qda", "13 MFCC with quadratic discriminants; the paper's accelerometer baseline"),
    ("entropy-and-mfcc", "slip where both are above their thresholds; the paper's baseline of both sensors"),
    ("majority", "always the most frequent class"),
    ("always-slip", "slip whenever something is held"),
    ("clock", "knows the time since the episode began, nothing else"),
    ("rig-only", "classifies the vibration of the test rig's drive, nothing else"),
    ("idle-noise", "classifies the noise of untouched fingers, nothing else"),
    ("oracle", "true slip at the interface"),
    ("oracle-label", "the encoder label itself: the ceiling of every figure"),
];

pub fn by_name<'a>(name: &str, setup: &Setup<'a>) -> Result<Detector<'a>> {
    let fitted = setup.fitted;
    let (cutoffs, order) = ([fitted.entropy, fitted.mfcc.cut], fitted.class_order);
    Ok(match name {
        NETWORK => network::network(setup.model, setup.dead)?,
        NETWORK_ALARM => network::network_alarm(setup.model, setup.dead)?,
        #[cfg(feature = "float")]
        FLOAT => float::float(setup.float_weights)?,
        #[cfg(not(feature = "float"))]
        FLOAT => bail!("{FLOAT} is not in this build; build with `--features train`"),
        "entropy" => thresholded(entropy(), cutoffs[0].threshold, order),
        "mfcc-qda" => thresholded(mfcc_qda(&fitted.mfcc)?, cutoffs[1].threshold, order),
        "entropy-and-mfcc" => {
            let (mut piezo, mut xl) = (entropy(), mfcc_qda(&fitted.mfcc)?);
            let score = move |episode: &_, frame| both([piezo(episode, frame), xl(episode, frame)], cutoffs);
            thresholded(score, 0.0, order)
        }
        "majority" => Box::new(|episode| Ok(limits::majority(episode, fitted.class_frames))),
        "always-slip" => Box::new(|episode| Ok(limits::always_slip(episode))),
        "clock" => {
            let clock = limits::Clock::new(&fitted.clock, fitted.class_frames);
            Box::new(move |episode| Ok(clock.predict(episode)))
        }
        "rig-only" => idle::idle(fitted.rig_only.as_ref(), VibrationContent::RigOnly).context("rig-only")?,
        "idle-noise" => {
            idle::idle(fitted.idle_noise.as_ref(), VibrationContent::IdleNoise).context("idle-noise")?
        }
        "oracle" => Box::new(limits::oracle),
        "oracle-label" => Box::new(limits::oracle_label),
        _ => {
            let names = DETECTORS.map(|(name, _)| name).join(", ");
            bail!("no detector is called \"{name}\"; there are: {names}")
        }
    })
}
