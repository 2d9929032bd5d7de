//! Vibration beside slip and what it passes: modes, impacts, rig, motors, hand.

use std::f64::consts::PI;

use super::super::handling::{closing, hertz_contact_s};
use super::super::modes::Mode;
use super::*;
use crate::recipe::Region;

#[test]
fn a_closing_impact_lasts_as_long_as_hertz_says() {
    within("Hertz, soft pad, s", hertz_contact_s(0.05, 5e-3, 2e6, 0.1), 8e-3..18e-3);
    within("Hertz, hard parts, s", hertz_contact_s(0.05, 5e-3, 1e9, 0.1), 0.5e-3..1.5e-3);
    let timeline = held(2.0, 0.0, 1.0);
    let mut rng = rng(5);
    let mut widths = Vec::new();
    for _ in 0..200 {
        for (sensor, pulse) in closing(&mut rng, &scene(&timeline), 0.5).iter().enumerate() {
            let mut motion = Motion::still(sensor, clock(1.0));
            motion.add_pulses(&[*pulse], 1.0);
            let g = motion.g;
            let lasts = g.iter().filter(|g| g[2] != 0.0).count() as f64 / RATE_HZ;
            let area: f64 = g.iter().map(|g| g[2]).sum::<f64>() / RATE_HZ;
            let expected = 2.0 * pulse.width_s * pulse.peak_g * pulse.direction[2] / PI;
            assert!((lasts - pulse.width_s).abs() < 2.1 / RATE_HZ && (area / expected - 1.0).abs() < 1e-3);
            assert!((0.1..=3.0).contains(&pulse.peak_g));
            widths.push(lasts * 1e3);
        }
    }
    within("sampled impacts, ms: median", median(widths.clone()), 8.0..18.0);
    within("shortest twentieth", quantile(widths, 0.05), ..2.0);
}

#[test]
fn a_mode_rings_down_by_its_damping_and_rises_with_grip() {
    let mode = |hz, damping, weight| Mode { hz, damping, direction: [0.0, 0.0, 1.0], weight };
    for (hz, damping) in [(120.0, 0.03), (400.0, 0.08), (1100.0, 0.05)] {
        let silent = mode(2500.0, 0.1, 0.0);
        let modes =
            Modes { modes: vec![mode(hz, damping, 1.0), silent, silent, silent], grip_exponent: 0.25 };
        let ringing = |grip_n: f64| {
            let timeline = held(grip_n, 0.0, 0.3);
            let mut motion = still(0.3);
            motion.g[100][2] = 1.0;
            modes.respond(&scene(&timeline), None, &mut motion);
            // Upward crossings of zero, after the strike itself.
            let z: Vec<f64> = motion.g.iter().skip(110).map(|g| g[2]).collect();
            let first = z.iter().position(|x| *x >= 0.0).unwrap();
            let ups: Vec<f64> = (first + 1..z.len())
                .filter(|&n| z[n - 1] < 0.0 && z[n] >= 0.0 && z[n].abs() + z[n - 1].abs() > 1e-9)
                .map(|n| (n as f64 - z[n] / (z[n] - z[n - 1])) / RATE_HZ)
                .collect();
            let hz = (ups.len() - 1) as f64 / (ups[ups.len() - 1] - ups[0]);
            // Energy of every three periods: least squares of its logarithm.
            let block = (3.0 * RATE_HZ / hz) as usize;
            let energy = |(i, c): (usize, &[f64])| {
                ((i * block) as f64 / RATE_HZ, log(c.iter().map(|x| x * x).sum::<f64>()))
            };
            let energies: Vec<_> = z.chunks_exact(block).take(8).enumerate().map(energy).collect();
            (hz, -slope(&energies) / 2.0)
        };
        let (two, decay) = ringing(2.0);
        near(format!("{hz} Hz, ζ {damping}: decay, ζω per second"), decay, TAU * hz * damping, 0.05);
        near("rings at", two, hz, 0.02);
        within("4 N over 2 N, 2^¼ limited to 1.1", ringing(4.0).0 / two - 1.1, -0.02..0.02);
    }
}

#[test]
fn units_of_each_platform_ring_in_their_ranges_and_otherwise_near_the_palm() {
    for (platform, lowest) in [(Platform::Umi, 80.0..180.0), (Platform::Tesollo, 30.0..90.0)] {
        let mut rng = rng(6);
        let ratios = (0..200).map(|_| {
            let unit = Modes::draw(&mut rng, platform);
            assert!(lowest.contains(&unit.modes[0].hz));
            let weight = |m: Modes| m.modes[0].weight / m.modes[2].weight;
            let centre = weight(unit.in_grasp(&mut rng, Region::Centre));
            weight(unit.in_grasp(&mut rng, Region::Palm)) / centre
        });
        let ratio = median(ratios.collect());
        within(format!("{platform:?}: first over third mode, palm over centre"), ratio, ..0.6);
    }
}

#[test]
fn the_comb_follows_the_speed_and_has_its_level() {
    for speed in [5.0, 10.0] {
        let timeline = held(2.0, speed, 1.0);
        let rig = Rig { per_mm: 12.0, ..Rig::draw(&mut rng(7)) };
        let mut motion = still(1.0);
        rig.add(&scene(&timeline), &mut motion);
        let g = motion.g;
        let power = |hz: &f64| power_at(&g, *hz / RATE_HZ);
        let loudest = (10..1000).map(f64::from).max_by(|a, b| power(a).total_cmp(&power(b)));
        assert_eq!(loudest, Some(12.0 * speed));
        near(format!("comb at {speed} mm/s, g rms"), rms(&g), rig.object_g, 0.02);
    }
}

#[test]
fn without_leak_is_a_rig_of_level_zero_to_the_bit() {
    let timeline = held(2.0, 10.0, 0.5);
    let motion = |rig_leak: bool, silent: bool| {
        let scene = Scene { rig_leak, ..scene(&timeline) };
        let mut vibration = Vibration::draw(&mut rng(8), &mut rng_of_families(), &scene);
        if silent {
            (vibration.rig.object_g, vibration.rig.table_g, vibration.rig.hum.0) = (0.0, 0.0, 0.0);
        }
        let modes = Modes::draw(&mut rng(9), Platform::Umi);
        let streams = &mut NoiseStreams::in_turn(rng(10));
        vibration.motion(&scene, &sliding(10.0, 2.0, 0.5), &modes, (0, clock(0.5)), streams).g
    };
    assert_eq!(motion(false, false), motion(true, true));
    assert_ne!(motion(false, false), motion(true, false));
}

#[test]
fn a_drag_vibrates_like_slip_but_only_through_a_gripped_object() {
    let level_mg = |grip_n: f64| {
        let mut timeline = held(grip_n, 0.0, 1.0);
        timeline.drag.fill(0.5);
        let scene = Scene { rig_leak: false, ..scene(&timeline) };
        let level = |seed| rms_above_10_hz(&calm(&scene, seed, 1.0, 1.0)) * 1e3;
        median((0..40).map(level).collect())
    };
    within("drag at 20 mm/s of half the contact, gripped, mg", level_mg(2.0), 5.0..100.0);
    within("with open jaws", level_mg(0.0), ..1e-3);
}

/// A scene's motion without impacts, machines nearby, slip and gravity; `weight` is a factor on what passes the modes.
fn calm(scene: &Scene<'_>, seed: u64, seconds: f64, weight: f64) -> Vec<[f64; 3]> {
    let mut vibration = Vibration::draw(&mut rng(seed), &mut rng_of_families(), scene);
    vibration.handling.quiet();
    let mut modes = Modes::draw(&mut rng(seed), scene.platform);
    modes.modes.iter_mut().for_each(|m| m.weight *= weight);
    let slip = SlipSeries { fraction: vec![0.0; scene.timeline.grip_n.len()], ..sliding(0.0, 0.0, seconds) };
    let streams = &mut NoiseStreams::in_turn(rng(seed));
    let mut motion = vibration.motion(scene, &slip, &modes, (0, clock(seconds)), streams);
    let mut gravity = still(1.0);
    vibration.hand_motion.add_gravity(&mut gravity);
    motion.g.iter_mut().for_each(|g| (0..3).for_each(|a| g[a] -= gravity.g[0][a]));
    motion.g
}

#[test]
fn a_release_rings_on_for_50_to_300_ms() {
    let mut timeline = held(2.0, 0.0, 1.2);
    timeline.grip_n[1200..].fill(0.0);
    let scene = Scene { rig_leak: false, ..scene(&timeline) };
    let tenths = (0..60).map(|seed| {
        let g = calm(&scene, seed, 1.2, 0.0);
        assert!(rms(&g[..3990]) == 0.0, "silent before the release");
        // Amplitude over time in blocks of 10 ms, while it is well above the cut-off.
        let blocks = g[4000..].chunks_exact(80).map(rms).take_while(|&g| g > 1e-3).enumerate();
        let blocks: Vec<(f64, f64)> = blocks.map(|(i, g)| (0.01 * i as f64, log(g))).collect();
        -log(10.0) / slope(&blocks[..blocks.len().max(2)]) * 1e3
    });
    let tenths: Vec<f64> = tenths.collect();
    // 50 to 300, scattered by 20 %.
    within("down to a tenth, ms: shortest", quantile(tenths.clone(), 0.0), 35.0..);
    within("longest", largest(tenths), ..400.0);
}

#[test]
fn motors_vibrate_while_they_run_and_the_servo_always() {
    let resting = held(2.0, 0.0, 4.0);
    let mut running = held(2.0, 0.0, 4.0);
    running.motor.fill(1.0);
    // Running motors 2 to 20 mg and the servo; the servo 0.25 to 1.5 mg.
    for (timeline, expected) in [(running, 2.0..20.2), (resting, 0.245..1.53)] {
        for seed in 0..60 {
            let scene = Scene { platform: Platform::Tesollo, rig_leak: false, ..scene(&timeline) };
            within("motors, mg", rms(&calm(&scene, seed, 4.0, 0.0)) * 1e3, expected.clone());
        }
    }
}

#[test]
fn a_hand_sways_trembles_and_walks_and_a_rig_does_not() {
    let timeline = held(2.0, 0.0, 6.0);
    let scene = Scene { hand_held: true, linked: false, rig_leak: false, ..scene(&timeline) };
    for seed in 0..40 {
        // 0.5 g of sway, 0.03 of tremor, and footfalls at most.
        let g = calm(&scene, seed, 6.0, 0.0);
        within("a hand moves the finger by, g", largest(g.iter().flatten().map(|x| x.abs())), 0.01..1.0);
    }
    assert_eq!(rms(&calm(&Scene { hand_held: false, ..scene }, 1, 6.0, 0.0)), 0.0);
}
