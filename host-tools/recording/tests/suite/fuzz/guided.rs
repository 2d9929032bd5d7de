//! libFuzzer chooses the bytes that a strategy takes for random ones, by the branches that those before have reached.

use std::cell::Cell;
use std::ffi::{CString, c_char, c_int};
use std::sync::atomic::{AtomicU64, Ordering};

use libfuzzer_sys as _;

use super::harness::LONGEST;

/// Inputs shown so far.
static SHOWN: AtomicU64 = AtomicU64::new(0);

type Target = dyn Fn(&[u8]);

thread_local! {
    static TARGET: Cell<Option<&'static Target>> = const { Cell::new(None) };
}

unsafe extern "C" {
    /// Does not return.
    fn LLVMFuzzerRunDriver(
        count: *mut c_int,
        arguments: *mut *mut *mut c_char,
        target: extern "C" fn(*const u8, usize) -> c_int,
    ) -> c_int;
}

/// What a program of libfuzzer-sys has; nothing calls it here.
#[unsafe(no_mangle)]
extern "C" fn rust_fuzzer_test_input() {}

extern "C" fn one(bytes: *const u8, length: usize) -> c_int {
    // SAFETY: libFuzzer's promise, but for a pointer where there are none.
    let bytes = if length == 0 { &[] } else { unsafe { std::slice::from_raw_parts(bytes, length) } };
    SHOWN.fetch_add(1, Ordering::Relaxed);
    // A panic here ends the process: libFuzzer says with which input.
    TARGET.get().expect("is set before the first")(bytes);
    0
}

/// Does not return where the environment has libFuzzer's arguments: `cargo xtask fuzz`.
pub fn run(target: &(dyn Fn(&[u8]) + '_)) {
    let Ok(arguments) = std::env::var("SLIPSENSE_LIBFUZZER") else { return };
    // SAFETY: libFuzzer ends the process, so that `target` lives as long as it.
    let target = unsafe { std::mem::transmute::<&(dyn Fn(&[u8]) + '_), &'static Target>(target) };
    TARGET.set(Some(target));
    // libFuzzer's own time limit works in the main thread only, which is not this one.
    std::thread::spawn(|| {
        loop {
            let before = SHOWN.load(Ordering::Relaxed);
            std::thread::sleep(2 * LONGEST);
            if SHOWN.load(Ordering::Relaxed) == before {
                eprintln!("an input takes more than {LONGEST:?}");
                std::process::abort();
            }
        }
    });
    let words = ["fuzz"].into_iter().chain(arguments.split_whitespace());
    let words: Vec<_> = words.map(|word| CString::new(word).expect("no zero bytes")).collect();
    let mut pointers: Vec<_> = words.iter().map(|word| word.as_ptr().cast_mut()).collect();
    let (mut count, mut first) = (pointers.len() as c_int, pointers.as_mut_ptr());
    // SAFETY: arguments as those of `main`.
    unsafe { LLVMFuzzerRunDriver(&mut count, &mut first, one) };
    unreachable!("libFuzzer ends the process");
}
