//! Each fault of an accelerometer: what is delivered, what is missing, and how long until it delivers again.

use std::cell::RefCell;
use std::rc::Rc;

use embassy_futures::block_on;
use slipsense::board::{Accelerometer, FifoSamples, XlFault};
use slipsense::drivers::{Adxl382, Icm42688, XlBatch, XlCounters, XlMonitor};
use slipsense::sensor::XlSample;

use super::fake::{Kind, Part, Wire, Wires, adxl380, buffer, numbered};

/// Between two ticks, rounded down as the timer might.
const TICK_US: u64 = 4_166;
/// Until the slowest part delivers after power-up: reset, configuration, 12 ticks of settling.
const START_TICKS: usize = 20;
/// The worst of a gap: one sample by the phase of the FIFO, one by rounding.
const COUNT_SLACK: i64 = 2;

struct Bench<A> {
    part: Rc<RefCell<Part>>,
    monitor: XlMonitor<A>,
    fifo: FifoSamples,
    now_us: u64,
    /// Samples made when the count was 0; while the rate is not measured yet, the count may be off by 3 %.
    begin: Option<i64>,
    measured: bool,
    /// Index of the sample that comes next, after a tick that delivered.
    next: Option<u32>,
}

/// What a tick delivers, and whether its index says that samples are missing before it.
type Delivered = Option<(Vec<XlSample>, bool)>;

impl<A: Accelerometer> Bench<A> {
    fn new(part: Rc<RefCell<Part>>, driver: A) -> Self {
        let (monitor, fifo) = (XlMonitor::new(driver), FifoSamples::new());
        Self { part, monitor, fifo, now_us: 1_000, begin: None, measured: false, next: None }
    }

    fn pass(&mut self, us: u64) {
        self.part.borrow_mut().advance(us);
        self.now_us += us;
    }

    fn tick(&mut self) -> Delivered {
        self.pass(TICK_US);
        let mut xl = XlBatch::new();
        let arrived = block_on(self.monitor.tick(self.now_us, &mut self.fifo, &mut xl));
        let made = self.part.borrow().made as i64;
        let counted = i64::from(self.monitor.xl_end()) * i64::from(A::PART.decimation);
        let begin = *self.begin.get_or_insert(made - counted);
        let off = counted - (made - begin);
        if self.measured {
            // In every tick, also while the part is dead: the count is what the part has made.
            assert!(off.abs() <= COUNT_SLACK, "counted {counted}, off by {off}");
        } else if self.monitor.counters().faults == 0 {
            assert!(off.abs() * 33 <= made - begin + 100, "counted {counted}, off by {off}");
        }
        let first = self.monitor.xl_end().wrapping_sub(xl.len() as u32);
        let gap = self.next.is_some_and(|next| next != first);
        self.next = arrived.then_some(self.monitor.xl_end());
        arrived.then(|| (xl.to_vec(), gap))
    }

    fn run(&mut self, ticks: usize) -> Vec<Delivered> {
        (0..ticks).map(|_| self.tick()).collect()
    }

    /// Until it delivers and its rate is measured.
    fn started(mut self) -> Self {
        let first = self.run(START_TICKS);
        assert!(first[0].is_none() && first[START_TICKS - 1].is_some(), "{}", arrived(&first));
        self.run(600 - START_TICKS);
        (self.begin, self.measured) = (None, true);
        self
    }

    fn counters(&self) -> XlCounters {
        self.monitor.counters()
    }

    fn lost(&self) -> u64 {
        self.monitor.count().lost()
    }

    /// Ticks until the next that delivers.
    fn recovery(&mut self) -> usize {
        (1..200).find(|_| self.tick().is_some()).expect("it never recovers")
    }
}

fn icm42688(part: &Rc<RefCell<Part>>) -> Icm42688<'static, Wire> {
    Icm42688::new(Wire(part.clone()), buffer())
}

fn fast(kind: Kind) -> Rc<RefCell<Part>> {
    let part = Part::new(kind);
    part.borrow_mut().rate_hz = 8_216.0;
    part
}

/// The same test for both parts that deliver their native samples. Started, and its rate measured, 2.7 % too fast.
macro_rules! each {
    ($bench:ident, $test:block) => {
        let part = fast(Kind::Adxl380);
        let mut $bench = Bench::new(part.clone(), adxl380(&part)).started();
        $test
        let part = fast(Kind::Icm42688);
        let mut $bench = Bench::new(part.clone(), icm42688(&part)).started();
        $test
    };
}

/// `#`: delivered, `|`: delivered after a gap, `.`: not delivered.
fn arrived(delivered: &[Delivered]) -> String {
    let letter = |batch: &Delivered| batch.as_ref().map_or('.', |&(_, gap)| if gap { '|' } else { '#' });
    delivered.iter().map(letter).collect()
}

fn samples(delivered: Vec<Delivered>) -> Vec<XlSample> {
    delivered.into_iter().flatten().flat_map(|(samples, _)| samples).collect()
}

fn assert_joined(samples: &[XlSample]) {
    let first = (0..).find(|&n| numbered(n) == samples[0]).expect("a sample of the part");
    for (n, &sample) in (first..).zip(samples) {
        assert_eq!(sample, numbered(n), "sample {n}");
    }
}

#[test]
fn every_sample_arrives_once_in_order() {
    each!(bench, {
        let batches = bench.run(2_000);
        assert!(batches.iter().all(Option::is_some));
        let samples = samples(batches);
        // 8,216 Hz for 8.332 s.
        assert!((68_440..68_470).contains(&samples.len()), "{}", samples.len());
        assert_joined(&samples[..20_000]);
        assert_eq!((bench.counters().faults, bench.counters().starts), (0, 1));
    });
}

#[test]
fn a_late_reader_loses_nothing_until_the_fifo_is_full_which_shows_as_a_gap() {
    each!(bench, {
        let before = bench.lost();
        bench.pass(5_000);
        let after = bench.run(5);
        assert_eq!(arrived(&after), "#####");
        assert_joined(&samples(after));
        assert_eq!(bench.lost(), before);
        // Nobody reads for 80 ms: 657 samples, of which a FIFO holds 105 or 255.
        bench.pass(80_000);
        let after = bench.run(10);
        assert_eq!(arrived(&after), "|#########");
        assert_joined(&samples(after));
        assert_eq!((bench.counters().overruns, bench.counters().faults), (1, 0));
    });
}

#[test]
fn lost_sync_shows_as_a_gap_or_costs_one_frame() {
    each!(bench, {
        bench.pass(1_000);
        // One byte too few, or one entry: whatever follows is out of step.
        let (cut, expected) = match bench.part.borrow().kind {
            Kind::Icm42688 => (1, ".#########"),
            _ => (3, "|#########"),
        };
        bench.part.borrow_mut().fifo.drain(..cut);
        let after = bench.run(10);
        assert_eq!(arrived(&after), expected);
        assert_joined(&samples(after));
        assert_eq!((bench.counters().resyncs, bench.counters().starts), (1, 1));
    });
}

#[test]
fn a_failed_transfer_costs_one_frame() {
    each!(bench, {
        bench.part.borrow_mut().wires = Wires::Error;
        assert_eq!(arrived(&bench.run(1)), ".");
        bench.part.borrow_mut().wires = Wires::Fine;
        assert_eq!(arrived(&bench.run(5)), "#####");
        let counters = bench.counters();
        assert_eq!((counters.faults, counters.starts), (1, 1));
        assert!(matches!(counters.last_fault, Some(XlFault::Bus(_))));
    });
}

#[test]
fn a_dead_part_is_restarted_when_it_answers_again() {
    // Refused, MISO low, MISO high.
    for wires in [Wires::Error, Wires::Stuck(0), Wires::Stuck(0xff)] {
        each!(bench, {
            bench.part.borrow_mut().wires = wires;
            let dead = bench.run(1_000);
            assert_eq!(arrived(&dead[3..]), ".".repeat(997));
            // At most five transfers a tick, so that the other sensors have their time.
            assert!(bench.part.borrow().transfers < 3 * 1_700, "{}", bench.part.borrow().transfers);
            bench.part.borrow_mut().wires = Wires::Fine;
            let ticks = bench.recovery();
            assert!(ticks <= 24 + 1 + START_TICKS, "{ticks}");
            let after = bench.run(50);
            assert_eq!(arrived(&after), "#".repeat(50));
            assert_joined(&samples(after));
            assert_eq!(bench.counters().starts, 2);
        });
    }
}

#[test]
fn a_part_that_lost_its_settings_is_restarted() {
    each!(bench, {
        bench.part.borrow_mut().power_on();
        assert_eq!(arrived(&bench.run(1)), ".");
        let ticks = 1 + bench.recovery();
        assert!(ticks <= 5 + START_TICKS, "{ticks}");
        assert_eq!(bench.counters().last_fault, Some(XlFault::Silent));
        assert_eq!(arrived(&bench.run(20)), "#".repeat(20));
    });
}

#[test]
fn another_part_is_refused_by_name() {
    let part = Part::new(Kind::Adxl382);
    let mut bench = Bench::new(part.clone(), adxl380(&part));
    assert!(bench.run(100).iter().all(Option::is_none));
    let fault = bench.monitor.counters().last_fault.expect("a fault");
    assert_eq!(fault, XlFault::WrongPart { expected: 0xad17_c000, found: 0xad17_c080 });
    assert_eq!(fault.to_string(), "identifier 0xad17c080, expected 0xad17c000");

    let part = Part::new(Kind::Adxl380);
    let mut bench = Bench::new(part.clone(), icm42688(&part));
    bench.run(100);
    assert!(matches!(bench.monitor.counters().last_fault, Some(XlFault::WrongPart { expected: 0x47, .. })));
}

#[test]
fn a_level_above_what_a_fifo_holds_is_a_fault() {
    for (kind, bytes, levels) in
        [(Kind::Adxl380, 3, [318, 319, 400]), (Kind::Icm42688, 1, [2_048, 2_049, 4_000])]
    {
        for (level, is_fault) in levels.into_iter().zip([false, true, true]) {
            let (part, mut samples) = (Part::new(kind), FifoSamples::new());
            part.borrow_mut().fifo = vec![0; bytes * usize::from(level)].into();
            let drained = match kind {
                Kind::Icm42688 => block_on(icm42688(&part).drain(&mut samples)),
                _ => block_on(adxl380(&part).drain(&mut samples)),
            };
            assert_eq!(drained == Err(XlFault::Level { level }), is_fault, "{kind:?} {level}: {drained:?}");
        }
    }
}

#[test]
fn an_icm42688_gets_the_widest_filter() {
    let part = Part::new(Kind::Icm42688);
    let _bench = Bench::new(part.clone(), icm42688(&part)).started();
    let registers = part.borrow().registers;
    let written = [0x16, 0x4c, 0x4e, 0x50, 0x52, 0x5f].map(|address: usize| registers[address]);
    assert_eq!(written, [0x40, 0x33, 0x03, 0x43, 0x01, 0x01], "bank 0");
    // Data sheet, 5.3: DELT 63, DELTSQR 3968, BITSHIFT 3, which is 3979 Hz.
    assert_eq!(registers[128 + 3..128 + 6], [63 << 1, 0x80, 0x3f], "bank 2");
}

#[test]
fn an_adxl382_comes_at_half_its_rate() {
    let part = Part::new(Kind::Adxl382);
    part.borrow_mut().rate_hz = 15_600.0;
    part.borrow_mut().signal = |_| [1_000, -2_000, 2_000];
    let mut bench = Bench::new(part.clone(), Adxl382::new(Wire(part.clone()), buffer())).started();
    let mut end = bench.monitor.xl_end();
    let mut total = 0;
    for _ in 0..2_000 {
        let (batch, gap) = bench.tick().expect("a batch");
        assert!(!gap);
        // Gravity passes unchanged: the filter's gain there is 1, exactly, from its first sample on.
        assert!(batch.iter().all(|&sample| sample == [1_000, -2_000, 2_000]));
        end = end.wrapping_add(batch.len() as u32);
        assert_eq!(end, bench.monitor.xl_end());
        total += batch.len();
    }
    // 7,800 Hz for 8.332 s.
    assert!((64_970..65_010).contains(&total), "{total}");
    bench.pass(30_000);
    assert_eq!(arrived(&bench.run(10)), "|#########");
}
