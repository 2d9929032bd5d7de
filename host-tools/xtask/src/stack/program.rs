//! The call graph of an ELF file.

use std::collections::{BTreeMap, BTreeSet};

use anyhow::{Context, Result, ensure};

use super::graph::{Graph, Node};
use crate::elf::{Code, Image, Instruction, Section, number};
use crate::process::root;
use crate::twin::machine::MODEL;

/// Where a panic ends; what it prints is no part of the frame path.
pub const PANIC: &str = "rust_begin_unwind";

/// What the code says by itself; calls through registers lead nowhere yet.
pub struct Program {
    pub image: Image,
    pub graph: Graph,
    /// Functions whose address lies in memory: in tables of methods, of tasks, of interrupts.
    pub in_tables: BTreeSet<usize>,
    /// Functions without a frame size from the compiler, whose frame was read off their instructions.
    pub read_off: usize,
}

impl Program {
    pub fn new(image: Image) -> Result<Self> {
        let code = Code::new()?;
        let mut graph = Graph::default();
        let mut read_off = 0;
        for (index, function) in image.functions.iter().enumerate() {
            let instructions = code.disassemble(&image, function)?;
            let pushed = instructions.iter().map(Instruction::pushed_bytes).sum();
            read_off += usize::from(function.frame.is_none());
            let mut node = Node {
                name: function.name.clone(),
                frame_bytes: function.frame.unwrap_or(pushed),
                indirect_calls: instructions.iter().filter(|instruction| instruction.is_indirect()).count(),
                points_to: pointers(&instructions).filter_map(|p| image.function_of_pointer(p)).collect(),
                ..Node::default()
            };
            for target in instructions.iter().filter_map(Instruction::direct_target) {
                let called = image.function_at(target);
                let called =
                    called.with_context(|| format!("{}: no function at {target:#x}", function.name))?;
                if called != index || target == function.address {
                    node.calls.insert(called);
                }
            }
            graph.nodes.push(node);
        }
        let tables = image.sections.iter().filter(|section| !section.is_code && section.name != VECTOR_TABLE);
        // A weight may look like an address.
        let model = std::fs::read(root().join(MODEL)).context(MODEL)?;
        let words = tables.flat_map(|section| section.words_outside(&model));
        let in_tables = words.filter_map(|word| image.function_of_pointer(word)).collect();
        Ok(Self { image, graph, in_tables, read_off })
    }

    /// The one function whose name, or an alias of it, is `name` or ends in it after a path.
    pub fn function(&self, name: &str) -> Result<usize> {
        let is = |full: &str| {
            full == name || full.strip_suffix(name).is_some_and(|path| path.ends_with([':', '<']))
        };
        let functions = self.image.functions.iter();
        let mut found =
            functions.enumerate().filter(|(_, function)| function.names.iter().any(|name| is(name)));
        let (index, _) = found.next().with_context(|| format!("the program has no function `{name}`"))?;
        ensure!(found.next().is_none(), "the program has several functions `{name}`");
        Ok(index)
    }

    /// Handlers by number of the exception: 1 is reset, 16 the first interrupt.
    pub fn handlers(&self) -> BTreeMap<usize, usize> {
        let table = self.image.sections.iter().find(|section| section.name == VECTOR_TABLE);
        let words = table.into_iter().flat_map(Section::words).enumerate().skip(1);
        words.filter_map(|(number, word)| Some((number, self.image.function_of_pointer(word)?))).collect()
    }
}

/// Name of the section in which cortex-m-rt puts the handlers.
const VECTOR_TABLE: &str = ".vector_table";

/// 32-bit constants that the code makes with `movw` and `movt`.
fn pointers(instructions: &[Instruction]) -> impl Iterator<Item = u32> {
    let mut low = BTreeMap::new();
    let mut made = BTreeSet::new();
    for instruction in instructions {
        let Some((register, operand)) = instruction.operands.split_once(", #") else { continue };
        let Some(number) = number(operand).and_then(|number| u32::try_from(number).ok()) else { continue };
        match instruction.mnemonic.as_str() {
            "movw" | "mov.w" | "movs" => _ = low.insert(register, number),
            "movt" => made.extend(low.get(register).map(|low| number << 16 | low)),
            _ => {}
        }
    }
    made.into_iter()
}
