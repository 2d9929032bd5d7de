//! Mutated input, and what a parser may take for one: time, memory.

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;
use std::time::{Duration, Instant};

use proptest::collection::vec;
use proptest::prelude::*;
use proptest::sample::{Index, select};
use proptest::test_runner::{Config, RngAlgorithm, TestRng, TestRunner};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{RngCore, SeedableRng};

const INPUTS: u32 = 20_000;
/// One input may take as long, on a computer that does other things too.
pub const LONGEST: Duration = Duration::from_secs(5);
/// Memory that one input may take, bytes.
pub const MEMORY_MAX: usize = 256 << 20;
/// Numbers at the edges of what a length, a count or an index may be.
const EDGES: [u64; 12] =
    [0, 1, 0x7F, 0xFF, 0x7FFF, 0xFFFF, 0x7FFF_FFFF, 0xFFFF_FFFF, 1 << 32, 1 << 40, i64::MAX as u64, u64::MAX];

/// Counts the memory of each thread.
struct Counting;

#[global_allocator]
static ALLOCATOR: Counting = Counting;

thread_local! {
    /// Bytes in use, and the most since the peak was last set.
    static USED: Cell<(usize, usize)> = const { Cell::new((0, 0)) };
}

// SAFETY: passes every call on to the system's allocator.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        let _ = USED.try_with(|used| {
            let now = used.get().0.wrapping_add(layout.size());
            used.set((now, used.get().1.max(now)));
        });
        // SAFETY: the caller's promise.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        // Memory of another thread may be freed here.
        let _ = USED.try_with(|used| used.set((used.get().0.saturating_sub(layout.size()), used.get().1)));
        // SAFETY: the caller's promise.
        unsafe { System.dealloc(pointer, layout) }
    }
}

/// Kind, place, second place, length and number of a change.
type Change = (u8, Index, Index, usize, u64);

fn change(bytes: &mut Vec<u8>, corpus: &[Vec<u8>], (kind, at, other, length, number): &Change) {
    if bytes.is_empty() {
        return;
    }
    let at = at.index(bytes.len());
    let end = (at + length).min(bytes.len());
    match kind {
        0 => bytes.truncate(at),
        1 => drop(bytes.drain(at..end)),
        2 => bytes.extend_from_within(at..end),
        3 => {
            // The end of another, from the same place or near its own end.
            let other = other.get(corpus);
            let from =
                if number % 2 == 0 { at.min(other.len()) } else { other.len().saturating_sub(*length) };
            bytes.truncate(at);
            bytes.extend_from_slice(&other[from..]);
        }
        4 => bytes.resize(bytes.len() + length, 0),
        5 | 6 => {
            let number = number.to_le_bytes();
            let width = [1, 2, 4, 8][length % 4];
            bytes[at..].iter_mut().zip(&number[..width]).for_each(|(byte, &number)| *byte = number);
        }
        7 => bytes[at] = bytes[at].wrapping_add(if number % 2 == 0 { 1 } else { u8::MAX }),
        _ => bytes[at] ^= 1 << (length % 8),
    }
}

/// One of the corpus with up to five changes, or random bytes. No `prop_oneof`: it leaves each option half of the bytes
/// that libFuzzer chose.
pub fn mutated(corpus: Vec<Vec<u8>>) -> impl Strategy<Value = Vec<u8>> {
    let number = (any::<bool>(), select(&EDGES[..]), any::<u64>());
    let number = number.prop_map(|(is_edge, edge, any)| if is_edge { edge } else { any });
    let changes = vec((0..10u8, any::<Index>(), any::<Index>(), 0..64usize, number), 0..=5);
    let random = (0..32u8, 0..2000usize, any::<u64>());
    (any::<Index>(), changes, random).prop_map(move |(which, changes, (dice, length, seed))| {
        if dice == 31 {
            let mut bytes = [0].repeat(length);
            ChaCha8Rng::seed_from_u64(seed).fill_bytes(&mut bytes);
            return bytes;
        }
        let mut bytes = which.get(&corpus).clone();
        changes.iter().for_each(|each| change(&mut bytes, &corpus, each));
        bytes
    })
}

/// Show `target` input after input; it says which it took for valid ones, of which there must be some.
pub fn fuzz(
    inputs: impl Strategy<Value = Vec<u8>>,
    accepted_percent_min: u32,
    target: impl Fn(&[u8]) -> bool,
) {
    fuzz_within(MEMORY_MAX, inputs, accepted_percent_min, target);
}

pub fn fuzz_within(
    memory_max: usize,
    inputs: impl Strategy<Value = Vec<u8>>,
    accepted_percent_min: u32,
    target: impl Fn(&[u8]) -> bool,
) {
    let accepted = Cell::new(0);
    let check = |bytes: &[u8]| {
        let (began, before) = (Instant::now(), USED.get().0);
        USED.set((before, before));
        accepted.set(accepted.get() + u32::from(target(bytes)));
        prop_assert!(began.elapsed() < LONGEST, "took {:?}", began.elapsed());
        let (after, most) = USED.get();
        prop_assert!(most - before < memory_max, "took {} bytes", most - before);
        prop_assert!(after <= before + (1 << 16), "kept {} bytes", after - before);
        Ok(())
    };
    #[cfg(feature = "fuzz")]
    {
        // Of zeros a strategy may never accept one, so others follow.
        let mut others = [0; 1 << 12];
        TestRng::deterministic_rng(RngAlgorithm::ChaCha).fill_bytes(&mut others);
        super::guided::run(&|chosen: &[u8]| {
            let random = TestRng::from_seed(RngAlgorithm::PassThrough, &[chosen, &others[..]].concat());
            let mut runner = TestRunner::new_with_rng(Config::default(), random);
            let bytes = inputs.new_tree(&mut runner).expect("none is filtered out");
            let bytes = proptest::strategy::ValueTree::current(&bytes);
            check(&bytes).unwrap_or_else(|error| panic!("{error}: {bytes:?}"));
        });
    }
    let config = Config { cases: INPUTS, failure_persistence: None, ..Config::default() };
    let mut runner = TestRunner::new_with_rng(config, TestRng::deterministic_rng(RngAlgorithm::ChaCha));
    runner.run(&inputs, |bytes| check(&bytes)).unwrap_or_else(|error| panic!("{error}"));
    let percent = 100 * accepted.get() / INPUTS;
    assert!(percent >= accepted_percent_min, "{percent} % are accepted: almost nothing gets through");
}
