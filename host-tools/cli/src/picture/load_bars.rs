//! How full a bus is, as bars: one pair for each pair of bit rates.

use slipsense_can_sim::busload::BusLoad;

use super::draw::{Anchor, CLASS, Canvas, GREY, INK, RULE, SENSOR, rect, rule};

const WIDTH: f64 = 880.0;
/// Left of the bars, for their names.
const LEFT: f64 = 170.0;
/// Right of the bars, for their numbers.
const RIGHT: f64 = 70.0;
const TOP: f64 = 70.0;
const BAR: f64 = 20.0;
const PAIR: f64 = 2.0 * BAR + 26.0;
const COLOURS: [(&str, &str); 3] =
    [("slip messages", CLASS[2]), ("raw messages", CLASS[1]), ("other nodes", SENSOR[0])];

/// Bit rates as the command line has them, Mbit/s.
pub fn rates(nominal_bps: u32, data_bps: u32) -> String {
    format!("{}/{}", f64::from(nominal_bps) / 1e6, f64::from(data_bps) / 1e6)
}

/// Typical and worst load on each bus, with a line at `limit_percent`.
pub fn load_bars(buses: &[BusLoad], limit_percent: u32, headline: &str) -> String {
    let bottom = TOP + PAIR * buses.len() as f64;
    let totals = buses.iter().flat_map(|bus| [bus.exact.total_percent, bus.worst.total_percent]);
    let most = totals.fold(100.0, f64::max);
    // Full twenties, so that the axis ends on a number.
    let end = (most / 20.0).ceil() * 20.0;
    let x = |percent: f64| LEFT + (WIDTH - LEFT - RIGHT) * percent / end;
    let mut page = Canvas::new();
    page.text(16.0, 24.0, Anchor::Start, 13.0, INK, headline);
    for (index, (name, colour)) in COLOURS.into_iter().enumerate() {
        let at = LEFT + 130.0 * index as f64;
        page.add(rect(at, 38.0, 12.0, 12.0, colour));
        page.text(at + 18.0, 49.0, Anchor::Start, 12.0, GREY, name);
    }
    for step in 0..=(end / 20.0) as u32 {
        let percent = 20.0 * f64::from(step);
        page.add(rule(x(percent), TOP - 6.0, x(percent), bottom, RULE));
        let label = format!("{percent} %");
        page.text(x(percent), bottom + 18.0, Anchor::Middle, 11.0, GREY, &label);
    }
    for (index, bus) in buses.iter().enumerate() {
        let y = TOP + PAIR * index as f64;
        let rates = format!("{} Mbit/s", rates(bus.nominal_bps, bus.data_bps));
        page.text(16.0, y + 14.0, Anchor::Start, 13.0, INK, &rates);
        for (row, (what, load)) in [("typical", bus.exact), ("worst case", bus.worst)].into_iter().enumerate()
        {
            let y = y + (BAR + 4.0) * row as f64;
            page.text(LEFT - 8.0, y + 14.0, Anchor::End, 12.0, GREY, what);
            let mut from = 0.0;
            let parts = [load.slip_percent, load.raw_percent, load.foreign_percent];
            for (percent, (_, colour)) in parts.into_iter().zip(COLOURS) {
                page.add(rect(x(from), y, x(from + percent) - x(from), BAR, colour));
                from += percent;
            }
            let total = format!("{:.1} %", load.total_percent);
            page.text(x(from) + 6.0, y + 14.0, Anchor::Start, 12.0, INK, &total);
        }
    }
    let limit = x(f64::from(limit_percent));
    page.add(rule(limit, TOP - 6.0, limit, bottom, "#b00020"));
    page.page(WIDTH, bottom + 40.0, headline)
}
