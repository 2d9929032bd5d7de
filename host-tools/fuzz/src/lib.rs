//! Deterministic fuzzing: a committed corpus, mutated from a fixed seed, so that a failure comes again.
//!
//! A panic of the target fails the test as any does, after the input has been written to a file. What also fails it:
//! an input that takes longer than [`LONGEST`], and memory that grows by more than [`GROWTH_BYTES`], whether an input
//! made the process ask for it at once or many left a little behind.
//!
//! Every test run takes a few thousand inputs; the long run is
//! `SLIPSENSE_FUZZ_INPUTS=10000000 cargo test --release -p slipsense-fuzz -- --nocapture`.

mod mutate;

use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

pub use mutate::mutate;

/// How many inputs, where it is not the short run.
pub const INPUTS_VARIABLE: &str = "SLIPSENSE_FUZZ_INPUTS";
/// Inputs of the short run.
pub const INPUTS: u64 = 20_000;
/// One input may take as long, on a computer that does other things too.
pub const LONGEST: Duration = Duration::from_secs(5);
/// What the process may ask for beyond what it had after the first inputs, bytes of address space.
pub const GROWTH_BYTES: u64 = 256 << 20;
/// Inputs before the memory is first looked at, and between looks.
const LOOK_EVERY: u64 = 1_000;

/// What a run came to.
#[derive(Clone, Copy, Debug)]
pub struct Ran {
    /// Inputs.
    pub inputs: u64,
    /// Of them accepted by the target.
    pub accepted: u64,
}

/// The files of a folder of the repository, in the order of their names.
///
/// # Panics
/// If there are none.
pub fn corpus(folder: &str) -> Vec<Vec<u8>> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..").join(folder);
    let files = std::fs::read_dir(&folder).unwrap_or_else(|error| panic!("{}: {error}", folder.display()));
    let mut paths: Vec<PathBuf> = files.map(|file| file.expect("a readable folder").path()).collect();
    paths.sort();
    assert!(!paths.is_empty(), "{}: the corpus is not there", folder.display());
    paths.iter().map(|path| std::fs::read(path).expect("a readable file")).collect()
}

/// Show `target` what `make` makes, again and again; `target` says whether it took the input for a valid one.
///
/// # Panics
/// Where something is found; the input is in a file then.
pub fn run(
    name: &str,
    mut make: impl FnMut(&mut ChaCha8Rng) -> Vec<u8>,
    mut target: impl FnMut(&[u8]) -> bool,
) -> Ran {
    let inputs = match std::env::var(INPUTS_VARIABLE) {
        Ok(text) => text.parse().unwrap_or_else(|_| panic!("{INPUTS_VARIABLE}: {text:?} is no number")),
        Err(_) => INPUTS,
    };
    let seed = name.bytes().fold(6_202, |seed: u64, byte| seed.wrapping_mul(257) + u64::from(byte));
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let (mut accepted, mut longest, mut memory) = (0, Duration::ZERO, None);
    let start = Instant::now();
    for index in 0..inputs {
        let input = make(&mut rng);
        let began = Instant::now();
        match catch_unwind(AssertUnwindSafe(|| target(&input))) {
            Ok(taken) => accepted += u64::from(taken),
            Err(panic) => {
                eprintln!("{name}: input {index}, in {}, is a finding", keep(name, &input).display());
                resume_unwind(panic);
            }
        }
        longest = longest.max(began.elapsed());
        assert!(
            longest < LONGEST,
            "{name}: input {index} took {longest:?}: {}",
            keep(name, &input).display()
        );
        if index % LOOK_EVERY == LOOK_EVERY - 1 {
            let (now, first) = (address_space_bytes(), *memory.get_or_insert_with(address_space_bytes));
            let grown = now.zip(first).map_or(0, |(now, first)| now.saturating_sub(first));
            assert!(grown < GROWTH_BYTES, "{name}: {grown} bytes more by input {index}");
        }
        if (index + 1) % 1_000_000 == 0 {
            println!("{name}: {} inputs", index + 1);
        }
    }
    let last =
        address_space_bytes().zip(memory.flatten()).map_or(0, |(now, first)| now.saturating_sub(first));
    println!(
        "{name}: {inputs} inputs in {:.0} s, {accepted} of them valid, the longest took {} us, {} KiB more memory \
         at most",
        start.elapsed().as_secs_f64(),
        longest.as_micros(),
        last / 1024
    );
    Ran { inputs, accepted }
}

/// The most address space that this process has ever had; `None` where nobody says.
fn address_space_bytes() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let peak = status.lines().find_map(|line| line.strip_prefix("VmPeak:"))?;
    peak.trim().strip_suffix("kB")?.trim().parse::<u64>().ok().map(|kib| kib * 1024)
}

fn keep(name: &str, input: &[u8]) -> PathBuf {
    let path = std::env::temp_dir().join(format!("slipsense-fuzz-{name}.bin"));
    std::fs::write(&path, input).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    path
}
