//! Every instruction of one `Pipeline::step` on the emulated board, in order, by function.

use std::collections::hash_map::Entry;
use std::collections::{BTreeMap, HashMap};

use anyhow::{Context, Result, ensure};

use crate::elf::{Code, Image, Instruction};

/// Where the frame path begins.
const STEP: &str = "pipeline::Pipeline>::step";
/// By function what was done of it, in order, whatever was done between.
pub type Trace = BTreeMap<String, Vec<Instruction>>;

/// Gathers the instructions of the first step in a trace.
pub struct Recorder {
    image: Image,
    /// The function that an instruction lies in, by its address.
    lies_in: HashMap<u32, Option<usize>>,
    step: usize,
    state: State,
    addresses: Vec<u32>,
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
        let (state, addresses) = (State::Before(None), Vec::new());
        Ok(Self { image, lies_in: HashMap::new(), step, state, addresses })
    }

    /// The instruction at this address is done.
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
            self.addresses.push(pc);
        }
    }

    /// The instructions themselves.
    pub fn trace(self) -> Result<Trace> {
        ensure!(self.state == State::After, "the emulated program did not come back from `{STEP}`");
        let code = Code::new()?;
        let mut known: HashMap<u64, Vec<Instruction>> = HashMap::new();
        let mut functions = Trace::new();
        for pc in self.addresses {
            let index = self.lies_in.get(&pc).copied().flatten();
            let function = &self.image.functions[index.with_context(|| format!("no function at {pc:#x}"))?];
            let instructions = match known.entry(function.address) {
                Entry::Occupied(found) => found.into_mut(),
                Entry::Vacant(new) => new.insert(code.of(&self.image, function)?),
            };
            let done = instructions.binary_search_by_key(&u64::from(pc), |instruction| instruction.address);
            let done =
                done.ok().with_context(|| format!("no instruction at {pc:#x} in {}", function.name))?;
            functions.entry(function.name.clone()).or_default().push(instructions[done].clone());
        }
        Ok(functions)
    }
}
