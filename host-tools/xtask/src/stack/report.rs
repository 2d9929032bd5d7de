//! The bound, for people and machines.

use std::collections::BTreeMap;
use std::fmt::Write;

use anyhow::{Result, ensure};
use serde::Serialize;

use super::panicking::Tasks;
use crate::regions::Regions;
use crate::table::{Align, Table, thousands};

/// One handler, or the start of the program.
#[derive(Clone, Debug, Serialize)]
pub struct Root {
    pub name: String,
    pub bytes: u64,
    /// The deepest way: functions and their frames, outermost first.
    pub way: Vec<(String, u64)>,
}

/// Handlers of one priority.
#[derive(Clone, Debug, Serialize)]
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
#[derive(Clone, Debug, Serialize)]
pub struct FramePath {
    pub functions: usize,
    pub bytes: u64,
    /// Functions with a check that may end in a panic, as far as the calls say.
    pub may_panic: Vec<String>,
}

/// Everything about the stack.
#[derive(Clone, Debug, Serialize)]
pub struct Report {
    /// Board and memories.
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
    /// All levels and the preemptions between them.
    pub fn bound_bytes(&self) -> u64 {
        let preemptions = self.levels.len().saturating_sub(1) as u64;
        self.levels.iter().map(Level::bytes).sum::<u64>() + preemptions * self.exception_bytes
    }

    pub fn fits(&self) -> bool {
        self.bound_bytes() <= self.region_bytes && self.regions.fits()
    }

    /// Is every branch that may panic in what a frame wakes one of which is known that it is never taken?
    pub fn holds_no_new_panic(&self) -> Result<()> {
        let new = self.frame_path.may_panic.iter().chain(&self.frame_tasks.unknown);
        let new: Vec<_> = new.map(String::as_str).collect();
        ensure!(
            new.is_empty(),
            "{}: a frame may end in a panic, and stack/panicking.rs does not say why not: {}",
            self.regions.board.label(),
            new.join("; ")
        );
        Ok(())
    }

    pub fn table(&self) -> Table {
        let mut table = Table::new(
            format!(
                "Stack of the firmware, bytes: bounds over the linked program ({})",
                self.regions.board.label()
            ),
            &[("level", Align::Left), ("starts at", Align::Left), ("bound", Align::Right)],
        );
        for level in &self.levels {
            for (index, root) in level.roots.iter().enumerate() {
                let name = if index == 0 { level.name } else { "" };
                table.row([name.to_owned(), root.name.clone(), thousands(root.bytes as i64)]);
            }
        }
        let saved = format!("saved at {} preemptions", self.levels.len().saturating_sub(1));
        let saved_bytes = self.bound_bytes() - self.levels.iter().map(Level::bytes).sum::<u64>();
        table.row([saved, String::new(), thousands(saved_bytes as i64)]);
        table.row([
            "deepest of each level, together".into(),
            String::new(),
            thousands(self.bound_bytes() as i64),
        ]);
        table.row(["region of the memory map".into(), String::new(), thousands(self.region_bytes as i64)]);
        table
    }

    pub fn text(&self, ways: bool) -> String {
        let mut text = format!("\n{}\n{}", self.regions.table(), self.table());
        let FramePath { functions, bytes, may_panic } = &self.frame_path;
        let panics = match may_panic.len() {
            0 => "none of them can panic".to_owned(),
            count => format!("{count} of them hold a check that may panic"),
        };
        _ = writeln!(
            text,
            "Pipeline::step: {} bytes, {functions} functions, no recursion, no call through a register; {panics}",
            thousands(*bytes as i64)
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
                    _ = writeln!(text, "  {:>7}  {name}", thousands(*bytes as i64));
                }
            }
            _ = writeln!(text, "\nFunctions of the frame path with a check that may panic");
            for name in &self.frame_path.may_panic {
                _ = writeln!(text, "  {name}");
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
