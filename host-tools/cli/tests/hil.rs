//! `slipsense hil` against a board that is a thread behind a GDB server, and against boards with something wrong. The
//! program of a real board is at the other end in `cargo xtask test --only hil`.

#[path = "support/fake_board.rs"]
mod fake_board;
mod support;

use std::process::Output;

use fake_board::{CORE_HZ, CYCLES, Fault, MAILBOX_AT, elf, serve};
use slipsense::board::mailbox::{SYMBOL, VERSION};
use slipsense::fixed::Logit;
use slipsense_recording::model_file::ModelFile;
use support::{Arrays, Place, fails, model, slipsense};

/// Frames of the episode that each run replays.
const FRAMES: u32 = 12;

/// The command's arguments for a board with this fault.
fn arguments(place: &Place, board_model: &ModelFile, fault: Fault, more: &[&str]) -> Vec<String> {
    Arrays::valid().write(&place.path("e.npz"));
    place.file("m.slipnet", model().to_bytes().unwrap());
    place.file("hil", elf(SYMBOL, MAILBOX_AT));
    let port = serve(board_model.to_bytes().unwrap(), fault);
    let path = |name: &str| place.path(name).display().to_string();
    let mut arguments = ["hil".to_owned(), path("e.npz"), "--elf".into(), path("hil")].to_vec();
    arguments.extend(["--model".into(), path("m.slipnet"), "--gdb".into(), format!("127.0.0.1:{port}")]);
    arguments.extend(["--frames".into(), FRAMES.to_string()]);
    arguments.extend(more.iter().map(ToString::to_string));
    arguments
}

fn run(fault: Fault) -> Output {
    let place = Place::new();
    slipsense(arguments(&place, &model(), fault, &["--json"]))
}

fn json(output: &Output) -> serde_json::Value {
    serde_json::from_slice(&output.stdout).expect("JSON")
}

#[test]
fn a_board_that_does_the_same() {
    let output = run(Fault::None);
    assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
    let report = json(&output);
    assert_eq!(report["frames"], FRAMES);
    assert_eq!(report["differing_frames"], 0);
    assert_eq!(report["first"], serde_json::json!([]));
    assert_eq!(report["sensors"], 2);
    // A slip message and at least the taxels of two sensors, 1.5 bytes each.
    assert!(report["can_frames"].as_u64().unwrap() > u64::from(FRAMES) * 2 * 1024 * 3 / 2 / 64);
    assert_eq!(report["worst_step_cycles"], FRAMES + CYCLES);
    assert_eq!(report["worst_step_frame"], FRAMES - 1);
    assert_eq!(report["core_hz"], CORE_HZ);
}

#[test]
fn one_bit_and_one_frame_less() {
    let flipped = run(Fault::FlipsBit(4));
    assert_eq!(flipped.status.code(), Some(1));
    let report = json(&flipped);
    assert_eq!(report["differing_frames"], 1);
    let first = &report["first"][0];
    assert_eq!((&first["frame"], &first["can_frame"]), (&3.into(), &1.into()));
    let (expected, found) = (first["expected"].as_str().unwrap(), first["found"].as_str().unwrap());
    let differing = expected.bytes().zip(found.bytes()).filter(|(a, b)| a != b).count();
    assert_eq!((expected.len(), differing), (found.len(), 1));

    let lost = json(&run(Fault::LosesFrame(FRAMES)));
    assert_eq!(lost["differing_frames"], 1);
    assert_eq!(lost["first"][0]["found"], serde_json::Value::Null);
    assert_eq!(lost["first"][0]["frame"], FRAMES - 1);
}

#[test]
fn in_words() {
    let place = Place::new();
    let output = slipsense(arguments(&place, &model(), Fault::FlipsBit(1), &[]));
    assert_eq!(output.status.code(), Some(1));
    let text = String::from_utf8(output.stdout).unwrap();
    assert!(text.starts_with("frame 0, CAN frame 1: board "), "{text}");
    assert!(text.contains("11 of 12 frames equal, 1 differ"), "{text}");
    assert!(text.contains("1012 cycles at most, in frame 11: 2.1 us at 480000000 Hz"), "{text}");
}

#[test]
fn boards_with_something_wrong() {
    let cases = [
        (Fault::OtherProgram, "does not come up for 1 s".to_owned()),
        (Fault::Version, format!("speaks version 99 of the mailbox, this is {VERSION}")),
        (Fault::Stops(3), "frame 2: the board does not answer for 1 s".to_owned()),
        (Fault::GivesUp(2), "frame 1: the board's program gives up: no bananas left".to_owned()),
        (Fault::TooLong, "frame 0: the board's answer is longer".to_owned()),
        (Fault::NoReset, "the server refuses `monitor reset halt`".to_owned()),
    ];
    for (fault, says) in cases {
        let place = Place::new();
        let error = fails(arguments(&place, &model(), fault, &["--timeout-s", "1"]));
        assert!(error.contains(&says), "{fault:?}: {error}");
    }
    let place = Place::new();
    let mut other = model();
    other.point.threshold = Logit::from_bits(other.point.threshold.to_bits() + 1);
    let error = fails(arguments(&place, &other, Fault::None, &[]));
    assert!(error.contains("the board has the model"), "{error}");
}

#[test]
fn what_a_user_can_get_wrong() {
    let place = Place::new();
    Arrays::valid().write(&place.path("e.npz"));
    place.file("hil", elf(SYMBOL, MAILBOX_AT));
    place.file("other", elf("main", 4));
    place.file("text", "no ELF");
    let path = |name: &str| place.path(name).display().to_string();
    let hil = |elf: &str, more: &[&str]| {
        let mut arguments = ["hil".to_owned(), path("e.npz"), "--elf".into(), path(elf)].to_vec();
        arguments.extend(more.iter().map(ToString::to_string));
        fails(arguments)
    };
    assert!(hil("other", &["--gdb", "127.0.0.1:1"]).contains("other: has no SLIPSENSE_MAILBOX"));
    assert!(hil("text", &["--gdb", "127.0.0.1:1"]).contains("text: no ELF"));
    assert!(hil("absent", &["--gdb", "127.0.0.1:1"]).contains("absent: cannot read the program"));
    // Port 1 of this computer is nobody's.
    assert!(hil("hil", &["--gdb", "127.0.0.1:1"]).contains("nothing serves a debugger there"));
    assert!(hil("hil", &["--gdb", "nonsense"]).contains("--gdb nonsense: no HOST:PORT"));
    // One way to the board, and no other beside it.
    for (ways, says) in [(&[][..], "required"), (&["--gdb", "nonsense", "--probe"], "cannot be used with")] {
        let (episode, program) = (path("e.npz"), path("hil"));
        let arguments = ["hil", &episode, "--elf", &program].into_iter().chain(ways.iter().copied());
        let output = slipsense(arguments);
        let error = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(
            output.status.code() == Some(2) && error.contains(says) && error.contains("--probe"),
            "{error}"
        );
    }
}

/// No computer has a probe of this name.
#[test]
fn no_probe_or_no_drivers_of_probes() {
    let place = Place::new();
    Arrays::valid().write(&place.path("e.npz"));
    place.file("hil", elf(SYMBOL, MAILBOX_AT));
    let path = |name: &str| place.path(name).display().to_string();
    let arguments =
        ["hil".to_owned(), path("e.npz"), "--elf".into(), path("hil"), "--probe=0483:ffff".into()];
    let error = fails(arguments);
    let says = if cfg!(feature = "hil") {
        "--probe=0483:ffff: no such debug probe is there: is the board's ST-LINK connector (CN1) on USB"
    } else {
        "--probe=0483:ffff: this build has no drivers of debug probes: `cargo run --release --features hil -- hil"
    };
    assert!(error.starts_with(says), "{error}");
}
