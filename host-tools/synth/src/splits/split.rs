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
pub const GENERATOR_VERSION: u32 = 3;

/// Frames of the paper-sized set, all splits together (the paper: "more than 1.4 million").
pub const PAPER_FRAMES: usize = 1_400_000;

/// The enumeration from a table: variant, name, and the episodes of its frozen set.
macro_rules! splits {
    (@text $name:literal 0) => { None };
    (@text $name:literal $episodes:tt) => {
        Some(include_str!(concat!("../../frozen/", $name, ".json")))
    };
    ($($(#[$doc:meta])* $split:ident $name:literal $episodes:tt,)*) => {
        #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
        #[serde(rename_all = "snake_case")]
        pub enum Split { $($(#[$doc])* $split,)* }

        impl Split {
            pub const ALL: [Self; [$($name),*].len()] = [$(Self::$split),*];

            pub const fn name(self) -> &'static str {
                match self { $(Self::$split => $name,)* }
            }

            /// Episodes of the frozen set; 0 where none is frozen. Four in five slip, some of them twice
            /// (the protocol of `src/mix.rs`): 84 slips or more each in `umi_id` and `umi_ood` (the paper tests
            /// on 167 in all), more than 30 each in `palm`, `tesollo2` and `tesollo3`. `noslip` is one hour;
            /// nine in ten of `free` slip, three in five of the `transfer_` splits. `transfer_noslip` is half an hour.
            pub const fn frozen_episodes(self) -> usize {
                match self { $(Self::$split => $episodes,)* }
            }

            /// The manifest of the frozen set; none where none is frozen.
            pub(super) const fn manifest(self) -> Option<&'static str> {
                match self { $(Self::$split => splits!(@text $name $episodes),)* }
            }
        }
    };
}

splits! {
    /// Training: training objects on the hand-held gripper.
    Train "train" 0,
    /// Operating points are chosen here: objects of its own, neither trained on nor tested on.
    Val "val" 32,
    /// Test: training objects, new grasps.
    UmiId "umi_id" 88,
    /// Test: objects never trained on.
    UmiOod "umi_ood" 88,
    /// The episodes of `umi_id` and `umi_ood` in turn, without the crosshead's vibration.
    UmiQuiet "umi_quiet" 176,
    /// Test: objects never trained on, held towards the palm.
    Palm "palm" 32,
    /// Test: another hand with two fingers, objects never trained on.
    Tesollo2 "tesollo2" 32,
    /// The same with three fingers.
    Tesollo3 "tesollo3" 32,
    /// Test: long episodes of everything but slip, on all hands, for false alarms per hour.
    Noslip "noslip" 60,
    /// Test: away from the rig. Pulls by hand all ways in the pad's plane, and twists; objects never trained on.
    Free "free" 80,
    /// Training beside `train`: pulls on the rig and by hand, twists, carrying; both hands, families that training may see.
    TrainAnywhere "train_anywhere" 0,
    /// The same of the objects of `val`.
    ValAnywhere "val_anywhere" 32,
    /// Test: pulls on the rig and by hand, twists, carrying; both hands, families of physics that training may see.
    TransferKnown "transfer_known" 27,
    /// The same with the held-out family of one stage: contact.
    TransferContact "transfer_contact" 27,
    TransferFriction "transfer_friction" 27,
    TransferFilm "transfer_film" 27,
    TransferSource "transfer_source" 27,
    TransferPath "transfer_path" 27,
    TransferDisturbance "transfer_disturbance" 27,
    TransferSensor "transfer_sensor" 27,
    /// The held-out families of all stages at once.
    TransferAll "transfer_all" 54,
    /// Test: half an hour of everything but slip, in the held-out families of all stages, for false alarms per hour.
    TransferNoslip "transfer_noslip" 30,
}

impl Split {
    /// The splits of the paper-sized set; `umi_quiet` only repeats two of them, and the paper has no `free`.
    pub const PAPER: [Self; 8] = {
        use Split::*;
        [Train, Val, UmiId, UmiOod, Palm, Tesollo2, Tesollo3, Noslip]
    };

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

    /// Neither trained on nor chosen on: its arrays are older than those of training.
    pub const fn is_test(self) -> bool {
        !matches!(self, Self::Train | Self::Val | Self::TrainAnywhere | Self::ValAnywhere)
    }

    /// Episodes in the paper-sized set: the frozen ones, of `noslip` three minutes; 0 for `train`, which gets the rest.
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
