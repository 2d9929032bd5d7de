//! The library's host tests, one binary: `cargo test -p slipsense --test host FOLDER::` runs those of a folder.

mod bringup;
mod drivers;
mod features;
mod features_exact;
mod network;
mod node;
mod piezo;
mod sensor;
mod settings;
mod tasks;
mod transfer;
mod update;
mod wire;

use slipsense::settings::{NODE_ID_UNSET, Setting, Settings};

/// The defaults but for these.
fn settings(values: &[(Setting, &[i64])]) -> Settings {
    let mut settings = Settings::new();
    values.iter().for_each(|(setting, elements)| _ = settings.set(*setting, elements).unwrap());
    settings
}

/// Of a node that has no address and asks for none.
fn nameless() -> Settings {
    settings(&[(Setting::NodeId, &[NODE_ID_UNSET]), (Setting::PlugAndPlay, &[0])])
}

/// The check value of a CAN transfer, CRC-16/CCITT-FALSE bit by bit.
fn crc(bytes: &[u8]) -> u16 {
    let bits = bytes.iter().flat_map(|byte| (0..8).rev().map(move |bit| u16::from(byte >> bit & 1)));
    bits.fold(0xFFFF, |crc, bit| crc << 1 ^ ((crc >> 15 ^ bit) * 0x1021))
}

/// Is the cell of this index on the pad?
fn on_pad(index: usize) -> bool {
    use slipsense::params::TAXEL_COLS;
    slipsense::sensor::is_active(index / TAXEL_COLS, index % TAXEL_COLS)
}
