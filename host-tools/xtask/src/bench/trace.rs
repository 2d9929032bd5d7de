//! Every instruction of one `Pipeline::step` on the emulated board, in order, by function.

use std::collections::hash_map::Entry;
use std::collections::{BTreeMap, HashMap};

use anyhow::{Context, Result, ensure};

use crate::elf::{Code, Image, Instruction};

/// Where the frame path begins.
const STEP: &str = "pipeline::Pipeline>::step";
/// The emulator ends a stretch where a page of the emulated core does.
const PAGE_BYTES: u64 = 1024;

/// By function what was done of it, in order, whatever was done between.
pub type Trace = BTreeMap<String, Vec<Instruction>>;

/// Gathers the stretches of the first step in a trace.
pub struct Recorder {
    image: Image,
    /// The function that a stretch lies in, by the stretch's address.
    lies_in: HashMap<u32, Option<usize>>,
    step: usize,
    state: State,
    stretches: Vec<u32>,
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum State {
    /// Before the step, in this function.
    Before(Option<usize>),
    /// In the step that this function called.
    Inside(Option<usize>),
    After,
}

impl Recorder {
    /// For this program.
    pub fn new(image: Image) -> Result<Self> {
        let step = image.functions.iter().position(|function| function.name.ends_with(STEP));
        let step = step.with_context(|| format!("the program has no function `{STEP}`"))?;
        let (state, stretches) = (State::Before(None), Vec::new());
        Ok(Self { image, lies_in: HashMap::new(), step, state, stretches })
    }

    /// A stretch of instructions begins here.
    pub fn see(&mut self, pc: u32) {
        let image = &self.image;
        let function = *self.lies_in.entry(pc).or_insert_with(|| image.function_at(pc.into()));
        let begins = function == Some(self.step) && u64::from(pc) == image.functions[self.step].address;
        self.state = match self.state {
            State::Before(caller) if begins => State::Inside(caller),
            State::Before(_) => State::Before(function),
            State::Inside(caller) if function == caller => State::After,
            state => state,
        };
        if let State::Inside(_) = self.state {
            self.stretches.push(pc);
        }
    }

    /// The stretches as instructions.
    pub fn trace(self) -> Result<Trace> {
        ensure!(self.state == State::After, "the emulated program did not come back from `{STEP}`");
        let code = Code::new()?;
        let mut known = HashMap::new();
        let mut functions = Trace::new();
        let next = self.stretches.iter().skip(1).map(|&next| Some(u64::from(next))).chain([None]);
        for (&pc, next) in self.stretches.iter().zip(next) {
            let index = self.lies_in.get(&pc).copied().flatten();
            let function = &self.image.functions[index.with_context(|| format!("no function at {pc:#x}"))?];
            let instructions = match known.entry(function.address) {
                Entry::Occupied(found) => found.into_mut(),
                Entry::Vacant(new) => new.insert(code.of(&self.image, function)?),
            };
            let done = stretch(instructions, pc.into(), next);
            functions.entry(function.name.clone()).or_default().extend_from_slice(done);
        }
        Ok(functions)
    }
}

/// From `pc` up to a branch or the end of the page; an instruction that crosses it stands alone. The emulator's
/// clock may end a stretch early: then the `next` begins inside it, where no branch leads.
fn stretch(function: &[Instruction], pc: u64, next: Option<u64>) -> &[Instruction] {
    let begin = function.partition_point(|instruction| instruction.address < pc);
    let rest = &function[begin..];
    let page_end = (pc / PAGE_BYTES + 1) * PAGE_BYTES;
    let end = |instruction: &Instruction| instruction.address + instruction.bytes;
    let last = rest.iter().position(|instruction| instruction.branches() || end(instruction) >= page_end);
    let count = match last {
        None => rest.len(),
        Some(last) if last > 0 && end(&rest[last]) > page_end => last,
        Some(last) => last + 1,
    };
    let whole = &rest[..count];
    let cut = whole.iter().skip(1).position(|instruction| Some(instruction.address) == next);
    let leads_there = whole.last().is_some_and(|last| last.direct_target() == next);
    cut.filter(|_| !leads_there).map_or(whole, |cut| &whole[..cut + 1])
}

#[cfg(test)]
mod tests {
    use super::*;

    fn code(from: u64, lines: &[(&str, &str, u64)]) -> Vec<Instruction> {
        let mut address = from;
        let mut code = Vec::new();
        for &(mnemonic, operands, bytes) in lines {
            let (mnemonic, operands) = (mnemonic.to_owned(), operands.to_owned());
            code.push(Instruction { address, bytes, mnemonic, operands });
            address += bytes;
        }
        code
    }

    #[test]
    fn a_stretch_ends_with_a_branch() {
        let code =
            code(0x100, &[("nop", "", 2), ("ldr", "r0, [r1]", 2), ("bne", "#0x100", 2), ("bx", "lr", 2)]);
        assert_eq!(stretch(&code, 0x102, Some(0x106)).len(), 2);
        assert_eq!(stretch(&code, 0x106, None).len(), 1);
    }

    #[test]
    fn a_stretch_ends_where_the_next_begins_unless_a_branch_leads_there() {
        let code =
            code(0x100, &[("nop", "", 2), ("ldr", "r0, [r1]", 2), ("nop", "", 2), ("bne", "#0x102", 2)]);
        assert_eq!(stretch(&code, 0x100, Some(0x104)).len(), 2);
        assert_eq!(stretch(&code, 0x100, Some(0x102)).len(), 4);
        assert_eq!(stretch(&code, 0x100, Some(0x108)).len(), 4);
    }

    #[test]
    fn a_stretch_ends_with_the_page() {
        let wide = ("ldr.w", "r0, [r1]", 4);
        let aligned = code(0x3f8, &[wide, wide, wide]);
        assert_eq!(stretch(&aligned, 0x3f8, None).len(), 2);
        let crossing = code(0x3fa, &[wide, wide, wide]);
        assert_eq!(stretch(&crossing, 0x3fa, None).len(), 1);
        assert_eq!(stretch(&crossing, 0x3fe, None).len(), 1);
    }
}
