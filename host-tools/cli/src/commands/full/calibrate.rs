//! `slipsense calibrate`: a module measures its untouched arrays; a known weight gives their gain.

use std::time::Instant;

use anyhow::{Result, bail, ensure};
use serde_json::json;
use slipsense::calibration::{GAIN_MAX, GAIN_ONE, SECONDS_MAX};
use slipsense::node::{CALIBRATE, SCALE_GAIN};
use slipsense::params::{COL_PITCH_MM, CONTACT_SUM_MIN, COUNT_MAX, MAX_SENSORS, ROW_PITCH_MM};
use slipsense::sensor::PiezoFrame;
use slipsense::wire::{NodeId, Received, Region};
use slipsense_recording::client::{ANSWER, Bus, Client};
use slipsense_recording::decode::Decoder;
use slipsense_recording::film::{EXPONENT, pressure_kpa};
use slipsense_recording::link::{Input, Place, Source, open};

use super::Print;
use super::convert::node_id;
use super::live::DataRate;

const TOOL: NodeId = NodeId::new(126).unwrap();
/// Frames of a press, at least: a second.
const PRESS_FRAMES: usize = 240;
/// Spread of the force over the frames of a press, share of it, standard deviation.
const STEADY: f64 = 0.05;

/// Measure the untouched pads of a module, or their gain under a known weight
///
/// Without calibration a module assumes the nominal offsets of its front end. Ten seconds of an untouched pad give
/// offset and noise of every taxel and a mask of those that do not work; the module measures in ADC codes, stores the
/// result in its flash and uses it at once. It refuses a pad that is touched meanwhile and names the taxel.
#[derive(clap::Args)]
#[command(after_help = "\
With --newton the pad must be loaded with a known force for as long as the command runs. The force is computed from
the raw frames, by the nominal film, over the whole pad; one factor for all taxels makes it right. From a recording the
factor is printed, and not sent. Offset and noise need ADC codes, which no recording holds.

No adapter and no module has been tried: the command's test runs against the library's node behind a socket.

Examples:
  slipsense calibrate socketcan:can0                        sensor 0 of node 42, hands off for 10 s
  slipsense calibrate slcan:/dev/ttyACM0 --sensor 2 --seconds 30
  slipsense calibrate socketcan:can0 --newton 4.905         500 g on the pad
  slipsense calibrate press.mcap --newton 4.905 --json      the factor, from a recording
  slipsense calibrate socketcan:can0 --forget               back to nominal values")]
pub struct Args {
    /// The bus, as for `slipsense record`, or with --newton a recording
    #[arg(value_name = "SOURCE")]
    source: Place,
    /// Which sensor's array
    #[arg(long, value_name = "N", default_value = "0", value_parser = clap::value_parser!(u8).range(..MAX_SENSORS as i64))]
    sensor: u8,
    /// Address of the module
    #[arg(long, value_name = "N", default_value = "42", value_parser = node_id)]
    node_id: NodeId,
    /// Time to measure: the untouched pad 10 s, the press 2 s if not given
    #[arg(long, value_name = "S", value_parser = clap::value_parser!(u8).range(1..=SECONDS_MAX as i64))]
    seconds: Option<u8>,
    /// Measure the gain instead, under this force over the whole pad
    #[arg(long, value_name = "N", conflicts_with = "forget")]
    newton: Option<f64>,
    /// Forget the array's calibration instead
    #[arg(long)]
    forget: bool,
    #[command(flatten)]
    data: DataRate,
    #[command(flatten)]
    print: Print,
}

impl Args {
    pub fn run(self) -> Result<()> {
        if let Some(newton) = self.newton {
            ensure!(newton.is_finite() && newton > 0.0, "--newton {newton}: must be positive");
        }
        if !self.source.is_live() && self.newton.is_none() {
            let name = match &self.source {
                Place::File(path, _) => path.display().to_string(),
                _ => "standard input".to_owned(),
            };
            bail!(
                "{name}: offset and noise need ADC codes, a recording holds counts; give a bus, or --newton"
            );
        }
        let mut source = open(&self.source, self.data.data_mbit)?;
        let gain = self.newton.map(|newton| gain(&self.press(&mut source)?, newton)).transpose()?;
        let numbers = if self.source.is_live() { self.change(&mut source, gain)? } else { Vec::new() };
        let gain = gain.map(|(found, factor)| (found, f64::from(factor) / f64::from(GAIN_ONE)));
        let gain_json = gain.map(|(found, factor)| json!({"newton_before": found, "factor": factor}));
        let (mut result, mut text) = (json!({"sensor": self.sensor, "gain": gain_json}), String::new());
        if let Some((found, factor)) = gain {
            text += &format!("sensor {}: {found:.3} N before, gain times {factor:.4}\n", self.sensor);
        }
        if let &[version, id, faulty, noise] = &numbers[..] {
            let noise_codes = noise as f64 / 8.0;
            result["calibration"] = json!({
                "version": version, "id": format!("{id:08x}"), "faulty": faulty, "noise_codes": noise_codes,
            });
            text += &match version {
                0 => format!("sensor {}: not calibrated\n", self.sensor),
                _ => format!(
                    "sensor {}: calibration {version} {id:08x}, {faulty} taxels masked, noise {noise_codes:.1} codes\n",
                    self.sensor
                ),
            };
        }
        self.print.show(&result, || text)
    }

    /// Let the module measure, or change its calibration, and wait; the numbers of the calibration that it then has.
    fn change(&self, source: &mut Source, gain: Option<(f64, u16)>) -> Result<Vec<u64>> {
        let (seconds, command) = match gain {
            Some((_, factor)) => (0, (SCALE_GAIN, factor)),
            None if self.forget => (0, (CALIBRATE, 0)),
            None => (self.seconds.unwrap_or(10), (CALIBRATE, self.seconds.unwrap_or(10).into())),
        };
        let (mut client, mut bus) =
            (Client::new(TOOL, self.node_id), Bus { source, others: &mut |_| Ok(()) });
        self.print.progress(usize::from(seconds) * 240, "hands off", |bar| {
            client.calibrate(&mut bus, self.sensor, command, &mut |frames| bar.set_position(frames))
        })?;
        client.register(&mut bus, &format!("slipsense.sensor.{}.calibration", self.sensor))
    }

    /// Raw frames of the sensor with all taxels.
    fn press(&self, source: &mut Source) -> Result<Vec<PiezoFrame>> {
        let frames = usize::from(self.seconds.unwrap_or(2)) * PRESS_FRAMES;
        let (mut decoder, mut press, mut heard) = (Decoder::new(), Vec::new(), Instant::now());
        while press.len() < frames {
            match source.receive()? {
                Input::Frame(entry) => {
                    if let Some(decoded) = decoder.accept(&entry.frame)
                        && let Received::Raw(message) = decoded.message
                        && (decoded.node, message.sensor) == (self.node_id, self.sensor)
                    {
                        heard = Instant::now();
                        press.extend((message.known() == Region::ALL).then_some(message.piezo));
                    }
                }
                Input::End => {
                    source.notes().iter().for_each(|note| eprintln!("note: {note}"));
                    break;
                }
                Input::Other(_) | Input::Idle => {}
            }
            if heard.elapsed() > ANSWER {
                bail!("no raw frames of sensor {} of node {}", self.sensor, self.node_id.get());
            }
        }
        Ok(press)
    }
}

/// Force by the nominal film, N, and the factor that makes it `newton`, 1/2048.
fn gain(press: &[PiezoFrame], newton: f64) -> Result<(f64, u16)> {
    ensure!(
        press.len() >= PRESS_FRAMES,
        "{} raw frames of this sensor with all taxels, need {PRESS_FRAMES}",
        press.len()
    );
    let area_mm2 = f64::from(COL_PITCH_MM * ROW_PITCH_MM);
    let mut forces = Vec::new();
    for frame in press {
        ensure!(frame.sum() >= CONTACT_SUM_MIN, "the pad is not loaded in all frames");
        ensure!(!frame.is_saturated(), "a taxel reads {COUNT_MAX}, full scale: spread the weight");
        // kPa times mm² is mN.
        let kpa: f64 = frame.active().map(|count| pressure_kpa(count.into())).sum();
        forces.push(kpa * area_mm2 / 1e3);
    }
    let mean = forces.iter().sum::<f64>() / forces.len() as f64;
    let variance = forces.iter().map(|force| (force - mean).powi(2)).sum::<f64>() / forces.len() as f64;
    let spread = variance.sqrt() / mean;
    ensure!(spread <= STEADY, "the force is not steady: it scatters by {:.0} %", 100.0 * spread);
    // Conductance goes with this power of pressure.
    let factor = (newton / mean).powf(EXPONENT) * f64::from(GAIN_ONE);
    ensure!(
        (f64::from(GAIN_ONE) / 4.0..=f64::from(GAIN_MAX)).contains(&factor.round()),
        "{mean:.3} N by the nominal film: a gain of {:.2} is beyond 0.25 to 2",
        factor / f64::from(GAIN_ONE)
    );
    Ok((mean, factor.round() as u16))
}
