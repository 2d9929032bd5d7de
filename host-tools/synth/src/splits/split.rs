//! The splits of the benchmark and their sizes.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

use crate::families::Stage;

#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct SetError(String);

impl SetError {
    pub(crate) fn new(rule: impl Into<String>) -> Self {
        Self(rule.into())
    }
}

/// Version of what the generator makes: raised with every change that changes the content of an episode.
/// Sets of different versions do not mix; the frozen test sets show a change that was not declared.
pub const GENERATOR_VERSION: u32 = 1;

/// Frames of the paper-sized set, all splits together (the paper: "more than 1.4 million").
pub const PAPER_FRAMES: usize = 1_400_000;

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Split {
    /// Training: training objects on the hand-held gripper.
    Train,
    /// Operating points are chosen here: objects of its own, neither trained on nor tested on.
    Val,
    /// Test: training objects, new grasps.
    UmiId,
    /// Test: objects never trained on.
    UmiOod,
    /// The episodes of `umi_id` and `umi_ood` in turn, without the crosshead's vibration.
    UmiQuiet,
    /// Test: objects never trained on, held towards the palm.
    Palm,
    /// Test: another hand with two fingers; objects trained on and never trained on in turn.
    Tesollo2,
    /// Test: another hand with three fingers; objects as in `tesollo2`.
    Tesollo3,
    /// Test: long episodes of everything but slip, on all hands, for false alarms per hour.
    Noslip,
    /// Test: away from the rig. Slips pulled by hand in all directions of the pad's plane, and twists; objects as
    /// in `tesollo2`.
    Free,
    /// Training beside `train`: pulls on the rig and by hand, twists, and carrying, on both hands, in families of physics
    /// that training may see.
    TrainAnywhere,
    /// The same of the objects of `val`.
    ValAnywhere,
    /// Test: pulls on the rig and by hand, twists, and carrying, on both hands, in families of physics that training
    /// may see.
    TransferKnown,
    /// The same with the held-out family of one stage: contact.
    TransferContact,
    TransferFriction,
    TransferFilm,
    TransferSource,
    TransferPath,
    TransferDisturbance,
    TransferSensor,
    /// The held-out families of all stages at once.
    TransferAll,
    /// Test: half an hour of everything but slip, in the held-out families of all stages, for false alarms per hour.
    TransferNoslip,
}

impl Split {
    pub const ALL: [Self; 22] = {
        use Split::*;
        [
            Train,
            Val,
            UmiId,
            UmiOod,
            UmiQuiet,
            Palm,
            Tesollo2,
            Tesollo3,
            Noslip,
            Free,
            TrainAnywhere,
            ValAnywhere,
            TransferKnown,
            TransferContact,
            TransferFriction,
            TransferFilm,
            TransferSource,
            TransferPath,
            TransferDisturbance,
            TransferSensor,
            TransferAll,
            TransferNoslip,
        ]
    };

    /// The splits of the paper-sized set; `umi_quiet` only repeats two of them, and the paper has no `free`.
    pub const PAPER: [Self; 8] = {
        use Split::*;
        [Train, Val, UmiId, UmiOod, Palm, Tesollo2, Tesollo3, Noslip]
    };

    pub const fn name(self) -> &'static str {
        match self {
            Self::Train => "train",
            Self::Val => "val",
            Self::UmiId => "umi_id",
            Self::UmiOod => "umi_ood",
            Self::UmiQuiet => "umi_quiet",
            Self::Palm => "palm",
            Self::Tesollo2 => "tesollo2",
            Self::Tesollo3 => "tesollo3",
            Self::Noslip => "noslip",
            Self::Free => "free",
            Self::TrainAnywhere => "train_anywhere",
            Self::ValAnywhere => "val_anywhere",
            Self::TransferKnown => "transfer_known",
            Self::TransferContact => "transfer_contact",
            Self::TransferFriction => "transfer_friction",
            Self::TransferFilm => "transfer_film",
            Self::TransferSource => "transfer_source",
            Self::TransferPath => "transfer_path",
            Self::TransferDisturbance => "transfer_disturbance",
            Self::TransferSensor => "transfer_sensor",
            Self::TransferAll => "transfer_all",
            Self::TransferNoslip => "transfer_noslip",
        }
    }

    /// The stages whose held-out families it has; `None` where the laboratory's families make it.
    pub const fn held_out_stages(self) -> Option<&'static [Stage]> {
        Some(match self {
            Self::TrainAnywhere | Self::ValAnywhere | Self::TransferKnown => &[],
            Self::TransferContact => &[Stage::Contact],
            Self::TransferFriction => &[Stage::Friction],
            Self::TransferFilm => &[Stage::Film],
            Self::TransferSource => &[Stage::Source],
            Self::TransferPath => &[Stage::Path],
            Self::TransferDisturbance => &[Stage::Disturbance],
            Self::TransferSensor => &[Stage::Sensor],
            Self::TransferAll | Self::TransferNoslip => &Stage::ALL,
            _ => return None,
        })
    }

    /// Episodes of the frozen set; 0 where none is frozen. Four in five slip, some of them twice
    /// (the protocol of `src/mix.rs`): 84 slips or more each in `umi_id` and `umi_ood` (the paper tests
    /// on 167 in all), more than 30 each in the transfer splits. `noslip` is one hour;
    /// nine in ten of `free` slip, four in five of the transfer splits. `transfer_noslip` is half an hour.
    pub const fn frozen_episodes(self) -> usize {
        match self {
            Self::Train | Self::TrainAnywhere => 0,
            Self::Val | Self::ValAnywhere => 32,
            Self::UmiId | Self::UmiOod => 88,
            Self::UmiQuiet => 176,
            Self::Palm | Self::Tesollo2 | Self::Tesollo3 => 32,
            Self::Noslip => 60,
            Self::Free => 80,
            Self::TransferAll => 40,
            Self::TransferNoslip => 30,
            _ => 20,
        }
    }

    /// Episodes in the paper-sized set: the frozen ones, but only three minutes of `noslip`; 0 for
    /// `train`, which gets the frames that are left.
    pub const fn paper_episodes(self) -> usize {
        match self {
            Self::Noslip => 3,
            Self::UmiQuiet | Self::Free => 0,
            other if other.held_out_stages().is_some() => 0,
            other => other.frozen_episodes(),
        }
    }
}

impl fmt::Display for Split {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}

impl FromStr for Split {
    type Err = SetError;

    fn from_str(name: &str) -> Result<Self, SetError> {
        Self::ALL.into_iter().find(|split| split.name() == name).ok_or_else(|| {
            let names = Self::ALL.map(Self::name).join(", ");
            SetError::new(format!("\"{name}\" is not a split ({names})"))
        })
    }
}
