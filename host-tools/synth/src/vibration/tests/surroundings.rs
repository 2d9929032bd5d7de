//! What sounds beside slip and through what: modes, impacts, rig, motors, hand.

use super::super::handling::{closing, hertz_contact_s};
use super::super::modes::Mode;
use super::*;
use crate::recipe::Region;
use std::f64::consts::PI;

#[test]
fn a_closing_impact_lasts_as_long_as_hertz_says() {
    let (soft, hard) = (hertz_contact_s(0.05, 5e-3, 2e6, 0.1), hertz_contact_s(0.05, 5e-3, 1e9, 0.1));
    println!("Hertz: soft pad {:.1} ms (8 to 18), hard parts {:.2} ms (about 1)", soft * 1e3, hard * 1e3);
    assert!((8e-3..18e-3).contains(&soft) && (0.5e-3..1.5e-3).contains(&hard));

    let held = Held::new(2.0, 0.0, 1.0);
    let mut rng = rng(5);
    let mut widths = Vec::new();
    for _ in 0..200 {
        for (sensor, pulse) in closing(&mut rng, &held.scene(VibrationModel::Modal), 0.5).iter().enumerate() {
            let mut g = vec![[0.0; 3]; 8000];
            add_pulses(&[*pulse], sensor, 1.0, clock(1.0), &mut g);
            let heard = g.iter().filter(|g| g[2] != 0.0).count() as f64 / RATE_HZ;
            let area: f64 = g.iter().map(|g| g[2]).sum::<f64>() / RATE_HZ;
            let expected = 2.0 * pulse.width_s * pulse.peak_g * pulse.direction[2] / PI;
            assert!((heard - pulse.width_s).abs() < 2.1 / RATE_HZ && (area / expected - 1.0).abs() < 1e-3);
            assert!((0.1..=3.0).contains(&pulse.peak_g));
            widths.push(heard * 1e3);
        }
    }
    widths.sort_by(f64::total_cmp);
    let at = |share: usize| widths[widths.len() * share / 100];
    println!("sampled impacts: 5 % {:.1} ms, median {:.1} ms, 95 % {:.1} ms", at(5), at(50), at(95));
    assert!((8.0..18.0).contains(&at(50)) && at(5) < 2.0);
}

#[test]
fn a_mode_rings_down_by_its_damping_and_rises_with_grip() {
    let mode = |hz, damping, weight| Mode { hz, damping, direction: [0.0, 0.0, 1.0], weight };
    for (hz, damping) in [(120.0, 0.03), (400.0, 0.08), (1100.0, 0.05)] {
        let silent = mode(2500.0, 0.1, 0.0);
        let modes = Modes { modes: [mode(hz, damping, 1.0), silent, silent, silent], grip_exponent: 0.25 };
        let rung = |grip_n: f64| {
            let held = Held::new(grip_n, 0.0, 0.3);
            let mut g = vec![[0.0; 3]; 2400];
            g[100][2] = 1.0;
            modes.respond(&held.scene(VibrationModel::Modal), None, clock(0.3), &mut g);
            // Peaks of |a|, after the strike itself, and upward crossings of zero.
            let z: Vec<f64> = g.iter().skip(110).map(|g| g[2]).collect();
            let first = z.iter().position(|x| *x >= 0.0).unwrap();
            let ups: Vec<f64> = (first + 1..z.len())
                .filter(|&n| z[n - 1] < 0.0 && z[n] >= 0.0 && z[n].abs() + z[n - 1].abs() > 1e-9)
                .map(|n| (n as f64 - z[n] / (z[n] - z[n - 1])) / RATE_HZ)
                .collect();
            let hz = (ups.len() - 1) as f64 / (ups[ups.len() - 1] - ups[0]);
            // Energy of every three periods: least squares of its logarithm.
            let block = (3.0 * RATE_HZ / hz) as usize;
            let energies: Vec<(f64, f64)> = z
                .chunks_exact(block)
                .take(8)
                .enumerate()
                .map(|(i, c)| (exp((i * block) as f64 / RATE_HZ), c.iter().map(|x| x * x).sum::<f64>()))
                .collect();
            (hz, -slope(&energies) / 2.0)
        };
        let (two, decay) = rung(2.0);
        let expected = TAU * hz * damping;
        let (firm, _) = rung(4.0);
        println!(
            "{hz} Hz, ζ {damping}: decay {decay:.1} per second (ζω {expected:.1}), rings at {two:.0} Hz, at \
             4 N times {:.3} (2^¼ limited to 1.1)",
            firm / two
        );
        assert!((decay / expected - 1.0).abs() < 0.05);
        assert!((two / hz - 1.0).abs() < 0.02 && (firm / two - 1.1).abs() < 0.02);
    }
}

#[test]
fn units_of_each_platform_ring_in_their_ranges_and_otherwise_near_the_palm() {
    for (platform, lowest) in [(Platform::Umi, 80.0..180.0), (Platform::Tesollo, 30.0..90.0)] {
        let mut rng = rng(6);
        let mut ratio = Vec::new();
        for _ in 0..200 {
            let unit = Modes::draw(&mut rng, platform);
            assert!(lowest.contains(&unit.modes[0].hz));
            let weight = |m: &Modes| m.modes[0].weight / m.modes[2].weight;
            let (centre, palm) =
                (unit.in_grasp(&mut rng, Region::Centre), unit.in_grasp(&mut rng, Region::Palm));
            ratio.push(weight(&palm) / weight(&centre));
        }
        let ratio = median(ratio);
        println!("{platform:?}: first over third mode near the palm {ratio:.2} of the centre's");
        assert!(ratio < 0.6);
    }
}

#[test]
fn the_comb_follows_the_speed_and_has_its_level() {
    for speed in [5.0, 10.0] {
        let held = Held::new(2.0, speed, 1.0);
        let mut rig = Rig::draw(&mut rng(7));
        rig.per_mm = 12.0;
        let mut g = vec![[0.0; 3]; 8000];
        rig.add(&held.scene(VibrationModel::Modal), clock(1.0), &mut g);
        let peak =
            (10..1000).map(f64::from).max_by(|a, b| power_at(&g, *a).total_cmp(&power_at(&g, *b))).unwrap();
        println!(
            "comb at {speed} mm/s: {peak} Hz ({} expected), {:.3} mg rms ({:.3})",
            12.0 * speed,
            rms(&g) * 1e3,
            rig.object_g * 1e3
        );
        assert_eq!(peak, 12.0 * speed);
        assert!((rms(&g) / rig.object_g - 1.0).abs() < 0.02);
    }
}

#[test]
fn without_leak_is_a_rig_of_level_zero_to_the_bit() {
    let held = Held::new(2.0, 10.0, 0.5);
    let slip = sliding(10.0, 2.0, 0.5);
    let motion = |leak: bool, silent: bool| {
        let scene = Scene { rig_leak: leak, ..held.scene(VibrationModel::Modal) };
        let mut vibration = Vibration::draw(&mut rng(8), &scene);
        if silent {
            vibration.rig.silence();
        }
        let modes = Modes::draw(&mut rng(9), Platform::Umi);
        vibration.motion_g(&scene, &slip, &modes, 0, clock(0.5), &mut NoiseStreams::in_turn(rng(10)))
    };
    assert_eq!(motion(false, false), motion(true, true));
    assert_ne!(motion(false, false), motion(true, false));
}

#[test]
fn a_drag_sounds_like_slip_but_only_through_a_gripped_object() {
    let drag = vec![1.0; 2402];
    let speed = vec![20.0; 2402];
    let heard = |grip_n: f64| {
        let held = Held::new(grip_n, 0.0, 1.0);
        let levels = (0..40).map(|seed| {
            let scene = Scene {
                drag: &drag,
                drag_mm_s: &speed,
                rig_leak: false,
                ..held.scene(VibrationModel::Modal)
            };
            let mut vibration = Vibration::draw(&mut rng(seed), &scene);
            vibration.handling.quiet();
            let slip = SlipSeries { fraction: vec![0.0; 2402], ..sliding(0.0, grip_n, 1.0) };
            let modes = Modes::draw(&mut rng(seed), Platform::Umi);
            let streams = &mut NoiseStreams::in_turn(rng(seed));
            rms_above_10_hz(&vibration.motion_g(&scene, &slip, &modes, 0, clock(1.0), streams)) * 1e3
        });
        median(levels.collect())
    };
    let (gripped, open) = (heard(2.0), heard(0.0));
    println!("drag at 20 mm/s: {gripped:.1} mg gripped, {open:.3} mg with open jaws (synthetic)");
    assert!((5.0..100.0).contains(&gripped) && open < 1e-3);
}

/// A scene's motion without rig, impacts, machines nearby and modes: gravity and what bypasses the modes.
fn bare(scene: &Scene<'_>, seed: u64, seconds: f64) -> Vec<[f64; 3]> {
    let mut vibration = Vibration::draw(&mut rng(seed), scene);
    vibration.handling.quiet();
    let mut modes = Modes::draw(&mut rng(seed), scene.platform);
    modes.modes.iter_mut().for_each(|m| m.weight = 0.0);
    let slip = SlipSeries { fraction: vec![0.0; scene.grip_n.len()], ..sliding(0.0, 0.0, seconds) };
    let mut g =
        vibration.motion_g(scene, &slip, &modes, 0, clock(seconds), &mut NoiseStreams::in_turn(rng(seed)));
    let mut gravity = vec![[0.0; 3]];
    vibration.hand_motion.gravity(&mut gravity);
    g.iter_mut().for_each(|g| (0..3).for_each(|a| g[a] -= gravity[0][a]));
    g
}

#[test]
fn a_release_rings_on_for_50_to_300_ms() {
    let mut held = Held::new(2.0, 0.0, 1.2);
    held.grip_n[1200..].fill(0.0);
    let scene = Scene { rig_leak: false, ..held.scene(VibrationModel::Modal) };
    let (mut tenths, mut peaks) = (Vec::new(), Vec::new());
    for seed in 0..60 {
        let g = bare(&scene, seed, 1.2);
        assert!(rms(&g[..3990]) == 0.0, "silent before the release");
        // Amplitude over time in blocks of 10 ms, while it is well above the cut-off.
        let blocks: Vec<(f64, f64)> = g[4000..]
            .chunks_exact(80)
            .enumerate()
            .map(|(i, c)| (exp(0.01 * i as f64), rms(c)))
            .take_while(|b| b.1 > 1e-3)
            .collect();
        tenths.push(-log(10.0) / slope(&blocks[..blocks.len().max(2)]) * 1e3);
        peaks.push(g.iter().flatten().fold(0f64, |m, x| m.max(x.abs())));
    }
    tenths.sort_by(f64::total_cmp);
    println!(
        "down to a tenth after {:.0} to {:.0} ms (50 to 300, scattered by 20 %), median peak {:.2} g",
        tenths[0],
        tenths[59],
        median(peaks)
    );
    assert!(tenths[0] > 35.0 && tenths[59] < 400.0);
}

#[test]
fn motors_are_heard_while_they_run_and_the_servo_always() {
    let held = Held::new(2.0, 0.0, 4.0);
    let full = vec![1.0; held.still.len()];
    let (mut running, mut resting) = (Vec::new(), Vec::new());
    for seed in 0..60 {
        let scene =
            Scene { platform: Platform::Tesollo, rig_leak: false, ..held.scene(VibrationModel::Modal) };
        resting.push(rms(&bare(&scene, seed, 4.0)) * 1e3);
        let scene = Scene { motor: &full, ..scene };
        running.push(rms(&bare(&scene, seed, 4.0)) * 1e3);
    }
    for levels in [&mut running, &mut resting] {
        levels.sort_by(f64::total_cmp);
    }
    println!(
        "motors running {:.1} to {:.1} mg (2 to 20 and the servo), at rest {:.2} to {:.2} mg (0.5 to 3)",
        running[0], running[59], resting[0], resting[59]
    );
    assert!(running[0] > 2.0 && running[59] < 20.5 && resting[0] > 0.49 && resting[59] < 3.05);
}

#[test]
fn a_hand_sways_trembles_and_walks_and_a_rig_does_not() {
    let held = Held::new(2.0, 0.0, 6.0);
    let scene =
        Scene { hand_held: true, linked: false, rig_leak: false, ..held.scene(VibrationModel::Modal) };
    let mut peaks: Vec<f64> = (0..40)
        .map(|seed| bare(&scene, seed, 6.0).iter().flatten().fold(0f64, |m, x| m.max(x.abs())))
        .collect();
    peaks.sort_by(f64::total_cmp);
    println!(
        "a hand moves the finger by up to {:.2} g, median {:.2} (0.5 sway, 0.03 tremor, footfalls)",
        peaks[39], peaks[20]
    );
    assert!(peaks[0] > 0.01 && peaks[39] < 1.0);
    let rig = Scene { hand_held: false, ..scene };
    assert_eq!(rms(&bare(&rig, 1, 6.0)), 0.0);
}

#[test]
fn with_only_the_rig_heard_slip_and_impacts_leave_no_trace() {
    let held = Held::new(2.0, 10.0, 0.5);
    let modes = Modes::draw(&mut rng(9), Platform::Umi);
    let motion = |slip: &SlipSeries| {
        let scene = Scene { content: VibrationContent::RigOnly, ..held.scene(VibrationModel::Modal) };
        let streams = &mut NoiseStreams::in_turn(rng(10));
        Vibration::draw(&mut rng(8), &scene).motion_g(&scene, slip, &modes, 0, clock(0.5), streams)
    };
    let resting = SlipSeries { fraction: vec![0.0; 1202], ..sliding(0.0, 2.0, 0.5) };
    assert_eq!(motion(&sliding(18.0, 2.0, 0.5)), motion(&resting));
}
