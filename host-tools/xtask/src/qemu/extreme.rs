//! Input that no sensor delivers for long: full scale, zeros, single taxels, alternating extremes, random
//! bits, batches of any size, parts that are missing, counters that wrap. The same seed gives the same
//! input everywhere: only integers are drawn.

use std::array;

use anyhow::{Result, anyhow};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use slipsense::fixed::Logit;
use slipsense::net::format::{DECISION_FRAMES_MAX, Dims, HEAD_WIDTH_MAX, OperatingPoint};
use slipsense::params::{COUNT_MAX, TAXEL_COLS, TAXELS, XL_BATCH_MAX, limits};
use slipsense::pipeline::FrameStamp;
use slipsense::sensor::{PiezoFrame, SensorReadings, TaxelMask, XlSample};
use slipsense_recording::model_file::random_model;

use super::frames::Frames;

/// Frames before the sequence number wraps.
const BEFORE_WRAP: u32 = 100;
/// A stretch of one kind of input lasts up to this many frames.
const STRETCH_MAX: u32 = 40;

pub fn frames(count: u32, sensors: usize, seed: u64) -> Frames {
    let mut rng = ChaCha8Rng::seed_from_u64(seed ^ (sensors as u64) << 32);
    // Just before the sample counter wraps.
    let mut sensor =
        || Sensor { piezo: (None, 0), xl: (None, 0), sample: 0u32.wrapping_sub(rng.random_range(0..20_000)) };
    let mut generators: Vec<Sensor> = (0..sensors).map(|_| sensor()).collect();
    let mut list = Vec::new();
    let mut stamp =
        FrameStamp { sequence: 0u32.wrapping_sub(BEFORE_WRAP), timestamp_us: rng.random_range(0..1 << 55) };
    for _ in 0..count {
        let parts = generators.iter_mut().map(|sensor| sensor.part(&mut rng)).collect();
        list.push((stamp, parts));
        stamp.sequence = stamp.sequence.wrapping_add(1);
        stamp.timestamp_us += rng.random_range(1..10_000);
    }
    Frames::new(sensors, list)
}

/// A network of random shape, weights and operating point.
pub fn model(seed: u64) -> Result<Vec<u8>> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let heads = [1, 2, 4, limits::HEADS][rng.random_range(0..4)];
    let dims = Dims {
        conv_channels: limits::CONV_CHANNELS.map(|most| rng.random_range(1..=most)),
        embed: heads * rng.random_range(1..=(limits::EMBED / heads).min(HEAD_WIDTH_MAX / 2)),
        xl_kernel: rng.random_range(1..=limits::XL_KERNEL),
        xl_channels: rng.random_range(1..=limits::XL_CHANNELS),
        heads,
        window: rng.random_range(1..=limits::WINDOW),
    };
    let mut file = random_model(dims, seed);
    let n = rng.random_range(1..=DECISION_FRAMES_MAX);
    // Near zero, so that the flag changes.
    let threshold = Logit::from_bits(rng.random_range(-500..500));
    file.point = OperatingPoint { threshold, k: rng.random_range(1..=n), n };
    file.to_bytes().map_err(|error| anyhow!("random model {seed}: {error}"))
}

type Scan = Box<dyn FnMut(&mut ChaCha8Rng) -> [u16; TAXELS]>;
/// By the number of the sample.
type Samples = Box<dyn Fn(u32, &mut ChaCha8Rng) -> XlSample>;

/// One sensor's generator: the kinds of input now, and for how many frames. `None` is a part that is missing.
struct Sensor {
    piezo: (Option<Scan>, u32),
    xl: (Option<Samples>, u32),
    sample: u32,
}

impl Sensor {
    fn part(&mut self, rng: &mut ChaCha8Rng) -> SensorReadings {
        if self.piezo.1 == 0 {
            self.piezo = (draw_piezo(rng), rng.random_range(1..=STRETCH_MAX));
        }
        if self.xl.1 == 0 {
            self.xl = (draw_xl(rng), rng.random_range(1..=STRETCH_MAX));
        }
        self.piezo.1 -= 1;
        self.xl.1 -= 1;
        // Cells off the pad are cut here, as on a board.
        let piezo = self.piezo.0.as_mut().map(|scan| PiezoFrame::from_scan(scan(rng)));
        let sample = &mut self.sample;
        let xl = self.xl.0.as_ref().map(|samples| {
            let batch = 0..batch_size(rng);
            let next = |_| {
                *sample = sample.wrapping_add(1);
                samples(*sample, rng)
            };
            batch.map(next).collect()
        });
        SensorReadings {
            piezo_arrived: piezo.is_some(),
            piezo: piezo.unwrap_or(PiezoFrame::zeroed()),
            stuck: TaxelMask::NONE,
            xl_arrived: xl.is_some(),
            xl: xl.unwrap_or_default(),
            xl_end: self.sample,
        }
    }
}

fn batch_size(rng: &mut ChaCha8Rng) -> usize {
    match rng.random_range(0..8) {
        0 => 0,
        1 => 1,
        2 => XL_BATCH_MAX,
        3 => rng.random_range(0..=XL_BATCH_MAX),
        _ => rng.random_range(32..=35),
    }
}

fn draw_piezo(rng: &mut ChaCha8Rng) -> Option<Scan> {
    let noise = |most: u16| -> Scan { Box::new(move |rng| array::from_fn(|_| rng.random_range(0..=most))) };
    let scan: Scan = match rng.random_range(0..8) {
        0 => Box::new(|_| [0; TAXELS]),
        1 => Box::new(|_| [COUNT_MAX; TAXELS]),
        2 | 3 => {
            let mut one_taxel = [0; TAXELS];
            let index = rng.random_range(0..TAXELS);
            one_taxel[index] = [1, 941, 942, COUNT_MAX][rng.random_range(0..4)];
            Box::new(move |_| one_taxel)
        }
        4 => {
            let mut phase = 1;
            let checkerboard = move |_: &mut ChaCha8Rng| {
                phase ^= 1;
                let is_full = |index: usize| (index / TAXEL_COLS + index % TAXEL_COLS + phase) % 2 == 1;
                array::from_fn(|index| if is_full(index) { COUNT_MAX } else { 0 })
            };
            Box::new(checkerboard)
        }
        5 => noise([1, 2, 16][rng.random_range(0..3)]),
        6 => noise(COUNT_MAX),
        _ => return None,
    };
    Some(scan)
}

fn draw_xl(rng: &mut ChaCha8Rng) -> Option<Samples> {
    let constant = |sample: XlSample| -> Samples { Box::new(move |_, _| sample) };
    let alternating = |period: u32| -> Samples {
        Box::new(move |n, _| [if (n / period).is_multiple_of(2) { i16::MAX } else { i16::MIN }; 3])
    };
    let samples: Samples = match rng.random_range(0..8) {
        0 => constant([0; 3]),
        1 => constant([i16::MAX, i16::MIN, i16::MAX]),
        2 => constant([rng.random(), rng.random(), rng.random()]),
        3 => alternating(1),
        4 => alternating(rng.random_range(2..=400)),
        5 => {
            let axes: usize = rng.random_range(1..=3);
            Box::new(move |_, rng| array::from_fn(|axis| if axis < axes { rng.random() } else { 0 }))
        }
        6 => Box::new(|n, _| [if n.is_multiple_of(100) { i16::MIN } else { 0 }; 3]),
        _ => return None,
    };
    Some(samples)
}

#[cfg(test)]
mod tests {
    use super::*;
    use slipsense::net::Model;

    #[test]
    fn the_same_seed_gives_the_same_input() {
        let parts = |seed| format!("{:?}", frames(50, 2, seed).list);
        assert_eq!(parts(3), parts(3));
        assert_ne!(parts(3), parts(4));
    }

    #[test]
    fn the_input_holds_every_extreme() {
        let frames = frames(2000, 1, 1).list;
        let any = |test: &dyn Fn(&SensorReadings) -> bool| frames.iter().any(|(_, parts)| test(&parts[0]));
        assert!(any(&|p| p.piezo.sum() == 942 * u32::from(COUNT_MAX)), "full scale");
        assert!(any(&|p| p.piezo_arrived && p.piezo.sum() == 0), "zeros");
        assert!(any(&|p| p.piezo.active().filter(|&c| c > 0).count() == 1), "single taxel");
        assert!(any(&|p| !p.piezo_arrived) && any(&|p| !p.xl_arrived), "parts missing");
        assert!(any(&|p| p.xl_arrived && p.xl.is_empty()), "an empty batch");
        assert!(any(&|p| p.xl.is_full()), "a full batch");
        assert!(any(&|p| p.xl.windows(2).any(|w| w[0] == [i16::MAX; 3] && w[1] == [i16::MIN; 3])), "swings");
        assert!(frames.iter().any(|(stamp, _)| stamp.sequence == 0), "the sequence wraps");
    }

    #[test]
    fn random_models_are_accepted() {
        for seed in 0..20 {
            Model::parse(&model(seed).unwrap()).unwrap();
        }
    }
}
