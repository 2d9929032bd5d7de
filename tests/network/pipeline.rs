//! The pipeline: what is decided by whom, and what happens when parts are missing.

use super::inputs::SHAPES;
use slipsense::fixed::{Logit, Q};
use slipsense::health;
use slipsense::net::Model;
use slipsense::net::format::OperatingPoint;
use slipsense::params::{CONTACT_SUM_MIN, MAX_SENSORS, TAXELS};
use slipsense::pipeline::{Class, FrameStamp, Pipeline};
use slipsense::sensor::{PiezoFrame, SensorInput, TaxelMask};
use slipsense::wire::{
    DEGRADED_FROZEN, DEGRADED_MISSING, DEGRADED_NOT_CALIBRATED, DEGRADED_POINT, INVALID_NO_SENSOR,
    INVALID_STARTING, Origin,
};
use slipsense_recording::model_file::random_model;

fn constant(logits: [i32; 3], sensors: usize) -> Pipeline<'static> {
    Pipeline::new(model_at(logits, OperatingPoint::EVEN), sensors).unwrap()
}

/// A model whose head ignores the network: its logits are these, and slip's lead over contact the log-odds.
fn model_at(logits: [i32; 3], point: OperatingPoint) -> Model<'static> {
    let [no_contact, no_slip, slip] = logits;
    let outputs = [no_contact, no_slip, slip, slip - no_slip];
    let mut file = random_model(SHAPES[0], 2);
    file.tensor_mut("head", "weight").fill(0);
    file.tensor_mut("head", "multiplier").fill(1 << 30);
    for (bias, output) in file.tensor_mut("head", "bias").iter_mut().zip(outputs) {
        *bias = output * 4;
    }
    file.point = point;
    Model::parse(file.to_bytes().unwrap().leak()).unwrap()
}

fn pad_with_sum(sum: u32) -> PiezoFrame {
    let mut counts = [0; TAXELS];
    counts[16 * 32 + 16] = sum as u16;
    PiezoFrame::from_counts(counts).unwrap()
}

fn one_frame(logits: [i32; 3], pads: &[Option<&PiezoFrame>]) -> Class {
    let inputs: Vec<_> = pads.iter().map(|&piezo| SensorInput { piezo, xl: Some(&[]), xl_end: 0 }).collect();
    let output = constant(logits, pads.len()).step(&inputs);
    assert_eq!(output.logits, logits.map(Logit::from_bits));
    assert_eq!(output.may_begin, output.class == Class::Slip);
    output.class
}

/// Per-unit rule: no contact only if every pad is below one count on average.
#[test]
fn the_pads_decide_contact() {
    let (idle, touched) = (pad_with_sum(CONTACT_SUM_MIN - 1), pad_with_sum(CONTACT_SUM_MIN));
    for logits in [[900, 0, 500], [0, 0, 500], [-5, 700, 0]] {
        assert_eq!(one_frame(logits, &[Some(&idle), Some(&idle)]), Class::NoContact);
        let held = if logits[2] > logits[1] { Class::Slip } else { Class::NoSlip };
        assert_eq!(one_frame(logits, &[Some(&touched), Some(&idle)]), held);
        assert_eq!(one_frame(logits, &[Some(&idle), Some(&touched)]), held);
    }
    assert_eq!(one_frame([0, 500, 500], &[Some(&touched)]), Class::NoSlip, "a tie is no slip");
}

#[test]
fn without_a_pad_the_network_decides_contact() {
    let (idle, touched) = (pad_with_sum(0), pad_with_sum(2000));
    assert_eq!(one_frame([900, 0, 500], &[None, Some(&idle)]), Class::NoContact);
    assert_eq!(one_frame([400, 0, 500], &[None, Some(&idle)]), Class::Slip);
    assert_eq!(one_frame([900, 0, 500], &[None, Some(&touched)]), Class::Slip);
}

/// Three frames over the threshold of the last five: later than the flag, and over sooner than it began.
#[test]
fn the_flag_follows_the_files_operating_point() {
    let flags = |threshold: i32| -> Vec<bool> {
        let threshold = Logit::from_bits(threshold);
        let model = model_at([0, 100, 600], OperatingPoint { threshold, k: 3, n: 5 });
        let mut pipeline = Pipeline::new(model, 1).unwrap();
        let (idle, held) = (pad_with_sum(0), pad_with_sum(2000));
        let pads = [&held, &idle, &held, &held, &held, &idle, &idle, &idle, &held];
        let step = |piezo| {
            let output = pipeline.step(&[SensorInput { piezo: Some(piezo), xl: Some(&[]), xl_end: 0 }]);
            let message = output.slip_message(FrameStamp::of_recording(0), &Origin::default());
            assert_eq!((message.slip, message.may_begin), (output.slip, output.may_begin));
            assert_eq!(output.log_odds, output.may_begin.then_some(Logit::from_bits(500)));
            output.slip
        };
        pads.map(step).to_vec()
    };
    let (down, up) = (false, true);
    assert_eq!(flags(499), [down, down, down, up, up, up, up, down, down]);
    assert_eq!(flags(500), [down; 9], "a lead of just the threshold is not enough");
}

#[test]
fn health_tells_what_is_missing_and_the_rest_goes_on() {
    let mut pipeline = constant([0, 1, 2], 3);
    let pad = pad_with_sum(4095);
    let samples = [[0i16, 5, -3]; 64];
    let mut clipped = samples;
    clipped[7][1] = i16::MAX;
    let good = |frame: u32| SensorInput { piezo: Some(&pad), xl: Some(&samples), xl_end: 64 * frame };
    let dead = SensorInput::default();

    let mut step = |inputs: &[SensorInput<'_>]| pipeline.step(inputs).health.map(|health| health.0);
    let warming = health::XL_WARMING_UP | health::TAXELS_SATURATED;
    let gone = health::PIEZO_MISSING | health::XL_MISSING;
    assert_eq!(step(&[good(1), dead]), [warming, gone, gone], "a sensor not given is missing");
    let deaf = SensorInput { piezo: None, xl: Some(&clipped), xl_end: 64 };
    let third = health::PIEZO_MISSING | health::XL_WARMING_UP | health::XL_CLIPPED;
    assert_eq!(step(&[good(2), good(2), deaf]), [health::TAXELS_SATURATED, warming, third]);
    // A frame without samples starts the front end anew.
    step(&[SensorInput { xl: None, ..good(3) }, good(3), dead]);
    assert!(step(&[good(4), good(4), dead])[0] & health::XL_WARMING_UP != 0);
    let long = SensorInput { xl: Some(&[[1; 3]; 65]), xl_end: 64 * 4 + 65, ..good(5) };
    assert!(step(&[long, good(5), dead])[0] & health::XL_SAMPLES_DROPPED != 0);
}

/// What comes after missing samples is what a front end gives that starts there, but for the noise floors, which stay.
#[test]
fn missing_samples_start_the_front_end_anew_and_are_flagged() {
    let sample = |n: u32| [(n.wrapping_mul(2_654_435_761) >> 18) as i16, n as i16, -(n as i16)];
    for lost in [1, 7, 500, u32::MAX] {
        let [mut pipeline, mut after] = [(); 2].map(|()| constant([0, 1, 2], 1));
        let mut end = u32::MAX - 100;
        for frame in 0..12 {
            let samples: Vec<_> = (0..33).map(|i| sample(frame * 33 + i)).collect();
            end = end.wrapping_add(33).wrapping_add(if frame == 6 { lost } else { 0 });
            let input = SensorInput { piezo: None, xl: Some(&samples), xl_end: end };
            let output = pipeline.step(&[input]);
            assert_eq!(output.health[0].contains(health::XL_SAMPLES_DROPPED), frame == 6, "frame {frame}");
            let warming = output.health[0].contains(health::XL_WARMING_UP);
            assert_eq!(warming, matches!(frame, 0..=2 | 6..=8), "frame {frame}");
            if frame >= 6 {
                let (ours, fresh) = (output.log_mel[0], after.step(&[input]).log_mel[0]);
                assert_eq!(ours.ln_power, fresh.ln_power, "frame {frame}");
                assert_eq!(ours.standardised, fresh.standardised, "frame {frame}");
            }
        }
    }
}

#[test]
fn sensor_count_is_checked() {
    let model = model_at([0; 3], OperatingPoint::EVEN);
    for sensors in [0, MAX_SENSORS + 1] {
        let error = Pipeline::new(model, sensors).err().unwrap();
        assert_eq!(error.to_string(), format!("{sensors} sensors, 1 to 3 are possible"));
    }
}

#[test]
fn the_slip_message_carries_the_output() {
    let pad = pad_with_sum(3000);
    let output =
        constant([-700, 20, 3000], 2).step(&[SensorInput { piezo: Some(&pad), ..SensorInput::default() }; 2]);
    let message = output.slip_message(
        FrameStamp { sequence: 7, timestamp_us: 29_167 },
        &Origin { late_frames: 4, starts: 9, locked: true, ..Origin::default() },
    );
    assert_eq!((message.sequence, message.timestamp_us, message.late_frames), (7, 29_167, 4));
    assert_eq!((message.class, message.slip, message.sensors), (2, true, 2));
    assert_eq!((message.may_begin, message.locked, message.starts), (true, true, 9));
    assert_eq!(message.logits, [-175, 5, 750].map(Q::from_bits));
    assert_eq!(message.log_odds, Q::from_bits(745));
    assert_eq!((message.contact[1].sum, message.contact[1].health), (3000, health::XL_MISSING));
    assert_eq!(message.contact[2], Default::default());
}

/// Reasons not to believe the flag, and what makes it worse.
#[test]
fn doubts_come_and_go_with_their_causes() {
    let mut pipeline = constant([0, 1, 2], 2);
    let pad = pad_with_sum(3000);
    let mut end = 0u32;
    let mut step = |pipeline: &mut Pipeline<'_>, pads: bool, xl: bool, changes: bool| {
        end += 33;
        let sample = |i: u32| [if changes { (i * 7919 % 64) as i16 } else { 5 }; 3];
        let samples: Vec<_> = (end - 33..end).map(sample).collect();
        let input = SensorInput { piezo: pads.then_some(&pad), xl: xl.then_some(&samples), xl_end: end };
        let output = pipeline.step(&[input; 2]);
        (output.invalid, output.degraded)
    };
    for frame in 1..=70 {
        let invalid = if frame < 60 { INVALID_STARTING } else { 0 };
        assert_eq!(step(&mut pipeline, true, true, true), (invalid, 0), "frame {frame}");
    }
    assert_eq!(step(&mut pipeline, true, false, true), (0, DEGRADED_MISSING));
    assert_eq!(step(&mut pipeline, false, false, true), (INVALID_NO_SENSOR, DEGRADED_MISSING));
    let frozen = (0..800).map(|_| step(&mut pipeline, false, true, false)).last().unwrap();
    assert_eq!(frozen, (INVALID_NO_SENSOR, DEGRADED_MISSING | DEGRADED_FROZEN));
    assert_eq!(step(&mut pipeline, true, true, false), (0, DEGRADED_FROZEN));

    let model = pipeline.model().hash;
    let configuration = |pipeline: &mut Pipeline<'_>, calibrations| {
        let output = pipeline.step(&[]);
        assert_eq!(pipeline.model().hash, model);
        let origin = Origin { calibrations, ..Origin::default() };
        let message = output.slip_message(FrameStamp::default(), &origin);
        (message.configuration, message.degraded & (DEGRADED_NOT_CALIBRATED | DEGRADED_POINT))
    };
    let none = configuration(&mut pipeline, [0; 3]);
    assert_eq!(none.1, DEGRADED_NOT_CALIBRATED);
    let swapped = [configuration(&mut pipeline, [7, 9, 0]), configuration(&mut pipeline, [9, 7, 0])];
    assert_eq!(swapped.map(|(_, degraded)| degraded), [0, 0]);
    let point = Some(OperatingPoint { k: 3, n: 9, ..OperatingPoint::EVEN });
    let masked = [TaxelMask([1; 32]), TaxelMask::NONE, TaxelMask::NONE];
    pipeline.configure(None, &masked, Default::default());
    let masked = configuration(&mut pipeline, [0; 3]);
    pipeline.configure(point, &[TaxelMask::NONE; MAX_SENSORS], Default::default());
    let pointed = configuration(&mut pipeline, [0; 3]);
    assert_eq!(pointed.1, DEGRADED_NOT_CALIBRATED | DEGRADED_POINT);
    let [rows, cols] = [(true, false), (false, true)].map(|mounting| {
        let mountings = [(false, false), mounting, (false, false)];
        pipeline.configure(None, &[TaxelMask::NONE; MAX_SENSORS], mountings);
        configuration(&mut pipeline, [0; 3]).0
    });
    let all = [none.0, swapped[0].0, swapped[1].0, masked.0, pointed.0, rows, cols];
    assert!((0..7).all(|i| (0..i).all(|j| all[i] != all[j])), "{all:?}");
    pipeline.configure(None, &[TaxelMask::NONE; MAX_SENSORS], Default::default());
    assert_eq!(configuration(&mut pipeline, [0; 3]), none);
}
