//! A convolution with its pool: eight sums (a 2×2 window of two filters), two words of weights, two of the map and
//! two pointers in registers, eleven instructions for sixteen products.

use core::arch::global_asm;

use crate::simd::{LANES, MapShape, portable};

/// What a convolution needs beside its maps and weights, as the assembly reads it.
#[repr(C)]
struct Pair {
    /// Bias and multiplier of the one filter, then of the other.
    scales: [i32; 4],
    /// Bytes from the end of an output row's plane to the start of the next row's.
    next_row: usize,
}

// One function per shape: distances are immediates. A tile is 3 rows × `pairs` planes × 3 columns of weights.
// On the stack: [0] output, [4] its row's end, [8] rows left, [12] the `Pair`.
global_asm!(
    "
    .syntax unified
    .thumb
    .macro slipsense_taps column, row, step=16
    ldrd r2, r3, [r1], #\\step
    ldrd r12, lr, [r0, #(4 * \\column)]
    smlad r4, r12, r2, r4
    smlad r5, lr, r2, r5
    smlad r8, r12, r3, r8
    smlad r9, lr, r3, r9
    ldrd r12, lr, [r0, #(\\row + 4 * \\column)]
    smlad r6, r12, r2, r6
    smlad r7, lr, r2, r7
    smlad r10, r12, r3, r10
    smlad r11, lr, r3, r11
    .endm
    .macro slipsense_first_tap side, pairs
    ldrd r2, r3, [r1], #16
    ldrd r12, lr, [r0, #(4 * (\\side + 2))]!
    smlad r4, r12, r2, r4
    smlad r5, lr, r2, r5
    smlad r8, r12, r3, r8
    smlad r9, lr, r3, r9
    ldrd r12, lr, [r0, #(4 * (\\side + 2) * \\pairs)]
    smlad r6, r12, r2, r6
    smlad r7, lr, r2, r7
    smlad r10, r12, r3, r10
    smlad r11, lr, r3, r11
    .endm
    .macro slipsense_max to, other
    cmp \\to, \\other
    it lt
    movlt \\to, \\other
    .endm
    .macro slipsense_conv side, pairs
    .section .text.hot.slipsense_conv_\\side\\()_\\pairs,\"ax\",%progbits
    .p2align 2
    .global slipsense_conv_\\side\\()_\\pairs
    .type slipsense_conv_\\side\\()_\\pairs, %function
    .thumb_func
slipsense_conv_\\side\\()_\\pairs:
    @ r0: map, r1: weights, r2: output, r3: the Pair
    push.w {{r4-r11, lr}}
    sub sp, sp, #20
    add r4, r2, #(2 * \\side)
    mov r5, #(\\side / 2)
    strd r2, r4, [sp]
    strd r5, r3, [sp, #8]
    sub r0, r0, #(4 * (\\side + 2))
2:  @ a tile; its first two sums need no zero to start from
    ldrd r2, r3, [r1], #16
    ldrd r12, lr, [r0, #(4 * (\\side + 2))]!
    smuad r4, r12, r2
    smuad r5, lr, r2
    smuad r8, r12, r3
    smuad r9, lr, r3
    ldrd r12, lr, [r0, #(4 * (\\side + 2) * \\pairs)]
    smuad r6, r12, r2
    smuad r7, lr, r2
    smuad r10, r12, r3
    smuad r11, lr, r3
    slipsense_taps 1, (4 * (\\side + 2) * \\pairs)
    slipsense_taps 2, (4 * (\\side + 2) * \\pairs)
    .rept 3 * \\pairs - 2
    slipsense_first_tap \\side, \\pairs
    slipsense_taps 1, (4 * (\\side + 2) * \\pairs)
    slipsense_taps 2, (4 * (\\side + 2) * \\pairs)
    .endr
    @ the last load of weights leads back to the first, where the distance fits the instruction
    slipsense_first_tap \\side, \\pairs
    slipsense_taps 1, (4 * (\\side + 2) * \\pairs)
    .if 9 * \\pairs * 16 - 16 <= 1020
    slipsense_taps 2, (4 * (\\side + 2) * \\pairs), (16 - 9 * \\pairs * 16)
    .else
    slipsense_taps 2, (4 * (\\side + 2) * \\pairs)
    subw r1, r1, #(9 * \\pairs * 16)
    .endif
    slipsense_max r4, r5
    slipsense_max r6, r7
    slipsense_max r4, r6
    slipsense_max r8, r9
    slipsense_max r10, r11
    slipsense_max r8, r10
    ldr r2, [sp, #12]
    ldm.w r2, {{r5, r6, r7, r9}}
    add r4, r4, r5
    smmulr r4, r4, r6
    usat r4, #15, r4
    add r8, r8, r7
    smmulr r8, r8, r9
    usat r8, #15, r8
    pkhbt r4, r4, r8, lsl #16
    ldrd r2, r3, [sp]
    str r4, [r2], #4
    str r2, [sp]
    subw r0, r0, #(3 * \\pairs * 4 * (\\side + 2) - 8)
    cmp r2, r3
    bne.w 2b
    @ the next two rows of the map, the next one of the output
    addw r0, r0, #(8 * (\\side + 2) * \\pairs - 4 * \\side)
    ldrd r4, r5, [sp, #8]
    ldr r6, [r5, #16]
    add r2, r2, r6
    add r3, r2, #(2 * \\side)
    strd r2, r3, [sp]
    subs r4, r4, #1
    str r4, [sp, #8]
    bne.w 2b
    add sp, sp, #20
    pop.w {{r4-r11, pc}}
    .size slipsense_conv_\\side\\()_\\pairs, . - slipsense_conv_\\side\\()_\\pairs
    .endm
    slipsense_conv 32, 1
    slipsense_conv 16, 2
    slipsense_conv 16, 4
    slipsense_conv 8, 2
    slipsense_conv 8, 4
    slipsense_conv 8, 6
    slipsense_conv 8, 8
    .text
    "
);

unsafe extern "C" {
    fn slipsense_conv_32_1(x: *const u32, w: *const u32, out: *mut u32, pair: *const Pair);
    fn slipsense_conv_16_2(x: *const u32, w: *const u32, out: *mut u32, pair: *const Pair);
    fn slipsense_conv_16_4(x: *const u32, w: *const u32, out: *mut u32, pair: *const Pair);
    fn slipsense_conv_8_2(x: *const u32, w: *const u32, out: *mut u32, pair: *const Pair);
    fn slipsense_conv_8_4(x: *const u32, w: *const u32, out: *mut u32, pair: *const Pair);
    fn slipsense_conv_8_6(x: *const u32, w: *const u32, out: *mut u32, pair: *const Pair);
    fn slipsense_conv_8_8(x: *const u32, w: *const u32, out: *mut u32, pair: *const Pair);
}

/// 3×3 convolution, ReLU and pool, see [`portable::conv_relu_pool`].
///
/// A shape that there is no assembly for, or slices too short for their shape, go through the portable form.
pub fn conv_relu_pool(
    (weights, bias, multiplier): (&[u32], &[i32], &[i32]),
    (x, from): (&[u32], MapShape),
    (out, to): (&mut [u32], MapShape),
) {
    let block = 3 * from.pairs * 3 * LANES;
    let (pairs, blocks) = (to.pairs, to.pairs / 2);
    let fits = from.border == 1
        && x.len() >= from.len()
        && out.len() >= to.len()
        && 2 * to.side == from.side
        && to.pairs % 2 == 0
        && weights.len() >= blocks * block
        && bias.len() >= 2 * pairs
        && multiplier.len() >= 2 * pairs;
    let known = matches!((from.side, from.pairs), (32, 1) | (16, 2 | 4) | (8, 2 | 4 | 6 | 8));
    if !fits || !known {
        return portable::conv_relu_pool((weights, bias, multiplier), (x, from), (out, to));
    }
    let scales = bias.as_chunks::<2>().0.iter().zip(multiplier.as_chunks::<2>().0).take(pairs);
    for (pair, (bias, multiplier)) in scales.enumerate() {
        let parameters = Pair {
            scales: [bias[0], multiplier[0], bias[1], multiplier[1]],
            next_row: 4 * (to.row() - to.side),
        };
        let (Some(filters), Some(plane)) =
            (weights.get(pair / 2 * block + pair % 2 * 2..), out.get_mut(to.at(0, pair, 0)..))
        else {
            return;
        };
        let (x, w, out, pair) = (x.as_ptr(), filters.as_ptr(), plane.as_mut_ptr(), &raw const parameters);
        // SAFETY: reads the whole map, `from.len()` words; of the weights the first two of every four words from
        // `filters` on, `block` words less the other pair's; writes `to.side` words of plane `pair` of each of
        // `to.side` rows, which lie within `to.len()`. All checked above. Direct calls, so that the stack's bound
        // can be told from the program.
        unsafe {
            match (from.side, from.pairs) {
                (32, _) => slipsense_conv_32_1(x, w, out, pair),
                (16, 2) => slipsense_conv_16_2(x, w, out, pair),
                (16, _) => slipsense_conv_16_4(x, w, out, pair),
                (_, 2) => slipsense_conv_8_2(x, w, out, pair),
                (_, 4) => slipsense_conv_8_4(x, w, out, pair),
                (_, 6) => slipsense_conv_8_6(x, w, out, pair),
                _ => slipsense_conv_8_8(x, w, out, pair),
            }
        }
    }
}
