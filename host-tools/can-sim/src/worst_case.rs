//! The longest that a frame of given header and length can take, whatever its data.

use crate::frame::{Format, Frame, Id};
use crate::timing::Timing;
use crate::wire_bits::{FrameBits, Header, RUN, Rate, crc_of};

/// Stuff bits so far on the worst way to a state, or none such way.
type Ways = [[Option<Stuffed>; RUN as usize + 1]; 2];

#[derive(Clone, Copy, Default)]
struct Stuffed {
    nominal: u32,
    data: u32,
}

/// Bits of the longest frame with this identifier (`None`: any of `extended` width), format and data length code.
///
/// Exact for CAN FD: every identifier and data field is a way through a graph of last level and run length, and
/// the longest is found by dynamic programming. For classic frames the checksum is taken as free too, which
/// bounds from above: no data need reach it.
pub fn worst_case(id: Option<Id>, extended: bool, format: Format, dlc: u8, timing: &Timing) -> FrameBits {
    let template_id = id.unwrap_or(if extended { Id::Extended(0) } else { Id::Standard(0) });
    let Ok(frame) = Frame::with_dlc(template_id, format, dlc) else { return FrameBits::default() };
    let header = Header::of(&frame);
    let base = FrameBits::of(&frame);
    let checksum = if format.is_fd() { 0 } else { crc_of(format, 0).width };
    let free_from = header.len;
    let end = header.len + 8 * frame.data().len() as u32 + checksum;

    let mut ways: Ways = Default::default();
    for index in 0..end {
        let fixed =
            (index < free_from && !(id.is_none() && is_id_bit(index, extended))).then(|| header.level(index));
        // A stuff bit that becomes due after this bit.
        let in_data_phase = format.switches() && index >= header.brs();
        let last = index + 1 == end && format.is_fd();
        ways = step(&ways, index == 0, fixed, in_data_phase, last, timing);
    }
    let worst =
        ways.iter().flatten().flatten().max_by_key(|ways| cost(ways, timing)).copied().unwrap_or_default();
    let mut bits = base;
    let (zeros_nominal, zeros_data) = stuff_of(&frame);
    bits.nominal = bits.nominal - zeros_nominal + worst.nominal;
    bits.data = bits.data - zeros_data + worst.data;
    bits.dynamic_stuff = worst.nominal + worst.data;
    bits
}

/// SOF at 0, then 11 bits of identifier, and 18 more after SRR and IDE.
const fn is_id_bit(index: u32, extended: bool) -> bool {
    matches!(index, 1..=11) || extended && matches!(index, 14..=31)
}

fn cost(ways: &Stuffed, timing: &Timing) -> u64 {
    u64::from(ways.nominal) * u64::from(timing.nominal.cycles())
        + u64::from(ways.data) * u64::from(timing.data.cycles())
}

/// Stuff bits of a frame, nominal and data.
fn stuff_of(frame: &Frame) -> (u32, u32) {
    let fd = frame.format().is_fd();
    crate::WireBits::new(frame).filter(|bit| bit.stuff && !(fd && bit.field == crate::Field::Crc)).fold(
        (0, 0),
        |(nominal, data), bit| match bit.rate {
            Rate::Data => (nominal, data + 1),
            _ => (nominal + 1, data),
        },
    )
}

fn step(
    ways: &Ways,
    first: bool,
    fixed: Option<bool>,
    in_data_phase: bool,
    last: bool,
    timing: &Timing,
) -> Ways {
    let mut next: Ways = Default::default();
    let mut reach = |level: bool, run: u8, mut way: Stuffed| {
        // Five in a row: the stuff bit follows and starts a run of its own, but for the fixed one after CAN FD's
        // data field.
        let (level, run) = if run == RUN && !last {
            if in_data_phase {
                way.data += 1
            } else {
                way.nominal += 1
            }
            (!level, 1)
        } else {
            (level, run)
        };
        let known = &mut next[level as usize][run as usize];
        if known.is_none_or(|known| cost(&known, timing) < cost(&way, timing)) {
            *known = Some(way);
        }
    };
    for level in [false, true] {
        if fixed.is_some_and(|fixed| fixed != level) {
            continue;
        }
        if first {
            reach(level, 1, Stuffed::default());
            continue;
        }
        for (before, runs) in ways.iter().enumerate() {
            for (run, way) in runs.iter().enumerate() {
                let Some(way) = way else { continue };
                let run = if (before == 1) == level { run as u8 + 1 } else { 1 };
                reach(level, run, *way);
            }
        }
    }
    next
}
