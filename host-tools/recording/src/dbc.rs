//! The slip message as a DBC file, for tools that know CAN but no Cyphal. The raw message has several frames and has
//! no place in one.

use std::fmt::Write;

use anyhow::Result;
use slipsense::params::FRAME_RATE_HZ;
use slipsense::wire::{NodeId, SlipMessage, SlipReceiver, Transmitter};

use crate::layout::{self, Field, Kind, Leaf};

/// Bit of a DBC identifier that says it has 29 bits.
const EXTENDED: u32 = 1 << 31;
/// `VFrameFormat` of a CAN FD frame with a 29-bit identifier.
const EXTENDED_FD: u32 = 15;

struct Signal {
    name: String,
    offset: u32,
    bits: u32,
    signed: bool,
    /// Value of one step.
    factor: f64,
    unit: &'static str,
    comment: String,
}

/// Text of the file for the module at this address.
pub fn text(node: NodeId) -> Result<String> {
    let definition = layout::slip()?;
    let mut signals: Vec<Signal> = definition.leaves().iter().map(signal).collect();
    let frame = Transmitter::new(node).slip(&SlipMessage::default());
    let (id, length) = (frame.id() | EXTENDED, frame.data().len());
    signals.push(Signal {
        name: "transfer_id".to_owned(),
        offset: 8 * (length as u32 - 1),
        bits: 5,
        signed: false,
        factor: 1.0,
        unit: "",
        comment: "Number of the transfer, modulo 32: a gap is a lost message.".to_owned(),
    });
    let mut out = String::from("VERSION \"\"\n\nNS_ :\n\nBS_:\n\n");
    writeln!(out, "BU_: SlipSense{}\n", node.get())?;
    writeln!(out, "BO_ {id} Slip: {length} SlipSense{}", node.get())?;
    for signal in &signals {
        let Signal { name, offset, bits, signed, factor, unit, .. } = signal;
        let sign = if *signed { '-' } else { '+' };
        let steps = 2f64.powi(*bits as i32);
        let low = if *signed { -steps / 2.0 } else { 0.0 };
        let (low, high) = (low * factor, (low + steps - 1.0) * factor);
        writeln!(
            out,
            " SG_ {name} : {offset}|{bits}@1{sign} ({factor},0) [{low}|{high}] \"{unit}\" Vector__XXX"
        )?;
    }
    let timeout_ms = SlipReceiver::TIMEOUT_US as f64 / 1e3;
    let about = format!(
        "The decision of one frame and the contact on each pad, {FRAME_RATE_HZ} per second. Act on slip where invalid is 0 \
         and the last message is at most {timeout_ms} ms old."
    );
    writeln!(out, "\nCM_ BO_ {id} \"{about}\";")?;
    for Signal { name, comment, .. } in signals.iter().filter(|signal| !signal.comment.is_empty()) {
        writeln!(out, "CM_ SG_ {id} {name} \"{}\";", comment.replace('"', "'"))?;
    }
    let formats = "\"StandardCAN\",\"ExtendedCAN\",\"reserved\",\"J1939PG\",\"reserved\",\"reserved\",\
                   \"reserved\",\"reserved\",\"reserved\",\"reserved\",\"reserved\",\"reserved\",\"reserved\",\
                   \"reserved\",\"StandardCAN_FD\",\"ExtendedCAN_FD\"";
    writeln!(out, "BA_DEF_ BO_ \"VFrameFormat\" ENUM {formats};")?;
    writeln!(out, "BA_DEF_ BO_ \"GenMsgCycleTime\" FLOAT 0 10000;")?;
    writeln!(out, "BA_DEF_DEF_ \"VFrameFormat\" \"StandardCAN\";\nBA_DEF_DEF_ \"GenMsgCycleTime\" 0;")?;
    writeln!(out, "BA_ \"VFrameFormat\" BO_ {id} {EXTENDED_FD};")?;
    writeln!(out, "BA_ \"GenMsgCycleTime\" BO_ {id} {:.3};", 1e3 / f64::from(FRAME_RATE_HZ))?;
    write!(out, "VAL_ {id} class_index")?;
    for (name, value, _) in definition.constants.iter().filter(|(name, ..)| name.starts_with("CLASS")) {
        write!(out, " {value} \"{name}\"")?;
    }
    writeln!(out, " ;")?;
    Ok(out)
}

fn signal(leaf: &Leaf) -> Signal {
    let Field { name, kind, comment, .. } = leaf.field();
    let (factor, unit) = match name.rsplit_once('_') {
        Some((_, "q10")) => (1.0 / 1024.0, ""),
        Some((_, "q8")) => (1.0 / 256.0, ""),
        Some((_, "us")) => (1.0, "us"),
        Some((_, "deg")) => (1.0, "deg"),
        _ => (1.0, ""),
    };
    let words = leaf.path.iter().map(|(field, index)| {
        let name = field.name.trim_end_matches("_q10").trim_end_matches("_q8");
        index.map_or_else(|| name.to_owned(), |index| format!("{name}_{index}"))
    });
    // Once is enough where there are several.
    let commented = leaf.path.last().is_some_and(|(_, index)| index.unwrap_or(0) == 0);
    Signal {
        name: words.collect::<Vec<_>>().join("_"),
        offset: leaf.offset,
        bits: kind.bits(),
        signed: matches!(kind, Kind::Signed(_)),
        factor,
        unit,
        comment: if commented { comment.clone() } else { String::new() },
    }
}
