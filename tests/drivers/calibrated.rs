//! A pad as a front end delivers it, in codes: offsets, noise, faulty taxels, drift, presses, a long grasp. What the
//! driver makes of it without calibration and with, in one table.

use std::cell::RefCell;
use std::rc::Rc;

use embassy_futures::block_on;
use embassy_sync::blocking_mutex::raw::NoopRawMutex;
use rand::seq::SliceRandom;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use slipsense::board::{FrameSource, SensorFrame, TaxelScan};
use slipsense::calibration::{BLOCK_FRAMES, Calibration, Refusal, Request, State, What};
use slipsense::drivers::array::Array;
use slipsense::drivers::{Bench, Commissioning, Failure, SensorLink, Sensors};
use slipsense::params::{ACTIVE_TAXELS, CONTACT_SUM_MIN, FRAME_RATE_HZ, TAXEL_COLS, TAXELS};
use slipsense::pipeline::FrameStamp;
use slipsense::sensor::PiezoFrame;
use slipsense::settings::{SCRATCH, SettingsStore};
use slipsense::transfer::{HALF_CODE, IDLE_CODE};

use super::fake::{Kind, Part, measured, nominal, sensor};
use crate::on_pad;
use crate::update::flash::Cells;

/// Codes of one of the 4096 steps of the linear range.
const LSB: f64 = 16.0;
const SECONDS: u32 = 10;
/// Offsets and noise of the front end, those steps.
const OFFSETS: (f64, f64) = (-20.0, 60.0);
const NOISE: (f64, f64) = (0.2, 3.0);
const FAULTY: f64 = 0.02;
/// Drift of the offsets: all together, and each by itself, steps in ten minutes.
const DRIFT_ALL: f64 = 8.0;
const DRIFT_OWN: f64 = 2.0;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Fault {
    None,
    /// One code whatever happens.
    Stuck(u16),
    /// At the upper rail.
    Shorted,
    /// No conductance.
    Open,
}

struct Pad {
    rng: ChaCha8Rng,
    offsets: Vec<f64>,
    noises: Vec<f64>,
    drifts: Vec<f64>,
    faults: Vec<Fault>,
    /// Gaussian draws, read from a random place each frame.
    gaussian: Vec<f64>,
    codes: Vec<u16>,
}

impl Pad {
    fn new(seed: u64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut each = |draw: &mut dyn FnMut(&mut ChaCha8Rng) -> f64| -> Vec<f64> {
            (0..TAXELS).map(|_| draw(&mut rng)).collect()
        };
        let offsets = each(&mut |rng| f64::from(IDLE_CODE) + LSB * rng.random_range(OFFSETS.0..OFFSETS.1));
        let noises = each(&mut |rng| LSB * NOISE.0 * (NOISE.1 / NOISE.0).powf(rng.random::<f64>()));
        let drifts = each(&mut |rng| LSB * (DRIFT_ALL + rng.random_range(-DRIFT_OWN..DRIFT_OWN)) / 600.0);
        let mut faults = vec![Fault::None; TAXELS];
        let mut slots: Vec<usize> = (0..TAXELS).filter(|&slot| on_pad(slot)).collect();
        let count = (FAULTY * slots.len() as f64).round() as usize;
        for &mut slot in slots.partial_shuffle(&mut rng, count).0 {
            faults[slot] = match rng.random_range(0..3) {
                0 => Fault::Stuck(rng.random_range(IDLE_CODE..20_000)),
                1 => Fault::Shorted,
                _ => Fault::Open,
            };
        }
        // Twelve uniform draws have unit variance together.
        let draw = |_| (0..12).map(|_| rng.random::<f64>()).sum::<f64>() - 6.0;
        let gaussian = (0..32 * TAXELS).map(draw).collect();
        Self { rng, offsets, noises, drifts, faults, gaussian, codes: vec![0; TAXELS] }
    }

    /// One scan, `time_s` after the start, under so many codes of conductance.
    fn scan(&mut self, time_s: f64, load: Option<&[f64]>) -> &[u16] {
        let from = self.rng.random_range(0..self.gaussian.len() - TAXELS);
        for slot in 0..TAXELS {
            let idle = self.offsets[slot]
                + self.drifts[slot] * time_s
                + self.noises[slot] * self.gaussian[from + slot];
            let value = match self.faults[slot] {
                Fault::None => idle + load.map_or(0.0, |load| load[slot]),
                Fault::Open => idle,
                Fault::Stuck(code) => f64::from(code),
                Fault::Shorted => 65_535.0,
            };
            self.codes[slot] = value.round() as u16;
        }
        &self.codes
    }

    fn calibrate(&mut self) -> Box<Calibration> {
        let scan = |frame| self.scan(f64::from(frame) / 240.0, None).to_vec();
        let (calibration, result) = measured(SECONDS * BLOCK_FRAMES, scan);
        result.expect("untouched");
        calibration
    }
}

/// A round contact in the middle, its conductance in codes: this peak, kPa, and this radius, taxels.
fn press(peak_kpa: f64, radius: f64) -> Vec<f64> {
    let kpa = |slot: usize| {
        let (row, col) = ((slot / TAXEL_COLS) as f64 - 15.5, (slot % TAXEL_COLS) as f64 - 15.5);
        peak_kpa * (1.0 - (row * row + col * col) / (radius * radius)).max(0.0).sqrt()
    };
    (0..TAXELS).map(|slot| f64::from(HALF_CODE) * (kpa(slot) / 900.0).powf(0.92)).collect()
}

/// Frames, those whose contact is wrong, and all of their counts.
#[derive(Clone, Copy, Default)]
struct Tally {
    frames: u32,
    wrong: u32,
    counts: u64,
}

impl Tally {
    /// What an array makes of these codes; contact as the pipeline decides, after masks.
    fn add(&mut self, array: &mut Array<'_>, codes: &[u16], pressed: bool) {
        let mut frame = PiezoFrame::zeroed();
        array.read(codes, 0, 1, &mut frame);
        frame.mask(array.stuck());
        self.frames += 1;
        self.wrong += u32::from((frame.sum() >= CONTACT_SUM_MIN) != pressed);
        self.counts += u64::from(frame.sum());
    }

    /// % of the frames.
    fn right(&self) -> f64 {
        100.0 - 100.0 * f64::from(self.wrong) / f64::from(self.frames)
    }
}

/// Ten minutes in which the offsets drift: presses of 2 s every 20 s, from 5 to 6 minutes a motionless grasp.
#[test]
fn contact_is_right_after_calibration_for_ten_minutes_of_drift() {
    let mut pad = Pad::new(11);
    let mut calibration = pad.calibrate();
    let summary = calibration.summary();
    let masked = |fault: Fault| {
        let of = (0..TAXELS).filter(|slot| on_pad(*slot) && pad.faults[*slot] == fault);
        (of.clone().count(), of.filter(|s| calibration.faulty.masks(s / 32, s % 32)).count())
    };
    let (open, shorted) = (masked(Fault::Open), masked(Fault::Shorted));
    let faulty = pad.faults.iter().filter(|fault| **fault != Fault::None).count();
    assert_eq!(summary.faulty as usize, faulty - open.0, "all but the open ones, which read as untouched");
    assert_eq!((open.1, shorted.0), (0, shorted.1));

    let mut without = nominal();
    let (mut before, mut after) = (Array::new(&mut without), Array::new(&mut calibration));
    // [without, with calibration][untouched, pressed, grasp].
    let mut tallies = [[Tally::default(); 3]; 2];
    let (light, grasp) = (press(40.0, 7.0), press(60.0, 8.0));
    for number in 0..600 * FRAME_RATE_HZ {
        let time_s = f64::from(SECONDS) + f64::from(number) / 240.0;
        let second = number / FRAME_RATE_HZ;
        let (load, phase) = match second {
            300..360 => (Some(&grasp[..]), 2),
            _ if second % 20 >= 18 => (Some(&light[..]), 1),
            _ => (None, 0),
        };
        let codes = pad.scan(time_s, load);
        tallies[1][phase].add(&mut after, codes, load.is_some());
        // Without calibration nothing follows, so one frame in 60 tells as much.
        if number % 60 == 0 {
            tallies[0][phase].add(&mut before, codes, load.is_some());
        }
    }
    println!(
        "offsets {OFFSETS:?}, noise {NOISE:?}, drift {DRIFT_ALL} ± {DRIFT_OWN} in 10 min (1/4096 of the linear range); \
         {faulty} of {ACTIVE_TAXELS} taxels faulty, {} masked; mean noise found {:.2}",
        summary.faulty,
        f64::from(summary.noise) / 8.0 / LSB
    );
    println!(
        "| contact right in % of the frames | untouched | pressed | 60 s grasp | all | idle pad, counts |"
    );
    println!("|---|---:|---:|---:|---:|---:|");
    for (name, tally) in ["not calibrated", "calibrated"].into_iter().zip(&tallies) {
        let sum = |of: fn(&Tally) -> u32| tally.iter().map(of).sum();
        let all = Tally { frames: sum(|one| one.frames), wrong: sum(|one| one.wrong), counts: 0 }.right();
        let [untouched, pressed, grasp] = tally.each_ref().map(Tally::right);
        let idle = tally[0].counts as f64 / f64::from(tally[0].frames);
        println!("| {name} | {untouched:.3} | {pressed:.3} | {grasp:.3} | {all:.3} | {idle:.0} |");
    }
    let [[idle_before, ..], after] = &tallies;
    assert!(idle_before.right() < 1.0, "an untrimmed pad reads touched");
    assert!(after[0].right() >= 99.9 && after[1].right() >= 99.9);
    assert_eq!(after[2].wrong, 0, "the grasp is never lost");
}

#[test]
fn a_touched_pad_is_refused_and_the_taxel_named() {
    let touch = press(20.0, 3.0);
    for seed in 0..5 {
        let mut pad = Pad::new(seed);
        let load = |frame| (700..1_000).contains(&frame).then_some(&touch[..]);
        let (calibration, found) =
            measured(SECONDS * BLOCK_FRAMES, |frame| pad.scan(0.0, load(frame)).to_vec());
        let Err(Refusal::Touched { row, col }) = found else { panic!("{found:?}") };
        assert!((12..20).contains(&row) && (12..20).contains(&col), "row {row}, column {col}");
        assert_eq!(calibration, nominal(), "unchanged");
    }
    let dead = |_| vec![IDLE_CODE; TAXELS];
    assert_eq!(measured(0, dead).1, Err(Refusal::TooShort));
    let all = Refusal::Faulty { count: ACTIVE_TAXELS as u16, row: 0, col: 5 };
    assert_eq!(measured(BLOCK_FRAMES, dead).1, Err(all));
}

#[test]
fn offsets_and_noise_are_those_of_the_pad() {
    let mut pad = Pad::new(3);
    pad.drifts.fill(0.0);
    let calibration = pad.calibrate();
    let (mut worst_offset, mut worst_noise) = (0f64, 0f64);
    for slot in (0..TAXELS).filter(|slot| on_pad(*slot) && pad.faults[*slot] == Fault::None) {
        let (trim, noise) = (calibration.trims[slot], pad.noises[slot]);
        let of_noise = (f64::from(trim.offset) / 8.0 - pad.offsets[slot]).abs() / noise;
        worst_offset = worst_offset.max(of_noise);
        worst_noise = worst_noise.max((f64::from(trim.noise) / 8.0 / noise - 1.0).abs());
    }
    let noise = 100.0 * worst_noise;
    println!("10 s: offsets within {worst_offset:.3} of their noise, noise within {noise:.1} %");
    assert!(worst_offset < 0.15 && worst_noise < 0.1);
}

/// Two pads in one scan; the second may be pressed.
struct Scan {
    pads: [Pad; 2],
    load: Rc<RefCell<Option<Vec<f64>>>>,
    frames: u32,
    codes: Vec<u16>,
}

impl TaxelScan for Scan {
    async fn wait_before(&mut self, _lead_us: u64) {}

    async fn tick(&mut self) -> FrameStamp {
        self.frames += 1;
        let time_s = f64::from(self.frames) / 240.0;
        let load = self.load.borrow();
        let load = load.as_deref().filter(|_| self.frames % 480 < 100);
        let [one, other] = &mut self.pads;
        let (one, other) = (one.scan(time_s, None), other.scan(time_s, load));
        self.codes = one.iter().zip(other).flat_map(|(&one, &other)| [one, other]).collect();
        FrameStamp { sequence: self.frames, timestamp_us: u64::from(self.frames) * 4_167 }
    }

    fn codes(&self) -> Option<&[u16]> {
        Some(&self.codes)
    }

    fn is_untouched(&self) -> bool {
        true
    }
}

/// Some frames; sums of the last.
fn run<A: slipsense::board::Accelerometer>(
    sensors: &mut Sensors<'_, NoopRawMutex, Scan, A>,
    frames: u32,
) -> [u32; 2] {
    let mut frame = SensorFrame::new();
    for _ in 0..frames {
        block_on(sensors.tick()).expect("a tick");
        block_on(sensors.read(&mut frame.parts));
    }
    [0, 1].map(|sensor| {
        let part = &mut frame.parts[sensor];
        part.piezo.mask(&part.stuck);
        part.piezo.sum()
    })
}

#[test]
fn the_board_measures_stores_and_applies_while_it_senses() {
    let link = Box::leak(Box::new(SensorLink::<NoopRawMutex>::new()));
    let load = Rc::<RefCell<Option<Vec<f64>>>>::default();
    let pads = [Pad::new(21), Pad::new(22)];
    let scan = Scan { pads, load: load.clone(), frames: 0, codes: Vec::new() };
    let mut sensors = Sensors::new(scan, (0..2).map(|_| sensor(&Part::new(Kind::Adxl380))).collect(), link);
    let connectors = heapless::Vec::from_slice(&[2, 0]).expect("room");
    let mut board =
        Commissioning::new(link, Box::leak(Box::new(Bench::new())), connectors, Default::default());
    let flash = Cells::<{ 64 * 1024 }>::new(2, 1);
    let range = flash.range();
    let mut store = SettingsStore::new(flash, range, Box::new(SCRATCH)).expect("whole sectors");
    let of = |sensor, what| Request { sensor, what };

    let refused = |result: Result<(), &'static str>| result.expect_err("refused");
    assert_eq!(refused(board.begin(of(2, What::Measure(1)))), "no such sensor");
    assert_eq!(refused(board.begin(of(1, What::Measure(61)))), "1 to 60 seconds");
    let why = refused(board.begin(of(1, What::Scale(2_048))));
    assert_eq!(why, "measure the untouched pad first");
    assert!(run(&mut sensors, 1).iter().all(|&sum| sum > 50_000), "an untrimmed pad reads touched");

    board.begin(of(1, What::Measure(2))).expect("begun");
    run(&mut sensors, 100);
    assert!(!board.is_ready());
    let progress = board.progress();
    let expected = (1, State::Measuring, 100, 480);
    assert_eq!((progress.sensor, progress.state, progress.frames, progress.wanted), expected);
    let why = refused(board.begin(of(0, What::Measure(1))));
    assert_eq!(why, "a calibration is not done yet");
    run(&mut sensors, 380);
    assert!(board.is_ready());
    let (sensor, result) = block_on(board.finish(&mut store)).expect("measured");
    let summary = result.expect("untouched");
    assert_eq!((sensor, summary.version, board.progress().state), (1, 1, State::Done));
    let [one, other] = run(&mut sensors, 2);
    assert!(one > 50_000 && other < CONTACT_SUM_MIN, "sums {one}, {other}");
    // It is stored for the connector, and names itself.
    let mut stored = nominal();
    assert!(block_on(store.load_calibration(0, &mut stored)) && stored.summary() == summary);
    assert_eq!(board.summaries()[1], summary);

    // A press while it measures is refused, and what was in force stays.
    *load.borrow_mut() = Some(press(30.0, 4.0));
    board.is_ready();
    board.begin(of(1, What::Measure(3))).expect("begun");
    run(&mut sensors, 720);
    assert!(board.is_ready());
    let (_, result) = block_on(board.finish(&mut store)).expect("measured");
    assert!(matches!(result, Err(Failure::Refused(Refusal::Touched { .. }))), "{result:?}");
    assert_eq!((board.progress().state, board.summaries()[1]), (State::Touched, summary));
    *load.borrow_mut() = None;

    board.begin(of(1, What::Scale(1_024))).expect("half the gain");
    assert!(block_on(board.finish(&mut store)).is_some_and(|(_, result)| result.is_ok()));
    run(&mut sensors, 2);
    assert!(block_on(store.load_calibration(0, &mut stored)));
    assert_eq!((stored.summary().version, stored.trims[40].gain), (2, 1_024));
    run(&mut sensors, 1);
    board.begin(of(1, What::Scale(0))).expect("begun");
    let result = block_on(board.finish(&mut store)).expect("tried").1;
    assert_eq!((&result, board.progress().state), (&Err(Failure::Gain), State::Gain));
    assert_eq!(result.expect_err("refused").to_string(), "a gain would be 0, or 2 and more");

    board.begin(of(1, What::Forget)).expect("begun");
    assert!(block_on(board.finish(&mut store)).is_some_and(|(_, result)| result.is_ok()));
    assert!(run(&mut sensors, 2)[1] > 50_000);
    assert!(block_on(store.load_calibration(0, &mut stored)) && stored == nominal());
}
