//! The FFT of CMSIS-DSP over many windows: what is in use against the port, and a hash of it all, by which this
//! computer and the emulated microcontroller are compared.

use core::fmt;

use slipsense::features::XlFrontEnd;
use slipsense::features::cmsis::{port, rfft, window};
use slipsense::features::highpass::FILTERED_MAX;
use slipsense::features::tables::HANN_Q31;
use slipsense::params::XL_WINDOW;

use crate::equality::Dice;

/// Windows of each kind, and frames of the whole front end.
const ROUNDS: u32 = 2500;
/// Accelerometer samples of a frame, rounded.
const BATCH: usize = 33;

type Samples = [i32; XL_WINDOW];
type Make = fn(&mut Dice, &mut Samples);

/// Windows as the library takes them: Q31, within what it can transform without overflow.
const KINDS: [(&str, Make); 7] = [
    ("full-scale noise", noise),
    ("noise of any level", noise_of_any_level),
    ("impulses of full scale", impulse),
    ("tones", tone),
    ("windowed noise", |dice, samples| {
        windowed(dice, samples, |dice| dice.next() as i32 % (FILTERED_MAX + 1))
    }),
    ("windowed extremes", |dice, samples| {
        windowed(dice, samples, |dice| [FILTERED_MAX, -FILTERED_MAX][dice.below(2)]);
    }),
    ("windowed extremes, signs of a bin", square),
];

/// What was compared. Printed, it is the same on both sides if they agree and neither differs from the port.
#[derive(Debug)]
pub struct Spectra {
    /// Windows by kind and how many of them came out otherwise than from the port.
    pub kinds: [(&'static str, u32); KINDS.len()],
    /// Of every word of every spectrum.
    pub hash: Hash,
    /// Of every feature of the front end.
    pub features: Hash,
}

/// FNV-1a over 32-bit words.
#[derive(Debug)]
pub struct Hash(u64);

impl Spectra {
    pub fn compare() -> Self {
        let mut dice = Dice(1);
        let mut hash = Hash::NEW;
        let kinds = KINDS.map(|(name, make)| {
            let differing = (0..ROUNDS).filter(|_| !is_equal(&mut dice, make, &mut hash)).count();
            (name, differing as u32)
        });
        Self { kinds, hash, features: front_end(&mut dice) }
    }
}

/// Transform one window; does the port say the same?
fn is_equal(dice: &mut Dice, make: Make, hash: &mut Hash) -> bool {
    let mut samples = [0; XL_WINDOW];
    make(dice, &mut samples);
    let mut same_samples = samples;
    let (mut spectrum, mut expected) = ([0; 2 * XL_WINDOW], [1; 2 * XL_WINDOW]);
    rfft(&mut samples, &mut spectrum);
    port::rfft(&mut same_samples, &mut expected);
    spectrum.iter().for_each(|&word| hash.add(word));
    spectrum == expected
}

/// Samples of any level to features.
fn front_end(dice: &mut Dice) -> Hash {
    let mut front_end = XlFrontEnd::new();
    let mut hash = Hash::NEW;
    for _ in 0..ROUNDS {
        let quieter = dice.below(16);
        let mut samples = [[0; 3]; BATCH];
        samples.as_flattened_mut().iter_mut().for_each(|sample| *sample = (dice.next() as i16) >> quieter);
        front_end.push(&samples);
        let features = front_end.log_mel();
        features.ln_power.iter().for_each(|&ln| hash.add(ln));
        features.standardised.iter().for_each(|&value| hash.add(value.into()));
    }
    hash
}

fn noise(dice: &mut Dice, samples: &mut Samples) {
    samples.iter_mut().for_each(|sample| *sample = dice.next() as i32 >> 1);
}

fn noise_of_any_level(dice: &mut Dice, samples: &mut Samples) {
    let quieter = dice.below(31);
    noise(dice, samples);
    samples.iter_mut().for_each(|sample| *sample >>= quieter);
}

fn impulse(dice: &mut Dice, samples: &mut Samples) {
    samples[dice.below(XL_WINDOW)] = [i32::MIN, i32::MAX, -1, 1][dice.below(4)];
}

fn tone(dice: &mut Dice, samples: &mut Samples) {
    let (bin, phase, quieter) = (dice.below(XL_WINDOW), dice.below(XL_WINDOW), dice.below(31));
    for (n, sample) in samples.iter_mut().enumerate() {
        *sample = half_cosine(bin * n + phase) >> quieter;
    }
}

/// What drives the bins furthest.
fn square(dice: &mut Dice, samples: &mut Samples) {
    let (bin, phase) = (dice.below(XL_WINDOW), dice.below(XL_WINDOW));
    let mut n = phase;
    windowed(dice, samples, |_| {
        n += bin;
        if half_cosine(n) < 0 { -FILTERED_MAX } else { FILTERED_MAX }
    });
}

fn windowed(dice: &mut Dice, samples: &mut Samples, mut filtered: impl FnMut(&mut Dice) -> i32) {
    window(&core::array::from_fn(|_| filtered(dice)), samples);
}

/// cos(2π·n/128) / 2, Q31, from the window.
fn half_cosine(n: usize) -> i32 {
    i32::MAX / 2 - HANN_Q31[n % XL_WINDOW]
}

impl Hash {
    const NEW: Self = Self(0xcbf2_9ce4_8422_2325);

    fn add(&mut self, word: i32) {
        self.0 = (self.0 ^ u64::from(word as u32)).wrapping_mul(0x0100_0000_01b3);
    }
}

impl fmt::Display for Spectra {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (name, differing) in &self.kinds {
            writeln!(f, "{name}: {differing} of {ROUNDS} windows differ from the port in any bit")?;
        }
        writeln!(f, "hash of {} spectra: {:016x}", ROUNDS * KINDS.len() as u32, self.hash.0)?;
        write!(f, "hash of the features of {ROUNDS} frames: {:016x}", self.features.0)
    }
}
