//! The longest that a frame of given header and length can take, whatever its data.

use crate::frame::{Format, Frame, Id};
use crate::timing::Timing;
use crate::wire_bits::{FrameBits, Header, RUN, crc_of, wire_bits};

/// By level and run length of the last bits: cycles of the stuff bits on the worst way there, or none such way.
type Ways = [[Option<u64>; RUN as usize + 1]; 2];

/// Cycles of the longest frame with this identifier (`None`: any of `extended` width), format and data length code,
/// without the intermission.
///
/// Exact for CAN FD: every identifier and data field is a way through a graph of last level and run length, and
/// the longest is found by dynamic programming. For classic frames the checksum is taken as free too, which
/// bounds from above: no data need reach it.
pub fn worst_case(id: Option<Id>, extended: bool, format: Format, dlc: u8, timing: &Timing) -> u64 {
    let template_id = id.unwrap_or(if extended { Id::Extended(0) } else { Id::Standard(0) });
    let Ok(frame) = Frame::with_dlc(template_id, format, dlc) else { return 0 };
    let header = Header::of(&frame);
    let checksum = if format.is_fd() { 0 } else { crc_of(format, 0).width };
    let end = header.len + 8 * frame.data().len() as u32 + checksum;
    let mut ways = Ways::default();
    // Before the frame the bus is recessive.
    ways[1][0] = Some(0);
    for index in 0..end {
        let is_free = index >= header.len || id.is_none() && is_id_bit(index, extended);
        // Of a stuff bit that becomes due after this bit. Instead of the last one stands CAN FD's fixed one.
        let in_data_phase = format.switches() && index >= header.brs();
        let stuff_bit = if in_data_phase { timing.data } else { timing.nominal }.cycles();
        let may_stuff = index + 1 < end || !format.is_fd();
        let before = core::mem::take(&mut ways);
        for level in [false, true].into_iter().filter(|&level| is_free || level == header.level(index)) {
            for (last, runs) in before.iter().enumerate() {
                for (run, way) in runs.iter().enumerate() {
                    let Some(mut cycles) = *way else { continue };
                    let mut state = (level, if (last == 1) == level { run + 1 } else { 1 });
                    if state.1 == usize::from(RUN) && may_stuff {
                        cycles += u64::from(stuff_bit);
                        state = (!level, 1);
                    }
                    let known = &mut ways[usize::from(state.0)][state.1];
                    *known = (*known).max(Some(cycles));
                }
            }
        }
    }
    let stuffed = ways.into_iter().flatten().flatten().max().unwrap_or_default();
    let mut bits = FrameBits::default();
    // Everything but the stuff bits of the template is in every frame.
    wire_bits(&frame, |bit| {
        if !bit.dynamic_stuff {
            bits.count(bit);
        }
    });
    timing.bits(&bits) + stuffed
}

/// SOF at 0, then 11 bits of identifier, and 18 more after SRR and IDE.
const fn is_id_bit(index: u32, extended: bool) -> bool {
    matches!(index, 1..=11) || extended && matches!(index, 14..=31)
}
