//! The frame source of the board: its scan and accelerometers under the library's [`Sensors`], and their report.

use defmt::{info, unwrap, warn};
use embassy_futures::block_on;
use slipsense::calibration::{Calibration, Summary};
use slipsense::drivers::array::Array;
use slipsense::drivers::{Bench, Commissioning, Sensor, SensorLink, Sensors, XlBatch, XlMonitor};
use slipsense::firmware::shared::Mutex;
use slipsense::params::MAX_SENSORS;
use static_cell::{ConstStaticCell, StaticCell};

use crate::accelerometers::{self, Xl};
use crate::adc_scan::{self, AdcScan};
use crate::services::Store;

/// What the services tell the sensors and hear from them.
pub static LINK: SensorLink<'static, Mutex> = SensorLink::new();

pub type BoardSensors = Sensors<'static, Mutex, AdcScan, Xl>;
pub type BoardCommissioning = Commissioning<'static, Mutex>;

/// The drivers and what they remember.
#[unsafe(link_section = ".axisram")]
static SOURCE: StaticCell<BoardSensors> = StaticCell::new();
#[unsafe(link_section = ".axisram")]
static CALIBRATIONS: ConstStaticCell<[Calibration; MAX_SENSORS]> =
    ConstStaticCell::new([const { Calibration::zeroed() }; MAX_SENSORS]);
#[unsafe(link_section = ".axisram")]
static BATCHES: ConstStaticCell<[XlBatch; MAX_SENSORS]> =
    ConstStaticCell::new([const { XlBatch::new() }; MAX_SENSORS]);
#[unsafe(link_section = ".axisram")]
static BENCH: ConstStaticCell<Bench> = ConstStaticCell::new(Bench::new());

/// Start the scan and the accelerometers of `sensors` sensors, with their arrays' calibrations out of the store; `order`
/// holds the connector of each. Apart: what this takes of the stack is given back.
#[inline(never)]
pub fn start(
    mut scan: adc_scan::Hardware,
    accelerometers: accelerometers::Hardware,
    sensors: usize,
    order: [usize; MAX_SENSORS],
    store: &mut Store,
) -> (&'static mut BoardSensors, BoardCommissioning) {
    let mut parts = accelerometers::start(accelerometers).map(Some);
    let mut arrays = scan.arrays.map(Some);
    // An order names each connector once.
    scan.arrays = order.map(|connector| unwrap!(arrays[connector].take()));
    let mut summaries = [Summary::default(); MAX_SENSORS];
    let connectors: heapless::Vec<usize, MAX_SENSORS> = order.into_iter().take(sensors).collect();
    let arrays_of = connectors.iter().zip(CALIBRATIONS.take()).zip(&mut summaries).zip(BATCHES.take());
    let used = arrays_of.map(|(((&connector, calibration), summary), batch)| {
        if !block_on(store.load_calibration(connector, calibration)) {
            warn!("connector {=usize}: the stored calibration is damaged", connector);
        }
        *summary = calibration.summary();
        info!("connector {=usize}: calibration {=u32} {=u32:08x}", connector, summary.version, summary.id);
        let xl = XlMonitor::new(unwrap!(parts[connector].take()));
        Sensor { array: Array::new(calibration), xl, batch }
    });
    let used = used.collect();
    // A part that is fitted and not used stays deselected: a pin that is let go floats, and the part would talk.
    parts.into_iter().flatten().for_each(core::mem::forget);
    let scan = AdcScan::start(scan, sensors);
    let commissioning = Commissioning::new(&LINK, BENCH.take(), connectors, summaries);
    (SOURCE.init_with(|| Sensors::new(scan, used, &LINK)), commissioning)
}

/// Into the log.
pub fn log(sensors: usize) {
    let Some(report) = LINK.report() else { return };
    if report.lost_scans > 0 {
        warn!("{=u32} scans lost", report.lost_scans);
    }
    for i in 0..sensors.min(MAX_SENSORS) {
        let xl = report.xl[i];
        info!(
            "sensor {=usize}: {=u64} mHz, lost {=u64} samples, {=u32} overruns, {=u32} resyncs, {=u32} starts",
            i, report.xl_rate_mhz[i], report.xl_lost[i], xl.overruns, xl.resyncs, xl.starts
        );
        if let Some(fault) = xl.last_fault {
            let (name, detail) = (fault.name(), fault.detail());
            warn!("sensor {=usize}: {=u32} faults, the last: {=str} {=u32:#x}", i, xl.faults, name, detail);
        }
        if report.dead_arrays[i] || report.stuck_taxels[i].len() > 0 {
            let (dead, stuck) = (report.dead_arrays[i], report.stuck_taxels[i].len());
            warn!("sensor {=usize}: array dead {=bool}, {=u32} taxels masked", i, dead, stuck);
        }
    }
}
