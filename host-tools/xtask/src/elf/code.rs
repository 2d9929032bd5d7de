//! Thumb-2 instructions, as far as calls and stack frames need them.

use anyhow::{Result, anyhow, ensure};
use capstone::arch::BuildsCapstone;
use capstone::arch::BuildsCapstoneExtraMode;
use capstone::arch::arm::{ArchExtraMode, ArchMode};
use capstone::prelude::Capstone;

use super::image::{Function, Image};

/// One instruction, as the disassembler writes it.
#[derive(Clone, Debug, Default)]
pub struct Instruction {
    pub address: u64,
    pub bytes: u64,
    pub mnemonic: String,
    pub operands: String,
}

pub struct Code(Capstone);

impl Code {
    pub fn new() -> Result<Self> {
        let builder = Capstone::new().arm().mode(ArchMode::Thumb);
        let capstone = builder.extra_mode([ArchExtraMode::MClass].into_iter()).build();
        capstone.map(Self).map_err(|error| anyhow!("the disassembler does not start: {error}"))
    }

    pub fn disassemble(&self, image: &Image, function: &Function) -> Result<Vec<Instruction>> {
        let mut all = Vec::new();
        for (address, bytes) in image.code(function) {
            let found =
                self.0.disasm_all(bytes, address).map_err(|error| anyhow!("{}: {error}", function.name))?;
            let before = all.len();
            all.extend(found.iter().map(|instruction| Instruction {
                address: instruction.address(),
                bytes: instruction.len() as u64,
                mnemonic: instruction.mnemonic().unwrap_or_default().to_owned(),
                operands: instruction.op_str().unwrap_or_default().to_owned(),
            }));
            let read: u64 = all[before..].iter().map(|instruction| instruction.bytes).sum();
            ensure!(read == bytes.len() as u64, "{}: no instruction at {:#x}", function.name, address + read);
        }
        Ok(all)
    }
}

impl Instruction {
    /// Mnemonic without width and condition suffixes that do not matter here: `b.w` is `b`.
    pub fn plain(&self) -> &str {
        self.mnemonic.split('.').next().unwrap_or_default()
    }

    /// How many of the next instructions an `it`, `ite`, … makes conditional; 0 for all others.
    pub fn governs(&self) -> usize {
        let letters = self.mnemonic.strip_prefix('i').unwrap_or_default();
        let is_it = letters.starts_with('t') && letters.chars().all(|letter| matches!(letter, 't' | 'e'));
        if is_it { letters.len() } else { 0 }
    }

    /// The address that a direct branch or call names.
    fn target(&self) -> Option<u64> {
        let (_, number) = self.operands.rsplit_once('#').unwrap_or(("", &self.operands));
        u64::from_str_radix(number.strip_prefix("0x")?, 16).ok()
    }

    /// A call, wherever it leads.
    pub fn calls(&self) -> bool {
        matches!(self.plain(), "bl" | "blx")
    }

    /// A call or branch to a fixed address, conditional ones included.
    pub fn direct_target(&self) -> Option<u64> {
        let branches = matches!(self.plain(), "bl" | "blx" | "b" | "cbz" | "cbnz")
            || (self.plain().len() == 3 && self.plain().starts_with('b') && is_condition(&self.plain()[1..]));
        branches.then(|| self.target()).flatten()
    }

    /// A call, or a jump that may leave the function, to an address in a register: not a return, and not
    /// `tbb`, `tbh` or a write to `pc`, with which the compiler jumps within a function only.
    pub fn is_indirect(&self) -> bool {
        match self.plain() {
            "blx" => self.target().is_none(),
            "bx" => self.operands != "lr",
            _ => false,
        }
    }

    /// Bytes by which the instruction lowers the stack pointer, as prologues do.
    pub fn pushed_bytes(&self) -> u64 {
        let lowered = || {
            let (_, operand) = self.operands.rsplit_once('#').unwrap_or_default();
            number(operand.trim_start_matches('-').trim_end_matches(['!', ']'])).unwrap_or(0)
        };
        match self.plain() {
            "push" => 4 * registers(&self.operands),
            "vpush" => (if self.operands.contains('d') { 8 } else { 4 }) * registers(&self.operands),
            "stmdb" if self.operands.starts_with("sp!") => 4 * registers(&self.operands),
            "sub" | "subw" if self.operands.starts_with("sp, ") => lowered(),
            "str" | "strd" if self.operands.contains("[sp, #-") && self.operands.ends_with('!') => lowered(),
            _ => 0,
        }
    }
}

/// Without its sign: `0x18` or `24`.
pub fn number(text: &str) -> Option<u64> {
    text.strip_prefix("0x").map_or_else(|| text.parse().ok(), |hex| u64::from_str_radix(hex, 16).ok())
}

fn is_condition(suffix: &str) -> bool {
    matches!(
        suffix,
        "eq" | "ne" | "hs" | "lo" | "mi" | "pl" | "vs" | "vc" | "hi" | "ls" | "ge" | "lt" | "gt" | "le"
    )
}

/// Registers in a list such as `{r4, r5, lr}` or `{d8-d11}`.
fn registers(operands: &str) -> u64 {
    let list = operands.split_once('{').map_or(operands, |(_, list)| list);
    list.trim_end_matches('}')
        .split(',')
        .map(|item| match item.trim().split_once('-') {
            Some((first, last)) => {
                let number =
                    |name: &str| name.trim_start_matches(char::is_alphabetic).parse::<u64>().unwrap_or(0);
                number(last).saturating_sub(number(first)) + 1
            }
            None => 1,
        })
        .sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn instruction(mnemonic: &str, operands: &str) -> Instruction {
        Instruction { mnemonic: mnemonic.to_owned(), operands: operands.to_owned(), ..Default::default() }
    }

    #[test]
    fn calls_and_branches_name_their_target_or_are_indirect_but_for_returns() {
        for (mnemonic, operands, target, is_indirect) in [
            ("bl", "#0x8001234", Some(0x800_1234), false),
            ("b.w", "#0x80", Some(0x80), false),
            ("bne.w", "#0x80", Some(0x80), false),
            ("cbz", "r0, #0x90", Some(0x90), false),
            ("blx", "#0x8000", Some(0x8000), false),
            ("blx", "r3", None, true),
            ("bx", "r1", None, true),
            ("bx", "lr", None, false),
            ("bic", "r0, r0, #0x3", None, false),
            ("bfi", "r0, r1, #4, #8", None, false),
        ] {
            let code = instruction(mnemonic, operands);
            assert_eq!((code.direct_target(), code.is_indirect()), (target, is_indirect), "{code:?}");
        }
    }

    #[test]
    fn prologues_lower_the_stack_pointer() {
        for (mnemonic, operands, bytes) in [
            ("push", "{r4, r5, r7, lr}", 16),
            ("push.w", "{r8, sb, sl, fp}", 16),
            ("vpush", "{d8, d9}", 16),
            ("vpush", "{s16-s19}", 16),
            ("sub", "sp, #0x18", 24),
            ("subw", "sp, sp, #0x82c", 2092),
            ("sub.w", "sp, sp, #512", 512),
            ("str", "fp, [sp, #-4]!", 4),
            ("str", "r0, [sp, #4]", 0),
            ("sub", "r0, #8", 0),
        ] {
            assert_eq!(instruction(mnemonic, operands).pushed_bytes(), bytes, "{mnemonic} {operands}");
        }
    }
}
