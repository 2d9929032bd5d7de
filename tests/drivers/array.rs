//! An array's codes, and when it or a taxel is invalid.

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use slipsense::drivers::array::{Array, DEAD_FRAMES, Mounting, STUCK_FRAMES};
use slipsense::params::{COUNT_MAX, TAXEL_ROWS, TAXELS};
use slipsense::sensor::{PiezoFrame, is_active};
use slipsense::transfer::adc_code;

/// Frames until every row was looked at once.
const ROUND: u32 = STUCK_FRAMES * TAXEL_ROWS as u32;

fn plain() -> Array {
    Array::new(Mounting::default())
}

/// A touched pad with noise, one array alone.
fn noisy(rng: &mut ChaCha8Rng) -> Vec<u16> {
    (0..TAXELS).map(|i| adc_code(40 + (i % 7) as u16 * 10 + rng.random_range(0..3))).collect()
}

#[test]
fn codes_go_where_they_belong_in_any_mounting() {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    for bits in 0..8 {
        let mounting = Mounting::from_bits(bits).expect("three bits");
        let mut places: Vec<usize> = (0..TAXELS).map(|slot| mounting.place(slot)).collect();
        for arrays in 1..=3 {
            let counts: Vec<u16> = (0..TAXELS * arrays).map(|_| rng.random_range(0..=COUNT_MAX)).collect();
            let codes: Vec<u16> = counts.iter().copied().map(adc_code).collect();
            for index in 0..arrays {
                let mut frame = PiezoFrame::zeroed();
                assert!(Array::new(mounting).read(&codes, index, arrays, &mut frame));
                for (row, col) in (0..32).flat_map(|row| (0..32).map(move |col| (row, col))) {
                    let (r, c) = if mounting.transposed { (col, row) } else { (row, col) };
                    let r = if mounting.rows_flipped { 31 - r } else { r };
                    let c = if mounting.cols_flipped { 31 - c } else { c };
                    let expected =
                        if is_active(r, c) { counts[(row * 32 + col) * arrays + index] } else { 0 };
                    assert_eq!(frame.counts()[r * 32 + c], expected);
                }
            }
        }
        places.sort_unstable();
        assert!(places.into_iter().eq(0..TAXELS), "a permutation");
    }
    assert_eq!(Mounting::from_bits(8), None);
}

#[test]
fn an_array_that_says_nothing_is_dead_and_one_that_speaks_is_not() {
    for count in [1, 700, 4_080, COUNT_MAX] {
        let mut rng = ChaCha8Rng::seed_from_u64(2);
        let (mut array, mut frame) = (plain(), PiezoFrame::zeroed());
        let uniform = vec![adc_code(count); TAXELS];
        for n in 1..=3 * DEAD_FRAMES {
            assert_eq!(array.read(&uniform, 0, 1, &mut frame), n < DEAD_FRAMES, "count {count}, frame {n}");
        }
        println!(
            "count {count} everywhere: dead after {DEAD_FRAMES} frames, alive with the first that differs"
        );
        assert!(array.read(&noisy(&mut rng), 0, 1, &mut frame));
    }
    // Near the rail, with noise.
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let (mut array, mut frame) = (plain(), PiezoFrame::zeroed());
    let railed = |rng: &mut ChaCha8Rng| {
        (0..TAXELS).map(|_| adc_code(COUNT_MAX - rng.random_range(0..3))).collect::<Vec<_>>()
    };
    assert!((0..DEAD_FRAMES).any(|_| !array.read(&railed(&mut rng), 0, 1, &mut frame)));
}

#[test]
fn an_untouched_pad_of_zeros_is_alive() {
    let (mut array, mut frame) = (plain(), PiezoFrame::zeroed());
    assert!((0..2 * ROUND).all(|_| array.read(&[0; TAXELS], 0, 1, &mut frame)));
    assert!(array.stuck().is_empty());
}

#[test]
fn a_stuck_taxel_is_found_until_it_moves() {
    let mut rng = ChaCha8Rng::seed_from_u64(4);
    let (mut array, mut frame) = (plain(), PiezoFrame::zeroed());
    let stuck = 16 * 32 + 9;
    let mut frames_to_find = None;
    for n in 1..=2 * ROUND {
        let mut codes = noisy(&mut rng);
        codes[stuck] = adc_code(900);
        array.read(&codes, 0, 1, &mut frame);
        if array.stuck().masks(stuck / 32, stuck % 32) {
            frames_to_find.get_or_insert(n);
        }
    }
    let found = frames_to_find.expect("never found");
    assert!(found <= ROUND);
    assert_eq!(array.stuck().len(), 1, "no other");
    let back = (1..=ROUND + STUCK_FRAMES)
        .find(|_| {
            array.read(&noisy(&mut rng), 0, 1, &mut frame);
            array.stuck().is_empty()
        })
        .expect("never valid again");
    println!("stuck: found after {found} frames, valid again after {back}");
}

#[test]
fn a_firm_grasp_is_not_stuck_and_a_short_is() {
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let (mut array, mut frame) = (plain(), PiezoFrame::zeroed());
    let full = 10 * 32 + 10;
    let mut grasp = |array: &mut Array| {
        for _ in 0..ROUND {
            let mut codes = noisy(&mut rng);
            codes[full] = adc_code(COUNT_MAX);
            array.read(&codes, 0, 1, &mut frame);
        }
    };
    grasp(&mut array);
    assert!(array.stuck().is_empty(), "held at full scale by a grasp");
    let mut idle = [0; TAXELS];
    idle[full] = adc_code(COUNT_MAX);
    let mut frame = PiezoFrame::zeroed();
    for _ in 0..ROUND {
        array.read(&idle, 0, 1, &mut frame);
    }
    assert!(array.stuck().masks(full / 32, full % 32), "at full scale on an untouched pad");
    grasp(&mut array);
    assert!(array.stuck().masks(full / 32, full % 32), "a grasp does not clear it");
}

#[test]
fn a_short_scan_or_a_missing_array_does_not_panic() {
    let mut frame = PiezoFrame::zeroed();
    plain().read(&[], 0, 0, &mut frame);
    plain().read(&[9; 100], 5, 3, &mut frame);
    plain().read(&[9; 10 * TAXELS], 0, 1, &mut frame);
}
