//! Updates: a firmware or a model that comes over the bus, is accepted only if it is signed, and is used only if it
//! is whole.
//!
//! ```text
//!  slipsense sign ─> file ─> node's file client ─> UpdateSink ─> flash: DFU or model slot ─> read back, hash
//!                                                     │ header: signature, kind, board, version, length, in this
//!                                                     └ order, before anything is erased
//!  firmware: DFU + state "swap" ─ restart ─> bootloader: check, swap ─> trial ─ Trial::observe ─> confirm
//!                                                 └── not confirmed: swap back at the next restart
//!  model:    slot ─ restart ─> ModelSlot::load, else the model in the firmware
//! ```
//!
//! A firmware is swapped by the crate `embassy-boot`, with the state that it keeps in a sector of its own; what its
//! state and slots hold after a power cut at any step, `tests/update` tries. A model has one slot, because the
//! firmware carries another one that takes its place: while a model is on its way, and when one was cut off.
//!
//! **What is refused, and why**, [`Refusal`] names; the same words go onto the bus. **An older image**: the version of
//! a firmware may not be below that of the one that runs, nor the version of a model below that of the model in the
//! slot, nor below the newest that has confirmed, which is stored with the settings and outlives a slot that was cut off
//! half way. A firmware and a model confirm by the same [`Trial`]. The same version may come again, but not the image that runs or waits for the restart. Rolling back a firmware that did not confirm is no update and always works.

pub mod boot;
mod image;
mod installed;
mod key;
mod model_slot;
mod notice;
pub mod partitions;
mod refusal;
mod sink;
mod slot;
mod state;

pub use image::{FORMAT_VERSION, HEADER_BYTES, Header, ImageVersion, MAGIC, SIGNED_BYTES, VersionError};
pub use installed::{find_bootloader, running_header};
pub use key::{
    DEVELOPMENT_KEY, DEVELOPMENT_SEED, IS_DEVELOPMENT_KEY, KEY_NOTICE, Keys, PUBLIC_KEYS, unlocks,
};
pub use model_slot::{ModelSlot, SlotModel};
pub use notice::Notice;
pub use refusal::Refusal;
pub use sink::{FirmwareSlot, UpdateSink};
pub use slot::PayloadHash;
pub use state::{CONFIRM_FRAMES, CONFIRM_HEARTBEATS, Evidence, Run, Trial, UpdateState};
