//! Bits of a sensor's health in words.

use slipsense::health;

pub const HEALTH: [(u8, &str); 8] = [
    (health::PIEZO_MISSING, "array missing"),
    (health::XL_MISSING, "accelerometer missing"),
    (health::XL_WARMING_UP, "accelerometer warming up"),
    (health::XL_CLIPPED, "accelerometer clipped"),
    (health::TAXELS_SATURATED, "taxels saturated"),
    (health::XL_SAMPLES_DROPPED, "accelerometer samples dropped"),
    (health::NO_MODEL, "no model"),
    (health::TAXELS_MASKED, "taxels masked"),
];

/// The words of the bits that are set, or `ok`.
pub fn words(table: &[(u8, &str)], bits: u8) -> String {
    let set: Vec<_> = table.iter().filter(|(bit, _)| bits & bit != 0).map(|&(_, name)| name).collect();
    if set.is_empty() { "ok".to_owned() } else { set.join(", ") }
}
