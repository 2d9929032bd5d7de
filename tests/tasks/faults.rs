//! Sensors that fail, one fault per test: the flags that it raises and no others, nothing else lost, and how many
//! frames after its end the sensor is as if nothing had been.

use std::ops::Range;

use slipsense::health::Condition;
use slipsense::health::{
    PIEZO_MISSING, TAXELS_MASKED, TAXELS_SATURATED, XL_CLIPPED, XL_MISSING, XL_SAMPLES_DROPPED, XL_WARMING_UP,
};
use slipsense::params::{COUNT_MAX, MAX_SENSORS, TAXELS};
use slipsense::sensor::SensorReadings;
use slipsense::sensor::{PiezoFrame, TaxelMask};
use slipsense::wire::{DEGRADED_FROZEN, RawMessage, wire_logit};

use super::world::{BATCH, Ran, World, healthy, scan};

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
    let mut world = World::new(FRAMES, 2);
    // One raw message per frame has room at 8 Mbit/s.
    world.script = &script;
    let ran = world.run();
    let without = World::new(FRAMES, 2).run();
    nothing_else(&ran, &without);
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
    let bits = |slip: &slipsense::wire::SlipMessage| slip.contact[FAULTY].health;
    let warming = |sequence: u32| if sequence < WARM_UP - 1 { XL_WARMING_UP } else { 0 };
    ran.slips.iter().map(|slip| bits(slip) & !warming(slip.sequence)).collect()
}

/// The flags that are up during the fault and behind it.
fn expect(ran: &Ran, name: &str, fault: Range<u32>, during: u8, behind: (u32, u8)) {
    for (sequence, found) in (0..).zip(flags(ran)) {
        let expected = match sequence {
            n if fault.contains(&n) => during,
            n if (fault.end..fault.end + behind.0).contains(&n) => behind.1,
            _ => 0,
        };
        assert_eq!(found, expected, "{name}, frame {sequence}");
    }
    assert_eq!(ran.status.condition(), Condition::Nominal, "and it is over");
}

#[test]
fn a_dead_array() {
    let ran = with_fault(|sequence, part| part.piezo_arrived = !FAULT.contains(&sequence));
    expect(&ran, "dead array", FAULT, PIEZO_MISSING, (0, 0));
    let during = &ran.slips[70].contact[FAULTY];
    assert_eq!((during.sum, during.area), (0, 0));
    raw_goes_on(&ran);
}

/// What the other part gives is sent, every second time or more: two sensors are more than the bus carries.
fn raw_goes_on(ran: &Ran) {
    let during = |raw: &&RawMessage| usize::from(raw.sensor) == FAULTY && FAULT.contains(&raw.sequence);
    assert!(ran.raw.iter().filter(during).count() as u32 >= (FAULT.end - FAULT.start) / 2);
}

#[test]
fn a_dead_accelerometer() {
    let ran = with_fault(|sequence, part| part.xl_arrived = !FAULT.contains(&sequence));
    raw_goes_on(&ran);
    expect(&ran, "dead accelerometer", FAULT, XL_MISSING, (WARM_UP - 1, XL_WARMING_UP));
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
    let ran = with_fault(|sequence, part| {
        part.piezo_arrived = !FAULT.contains(&sequence);
        part.xl_arrived = part.piezo_arrived;
    });
    expect(&ran, "dead sensor", FAULT, PIEZO_MISSING | XL_MISSING, (WARM_UP - 1, XL_WARMING_UP));
    let none =
        ran.raw.iter().filter(|raw| usize::from(raw.sensor) == FAULTY && FAULT.contains(&raw.sequence));
    assert_eq!(none.count(), 0, "nothing to send");
}

#[test]
fn a_saturated_taxel() {
    let ran = with_fault(|sequence, part| {
        if FAULT.contains(&sequence) {
            let mut counts: [u16; TAXELS] = *scan(sequence, FAULTY as u32).counts();
            counts[16 * 32 + 16] = COUNT_MAX;
            part.piezo = PiezoFrame::from_scan(counts);
        }
    });
    expect(&ran, "saturated taxel", FAULT, TAXELS_SATURATED, (0, 0));
}

#[test]
fn a_clipped_accelerometer() {
    let ran = with_fault(|sequence, part| {
        if FAULT.contains(&sequence) {
            part.xl[5][1] = i16::MAX;
        }
    });
    expect(&ran, "clipped accelerometer", FAULT, XL_CLIPPED, (0, 0));
}

#[test]
fn a_stuck_taxel_is_masked() {
    let stuck = |_: u32, parts: &mut [SensorReadings; MAX_SENSORS]| {
        healthy(0, parts);
        let mut counts = *parts[FAULTY].piezo.counts();
        counts[10 * 32 + 20] = COUNT_MAX;
        parts[FAULTY].piezo = PiezoFrame::from_scan(counts);
    };
    let in_order = |sequence: u32, parts: &mut [SensorReadings; MAX_SENSORS]| {
        stuck(sequence, parts);
        parts.iter_mut().for_each(|part| part.xl_end = (sequence + 1) * BATCH);
    };
    let set = |shared: &slipsense::tasks::Shared<_>, tick: u32| {
        let mut controls = shared.config();
        let mask = if FAULT.contains(&tick) { TaxelMask::NONE.with(10, 20) } else { TaxelMask::NONE };
        controls.masks[FAULTY] = mask;
        shared.set_config(controls);
    };
    let found = |sequence: u32, parts: &mut [SensorReadings; MAX_SENSORS]| {
        in_order(sequence, parts);
        // As the driver says it, one frame later than the setting.
        let is_stuck = FAULT.contains(&(sequence + 1));
        parts[FAULTY].stuck = if is_stuck { TaxelMask::NONE.with(10, 20) } else { TaxelMask::NONE };
    };
    let without = World { script: &in_order, ..World::new(FRAMES, 2) }.run();
    is_masked(&World { script: &in_order, before_tick: &set, ..World::new(FRAMES, 2) }.run(), &without);
    is_masked(&World { script: &found, ..World::new(FRAMES, 2) }.run(), &without);
}

/// A mask of the settings and a taxel that the driver found stuck have the same effect.
fn is_masked(ran: &Ran, without: &Ran) {
    nothing_else(ran, without);
    let sum = without.slips[0].contact[FAULTY].sum;
    for (sequence, flags) in (0..).zip(flags(ran)) {
        let contact = ran.slips[sequence as usize].contact[FAULTY];
        // Set while the frame before waits for its decision.
        let masked = FAULT.contains(&(sequence + 1));
        if masked {
            assert_eq!((flags, contact.sum), (TAXELS_MASKED, sum - u32::from(COUNT_MAX)));
        } else {
            assert_eq!((flags, contact.sum), (TAXELS_SATURATED, sum));
        }
    }
    let masked = ran.raw.iter().find(|raw| usize::from(raw.sensor) == FAULTY && raw.sequence == 80);
    if let Some(raw) = masked {
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
    expect(&ran, "missing samples", fault, XL_SAMPLES_DROPPED | XL_WARMING_UP, (WARM_UP - 2, XL_WARMING_UP));
}

#[test]
fn samples_that_are_missing_while_the_part_is_silent_are_one_fault() {
    let ran = with_fault(|sequence, part| {
        part.xl_arrived = !FAULT.contains(&sequence);
        if sequence >= FAULT.start {
            part.xl_end += 500;
        }
    });
    expect(&ran, "silent accelerometer", FAULT, XL_MISSING, (WARM_UP - 1, XL_WARMING_UP));
}

#[test]
fn all_parts_of_all_sensors_dead() {
    let script = |sequence, parts: &mut [SensorReadings; MAX_SENSORS]| {
        healthy(sequence, parts);
        parts.iter_mut().for_each(|part| (part.piezo_arrived, part.xl_arrived) = (false, false));
    };
    let mut world = World::new(FRAMES, 3);
    world.script = &script;
    let ran = world.run();
    assert_eq!(ran.slips.len() as u32, FRAMES);
    let bits = PIEZO_MISSING | XL_MISSING;
    assert!(ran.slips.iter().all(|slip| slip.contact.iter().all(|contact| contact.health == bits)));
    assert_eq!((ran.raw.len(), ran.status.dropped_raw), (0, 0));
    assert_eq!(ran.status.condition(), Condition::Caution);
}
