//! Bits of a sensor's health, and why a slip message must not be believed or is worse than usual, in words.

use slipsense::health;
use slipsense::wire::{
    DEGRADED_FROZEN, DEGRADED_LATE, DEGRADED_MISSING, DEGRADED_NOT_CALIBRATED, DEGRADED_POINT,
    DEGRADED_SELF_TEST, INVALID_MEMORY, INVALID_NETWORK, INVALID_NO_MODEL, INVALID_NO_SENSOR,
    INVALID_OTHER_MODEL, INVALID_STARTING,
};

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

pub const INVALID: [(u8, &str); 6] = [
    (INVALID_NO_MODEL, "no model"),
    (INVALID_STARTING, "starting"),
    (INVALID_NO_SENSOR, "no sensor"),
    (INVALID_MEMORY, "memory check failed"),
    (INVALID_NETWORK, "network check failed"),
    (INVALID_OTHER_MODEL, "not the expected model"),
];
pub const DEGRADED: [(u8, &str); 6] = [
    (DEGRADED_MISSING, "a sensor is missing"),
    (DEGRADED_FROZEN, "an accelerometer is frozen"),
    (DEGRADED_NOT_CALIBRATED, "an array is not calibrated"),
    (DEGRADED_POINT, "operating point by setting"),
    (DEGRADED_LATE, "late decisions"),
    (DEGRADED_SELF_TEST, "a self test failed"),
];

/// The words of the bits that are set, or `ok`.
pub fn words(table: &[(u8, &str)], bits: u8) -> String {
    let set: Vec<_> = table.iter().filter(|(bit, _)| bits & bit != 0).map(|&(_, name)| name).collect();
    if set.is_empty() { "ok".to_owned() } else { set.join(", ") }
}
