//! Recordings: episodes, labels and predictions, candump logs, model files, the pressure that a count stands for; with the
//! feature `links` also MCAP, the links to a bus, and the descriptions of the slip message for DBC and C.
//!
//! An episode is a recorded or generated stretch of sensor data, a NumPy `.npz` archive that anyone can write with
//! `numpy.savez`:
//!
//! | array | dtype, shape | meaning |
//! |---|---|---|
//! | `piezo` | uint16 \[F, S, 32, 32\] | ADC counts 0–4095; taxels off the pad are 0 |
//! | `xl` | int16 \[S, N, 3\] | accelerometer samples x, y, z, LSB |
//! | `xl_end` | uint32 \[F, S\] | samples of `xl[s]` available at the frame tick, non-decreasing |
//! | `label` | uint8 \[F\], optional | 0 no contact, 1 no slip, 2 slip |
//! | `slip_true` | float32 \[F\], optional | interface slip speed, mm/s |
//! | `slip_fraction` | float32 \[F\], optional | share of the load that slips, 0–1 |
//! | `displacement_mm` | float32 \[F\], optional | crosshead encoder, mm |
//! | `meta` | uint8, UTF-8 JSON | `xl_lsb_g`, `xl_rate_hz`, `frame_rate_hz`, and what else is known |
//!
//! F frames at 240 Hz, S sensors (1 to 3), N accelerometer samples. Arrays of other names are ignored.
//! What breaks a rule is refused with the array, the index and the rule named.

#[cfg(feature = "links")]
pub mod c_header;
pub mod candump;
#[cfg(feature = "links")]
pub mod client;
#[cfg(feature = "links")]
pub mod dbc;
#[cfg(feature = "links")]
pub mod decode;
mod episode;
mod episode_file;
mod error;
pub mod film;
#[cfg(feature = "links")]
pub mod firmware_elf;
mod health;
mod mel;
pub mod label;
#[cfg(feature = "links")]
pub mod layout;
#[cfg(feature = "links")]
pub mod link;
#[cfg(feature = "links")]
pub mod log_file;
#[cfg(feature = "links")]
pub mod mcap_file;
mod meta;
pub mod model_file;
pub mod npz;
mod predictions;
#[cfg(feature = "links")]
pub mod rebuild;
#[cfg(feature = "links")]
pub mod recorder;
#[cfg(feature = "links")]
mod recording;
pub mod score;
pub mod threshold;
#[cfg(feature = "links")]
pub mod slcan;
mod whole_file;

pub use episode::Episode;
pub use episode_file::EpisodeReader;
pub use error::{EpisodeError, Problem};
pub use health::{DEGRADED, HEALTH, INVALID, words};
pub use mel::mel_point_hz;
pub use meta::{Meta, XL_RATE_TOLERANCE};
pub use predictions::{Predictions, logmel_g2, logmel_std};
pub use whole_file::write_whole;

/// Bytes in hexadecimal, two small digits each.
pub fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

/// 32 bytes of 64 hexadecimal digits.
pub fn from_hex(text: &str) -> Option<[u8; 32]> {
    let mut bytes = [0; 32];
    unhex(text.as_bytes(), &mut bytes)?;
    Some(bytes)
}

/// Fill `bytes` from hexadecimal digits, two each. `None`: they are others, or not as many.
pub(crate) fn unhex(digits: &[u8], bytes: &mut [u8]) -> Option<()> {
    let nibble = |digit: u8| char::from(digit).to_digit(16);
    let (pairs, []) = digits.as_chunks() else { return None };
    (pairs.len() == bytes.len()).then_some(())?;
    for (byte, &[high, low]) in bytes.iter_mut().zip(pairs) {
        *byte = (nibble(high)? << 4 | nibble(low)?) as u8;
    }
    Some(())
}
