//! `slipsense calibrate` against the library's node behind a socket that speaks slcan.

use std::io::{BufRead, BufReader, Write};
use std::net::TcpListener;
use std::sync::mpsc::{self, RecvTimeoutError};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use slipsense::calibration::{Progress, Request, State, Summary, What};
use slipsense::node::{Action, Identity, Node, Version};
use slipsense::params::TAXELS;
use slipsense::sensor::{PiezoFrame, SensorInput, is_active};
use slipsense::settings::{Damage, LoadReport, Origin, Settings};
use slipsense::wire::{CanFrame, Detail, NodeId, RawBuffer, RawForm, RawFrame, Transmitter};
use slipsense_recording::candump::CandumpWriter;
use slipsense_recording::slcan;

use super::support::Place;

/// Raw frames of a pad that is pressed everywhere: 20 counts, some 2.3 kPa.
fn press(form: RawForm, number: u32, transmitter: &mut Transmitter) -> Vec<CanFrame> {
    let counts = std::array::from_fn::<u16, TAXELS, _>(|i| if is_active(i / 32, i % 32) { 20 } else { 0 });
    let piezo = PiezoFrame::from_counts(counts).unwrap();
    let input = SensorInput { piezo: Some(&piezo), xl: Some(&[]), xl_end: 0 };
    let raw = RawFrame { timestamp_us: 0, sequence: number, sensor: 0, health: 0, input };
    let mut buffer = RawBuffer::new();
    transmitter.raw_as(form, &raw, &mut buffer).collect()
}

/// A node with one sensor, whose measurements end so; what it was asked for.
fn serve(end: State) -> (String, JoinHandle<Vec<Request>>) {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = format!("slcan:{}", listener.local_addr().unwrap());
    let run = move || {
        let mut stream = listener.accept().unwrap().0;
        let (heard, lines) = mpsc::channel();
        let mut input = BufReader::new(stream.try_clone().unwrap()).split(b'\r').map_while(Result::ok);
        thread::spawn(move || input.try_for_each(|line| heard.send(line)));
        let identity = Identity {
            hardware_version: Version { major: 1, minor: 0 },
            software_version: Version::SOFTWARE,
            vcs_revision: 0,
            unique_id: [7; 16],
            model_hash: None,
            settings: LoadReport { origin: Origin::Blank, damage: Damage::default() },
            entropy: None,
        };
        let mut node = Node::new(identity, Settings::new());
        let (mut asked, began) = (Vec::new(), Instant::now());
        let (mut transmitter, mut number) = (Transmitter::new(NodeId::DEFAULT), 0);
        let mut measured: Option<Instant> = None;
        loop {
            let line = lines.recv_timeout(Duration::from_millis(5));
            let now_us = began.elapsed().as_micros() as u64;
            match line.as_deref().map(slcan::parse) {
                Ok(Some(Ok(frame))) => node.accept(&frame, now_us),
                Err(RecvTimeoutError::Disconnected) => return asked,
                _ => {}
            }
            while let Some(action) = node.take_action() {
                let Action::Calibrate(request) = action else { panic!("{action:?}") };
                let known = request.sensor == 0;
                node.command_done(if known { Ok(()) } else { Err("no such sensor") });
                if known {
                    asked.push(request);
                    measured = Some(Instant::now());
                    node.status.measurement = Progress { state: State::Measuring, ..Progress::default() };
                }
            }
            if measured.is_some_and(|at| at.elapsed() > Duration::from_millis(700)) {
                let at = if end == State::Touched { (12, 3) } else { (0, 0) };
                node.status.measurement = Progress { state: end, at, ..Progress::default() };
                node.status.calibrations[0] = Summary { version: 3, id: 0x1a2b_3c4d, faulty: 2, noise: 28 };
            }
            node.poll(now_us);
            let mut frames: Vec<CanFrame> = press(RawForm::Plain, number, &mut transmitter);
            number += 1;
            frames.extend(std::iter::from_fn(|| node.next_frame()));
            let sent: String = frames.iter().map(slcan::command).collect();
            if stream.write_all(sent.as_bytes()).is_err() {
                return asked;
            }
        }
    };
    (address, thread::spawn(run))
}

#[test]
fn a_module_measures_and_says_what_it_found() {
    let place = Place::new();
    let (address, node) = serve(State::Done);
    let result = place.json(&format!("calibrate {address} --seconds 1"));
    assert_eq!(node.join().unwrap(), [Request { sensor: 0, what: What::Measure(1) }]);
    let found = &result["calibration"];
    assert_eq!((&found["version"], &found["id"]), (&3.into(), &"1a2b3c4d".into()), "{result}");
    assert_eq!((&found["faulty"], &found["noise_codes"]), (&2.into(), &3.5.into()), "{result}");

    let (address, node) = serve(State::Done);
    assert!(place.run(&format!("calibrate {address} --forget")).contains("calibration 3 1a2b3c4d"));
    assert_eq!(node.join().unwrap(), [Request { sensor: 0, what: What::Forget }]);
}

#[test]
fn a_known_weight_gives_a_factor() {
    let place = Place::new();
    let (address, node) = serve(State::Done);
    let result = place.json(&format!("calibrate {address} --newton 1.5 --seconds 1"));
    // By hand: 20 of 4940.5 counts are 900 kPa · (20/4920.5)^(1/0.92) = 2.267 kPa on 942 · 0.644 mm².
    let (force, factor) = (2.2666 * 942.0 * 0.644 / 1e3, (1.5_f64 / 1.3750).powf(0.92));
    let number = |name: &str| result["gain"][name].as_f64().unwrap();
    assert!((number("newton_before") - force).abs() < 0.002, "{result}, {force}");
    assert!((number("factor") - factor).abs() < 0.002, "{result}, {factor}");
    let scale = (number("factor") * 2048.0).round() as u16;
    assert_eq!(node.join().unwrap(), [Request { sensor: 0, what: What::Scale(scale) }]);
}

/// On a full bus some frames lack the taxels.
#[test]
fn a_press_is_of_whole_scans() {
    let place = Place::new();
    for (name, frames) in [("a.log", 478), ("b.log", 480)] {
        let mut log = CandumpWriter::new(Vec::new(), "can0").unwrap();
        let mut transmitter = Transmitter::new(NodeId::DEFAULT);
        for number in 0..frames {
            let detail = if number % 2 == 0 { Detail::All } else { Detail::Accelerometer };
            let frames = press(RawForm::Compressed(detail), number, &mut transmitter);
            frames.iter().for_each(|frame| log.write(number.into(), frame).unwrap());
        }
        place.file(name, log.finish().unwrap());
    }
    place.errors([(
        "calibrate @a.log --newton 1.5",
        "239 raw frames of this sensor with all taxels, need 240",
    )]);
    let found = place.json("calibrate @b.log --newton 1.5")["gain"]["newton_before"].as_f64().unwrap();
    assert!((found - 1.375).abs() < 0.002, "{found}");
}

#[test]
fn what_cannot_be_is_refused() {
    let place = Place::with_files();
    let ((touched, _), (well, _)) = (serve(State::Touched), serve(State::Done));
    place.errors([
        (format!("calibrate {touched} --seconds 1"), "sensor 0, row 12, column 3 of the scan: touched"),
        (format!("calibrate {well} --sensor 1"), "node 42 refuses: no such sensor"),
        ("calibrate @a.log".to_owned(), "offset and noise need ADC codes, a recording holds counts"),
        ("calibrate @a.log --newton=-1".to_owned(), "must be positive"),
    ]);
}
