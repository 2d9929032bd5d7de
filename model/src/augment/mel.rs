//! Changes of what an accelerometer measures, and the standardisation and the noise floor after them.

use std::ops::Range;

use rand::Rng;
use rand_chacha::ChaCha8Rng;
use slipsense::features::floor::{FALL_SHIFT, FIRST_FRAMES, OVER_FLOOR_FRAC_BITS, RISE_SHIFT};
use slipsense::features::{STANDARDISE_EPSILON_Q32, STANDARDISED_FRAC_BITS};
use slipsense::params::MEL_BINS;

/// Share of sequences in which something else sounds.
const WITH_SOUND: f64 = 0.6;
const BURSTS_MAX: usize = 3;
const BURST_FRAMES: Range<usize> = 2..120;
/// Level of a burst over the mean of the sequence, nat of power.
const BURST_LEVEL: Range<f32> = -1.0..4.0;
/// Level of a machine over the mean of the sequence, nat, and of its tones over that.
const MACHINE_LEVEL: Range<f32> = -3.0..2.0;
const TONE_LEVEL: Range<f32> = 1.0..5.0;
/// Frames from which on a sound that is there at the start of a sequence has been there before it.
const LASTING_FRAMES: usize = 120;
const TONES_MAX: usize = 4;
/// Largest slow change of the response over the bins, nat: units and mounts differ by some tenths, the modes
/// of another hand's fingers by more.
const COLOUR: f32 = 1.5;
/// Share of sensors whose vibration comes by another path; its level, and its largest slow change over the bins, nat.
/// Recorded sliding differs from the families' by 2 to 3 nat RMS (`slipsense families`).
const OTHER_PATH: f64 = 0.6;
const PATH_LEVEL: Range<f32> = -1.5..1.0;
const PATH_SHAPE: f32 = 4.0;
/// Most mel bins masked.
const MASK_MAX: usize = 5;
/// Largest amplitude of the uniform noise on standardised log-mel.
const NOISE_LOG_MEL: f32 = 0.1;
/// Largest feature that the front end has.
const LARGEST: f32 = i16::MAX as f32 / (1 << STANDARDISED_FRAC_BITS) as f32;

/// Three slow waves over the bins, the slowest the largest.
fn slow_shape(amplitude: f32, rng: &mut ChaCha8Rng) -> [f32; MEL_BINS] {
    let waves: [f32; 3] =
        std::array::from_fn(|wave| rng.random_range(-1.0..1.0f32) * amplitude / (wave + 1) as f32);
    std::array::from_fn(|bin| {
        let turn = std::f32::consts::PI * (bin as f32 + 0.5) / MEL_BINS as f32;
        waves.iter().zip(1u8..).map(|(wave, n)| wave * (turn * f32::from(n)).cos()).sum()
    })
}

/// Vibration from elsewhere, the same at all sensors: bursts such as knocks, or a machine such as the hand's motor.
#[derive(Clone, Debug, Default)]
pub struct Sound {
    bursts: Vec<Burst>,
}

#[derive(Clone, Debug)]
struct Burst {
    frames: Range<usize>,
    /// Nat over the mean of the sequence.
    spectrum: [f32; MEL_BINS],
    /// Fall per frame, nat.
    decay: f32,
}

impl Burst {
    /// Broad noise with a few tones, from the start or some time on.
    fn machine(frames: usize, rng: &mut ChaCha8Rng) -> Self {
        let level = rng.random_range(MACHINE_LEVEL);
        let mut spectrum = slow_shape(2.0, rng).map(|shape| level + shape);
        for _ in 0..rng.random_range(0..=TONES_MAX) {
            spectrum[rng.random_range(0..MEL_BINS)] += rng.random_range(TONE_LEVEL);
        }
        let start = if rng.random_bool(0.5) { 0 } else { rng.random_range(0..frames) };
        let end = if rng.random_bool(0.5) { frames } else { rng.random_range(start..frames) + 1 };
        Self { frames: start..end, spectrum, decay: 0.0 }
    }
}

impl Sound {
    /// None in 40 % of the sequences, else a machine or one to three bursts within `frames` frames.
    pub fn draw(frames: usize, rng: &mut ChaCha8Rng) -> Self {
        if !rng.random_bool(WITH_SOUND) {
            return Self::default();
        }
        if rng.random_bool(0.5) {
            return Self { bursts: vec![Burst::machine(frames, rng)] };
        }
        let bursts = (0..rng.random_range(1..=BURSTS_MAX)).map(|_| {
            let start = rng.random_range(0..frames);
            let level = rng.random_range(BURST_LEVEL);
            let spectrum = slow_shape(2.0, rng).map(|shape| level + shape);
            let decay = if rng.random_bool(0.5) { rng.random_range(0.01..0.3) } else { 0.0 };
            Burst { frames: start..start + rng.random_range(BURST_FRAMES), spectrum, decay }
        });
        Self { bursts: bursts.collect() }
    }

    /// The floors of a sequence's first frame with it: a machine that runs then has run before.
    fn add_to_floor(&self, mean: f32, floor: &mut [f32; MEL_BINS]) {
        let lasting = self.bursts.iter().filter(|burst| burst.decay == 0.0 && burst.frames.start == 0);
        Self { bursts: lasting.filter(|burst| burst.frames.len() > LASTING_FRAMES).cloned().collect() }
            .add(0, mean, floor);
    }

    /// Add it to one frame, ln of power. `mean`: of the sequence.
    fn add(&self, frame: usize, mean: f32, ln_power: &mut [f32; MEL_BINS]) {
        for burst in self.bursts.iter().filter(|burst| burst.frames.contains(&frame)) {
            let fallen = burst.decay * (frame - burst.frames.start) as f32;
            for (ln, spectrum) in ln_power.iter_mut().zip(&burst.spectrum) {
                let sound = mean + spectrum - fallen;
                let (louder, softer) = (ln.max(sound), ln.min(sound));
                *ln = louder + (softer - louder).exp().ln_1p();
            }
        }
    }
}

/// How one accelerometer's frames are changed.
#[derive(Clone, Debug)]
pub struct MelChange {
    colour: [f32; MEL_BINS],
    /// Gain of what is above the noise floor, nat.
    path: [f32; MEL_BINS],
    masked: Range<usize>,
    noise: f32,
}

impl MelChange {
    /// None: the frames as the front end has them.
    pub const NONE: Self = Self { colour: [0.0; MEL_BINS], path: [0.0; MEL_BINS], masked: 0..0, noise: 0.0 };

    /// A colour, often another path, one to five neighbouring bins masked in half of the cases, and some noise.
    pub fn draw(rng: &mut ChaCha8Rng) -> Self {
        let width = if rng.random_bool(0.5) { rng.random_range(1..=MASK_MAX) } else { 0 };
        let from = rng.random_range(0..=MEL_BINS - width);
        let path = if rng.random_bool(OTHER_PATH) {
            let level = rng.random_range(PATH_LEVEL);
            slow_shape(rng.random_range(0.0..PATH_SHAPE), rng).map(|shape| level + shape)
        } else {
            [0.0; MEL_BINS]
        };
        Self {
            colour: slow_shape(rng.random_range(0.0..COLOUR), rng),
            path,
            masked: from..from + width,
            noise: rng.random_range(0.0..NOISE_LOG_MEL),
        }
    }

    /// The floors at the start of a sequence, from those of the episode there, of which `frame` frames have passed.
    pub fn floor(&self, floor: &[f32; MEL_BINS], frame: usize, (sound, mean): (&Sound, f32)) -> Floor {
        let mut floor = *floor;
        sound.add_to_floor(mean, &mut floor);
        floor.iter_mut().zip(&self.colour).for_each(|(floor, colour)| *floor += colour);
        Floor { floor, warm_up_frames: (FIRST_FRAMES as usize).saturating_sub(frame) }
    }

    /// One frame's ln of power to what the network sees; a masked bin becomes 0, the mean of a standardised frame.
    /// `mean` of the sequence's ln of power, `frame` of the sequence.
    pub fn apply(
        &self,
        ln_power: &[f32; MEL_BINS],
        floor: &mut Floor,
        (sound, mean, frame): (&Sound, f32, usize),
        out: &mut [f32],
        rng: &mut ChaCha8Rng,
    ) {
        let mut ln = *ln_power;
        sound.add(frame, mean, &mut ln);
        for (ln, colour) in ln.iter_mut().zip(&self.colour) {
            *ln += colour;
        }
        for ((ln, floor), path) in ln.iter_mut().zip(&floor.floor).zip(&self.path) {
            let above = (*ln - floor).exp_m1();
            if above > 0.0 {
                *ln = floor + (above * path.exp()).ln_1p();
            }
        }
        let seen = standardise(&ln).into_iter().chain(floor.step(&ln));
        for (feature, (out, value)) in out.iter_mut().zip(seen).enumerate() {
            *out = if self.masked.contains(&(feature % MEL_BINS)) {
                0.0
            } else {
                value + self.noise * rng.random_range(-1.0..1.0f32)
            };
        }
    }
}

/// The noise floors of one sensor, nat: the front end's, in float.
#[derive(Clone, Debug)]
pub struct Floor {
    floor: [f32; MEL_BINS],
    /// Frames until the window holds nothing but samples.
    warm_up_frames: usize,
}

impl Floor {
    /// How far a frame is above the floors, as the network sees it.
    fn step(&mut self, ln: &[f32; MEL_BINS]) -> [f32; MEL_BINS] {
        const _: () = assert!(OVER_FLOOR_FRAC_BITS + 1 == STANDARDISED_FRAC_BITS, "seen as half as much");
        if let Some(left) = self.warm_up_frames.checked_sub(1) {
            *self = Self { floor: *ln, warm_up_frames: left };
            return [0.0; MEL_BINS];
        }
        std::array::from_fn(|bin| {
            let difference = ln[bin] - self.floor[bin];
            let shift = if difference > 0.0 { RISE_SHIFT } else { FALL_SHIFT };
            self.floor[bin] += difference / (1 << shift) as f32;
            (difference / 2.0).clamp(-LARGEST, LARGEST)
        })
    }
}

/// As the front end's, in float: changed frames are made nowhere else.
fn standardise(ln: &[f32; MEL_BINS]) -> [f32; MEL_BINS] {
    let mean = ln.iter().sum::<f32>() / MEL_BINS as f32;
    let variance = ln.iter().map(|x| (x - mean).powi(2)).sum::<f32>() / MEL_BINS as f32;
    let epsilon = STANDARDISE_EPSILON_Q32 as f32 / 2f32.powi(32);
    ln.map(|x| ((x - mean) / (variance + epsilon).sqrt()).clamp(-LARGEST, LARGEST))
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use slipsense::features::{LN_FRAC_BITS, XlFrontEnd};
    use slipsense::params::XL_FEATURES;

    #[test]
    fn a_mask_hides_at_most_five_bins() {
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let mut hidden = [0; MASK_MAX + 1];
        let ln: [f32; MEL_BINS] = std::array::from_fn(|bin| bin as f32);
        for _ in 0..200 {
            let mut out = [0.0; XL_FEATURES];
            let (change, sound) = (MelChange::draw(&mut rng), Sound::default());
            let mut floor = change.floor(&[-1.0; MEL_BINS], 4, (&sound, 0.0));
            change.apply(&ln, &mut floor, (&sound, 0.0, 0), &mut out, &mut rng);
            hidden[out.iter().filter(|&&x| x == 0.0).count() / 2] += 1;
        }
        assert!(hidden.iter().all(|&n| n > 0) && hidden[0] > 60, "{hidden:?}");
    }

    #[test]
    fn an_unchanged_frame_is_the_front_ends() {
        let mut rng = ChaCha8Rng::seed_from_u64(4);
        let mut front_end = XlFrontEnd::new();
        let mut floor = None;
        for frame in 0..50 {
            let samples: Vec<[i16; 3]> =
                (0..33).map(|_| std::array::from_fn(|_| rng.random_range(-900..900))).collect();
            front_end.push(&samples);
            let real = |q: i32| q as f32 / (1 << LN_FRAC_BITS) as f32;
            let before = front_end.noise_floor().floor().map(real);
            let log_mel = front_end.log_mel();
            let ln = log_mel.ln_power.map(real);
            let (mut out, sound) = ([0.0; XL_FEATURES], Sound::default());
            let floor = floor.get_or_insert_with(|| MelChange::NONE.floor(&before, frame, (&sound, 0.0)));
            MelChange::NONE.apply(&ln, floor, (&sound, 0.0, 0), &mut out, &mut rng);
            for (ours, theirs) in out.iter().zip(log_mel.features()) {
                let theirs = f32::from(theirs) / (1 << STANDARDISED_FRAC_BITS) as f32;
                assert!((ours - theirs).abs() < 2e-3, "{ours} {theirs}");
            }
        }
    }

    #[test]
    fn a_sound_only_adds_power_and_only_while_it_lasts() {
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        let mut changed = 0;
        for _ in 0..50 {
            let sound = Sound::draw(100, &mut rng);
            for frame in 0..100 {
                let mut ln = [3.0; MEL_BINS];
                sound.add(frame, 3.0, &mut ln);
                assert!(ln.iter().all(|&x| x >= 3.0));
                let sounds = sound.bursts.iter().any(|burst| burst.frames.contains(&frame));
                assert_eq!(ln.iter().any(|&x| x > 3.0), sounds);
                changed += usize::from(sounds);
            }
        }
        assert!((500..4000).contains(&changed), "{changed}");
    }
}
