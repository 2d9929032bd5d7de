//! What came back from the emulated computer, held against what was sent.

use std::fs;
use std::path::Path;
use std::time::Duration;

use anyhow::{Context, Result, ensure};
use serde_json::Value;

use crate::process::{command, run as start};
use crate::table::Table;

pub const SENT: &str = "sent.log";
/// What a recorder writes out at once: what a kill may cost, s, and as much again as the kill itself may take to come.
const FLUSH_S: f64 = 1.0;
const SLACK_S: f64 = 0.25;
/// A sender is late by this at most, ms, or it is no real time: six frames, for what else runs on the one core.
const LATE_MS: f64 = 25.0;
/// Errors: name of the run, and what it must say.
const ERRORS: [(&str, &str); 5] = [
    ("no-interface", "socketcan:nocan0: No such device"),
    ("down", "socketcan:vcan0: the interface is down"),
    ("classic", "socketcan:vcan0: the interface is not in CAN FD mode"),
    ("classic-replay", "socketcan:vcan0: the interface is not in CAN FD mode"),
    ("gone", "stopped after 2000 frames, which are kept"),
];

/// The table, and whether all of it is good.
struct Checks<'d> {
    share: &'d Path,
    table: Table,
    good: bool,
}

/// Print the table; `false`: something is not as it should be.
pub fn report(share: &Path, slipsense: &Path, seconds: u32, took: Duration) -> Result<bool> {
    let kernel = fs::read_to_string(share.join("kernel")).context("the emulated computer's kernel")?;
    let title = format!(
        "SocketCAN of Linux {}, three sensors at 240 Hz, plain, {seconds} s, synthetic",
        kernel.trim()
    );
    let table = Table::new(title, &["check", "found", "verdict"]);
    let mut checks = Checks { share, table, good: true };
    let sent = Frames::read(&share.join(SENT))?;
    checks.recorded("first", &sent, slipsense)?;
    checks.recorded("second", &sent, slipsense)?;
    checks.killed(&sent, f64::from(seconds))?;
    checks.watched(&sent, seconds)?;
    checks.errors()?;
    println!("{}", checks.table);
    let uptime = checks.text("end")?;
    let guest_s = uptime.split(' ').next().unwrap_or_default();
    println!("{guest_s} s of the emulated computer's time, {:.0} s of this one's", took.as_secs_f64());
    Ok(checks.good)
}

impl Checks<'_> {
    fn text(&self, name: &str) -> Result<String> {
        fs::read_to_string(self.share.join(name)).with_context(|| format!("{name}: the run left none"))
    }

    fn json(&self, run: &str) -> Result<Value> {
        let text = self.text(&format!("{run}.out"))?;
        let error = || format!("{run}: {}", self.text(&format!("{run}.err")).unwrap_or_default());
        serde_json::from_str(&text).with_context(error)
    }

    fn row(&mut self, check: impl Into<String>, found: impl Into<String>, is_good: bool) {
        self.good &= is_good;
        let verdict = if is_good { "as it should" } else { "WRONG" };
        self.table.row([check.into(), found.into(), verdict.to_owned()]);
    }

    fn ended(&self, run: &str) -> Result<bool> {
        Ok(self.text(&format!("{run}.status"))?.trim() == "0")
    }

    /// A whole recording: what the recorder and the sender say, and every frame.
    fn recorded(&mut self, name: &str, sent: &Frames, slipsense: &Path) -> Result<()> {
        let (record, replay) = (self.json(&format!("{name}-record"))?, self.json(&format!("{name}-replay"))?);
        let ended = self.ended(&format!("{name}-record"))? && self.ended(&format!("{name}-replay"))?;
        let (took_s, late_ms) = (replay["took_s"].as_f64(), replay["latest_ms"].as_f64());
        let (took_s, late_ms) = (took_s.context("took_s")?, late_ms.context("latest_ms")?);
        let real_time = ended && replay["frames"] == sent.data.len() && late_ms <= LATE_MS;
        let found = format!("{} frames in {took_s:.3} s, the latest {late_ms:.1} ms late", replay["frames"]);
        self.row(format!("{name} replay, in real time"), found, real_time);
        let nodes = record["nodes"].as_object().context("nodes")?;
        let count = |what: &str| nodes.values().filter_map(|node| node[what].as_u64()).sum::<u64>();
        let (slip, raw, lost) = (count("slip"), count("raw"), count("slip_lost") + count("raw_lost"));
        let errors = count("errors") + count("restarts");
        let found = format!("{slip} slip and {raw} raw messages, {lost} lost, {errors} errors");
        let is_good = slip > 0 && lost + errors == 0;
        self.row(format!("{name} recording, by the numbers in the messages"), found, is_good);
        let log = Frames::read(&self.share.join(format!("{name}.log")))?;
        let (is_equal, found) = log.beside(sent);
        let is_good = is_equal && log.times_us.is_sorted();
        self.row(format!("{name} recording, candump, byte by byte"), found, is_good);
        let mcap = self.share.join(format!("{name}.mcap"));
        if mcap.exists() {
            let converted = self.share.join(format!("{name}-converted.log"));
            start(command(slipsense).arg("convert").arg(mcap).arg(&converted))?;
            let converted = Frames::read(&converted)?;
            let is_same = converted.times_us == log.times_us;
            let (is_equal, found) = converted.beside(sent);
            self.row(format!("{name} recording, MCAP, and the same times"), found, is_equal && is_same);
        }
        Ok(())
    }

    /// A recorder that was killed: what was on the bus until a second before is in its files.
    fn killed(&mut self, sent: &Frames, seconds: f64) -> Result<()> {
        let at_kill = self.at_kill()?;
        let a_second = sent.data.len() as f64 / seconds;
        let floor = at_kill as f64 - (FLUSH_S + SLACK_S) * a_second;
        ensure!(floor > 0.0, "killed after {at_kill} frames, before there was anything in the file");
        let opens = |checks: &mut Self, name: &str, what: &str| -> Result<()> {
            let log = Frames::parse(&checks.text(name)?, &checks.share.join(name))?;
            let count = log.data.len();
            let is_prefix = sent.data.starts_with(&log.data);
            let is_good = is_prefix && count as f64 >= floor && count <= at_kill + a_second as usize;
            let found = format!("{count} of the {at_kill} frames sent by then");
            checks.row(format!("killed recorder's file, {what}"), found, is_good);
            Ok(())
        };
        opens(self, "killed.log", "candump")?;
        match self.json("open") {
            Ok(_) => opens(self, "opened.log", "MCAP, converted")?,
            // The other rows are worth seeing.
            Err(error) => self.row("killed recorder's file, MCAP, converted", format!("{error:#}"), false),
        }
        let (slip, lost, lines) = self.seconds("watch")?;
        self.row("killed recorder's MCAP in the monitor", watched(slip, lost, lines), slip > 0 && lost == 0);
        Ok(())
    }

    /// CAN frames on the bus until the recorder was killed.
    fn at_kill(&self) -> Result<usize> {
        self.text("at-kill")?.trim().parse().context("at-kill")
    }

    /// A monitor of the bus: it has seen every slip message that was sent until the recorder beside it was killed.
    fn watched(&mut self, sent: &Frames, seconds: u32) -> Result<()> {
        let (slip, lost, lines) = self.seconds("live")?;
        let all = u64::from(seconds) * slipsense::params::FRAME_RATE_HZ as u64;
        let least = self.at_kill()? as u64 * all / sent.data.len() as u64;
        let is_good = self.ended("live")? && slip >= least && lost == 0 && lines >= seconds as usize / 2;
        self.row("monitor of the interface", watched(slip, lost, lines), is_good);
        Ok(())
    }

    /// Slip messages, lost messages and lines that a monitor printed.
    fn seconds(&self, run: &str) -> Result<(u64, u64, usize)> {
        let text = self.text(&format!("{run}.out"))?;
        let lines: Vec<Value> = text.lines().map(serde_json::from_str).collect::<Result<_, _>>()?;
        let sum = |what: &str| lines.iter().filter_map(|line| line[what].as_u64()).sum::<u64>();
        Ok((sum("slip_messages"), sum("lost") + sum("errors"), lines.len()))
    }

    fn errors(&mut self) -> Result<()> {
        for (run, says) in ERRORS {
            let said = self.text(&format!("{run}.err"))?;
            let status = self.text(&format!("{run}.status"))?;
            let is_good = status.trim() == "2" && said.lines().count() == 1 && said.contains(says);
            self.row(format!("error: {run}"), said.trim(), is_good);
        }
        let gone = Frames::read(&self.share.join("gone.log"))?;
        let (sent, kept) = (Frames::read(&self.share.join(SENT))?, gone.data.len());
        let is_good = sent.data[..2000] == gone.data;
        self.row("recording of the interface that went", format!("{kept} frames kept"), is_good);
        Ok(())
    }
}

fn watched(slip: u64, lost: u64, lines: usize) -> String {
    format!("{lines} lines, {slip} slip messages, {lost} lost")
}

/// A candump log, read by its columns and by nothing of the command's.
struct Frames {
    times_us: Vec<u64>,
    /// `ID##FLAGSDATA`, but for the flags: a bus does not tell them as a log does.
    data: Vec<String>,
}

impl Frames {
    fn read(path: &Path) -> Result<Self> {
        let text = fs::read_to_string(path).with_context(|| path.display().to_string())?;
        ensure!(text.ends_with('\n'), "{}: the last line is not whole", path.display());
        Self::parse(&text, path)
    }

    /// Of the text of a file, without a last line that is not whole.
    fn parse(text: &str, path: &Path) -> Result<Self> {
        let (whole, _) = text.rsplit_once('\n').unwrap_or_default();
        let mut frames = Self { times_us: Vec::new(), data: Vec::new() };
        for line in whole.lines() {
            let mut columns = line.split(' ');
            let time = columns.next().and_then(|time| time.strip_prefix('(')?.strip_suffix(')'));
            let time = time.and_then(|time| time.replace('.', "").parse().ok());
            let frame = columns.nth(1).and_then(|frame| frame.split_once("##"));
            let both = time.zip(frame.filter(|(_, data)| !data.is_empty()));
            let (time, (id, data)) = both.with_context(|| format!("{}: {line:?}", path.display()))?;
            frames.times_us.push(time);
            frames.data.push(format!("{id}{}", &data[1..]));
        }
        Ok(frames)
    }

    /// Are they the same frames? How they differ, in words.
    fn beside(&self, sent: &Self) -> (bool, String) {
        let differing = self.data.iter().zip(&sent.data).filter(|(here, there)| here != there).count();
        let found = format!("{} of {} frames, {differing} differ", self.data.len(), sent.data.len());
        (differing == 0 && self.data.len() == sent.data.len(), found)
    }
}
