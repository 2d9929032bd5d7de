//! Four outputs of a dense layer after the other: four sums, four inputs, four weights and two pointers in registers,
//! 45 instructions for 64 products.

use core::arch::global_asm;

use crate::simd::layout::{LANES, LayerParams};
use crate::simd::portable;

/// Words of `x` that one round takes.
const ROUND: usize = 8;

/// What the assembly reads beside input and weights; it moves the pointers on.
#[repr(C)]
struct Blocks {
    bias: *const i32,
    multiplier: *const i32,
    out: *mut i32,
    /// Blocks of four outputs left.
    count: usize,
}

// No register is left for a counter: a round ends by comparing the input's pointer with its end.
// On the stack: [0] x, [4] the Blocks, [8] the end of x.
global_asm!(
    "
    .section .text.hot.slipsense_dense,\"ax\",%progbits
    .syntax unified
    .thumb
    .p2align 2
    .type slipsense_dense, %function
    .thumb_func
slipsense_dense:
    @ r0: x, r1: weights, r2: end of x, r3: the Blocks
    push.w {{r4-r11, lr}}
    sub sp, sp, #12
    strd r0, r3, [sp]
    str r2, [sp, #8]
    ldr.w r8, [r3]
3:  @ a block; r3: the Blocks, r8: its biases
    ldm.w r8!, {{r4-r7}}
    str.w r8, [r3]
2:  .rept 2
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
    ldr r2, [sp, #8]
    cmp r0, r2
    bne.w 2b
    ldrd r0, r3, [sp]
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
    "
);

unsafe extern "C" {
    fn slipsense_dense(x: *const u32, w: *const u32, end: *const u32, blocks: *mut Blocks);
}

/// See [`portable::dense`].
///
/// What is not a whole number of rounds goes through the portable form; no layer is.
#[inline]
pub fn dense(x: &[u32], layer: LayerParams<'_>, out: &mut [i32]) {
    if x.is_empty() || !x.len().is_multiple_of(ROUND) {
        return portable::dense(x, layer, out);
    }
    let LayerParams { weights, bias, multiplier } = layer;
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
    unsafe { slipsense_dense(x.as_ptr(), weights.as_ptr(), x.as_ptr_range().end, &mut blocks) };
}
