//! The innermost loops that multiply and accumulate, found in the code of a linked program.

use crate::elf::Instruction;

/// A loop without another inside.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Loop {
    /// Of its first instruction.
    pub address: u64,
    /// From the branch target to the branch back.
    pub body: Vec<Instruction>,
    /// Multiply-accumulates of one turn that it does.
    pub products: u32,
}

/// A loop in which fewer instructions accumulate requantizes or divides: no inner loop of a sum of products.
const INSTRUCTIONS_PER_MAC_MAX: usize = 10;

/// All innermost loops of a function that are there to multiply and accumulate.
///
/// A loop is what lies between a branch back and its target: how LLVM lays loops out.
pub fn innermost(instructions: &[Instruction]) -> Vec<Loop> {
    let spans: Vec<(u64, u64)> = instructions
        .iter()
        .filter_map(|branch| Some((branch.direct_target()?, branch.address)))
        .filter(|(target, branch)| target <= branch)
        .collect();
    let holds_another = |&(from, to): &(u64, u64)| {
        spans.iter().any(|&(other_from, other_to)| {
            (other_from, other_to) != (from, to) && from <= other_from && other_to <= to
        })
    };
    let mut loops: Vec<Loop> = spans
        .iter()
        .filter(|span| !holds_another(span))
        .filter_map(|&(from, to)| {
            let inside = |instruction: &&Instruction| (from..=to).contains(&instruction.address);
            let body: Vec<_> = instructions.iter().filter(inside).cloned().collect();
            let products = body.iter().map(products).sum();
            let starts_here = body.first().is_some_and(|first| first.address == from);
            let is_sum = products > 0 && body.len() <= INSTRUCTIONS_PER_MAC_MAX * products as usize;
            (starts_here && is_sum).then_some(Loop { address: from, body, products })
        })
        .collect();
    loops.sort_by_key(|found| found.address);
    loops
}

/// Multiply-accumulates of one instruction on 32-bit sums, with `smuad` the first of a sum; plain products make
/// addresses and scales.
fn products(instruction: &Instruction) -> u32 {
    match instruction.plain() {
        "smuad" | "smlad" | "smladx" | "smlald" | "smlaldx" => 2,
        "mla" | "smlabb" | "smlabt" | "smlatb" | "smlatt" => 1,
        _ => 0,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn code(lines: &[&str]) -> Vec<Instruction> {
        (0..)
            .zip(lines)
            .map(|(index, line)| {
                let (mnemonic, operands) = line.split_once(' ').unwrap_or((line, ""));
                Instruction {
                    address: 0x100 + 4 * index,
                    bytes: 4,
                    mnemonic: mnemonic.to_owned(),
                    operands: operands.to_owned(),
                }
            })
            .collect()
    }

    #[test]
    fn the_inner_of_two_loops_is_found() {
        let code = code(&[
            "movs r0, #0",
            "mul r5, r6, r7",
            "ldr r1, [r2], #4",
            "smlad r0, r1, r3, r0",
            "smlabb r0, r1, r3, r0",
            "subs r4, #1",
            "bne.w #0x108",
            "bhi #0x104",
        ]);
        let loops = innermost(&code);
        assert_eq!(loops.len(), 1);
        assert_eq!((loops[0].address, loops[0].body.len(), loops[0].products), (0x108, 5, 3));
    }

    #[test]
    fn loops_that_do_not_accumulate_are_left_out() {
        assert!(innermost(&code(&["mul r0, r1, r2", "bne #0x100"])).is_empty());
        assert!(innermost(&code(&["subs r4, #1", "bne #0x100"])).is_empty());
        assert!(
            innermost(&code(&["mla r0, r1, r2, r0", "beq #0x200"])).is_empty(),
            "a branch forward is no loop"
        );
    }
}
