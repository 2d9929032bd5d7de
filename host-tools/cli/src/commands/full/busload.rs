//! `slipsense busload`: how full a bus gets, and how long the slip flag waits on it.

use std::fmt::Write;
use std::path::PathBuf;

use anyhow::{Result, anyhow, ensure};
use serde_json::json;
use slipsense::params::MAX_SENSORS;
use slipsense::wire::{RAW_XL_MAX, RawForm};
use slipsense_can_sim::Timing;
use slipsense_can_sim::busload::{
    BusLoad, CLOCK_HZ, DATA_BPS_MAX, NODES_MAX, NOMINAL_BPS_MAX, Plan, SAMPLES_TYPICAL_MAX,
    SIMULATED_PERIODS, Sample, plan,
};
use slipsense_recording::Episode;

use super::{Print, Raw};
use crate::bundled;
use crate::output::{check_file, write_file};
use crate::picture::{load_bars, rates};
use crate::simulate::simulate;
use crate::summary::counted;

/// Tell how full a CAN FD bus gets and how long the slip flag waits on it
///
/// The exact load is that of an episode's CAN frames, counted to the bit with stuff bits and pauses; the worst
/// case has the most stuff bits that any data could need. The flag latency is the time from a slip message's
/// handing over to the end of its frame on a bus that is always full, for the module with the largest address:
/// computed, and the longest of 1440 periods on the modelled bus. Heartbeats and service calls are not counted.
#[derive(clap::Args)]
#[command(after_help = "\
Frames of other nodes are taken as full ones with identifiers between the slip and the raw messages'.
Above 100 % the raw messages lose: the slip message still goes first. Bit rates are those that a clock
of 80 MHz gives: divisors of it, at most 1 and 8 Mbit/s.

Examples:
  slipsense busload                                        one module, one sensor, at 1/5 and 1/8 Mbit/s
  slipsense busload grasp.npz --sensors 3 --raw-every 2    three sensors, every second frame
  slipsense busload --sensors 3 --raw compressed           three sensors that fit one bus
  slipsense busload --nodes 2 --raw-every 0 --foreign 40   two modules without raw messages among others
  slipsense busload --bitrate 0.5/2 --limit 70 --json | jq '.buses[].worst.total_percent'
  slipsense busload --sensors 2 --svg load.svg             the same as a picture")]
pub struct Args {
    /// Episode whose frames are typical; the bundled one if not given
    #[arg(value_name = "EPISODE.npz")]
    episode: Option<PathBuf>,
    /// Bit rates of arbitration and data phase, Mbit/s; may be given several times
    #[arg(long, value_name = "NOMINAL/DATA", default_values = ["1/5", "1/8"], value_parser = Rates::parse)]
    bitrate: Vec<Rates>,
    /// Sensors of each module, 1 to 3; those of the episode if not given
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u8).range(1..=MAX_SENSORS as i64))]
    sensors: Option<u8>,
    /// Modules on the bus, 1 to 8
    #[arg(long, value_name = "N", default_value = "1")]
    #[arg(value_parser = clap::value_parser!(u8).range(1..=NODES_MAX as i64))]
    nodes: u8,
    /// Raw messages of every N-th frame; 0: none
    #[arg(long, value_name = "N", default_value = "1", value_parser = clap::value_parser!(u32).range(0..=240))]
    raw_every: u32,
    /// How the raw messages go; the worst case of compressed ones is data that no coder makes shorter
    #[arg(long, value_enum, default_value_t = Raw::Plain)]
    raw: Raw,
    /// Accelerometer samples in a raw message, for the worst case, 0 to 64; 35 is a part 3 % fast
    #[arg(long, value_name = "N", default_value_t = SAMPLES_TYPICAL_MAX as u8)]
    #[arg(value_parser = clap::value_parser!(u8).range(0..=RAW_XL_MAX as i64))]
    samples: u8,
    /// Load by other nodes' frames, percent of the bus's time
    #[arg(long, value_name = "PERCENT", default_value = "0", value_parser = clap::value_parser!(u32).range(0..=100))]
    foreign: u32,
    /// Warn above this load, percent
    #[arg(long, value_name = "PERCENT", default_value = "100", value_parser = clap::value_parser!(u32).range(1..=100))]
    limit: u32,
    /// Picture to write
    #[arg(long, value_name = "FILE.svg")]
    svg: Option<PathBuf>,
    #[command(flatten)]
    print: Print,
}

/// Bit rates, bit/s.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Rates {
    nominal_bps: u32,
    data_bps: u32,
}

impl Rates {
    fn parse(text: &str) -> Result<Self, String> {
        let (nominal, data) = text.split_once('/').ok_or("need two rates in Mbit/s, such as 1/8")?;
        let (nominal_bps, data_bps) = (bps(nominal, NOMINAL_BPS_MAX)?, bps(data, DATA_BPS_MAX)?);
        if data_bps < nominal_bps {
            return Err("the data phase cannot be slower than arbitration".to_owned());
        }
        Ok(Self { nominal_bps, data_bps })
    }

    fn timing(self) -> Result<Timing> {
        Timing::new(CLOCK_HZ, self.nominal_bps, self.data_bps).map_err(|error| {
            let slipsense_can_sim::TimingError::BitRate(bps) = error;
            let (rates, mhz) = (rates(self.nominal_bps, self.data_bps), CLOCK_HZ / 1_000_000);
            anyhow!("--bitrate {rates}: a clock of {mhz} MHz is no multiple of {bps} bit/s")
        })
    }
}

/// Mbit/s to whole bit/s.
fn bps(text: &str, max: u32) -> Result<u32, String> {
    let bps = text.parse().map_or(f64::NAN, |mega: f64| mega * 1e6);
    let is_rate = (1.0..=f64::from(max)).contains(&bps);
    let refused = || format!("\"{text}\" must be a rate above 0, at most {} Mbit/s", max / 1_000_000);
    is_rate.then_some(bps.round() as u32).ok_or_else(refused)
}

impl Args {
    pub fn run(self) -> Result<()> {
        self.svg.as_deref().map(check_file).transpose()?;
        let timings = self.bitrate.iter().map(|rates| rates.timing()).collect::<Result<Vec<_>>>()?;
        let (episode, name) = match &self.episode {
            Some(path) => (Episode::read(path)?, path.display().to_string()),
            None => (bundled::episode()?, bundled::NAME.to_owned()),
        };
        let mut sample = Sample::default();
        let (frames, model) = (episode.frames(), bundled::model(None)?);
        self.print.progress(frames, "frames", |bar| {
            simulate(&episode, frames, model.parse()?, self.raw.form(), |_, can| {
                bar.inc(1);
                can.iter().for_each(|frame| sample.push(frame));
                Ok(())
            })
        })?;
        ensure!(sample.is_complete(), "{name}: no raw message in it");
        let asked = Plan {
            nodes: self.nodes.into(),
            sensors: self.sensors.map_or(episode.sensors, usize::from),
            raw_every: self.raw_every,
            raw_form: self.raw.form(),
            samples: self.samples.into(),
            foreign_percent: self.foreign,
        };
        let buses: Vec<_> = timings.iter().map(|timing| plan(&asked, &sample, timing)).collect();
        let warnings = self.warnings(&buses);
        if let Some(svg) = &self.svg {
            write_file(svg, load_bars(&buses, self.limit, &headline(&asked, &name)))?;
        }
        let result = json!({
            "nodes": asked.nodes, "sensors": asked.sensors, "raw_every": asked.raw_every, "raw": self.raw,
            "samples": asked.samples, "foreign_percent": asked.foreign_percent,
            "episode": {"name": name, "frames": frames},
            "simulated_periods": SIMULATED_PERIODS, "buses": buses, "warnings": warnings,
        });
        self.print.show(&result, || table(&asked, &name, &buses, &warnings))
    }

    fn warnings(&self, buses: &[BusLoad]) -> Vec<String> {
        let limit = f64::from(self.limit);
        buses
            .iter()
            .filter_map(|bus| {
                let (exact, worst) = (bus.exact.total_percent, bus.worst.total_percent);
                let (what, percent) = match () {
                    () if exact > 100.0 => ("raw messages will be lost: this traffic asks for", exact),
                    () if exact > limit => ("this traffic asks for", exact),
                    () if worst > limit => ("the worst case asks for", worst),
                    () => return None,
                };
                let rates = rates(bus.nominal_bps, bus.data_bps);
                Some(format!("{rates} Mbit/s: {what} {percent:.1} % of the bus, limit {limit} %"))
            })
            .collect()
    }
}

fn headline(asked: &Plan, name: &str) -> String {
    let Plan { nodes, sensors, raw_every, raw_form, samples, foreign_percent } = *asked;
    let raw = if raw_form == RawForm::Plain { "raw" } else { "compressed raw" };
    let raw = match raw_every {
        0 => "no raw messages".to_owned(),
        1 => format!("{raw} messages of every frame, at worst {samples} samples"),
        every => format!("{raw} messages of every {every} frames, at worst {samples} samples"),
    };
    let foreign =
        if foreign_percent > 0 { format!(", {foreign_percent} % by others") } else { String::new() };
    let (nodes, sensors) = (counted(nodes, "module"), counted(sensors, "sensor"));
    format!("{nodes}, {sensors} each; {raw}{foreign}; typical: {name}")
}

fn table(asked: &Plan, name: &str, buses: &[BusLoad], warnings: &[String]) -> String {
    let mut text = headline(asked, name) + "\n\n";
    text += "  Mbit/s    load: typical   worst    flag latency, full bus: typical      any data\n";
    text += "                                                  computed    bus   computed    bus\n";
    for bus in buses {
        let rates = rates(bus.nominal_bps, bus.data_bps);
        let (typical, any) = (bus.latency_exact, bus.latency_worst);
        let _ = writeln!(
            text,
            "  {rates:<8} {:>12.1} % {:>6.1} % {:>21.1} µs {:>6.1} {:>7.1} µs {:>6.1}",
            bus.exact.total_percent,
            bus.worst.total_percent,
            typical.calculated_us,
            typical.simulated_us,
            any.calculated_us,
            any.simulated_us,
        );
    }
    for warning in warnings {
        let _ = writeln!(text, "\n  warning: {warning}");
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rates_are_mbit_per_s() {
        assert_eq!(Rates::parse("0.5/2"), Ok(Rates { nominal_bps: 500_000, data_bps: 2_000_000 }));
        for wrong in ["1", "1/9", "2/8", "0/8", "1/x", "-1/8", "1/NaN", "1/0.5", "1/"] {
            assert!(Rates::parse(wrong).is_err(), "{wrong}");
        }
    }
}
