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

/// Is the cell of this index on the pad?
fn on_pad(index: usize) -> bool {
    use slipsense::params::TAXEL_COLS;
    slipsense::sensor::is_active(index / TAXEL_COLS, index % TAXEL_COLS)
}
