//! Four outputs of a dense layer after the other: four sums, four inputs, four weights and two pointers in registers,
//! 21 instructions for 32 products, unrolled without a counter.

use core::arch::global_asm;

use crate::simd::{LANES, portable};

/// Words of `x` that one round takes.
const CHUNK: usize = 4;
/// Rounds there is code for: 512 inputs.
const CHUNKS_MAX: usize = 64;

/// What the assembly reads beside input and weights; it moves the pointers on.
#[repr(C)]
struct Blocks {
    bias: *const i32,
    multiplier: *const i32,
    out: *mut i32,
    /// Blocks of four outputs left.
    count: usize,
}

// Code of one round: 21 instructions of four bytes, which is what makes the jump into the middle exact.
// On the stack: [0] x, [4] the Blocks, [8] where to jump.
global_asm!(
    "
    .section .text.hot.slipsense_dense,\"ax\",%progbits
    .syntax unified
    .thumb
    .p2align 2
    .type slipsense_dense, %function
    .thumb_func
slipsense_dense:
    @ r0: x, r1: weights, r2: rounds, r3: the Blocks
    push.w {{r4-r11, lr}}
    sub sp, sp, #12
    ldr.w r12, 2f
    movw lr, #84
    mls r12, r2, lr, r12
    strd r0, r3, [sp]
    str.w r12, [sp, #8]
    ldr.w r8, [r3]
3:  @ a block; r3: the Blocks, r8: its biases
    ldm.w r8!, {{r4-r7}}
    str.w r8, [r3]
    bx r12
    .p2align 2
2:  .word 1f + 1
    .rept {chunks}
    ldm.w r0!, {{r8-r11}}
    ldm.w r1!, {{r2, r3, r12, lr}}
    smlad r4, r8, r2, r4
    smlad r5, r8, r3, r5
    smlad r6, r8, r12, r6
    smlad r7, r8, lr, r7
    ldm.w r1!, {{r2, r3, r12, lr}}
    smlad r4, r9, r2, r4
    smlad r5, r9, r3, r5
    smlad r6, r9, r12, r6
    smlad r7, r9, lr, r7
    ldm.w r1!, {{r2, r3, r12, lr}}
    smlad r4, r10, r2, r4
    smlad r5, r10, r3, r5
    smlad r6, r10, r12, r6
    smlad r7, r10, lr, r7
    ldm.w r1!, {{r2, r3, r12, lr}}
    smlad r4, r11, r2, r4
    smlad r5, r11, r3, r5
    smlad r6, r11, r12, r6
    smlad r7, r11, lr, r7
    .endr
1:  ldrd r0, r3, [sp]
    ldr.w r12, [sp, #8]
    ldrd r8, r9, [r3, #4]
    ldm.w r8!, {{r2, r10, r11, lr}}
    smmulr r4, r4, r2
    smmulr r5, r5, r10
    smmulr r6, r6, r11
    smmulr r7, r7, lr
    stm.w r9!, {{r4-r7}}
    ldr r2, [r3, #12]
    strd r8, r9, [r3, #4]
    ldr.w r8, [r3]
    subs r2, r2, #1
    str r2, [r3, #12]
    bne.w 3b
    add sp, sp, #12
    pop.w {{r4-r11, pc}}
    .size slipsense_dense, . - slipsense_dense
    .text
    ",
    chunks = const CHUNKS_MAX,
);

unsafe extern "C" {
    fn slipsense_dense(x: *const u32, w: *const u32, chunks: usize, blocks: *mut Blocks);
}

/// See [`portable::dense`].
///
/// What is not a whole round, or longer than the longest, goes through the portable form; no layer is.
#[inline]
pub fn dense(x: &[u32], (weights, bias, multiplier): (&[u32], &[i32], &[i32]), out: &mut [i32]) {
    let chunks = x.len() / CHUNK;
    if x.is_empty() || !x.len().is_multiple_of(CHUNK) || chunks > CHUNKS_MAX {
        return portable::dense(x, (weights, bias, multiplier), out);
    }
    let lengths = [weights.len() / x.len(), bias.len(), multiplier.len(), out.len()];
    let count = lengths.into_iter().fold(usize::MAX, usize::min) / LANES;
    if count == 0 {
        return;
    }
    let mut blocks =
        Blocks { bias: bias.as_ptr(), multiplier: multiplier.as_ptr(), out: out.as_mut_ptr(), count };
    // SAFETY: reads x once per block, and for `count` blocks four words of weights per word of x, four biases and
    // four multipliers; writes as many results: all of them are there, by `count`. References to words are
    // aligned for multiple loads.
    unsafe { slipsense_dense(x.as_ptr(), weights.as_ptr(), chunks, &mut blocks) };
}
