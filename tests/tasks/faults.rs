//! Sensors that fail, one fault per test: the flags that it raises and no others, nothing else lost, and how many
//! frames after its end the sensor is as if nothing had been.

use std::ops::Range;

use slipsense::health::{
    Condition, PIEZO_MISSING, TAXELS_MASKED, TAXELS_SATURATED, XL_CLIPPED, XL_MISSING, XL_SAMPLES_DROPPED,
    XL_WARMING_UP,
};
use slipsense::params::{COUNT_MAX, MAX_SENSORS};
use slipsense::sensor::{SensorReadings, TaxelMask};
use slipsense::tasks::Shared;
use slipsense::wire::{DEGRADED_FROZEN, RawMessage, SlipMessage, wire_logit};

use super::fault_plan::counts;
use super::world::{BATCH, Ran, World, healthy};

const FRAMES: u32 = 240;
/// The fault lasts this long.
const FAULT: Range<u32> = 60..120;
/// The sensor that fails; sensor 0 does not.
const FAULTY: usize = 1;
/// Frames until an accelerometer has filled a window of 128 samples.
const WARM_UP: u32 = 128 / BATCH + 1;

/// Run with this fault in sensor 1, and check all that has nothing to do with it.
fn with_fault(fault: impl Fn(u32, &mut SensorReadings)) -> Ran {
    let script = |sequence, parts: &mut [SensorReadings; MAX_SENSORS]| {
        healthy(sequence, parts);
        fault(sequence, &mut parts[FAULTY]);
    };
    // One raw message per frame has room at 8 Mbit/s.
    let ran = World { script: &script, ..World::new(FRAMES, 2) }.run();
    nothing_else(&ran, &World::new(FRAMES, 2).run());
    ran
}

/// Run with this fault in sensor 1 for [`FAULT`]: these flags are up during it, those behind it.
#[track_caller]
fn during(fault: fn(&mut SensorReadings), flags: u8, behind: (u32, u8)) -> Ran {
    let ran = with_fault(|sequence, part| {
        if FAULT.contains(&sequence) {
            fault(part);
        }
    });
    expect(&ran, FAULT, flags, behind);
    ran
}

fn nothing_else(ran: &Ran, without: &Ran) {
    assert_eq!(ran.slips.len() as u32, FRAMES, "every slip message arrives");
    assert_eq!((ran.status.late_frames, ran.status.dropped_frames, ran.status.bus_offs), (0, 0, 0));
    assert_eq!(ran.errors, 0);
    for (slip, healthy) in ran.slips.iter().zip(&without.slips) {
        assert_eq!(slip.contact[0], healthy.contact[0], "the other sensor, frame {}", slip.sequence);
        assert_eq!(slip.sequence, healthy.sequence);
    }
}

/// Health of the faulty sensor by frame, without what a start brings.
fn flags(ran: &Ran) -> Vec<u8> {
    let bits = |slip: &SlipMessage| slip.contact[FAULTY].health;
    let warming = |sequence: u32| if sequence < WARM_UP - 1 { XL_WARMING_UP } else { 0 };
    ran.slips.iter().map(|slip| bits(slip) & !warming(slip.sequence)).collect()
}

/// The flags that are up during the fault and behind it.
#[track_caller]
fn expect(ran: &Ran, fault: Range<u32>, during: u8, behind: (u32, u8)) {
    for (sequence, found) in (0..).zip(flags(ran)) {
        let expected = match sequence {
            n if fault.contains(&n) => during,
            n if (fault.end..fault.end + behind.0).contains(&n) => behind.1,
            _ => 0,
        };
        assert_eq!(found, expected, "frame {sequence}");
    }
    assert_eq!(ran.status.condition(), Condition::Nominal, "and it is over");
}

#[test]
fn a_dead_array() {
    let ran = during(|part| part.piezo_arrived = false, PIEZO_MISSING, (0, 0));
    let during = &ran.slips[70].contact[FAULTY];
    assert_eq!((during.sum, during.area), (0, 0));
    raw_goes_on(&ran);
}

/// What the other part gives is sent, every second time or more: two sensors are more than the bus carries.
fn raw_goes_on(ran: &Ran) {
    assert!(raw_during(ran) >= FAULT.len() / 2);
}

/// Raw messages of the faulty sensor during the fault.
fn raw_during(ran: &Ran) -> usize {
    let during = |raw: &&RawMessage| usize::from(raw.sensor) == FAULTY && FAULT.contains(&raw.sequence);
    ran.raw.iter().filter(during).count()
}

#[test]
fn a_dead_accelerometer() {
    let ran = during(|part| part.xl_arrived = false, XL_MISSING, (WARM_UP - 1, XL_WARMING_UP));
    raw_goes_on(&ran);
    let healthy = World::new(FRAMES, 2).run();
    for (slip, healthy) in ran.slips.iter().zip(&healthy.slips) {
        assert_eq!(slip.contact[FAULTY].sum, healthy.contact[FAULTY].sum, "its array goes on");
    }
}

#[test]
fn a_frozen_accelerometer() {
    let ran = with_fault(|_, part| part.xl.fill([7, -5, 2_000]));
    assert!(ran.slips.iter().skip(WARM_UP as usize).all(|slip| slip.degraded & DEGRADED_FROZEN != 0));
    assert_eq!((ran.status.frozen, ran.status.condition()), (true, Condition::Caution));
}

#[test]
fn a_dead_sensor() {
    let dead: fn(&mut SensorReadings) = |part| (part.piezo_arrived, part.xl_arrived) = (false, false);
    let ran = during(dead, PIEZO_MISSING | XL_MISSING, (WARM_UP - 1, XL_WARMING_UP));
    assert_eq!(raw_during(&ran), 0, "nothing to send");
}

#[test]
fn a_saturated_taxel_and_a_clipped_sample() {
    during(|part| full_scale(part, 16 * 32 + 16), TAXELS_SATURATED, (0, 0));
    during(|part| part.xl[5][1] = i16::MAX, XL_CLIPPED, (0, 0));
}

fn full_scale(part: &mut SensorReadings, taxel: usize) {
    counts(part, |index, count| if index == taxel { COUNT_MAX } else { count });
}

#[test]
fn a_stuck_taxel_is_masked() {
    let mask = |tick: u32| if FAULT.contains(&tick) { TaxelMask::NONE.with(10, 20) } else { TaxelMask::NONE };
    let stuck = |sequence: u32, parts: &mut [SensorReadings; MAX_SENSORS]| {
        healthy(0, parts);
        full_scale(&mut parts[FAULTY], 10 * 32 + 20);
        parts.iter_mut().for_each(|part| part.xl_end = (sequence + 1) * BATCH);
    };
    let set = |shared: &Shared<_>, tick: u32| {
        let mut controls = shared.config();
        controls.masks[FAULTY] = mask(tick);
        shared.set_config(controls);
    };
    let found = |sequence: u32, parts: &mut [SensorReadings; MAX_SENSORS]| {
        stuck(sequence, parts);
        // As the driver says it, one frame later than the setting.
        parts[FAULTY].stuck = mask(sequence + 1);
    };
    let without = World { script: &stuck, ..World::new(FRAMES, 2) }.run();
    is_masked(&World { script: &stuck, before_tick: &set, ..World::new(FRAMES, 2) }.run(), &without);
    is_masked(&World { script: &found, ..World::new(FRAMES, 2) }.run(), &without);
}

/// A mask of the settings and a taxel that the driver found stuck have the same effect.
fn is_masked(ran: &Ran, without: &Ran) {
    nothing_else(ran, without);
    let sum = without.slips[0].contact[FAULTY].sum;
    for (sequence, flags) in (0..).zip(flags(ran)) {
        let contact = ran.slips[sequence as usize].contact[FAULTY];
        // Set while the frame before waits for its decision.
        let masked = (TAXELS_MASKED, sum - u32::from(COUNT_MAX));
        let expected = if FAULT.contains(&(sequence + 1)) { masked } else { (TAXELS_SATURATED, sum) };
        assert_eq!((flags, contact.sum), expected);
    }
    if let Some(raw) = ran.raw.iter().find(|raw| usize::from(raw.sensor) == FAULTY && raw.sequence == 80) {
        assert_eq!((raw.piezo.counts()[10 * 32 + 20], raw.health), (0, TAXELS_MASKED));
    }
}

#[test]
fn missing_samples() {
    // A FIFO that overran: 7 samples are gone, the count goes on.
    let overrun = |sequence: u32, part: &mut SensorReadings| {
        if sequence >= FAULT.start {
            part.xl_end += 7;
        }
    };
    let ran = with_fault(overrun);
    // The tasks and the pipeline alone treat it alike, as does the Python package (tests/python/check_package.py).
    let script = |sequence, parts: &mut [SensorReadings; MAX_SENSORS]| {
        healthy(sequence, parts);
        overrun(sequence, &mut parts[FAULTY]);
    };
    let outputs = World { script: &script, ..World::new(FRAMES, 2) }.outputs();
    for (slip, output) in ran.slips.iter().zip(&outputs) {
        assert_eq!(slip.logits, output.logits.map(wire_logit), "frame {}", slip.sequence);
        assert_eq!(slip.contact.map(|contact| contact.health), output.health.map(|health| health.0));
    }
    let fault = FAULT.start..FAULT.start + 1;
    expect(&ran, fault, XL_SAMPLES_DROPPED | XL_WARMING_UP, (WARM_UP - 2, XL_WARMING_UP));
}

#[test]
fn samples_that_are_missing_while_the_part_is_silent_are_one_fault() {
    let ran = with_fault(|sequence, part| {
        part.xl_arrived = !FAULT.contains(&sequence);
        if sequence >= FAULT.start {
            part.xl_end += 500;
        }
    });
    expect(&ran, FAULT, XL_MISSING, (WARM_UP - 1, XL_WARMING_UP));
}

#[test]
fn all_parts_of_all_sensors_dead() {
    let script = |sequence, parts: &mut [SensorReadings; MAX_SENSORS]| {
        healthy(sequence, parts);
        parts.iter_mut().for_each(|part| (part.piezo_arrived, part.xl_arrived) = (false, false));
    };
    let ran = World { script: &script, ..World::new(FRAMES, 3) }.run();
    assert_eq!(ran.slips.len() as u32, FRAMES);
    let bits = PIEZO_MISSING | XL_MISSING;
    assert!(ran.slips.iter().all(|slip| slip.contact.iter().all(|contact| contact.health == bits)));
    assert_eq!((ran.raw.len(), ran.status.dropped_raw), (0, 0));
    assert_eq!(ran.status.condition(), Condition::Caution);
}
