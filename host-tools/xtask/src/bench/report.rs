//! The results: for people, for machines, and as Markdown for the README.

use std::fmt;
use std::fs;
use std::path::Path;

use anyhow::{Context, Result};
use serde::Serialize;

use super::compression::Compression;
use super::cycles::{Estimate, FunctionEstimate, LoopEstimate, StepEstimate};
use super::emulated::{Emulated, PathCost};
use super::host::Host;
use super::size::Size;
use crate::stack;
use crate::table::{Align, Table, thousands};

/// Everything that was measured.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Report {
    #[serde(skip_serializing_if = "Option::is_none")]
    pub emulated: Option<Emulated>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub cycles: Option<Estimate>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub size: Option<Size>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub stack: Option<stack::Report>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub host: Option<Host>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub compression: Option<Compression>,
}

impl Report {
    /// `bench.json` and `bench.md`, each written whole or not at all.
    pub fn write(&self, dir: &Path) -> Result<()> {
        fs::create_dir_all(dir).with_context(|| format!("cannot make {}", dir.display()))?;
        let json = serde_json::to_string_pretty(self)? + "\n";
        let markdown: String = self.tables().iter().map(|table| table.markdown() + "\n").collect();
        for (name, text) in [("bench.json", json), ("bench.md", markdown)] {
            let path = dir.join(name);
            let unfinished = dir.join(format!(".{name}"));
            fs::write(&unfinished, text)
                .and_then(|()| fs::rename(&unfinished, &path))
                .with_context(|| format!("cannot write {}", path.display()))?;
        }
        Ok(())
    }

    fn tables(&self) -> Vec<Table> {
        let mut tables = Vec::new();
        if let Some(emulated) = &self.emulated {
            tables.push(kernels(emulated));
            if !emulated.paths.is_empty() {
                tables.push(paths(emulated));
                tables.extend(emulated.paths.chunk_by(|a, b| a.sensors == b.sensors).map(parts));
            }
        }
        if let Some(estimate) = &self.cycles {
            tables.push(steps(estimate));
            tables.extend(estimate.steps.first().map(functions));
            tables.push(loops(estimate));
        }
        tables.extend(self.size.iter().map(|size| sections(size, self.emulated.as_ref())));
        tables.extend(self.stack.iter().map(stack::Report::table));
        tables.extend(self.host.iter().map(host));
        tables.extend(self.compression.iter().flat_map(compression));
        tables
    }
}

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.tables().iter().try_for_each(|table| writeln!(f, "\n{table}"))
    }
}

fn kernels(emulated: &Emulated) -> Table {
    let mut table = Table::new(
        format!(
            "Instructions of a call, exact, emulated Cortex-M7 (check: a loop of {} was measured as {})",
            thousands(emulated.loop_expected.into()),
            thousands(emulated.loop_measured.into())
        ),
        &[
            ("kernel", Align::Left),
            ("instructions", Align::Right),
            ("MACs", Align::Right),
            ("per MAC", Align::Right),
        ],
    );
    for kernel in &emulated.kernels {
        table.row([
            kernel.name.clone(),
            thousands(kernel.instructions.into()),
            macs(kernel.macs as usize),
            per_mac(kernel.instructions, kernel.macs as usize),
        ]);
    }
    table
}

fn paths(emulated: &Emulated) -> Table {
    let mut table = Table::new(
        "Instructions of a frame from samples to CAN frames, exact, emulated Cortex-M7".to_owned(),
        &[
            ("sensors", Align::Right),
            ("input", Align::Left),
            ("median", Align::Right),
            ("worst", Align::Right),
            ("MACs, full contact", Align::Right),
            ("per MAC", Align::Right),
            ("frames", Align::Right),
        ],
    );
    for path in &emulated.paths {
        table.row([
            path.sensors.to_string(),
            path.input.to_owned(),
            thousands(path.instructions.median.into()),
            thousands(path.instructions.worst.into()),
            macs(path.macs),
            per_mac(path.instructions.median, path.macs),
            path.frames.to_string(),
        ]);
    }
    table
}

/// Parts downwards, inputs across; all with the same number of sensors.
fn parts(paths: &[PathCost]) -> Table {
    let sensors = paths.first().map_or(0, |path| path.sensors);
    let mut columns = vec![("part", Align::Left), ("MACs", Align::Right)];
    for path in paths {
        columns.push((path.input, Align::Right));
        columns.push(("worst", Align::Right));
    }
    let mut table = Table::new(
        format!("The same by part, {sensors} sensor{}: instructions, median and worst", plural(sensors)),
        &columns,
    );
    let names = paths.first().map(|path| &path.parts[..]).unwrap_or_default();
    for (index, part) in names.iter().enumerate() {
        let mut row = vec![part.name.to_owned(), macs(part.macs)];
        for path in paths {
            let spread = path.parts[index].instructions;
            row.extend([thousands(spread.median.into()), thousands(spread.worst.into())]);
        }
        table.row(row);
    }
    let mut rest = vec!["rest".to_owned(), String::new()];
    rest.extend(paths.iter().flat_map(|path| [thousands(path.rest), String::new()]));
    table.row(rest);
    table
}

/// Of a frame at 240 Hz and 480 MHz, the clock of the board.
const CYCLES_PER_FRAME: f64 = 480e6 / 240.0;
/// Functions with less of the cycles are left to the JSON.
const SHARE_SHOWN: f64 = 0.002;

fn steps(estimate: &Estimate) -> Table {
    let mut table = Table::new(
        format!("Cycles of Pipeline::step, ESTIMATE by {}, memory without waits", estimate.model),
        &[
            ("sensors", Align::Right),
            ("input", Align::Left),
            ("instructions, exact", Align::Right),
            ("cycles, est.", Align::Right),
            ("of a frame at 480 MHz, est.", Align::Right),
        ],
    );
    for step in &estimate.steps {
        table.row([
            step.sensors.to_string(),
            step.input.to_owned(),
            thousands(step.instructions.into()),
            thousands(step.cycles as i64),
            format!("{:.0} %", 100.0 * step.cycles as f64 / CYCLES_PER_FRAME),
        ]);
    }
    table
}

fn functions(step: &StepEstimate) -> Table {
    let mut table = Table::new(
        format!("The same by function, {} sensor{}, calls left out", step.sensors, plural(step.sensors)),
        &[("function", Align::Left), ("instructions", Align::Right), ("cycles, est.", Align::Right)],
    );
    let shown = |function: &&FunctionEstimate| function.cycles as f64 >= SHARE_SHOWN * step.cycles as f64;
    for function in step.functions.iter().filter(shown) {
        table.row([
            short(&function.name),
            thousands(function.instructions as i64),
            thousands(function.cycles as i64),
        ]);
    }
    table
}

/// A row for each function: its loops differ in how many outputs they make at once.
fn loops(estimate: &Estimate) -> Table {
    let mut table = Table::new(
        "Inner loops of the network, the same estimate; per multiply-accumulate of the layer, of which a \
         convolution's loop does two in three"
            .to_owned(),
        &[
            ("function", Align::Left),
            ("loops", Align::Right),
            ("instructions per MAC", Align::Right),
            ("cycles per MAC, est.", Align::Right),
        ],
    );
    for loops in estimate.loops.chunk_by(|a, b| a.function == b.function) {
        let range = |value: &dyn Fn(&LoopEstimate) -> f64| {
            let values = loops.iter().map(|found| value(found) / f64::from(found.macs));
            let (least, most) =
                values.fold((f64::MAX, 0.0f64), |(least, most), x| (least.min(x), most.max(x)));
            if least == most { format!("{least:.2}") } else { format!("{least:.2} to {most:.2}") }
        };
        table.row([
            loops.first().map_or(String::new(), |found| short(&found.function)),
            loops.len().to_string(),
            range(&|found| found.instructions as f64),
            range(&|found| found.cycles),
        ]);
    }
    table
}

/// Names of generic functions fill a line.
fn short(name: &str) -> String {
    const LENGTH: usize = 60;
    if name.chars().count() <= LENGTH {
        return name.to_owned();
    }
    name.chars().take(LENGTH - 1).chain(['…']).collect()
}

fn sections(size: &Size, emulated: Option<&Emulated>) -> Table {
    let mut table = Table::new(
        "Memory of the firmware, bytes (NUCLEO-H743ZI2)".to_owned(),
        &[
            ("section", Align::Left),
            ("address", Align::Right),
            ("flash", Align::Right),
            ("RAM", Align::Right),
        ],
    );
    let bytes = |bytes: u64, counts: bool| if counts { thousands(bytes as i64) } else { String::new() };
    for section in &size.sections {
        table.row([
            section.name.clone(),
            format!("{:#010x}", section.address),
            bytes(section.bytes, section.in_flash),
            bytes(section.bytes, section.in_ram),
        ]);
    }
    let mut total = |name: &str, flash: Option<u64>, ram: Option<u64>| {
        let cell = |value: Option<u64>| value.map(|value| thousands(value as i64)).unwrap_or_default();
        table.row([name.to_owned(), String::new(), cell(flash), cell(ram)]);
    };
    total("together, without the stack", Some(size.flash_bytes), Some(size.ram_bytes));
    total("of that the model file", Some(size.model_bytes as u64), None);
    for (name, &bytes) in emulated.iter().flat_map(|emulated| &emulated.sizes) {
        total(&format!("size of a {name}"), None, Some(bytes.into()));
    }
    table
}

fn host(host: &Host) -> Table {
    let mut table = Table::new(
        format!("This computer, {} cores", host.cores),
        &[("what", Align::Left), ("measured", Align::Right)],
    );
    let rate = |frames_per_s: f64| format!("{} frames/s", thousands(frames_per_s as i64));
    table.row(["pipeline, one sensor, one core".to_owned(), rate(host.frames_per_s)]);
    if let Some(float) = host.float_frames_per_s {
        table.row(["float network on tract, one sensor, one core".to_owned(), rate(float)]);
    }
    let replay = &host.replay;
    let what = format!("{} frames of {} sensors, all cores", thousands(replay.frames as i64), replay.sensors);
    table.row([what, format!("{:.1} s", replay.wall_s)]);
    table
}

fn compression(all: &Compression) -> [Table; 3] {
    let mut sizes = Table::new(
        "A sensor's raw frame compressed alone, other coders with the layout that suits them better"
            .to_owned(),
        &[
            ("data", Align::Left),
            ("coder", Align::Left),
            ("bytes, mean", Align::Right),
            ("ratio", Align::Right),
        ],
    );
    let mut loads = Table::new(
        "Share of the bus, slip message included, by the bits of every frame; 240 frames/s".to_owned(),
        &[
            ("data", Align::Left),
            ("Mbit/s", Align::Left),
            ("sensors", Align::Right),
            ("mean", Align::Right),
            ("fullest period", Align::Right),
            ("plain, mean", Align::Right),
        ],
    );
    for data in &all.data {
        let plain = data.plain_bytes;
        sizes.row([data.name.clone(), "plain message".to_owned(), format!("{plain:.0}"), "1.00".to_owned()]);
        for (coder, bytes) in &data.coders {
            let ratio = format!("{:.2}", plain / bytes);
            sizes.row([String::new(), coder.clone(), format!("{bytes:.0}"), ratio]);
        }
        for (index, load) in data.loads.iter().enumerate() {
            let name = if index == 0 { data.name.clone() } else { String::new() };
            let percent = |share: f64| format!("{:.1} %", 100.0 * share);
            loads.row([
                name,
                format!("1/{}", load.data_bps / 1_000_000),
                load.sensors.to_string(),
                percent(load.mean),
                percent(load.worst),
                percent(load.plain_mean),
            ]);
        }
    }
    let mut costs = Table::new(
        "Instructions to compress a sensor's frame, exact, emulated Cortex-M7".to_owned(),
        &[
            ("input", Align::Left),
            ("median", Align::Right),
            ("worst", Align::Right),
            ("bytes, mean", Align::Right),
            ("longest beside plain", Align::Right),
            ("frames", Align::Right),
        ],
    );
    for cost in &all.costs {
        costs.row([
            cost.input.to_owned(),
            thousands(cost.median.into()),
            thousands(cost.worst.into()),
            format!("{:.0}", cost.mean_bytes),
            format!("{:+}", cost.longer_bytes),
            cost.frames.to_string(),
        ]);
    }
    [sizes, loads, costs]
}

fn plural(count: usize) -> &'static str {
    if count == 1 { "" } else { "s" }
}

fn macs(macs: usize) -> String {
    if macs == 0 { String::new() } else { thousands(macs as i64) }
}

fn per_mac(instructions: u32, macs: usize) -> String {
    if macs == 0 { String::new() } else { format!("{:.2}", f64::from(instructions) / macs as f64) }
}
