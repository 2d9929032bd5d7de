//! `slipsense calibrate`: a module measures its untouched arrays; a known weight gives their gain.

use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail, ensure};
use serde_json::json;
use slipsense::calibration::{GAIN_MAX, GAIN_ONE, SECONDS_MAX, State};
use slipsense::node::{ACCESS_PORT, CALIBRATE, COMMAND_PORT, SCALE_GAIN};
use slipsense::params::{COL_PITCH_MM, CONTACT_SUM_MIN, COUNT_MAX, MAX_SENSORS, ROW_PITCH_MM};
use slipsense::sensor::PiezoFrame;
use slipsense::wire::{Frames, NodeId, Priority, Received, ServiceId, ServiceRole, Sessions, TransferId};
use slipsense_recording::decode::Decoder;
use slipsense_recording::link::{Input, Place, Source, open};
use slipsense_synth::{EXPONENT, pressure_kpa};

use super::Print;
use super::convert::node_id;

const TOOL: NodeId = NodeId::new(126).unwrap();
/// A node answers within this time; a store may take an erase of its flash.
const ANSWER: Duration = Duration::from_secs(10);
/// How often a measurement that goes on is looked at.
const LOOK: Duration = Duration::from_millis(500);
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
    /// Bit rate of the data phase to set at an slcan adapter, Mbit/s
    #[arg(long, value_name = "MBIT", default_value = "8", value_parser = clap::value_parser!(u8).range(1..=8))]
    data_mbit: u8,
    #[command(flatten)]
    print: Print,
}

impl Args {
    pub fn run(self) -> Result<()> {
        if let Some(newton) = self.newton {
            ensure!(newton.is_finite() && newton > 0.0, "--newton {newton}: must be positive");
        }
        if !self.source.is_live() && self.newton.is_none() {
            bail!(
                "{}: offset and noise need ADC codes, a recording holds counts; give a bus, or --newton",
                place_name(&self.source)
            );
        }
        let mut client = Client::new(open(&self.source, self.data_mbit)?, self.node_id);
        let factor = match self.newton {
            Some(newton) => {
                let frames = usize::from(self.seconds.unwrap_or(2)) * PRESS_FRAMES;
                let (found, factor) = gain(&client.press(self.sensor, frames)?, newton)?;
                if self.source.is_live() {
                    self.change(&mut client, SCALE_GAIN, factor)?;
                }
                Some((found, factor))
            }
            None if self.forget => {
                self.change(&mut client, CALIBRATE, 0)?;
                None
            }
            None => {
                self.change(&mut client, CALIBRATE, self.seconds.unwrap_or(10).into())?;
                None
            }
        };
        let numbers = match self.source.is_live() {
            true => client.register(&format!("slipsense.sensor.{}.calibration", self.sensor))?,
            false => Vec::new(),
        };
        let gain = factor.map(|(found, factor)| {
            json!({"newton_before": found, "factor": f64::from(factor) / f64::from(GAIN_ONE)})
        });
        let (mut result, mut text) = (json!({"sensor": self.sensor, "gain": gain}), String::new());
        if let Some((found, factor)) = factor {
            let factor = f64::from(factor) / f64::from(GAIN_ONE);
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

    /// Let the module measure, or change its calibration, and wait.
    fn change(&self, client: &mut Client, command: u16, number: u16) -> Result<()> {
        client.command(command, &format!("{} {number}", self.sensor))?;
        let seconds = if command == CALIBRATE { number } else { 0 };
        let bar = self.print.progress(usize::from(seconds) * 240, "hands off");
        let deadline = Instant::now() + Duration::from_secs(seconds.into()) + ANSWER;
        loop {
            std::thread::sleep(LOOK);
            let numbers = client.register("slipsense.status.measurement")?;
            let &[_, state, frames, wanted, row, col] = &numbers[..] else {
                bail!("node {}: no such measurement: {numbers:?}", client.node.get());
            };
            bar.set_position(frames);
            let is = |other: State| state == other as u64;
            if is(State::Done) {
                bar.finish_and_clear();
                return Ok(());
            }
            let at = format!("sensor {}, row {row}, column {col}", self.sensor);
            ensure!(
                !is(State::Touched),
                "{at} of the scan: touched while it was measured; lift everything off"
            );
            ensure!(!is(State::Faulty), "{at} of the scan is the first of too many taxels out of order");
            ensure!(!is(State::TooShort), "sensor {}: no whole second of scans came", self.sensor);
            ensure!(!is(State::NotStored), "sensor {}: the flash refused the calibration", self.sensor);
            ensure!(!is(State::Gain), "sensor {}: a gain would be 0, or 2 and more", self.sensor);
            ensure!(Instant::now() < deadline, "{frames} of {wanted} frames, then nothing more");
        }
    }
}

fn place_name(place: &Place) -> String {
    match place {
        Place::File(path, _) => path.display().to_string(),
        _ => "standard input".to_owned(),
    }
}

/// Force by the nominal film, N, and the factor that makes it `newton`, 1/2048.
fn gain(press: &[PiezoFrame], newton: f64) -> Result<(f64, u16)> {
    ensure!(press.len() >= PRESS_FRAMES, "{} raw frames of this sensor, need {PRESS_FRAMES}", press.len());
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

struct Client {
    source: Source,
    node: NodeId,
    transfer: u8,
    decoder: Decoder,
}

impl Client {
    fn new(source: Source, node: NodeId) -> Self {
        Self { source, node, transfer: 0, decoder: Decoder::new() }
    }

    fn request(&mut self, port: u16, payload: &[u8]) -> Result<Vec<u8>> {
        let (priority, role) = (Priority::Nominal, ServiceRole::Request);
        let id = ServiceId { priority, role, port, destination: self.node, source: TOOL };
        self.transfer = (self.transfer + 1) % 32;
        for frame in Frames::new(id, self.transfer, payload) {
            self.source.send(&frame)?;
        }
        let mut sessions = Box::new(Sessions::<1, 640>::new());
        let (wanted, deadline) = (TransferId::Service(id.response()).to_can(), Instant::now() + ANSWER);
        while Instant::now() < deadline {
            match self.source.receive()? {
                Input::Frame(entry) if entry.frame.id() == wanted => {
                    let id = TransferId::from_can(wanted).context("an identifier of our own")?;
                    if let Ok(Some(arrived)) = sessions.accept(id, &entry.frame, 0)
                        && arrived.transfer == self.transfer
                    {
                        return Ok(arrived.payload.to_vec());
                    }
                }
                Input::End => break,
                Input::Frame(_) | Input::Other(_) | Input::Idle => {}
            }
        }
        bail!("node {} does not answer", self.node.get())
    }

    fn command(&mut self, command: u16, parameter: &str) -> Result<()> {
        let payload = [&command.to_le_bytes()[..], &[parameter.len() as u8], parameter.as_bytes()].concat();
        let answer = self.request(COMMAND_PORT, &payload)?;
        let why = answer.get(2..).map(String::from_utf8_lossy).unwrap_or_default();
        ensure!(
            answer.first() == Some(&0),
            "node {} refuses: {}",
            self.node.get(),
            why.trim_end_matches('\0')
        );
        Ok(())
    }

    /// The numbers in a register of natural16 or natural32.
    fn register(&mut self, name: &str) -> Result<Vec<u64>> {
        let payload = [&[name.len() as u8], name.as_bytes(), &[0]].concat();
        let answer = self.request(ACCESS_PORT, &payload)?;
        let (bytes, elements) = match answer.get(8..) {
            Some([9, count, rest @ ..]) => (4, rest.get(..4 * usize::from(*count))),
            Some([10, count, rest @ ..]) => (2, rest.get(..2 * usize::from(*count))),
            _ => (1, None),
        };
        let elements = elements
            .with_context(|| format!("node {}: {name} is not there: an older firmware?", self.node.get()))?;
        let number = |bytes: &[u8]| bytes.iter().rev().fold(0, |number, &byte| number << 8 | u64::from(byte));
        Ok(elements.chunks(bytes).map(number).collect())
    }

    fn press(&mut self, sensor: u8, frames: usize) -> Result<Vec<PiezoFrame>> {
        let (mut press, mut heard) = (Vec::new(), Instant::now());
        while press.len() < frames {
            match self.source.receive()? {
                Input::Frame(entry) => {
                    if let Some(decoded) = self.decoder.accept(&entry.frame)
                        && let Received::Raw(message) = decoded.message
                        && (decoded.node, message.sensor) == (self.node, sensor)
                    {
                        press.push(message.piezo);
                        heard = Instant::now();
                    }
                }
                Input::End => break,
                Input::Other(_) | Input::Idle => {}
            }
            if heard.elapsed() > ANSWER {
                bail!("no raw frames of sensor {sensor} of node {}", self.node.get());
            }
        }
        Ok(press)
    }
}
