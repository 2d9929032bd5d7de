//! One run: the ELF in the emulator for a number of virtual seconds.

use std::collections::BTreeMap;
use std::net::TcpListener;
use std::sync::Arc;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail};
use rigless::device::ResetCause;
use rigless::emulator::{self, Driver, Host, Settled, Start, Stop, Watch};
use rigless::image::Image;
use rigless::mcu::Operate;
use rigless::session::Session;
use rigless::soc::Width;
use rigless::symbols::Symbols;
use rigless::time::VirtualNanos;
use slipsense::sensor::XlSample;
use slipsense::settings::Setting;

use crate::arguments::Arguments;
use crate::board_faults::BoardFaults;
use crate::diagnostics::{self, Diagnostic};
use crate::far_end::FarEnd;
use crate::fault_injection::Kind;
use crate::fdcan::wire::Logged;
use crate::fitted::Fitted;
use crate::flash_wait::FlashWait;
use crate::machine::Twin;
use crate::power_faults::{Failure, PowerFaults};
use crate::programs::{self, VECTORS};
use crate::rtt::{self, Probe};
use crate::settings;
use crate::shared::lock;
use crate::xl::{self, Readouts};

/// How often the log is read: what a probe does.
const STEP_NS: u64 = 1_000_000;
/// From one line about how far a long run is to the next.
const MINUTE_NS: u64 = 60_000_000_000;
/// Exceptions before the first interrupt in the table.
const SYSTEM_EXCEPTIONS: usize = 16;
const INTERRUPTS: usize = 150;
/// TIM2's counter: the lowest 16 bits of embassy's clock, microseconds.
const TIM2_CNT: u64 = 0x4000_0024;
/// SYSCFG_PWRCR, whose lowest bit is ODEN: voltage scale 0.
const SYSCFG_PWRCR: u64 = 0x5800_042C;

pub struct Done {
    /// Everything on FDCAN1's wires.
    pub frames: Vec<Logged>,
    /// Request and end of each frame that FDCAN1 sent, virtual ns.
    pub requests: Vec<(u64, u64)>,
    /// What was read of each accelerometer, and when.
    pub readouts: Vec<Vec<(u64, Vec<XlSample>)>>,
    /// Samples per second that each accelerometer makes.
    pub xl_rate_hz: f64,
    pub failures: Vec<Failure>,
    pub read_flags: u64,
    /// Each restart: virtual ns, and who asked for it.
    pub resets: Vec<(u64, ResetCause)>,
    pub log: Vec<String>,
    pub diagnostics: Vec<Diagnostic>,
    /// Voltage scale 0 was asked for, as 480 MHz needs.
    pub overdrive: bool,
    /// Scans that began event by event, without `--slow`.
    pub scans_by_events: usize,
    /// Interrupts taken: name and how often.
    pub interrupts: BTreeMap<String, u64>,
    /// The lowest 16 bits of embassy's clock at the end, microseconds.
    pub clock_us: u64,
    pub virtual_ns: u64,
    pub instructions: u64,
    pub wall: Duration,
}

#[derive(Default)]
struct Recorder {
    end: u64,
    probe: Option<Probe>,
    /// First instruction of each handler and the interrupts it serves.
    handlers: BTreeMap<u64, String>,
    hits: BTreeMap<u64, u64>,
    clock_us: u64,
    overdrive: bool,
    last: Option<Stop>,
    far_end: Option<FarEnd>,
    supply: PowerFaults,
    faults: BoardFaults,
    restarts: usize,
    wait: FlashWait,
    broken: Option<anyhow::Error>,
}

impl Recorder {
    /// Frames and orders of the far end, if there is one. `false`: it is gone.
    fn exchange(&mut self, session: &mut Session<Twin>, stop: Stop, host: &mut dyn Host) -> Result<bool> {
        let Some(far_end) = &mut self.far_end else { return Ok(true) };
        let is_there = far_end.exchange(stop.at.0, &mut session.board_mut().mcu.fdcan[0].wire)?;
        if let Some(steps) = far_end.power_fails_at.take() {
            self.supply.fail_at(steps)?;
        }
        for order in far_end.orders.drain(..) {
            self.faults.order(&order, session, host, stop)?;
        }
        Ok(is_there)
    }
}

impl Driver<Twin> for Recorder {
    fn on_settled(&mut self, session: &mut Session<Twin>, host: &mut dyn Host, settled: Settled) {
        match settled {
            Settled::Hit(hit) => *self.hits.entry(hit.address).or_default() += 1,
            Settled::Access { access, value } => {
                self.faults.look(session, access);
                self.supply.look(session, host, access);
                self.wait.look(host, access, value);
            }
            Settled::Stop(stop) => {
                self.wait.settle(session, host, stop.at);
                if session.resets().len() != self.restarts {
                    self.restarts = session.resets().len();
                    self.broken = self.faults.restarted(host).err().map(Into::into).or(self.broken.take());
                }
            }
            _ => {}
        }
    }

    fn on_stop(
        &mut self,
        session: &mut Session<Twin>,
        stop: Stop,
        host: &mut dyn Host,
    ) -> Option<VirtualNanos> {
        if let Some(probe) = &mut self.probe {
            probe.drain(host);
        }
        self.last = Some(stop);
        if stop.at.0 % MINUTE_NS == 0 {
            eprintln!(
                "{} of {:.1} virtual minutes",
                stop.at.0 / MINUTE_NS,
                self.end as f64 / MINUTE_NS as f64
            );
        }
        let goes_on = self.exchange(session, stop, host).unwrap_or_else(|error| {
            self.broken = Some(error);
            false
        });
        if !goes_on || stop.at.0 >= self.end {
            let mcu = session.mcu();
            let count = mcu.peek(stop.at, TIM2_CNT, Width::W32).unwrap_or(0);
            self.clock_us = count & 0xFFFF;
            self.overdrive = mcu.peek(stop.at, SYSCFG_PWRCR, Width::W32).unwrap_or(0) & 1 != 0;
            return None;
        }
        Some(VirtualNanos((stop.at.0 + STEP_NS).min(self.end)))
    }
}

fn handlers(images: &[Image], board: &Twin) -> BTreeMap<u64, String> {
    let mut names: BTreeMap<usize, Vec<&str>> = BTreeMap::new();
    for peripheral in rigless::mcu::Mcu::bus(&board.mcu).peripherals() {
        for &line in peripheral.interrupts {
            names.entry(line.into()).or_default().push(peripheral.name);
        }
    }
    let mut found: BTreeMap<u64, Vec<String>> = BTreeMap::new();
    let Some((_, table)) = images.iter().flat_map(Image::segments).find(|(address, _)| *address == VECTORS)
    else {
        return BTreeMap::new();
    };
    for (line, entry) in table.chunks_exact(4).skip(SYSTEM_EXCEPTIONS).take(INTERRUPTS).enumerate() {
        let address = u32::from_le_bytes([entry[0], entry[1], entry[2], entry[3]]) & !1;
        let name = names.get(&line).map_or_else(|| format!("interrupt {line}"), |names| names.join("/"));
        found.entry(address.into()).or_default().push(name);
    }
    // The default handler serves nearly all.
    found.retain(|_, lines| lines.len() < 20);
    found.into_iter().map(|(address, lines)| (address, lines.join("+"))).collect()
}

pub fn run(arguments: &Arguments, fitted: &Arc<Fitted>, seconds: f64) -> Result<Done> {
    let elf = &arguments.elf;
    let bytes = std::fs::read(elf).with_context(|| format!("{}: cannot read the firmware", elf.display()))?;
    let mut images = programs::images(elf, bytes.clone(), arguments.boot.as_deref())?;
    let symbols = Symbols::read(&bytes, |value| value & !1)?;
    let probe = symbols.get("_SEGGER_RTT").ok().map(|block| Probe { block, bytes: Vec::new() });
    let board = Box::new(Twin::new(fitted)?);
    let handlers = handlers(&images, &board);
    let mut session = Session::new(board, 0, VirtualNanos(STEP_NS))?;
    for &address in handlers.keys() {
        session.watch(Watch::Instruction(address));
    }
    let recorder = Recorder {
        end: (seconds * 1e9) as u64,
        probe,
        handlers,
        far_end: arguments.far_end.then(FarEnd::wait).transpose()?,
        faults: BoardFaults::new(&symbols),
        ..Recorder::default()
    };
    let listener = arguments.gdb.map(|port| TcpListener::bind(("127.0.0.1", port))).transpose()?;
    if let Some(listener) = &listener {
        eprintln!("waiting for a debugger: target extended-remote {}", listener.local_addr()?);
    }
    let mut stored: Vec<_> =
        arguments.sensors.map(|sensors| (Setting::Sensors, sensors.into())).into_iter().collect();
    if fitted.faults.all().iter().any(|fault| fault.kind == Kind::Hostile) {
        stored.push((Setting::Lock, 1));
    }
    if !stored.is_empty() {
        images.push(settings::stored(&stored)?);
    }
    let mut start = Start::new(&images);
    start.debugger = listener.as_ref();
    start.wait_for_debugger = listener.is_some();

    let clock = Instant::now();
    let mut finished = emulator::run(session, &start, recorder)?;
    let wall = clock.elapsed();
    if let Some(error) = finished.session.take_error() {
        return Err(error.into());
    }
    if let Some(error) = finished.driver.broken.take() {
        return Err(error);
    }
    let Some(stop) = finished.driver.last else { bail!("the run ended before it began") };
    let driver = finished.driver;
    let log = driver.probe.as_ref().map(|probe| rtt::lines(&bytes, &probe.bytes)).transpose()?;
    let interrupts =
        driver.hits.iter().map(|(address, count)| (driver.handlers[address].clone(), *count)).collect();
    let resets = finished.session.resets().iter().map(|reset| (reset.at.0, reset.cause)).collect();
    let diagnostics = diagnostics::collect(&finished.session, arguments);
    let board = finished.session.board_mut();
    let take = |readouts: &Readouts| std::mem::take(&mut *lock(readouts));
    let readouts = board.readouts.iter().map(take).collect();
    let scans_by_events = board.mcu.scans_by_events();
    let fdcan = &mut board.mcu.fdcan[0];
    Ok(Done {
        frames: std::mem::take(&mut fdcan.wire.log),
        requests: std::mem::take(&mut fdcan.requests),
        readouts,
        xl_rate_hz: fitted.xl.rate_hz(xl::OSCILLATOR_ERROR),
        failures: driver.supply.failures,
        read_flags: driver.faults.flags,
        resets,
        log: log.unwrap_or_default(),
        diagnostics,
        overdrive: driver.overdrive,
        scans_by_events,
        interrupts,
        clock_us: driver.clock_us,
        virtual_ns: stop.at.0,
        instructions: stop.instruction_count,
        wall,
    })
}
