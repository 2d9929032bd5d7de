//! Recording, converting, replaying, watching: through the binary.

use std::fs;
use std::io::{Read, Write};
use std::net::TcpListener;
use std::path::Path;
use std::thread;
use std::time::{Duration, Instant};

use crate::support::{Place, slipsense};
use serde_json::Value;
use slipsense::sensor::{PiezoFrame, SensorInput};
use slipsense::wire::{NodeId, RawBuffer, RawFrame, SlipMessage, Transmitter};
use slipsense_recording::Episode;
use slipsense_recording::candump::CandumpWriter;
use slipsense_recording::log_file::{Format, read};

/// What a fingertip sends, as lines of candump.
pub struct Log {
    transmitter: Transmitter,
    lines: CandumpWriter<Vec<u8>>,
    piezo: PiezoFrame,
    sequence: u32,
}

impl Log {
    pub fn new() -> Self {
        let lines = CandumpWriter::new(Vec::new(), "can0").unwrap();
        let transmitter = Transmitter::new(NodeId::DEFAULT);
        Self { transmitter, lines, piezo: PiezoFrame::from_scan([7; 1024]), sequence: 0 }
    }

    /// Of the next frame.
    pub fn frame(&mut self, at_us: u64, with_raw: bool) -> Vec<u8> {
        let (sequence, xl) = (self.sequence, [[1, -2, 3]; 33]);
        self.sequence += 1;
        let message = SlipMessage { sequence, sensors: 1, slip: sequence >= 240, ..SlipMessage::default() };
        let mut sent = vec![self.transmitter.slip(&message)];
        if with_raw {
            let xl_end = 33 * (sequence + 1);
            let input = SensorInput { piezo: Some(&self.piezo), xl: Some(&xl), xl_end };
            let raw = RawFrame { timestamp_us: at_us, sequence, sensor: 0, health: 0, input };
            sent.extend(self.transmitter.raw(&raw, &mut RawBuffer::new()));
        }
        sent.iter().for_each(|frame| self.lines.write(at_us, frame).unwrap());
        std::mem::take(self.lines.flushed().unwrap())
    }
}

pub fn log(frames: u32, lost: &[u32]) -> Vec<u8> {
    let mut log = Log::new();
    let at_us = |frame: u32| 1_700_000_000_000_000 + u64::from(frame) * 12_500 / 3;
    let kept = |frame: u32| {
        let lines = log.frame(at_us(frame), true);
        if lost.contains(&frame) { Vec::new() } else { lines }
    };
    (0..frames).flat_map(kept).collect()
}

#[test]
fn a_recording_goes_through_every_format_and_back() {
    let place = Place::new();
    let first = log(24, &[]);
    place.file("a.log", &first);
    place.run("convert @a.log @b.mcap");
    place.run("convert @b.mcap @c.log");
    assert_eq!(fs::read(place.path("c.log")).unwrap(), first, "byte for byte");
    let result = place.json("convert @c.log @f.npz --xl-lsb-g 0.0005");
    assert_eq!(result["wrote"], "24 frames of 1 sensor");
    assert!(result["left_out"][0].as_str().unwrap().contains("slipsense run"), "{result}");
    let episode = Episode::read(place.path("f.npz")).unwrap();
    assert_eq!((episode.frames(), episode.xl_end(23, 0), episode.meta.xl_lsb_g), (24, 24 * 33, 0.0005));
}

#[test]
fn an_episode_to_the_bus_and_back() {
    let place = Place::with_files();
    let text = place.run("convert @e.npz @e.mcap");
    assert!(text.contains("left out: what meta says of units and origin, labels, true slip speed"), "{text}");
    place.run("convert @e.mcap @back.npz --xl-lsb-g 0.000488");
    let [before, after] = ["e.npz", "back.npz"].map(|name| Episode::read(place.path(name)).unwrap());
    assert!(before.piezo == after.piezo);
    assert_eq!((&before.xl_end, before.frames()), (&after.xl_end, after.frames()));
    for (before, after) in before.xl.iter().zip(&after.xl) {
        assert_eq!(&before[..after.len()], after, "samples after the last frame are not on the bus");
    }
}

#[test]
fn a_crosshead_comes_along() {
    let place = Place::new();
    place.file("stand.csv", "Load [N],Travel [mm],Time [sec]\n0.1,0.5,0\n0.2,0.75,0.1\n");
    assert!(place.run("convert @stand.csv @stand.mcap").contains("the load is left out"));
    place.run("convert @stand.mcap @back.csv");
    let back = fs::read_to_string(place.path("back.csv")).unwrap();
    assert_eq!(back, "Time [s],Travel [mm]\n0.000000,0.5\n0.100000,0.75\n");
    place.errors([("convert @stand.csv @x.log", "no CAN frame in it")]);
}

#[test]
fn losses_are_counted() {
    let place = Place::new();
    place.file("a.log", log(300, &[10, 11, 12, 100]));
    let result = place.json("record @a.log @r.mcap");
    let count = &result["nodes"]["42"];
    assert_eq!((&count["slip"], &count["slip_lost"]), (&296.into(), &4.into()), "{result}");
    assert_eq!((&count["raw"], &count["raw_lost"]), (&296.into(), &4.into()), "{result}");
    // Nothing is overwritten.
    place.errors([("record @a.log @r.mcap", "cannot make a new file")]);

    let text = place.run("monitor @a.log --plain");
    let lines: Vec<&str> = text.lines().collect();
    assert_eq!(lines.len(), 2, "{text}");
    assert!(lines[0].contains("236 slip") && text.contains("lost 8"), "slip and raw: {text}");
    let text = place.run("monitor @r.mcap --plain --json");
    let last: Value = text.lines().last().unwrap().parse().unwrap();
    assert_eq!((&last["slip_frames"], &last["lost"]), (&60.into(), &0.into()), "{last}");
}

/// An slcan adapter behind TCP: what replay sends to one, record hears from another.
#[test]
fn frames_go_over_slcan() {
    let place = Place::new();
    let source = place.file("a.log", log(12, &[]));
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = format!("slcan:{}", listener.local_addr().unwrap());
    let adapter = thread::spawn(move || {
        let mut received = String::new();
        listener.accept().unwrap().0.read_to_string(&mut received).unwrap();
        let lines = received.strip_prefix("C\rS8\rY5\rO\r").unwrap().strip_suffix("C\r").unwrap().to_owned();
        let (mut second, _) = listener.accept().unwrap();
        // Answers and classic traffic between the frames.
        second.write_all(format!("\r\x07T0478382A10F\r{lines}").as_bytes()).unwrap();
        // Closed with commands unread it would reset the connection.
        second.shutdown(std::net::Shutdown::Write).unwrap();
        second.read_to_string(&mut String::new()).unwrap();
    });
    place.run(&format!("replay @a.log {address} --speed max --data-mbit 5"));
    let result = place.json(&format!("record {address} @r.log"));
    adapter.join().unwrap();
    let count = &result["nodes"]["42"];
    assert_eq!((&count["slip"], &count["raw"]), (&12.into(), &12.into()), "{result}");
    let frames = |path: &Path| -> Vec<_> {
        read(path, Format::Candump).unwrap().entries.iter().map(|entry| entry.frame).collect()
    };
    assert!(frames(&place.path("r.log")) == frames(&source));
}

#[test]
fn replay_keeps_times_and_takes_its_time() {
    let place = Place::new();
    let source = log(48, &[]);
    place.file("a.log", &source);
    let began = Instant::now();
    place.run("replay @a.log @out.log");
    assert!(began.elapsed() >= Duration::from_micros(47 * 12_500 / 3), "{:?}", began.elapsed());
    assert_eq!(fs::read(place.path("out.log")).unwrap(), source);
    assert_eq!(place.run("replay @a.log - --speed max").as_bytes(), source);
}

/// Longer than what replay reads ahead.
#[test]
fn a_replayed_log_is_whole_or_not_there() {
    let place = Place::new();
    let mut lines =
        "(0000000001.000000) can0 1BFFFFFF##100\n(0000000001.000000) can1 1BFFFFFF##100\n".repeat(51_000);
    place.file("a.log", &lines);
    place.run("replay @a.log @out.log --speed max");
    place.run("replay @a.log @a.log --speed max");
    for name in ["a.log", "out.log"] {
        assert!(
            fs::read(place.path(name)).unwrap() == lines.as_bytes(),
            "{name}: every frame, by its interface"
        );
    }
    lines += "bad\n";
    place.file("bad.log", lines);
    place.errors([
        ("replay @bad.log @new.log --speed max", "@bad.log: line 102001: "),
        ("replay @bad.log @bad.log --speed max", "@bad.log: line 102001: "),
        ("replay @a.log @new.log --speed 1e-300", "must be 0.001 or more, or max"),
        ("replay @a.log @new.log --speed nan", "must be 0.001 or more, or max"),
    ]);
}

#[test]
fn a_recording_that_was_cut_short_is_said() {
    let place = Place::new();
    place.file("a.log", log(300, &[]));
    place.run("convert @a.log @a.mcap");
    let whole = fs::read(place.path("a.mcap")).unwrap();
    place.file("cut.mcap", &whole[..whole.len() - 20]);
    let cut = "the file was cut short";
    assert!(place.run("record @cut.mcap @b.log").contains(cut));
    assert!(place.json("record @cut.mcap @c.log")["notes"][0].as_str().unwrap().contains(cut));
    assert!(place.run("replay @cut.mcap @d.log --speed max").contains(cut));
    assert_eq!(place.json("record @a.mcap @e.log")["notes"], Value::Array(Vec::new()));
    for line in
        ["monitor @cut.mcap --plain", "replay @cut.mcap - --speed max", "calibrate @cut.mcap --newton 14"]
    {
        let said = String::from_utf8(slipsense(place.words(line)).stderr).unwrap();
        assert!(said.starts_with(&format!("note: {cut}")), "{line}: {said}");
    }
}

/// At which the crate mcap panics: its length and that of what comes before it are more than 2^64.
fn mcap_with_a_record_of_impossible_length() -> Vec<u8> {
    let record = |opcode: u8, data: &[u8]| [&[opcode][..], &(data.len() as u64).to_le_bytes(), data].concat();
    let within = [&[5][..], &(u64::MAX - 4).to_le_bytes()].concat();
    // Two times, length, check, name of the compression, length: the last two not 0.
    let (zero, length) = (0u64.to_le_bytes(), (within.len() as u64).to_le_bytes());
    let chunk = [&zero, &zero, &length, &[0; 8], &length, &within[..]].concat();
    [&b"\x89MCAP0\r\n"[..], &record(1, &[0; 8]), &record(6, &chunk), &[0; 64]].concat()
}

#[test]
fn what_cannot_be_recorded_converted_or_replayed() {
    let place = Place::new();
    place.file("a.log", log(3, &[]));
    place.file("bad.log", "(1.0) can0 wxyzwxyz##1\n");
    place.file("x.txt", "");
    place.file("long.mcap", mcap_with_a_record_of_impossible_length());
    place.errors([
        (
            "convert @long.mcap @y.log",
            "long.mcap: after message 0: record with opcode 05 length exceeds limit",
        ),
        ("convert @a.log @x.wav", "must end in"),
        ("convert @x.txt @out.mcap", "must end in"),
        ("convert @bad.log @out.mcap", "line 1: identifier \"wxyzwxyz\""),
        ("convert @a.log @x.npz", "--xl-lsb-g is missing: g per LSB, 0.000133 for an ADXL380"),
        ("convert @a.log @x.npz --xl-lsb-g 1 --node-id 7", "node 7"),
        ("convert @a.log @x.csv", "no crosshead's displacement"),
        ("record @a.log @x.wav", "must end in .mcap or .log"),
        ("record socketcan:none0 @out.mcap", "socketcan:none0: "),
        ("record slcan:/dev/none @out.mcap", "/dev/none: cannot open"),
        ("record @bad.log @y.log @out.mcap", "stopped after 0 frames … @bad.log: line 1: identifier"),
        ("monitor @bad.log --plain", "@bad.log: line 1: identifier"),
        ("replay @x.txt -", "must end in"),
        ("monitor a.log", "--plain"),
        ("dbc --node-id 128", "--node-id"),
    ]);
}

#[test]
fn descriptions_for_other_programs() {
    let place = Place::new();
    place.run("dbc --node-id 43 --out @slip.dbc");
    let dbc = fs::read_to_string(place.path("slip.dbc")).unwrap();
    assert!(dbc.contains("BO_ 2222471979 Slip: 64 SlipSense43"), "{dbc}");
    assert!(dbc.contains("BA_ \"GenMsgCycleTime\" BO_ 2222471979 4.167;"), "{dbc}");
    assert!(dbc.contains("at most 12.5 ms old"), "{dbc}");
    assert!(dbc.contains(" SG_ slip : 90|1@1+ (1,0) [0|1] \"\" Vector__XXX"), "{dbc}");
    assert!(place.run("c-header").contains("static inline int slipsense_slip_decode("));
}
