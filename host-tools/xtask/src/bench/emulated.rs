//! The benchmark program on the emulated board: exact numbers of instructions.

use std::fs;
use std::path::Path;

use anyhow::{Context, Result, bail, ensure};
use slipsense::net::Model;
use slipsense::params::MAX_SENSORS;
use slipsense_qemu::measured::{COMPRESSION_FILE, MEASURED_FILE, WARM_UP_FRAMES};
use slipsense_recording::model_file::cost;

use super::inputs::Input;
use crate::qemu::frames::Frames;
use crate::qemu::machine::{Machine, folder};
use crate::table::{Table, median_and_worst, thousands};

pub const PROGRAM: &str = "slipsense-qemu-bench";

#[derive(Debug, Default)]
pub struct Measured {
    /// Instructions of a loop by its code, and as measured: equal, or no number here is valid.
    loop_instructions: [u32; 2],
    /// Name, multiply-accumulates, instructions.
    kernels: Vec<(String, u32, u32)>,
    /// Of each frame: of `Pipeline::step`, and from its result to CAN frames.
    pub frames: Vec<[u32; 2]>,
    /// Of each sensor's frame compressed: bytes and instructions.
    pub compressed: Vec<[u32; 2]>,
}

/// Measure the kernels and, if `frames` is not 0, the path over as many frames of each input.
pub fn print(model: &[u8], frames: usize) -> Result<()> {
    let machine = Machine::build(PROGRAM)?;
    let layers = cost::layers(&Model::parse(model).context("the model to measure")?);
    let mut table = Table::new(
        "Instructions of a frame from samples to CAN frames, exact, emulated Cortex-M7",
        &["sensors", "input", "median", "worst", "MACs, full contact", "per MAC", "frames"],
    );
    let mut kernels = None;
    for sensors in 1..=MAX_SENSORS {
        for input in Input::ALL {
            let count = if frames == 0 { 0 } else { WARM_UP_FRAMES + frames };
            let measured = path(&machine, model, input, sensors, count)?;
            ensure!(
                *kernels.get_or_insert_with(|| measured.kernels.clone()) == measured.kernels,
                "two runs of the emulator disagree about a kernel: is it started with -icount?"
            );
            if count == 0 {
                print_kernels(&measured.kernels);
                return Ok(());
            }
            let [median, worst] = measured.median_and_worst_path();
            let macs = cost::macs_per_frame(&layers, sensors);
            table.row([
                sensors.to_string(),
                input.name().to_owned(),
                thousands(median),
                thousands(worst),
                thousands(macs as u64),
                format!("{:.2}", f64::from(median) / macs as f64),
                frames.to_string(),
            ]);
        }
    }
    print_kernels(&kernels.unwrap_or_default());
    print!("{table}");
    Ok(())
}

/// Measure the path over `count` frames of an input.
pub fn path(machine: &Machine, model: &[u8], input: Input, sensors: usize, count: usize) -> Result<Measured> {
    let dir = folder(&input.frames(sensors, count)?, model)?;
    eprintln!("{sensors} sensors, {}: {count} frames on the emulated Cortex-M7", input.name());
    machine.run(dir.path())?;
    let measured = Measured::read(dir.path())?;
    ensure!(measured.frames.len() == count, "{} frames of {count} measured", measured.frames.len());
    Ok(measured)
}

fn print_kernels(kernels: &[(String, u32, u32)]) {
    let mut table = Table::new(
        "Instructions of a call, exact, emulated Cortex-M7",
        &["kernel", "instructions", "MACs", "per MAC"],
    );
    for (name, macs, instructions) in kernels {
        let (macs_text, per_mac) = match macs {
            0 => Default::default(),
            _ => (thousands(*macs), format!("{:.2}", f64::from(*instructions) / f64::from(*macs))),
        };
        table.row([name.clone(), thousands(*instructions), macs_text, per_mac]);
    }
    print!("{table}");
}

/// Every sensor's frame compressed on the emulated core.
pub fn compressed(model: &[u8], frames: &Frames) -> Result<Vec<[u32; 2]>> {
    let machine = Machine::build(PROGRAM)?;
    let dir = folder(frames, model)?;
    fs::write(dir.path().join(COMPRESSION_FILE), "").context(COMPRESSION_FILE)?;
    machine.run(dir.path())?;
    Ok(Measured::read(dir.path())?.compressed)
}

impl Measured {
    pub fn read(dir: &Path) -> Result<Self> {
        let text = fs::read_to_string(dir.join(MEASURED_FILE));
        Self::parse(&text.context("the emulated program wrote no output")?)
    }

    /// Instructions of a frame from samples to CAN frames, once the windows are full.
    pub fn median_and_worst_path(&self) -> [u32; 2] {
        let path = self.frames[WARM_UP_FRAMES..].iter().map(|[step, wire]| step + wire);
        median_and_worst(path.collect())
    }

    fn parse(text: &str) -> Result<Self> {
        let mut all = Self::default();
        for line in text.lines() {
            let wrong = || format!("the emulated program wrote `{line}`");
            let mut words = line.splitn(4, ' ');
            let kind = words.next();
            let mut number = || words.next().and_then(|word| word.parse().ok()).with_context(wrong);
            let [a, b]: [u32; 2] = [number()?, number()?];
            match (kind, words.next()) {
                (Some("check"), None) => all.loop_instructions = [a, b],
                (Some("kernel"), Some(name)) => all.kernels.push((name.to_owned(), a, b)),
                (Some("frame"), None) => all.frames.push([a, b]),
                (Some("compressed"), None) => all.compressed.push([a, b]),
                _ => bail!(wrong()),
            }
        }
        let [expected, measured] = all.loop_instructions;
        ensure!(
            expected == measured && expected > 0,
            "a loop of {expected} instructions was measured to take {measured}: the counter is wrong"
        );
        Ok(all)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_of_the_program_are_read() {
        let text = "check 10 10\nkernel 3 4 conv 3x3 8x8x16->32, ReLU\nframe 5 6\ncompressed 7 8\n";
        let all = Measured::parse(text).unwrap();
        assert_eq!((all.frames, all.compressed), (vec![[5, 6]], vec![[7, 8]]));
        assert_eq!(all.kernels, [("conv 3x3 8x8x16->32, ReLU".to_owned(), 3, 4)]);
        assert!(Measured::parse("check 10 10\nframe 5\n").is_err());
        // A counter that is off.
        let error = Measured::parse("check 200000 200001\n").unwrap_err().to_string();
        assert!(error.contains("200001"), "{error}");
        assert!(Measured::parse("").is_err(), "without the check no number is valid");
    }
}
