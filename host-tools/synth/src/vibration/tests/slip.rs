//! The vibration of slip: texture, asperities, stick and slip, levels.

use super::super::slip::{REFERENCE_MM_S, REFERENCE_N};
use super::*;
use crate::check::mean as mean_of;
use crate::recipe::{Region, SPEEDS_MM_S};

/// Mean power spectrum of Hann-windowed segments of 256 samples, bins of 31.25 Hz.
fn spectrum(g: &[[f64; 3]]) -> Vec<f64> {
    const N: usize = 256;
    let window: [f64; N] = std::array::from_fn(|n| 0.5 - 0.5 * cos(TAU * n as f64 / N as f64));
    let mut power = vec![0.0; N / 2];
    for segment in g.chunks_exact(N) {
        let segment: Vec<_> = segment.iter().zip(window).map(|(g, w)| g.map(|x| w * x)).collect();
        for (bin, power) in power.iter_mut().enumerate() {
            *power += power_at(&segment, bin as f64 / N as f64);
        }
    }
    power
}

fn rubbing_of(surface: &Surface, slip: &SlipSeries, seconds: f64, seed: u64) -> Vec<[f64; 3]> {
    let mut force = still(seconds);
    surface.add_rubbing(&slip.rubbing(), 1.0, &mut rng(seed), &mut force);
    force.g
}

#[test]
fn a_texture_line_moves_in_proportion_to_speed() {
    let object = Object { texture_mm: vec![0.08], texture_share: 1.0, stick_slip: 0.0, ..plain().clone() };
    let surface = Surface::draw(&mut rng(1), &object);
    let peak = |speed| {
        let g = rubbing_of(&surface, &sliding(speed, 2.0, 1.0), 1.0, 2);
        let power = |hz: &f64| power_at(&g, *hz / RATE_HZ);
        let scan: Vec<f64> = (20..1200).map(|i| f64::from(i) * 0.5).collect();
        scan.into_iter().max_by(|a, b| power(a).total_cmp(&power(b))).unwrap()
    };
    let (slow, fast) = (peak(5.0), peak(15.0));
    near("line at 5 mm/s, v/λ, Hz", slow, 62.5, 0.02);
    near("at 15 mm/s over 5 mm/s", fast / slow, 3.0, 0.02);
}

#[test]
fn the_asperity_roll_off_moves_in_proportion_to_speed() {
    let mut surface = Surface::draw(&mut rng(3), plain());
    surface.asperity_mm = 0.02;
    let corner = |speed| {
        let power = spectrum(&rubbing_of(&surface, &sliding(speed, 2.0, 40.0), 40.0, 4));
        // From the sum below a frequency: a first-order roll-off has half of its power below the corner.
        let total: f64 = power[1..].iter().sum();
        let mut below = 0.0;
        for (bin, p) in power.iter().enumerate().skip(1) {
            if below + p > total / 2.0 {
                return (bin as f64 - 0.5 + (total / 2.0 - below) / p) * 31.25;
            }
            below += p;
        }
        f64::NAN
    };
    near("roll-off at 8 mm/s over 4 mm/s", corner(8.0) / corner(4.0), 2.0, 0.1);
}

#[test]
fn levels_follow_the_configured_exponents() {
    for seed in 0..4 {
        let surface = Surface::draw(&mut rng(10 + seed), plain());
        let level = |speed: f64, force: f64| {
            let g = rubbing_of(&surface, &sliding(speed, force, 40.0), 40.0, 20 + seed);
            // The amplitude is the rms less what the roll-off lets through.
            rms(&g) / signal::blend_rms(signal::blend(speed / surface.asperity_mm, RATE_HZ))
        };
        let over_speed = slope(&[2.0, 5.0, 10.0, 15.0, 18.0].map(|v| (log(v), log(level(v, 2.0)))));
        let over_force = slope(&[0.5, 1.0, 2.0, 4.0, 8.0].map(|f| (log(f), log(level(10.0, f)))));
        near("amplitude over speed, exponent", over_speed, surface.speed_exponent, 0.05);
        near("over force", over_force, surface.force_exponent, 0.05);
    }
}

#[test]
fn levels_are_stated_at_the_reference() {
    let surface = Surface::draw(&mut rng(11), plain());
    assert_eq!(surface.amplitude_g(REFERENCE_MM_S, REFERENCE_N), surface.level_g);
    let g = rubbing_of(&surface, &sliding(REFERENCE_MM_S, REFERENCE_N, 20.0), 20.0, 12);
    near("rms at the reference, g", rms(&g), surface.level_g, 0.03);
}

/// Median level, mg rms above 10 Hz, and sum of the spectra of 120 motions of 0.6 s.
fn level_and_spectrum(first_seed: u64, add: impl Fn(Rng, &mut Motion)) -> (f64, Vec<f64>) {
    let mut sum = vec![0.0; 128];
    let level = |seed| {
        let mut motion = still(0.6);
        add(rng(first_seed + seed), &mut motion);
        sum.iter_mut().zip(spectrum(&motion.g[..1024])).for_each(|(sum, power)| *sum += power);
        rms_above_10_hz(&motion.g) * 1e3
    };
    let level = median((0..120).map(level).collect());
    (level, sum)
}

/// Of slip through the modes of units drawn anew.
fn through_modes(speed: f64) -> (f64, Vec<f64>) {
    let timeline = held(2.0, 0.0, 0.6);
    let scene = scene(&timeline);
    let slip = sliding(speed, 2.0, 0.6);
    level_and_spectrum(1000, |mut rng, motion| {
        let vibration = Vibration::draw(&mut rng, &mut rng_of_families(), &scene);
        let modes = Modes::draw(&mut rng, scene.platform).in_grasp(&mut rng, Region::Centre);
        vibration.slip(&scene, &slip, &mut NoiseStreams::in_turn(rng), motion);
        modes.respond(&scene, None, motion);
    })
}

#[test]
fn levels_meet_the_anchor() {
    const ANCHOR_MG: [f64; 5] = [4.0, 13.0, 30.0, 49.0, 60.0];
    for (speed, anchor) in SPEEDS_MM_S.into_iter().zip(ANCHOR_MG) {
        near("median level, mg", through_modes(speed).0, anchor, 0.25);
    }
}

#[test]
fn the_autoregressive_model_is_stable_as_loud_and_otherwise_coloured() {
    let reflections = (0..50).flat_map(|seed| {
        let noise = AutoregressiveNoise::draw(&mut rng(seed), plain());
        let forces = [0.2, 0.7, 1.3, 3.0, 6.0, 12.0];
        (1..60).flat_map(|v| forces.map(|f| noise.at(f64::from(v), f))).flatten().collect::<Vec<_>>()
    });
    within("largest reflection coefficient, stable below 1", largest(reflections.map(f64::abs)), ..1.0);
    for speed in SPEEDS_MM_S {
        let (level, mean) = level_and_spectrum(2000, |mut rng, motion| {
            let texture = AutoregressiveNoise::draw(&mut rng, plain());
            texture.add(&sliding(speed, 2.0, 0.6), &mut rng, motion);
        });
        let (modal, modal_mean) = through_modes(speed);
        // Half the sum of differences between spectra of unit power: 0 the same, 1 nothing in common.
        let (a, b) = (mean.iter().sum::<f64>(), modal_mean.iter().sum::<f64>());
        let apart: f64 = mean.iter().zip(&modal_mean).map(|(x, y)| (x / a - y / b).abs()).sum::<f64>() / 2.0;
        within(format!("{speed} mm/s: autoregressive over modal level"), level / modal, 1.0 / 1.5..1.5);
        within("their spectra apart", apart, 0.1..);
    }
}

#[test]
fn stick_slip_comes_at_the_period_of_its_formula() {
    let object = Object { stick_slip: 1.0, ..plain().clone() };
    let slack = object.mu_static - object.mu_kinetic;
    for seed in 0..6 {
        let surface = Surface::draw(&mut rng(seed), &object);
        let pulses = surface.pulses(&sliding(2.0, 2.0, 20.0).rubbing(), 1.0, &mut rng(seed));
        let stiffness = 2.0 * slack / surface.stick.spacing_mm_per_n;
        let expected = (stiffness * 2.0 / (2.0 * slack * 2.0)).min(2200.0);
        let rate = pulses.len() as f64 / 20.0;
        near(format!("K {stiffness:.1} N/mm: pulses per second, K v / (2 Δμ N)"), rate, expected, 0.12);
    }
}

#[test]
fn spreading_slip_ticks_weakly() {
    let steps = 2400;
    let spreading = SlipSeries {
        // The patch lets go from 0 to half within a second, at the speed of gross slip.
        fraction: (0..steps).map(|i| 0.499 * i as f64 / steps as f64).collect(),
        speed_mm_s: (0..steps).map(|i| 10.0 * 0.499 * i as f64 / steps as f64).collect(),
        ..sliding(10.0, 2.0, 1.0 - 2.0 / STEP_HZ)
    };
    let object = Object { stick_slip: 1.0, ..plain().clone() };
    let mean = |p: &[Pulse]| p.iter().map(|p| p.peak_g).sum::<f64>() / p.len().max(1) as f64;
    let (mut ratios, mut counts) = (Vec::new(), Vec::new());
    for seed in 0..40 {
        let surface = Surface::draw(&mut rng(seed), &object);
        let weak = surface.pulses(&spreading.rubbing(), 1.0, &mut rng(seed));
        let gross = surface.pulses(&sliding(10.0, 2.0, 5.0).rubbing(), 1.0, &mut rng(seed));
        counts.push(weak.len() as f64);
        ratios.push(mean(&weak) / mean(&gross));
    }
    within("incipient over gross, 0.05 to 0.3", median(ratios), 0.04..0.3);
    within("pulses for half the patch, 20", mean_of(&counts), 16.0..24.0);
}
