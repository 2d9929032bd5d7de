//! Four outputs of a dense layer: four sums, four inputs, four weights and two pointers in registers, 21 instructions
//! for 32 products, unrolled without a counter.

use core::arch::global_asm;

use crate::simd::{LANES, portable};

/// Words of `x` that one round of the dense kernel takes.
const CHUNK: usize = 4;
/// Rounds there is code for: 512 inputs.
const CHUNKS_MAX: usize = 64;

// Code of one round: 21 instructions of four bytes, which is what makes the jump into the middle exact.
global_asm!(
    "
    .section .text.hot.slipsense_dense4,\"ax\",%progbits
    .syntax unified
    .thumb
    .p2align 2
    .type slipsense_dense4, %function
    .thumb_func
slipsense_dense4:
    @ r0: x, r1: weights, r2: rounds, r3: the four sums, in and out
    push.w {{r3-r11, lr}}
    ldr.w r12, 2f
    movw lr, #84
    mls r12, r2, lr, r12
    ldm.w r3, {{r4-r7}}
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
1:  ldr.w r3, [sp]
    stm.w r3, {{r4-r7}}
    pop.w {{r3-r11, pc}}
    .size slipsense_dense4, . - slipsense_dense4
    .text
    ",
    chunks = const CHUNKS_MAX,
);

unsafe extern "C" {
    fn slipsense_dense4(x: *const u32, w: *const u32, chunks: usize, sums: *mut i32);
}

/// `start + Σ x·w` for four outputs, see [`portable::dense4`].
///
/// What is not a whole round, or longer than the longest, goes through the portable form; no layer is.
#[inline]
pub fn dense4(start: [i32; LANES], x: &[u32], w: &[u32]) -> [i32; LANES] {
    let chunks = x.len() / CHUNK;
    if x.len() % CHUNK != 0 || chunks > CHUNKS_MAX || w.len() < LANES * x.len() {
        return portable::dense4(start, x, w);
    }
    let mut sums = start;
    // SAFETY: reads `chunks · 4` words of x and four times as many of w, which are there, and `sums`; writes
    // `sums`. References to `u32` are aligned for multiple loads.
    unsafe { slipsense_dense4(x.as_ptr(), w.as_ptr(), chunks, sums.as_mut_ptr()) };
    sums
}
