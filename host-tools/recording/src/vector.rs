//! Vector's binary log, BLF, through the crate `blf_asc`.

use std::path::Path;

use crate::candump::LogEntry;
use anyhow::{Context, Result, anyhow};
use blf_asc::{ArbitrationId, BlfReader, BlfWriter, DataBytes, Message};
use slipsense::wire::CanFrame;

use crate::log_file::Recording;

/// Before this BLF's date is empty: 1990, the crate's and python-can's rule.
const BLF_EPOCH_US: u64 = 631_152_000_000_000;

pub(crate) fn read_blf(path: &Path) -> Result<Recording> {
    let mut reader = BlfReader::open(path).map_err(|e| anyhow!("not a BLF file: {e}"))?;
    collect(|| reader.next_message().map_err(|e| anyhow!("{e}")))
}

fn collect(mut next: impl FnMut() -> Result<Option<Message>>) -> Result<Recording> {
    let mut recording = Recording::default();
    let mut skipped = 0;
    while let Some(message) = next()? {
        if !message.is_fd || !message.is_extended_id || message.is_error_frame || message.is_remote_frame {
            skipped += 1;
            continue;
        }
        let at = recording.entries.len() + 1;
        let frame = CanFrame::new(message.arbitration_id.into(), message.data.as_slice())
            .with_context(|| format!("frame {at}"))?;
        anyhow::ensure!(message.timestamp >= 0.0, "frame {at}: time {} is before 1970", message.timestamp);
        recording.entries.push(LogEntry {
            timestamp_us: (message.timestamp * 1e6).round() as u64,
            interface: format!("can{}", message.channel),
            frame,
        });
    }
    recording.note_skipped(skipped);
    Ok(recording)
}

/// The number at the end of an interface's name, which is all that Vector's formats know of it.
pub(crate) fn channel(interface: &str) -> u16 {
    let digits = interface.trim_start_matches(|c: char| !c.is_ascii_digit());
    digits.parse().unwrap_or(0)
}

pub(crate) fn lost_names(entries: &[LogEntry]) -> Vec<String> {
    let odd = entries.iter().find(|entry| entry.interface != format!("can{}", channel(&entry.interface)));
    odd.map(|entry| {
        format!("interface {} becomes channel {}", entry.interface, channel(&entry.interface) + 1)
    })
    .into_iter()
    .collect()
}

pub(crate) fn write_blf(path: &Path, entries: &[LogEntry]) -> Result<Vec<String>> {
    let mut notes = lost_names(entries);
    let start_us = entries.first().map_or(0, |entry| entry.timestamp_us);
    if (1000..BLF_EPOCH_US).contains(&start_us) {
        notes.push("BLF has no time before 1990: times count from the first frame's millisecond".to_owned());
    }
    let mut writer = BlfWriter::create(path).map_err(|e| anyhow!("{e}"))?;
    for entry in entries {
        let data = entry.frame.data();
        let message = Message {
            // The writer cuts nanoseconds off, and a float of today's seconds is up to 120 ns short.
            timestamp: entry.timestamp_us as f64 / 1e6 + 3e-7,
            arbitration_id: ArbitrationId(entry.frame.id()),
            is_extended_id: true,
            is_fd: true,
            bitrate_switch: true,
            dlc: data.len() as u8,
            data: DataBytes(data.to_vec()),
            channel: channel(&entry.interface),
            ..Message::default()
        };
        writer.on_message_received(&message).map_err(|e| anyhow!("{e}"))?;
    }
    writer.finish().map_err(|e| anyhow!("{e}"))?;
    Ok(notes)
}
