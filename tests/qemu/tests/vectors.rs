//! This computer's kernels, in vector registers where it has them, against the portable ones; the Cortex-M7's:
//! `cargo xtask test --only qemu-kernels`.

use slipsense_qemu::equality::{ROUNDS, Scratch, compare};

#[test]
fn kernels_of_this_computer_equal_the_portable_ones() {
    let (mut count, mut scratch) = (0, Scratch::ZEROED);
    compare(ROUNDS, &mut scratch, |compared| {
        println!("{compared:?}");
        assert_eq!(compared.differing, 0, "{}", compared.kernel);
        assert!(compared.calls >= ROUNDS);
        count += 1;
    });
    assert_eq!(count, 4);
    #[cfg(target_arch = "x86_64")]
    println!("with AVX2: {}", std::arch::is_x86_feature_detected!("avx2"));
}
