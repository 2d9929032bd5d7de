//! The front end against float64: golden vectors from librosa and scipy, a plain float64 reference of
//! its own for what needs many signals, and properties at the extremes. All signals are synthetic.
//! `cargo test -p slipsense --test host features:: -- --nocapture` prints the figures.

use proptest::prelude::*;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde_json::Value;
use slipsense::features::fft::Complex;
use slipsense::features::highpass::{FILTERED_FRAC_BITS, FILTERED_MAX, HighPassState};
use slipsense::features::log::{LOG_FLOOR_LSB2, ln_q16};
use slipsense::features::mel::mel_power;
use slipsense::features::power::{POWER_FRAC_BITS, add_power};
use slipsense::features::ring::Ring;
use slipsense::features::tables::HIGHPASS;
use slipsense::features::transform::{Work, windowed_fft};
use slipsense::features::{LN_FRAC_BITS, LogMel, STANDARDISED_FRAC_BITS, XlFrontEnd};
use slipsense::params::{FFT_BINS, HIGHPASS_HZ, MEL_BINS, MEL_HIGH_HZ, MEL_LOW_HZ, XL_RATE_HZ, XL_WINDOW};
use slipsense::sensor::XlSample;
use std::f64::consts::{LN_10, PI, SQRT_2};

/// 20 dB above the floor, as a natural logarithm of power.
const CLEAR_NAT: f64 = 2.0 * LN_10;
/// Worst error asked for where the power is 20 dB above the floor; the one reached there, and the one reached
/// anywhere. The FFT of CMSIS-DSP cuts products off where ours rounds them.
const REQUIRED_NAT: f64 = 0.02;
const REACHED_NAT: f64 = if cfg!(feature = "cmsis-dsp") { 2.5e-3 } else { 1e-3 };
const REACHED_ANYWHERE_NAT: f64 = if cfg!(feature = "cmsis-dsp") { 0.03 } else { 0.01 };
const _: () = assert!(REACHED_NAT <= REQUIRED_NAT);

/// √(4/3), the gain of the FFT, or √(2/3), with the FFT of CMSIS-DSP.
const FFT_GAIN: f64 =
    if cfg!(feature = "cmsis-dsp") { 0.816_496_580_927_726 } else { 1.154_700_538_379_251_5 };

/// Signal to noise of window and FFT that their documentation states, at 32,767, 500 and 10 LSB.
const SNR_DB: [f64; 3] = if cfg!(feature = "cmsis-dsp") { [127.0, 91.0, 58.0] } else { [138.0, 102.0, 69.0] };

fn nat(ln_power: i32) -> f64 {
    ln_power as f64 / (1u32 << LN_FRAC_BITS) as f64
}

fn standard(value: i16) -> f64 {
    value as f64 / (1u32 << STANDARDISED_FRAC_BITS) as f64
}

/// The textbook high-pass of one axis, primed with the first sample.
fn highpass_f64(x: &[f64]) -> Vec<f64> {
    let k = (PI * HIGHPASS_HZ as f64 / XL_RATE_HZ as f64).tan();
    let norm = 1.0 + SQRT_2 * k + k * k;
    let (a1, a2) = (2.0 * (k * k - 1.0) / norm, (1.0 - SQRT_2 * k + k * k) / norm);
    let (mut x1, mut x2, mut y1, mut y2) = (x[0], x[0], 0.0, 0.0);
    let step = |&x: &f64| {
        let y = (x - 2.0 * x1 + x2) / norm - a1 * y1 - a2 * y2;
        (x2, x1, y2, y1) = (x1, x, y1, y);
        y
    };
    x.iter().map(step).collect()
}

/// Bins 0 to 64 of the defining sum under the Hann window.
fn dft_f64(x: impl IntoIterator<Item = f64>) -> Vec<(f64, f64)> {
    let hann = |n: usize| 0.5 - 0.5 * (2.0 * PI * n as f64 / XL_WINDOW as f64).cos();
    let x: Vec<f64> = x.into_iter().enumerate().map(|(n, x)| x * hann(n)).collect();
    let bin = |k: usize| {
        x.iter().enumerate().fold((0.0, 0.0), |(re, im), (n, &x)| {
            let angle = -2.0 * PI * (k * n % XL_WINDOW) as f64 / XL_WINDOW as f64;
            (re + x * angle.cos(), im + x * angle.sin())
        })
    };
    (0..FFT_BINS).map(bin).collect()
}

fn log_mel_f64(samples: &[[f64; 3]]) -> [f64; MEL_BINS] {
    let mut power = [0.0; FFT_BINS];
    for axis in 0..3 {
        let filtered = highpass_f64(&samples.iter().map(|s| s[axis]).collect::<Vec<_>>());
        let window = filtered[filtered.len() - XL_WINDOW..].iter().copied();
        for (power, (re, im)) in power.iter_mut().zip(dft_f64(window)) {
            *power += re * re + im * im;
        }
    }
    let mel = |hz: f64| 2595.0 * (1.0 + hz / 700.0).log10();
    let (low, high) = (mel(MEL_LOW_HZ as f64), mel(MEL_HIGH_HZ as f64));
    let step = (high - low) / (MEL_BINS + 1) as f64;
    let edge = |i: usize| 700.0 * (10f64.powf((low + step * i as f64) / 2595.0) - 1.0);
    core::array::from_fn(|i| {
        let (left, peak, right) = (edge(i), edge(i + 1), edge(i + 2));
        let weighted = power.iter().enumerate().map(|(k, power)| {
            let hz = k as f64 * XL_RATE_HZ as f64 / XL_WINDOW as f64;
            ((hz - left) / (peak - left)).min((right - hz) / (right - peak)).max(0.0) * power
        });
        weighted.sum::<f64>().max(LOG_FLOOR_LSB2 as f64).ln()
    })
}

fn log_mel_of(samples: &[XlSample]) -> LogMel {
    let mut front_end = XlFrontEnd::new();
    front_end.push(samples);
    front_end.log_mel()
}

fn numbers(value: &Value) -> Vec<f64> {
    value.as_array().expect("an array").iter().map(|v| v.as_f64().expect("a number")).collect()
}

fn table(value: &Value) -> Vec<Vec<f64>> {
    value.as_array().expect("an array").iter().map(numbers).collect()
}

#[test]
fn log_mel_agrees_with_librosa_and_scipy() {
    let file: Value = serde_json::from_str(include_str!("vectors/logmel_vectors.json")).expect("JSON");
    let (mut worst, mut sum, mut count) = (0f64, 0.0, 0);
    let (mut worst_any, mut worst_standard) = (0f64, 0f64);
    for signal in file["signals"].as_array().expect("signals") {
        let name = signal["name"].as_str().expect("a name");
        let axes = table(&signal["axes"]);
        let samples: Vec<XlSample> =
            (0..axes[0].len()).map(|n| core::array::from_fn(|axis| axes[axis][n] as i16)).collect();
        let (expected, expected_standard) = (table(&signal["ln_power"]), table(&signal["standardised"]));
        let mut front_end = XlFrontEnd::new();
        let (mut start, mut worst_here) = (0, 0f64);
        for (frame, &hop) in numbers(&signal["hops"]).iter().enumerate() {
            front_end.push(&samples[start..start + hop as usize]);
            start += hop as usize;
            let ours = front_end.log_mel();
            for bin in 0..MEL_BINS {
                let error = (nat(ours.ln_power[bin]) - expected[frame][bin]).abs();
                worst_any = worst_any.max(error);
                if expected[frame][bin] >= CLEAR_NAT {
                    worst_here = worst_here.max(error);
                    sum += error;
                    count += 1;
                }
                let off = (standard(ours.standardised[bin]) - expected_standard[frame][bin]).abs();
                worst_standard = worst_standard.max(off);
            }
        }
        assert_eq!(start, samples.len(), "{name}: the hops cover the samples");
        println!("{name:22} worst {worst_here:.2e} nat");
        worst = worst.max(worst_here);
    }
    println!(
        "log-mel against float64, {count} values at least 20 dB above the floor: worst {worst:.2e} nat, \
         mean {:.2e} nat; anywhere {worst_any:.2e} nat; standardised {worst_standard:.2e}",
        sum / count as f64
    );
    assert!(count > 2500, "only {count} values lie 20 dB above the floor");
    assert!(worst <= REACHED_NAT, "{worst} nat");
    assert!(worst_any <= REACHED_ANYWHERE_NAT, "anywhere {worst_any} nat");
    assert!(sum / count as f64 <= 1e-4 && worst_standard <= 0.005);
}

/// Bins 0 to 64 of the latest samples.
fn spectrum(ring: &Ring) -> [Complex; FFT_BINS] {
    let mut bins = [None; FFT_BINS];
    // What the room held before must not matter.
    let mut work = Work::default();
    windowed_fft(&[FILTERED_MAX; XL_WINDOW], &mut work, |_, _| {});
    windowed_fft(ring.latest(), &mut work, |bin, value| {
        assert_eq!(bins[bin].replace(value), None, "bin {bin} comes once");
    });
    bins.map(|bin| bin.expect("every bin comes"))
}

/// Energy of the reference over energy of the difference, dB.
fn snr_db(ours: &[Complex], reference: &[(f64, f64)], scale: f64) -> f64 {
    let (mut signal, mut noise) = (0.0, 0.0);
    for (ours, (re, im)) in ours.iter().zip(reference) {
        signal += re * re + im * im;
        noise += (ours.re as f64 / scale - re).powi(2) + (ours.im as f64 / scale - im).powi(2);
    }
    10.0 * (signal / noise).log10()
}

#[test]
fn window_and_fft_keep_their_signal_to_noise() {
    for (amplitude, least_db) in [32767.0, 500.0, 10.0].into_iter().zip(SNR_DB) {
        let mut worst = f64::INFINITY;
        for tenth_bin in 5..640 {
            let mut ring = Ring::new();
            let signal: Vec<f64> = (0..XL_WINDOW)
                .map(|n| (amplitude * (2.0 * PI * tenth_bin as f64 * n as f64 / 1280.0 + 0.3).sin()).round())
                .collect();
            signal.iter().for_each(|&x| ring.push((x as i32) << FILTERED_FRAC_BITS));
            worst = worst.min(snr_db(&spectrum(&ring), &dft_f64(signal), 256.0 * FFT_GAIN));
        }
        println!("window and FFT, amplitude {amplitude} LSB: {worst:.1} dB over 635 tones");
        assert!(worst >= least_db, "{worst} dB");
    }
}

#[test]
fn nothing_overflows_at_the_largest_filtered_samples() {
    // The signs line up with each bin in turn.
    for bin in 0..FFT_BINS {
        for quadrature in [0.0, PI / 2.0, PI / 4.0] {
            let mut ring = Ring::new();
            for n in 0..XL_WINDOW {
                let phase = 2.0 * PI * (bin * n % XL_WINDOW) as f64 / XL_WINDOW as f64 + quadrature;
                ring.push(if phase.cos() >= 0.0 { FILTERED_MAX } else { -FILTERED_MAX });
            }
            let exact = dft_f64(ring.latest().iter().map(|&x| f64::from(x)));
            // From Q14 to Q8.
            assert!(snr_db(&spectrum(&ring), &exact, FFT_GAIN / 64.0) > 130.0, "bin {bin}");
            let (mut power, mut work) = ([0; FFT_BINS], Work::default());
            (0..3).for_each(|_| add_power(&mut power, ring.latest(), &mut work));
            assert!(power[1..FFT_BINS - 1].iter().sum::<u64>() < 5 << 60);
            assert!(mel_power(&power).iter().all(|&p| nat(ln_q16(p)) < 33.3));
        }
    }
}

#[test]
fn high_pass_follows_float64_and_stays_within_its_bound() {
    // Full-scale input whose signs follow the impulse response backwards.
    let mut impulse = vec![0.0; 4000];
    impulse[0] = 1.0;
    // Primed with 1 the filter would see no step, so the impulse stands second.
    impulse.rotate_right(1);
    let response = highpass_f64(&impulse);
    let gain: f64 = response.iter().map(|h| h.abs()).sum();
    let worst_case: Vec<f64> =
        response.iter().rev().map(|&h| if h >= 0.0 { 32767.0 } else { -32768.0 }).collect();
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let uniform: Vec<f64> = (0..8000).map(|_| rng.random_range(-32767.0f64..32767.0).round()).collect();
    let motion: Vec<f64> =
        (0..8000).map(|n| (30000.0 * (2.0 * PI * n as f64 / 4000.0).sin()).round()).collect();
    let gravity_step: Vec<f64> = (0..8000).map(|n| if n < 50 { 2049.0 } else { -2049.0 }).collect();

    let (mut worst, mut largest) = (0f64, 0f64);
    for signal in [&worst_case, &uniform, &motion, &gravity_step] {
        let mut state = HighPassState::at_rest(signal[0] as i16);
        for (x, y) in signal.iter().zip(highpass_f64(signal)) {
            let ours = HIGHPASS.step(&mut state, *x as i16) as f64 / (1u32 << FILTERED_FRAC_BITS) as f64;
            worst = worst.max((ours - y).abs());
            largest = largest.max(ours.abs());
        }
    }
    println!("high-pass: sum |h| {gain:.5}, largest output {largest:.0} LSB, worst error {worst:.4} LSB");
    assert!((gain - 2.42346).abs() < 1e-4);
    assert!(largest < 131_072.0 && largest > 0.99 * gain * 32767.0);
    // 2.4e-6 of the largest output: the coefficients' rounding to Q30, at a few hertz only.
    assert!(worst < 0.2);
}

#[test]
fn gravity_leaves_nothing_behind() {
    // From the first sample on, and again one second after it turns: no limit cycle keeps a residue.
    assert_eq!(log_mel_of(&[[2049, -17, 300]; 500]), LogMel::default());
    let mut turned = vec![[2049, -17, 300]; 100];
    turned.extend([[-2049, 900, -32768]; 8000]);
    assert_eq!(log_mel_of(&turned), LogMel::default());
}

#[test]
fn logarithm_error_is_as_documented() {
    let mut worst = 0f64;
    let floor = LOG_FLOOR_LSB2 << POWER_FRAC_BITS;
    for octave in POWER_FRAC_BITS..63 {
        for part in 0..4096u64 {
            let power = (1 << octave) + (((1u128 << octave) * part as u128) >> 12) as u64;
            let exact = (power as f64 / floor as f64).ln();
            worst = worst.max((nat(ln_q16(power)) - exact).abs());
        }
    }
    println!("logarithm: worst error {worst:.2e} nat");
    assert!(worst < 1.6e-5);
    assert_eq!(ln_q16(0), 0);
    assert_eq!(ln_q16(floor), 0);
    assert!(ln_q16(u64::MAX) < 35 << LN_FRAC_BITS);
}

/// A rotation matrix from a unit quaternion, uniform over SO(3).
fn rotation(rng: &mut ChaCha8Rng) -> [[f64; 3]; 3] {
    let [w, x, y, z] = loop {
        let q: [f64; 4] = core::array::from_fn(|_| rng.random_range(-1.0..1.0));
        let square: f64 = q.iter().map(|v| v * v).sum();
        if (0.01..1.0).contains(&square) {
            break q.map(|v| v / square.sqrt());
        }
    };
    [
        [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
        [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
        [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
    ]
}

/// The paper's way: log-mel of each axis alone, then log-sum-exp over the axes.
fn log_sum_exp_f64(samples: &[[f64; 3]]) -> [f64; MEL_BINS] {
    let of_axis = |axis: usize| {
        let alone: Vec<[f64; 3]> =
            samples.iter().map(|s| core::array::from_fn(|at| if at == axis { s[at] } else { 0.0 })).collect();
        log_mel_f64(&alone)
    };
    let axes = [0, 1, 2].map(of_axis);
    core::array::from_fn(|bin| axes.iter().map(|axis| axis[bin].exp()).sum::<f64>().ln())
}

#[test]
fn rotation_changes_no_more_than_rounding() {
    let mut rng = ChaCha8Rng::seed_from_u64(7);
    let (mut reference_change, mut our_change, mut beyond_rounding) = (0f64, 0f64, 0f64);
    let (mut identity, mut our_identity) = (0f64, 0f64);
    for (trial, amplitude) in [15.0f64, 300.0, 15_000.0].into_iter().cycle().take(45).enumerate() {
        let signal: Vec<[f64; 3]> = (0..300)
            .map(|_| core::array::from_fn(|_| rng.random_range(-amplitude..amplitude).round()))
            .collect();
        let matrix = rotation(&mut rng);
        let rotated: Vec<[f64; 3]> =
            signal.iter().map(|s| matrix.map(|row| row[0] * s[0] + row[1] * s[1] + row[2] * s[2])).collect();
        let rounded: Vec<[f64; 3]> = rotated.iter().map(|s| s.map(f64::round)).collect();
        let whole = |s: &[[f64; 3]]| s.iter().map(|s| s.map(|x| x as i16)).collect::<Vec<_>>();

        let (before, after) = (log_mel_f64(&signal), log_mel_f64(&rotated));
        let (after_rounding, merged) = (log_mel_f64(&rounded), log_sum_exp_f64(&rounded));
        let (ours, ours_rotated) = (log_mel_of(&whole(&signal)), log_mel_of(&whole(&rounded)));
        for bin in 0..MEL_BINS {
            let change = nat(ours_rotated.ln_power[bin]) - nat(ours.ln_power[bin]);
            // What rounding the rotated samples to whole LSB does to exact arithmetic.
            let from_rounding = after_rounding[bin] - before[bin];
            reference_change = reference_change.max((after[bin] - before[bin]).abs());
            beyond_rounding = beyond_rounding.max((change - from_rounding).abs());
            identity = identity.max((merged[bin] - after_rounding[bin]).abs());
            our_identity = our_identity.max((merged[bin] - nat(ours_rotated.ln_power[bin])).abs());
            if trial % 3 == 2 {
                our_change = our_change.max(change.abs());
            }
        }
    }
    println!(
        "random rotations: the float64 reference changes by {reference_change:.1e} nat; ours by \
         {our_change:.1e} nat at 15,000 LSB, and at any level by {beyond_rounding:.1e} nat more than \
         rounding the rotated samples explains; log-sum-exp over the axes and the log of the summed power \
         differ by {identity:.1e} nat in float64, by {our_identity:.1e} nat from ours"
    );
    assert!(identity < 1e-9);
    assert!(our_identity < REACHED_NAT);
    assert!(reference_change < 1e-9);
    assert!(beyond_rounding < 1e-3);
    assert!(our_change < 2e-4);
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 48, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn cutting_the_signal_differently_changes_nothing(
        samples in prop::collection::vec(prop::array::uniform3(any::<i16>()), 0..500),
        cuts in prop::collection::vec(0usize..200, 0..20),
    ) {
        let mut front_end = XlFrontEnd::new();
        let mut rest = samples.as_slice();
        for cut in cuts {
            let (now, later) = rest.split_at(cut.min(rest.len()));
            front_end.push(now);
            rest = later;
        }
        front_end.push(rest);
        prop_assert_eq!(front_end.log_mel(), log_mel_of(&samples));
    }

    #[test]
    fn extremes_neither_panic_nor_leave_the_range(
        samples in prop::collection::vec(
            prop::array::uniform3(prop_oneof![Just(i16::MIN), Just(i16::MAX), Just(0i16), any::<i16>()]),
            0..400,
        ),
        held in 1usize..60,
    ) {
        // Held extremes drive the filter further than alternating ones.
        let held: Vec<XlSample> = samples.iter().flat_map(|&s| std::iter::repeat_n(s, held)).take(1500).collect();
        for signal in [&samples, &held] {
            let features = log_mel_of(signal);
            prop_assert!(features.ln_power.iter().all(|&ln| ln >= 0 && nat(ln) < 33.3));
            let limit = 15f64.sqrt() + 0.5 / (1u32 << STANDARDISED_FRAC_BITS) as f64;
            prop_assert!(features.standardised.iter().all(|&v| standard(v).abs() <= limit));
        }
    }

    #[test]
    fn swapping_axes_changes_not_one_bit(
        samples in prop::collection::vec(prop::array::uniform3(any::<i16>()), 1..300),
    ) {
        let swapped: Vec<XlSample> = samples.iter().map(|&[x, y, z]| [z, x, y]).collect();
        prop_assert_eq!(log_mel_of(&swapped), log_mel_of(&samples));
    }
}
