//! This computer's kernels, in vector registers where it has them, against the portable ones; the Cortex-M7's:
//! `cargo xtask test --only qemu-kernels`.

use slipsense_qemu::equal::{ROUNDS, Scratch, compare};

#[test]
fn kernels_of_this_computer_equal_the_portable_ones() {
    let mut kernels = 0;
    compare(ROUNDS, &mut Scratch::new(), |compared| {
        println!("{compared:?}");
        assert_eq!(compared.differing, 0, "{}", compared.kernel);
        assert!(compared.calls >= ROUNDS);
        kernels += 1;
    });
    assert_eq!(kernels, 4);
}
