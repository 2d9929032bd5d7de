//! What attention multiplies: a query by keys, weights by values.

use core::arch::global_asm;

use crate::simd::portable;

/// Words of a query that are kept in registers at once.
const STEP: usize = 4;
/// Sums of [`weighted_sums`].
const SUMS: usize = 8;

global_asm!(
    "
    .syntax unified
    .thumb
    @ r0: four words of the query, r1: rows, r2: how many, r3: output, on the stack: bytes from row to row
    .macro slipsense_dot add
    ldm.w r1, {{r8-r11}}
    add r1, r1, r12
    .if \\add
    ldr lr, [r3]
    smlad lr, r4, r8, lr
    .else
    smuad lr, r4, r8
    .endif
    smlad lr, r5, r9, lr
    smlad lr, r6, r10, lr
    smlad lr, r7, r11, lr
    str lr, [r3], #4
    .endm
    .macro slipsense_dots name, add
    .section .text.hot.\\name,\"ax\",%progbits
    .p2align 2
    .type \\name, %function
    .thumb_func
\\name:
    push.w {{r4-r11, lr}}
    ldr r12, [sp, #36]
    ldm.w r0, {{r4-r7}}
    @ an odd row, then two by two
    lsrs r2, r2, #1
    bcc 2f
    slipsense_dot \\add
    cbz r2, 3f
2:  slipsense_dot \\add
    slipsense_dot \\add
    subs r2, r2, #1
    bne 2b
3:  pop.w {{r4-r11, pc}}
    .size \\name, . - \\name
    .endm
    slipsense_dots slipsense_dots_set, 0
    slipsense_dots slipsense_dots_add, 1

    @ r0: weights, r1: rows, r2: how many, r3: output
    .macro slipsense_weighted stride
    ldr r3, [r0], #4
    ldrd r12, lr, [r1, #8]
    smlabb r8, r12, r3, r8
    smlatb r9, r12, r3, r9
    smlabb r10, lr, r3, r10
    smlatb r11, lr, r3, r11
    ldrd r12, lr, [r1], #\\stride
    smlabb r4, r12, r3, r4
    smlatb r5, r12, r3, r5
    smlabb r6, lr, r3, r6
    smlatb r7, lr, r3, r7
    .endm
    .macro slipsense_weighted_sums name, stride
    .section .text.hot.\\name,\"ax\",%progbits
    .p2align 2
    .type \\name, %function
    .thumb_func
\\name:
    push.w {{r3-r11, lr}}
    movs r4, #0
    movs r5, #0
    movs r6, #0
    movs r7, #0
    mov r8, r4
    mov r9, r4
    mov r10, r4
    mov r11, r4
    @ an odd row, then two by two
    lsrs r2, r2, #1
    bcc 2f
    slipsense_weighted \\stride
    cbz r2, 3f
2:  slipsense_weighted \\stride
    slipsense_weighted \\stride
    subs r2, r2, #1
    bne 2b
3:  ldr r3, [sp]
    stm.w r3, {{r4-r11}}
    pop.w {{r3-r11, pc}}
    .size \\name, . - \\name
    .endm
    slipsense_weighted_sums slipsense_weighted_sums_128, 128
    slipsense_weighted_sums slipsense_weighted_sums_256, 256
    .text
    "
);

unsafe extern "C" {
    fn slipsense_dots_set(query: *const u32, rows: *const u32, count: usize, out: *mut i32, stride: usize);
    fn slipsense_dots_add(query: *const u32, rows: *const u32, count: usize, out: *mut i32, stride: usize);
    fn slipsense_weighted_sums_128(weights: *const i32, rows: *const u32, count: usize, out: *mut i32);
    fn slipsense_weighted_sums_256(weights: *const i32, rows: *const u32, count: usize, out: *mut i32);
}

/// Words that `count` rows of `width` words at a distance of `stride` take.
fn span(count: usize, width: usize, stride: usize) -> usize {
    (count - 1) * stride + width
}

/// See [`portable::dots`]. A query of another length than a multiple of four words goes through that.
#[inline]
pub fn dots(query: &[u32], rows: &[u32], stride: usize, out: &mut [i32]) {
    let fits = out.is_empty() || rows.len() < span(out.len(), query.len(), stride);
    if query.is_empty() || !query.len().is_multiple_of(STEP) || fits {
        return portable::dots(query, rows, stride, out);
    }
    for (step, words) in query.chunks_exact(STEP).enumerate() {
        let Some(rows) = rows.get(step * STEP..) else { return };
        let (q, rows, count, out) = (words.as_ptr(), rows.as_ptr(), out.len(), out.as_mut_ptr());
        // SAFETY: reads four words of the query and of each of `out.len()` rows, which are there, checked above;
        // reads and writes `out`.
        unsafe {
            match step {
                0 => slipsense_dots_set(q, rows, count, out, 4 * stride),
                _ => slipsense_dots_add(q, rows, count, out, 4 * stride),
            }
        }
    }
}

/// See [`portable::weighted_sums`]. Other distances than the two that a model can have go through that.
#[inline]
pub fn weighted_sums(weights: &[i32], rows: &[u32], stride: usize) -> [i32; SUMS] {
    let short = weights.is_empty() || rows.len() < span(weights.len(), SUMS / 2, stride);
    if short || !matches!(stride, 32 | 64) {
        return portable::weighted_sums(weights, rows, stride);
    }
    let mut sums = [0; SUMS];
    let (w, rows, count, out) = (weights.as_ptr(), rows.as_ptr(), weights.len(), sums.as_mut_ptr());
    // SAFETY: reads the weights and four words of as many rows, which are there, checked above; writes `sums`.
    unsafe {
        match stride {
            32 => slipsense_weighted_sums_128(w, rows, count, out),
            _ => slipsense_weighted_sums_256(w, rows, count, out),
        }
    }
    sums
}
