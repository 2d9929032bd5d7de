//! A convolution with its pool: eight sums (a 2×2 window of two filters), two numbers of the file, two of the strip
//! and two pointers in registers. LLVM's model of the core does a single load beside a product, so 88 instructions
//! take 48 cycles for what would be 144 products of 16 bits one by one.

use core::arch::global_asm;

use crate::simd::layout::{LANES, LayerParams, Map, MapMut, MapShape};
use crate::simd::portable;

// One pair of functions per shape: distances are immediates. A strip is 4 × `pairs` planes, two by turns added to
// the one row of sums and the other. For each plane three columns of coefficients, of each column four words, the
// first two of which are read.
// On the stack: [0] output, [4] its row's end, [8] bias and multiplier of the one filter, then of the other.
global_asm!(
    "
    .syntax unified
    .thumb
    .macro slipsense_product to, x, w
    smuad \\to, \\x, \\w
    .endm
    .macro slipsense_add_product to, x, w
    smlad \\to, \\x, \\w, \\to
    .endm
    .macro slipsense_max to, other
    cmp \\to, \\other
    it lt
    movlt \\to, \\other
    .endm
    @ A plane; what it begins with is loaded, and it loads what the next begins with. The last one has room for the
    @ pool of the upper row, whose sums are whole.
    .macro slipsense_plane product, a0, a1, b0, b1, plane, last=0
    \\product \\a0, r12, r2
    ldr.w lr, [r0, #(.Lslipsense_x + 4)]
    \\product \\b0, r12, r3
    ldr.w r12, [r0, #(.Lslipsense_x + 8)]
    \\product \\a1, lr, r2
    ldr.w r2, [r1, #(.Lslipsense_w + 16)]
    \\product \\b1, lr, r3
    ldr.w r3, [r1, #(.Lslipsense_w + 20)]
    smlad \\a0, lr, r2, \\a0
    smlad \\b0, lr, r3, \\b0
    ldr.w lr, [r0, #(.Lslipsense_x + 12)]
    smlad \\a1, r12, r2, \\a1
    ldr.w r2, [r1, #(.Lslipsense_w + 32)]
    smlad \\b1, r12, r3, \\b1
    ldr.w r3, [r1, #(.Lslipsense_w + 36)]
    smlad \\a0, r12, r2, \\a0
    .if \\last
    cmp r4, r5
    smlad \\b0, r12, r3, \\b0
    it lt
    movlt r4, r5
    smlad \\a1, lr, r2, \\a1
    cmp r6, r7
    smlad \\b1, lr, r3, \\b1
    it lt
    movlt r6, r7
    .else
    smlad \\b0, r12, r3, \\b0
    .set .Lslipsense_x, .Lslipsense_x + 4 * \\plane
    .set .Lslipsense_w, .Lslipsense_w + 48
    ldr.w r12, [r0, #.Lslipsense_x]
    smlad \\a1, lr, r2, \\a1
    ldr.w r2, [r1, #.Lslipsense_w]
    smlad \\b1, lr, r3, \\b1
    ldr.w r3, [r1, #(.Lslipsense_w + 4)]
    .endif
    .endm
    .macro slipsense_conv side, pairs, bits
    .section .text.hot.slipsense_conv_\\side\\()_\\pairs,\"ax\",%progbits
    .p2align 2
    .global slipsense_conv_\\side\\()_\\pairs
    .type slipsense_conv_\\side\\()_\\pairs, %function
    .thumb_func
slipsense_conv_\\side\\()_\\pairs:
    @ r0: strip, r1: coefficients, r2: output, r3: its row's end, on the stack: where the scales are
    push.w {{r4-r11, lr}}
    ldr r4, [sp, #36]
    sub sp, sp, #24
    ldrd r5, r6, [r4]
    ldrd r7, r8, [r4, #8]
    strd r2, r3, [sp]
    strd r5, r6, [sp, #8]
    strd r7, r8, [sp, #16]
2:  @ a window of two filters
    ldr.w r12, [r0]
    ldr.w r2, [r1]
    ldr.w r3, [r1, #4]
    .set .Lslipsense_x, 0
    .set .Lslipsense_w, 0
    slipsense_plane slipsense_product, r4, r5, r6, r7, (\\side + 2)
    slipsense_plane slipsense_product, r8, r9, r10, r11, (\\side + 2)
    .rept \\pairs - 1
    slipsense_plane slipsense_add_product, r4, r5, r6, r7, (\\side + 2)
    slipsense_plane slipsense_add_product, r8, r9, r10, r11, (\\side + 2)
    .endr
    @ sum and difference: what upper and lower outputs begin with
    add r4, r4, r8
    sub r8, r4, r8, lsl #1
    add r5, r5, r9
    sub r9, r5, r9, lsl #1
    add r6, r6, r10
    sub r10, r6, r10, lsl #1
    add r7, r7, r11
    sub r11, r7, r11, lsl #1
    .rept \\pairs - 1
    slipsense_plane slipsense_add_product, r4, r5, r6, r7, (\\side + 2)
    slipsense_plane slipsense_add_product, r8, r9, r10, r11, (\\side + 2)
    .endr
    slipsense_plane slipsense_add_product, r4, r5, r6, r7, (\\side + 2)
    slipsense_plane slipsense_add_product, r8, r9, r10, r11, (\\side + 2), 1
    slipsense_max r8, r9
    slipsense_max r10, r11
    slipsense_max r4, r8
    slipsense_max r6, r10
    ldrd r5, r7, [sp, #8]
    ldrd r8, r9, [sp, #16]
    ldrd r2, r3, [sp]
    add r4, r4, r5
    add r6, r6, r8
    smmulr r4, r4, r7
    smmulr r6, r6, r9
    usat r4, #\\bits, r4
    usat r6, #\\bits, r6
    add r0, r0, #8
    pkhbt r4, r4, r6, lsl #16
    str r4, [r2], #4
    cmp r2, r3
    str r2, [sp]
    bne.w 2b
    add sp, sp, #24
    pop.w {{r4-r11, pc}}
    .size slipsense_conv_\\side\\()_\\pairs, . - slipsense_conv_\\side\\()_\\pairs

    .section .text.hot.slipsense_strip_\\side\\()_\\pairs,\"ax\",%progbits
    .p2align 2
    .global slipsense_strip_\\side\\()_\\pairs
    .type slipsense_strip_\\side\\()_\\pairs, %function
    .thumb_func
slipsense_strip_\\side\\()_\\pairs:
    @ r0: four rows of the map, r1: strip
    push.w {{r4-r11, lr}}
    mov r12, #\\pairs
2:  mov lr, #((\\side + 2) / 2)
3:  @ two columns of a pair of channels
    ldrd r4, r5, [r0, #(4 * (\\side + 2) * \\pairs)]
    ldrd r6, r7, [r0, #(8 * (\\side + 2) * \\pairs)]
    ldrd r8, r9, [r0, #(12 * (\\side + 2) * \\pairs)]
    ldrd r2, r3, [r0], #8
    ssub16 r10, r6, r4
    ssub16 r11, r7, r5
    ssub16 r2, r2, r6
    ssub16 r3, r3, r7
    ssub16 r8, r8, r4
    ssub16 r9, r9, r5
    sadd16 r4, r4, r6
    sadd16 r5, r5, r7
    strd r10, r11, [r1, #(4 * (\\side + 2))]
    strd r2, r3, [r1, #(8 * (\\side + 2) * \\pairs)]
    strd r8, r9, [r1, #(8 * (\\side + 2) * \\pairs + 4 * (\\side + 2))]
    strd r4, r5, [r1], #8
    subs lr, lr, #1
    bne 3b
    add r1, r1, #(4 * (\\side + 2))
    subs r12, r12, #1
    bne 2b
    pop.w {{r4-r11, pc}}
    .size slipsense_strip_\\side\\()_\\pairs, . - slipsense_strip_\\side\\()_\\pairs
    .endm
    slipsense_conv 32, 1, 14
    slipsense_conv 16, 2, 14
    slipsense_conv 16, 4, 14
    slipsense_conv 8, 2, 15
    slipsense_conv 8, 4, 15
    slipsense_conv 8, 6, 15
    slipsense_conv 8, 8, 15
    .text
    "
);

/// Direct calls, so that the stack's bound can be computed from the program.
macro_rules! shapes {
    ($(($side:literal, $pairs:literal, $border:literal): $combine:ident, $convolve:ident;)*) => {
        unsafe extern "C" {
            $(
                fn $combine(x: *const u32, strip: *mut u32);
                fn $convolve(
                    strip: *const u32,
                    weights: *const u32,
                    out: *mut u32,
                    end: *const u32,
                    scales: *const [i32; 4],
                );
            )*
        }

        /// Is there assembly from maps of the one shape to maps of the other? It cuts to what the other's border asks
        /// for.
        const fn is_known(from: MapShape, to: MapShape) -> bool {
            matches!((from.side, from.pairs, to.border), $(($side, $pairs, $border))|*)
        }

        /// See [`portable::combine_rows`]; nothing for an unknown shape.
        ///
        /// # Safety
        /// Four rows can be read at `x`, and as many words written at `strip`.
        unsafe fn combine_rows(from: MapShape, x: *const u32, strip: *mut u32) {
            match (from.side, from.pairs) {
                // SAFETY: the caller's.
                $(($side, $pairs) => unsafe { $combine(x, strip) },)*
                _ => {}
            }
        }

        /// One row of the output of two filters, nothing for an unknown shape. `scales`: bias and multiplier of the
        /// one, then of the other.
        ///
        /// # Safety
        /// A strip can be read at `strip`, the first two of every four words of a block at `weights`, and a word for
        /// every second column be written to `out`.
        unsafe fn convolve(
            from: MapShape,
            strip: *const u32,
            weights: *const u32,
            out: core::ops::Range<*mut u32>,
            scales: &[i32; 4],
        ) {
            match (from.side, from.pairs) {
                // SAFETY: the caller's.
                $(($side, $pairs) => unsafe { $convolve(strip, weights, out.start, out.end, scales) },)*
                _ => {}
            }
        }
    };
}

shapes! {
    (32, 1, 1): slipsense_strip_32_1, slipsense_conv_32_1;
    (16, 2, 1): slipsense_strip_16_2, slipsense_conv_16_2;
    (16, 4, 1): slipsense_strip_16_4, slipsense_conv_16_4;
    (8, 2, 0): slipsense_strip_8_2, slipsense_conv_8_2;
    (8, 4, 0): slipsense_strip_8_4, slipsense_conv_8_4;
    (8, 6, 0): slipsense_strip_8_6, slipsense_conv_8_6;
    (8, 8, 0): slipsense_strip_8_8, slipsense_conv_8_8;
}

/// 3×3 convolution, ReLU and pool, see [`portable::conv_relu_pool`].
///
/// A shape that there is no assembly for, or slices too short for their shape, go through the portable form.
pub fn conv_relu_pool(layer: LayerParams<'_>, x: Map<'_>, out: MapMut<'_>, strip: &mut [u32]) {
    let (from, to) = (x.shape, out.shape);
    let LayerParams { weights, bias, multiplier } = layer;
    let block = 4 * from.pairs * 3 * LANES;
    let fits = from.border == 1
        && x.words.len() >= from.len()
        && out.words.len() >= to.len()
        && strip.len() >= from.strip()
        && 2 * to.side == from.side
        && to.pairs % 2 == 0
        && weights.len() >= to.pairs / 2 * block
        && bias.len() >= 2 * to.pairs
        && multiplier.len() >= 2 * to.pairs;
    if !fits || !is_known(from, to) {
        return portable::conv_relu_pool(layer, x, out, strip);
    }
    for row in 0..to.side {
        let Some(rows) = x.words.get(2 * row * from.row()..) else { return };
        // SAFETY: output row `row` is made of rows 2 `row` to 2 `row` + 3 of the map, border counted; they lie within
        // `from.len()`, and four rows fit the strip, as checked above.
        unsafe { combine_rows(from, rows.as_ptr(), strip.as_mut_ptr()) };
        let scales = bias.as_chunks::<2>().0.iter().zip(multiplier.as_chunks::<2>().0);
        for (pair, (bias, multiplier)) in scales.take(to.pairs).enumerate() {
            let plane = to.at(row, pair, 0);
            let (Some(filters), Some(plane)) =
                (weights.get(pair / 2 * block + pair % 2 * 2..), out.words.get_mut(plane..plane + to.side))
            else {
                return;
            };
            let scales = [bias[0], multiplier[0], bias[1], multiplier[1]];
            // SAFETY: the strip is that of this shape, and of the weights a block from `filters` on is there, less
            // the other pair's words at its end, as checked above.
            unsafe { convolve(from, strip.as_ptr(), filters.as_ptr(), plane.as_mut_ptr_range(), &scales) };
        }
    }
}
