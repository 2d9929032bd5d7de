//! What a board says about its updates without being asked: on the bus, and in its log.

use core::fmt;

use super::Refusal;
use super::image::ImageVersion;
use super::key::KEY_NOTICE;
use super::model_slot::SlotModel;
use super::state::Run;
use crate::node::{Severity, UpdateTarget};

/// A line.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Notice {
    /// [`KEY_NOTICE`].
    DevelopmentKey,
    /// The firmware that runs, and how it came to.
    Firmware(ImageVersion, Run),
    /// The firmware that runs, and why no other is taken over the bus.
    FirmwareStays(ImageVersion, Refusal),
    /// The model that runs.
    Model(SlotModel),
    /// What runs has confirmed: nothing older is taken any more.
    Confirmed(UpdateTarget, ImageVersion),
    /// It could not, because of the flash.
    NotConfirmed(UpdateTarget, ImageVersion),
}

impl Notice {
    /// How much it matters.
    pub const fn severity(self) -> Severity {
        match self {
            Self::Firmware(_, Run::Confirmed)
            | Self::Model(SlotModel::Slot(_) | SlotModel::BuiltIn(Refusal::Blank)) => Severity::Info,
            Self::DevelopmentKey
            | Self::Firmware(_, Run::Pending | Run::OnTrial)
            | Self::FirmwareStays(..)
            | Self::Confirmed(..) => Severity::Notice,
            Self::Firmware(_, Run::RolledBack) | Self::Model(SlotModel::BuiltIn(_)) => Severity::Warning,
            Self::NotConfirmed(..) => Severity::Error,
        }
    }
}

impl fmt::Display for Notice {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::DevelopmentKey => f.write_str(KEY_NOTICE.unwrap_or("")),
            Self::Firmware(version, run) => {
                let how = match run {
                    Run::Confirmed => "confirmed",
                    Run::Pending => "confirmed, and a new one waits for a restart",
                    Run::OnTrial => "on trial: a restart before it confirms brings back the one before",
                    Run::RolledBack => "back: the one after it did not confirm",
                };
                write!(f, "firmware {version}, {how}")
            }
            Self::FirmwareStays(version, why) => write!(f, "firmware {version}; no update of it: {why}"),
            Self::Model(model) => model.fmt(f),
            Self::Confirmed(target, version) => write!(f, "{} {version} has confirmed", target.name()),
            Self::NotConfirmed(target, version) => {
                write!(f, "{} {version} cannot confirm: {}", target.name(), Refusal::Flash)
            }
        }
    }
}
