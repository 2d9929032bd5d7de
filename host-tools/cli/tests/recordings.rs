//! Recording, converting, replaying, watching: through the binary.

mod support;

use std::fs;
use std::io::{Read, Write};
use std::net::TcpListener;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::thread;
use std::time::{Duration, Instant};

use serde_json::Value;
use slipsense::sensor::{PiezoFrame, SensorInput};
use slipsense::wire::{NodeId, RawBuffer, RawFrame, SlipMessage, Transmitter};
use slipsense_recording::Episode;
use slipsense_recording::candump::CandumpWriter;
use slipsense_recording::log_file::{Format, read};
use support::{Arrays, Place, fails, slipsense, succeeds};

/// A log of one sensor; the frames numbered in `lost` are not in it.
fn log(frames: u32, lost: &[u32]) -> Vec<u8> {
    let mut transmitter = Transmitter::new(NodeId::DEFAULT);
    let mut log = CandumpWriter::new(Vec::new(), "can0").unwrap();
    let (piezo, xl) = (PiezoFrame::from_scan([7; 1024]), [[1, -2, 3]; 33]);
    for sequence in 0..frames {
        let at_us = 1_700_000_000_000_000 + u64::from(sequence) * 12_500 / 3;
        let message = SlipMessage { sequence, sensors: 1, alarm: sequence >= 240, ..SlipMessage::default() };
        let input = SensorInput { piezo: Some(&piezo), xl: Some(&xl), xl_end: 33 * (sequence + 1) };
        let raw = RawFrame { timestamp_us: at_us, sequence, sensor: 0, health: 0, input };
        let mut sent = vec![transmitter.slip(&message)];
        sent.extend(transmitter.raw(&raw, &mut RawBuffer::new()));
        if !lost.contains(&sequence) {
            sent.iter().for_each(|frame| log.write(at_us, frame).unwrap());
        }
    }
    log.finish().unwrap()
}

fn args<const N: usize>(command: &str, paths: [&Path; N], more: &[&str]) -> Vec<String> {
    let paths = paths.iter().map(|path| path.display().to_string());
    [command.to_owned()].into_iter().chain(paths).chain(more.iter().map(|&more| more.to_owned())).collect()
}

#[test]
fn a_recording_goes_through_every_format_and_back() {
    let place = Place::new();
    let first = place.file("a.log", log(24, &[]));
    let mut last = first.clone();
    for name in ["b.mcap", "e.log"] {
        let next = place.path(name);
        succeeds(args("convert", [&last, &next], &[]));
        last = next;
    }
    assert_eq!(fs::read(&last).unwrap(), fs::read(&first).unwrap(), "byte for byte");
    let episode = place.path("f.npz");
    let said: Value = serde_json::from_str(&succeeds(args(
        "convert",
        [&last, &episode],
        &["--xl-lsb-g", "0.0005", "--json"],
    )))
    .unwrap();
    assert_eq!(said["wrote"], "24 frames of 1 sensor");
    assert!(said["left_out"][0].as_str().unwrap().contains("slipsense run"), "{said}");
    let episode = Episode::read(episode).unwrap();
    assert_eq!((episode.frames(), episode.xl_end(23, 0), episode.meta.xl_lsb_g), (24, 24 * 33, 0.0005));
}

#[test]
fn an_episode_to_the_bus_and_back() {
    let place = Place::new();
    let episode = place.path("e.npz");
    Arrays::valid().write(&episode);
    let (log, back) = (place.path("e.log"), place.path("back.npz"));
    let said = succeeds(args("convert", [&episode, &log], &[]));
    assert!(said.contains("left out: what meta says of units and origin, labels, true slip speed"), "{said}");
    succeeds(args("convert", [&log, &back], &["--xl-lsb-g", "0.000488"]));
    let (before, after) = (Episode::read(&episode).unwrap(), Episode::read(&back).unwrap());
    assert!(before.piezo == after.piezo);
    assert_eq!((before.xl_end.clone(), before.frames()), (after.xl_end.clone(), after.frames()));
    for (before, after) in before.xl.iter().zip(&after.xl) {
        assert_eq!(&before[..after.len()], after, "samples after the last frame are not on the bus");
    }
}

#[test]
fn a_crosshead_comes_along() {
    let place = Place::new();
    let stand = place.file("stand.csv", "Load [N],Travel [mm],Time [sec]\n0.1,0.5,0\n0.2,0.75,0.1\n");
    let (mcap, back) = (place.path("stand.mcap"), place.path("back.csv"));
    assert!(succeeds(args("convert", [&stand, &mcap], &[])).contains("the load is left out"));
    succeeds(args("convert", [&mcap, &back], &[]));
    assert_eq!(fs::read_to_string(&back).unwrap(), "Time [s],Travel [mm]\n0.000000,0.5\n0.100000,0.75\n");
    assert!(fails(args("convert", [&stand, &place.path("x.log")], &[])).contains("no CAN frame in it"));
}

#[test]
fn losses_are_counted() {
    let place = Place::new();
    let source = place.file("a.log", log(300, &[10, 11, 12, 100]));
    let out = place.path("r.mcap");
    let said: Value = serde_json::from_str(&succeeds(args("record", [&source, &out], &["--json"]))).unwrap();
    let count = &said["nodes"]["42"];
    assert_eq!((&count["slip"], &count["slip_lost"]), (&296.into(), &4.into()), "{said}");
    assert_eq!((&count["raw"], &count["raw_lost"]), (&296.into(), &4.into()), "{said}");
    assert!(
        fails(args("record", [&source, &out], &[])).contains("cannot make a new file"),
        "nothing is overwritten"
    );

    let lines = succeeds(args("monitor", [&source], &["--plain"]));
    assert_eq!(lines.lines().count(), 2, "{lines}");
    assert!(
        lines.lines().next().unwrap().contains("236 slip") && lines.contains("lost 8"),
        "slip and raw: {lines}"
    );
    let last: Value =
        succeeds(args("monitor", [&out], &["--plain", "--json"])).lines().last().unwrap().parse().unwrap();
    assert_eq!((&last["alarm_frames"], &last["lost"]), (&60.into(), &0.into()), "{last}");
}

fn spawn(args: &[String]) -> Child {
    let mut command = Command::new(env!("CARGO_BIN_EXE_slipsense"));
    command.args(args).stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped());
    command.spawn().unwrap()
}

/// Until `done`, at most a minute.
fn wait(what: &str, mut done: impl FnMut() -> bool) {
    let began = Instant::now();
    while !done() {
        assert!(began.elapsed() < Duration::from_secs(60), "{what}");
        thread::sleep(Duration::from_millis(20));
    }
}

/// SIGKILL in the middle: what was written out can be read.
#[test]
#[cfg(unix)]
fn a_killed_recorder_leaves_readable_files() {
    use std::os::unix::process::ExitStatusExt;
    let place = Place::new();
    let (mcap, candump) = (place.path("r.mcap"), place.path("r.log"));
    let mut child = spawn(&args("record", [Path::new("-"), &mcap, &candump], &[]));
    let log = log(480, &[]);
    let mut input = child.stdin.take().unwrap();
    // The pipe stays open, so that nothing ends by itself.
    input.write_all(&log[..log.len() / 2]).unwrap();
    let size = |path: &PathBuf| fs::metadata(path).map_or(0, |data| data.len());
    wait("the second of a flush", || size(&candump) > 0 && size(&mcap) > 1000);
    let seen = size(&candump);
    input.write_all(&log[log.len() / 2..]).unwrap();
    wait("the next flush", || size(&candump) > seen);
    child.kill().unwrap();
    assert_eq!(child.wait().unwrap().signal(), Some(9));
    drop(input);
    for (path, format) in [(&mcap, Format::Mcap), (&candump, Format::Candump)] {
        let found = read(path, format).unwrap();
        assert!(found.entries.len() > 1000, "{format:?}: {} frames", found.entries.len());
        assert_eq!(found.entries[0].timestamp_us, 1_700_000_000_000_000);
        println!("{format:?}: {} of 12960 frames after SIGKILL, {:?}", found.entries.len(), found.notes);
    }
    assert!(succeeds(args("convert", [&mcap, &place.path("x.log")], &[])).contains("cut short"));
}

/// An slcan adapter behind TCP: what replay sends to one, record hears from another.
#[test]
fn frames_go_over_slcan() {
    let place = Place::new();
    let source = place.file("a.log", log(12, &[]));
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = format!("slcan:{}", listener.local_addr().unwrap());
    let adapter = thread::spawn(move || {
        let mut said = String::new();
        listener.accept().unwrap().0.read_to_string(&mut said).unwrap();
        let lines = said.strip_prefix("C\rS8\rY5\rO\r").unwrap().strip_suffix("C\r").unwrap().to_owned();
        let (mut second, _) = listener.accept().unwrap();
        // Answers and classic traffic between the frames.
        second.write_all(format!("\r\x07T0478382A10F\r{lines}").as_bytes()).unwrap();
        // Closed with commands unread it would reset the connection.
        second.shutdown(std::net::Shutdown::Write).unwrap();
        second.read_to_string(&mut String::new()).unwrap();
    });
    let more = [address.as_str(), "--speed", "max", "--data-mbit", "5"];
    succeeds(args("replay", [&source], &more));
    let out = place.path("r.log");
    let recorded = args("record", [Path::new(&address), &out], &["--json"]);
    let said: Value = serde_json::from_str(&succeeds(recorded)).unwrap();
    adapter.join().unwrap();
    assert_eq!(
        (&said["nodes"]["42"]["slip"], &said["nodes"]["42"]["raw"]),
        (&12.into(), &12.into()),
        "{said}"
    );
    let frames = |path: &Path| -> Vec<_> {
        read(path, Format::Candump).unwrap().entries.iter().map(|entry| entry.frame).collect()
    };
    assert!(frames(&out) == frames(&source));
}

#[test]
fn replay_keeps_times_and_takes_its_time() {
    let place = Place::new();
    let source = place.file("a.log", log(48, &[]));
    let out = place.path("out.log");
    let began = Instant::now();
    succeeds(args("replay", [&source, &out], &[]));
    assert!(began.elapsed() >= Duration::from_micros(47 * 12_500 / 3), "{:?}", began.elapsed());
    assert_eq!(fs::read(&out).unwrap(), fs::read(&source).unwrap());
    assert_eq!(
        succeeds(args("replay", [&source], &["-", "--speed", "max"])).as_bytes(),
        fs::read(&source).unwrap()
    );
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
    let good = place.file("a.log", log(3, &[]));
    let bad = place.file("bad.log", "(1.0) can0 wxyzwxyz##1\n");
    let text = place.file("x.txt", "");
    let long = place.file("long.mcap", mcap_with_a_record_of_impossible_length());
    let out = place.path("out.mcap");
    let cases: [(Vec<String>, &str); 12] = [
        (
            args("convert", [&long, &place.path("y.log")], &[]),
            "long.mcap: after message 0: a record of imposs",
        ),
        (args("convert", [&good, &place.path("x.wav")], &[]), "must end in"),
        (args("convert", [&text, &out], &[]), "must end in"),
        (args("convert", [&bad, &out], &[]), "line 1: identifier \"wxyzwxyz\""),
        (args("convert", [&good, &place.path("x.npz")], &[]), "--xl-lsb-g is missing"),
        (args("convert", [&good, &place.path("x.npz")], &["--xl-lsb-g", "1", "--node-id", "7"]), "node 7"),
        (args("convert", [&good, &place.path("x.csv")], &[]), "no crosshead's displacement"),
        (args("record", [&good, &place.path("x.txt")], &[]), "must end in .mcap or .log"),
        (args("record", [Path::new("socketcan:none0"), &out], &[]), "socketcan:none0: "),
        (args("record", [Path::new("slcan:/dev/none"), &out], &[]), "/dev/none: cannot open"),
        (args("record", [&bad, &place.path("y.log"), &out], &[]), "stopped after 0 frames"),
        (args("replay", [&text], &["-"]), "must end in"),
    ];
    for (command, rule) in cases {
        let error = fails(&command);
        assert!(error.contains(rule), "{command:?}: {error}");
    }
    assert!(fails(["monitor", "a.log"]).contains("--plain"));
    assert_eq!(place.names(), ["a.log", "bad.log", "long.mcap", "x.txt"], "nothing is left behind");
}

#[test]
fn descriptions_for_other_programs() {
    let place = Place::new();
    let file = place.path("slip.dbc");
    succeeds(args("dbc", [], &["--node-id", "43", "--out", file.to_str().unwrap()]));
    let dbc = fs::read_to_string(file).unwrap();
    assert!(dbc.contains("BO_ 2222471211 Slip: 64 SlipSense43"), "{dbc}");
    assert!(dbc.contains(" SG_ alarm : 93|1@1+ (1,0) [0|1] \"\" Vector__XXX"), "{dbc}");
    assert!(succeeds(["c-header"]).contains("static inline int slipsense_slip_decode("));
    assert_eq!(slipsense(["dbc", "--node-id", "128"]).status.code(), Some(2));
}
