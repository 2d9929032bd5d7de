//! `slipsense record` as a process: killed, ended, without room on the disk, for hours.
#![cfg(unix)]

use std::fs;
use std::io::Write;
use std::path::Path;
use std::process::Command;
use std::thread;
use std::time::{Duration, Instant};

use crate::recordings::{Log, log};
use crate::support::{Place, assert_says};
use rayon::prelude::*;
use serde_json::Value;
use slipsense_recording::log_file::{Format, read};

/// How often a recorder is killed, and hours of bus time that one records; the book has the campaign.
const KILLS: &str = "SLIPSENSE_KILLS";
const HOURS: &str = "SLIPSENSE_RECORD_HOURS";
/// Kills at a time.
const PARALLEL: usize = 4;
/// What a kill may cost, and what a busy computer may add.
const LOST: Duration = Duration::from_secs(1);
const BUSY: Duration = Duration::from_secs(1);
/// Of the recorder of hours, kB.
const MEMORY_KB: u64 = 100_000;

fn from_environment(name: &str, otherwise: f64) -> f64 {
    std::env::var(name)
        .map_or(otherwise, |text| text.parse().unwrap_or_else(|_| panic!("{name}: need a number")))
}

/// Until `done`, at most a minute.
fn wait(what: &str, mut done: impl FnMut() -> bool) {
    let began = Instant::now();
    while !done() {
        assert!(began.elapsed() < Duration::from_secs(60), "{what}");
        thread::sleep(Duration::from_millis(20));
    }
}

/// Send frames in real time, kill the recorder; the time from the last frame in its files to the kill.
fn killed(after: Duration) -> Duration {
    use std::os::unix::process::ExitStatusExt;
    let place = Place::new();
    let mut child = place.start("record - @r.mcap @r.log");
    let mut input = child.stdin.take().unwrap();
    let (mut source, mut sent, began) = (Log::new(), Vec::new(), Instant::now());
    let mut ticks = 0;
    while began.elapsed() < after {
        let at_us = began.elapsed().as_micros() as u64;
        while ticks < at_us * 240 / 1_000_000 {
            let lines = source.frame(at_us, true);
            sent.extend(lines.iter().filter(|&&byte| byte == b'\n').map(|_| at_us));
            input.write_all(&lines).unwrap();
            ticks += 1;
        }
        thread::sleep(Duration::from_millis(2));
    }
    child.kill().unwrap();
    let killed = began.elapsed();
    assert_eq!(child.wait().unwrap().signal(), Some(9));
    drop(input);
    let lost = [("r.mcap", Format::Mcap), ("r.log", Format::Candump)].map(|(name, format)| {
        let path = place.path(name);
        if fs::metadata(&path).map_or(0, |data| data.len()) == 0 {
            return killed;
        }
        let found = match read(&path, format) {
            Ok(found) => found.entries,
            // It has nothing yet.
            Err(error) => {
                assert!(killed < LOST + BUSY, "{name}, killed after {killed:?}: {error:#}");
                return killed;
            }
        };
        let times: Vec<u64> = found.iter().map(|entry| entry.timestamp_us).collect();
        assert_eq!(times, sent[..times.len()], "{name}: what there is, is what was sent");
        killed - Duration::from_micros(times.last().copied().unwrap_or(0))
    });
    if lost[0] < killed {
        assert!(place.run("convert @r.mcap @x.log").contains("cut short"));
    }
    lost[0].max(lost[1])
}

#[test]
fn a_kill_costs_a_second_at_most() {
    let kills = from_environment(KILLS, 4.0) as usize;
    let one = |number: usize| killed(Duration::from_millis(100 + (number as u64 * 7919) % 3400));
    let pool = rayon::ThreadPoolBuilder::new().num_threads(PARALLEL).build().unwrap();
    let lost: Vec<Duration> = pool.install(|| (0..kills).into_par_iter().map(one).collect());
    let most = lost.iter().max().copied().unwrap_or_default();
    let more = lost.iter().filter(|lost| **lost > LOST).count();
    println!("{kills} kills: at most {most:?} lost, {more} times more than {LOST:?}");
    assert!(most <= LOST + BUSY, "{most:?} lost");
}

/// Slip messages at 240 Hz, raw ones at 10 Hz, faster than in real time; the clock goes back by an hour, and forth again.
#[test]
fn a_recording_of_hours_is_whole_in_bounded_memory() {
    let hours = from_environment(HOURS, 0.02);
    let frames = (hours * 3600.0 * 240.0) as u64;
    let place = Place::new();
    let mut child = place.start("record - @r.mcap --split-mb 200 --json");
    let mut input = child.stdin.take().unwrap();
    let (mut source, mut sent) = (Log::new(), 0);
    for frame in 0..frames {
        let steps = if frame > frames / 3 && frame < frames / 3 * 2 { 0 } else { 3_600_000_000 };
        let lines = source.frame(1_700_000_000_000_000 + frame * 12_500 / 3 + steps, frame % 24 == 0);
        sent += lines.iter().filter(|&&byte| byte == b'\n').count();
        input.write_all(&lines).unwrap();
    }
    let status = fs::read_to_string(format!("/proc/{}/status", child.id())).unwrap_or_default();
    let peak =
        status.lines().find_map(|line| line.strip_prefix("VmHWM:")?.split_whitespace().next()?.parse().ok());
    drop(input);
    let ended = child.wait_with_output().unwrap();
    let result: Value = serde_json::from_slice(&ended.stdout).unwrap();
    let count = &result["nodes"]["42"];
    assert_eq!((&result["frames"], &result["clock_back"]), (&sent.into(), &1.into()), "{result}");
    assert_eq!((&count["slip"], &count["slip_lost"]), (&frames.into(), &0.into()), "{result}");
    assert_eq!((&count["raw"], &count["raw_lost"]), (&frames.div_ceil(24).into(), &0.into()), "{result}");
    let peak: u64 = peak.expect("Linux says so");
    assert!(peak < MEMORY_KB, "{peak} kB");
    let parts = result["out"].as_array().unwrap();
    let found: u64 = parts.iter().filter_map(Value::as_str).map(|part| slips(&place, part)).sum();
    println!(
        "{hours} h, {sent} frames in {} files, {peak} kB at most, {found} slip messages read back",
        parts.len()
    );
    assert_eq!(found, frames);
}

/// Slip messages of a recording, by the monitor.
fn slips(place: &Place, part: &str) -> u64 {
    let name = Path::new(part).file_name().unwrap().display().to_string();
    let lines = place.run(&format!("monitor @{name} --plain --json"));
    let lines = lines.lines().map(|line| line.parse::<Value>().unwrap());
    lines.filter_map(|line| line["slip_messages"].as_u64()).sum()
}

/// Splits at a size; ended by SIGTERM while the source is quiet, it closes its files.
#[test]
fn a_recorder_splits_and_ends_by_sigterm() {
    let place = Place::new();
    let mut child = place.start("record - @r.mcap @r.log --split-mb 1 --json");
    let log = log(480, &[]);
    let mut input = child.stdin.take().unwrap();
    input.write_all(&log).unwrap();
    let size = |part: &str| fs::metadata(place.path(part)).map_or(0, |data| data.len());
    wait("a flush", || size("r-0001.log") > 1_000_000);
    thread::sleep(Duration::from_millis(200));
    let classic = "(1700000009.000000) can0 123#00\n";
    input.write_all([classic.as_bytes(), &log].concat().as_slice()).unwrap();
    wait("a flush of the second part", || size("r-0002.log") > 0);
    let status = Command::new("kill").arg(child.id().to_string()).status().unwrap();
    assert!(status.success());
    let ended = child.wait_with_output().unwrap();
    drop(input);
    assert!(ended.status.success(), "{:?}", ended.status);
    let result: Value = serde_json::from_slice(&ended.stdout).unwrap();
    assert_eq!((&result["frames"], &result["passed_over"]["classic_frames"]), (&25_920.into(), &1.into()));
    for end in ["log", "mcap"] {
        let mut frames = 0;
        for out in result["out"].as_array().unwrap().iter().filter_map(Value::as_str) {
            let Some((stem, _)) = out.rsplit_once(&format!(".{end}")) else { continue };
            assert!(stem.contains("r-00"), "{out}");
            let found = read(Path::new(out), Format::from_path(Path::new(out)).unwrap()).unwrap();
            frames += found.entries.len();
            assert!(found.notes.is_empty(), "{out}: {:?}", found.notes);
        }
        assert_eq!(frames, 25_920, "{end}");
    }
}

/// A disk that is full ends the recording with the file's name and the counts; what was written can be read.
#[test]
fn a_full_disk_ends_a_recorder_and_is_said() {
    let place = Place::new();
    for out in ["r.log", "r.mcap"] {
        let mut child = place.start_limited(2048, &format!("record - @{out} --json"));
        let mut input = child.stdin.take().unwrap();
        input.write_all(&log(12, &[])).unwrap();
        wait("a flush", || fs::metadata(place.path(out)).is_ok_and(|data| data.len() > 1000));
        // The recorder ends before it has taken all.
        let _ = input.write_all(&log(480, &[]));
        drop(input);
        let ended = child.wait_with_output().unwrap();
        let error = String::from_utf8(ended.stderr).unwrap();
        assert_eq!(ended.status.code(), Some(2), "{error}");
        assert_says(&error, &[&format!("{out}: cannot write: "), "File too large"]);
        let result: Value = serde_json::from_slice(&ended.stdout).unwrap();
        assert!(result["nodes"]["42"]["slip"].as_u64() > Some(12), "{result}");
        let said: Vec<usize> = error.split([' ', ':']).filter_map(|word| word.parse().ok()).collect();
        let path = place.path(out);
        let found = read(&path, Format::from_path(&path).unwrap()).unwrap().entries.len();
        assert!(
            said.len() >= 2 && said[0] > said[1] && found >= said[1] && said[1] >= 324,
            "{found}: {error}"
        );
    }
}
