//! The frame source: one part's fault is that part's only.

use std::cell::{Cell, RefCell};
use std::rc::Rc;

use embassy_futures::block_on;
use embassy_sync::blocking_mutex::raw::NoopRawMutex;
use slipsense::board::{FrameSource, SensorFrame, TaxelScan};
use slipsense::drivers::array::Mounting;
use slipsense::drivers::{Adxl380, SensorLink, Sensors};
use slipsense::params::{FRAME_RATE_HZ, MAX_SENSORS, TAXEL_COLS, TAXELS};
use slipsense::pipeline::FrameStamp;
use slipsense::transfer::adc_code;

use super::fake::{Kind, Part, Wire, Wires, sensor};

const SENSORS: usize = 3;
const TICK_US: u64 = 4_168;

#[derive(Default)]
struct Faults {
    lost: Cell<bool>,
    overwritten: Cell<bool>,
    /// Accelerometers that had samples left at the last tick.
    unread: Cell<usize>,
}

/// A scan of three arrays; each count says its array.
struct Scan {
    faults: Rc<Faults>,
    parts: Vec<Rc<RefCell<Part>>>,
    stamp: FrameStamp,
    codes: Vec<u16>,
}

impl TaxelScan for Scan {
    async fn wait_before(&mut self, lead_us: u64) {
        assert_eq!(lead_us, 3 * 340, "what three FIFOs take");
        self.parts.iter().for_each(|part| part.borrow_mut().advance(TICK_US));
    }

    async fn tick(&mut self) -> FrameStamp {
        let unread = |part: &&Rc<RefCell<Part>>| !part.borrow().fifo.is_empty();
        self.faults.unread.set(self.parts.iter().filter(unread).count());
        self.stamp.sequence += 1;
        self.stamp.timestamp_us += TICK_US;
        let noise = self.stamp.sequence as u16 % 5;
        self.codes = (0..SENSORS * TAXELS)
            .map(|i| adc_code((i % SENSORS) as u16 * 100 + noise + (i % 2) as u16))
            .collect();
        self.stamp
    }

    fn codes(&self) -> Option<&[u16]> {
        (!self.faults.lost.get()).then_some(&self.codes)
    }

    fn is_untouched(&self) -> bool {
        !self.faults.overwritten.get()
    }
}

type Fingertips = Sensors<'static, NoopRawMutex, Scan, Adxl380<'static, Wire>>;
type Link = &'static SensorLink<'static, NoopRawMutex>;

fn bench() -> (Fingertips, Vec<Rc<RefCell<Part>>>, Rc<Faults>, Link) {
    let link = Box::leak(Box::new(SensorLink::new()));
    let parts: Vec<_> = (0..SENSORS).map(|_| Part::new(Kind::Adxl380)).collect();
    let faults = Rc::new(Faults::default());
    let (stamp, codes) = (FrameStamp::default(), Vec::new());
    let scan = Scan { faults: faults.clone(), parts: parts.clone(), stamp, codes };
    (Sensors::new(scan, parts.iter().map(sensor).collect(), link), parts, faults, link)
}

/// Which parts arrived in one frame: arrays, then accelerometers.
fn frame(sensors: &mut Fingertips, frame: &mut SensorFrame) -> String {
    block_on(sensors.tick()).expect("a tick");
    block_on(sensors.read(&mut frame.parts));
    let piezo = frame.parts.iter().map(|part| if part.piezo_arrived { 'p' } else { '-' });
    piezo.chain(frame.parts.iter().map(|part| if part.xl_arrived { 'x' } else { '-' })).collect()
}

#[test]
fn a_fault_is_the_faulty_parts_only() {
    let (mut sensors, parts, faults, _) = bench();
    let mut buffer = SensorFrame::new();
    let mut next = |sensors: &mut Fingertips| frame(sensors, &mut buffer);
    assert_eq!(next(&mut sensors), "ppp---", "the scan does not wait for accelerometers");
    (0..30).for_each(|_| _ = next(&mut sensors));
    assert_eq!(next(&mut sensors), "pppxxx");
    assert_eq!(faults.unread.get(), 0, "accelerometers are read ahead of the tick");

    parts[1].borrow_mut().wires = Wires::Error;
    (0..100).for_each(|_| assert_eq!(next(&mut sensors), "pppx-x"));
    parts[1].borrow_mut().wires = Wires::Fine;
    assert!((1..100).any(|_| next(&mut sensors) == "pppxxx"), "recovered");

    faults.lost.set(true);
    assert_eq!(next(&mut sensors), "---xxx");
    faults.lost.set(false);
    assert_eq!(next(&mut sensors), "pppxxx", "a lost scan costs its frame");
    faults.overwritten.set(true);
    assert_eq!(next(&mut sensors), "---xxx");
    faults.overwritten.set(false);
    assert_eq!(next(&mut sensors), "pppxxx");
    let report = sensors.report();
    assert_eq!((report.lost_scans, report.xl[1].starts, report.xl[0].starts), (2, 2, 1));
    for (sensor, part) in buffer.parts.iter().enumerate() {
        let counts: Vec<u16> = part.piezo.active().collect();
        assert!(counts.iter().all(|&count| count / 100 == sensor as u16), "array {sensor}");
    }
}

#[test]
fn a_report_comes_each_second_and_a_mounting_counts_from_the_next_frame_on() {
    let (mut sensors, _, faults, link) = bench();
    let mut buffer = SensorFrame::new();
    let mut next = || {
        frame(&mut sensors, &mut buffer);
        let counts = buffer.parts[1].piezo.counts();
        i32::from(counts[16 * TAXEL_COLS + 17]) - i32::from(counts[16 * TAXEL_COLS + 16])
    };
    // Even slots read a count more.
    assert_eq!((next(), next()), (-1, -1));
    link.mount([Mounting { cols_flipped: true, rows_flipped: false }; MAX_SENSORS]);
    assert_eq!((next(), next()), (1, 1));
    faults.lost.set(true);
    (4..FRAME_RATE_HZ - 1).for_each(|_| _ = next());
    assert!(link.report().is_none());
    // What was lost before the frame that it comes with.
    for (frames, lost_scans) in [(1, 235), (FRAME_RATE_HZ - 1, 235), (1, 475)] {
        (0..frames).for_each(|_| _ = next());
        assert_eq!(link.report().map(|report| report.lost_scans), Some(lost_scans));
    }
}

#[test]
fn discarded_frames_show_as_a_gap() {
    let (mut sensors, ..) = bench();
    let mut buffer = SensorFrame::new();
    (0..40).for_each(|_| _ = frame(&mut sensors, &mut buffer));
    let first = |buffer: &SensorFrame| buffer.parts.each_ref().map(|part| part.xl_end - part.xl.len() as u32);
    let end = |buffer: &SensorFrame| buffer.parts.each_ref().map(|part| part.xl_end);
    let before = end(&buffer);
    for _ in 0..20 {
        block_on(sensors.tick()).expect("a tick");
    }
    assert_eq!(frame(&mut sensors, &mut buffer), "pppxxx");
    assert!(first(&buffer).iter().zip(before).all(|(&first, before)| first > before + 600));
    let before = end(&buffer);
    assert_eq!(frame(&mut sensors, &mut buffer), "pppxxx");
    assert_eq!(first(&buffer), before);
    assert_eq!(sensors.report().xl[0].overruns, 0);
}
