//! The bound, in tables and sentences.

use std::collections::BTreeMap;
use std::fmt::Write;

use anyhow::{Result, ensure};

use super::panicking::Tasks;
use crate::firmware::BOARD;
use crate::regions::Regions;
use crate::table::{Table, thousands};

/// One handler, or the start of the program.
pub struct Root {
    pub name: String,
    pub bytes: u64,
    /// The deepest way: functions and their frames, outermost first.
    pub way: Vec<(String, u64)>,
}

/// Handlers of one priority.
pub struct Level {
    pub name: &'static str,
    pub roots: Vec<Root>,
}

impl Level {
    fn bytes(&self) -> u64 {
        self.roots.iter().map(|root| root.bytes).max().unwrap_or(0)
    }
}

/// The signal path, without what a panic would print.
pub struct FramePath {
    pub functions: usize,
    pub bytes: u64,
    /// Functions with a check that may end in a panic, as far as the calls say.
    pub may_panic: Vec<String>,
}

pub struct Report {
    pub regions: Regions,
    /// What the memory map gives.
    pub region_bytes: u64,
    /// What the core saves at each preemption.
    pub exception_bytes: u64,
    pub levels: Vec<Level>,
    pub frame_path: FramePath,
    pub frame_tasks: Tasks,
    pub functions: usize,
    /// Functions whose frame was read off their instructions.
    pub read_off: usize,
    /// Functions that call through registers, and at how many places.
    pub indirect: BTreeMap<String, usize>,
}

impl Report {
    fn saved_bytes(&self) -> u64 {
        self.levels.len().saturating_sub(1) as u64 * self.exception_bytes
    }

    fn bound_bytes(&self) -> u64 {
        self.levels.iter().map(Level::bytes).sum::<u64>() + self.saved_bytes()
    }

    pub fn fits(&self) -> bool {
        self.bound_bytes() <= self.region_bytes && self.regions.fits()
    }

    /// Is every branch that may panic in what a frame wakes one of which is known that it is never taken?
    pub fn holds_no_new_panic(&self) -> Result<()> {
        let new: Vec<_> = self.frame_path.may_panic.iter().chain(&self.frame_tasks.unknown).collect();
        ensure!(
            new.is_empty(),
            "a frame may end in a panic, and stack/panicking.rs does not say why not: {new:?}"
        );
        Ok(())
    }

    fn table(&self) -> Table {
        let title = format!("Stack of the firmware, bytes: bounds over the linked program ({BOARD})");
        let mut table = Table::new(title, &["level", "starts at", "bound"]);
        for level in &self.levels {
            for (index, root) in level.roots.iter().enumerate() {
                let name = if index == 0 { level.name } else { "" };
                table.row([name.to_owned(), root.name.clone(), thousands(root.bytes)]);
            }
        }
        let preemptions = format!("saved at {} preemptions", self.levels.len().saturating_sub(1));
        for (name, bytes) in [
            (preemptions.as_str(), self.saved_bytes()),
            ("deepest of each level, together", self.bound_bytes()),
            ("region of the memory map", self.region_bytes),
        ] {
            table.row([name.to_owned(), String::new(), thousands(bytes)]);
        }
        table
    }

    pub fn text(&self, ways: bool) -> String {
        let mut text = format!("{}{}\n", self.regions.table(), self.table());
        let FramePath { functions, bytes, may_panic } = &self.frame_path;
        _ = writeln!(
            text,
            "Pipeline::step: {} bytes, {functions} functions, no recursion, no call through a register; {} of them \
             hold a check that may panic",
            thousands(*bytes),
            may_panic.len()
        );
        let Tasks { functions, known, unknown } = &self.frame_tasks;
        _ = writeln!(
            text,
            "Tasks of a frame: {functions} functions; {} branches that may panic, never taken for a reason that \
             stack/panicking.rs gives; {} without a reason",
            known.len(),
            unknown.len()
        );
        let places: usize = self.indirect.values().sum();
        _ = writeln!(
            text,
            "{} functions, {} of them assembly whose frame was read off the instructions; {} call through registers \
             at {places} places, all resolved by name",
            self.functions,
            self.read_off,
            self.indirect.len()
        );
        if ways {
            for root in self.levels.iter().flat_map(|level| &level.roots) {
                _ = writeln!(text, "\n{}", root.name);
                for (name, bytes) in &root.way {
                    _ = writeln!(text, "  {:>7}  {name}", thousands(*bytes));
                }
            }
            _ = writeln!(text, "\nBranches of the tasks of a frame that may panic, and why none is taken");
            for (branch, reason) in &self.frame_tasks.known {
                _ = writeln!(text, "  {branch}: {reason}");
            }
            _ = writeln!(text, "\nFunctions that call through registers");
            for (name, places) in &self.indirect {
                _ = writeln!(text, "  {places:>7}  {name}");
            }
        }
        text
    }
}
