//! Fields, counts and times of single frames. Every bit is compared with an encoder that shares no code:
//! `tests/python/check_can_bits.py` with the example `random_frames`.

use proptest::prelude::*;
use slipsense_can_sim::{
    Field, Format, Frame, FrameBits, Id, Rate, Timing, WireBit, dlc_of, len_of, wire_bits, worst_case,
};

const CLASSIC: Format = Format::Classic;

fn frame(id: Id, format: Format, data: &[u8]) -> Frame {
    Frame::new(id, format, data).unwrap()
}

fn bits_of(frame: &Frame) -> Vec<WireBit> {
    let mut bits = Vec::new();
    wire_bits(frame, |bit| bits.push(bit));
    bits
}

fn at(data_bps: u32) -> Timing {
    Timing::new(80_000_000, 1_000_000, data_bps).unwrap()
}

#[test]
fn lengths_and_codes_belong_together() {
    for dlc in 0..16 {
        assert_eq!(dlc_of(len_of(dlc, true), true), Some(dlc));
    }
    assert_eq!((dlc_of(9, true), dlc_of(9, false), len_of(12, false)), (None, None, 8));
    assert!(Frame::new(Id::Standard(1 << 11), CLASSIC, &[]).is_err());
    assert!(Frame::new(Id::Extended(1 << 29), CLASSIC, &[]).is_err());
    assert!(Frame::new(Id::Standard(0), CLASSIC, &[0; 9]).is_err());
    assert!(Frame::with_dlc(Id::Standard(0), CLASSIC, 16).is_err());
}

/// 64 bytes, 11-bit identifier, 1 Mbit/s arbitration, with the intermission: typical over random data, worst over
/// all. stm32h7.md of the project's notes has 142/169 µs at 5 Mbit/s and 100/118 µs at 8 Mbit/s.
#[test]
fn a_full_frame_takes_the_times_that_the_design_counts_on() {
    for (data_bps, typical_us, worst_us) in [(5_000_000, 142, 169), (8_000_000, 100, 118)] {
        let timing = at(data_bps);
        let worst = timing.ns(worst_case(None, false, Format::FD, 15, &timing) + timing.intermission());
        let mut seed = 1_u32;
        let mut random = || {
            seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (seed >> 24) as u8
        };
        let frames = 2000;
        let total: u64 = (0..frames)
            .map(|number| {
                let data: [u8; 64] = std::array::from_fn(|_| random());
                timing.frame(&frame(Id::Standard(number % 2048), Format::FD, &data)) + timing.intermission()
            })
            .sum();
        let typical = timing.ns(total / u64::from(frames));
        println!("64 bytes at {data_bps} bit/s: typical {typical} ns, worst {worst} ns");
        assert!(typical.abs_diff(typical_us * 1000) < 1500, "{typical}");
        assert!(worst.abs_diff(worst_us * 1000) < 1500, "{worst}");
    }
}

/// Stuff bits that all-zero payloads cost, which is why raw counts are not sent as they are.
#[test]
fn zeros_stuff_badly() {
    let bits = FrameBits::of(&frame(Id::Standard(0x123), Format::FD, &[0; 64]));
    println!("64 zero bytes: {} dynamic stuff bits", bits.dynamic_stuff);
    assert!((100..=105).contains(&bits.dynamic_stuff));
}

/// One byte: all data, every identifier of a sample, by trying.
#[test]
fn the_worst_case_of_a_short_fd_frame_is_reached_and_never_passed() {
    let timing = at(8_000_000);
    for id in (0..2048).step_by(37).map(Id::Standard).chain([Id::Extended(0), Id::Extended(0x1F0F_0F0F)]) {
        let longest = (0..=255).map(|byte| timing.frame(&frame(id, Format::FD, &[byte]))).max();
        let claimed = worst_case(Some(id), false, Format::FD, 1, &timing);
        assert_eq!(Some(claimed), longest, "{id:?}");
    }
    let all =
        (0..2048).flat_map(|id| [0x00, 0x0F, 0x3C, 0x78, 0xF0, 0xFF, 0x1F, 0xE0].map(|byte| (id, byte)));
    let longest = all.map(|(id, byte)| timing.frame(&frame(Id::Standard(id), Format::FD, &[byte]))).max();
    let claimed = worst_case(None, false, Format::FD, 1, &timing);
    assert!(longest <= Some(claimed));
}

#[test]
fn bits_at_the_switch_are_split_at_their_sample_points() {
    let timing = at(8_000_000);
    // 80 quanta sampled at 64; 10 quanta sampled at 8.
    assert_eq!((timing.nominal.before_sample(), timing.data.after_sample()), (64, 2));
    assert_eq!((timing.bit(Rate::ToData), timing.bit(Rate::ToNominal)), (66, 8 + 16));
    assert_eq!(timing.bit(Rate::ToData) + timing.bit(Rate::ToNominal), 90);
    assert_eq!(timing.ns(1), 13, "12.5 ns, rounded up");
    assert_eq!(timing.ns(80_000_000 * 36_000), 36_000_000_000_000, "ten hours do not overflow");
    assert!(Timing::new(80_000_000, 1_000_000, 6_000_000).is_err());
    assert!(Timing::new(80_000_000, 0, 8_000_000).is_err());
}

fn any_frame() -> impl Strategy<Value = Frame> {
    let id = prop_oneof![
        (0u16..2048).prop_map(Id::Standard),
        prop_oneof![Just(0), Just(0x1FFF_FFFF), 0u32..1 << 29].prop_map(Id::Extended)
    ];
    let format = prop_oneof![
        Just(Format::Classic),
        Just(Format::Remote),
        (any::<bool>(), any::<bool>())
            .prop_map(|(bit_rate_switch, error_passive)| Format::Fd { bit_rate_switch, error_passive }),
    ];
    let data = prop_oneof![
        proptest::collection::vec(any::<u8>(), 64),
        proptest::collection::vec(prop_oneof![Just(0u8), Just(0xFF), Just(0xF8), Just(0x07)], 64),
    ];
    (id, format, 0u8..16, data).prop_map(|(id, format, dlc, data)| {
        let mut frame = Frame::with_dlc(id, format, dlc).unwrap();
        let len = frame.data().len();
        frame.data_mut().copy_from_slice(&data[..len]);
        frame
    })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(2000))]

    /// The data comes back out of its field, and counts and times agree with the bits.
    #[test]
    fn fields_counts_and_times_are_those_of_the_bits(frame in any_frame()) {
        let bits = bits_of(&frame);
        let payload: Vec<bool> =
            bits.iter().filter(|bit| bit.field == Field::Data && !bit.dynamic_stuff).map(|bit| bit.level).collect();
        let sent: Vec<u8> =
            payload.chunks(8).map(|byte| byte.iter().fold(0, |value, &bit| value << 1 | u8::from(bit))).collect();
        prop_assert_eq!(sent, frame.data());

        let counted = FrameBits::of(&frame);
        prop_assert_eq!(counted.total() as usize, bits.len());
        prop_assert_eq!(counted.dynamic_stuff as usize, bits.iter().filter(|bit| bit.dynamic_stuff).count());
        let timing = at(8_000_000);
        prop_assert_eq!(timing.frame(&frame), bits.iter().map(|bit| u64::from(timing.bit(bit.rate))).sum::<u64>());
    }

    /// No frame is longer than the worst of its identifier, nor that than the worst of all identifiers.
    #[test]
    fn no_frame_passes_the_worst_case(frame in any_frame()) {
        let timing = at(5_000_000);
        let extended = matches!(frame.id(), Id::Extended(_));
        let of_id = worst_case(Some(frame.id()), extended, frame.format(), frame.dlc(), &timing);
        let of_all = worst_case(None, extended, frame.format(), frame.dlc(), &timing);
        prop_assert!(timing.frame(&frame) <= of_id && of_id <= of_all);
    }

    /// The lower arbitration field is the frame whose first differing bit is dominant.
    #[test]
    fn the_arbitration_field_orders_frames_as_the_bus_does(a in any_frame(), b in any_frame()) {
        let levels = |frame: &Frame| -> Vec<bool> {
            let compared = |bit: &WireBit| bit.field <= Field::Arbitration && !bit.dynamic_stuff;
            bits_of(frame).into_iter().filter(compared).map(|bit| bit.level).collect()
        };
        let (x, y) = (levels(&a), levels(&b));
        let first = x.iter().zip(&y).find(|(x, y)| x != y).map(|(x, _)| !x);
        let (a, b) = (a.arbitration_field(), b.arbitration_field());
        prop_assert_eq!(first, (a != b).then_some(a < b));
    }
}
