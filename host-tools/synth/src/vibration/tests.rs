//! The vibration against closed forms; each test prints what it measured beside what it expects.

use super::disturbance::{closing, hertz_contact_s};
use super::modes::Mode;
use super::slip::{REFERENCE_MM_S, REFERENCE_N};
use super::*;
use crate::draw::{Stream, stream};
use crate::objects::{Kind, named};
use crate::recipe::Region;
use libm::{cos, exp, log, sin};
use std::f64::consts::{PI, TAU};

const RATE_HZ: f64 = 8_000.0;

fn rng(seed: u64) -> Rng {
    stream(seed, Stream::Vibration, 0)
}

fn clock(seconds: f64) -> Clock {
    Clock { rate_hz: RATE_HZ, drift_per_s: 0.0, start: 0.0, samples: (seconds * RATE_HZ) as usize }
}

/// Gross slip along the finger at constant speed and grip.
fn sliding(speed_mm_s: f64, grip_n: f64, seconds: f64) -> Slide {
    let steps = (seconds * STEP_HZ) as usize + 2;
    Slide {
        speed_mm_s: vec![speed_mm_s; steps],
        fraction: vec![1.0; steps],
        path_mm: (0..steps).map(|i| i as f64 * speed_mm_s / STEP_HZ).collect(),
        direction: vec![[0.0, 1.0]; steps],
        grip_n: vec![grip_n; steps],
    }
}

/// An object of Ra 1 µm without texture.
fn plain() -> &'static Object {
    let object = named("shore-88-block").unwrap();
    Box::leak(Box::new(Object {
        roughness_um: 1.0,
        stick_slip: 0.2,
        kind: Kind::Material,
        ring_hz: 0.0,
        texture_mm: Vec::new(),
        ..object.clone()
    }))
}

/// Series of a scene in which a grip is held and nothing else happens.
struct Held {
    grip_n: Vec<f64>,
    crosshead_mm: Vec<f64>,
    still: Vec<f64>,
    full: Vec<f64>,
}

impl Held {
    fn new(grip_n: f64, crosshead_mm_s: f64, seconds: f64) -> Self {
        let steps = (seconds * STEP_HZ) as usize + 2;
        Self {
            grip_n: vec![grip_n; steps],
            crosshead_mm: (0..steps).map(|i| i as f64 * crosshead_mm_s / STEP_HZ).collect(),
            still: vec![0.0; steps],
            full: vec![1.0; steps],
        }
    }

    fn scene(&self, model: VibrationModel) -> Scene<'_> {
        Scene {
            platform: Platform::Umi,
            model,
            heard: Heard::All,
            rig_leak: true,
            hand_held: false,
            linked: true,
            shared_table: false,
            object: plain(),
            grip_n: &self.grip_n,
            crosshead_mm: &self.crosshead_mm,
            jaw: &self.still,
            motor: &self.still,
            drag: &self.still,
            drag_mm_s: &self.still,
            motion: &self.full,
            ambient: &self.still,
            pulses: &[],
        }
    }
}

/// Vector rms.
fn rms(g: &[[f64; 3]]) -> f64 {
    (g.iter().flatten().map(|x| x * x).sum::<f64>() / g.len() as f64).sqrt()
}

/// Vector rms above 10 Hz (first-order), without the first tenth of a second.
fn rms_above_10_hz(g: &[[f64; 3]]) -> f64 {
    let pole = exp(-TAU * 10.0 / RATE_HZ);
    let (mut last, mut y) = (g[0], [0.0; 3]);
    let filtered: Vec<[f64; 3]> = g
        .iter()
        .map(|x| {
            for a in 0..3 {
                y[a] = pole * (y[a] + x[a] - last[a]);
            }
            last = *x;
            y
        })
        .collect();
    rms(&filtered[800..])
}

/// Power at a frequency, summed over the axes.
fn power_at(g: &[[f64; 3]], hz: f64) -> f64 {
    (0..3)
        .map(|axis| {
            let (mut re, mut im) = (0.0, 0.0);
            for (n, x) in g.iter().enumerate() {
                let phase = TAU * hz * n as f64 / RATE_HZ;
                re += x[axis] * cos(phase);
                im += x[axis] * sin(phase);
            }
            re * re + im * im
        })
        .sum()
}

/// Mean power spectrum of Hann-windowed segments of 256 samples, bins of 31.25 Hz.
fn spectrum(g: &[[f64; 3]]) -> Vec<f64> {
    const N: usize = 256;
    let table: Vec<(f64, f64)> =
        (0..N).map(|i| (cos(TAU * i as f64 / N as f64), sin(TAU * i as f64 / N as f64))).collect();
    let mut power = vec![0.0; N / 2];
    for segment in g.chunks_exact(N) {
        for axis in 0..3 {
            for (bin, power) in power.iter_mut().enumerate() {
                let (mut re, mut im) = (0.0, 0.0);
                for (n, x) in segment.iter().enumerate() {
                    let window = 0.5 - 0.5 * table[n].0;
                    let (c, s) = table[bin * n % N];
                    re += window * x[axis] * c;
                    im += window * x[axis] * s;
                }
                *power += re * re + im * im;
            }
        }
    }
    power
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

/// Slope of a least-squares line through the logarithms.
fn slope(points: &[(f64, f64)]) -> f64 {
    let n = points.len() as f64;
    let logs: Vec<(f64, f64)> = points.iter().map(|(x, y)| (log(*x), log(*y))).collect();
    let (mx, my) = (logs.iter().map(|p| p.0).sum::<f64>() / n, logs.iter().map(|p| p.1).sum::<f64>() / n);
    logs.iter().map(|(x, y)| (x - mx) * (y - my)).sum::<f64>()
        / logs.iter().map(|(x, _)| (x - mx) * (x - mx)).sum::<f64>()
}

fn sound_of(surface: &Surface, slide: &Slide, seconds: f64, seed: u64) -> Vec<[f64; 3]> {
    let clock = clock(seconds);
    let mut buffer = vec![[0.0; 3]; clock.samples];
    surface.sound(&Rub::of(slide), 1.0, clock, &mut rng(seed), &mut buffer);
    buffer
}

#[test]
fn the_polynomial_sine_is_a_sine() {
    let worst = (-4000..4000)
        .map(|i| {
            let turns = i as f64 * 0.000_731;
            (sin_turns(turns) - sin(TAU * turns)).abs().max((cos_turns(turns) - cos(TAU * turns)).abs())
        })
        .fold(0.0, f64::max);
    println!("largest error of the sine: {worst:.1e}, expected below 4e-6");
    assert!(worst < 4e-6);
}

#[test]
fn a_texture_line_moves_in_proportion_to_speed() {
    let object = Object { texture_mm: vec![0.08], texture_share: 1.0, stick_slip: 0.0, ..plain().clone() };
    let surface = Surface::draw(&mut rng(1), &object);
    let peak = |speed| {
        let g = sound_of(&surface, &sliding(speed, 2.0, 1.0), 1.0, 2);
        let power = |hz: &f64| power_at(&g, *hz);
        let scan: Vec<f64> = (20..1200).map(|i| f64::from(i) * 0.5).collect();
        scan.into_iter().max_by(|a, b| power(a).total_cmp(&power(b))).unwrap()
    };
    let (slow, fast) = (peak(5.0), peak(15.0));
    println!("line at 5 mm/s {slow} Hz (v/λ 62.5), at 15 mm/s {fast} Hz (187.5), ratio {:.3}", fast / slow);
    assert!((fast / slow / 3.0 - 1.0).abs() < 0.02 && (slow / 62.5 - 1.0).abs() < 0.02);
}

#[test]
fn the_asperity_roll_off_moves_in_proportion_to_speed() {
    let mut surface = Surface::draw(&mut rng(3), plain());
    surface.asperity_mm = 0.02;
    let corner = |speed| {
        let power = spectrum(&sound_of(&surface, &sliding(speed, 2.0, 40.0), 40.0, 4));
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
    let (slow, fast) = (corner(4.0), corner(8.0));
    println!(
        "roll-off at 4 mm/s {slow:.0} Hz (v/λ_c 200), at 8 mm/s {fast:.0} Hz (400), ratio {:.2}",
        fast / slow
    );
    assert!((fast / slow / 2.0 - 1.0).abs() < 0.1);
}

#[test]
fn levels_follow_the_configured_exponents() {
    for seed in 0..4 {
        let surface = Surface::draw(&mut rng(10 + seed), plain());
        let level = |speed: f64, force: f64| {
            let g = sound_of(&surface, &sliding(speed, force, 40.0), 40.0, 20 + seed);
            // The amplitude is the rms less what the roll-off lets through.
            rms(&g) / signal::blend_rms(signal::blend(speed / surface.asperity_mm, RATE_HZ))
        };
        let over_speed = slope(&[2.0, 5.0, 10.0, 15.0, 18.0].map(|v| (v, level(v, 2.0))));
        let over_force = slope(&[0.5, 1.0, 2.0, 4.0, 8.0].map(|f| (f, level(10.0, f))));
        println!(
            "amplitude over speed {over_speed:.3} (configured {:.3}), over force {over_force:.3} ({:.3})",
            surface.speed_exponent, surface.force_exponent
        );
        assert!((over_speed / surface.speed_exponent - 1.0).abs() < 0.05);
        assert!((over_force / surface.force_exponent - 1.0).abs() < 0.05);
    }
}

/// Level and spectrum of slip through the modes of units drawn anew, mg rms above 10 Hz.
fn through_modes(platform: Platform, speed: f64, draws: u64) -> (f64, Vec<f64>) {
    let held = Held::new(2.0, 0.0, 0.6);
    let scene = Scene { platform, ..held.scene(VibrationModel::Modal) };
    let slide = sliding(speed, 2.0, 0.6);
    let mut mean = vec![0.0; 128];
    let levels = (0..draws)
        .map(|seed| {
            let mut rng = rng(1000 + seed);
            let sound = Sound::draw(&mut rng, &scene);
            let modes = Modes::draw(&mut rng, platform).in_grasp(&mut rng, Region::Centre);
            let mut g = vec![[0.0; 3]; clock(0.6).samples];
            sound.slip(&slide, 0, clock(0.6), &mut rng, &mut g);
            modes.respond(&scene, None, clock(0.6), &mut g);
            mean.iter_mut().zip(spectrum(&g[..1024])).for_each(|(m, p)| *m += p);
            rms_above_10_hz(&g) * 1e3
        })
        .collect();
    (median(levels), mean)
}

const SPEEDS_MM_S: [f64; 5] = [2.0, 5.0, 10.0, 15.0, 18.0];
const ANCHOR_MG: [f64; 5] = [4.0, 13.0, 30.0, 49.0, 60.0];

#[test]
fn levels_meet_the_anchor() {
    let umi = SPEEDS_MM_S.map(|v| through_modes(Platform::Umi, v, 120).0);
    let tesollo = SPEEDS_MM_S.map(|v| through_modes(Platform::Tesollo, v, 120).0);
    println!("median level at {SPEEDS_MM_S:?} mm/s, 2 N, Ra 1 µm: {umi:.1?} mg, expected {ANCHOR_MG:?}");
    println!("on a jointed hand: {tesollo:.1?} mg (synthetic)");
    for (level, anchor) in umi.iter().zip(ANCHOR_MG) {
        assert!((level / anchor - 1.0).abs() < 0.25, "{level} mg against {anchor} mg");
    }
}

#[test]
fn the_autoregressive_model_is_stable_as_loud_and_otherwise_coloured() {
    let mut largest: f64 = 0.0;
    for seed in 0..50 {
        let texture = Texture::draw(&mut rng(seed), plain());
        for v in 1..60 {
            for f in [0.2, 0.7, 1.3, 3.0, 6.0, 12.0] {
                for k in texture.at(f64::from(v), f) {
                    largest = largest.max(k.abs());
                }
            }
        }
    }
    println!("largest reflection coefficient {largest:.4}, stable below 1");
    assert!(largest < 1.0);
    for (speed, anchor) in SPEEDS_MM_S.into_iter().zip(ANCHOR_MG) {
        let mut mean = vec![0.0; 128];
        let levels = (0..120)
            .map(|seed| {
                let mut rng = rng(2000 + seed);
                let texture = Texture::draw(&mut rng, plain());
                let mut g = vec![[0.0; 3]; clock(0.6).samples];
                texture.add(&sliding(speed, 2.0, 0.6), clock(0.6), &mut rng, &mut g);
                mean.iter_mut().zip(spectrum(&g[..1024])).for_each(|(m, p)| *m += p);
                rms_above_10_hz(&g) * 1e3
            })
            .collect();
        let level = median(levels);
        let (modal, modal_mean) = through_modes(Platform::Umi, speed, 120);
        let centroid = |p: &[f64]| {
            p.iter().enumerate().map(|(i, p)| i as f64 * 31.25 * p).sum::<f64>() / p.iter().sum::<f64>()
        };
        // Half the sum of differences between spectra of unit power: 0 the same, 1 nothing in common.
        let (a, b) = (mean.iter().sum::<f64>(), modal_mean.iter().sum::<f64>());
        let apart: f64 = mean.iter().zip(&modal_mean).map(|(x, y)| (x / a - y / b).abs()).sum::<f64>() / 2.0;
        println!(
            "{speed} mm/s: autoregressive {level:.1} mg, modal {modal:.1}, anchor {anchor}; centroids \
             {:.0} and {:.0} Hz, spectra {apart:.2} apart (synthetic)",
            centroid(&mean),
            centroid(&modal_mean)
        );
        assert!((level / modal).max(modal / level) < 1.5);
        assert!(apart > 0.1);
    }
}

#[test]
fn stick_slip_comes_at_the_period_of_its_formula() {
    let object = Object { stick_slip: 1.0, ..plain().clone() };
    let slack = object.mu_static - object.mu_kinetic;
    for seed in 0..6 {
        let surface = Surface::draw(&mut rng(seed), &object);
        let pulses = surface.pulses(&Rub::of(&sliding(2.0, 2.0, 20.0)), 1.0, &mut rng(seed));
        let stiffness = 2.0 * slack / surface.stick_spacing_mm_per_n();
        let expected = (stiffness * 2.0 / (2.0 * slack * 2.0)).min(2200.0);
        let rate = pulses.len() as f64 / 20.0;
        println!("K {stiffness:.1} N/mm: {rate:.1} pulses per second, K v / (2 Δμ N) = {expected:.1}");
        assert!((rate / expected - 1.0).abs() < 0.12);
    }
}

#[test]
fn spreading_slip_ticks_weakly() {
    let steps = 2400;
    let spreading = Slide {
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
        let weak = surface.pulses(&Rub::of(&spreading), 1.0, &mut rng(seed));
        let gross = surface.pulses(&Rub::of(&sliding(10.0, 2.0, 5.0)), 1.0, &mut rng(seed));
        counts.push(weak.len() as f64);
        ratios.push(mean(&weak) / mean(&gross));
    }
    let (ratio, count) = (median(ratios), counts.iter().sum::<f64>() / counts.len() as f64);
    println!("incipient over gross {ratio:.2} (0.05 to 0.3), {count:.1} pulses for half the patch (20)");
    assert!((0.04..0.3).contains(&ratio) && (16.0..24.0).contains(&count));
}

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
    let slide = sliding(10.0, 2.0, 0.5);
    let motion = |leak: bool, silent: bool| {
        let scene = Scene { rig_leak: leak, ..held.scene(VibrationModel::Modal) };
        let mut sound = Sound::draw(&mut rng(8), &scene);
        if silent {
            sound.rig.silence();
        }
        let modes = Modes::draw(&mut rng(9), Platform::Umi);
        sound.motion_g(&scene, &slide, &modes, 0, clock(0.5), &mut rng(10))
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
            let mut sound = Sound::draw(&mut rng(seed), &scene);
            sound.disturbances.quiet();
            let slide = Slide { fraction: vec![0.0; 2402], ..sliding(0.0, grip_n, 1.0) };
            let modes = Modes::draw(&mut rng(seed), Platform::Umi);
            rms_above_10_hz(&sound.motion_g(&scene, &slide, &modes, 0, clock(1.0), &mut rng(seed))) * 1e3
        });
        median(levels.collect())
    };
    let (gripped, open) = (heard(2.0), heard(0.0));
    println!("drag at 20 mm/s: {gripped:.1} mg gripped, {open:.3} mg with open jaws (synthetic)");
    assert!((5.0..100.0).contains(&gripped) && open < 1e-3);
}

#[test]
fn a_drifting_clock_and_its_inverse_agree() {
    let clock = Clock { rate_hz: 8_180.0, drift_per_s: 5e-6, start: 0.4, samples: 1_000_000 };
    let worst = (0..1_000_000)
        .step_by(997)
        .map(|n| (clock.periods(clock.time(n)) - n as f64).abs())
        .fold(0.0, f64::max);
    println!("clock against its inverse over two minutes: {worst:.1e} samples");
    assert!(worst < 1e-6);
    let ends = clock.ends(28_800, 240.0);
    assert!(ends.windows(2).all(|w| (33..=35).contains(&(w[1] - w[0]))));
}

#[test]
fn levels_are_stated_at_the_reference() {
    let surface = Surface::draw(&mut rng(11), plain());
    assert_eq!(surface.amplitude_g(REFERENCE_MM_S, REFERENCE_N), surface.level_g);
    let g = sound_of(&surface, &sliding(REFERENCE_MM_S, REFERENCE_N, 20.0), 20.0, 12);
    println!("rms at the reference {:.2} mg, stated {:.2}", rms(&g) * 1e3, surface.level_g * 1e3);
    assert!((rms(&g) / surface.level_g - 1.0).abs() < 0.03);
}

/// A scene's motion without rig, impacts, machines nearby and modes: gravity and what bypasses the modes.
fn bare(scene: &Scene<'_>, seed: u64, seconds: f64) -> Vec<[f64; 3]> {
    let mut sound = Sound::draw(&mut rng(seed), scene);
    sound.disturbances.quiet();
    let mut modes = Modes::draw(&mut rng(seed), scene.platform);
    modes.modes.iter_mut().for_each(|m| m.weight = 0.0);
    let slide = Slide { fraction: vec![0.0; scene.grip_n.len()], ..sliding(0.0, 0.0, seconds) };
    let mut g = sound.motion_g(scene, &slide, &modes, 0, clock(seconds), &mut rng(seed));
    let mut gravity = vec![[0.0; 3]];
    sound.carriage.gravity(&mut gravity);
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
    let motion = |slide: &Slide| {
        let scene = Scene { heard: Heard::RigOnly, ..held.scene(VibrationModel::Modal) };
        Sound::draw(&mut rng(8), &scene).motion_g(&scene, slide, &modes, 0, clock(0.5), &mut rng(10))
    };
    let resting = Slide { fraction: vec![0.0; 1202], ..sliding(0.0, 2.0, 0.5) };
    assert_eq!(motion(&sliding(18.0, 2.0, 0.5)), motion(&resting));
}
