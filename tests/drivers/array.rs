//! An array's codes, and when it or a taxel is invalid.

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use slipsense::calibration::{BLOCK_FRAMES, Calibration};
use slipsense::drivers::array::{Array, DEAD_FRAMES, Mounting, STUCK_FRAMES};
use slipsense::params::{COUNT_MAX, FRAME_RATE_HZ, TAXEL_ROWS, TAXELS};
use slipsense::sensor::{PiezoFrame, TaxelMask, is_active};
use slipsense::transfer::{IDLE_CODE, adc_code};

use super::fake::{measured, nominal};

/// Frames until every row was looked at once.
const ROUND: u32 = STUCK_FRAMES * TAXEL_ROWS as u32;

/// An untouched pad with some noise.
fn idle(rng: &mut ChaCha8Rng) -> Vec<u16> {
    (0..TAXELS).map(|_| IDLE_CODE + rng.random_range(0..16)).collect()
}

/// A touched pad with noise, one array alone.
fn touched(rng: &mut ChaCha8Rng) -> Vec<u16> {
    (0..TAXELS).map(|i| adc_code(40 + (i % 7) as u16 * 10) + rng.random_range(0..16)).collect()
}

/// What a second of the untouched pad gives.
fn calibrated(rng: &mut ChaCha8Rng) -> Box<Calibration> {
    let (calibration, result) = measured(BLOCK_FRAMES, |_| idle(rng));
    result.expect("in order");
    calibration
}

#[test]
fn codes_go_where_they_belong_in_any_mounting() {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    for (rows_flipped, cols_flipped) in [(false, false), (true, false), (false, true), (true, true)] {
        let mounting = Mounting { rows_flipped, cols_flipped };
        for arrays in 1..=3 {
            let counts: Vec<u16> = (0..TAXELS * arrays).map(|_| rng.random_range(0..=COUNT_MAX)).collect();
            let codes: Vec<u16> = counts.iter().copied().map(adc_code).collect();
            for index in 0..arrays {
                let (mut calibration, mut frame) = (nominal(), PiezoFrame::zeroed());
                calibration.faulty = calibration.faulty.with(3, 11);
                let mut array = Array::new(&mut calibration);
                array.mount(mounting);
                assert!(array.read(&codes, index, arrays, &mut frame));
                let flip = |n: usize, flipped: bool| if flipped { 31 - n } else { n };
                for slot in 0..TAXELS {
                    let (row, col) = (slot / 32, slot % 32);
                    let (r, c) = (flip(row, rows_flipped), flip(col, cols_flipped));
                    let expected = if is_active(r, c) { counts[slot * arrays + index] } else { 0 };
                    assert_eq!(frame.counts()[r * 32 + c], expected);
                    assert_eq!(array.stuck().masks(r, c), (row, col) == (3, 11));
                }
            }
        }
    }
}

#[test]
fn an_array_that_says_nothing_is_dead_and_one_that_speaks_is_not() {
    assert_eq!((DEAD_FRAMES, STUCK_FRAMES), (24, 80), "100 ms and a third of a second");
    let mut frame = PiezoFrame::zeroed();
    for code in [0, IDLE_CODE, 30_000, u16::MAX] {
        let mut rng = ChaCha8Rng::seed_from_u64(2);
        let mut array = Array::new(Box::leak(nominal()));
        let uniform = vec![code; TAXELS];
        for n in 1..=3 * DEAD_FRAMES {
            assert_eq!(array.read(&uniform, 0, 1, &mut frame), n < DEAD_FRAMES, "code {code}, frame {n}");
        }
        assert!(array.read(&touched(&mut rng), 0, 1, &mut frame));
    }
    // Near a rail, with noise.
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    for rail in [0, u16::MAX - 15] {
        let mut array = Array::new(Box::leak(nominal()));
        let mut railed = || (0..TAXELS).map(|_| rail + rng.random_range(0..16)).collect::<Vec<_>>();
        assert!((0..DEAD_FRAMES).any(|_| !array.read(&railed(), 0, 1, &mut frame)), "rail {rail}");
    }
}

/// A taxel that reads a touch for ever keeps the offsets from following, until a setting switches it off.
#[test]
fn a_taxel_that_is_switched_off_is_no_touch() {
    let sum_after = |off: TaxelMask| {
        let rng = &mut ChaCha8Rng::seed_from_u64(9);
        let mut array = Array::new(Box::leak(calibrated(rng)));
        array.switch_off(off);
        let mut frame = PiezoFrame::zeroed();
        for _ in 0..40 * FRAME_RATE_HZ {
            let mut codes: Vec<_> = idle(rng).iter().map(|code| code + 8).collect();
            codes[16 * 32 + 16] = adc_code(1_500) + rng.random_range(0..16);
            array.read(&codes, 0, 1, &mut frame);
        }
        array.read(&touched(&mut ChaCha8Rng::seed_from_u64(8)), 0, 1, &mut frame);
        frame.sum()
    };
    let (held, follows) = (sum_after(TaxelMask::NONE), sum_after(TaxelMask::NONE.with(16, 16)));
    assert!(follows < held, "{follows} {held}");
}

/// Offsets follow an untouched pad, and no array that is unplugged or has no supply.
#[test]
fn a_dead_array_keeps_its_calibration() {
    for code in [0, IDLE_CODE, u16::MAX] {
        let [mut array, mut other] =
            [(); 2].map(|()| Array::new(Box::leak(calibrated(&mut ChaCha8Rng::seed_from_u64(7)))));
        let [mut frame, mut expected] = [PiezoFrame::zeroed(), PiezoFrame::zeroed()];
        (0..40 * FRAME_RATE_HZ).for_each(|_| _ = array.read(&vec![code; TAXELS], 0, 1, &mut frame));
        let codes = touched(&mut ChaCha8Rng::seed_from_u64(8));
        assert!(array.read(&codes, 0, 1, &mut frame) && other.read(&codes, 0, 1, &mut expected));
        assert_eq!(frame.counts(), expected.counts(), "code {code}");
    }
}

#[test]
fn a_stuck_taxel_is_found_until_it_moves_but_only_where_noise_was_measured() {
    let mut rng = ChaCha8Rng::seed_from_u64(4);
    let stuck = 16 * 32 + 9;
    let mut frame = PiezoFrame::zeroed();
    let [mut array, mut unknown] =
        [calibrated(&mut rng), nominal()].map(|known| Array::new(Box::leak(known)));
    let mut frames_to_find = None;
    for n in 1..=2 * ROUND {
        let mut codes = touched(&mut rng);
        codes[stuck] = adc_code(900);
        array.read(&codes, 0, 1, &mut frame);
        unknown.read(&codes, 0, 1, &mut frame);
        if array.stuck().masks(stuck / 32, stuck % 32) {
            frames_to_find.get_or_insert(n);
        }
    }
    let found = frames_to_find.expect("never found");
    assert!(found <= ROUND);
    assert_eq!((array.stuck().len(), unknown.stuck().len()), (1, 0), "no other");
    let is_back = (0..ROUND + STUCK_FRAMES).any(|_| {
        array.read(&touched(&mut rng), 0, 1, &mut frame);
        array.stuck().is_empty()
    });
    assert!(is_back, "never valid again");
    // A scan that stands still is not the taxels' fault.
    let codes = touched(&mut rng);
    (0..2 * ROUND).for_each(|_| _ = array.read(&codes, 0, 1, &mut frame));
    assert!(array.stuck().is_empty());
}

#[test]
fn a_firm_grasp_is_not_stuck_and_a_short_is() {
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let (mut calibration, mut frame) = (calibrated(&mut rng), PiezoFrame::zeroed());
    let mut array = Array::new(&mut calibration);
    let full = 10 * 32 + 10;
    let mut run = |array: &mut Array, codes: fn(&mut ChaCha8Rng) -> Vec<u16>| {
        for _ in 0..ROUND {
            let mut codes = codes(&mut rng);
            codes[full] = u16::MAX;
            array.read(&codes, 0, 1, &mut frame);
        }
    };
    run(&mut array, touched);
    assert!(array.stuck().is_empty(), "held at full scale by a grasp");
    run(&mut array, idle);
    assert!(array.stuck().masks(full / 32, full % 32), "at full scale on an untouched pad");
    run(&mut array, touched);
    assert!(array.stuck().masks(full / 32, full % 32), "a grasp does not clear it");
}

#[test]
fn a_short_scan_or_a_missing_array_does_not_panic() {
    let (mut array, mut frame) = (Array::new(Box::leak(nominal())), PiezoFrame::zeroed());
    array.read(&[], 0, 0, &mut frame);
    array.read(&[9; 100], 5, 3, &mut frame);
    array.read(&[9; 10 * TAXELS], 0, 1, &mut frame);
}
