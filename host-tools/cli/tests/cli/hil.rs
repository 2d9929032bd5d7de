//! `slipsense hil` against a board that is a thread behind a GDB server, and against boards with something wrong. The
//! program of a real board is at the other end in `cargo xtask test --only hil`.

use std::process::Output;

use slipsense::board::mailbox::{SYMBOL, VERSION};
use slipsense::fixed::Logit;
use slipsense_recording::model_file::ModelFile;

use crate::fake_board::{CORE_HZ, CYCLES, Fault, MAILBOX_AT, elf, serve};
use crate::support::{Place, assert_says, model, slipsense};

/// Frames of the episode that each run replays.
const FRAMES: u32 = 12;

fn place() -> Place {
    let place = Place::with_files();
    place.file("hil", elf(SYMBOL, MAILBOX_AT));
    place
}

fn command(board_model: &ModelFile, fault: Fault, more: &str) -> String {
    let port = serve(board_model.to_bytes().unwrap(), fault);
    format!("hil @e.npz --elf @hil --model @m.slipnet --gdb 127.0.0.1:{port} --frames {FRAMES} {more}")
}

fn run(fault: Fault) -> Output {
    let place = place();
    slipsense(place.words(&command(&model(), fault, "--json")))
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
    let place = place();
    let output = slipsense(place.words(&command(&model(), Fault::FlipsBit(1), "")));
    assert_eq!(output.status.code(), Some(1));
    let text = String::from_utf8(output.stdout).unwrap();
    assert!(text.starts_with("frame 0, CAN frame 1: board "), "{text}");
    let cycles = "1012 cycles at most, in frame 11: 2.1 us at 480000000 Hz";
    assert_says(&text, &["11 of 12 frames equal, 1 differ", cycles]);
}

#[test]
fn boards_with_something_wrong() {
    let place = place();
    let version = format!("speaks version 99 of the mailbox, this is {VERSION}");
    let cases = [
        (Fault::OtherProgram, "does not come up for 1 s"),
        (Fault::Version, &version),
        (Fault::Stops(3), "frame 2: the board does not answer for 1 s"),
        (Fault::GivesUp(2), "frame 1: the board's program gives up: no bananas left"),
        (Fault::TooLong, "frame 0: the board's answer is longer"),
        (Fault::NoReset, "the server refuses `monitor reset halt`"),
    ];
    place.errors(cases.map(|(fault, rule)| (command(&model(), fault, "--timeout-s 1"), rule)));
    let mut other = model();
    other.point.threshold = Logit::from_bits(other.point.threshold.to_bits() + 1);
    place.errors([(command(&other, Fault::None, ""), "the board has the model")]);
}

#[test]
fn what_a_user_can_get_wrong() {
    let place = place();
    place.file("other", elf("main", 4));
    place.file("text", "not a program");
    // No computer has a probe of this name.
    let probe = if cfg!(feature = "hil") {
        "--probe=0483:ffff: no such debug probe is there: is the board's ST-LINK connector (CN1) on USB"
    } else {
        "--probe=0483:ffff: this build has no drivers of debug probes: `cargo run --release --features hil -- hil"
    };
    let cases = [
        ("--elf @other --gdb 127.0.0.1:1", "other: has no SLIPSENSE_MAILBOX"),
        ("--elf @text --gdb 127.0.0.1:1", "text: not an ELF file"),
        ("--elf @absent --gdb 127.0.0.1:1", "absent: cannot read the program"),
        // Port 1 of this computer is nobody's.
        ("--elf @hil --gdb 127.0.0.1:1", "nothing serves a debugger there"),
        ("--elf @hil --gdb nonsense", "--gdb nonsense: not HOST:PORT"),
        // One way to the board, and no other beside it.
        ("--elf @hil", "--probe"),
        ("--elf @hil --gdb nonsense --probe", "cannot be used with"),
        ("--elf @hil --probe=0483:ffff", probe),
    ];
    place.errors(cases.map(|(options, rule)| (format!("hil @e.npz {options}"), rule)));
}
