//! `slipsense record`: a bus into files.

use std::fmt::Write;
use std::path::PathBuf;
use std::time::{Duration, Instant};

use anyhow::{Result, anyhow};
use serde_json::json;
use slipsense_recording::decode::{Count, Decoder};
use slipsense_recording::link::Place;
use slipsense_recording::recorder::Recorder;

use super::Print;
use super::live::{DataRate, Event, Live, PassedOver};

/// Time between flushes. With the time that writing takes, on a busy computer too, a kill costs a second at most.
const FLUSH: Duration = Duration::from_millis(400);

/// Record a bus to MCAP and candump, and count what was lost
///
/// Everything is written to the disk twice a second: a recorder that is killed leaves files that can be read, without
/// the last second. Ended by Ctrl-C or SIGTERM it writes what has come, and the MCAP file has its index. Times are the
/// kernel's (SocketCAN), this computer's at the adapter (slcan), or the log's. With --split-minutes or --split-mb the
/// files are grasp-0001, grasp-0002 and so on.
#[derive(clap::Args)]
#[command(after_help = "\
Sources:
  socketcan:can0         an interface of Linux, in CAN FD mode
  slcan:/dev/ttyACM0     a USB adapter with slcan and CAN FD (CANable 2.0); also slcan:HOST:PORT
  FILE                   a recording or a pipe; - is a candump log on standard input

  sudo ip link set can0 up type can bitrate 1000000 sample-point 0.8 \\
       dbitrate 8000000 dsample-point 0.8 fd on
  sudo ip link add vcan0 mtu 72 type vcan && sudo ip link set vcan0 up    a bus without an adapter
  sudo sysctl net.core.rmem_max=8388608    the kernel keeps a second of frames for a busy program, not 30 ms

Losses are counted by the numbers in the messages: slip messages exactly; raw messages as long as fewer
than 32 in a row are missing; what the kernel dropped by its own counter. SocketCAN was run by its authors on vcan of Debian's kernel, not with an adapter.

Examples:
  slipsense record socketcan:can0 grasp.mcap
  slipsense record slcan:/dev/ttyACM0 grasp.mcap grasp.log --seconds 60
  candump -L can0 | slipsense record - grasp.mcap --json")]
pub struct Args {
    /// Where frames come from
    #[arg(value_name = "SOURCE")]
    source: Place,
    /// Files to write, .mcap or .log; none may be there already
    #[arg(value_name = "OUT", required = true)]
    out: Vec<PathBuf>,
    /// Stop after this time; without it at the end of the source or by Ctrl-C
    #[arg(long, value_name = "S", value_parser = clap::value_parser!(u64).range(1..))]
    seconds: Option<u64>,
    /// Begin new files after this time
    #[arg(long, value_name = "MINUTES", value_parser = clap::value_parser!(u64).range(1..))]
    split_minutes: Option<u64>,
    /// Begin new files when one of them has this size, MB (a million bytes)
    #[arg(long, value_name = "MB", value_parser = clap::value_parser!(u64).range(1..))]
    split_mb: Option<u64>,
    #[command(flatten)]
    data: DataRate,
    #[command(flatten)]
    print: Print,
}

impl Args {
    pub fn run(self) -> Result<()> {
        let live = Live::start(&self.source, self.data.data_mbit)?;
        let mut parts = vec![self.names(1)];
        let mut files = create(&parts[0])?;
        let (mut decoder, mut frames, mut kept, mut clock_back) = (Decoder::new(), 0u64, 0, 0u32);
        let mut record = || -> Result<()> {
            let (began, mut flushed, mut part_began) = (Instant::now(), Instant::now(), Instant::now());
            let (mut full, mut before_us) = (false, 0);
            loop {
                match live.next()? {
                    Event::Frame(entry) => {
                        if std::mem::take(&mut full) {
                            let names = self.names(parts.len() + 1);
                            let next = create(&names)?;
                            finish(std::mem::replace(&mut files, next))?;
                            parts.push(names);
                            part_began = Instant::now();
                        }
                        frames += 1;
                        clock_back += u32::from(entry.timestamp_us < before_us);
                        before_us = entry.timestamp_us;
                        decoder.accept(&entry.frame);
                        files.iter_mut().try_for_each(|file| file.write(&entry))?;
                    }
                    Event::Quiet => {}
                    Event::End => return Ok(()),
                }
                if flushed.elapsed() >= FLUSH {
                    // From the start of the flush: frames wait while it writes.
                    flushed = Instant::now();
                    files.iter_mut().try_for_each(Recorder::flush)?;
                    kept = frames;
                    // New files come with the next frame, so that none is empty.
                    full = self.is_full(&parts[parts.len() - 1], part_began)?;
                }
                if self.seconds.is_some_and(|seconds| began.elapsed() >= Duration::from_secs(seconds)) {
                    live.stop();
                }
            }
        };
        // Frames so far are kept.
        let mut failure = record().err();
        match finish(files) {
            Ok(()) => kept = frames,
            Err(error) => failure = failure.or(Some(error)),
        }
        let failure = failure.map(|error| {
            error.context(match kept == frames {
                true => format!("stopped after {frames} frames, which are kept"),
                false => format!("stopped after {frames} frames, of which {kept} are kept"),
            })
        });
        if frames == 0 {
            remove(&parts.concat())?;
            return Err(failure.unwrap_or_else(|| anyhow!("no CAN FD frame with a 29-bit identifier came")));
        }
        let counts = decoder.counts();
        let out: Vec<_> = parts.concat().iter().map(|out| out.display().to_string()).collect();
        let passed_over = live.passed_over();
        let result = json!({
            "out": out, "frames": frames, "other_frames": decoder.others, "passed_over": passed_over, "nodes": counts,
            "clock_back": clock_back, "notes": passed_over.notes,
        });
        self.print.show(&result, || {
            let mut text = format!("{frames} frames: {}\n", out.join(", "));
            for (node, Count { slip, slip_lost, raw, raw_lost, errors, restarts }) in counts {
                let _ = writeln!(
                    text,
                    "  node {node}: {slip} slip messages, {slip_lost} lost; {raw} raw messages, {raw_lost} lost; \
                     {errors} errors, {restarts} restarts"
                );
            }
            let PassedOver { classic_frames, standard_id_frames, error_frames, unreadable_lines, kernel_drops, notes } =
                &passed_over;
            let _ = writeln!(
                text,
                "  passed over: {classic_frames} classic, {standard_id_frames} with 11-bit identifiers, {error_frames} \
                 error frames, {unreadable_lines} unreadable lines; the kernel dropped {kernel_drops}"
            );
            if clock_back > 0 {
                let _ = writeln!(text, "  the clock of the timestamps went back {clock_back} times");
            }
            notes.iter().for_each(|note| text += &format!("  {note}\n"));
            text
        })?;
        failure.map_or(Ok(()), Err)
    }

    /// The files of part `n`.
    fn names(&self, part: usize) -> Vec<PathBuf> {
        if self.split_minutes.is_none() && self.split_mb.is_none() {
            return self.out.clone();
        }
        let name = |out: &PathBuf| {
            let (stem, end) = (out.file_stem().unwrap_or_default(), out.extension().unwrap_or_default());
            out.with_file_name(format!("{}-{part:04}.{}", stem.display(), end.display()))
        };
        self.out.iter().map(name).collect()
    }

    fn is_full(&self, part: &[PathBuf], began: Instant) -> Result<bool> {
        if self.split_minutes.is_some_and(|minutes| began.elapsed() >= Duration::from_secs(60 * minutes)) {
            return Ok(true);
        }
        let Some(most) = self.split_mb else { return Ok(false) };
        let sizes: Vec<u64> =
            part.iter().map(|file| Ok(std::fs::metadata(file)?.len())).collect::<Result<_>>()?;
        Ok(sizes.iter().any(|&size| size >= most * 1_000_000))
    }
}

/// End all files, whatever becomes of one.
fn finish(files: Vec<Recorder>) -> Result<()> {
    files.into_iter().map(Recorder::finish).fold(Ok(()), Result::and)
}

/// New files, all or none.
fn create(names: &[PathBuf]) -> Result<Vec<Recorder>> {
    let mut files = Vec::new();
    for name in names {
        match Recorder::create(name) {
            Ok(file) => files.push(file),
            Err(error) => {
                remove(&names[..files.len()])?;
                return Err(error);
            }
        }
    }
    Ok(files)
}

/// Take files away again: there is nothing in them.
fn remove(names: &[PathBuf]) -> Result<()> {
    Ok(names.iter().try_for_each(std::fs::remove_file)?)
}
