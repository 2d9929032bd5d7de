//! What a user can get wrong: exit code 2, one line that names the thing, nothing left behind.

use std::fs;
use std::net::TcpListener;
use std::path::Path;

use slipsense::params::TAXEL_COLS;
use slipsense_recording::Episode;

use crate::support::{Arrays, Place, assert_says, model, model_bytes, names};

/// Run an episode that must be refused, by its name.
fn refused(place: &Place, episode: &str) -> String {
    let before = place.names();
    let error = place.error(&format!("run @{episode} --out @deep/out --model @m.slipnet"));
    assert_eq!(place.names(), before, "no output");
    assert!(error.contains(&place.path(episode).display().to_string()), "names the file: {error}");
    error
}

#[test]
fn every_rule_of_the_episode_format() {
    type Break = fn(&mut Arrays);
    let cases: [(Break, &str); 16] = [
        (|a| a.has_piezo = false, "array `piezo` is missing"),
        (|a| a.piezo[16 * TAXEL_COLS + 16] = 4096, "`piezo`[0, 0, 16, 16] is 4096: must be at most 4095"),
        (|a| a.piezo[0] = 1, "`piezo`[0, 0, 0, 0] is 1: must be 0, there is no taxel"),
        (|a| a.xl_end[10] = 1, "`xl_end`[5, 0] is 1: must not decrease"),
        (|a| a.xl_end[79] = 9999, "`xl_end`[39, 1] is 9999: must be at most N = 1360"),
        (|a| a.label[7] = 3, "`label`[7] is 3: must be 0, 1 or 2"),
        (|a| a.label.truncate(39), "array `label`"),
        (|a| a.slip_true[3] = f32::NAN, "`slip_true`[3] is NaN"),
        (|a| a.slip_true[3] = -1.0, "`slip_true`[3] is -1"),
        (|a| a.slip_true.truncate(1), "array `slip_true`"),
        (|a| a.meta = "{".into(), "array `meta`: must be UTF-8 JSON"),
        (|a| a.meta = a.meta.replace("xl_lsb_g", "lsb"), "`meta` key `xl_lsb_g` is missing"),
        (|a| a.meta = a.meta.replace("240", "100"), "`meta` key `frame_rate_hz` is 100: must be 240"),
        (|a| a.meta = a.meta.replace("8000", "4000"), "`meta` key `xl_rate_hz` is 4000"),
        (|a| a.meta = a.meta.replace("0.000488", "0"), "`meta` key `xl_lsb_g` is 0: must be positive"),
        // The same numbers read as four sensors of half the frames.
        (
            |a| {
                (a.frames, a.sensors, a.xl) = (20, 4, vec![0; 4 * 1000 * 3]);
                a.label.clear();
                a.slip_true.truncate(20);
            },
            "S from 1 to 3",
        ),
    ];
    let place = Place::with_files();
    for (break_it, rule) in cases {
        let mut arrays = Arrays::valid();
        break_it(&mut arrays);
        arrays.write(&place.path("e.npz"));
        assert_says(&refused(&place, "e.npz"), &[rule]);
    }
}

#[test]
fn damaged_and_missing_episodes() {
    let place = Place::with_files();
    let whole = fs::read(place.path("e.npz")).unwrap();
    for length in [0, 1, 100, whole.len() / 2, whole.len() - 1] {
        place.file("cut.npz", &whole[..length]);
        refused(&place, "cut.npz");
    }
    place.file("cut.npz", "frame,pressure\n");
    assert!(refused(&place, "cut.npz").contains("not an .npz"));
    assert!(refused(&place, "none.npz").contains("No such file"));
    fs::create_dir(place.path("folder")).unwrap();
    assert!(refused(&place, "folder").contains("is a folder"));
    place.errors([
        ("features @cut.npz --out @f.npz", "@cut.npz"),
        ("features @cut.npz --out @folder", "is a folder"),
        ("view @cut.npz", "cut.npz"),
    ]);
}

#[test]
fn models_that_cannot_be_used() {
    let place = Place::with_files();
    let whole = model_bytes();
    let (mut version, mut flipped, mut overflowing) = (whole.clone(), whole.clone(), model());
    (version[8], flipped[100]) = (9, whole[100] ^ 1);
    overflowing.tensor_mut("head", "bias")[2] = i32::MAX;
    for (content, rule) in [
        (version, "model format version 9 is unknown"),
        (overflowing.to_bytes().unwrap(), "head channel 2: accumulator can reach"),
        (Vec::new(), "not a SlipSense model file"),
        (b"not a model at all".to_vec(), "not a SlipSense model file"),
        (whole[..whole.len() / 2].to_vec(), "file ends inside"),
        (flipped, "damaged"),
    ] {
        place.file("b.slipnet", content);
        let commands = [
            "run @e.npz --out @out --model @b.slipnet",
            "model info @b.slipnet",
            "eval-rotation --model @b.slipnet",
            "tune @b.slipnet --out @t.slipnet",
        ];
        place.errors(commands.map(|line| (line, rule)));
        place.errors(commands.map(|line| (line, "@b.slipnet")));
    }
    let missing = "@none.slipnet: cannot read the model";
    place.errors([
        ("run @e.npz --out @out --model @none.slipnet", missing),
        ("model info @none.slipnet", missing),
        ("grasp --model @none.slipnet", missing),
        ("eval-rotation --model @none.slipnet", missing),
        ("tune @none.slipnet --out @t.slipnet", missing),
        ("view - --model @none.slipnet", missing),
        ("tune @m.slipnet --out @t.slipnet --hours 0", "--hours is 0, must be 1/60 to 100"),
        ("tune @m.slipnet --out @t --per-hour -1", "--per-hour is -1, must be 0 or more"),
    ]);
}

/// Root may write into any folder, so permissions would prove nothing; these fail for everyone.
#[test]
fn folders_that_cannot_be_written() {
    let place = Place::with_files();
    let file = place.file("file", "mine");
    let mut targets = ["@file", "@file/out", "@file/a/b"].map(|name| place.words(name).concat()).to_vec();
    if Path::new("/proc/self").is_dir() {
        targets.push("/proc/slipsense/out".into());
    }
    for target in targets {
        for command in ["run @e.npz", "demo", "synth --split val --frames 1", "grasp --trials 1"] {
            place.errors([(format!("{command} --out {target}"), format!("{target}: "))]);
        }
        if target != file.display().to_string() {
            place.errors([(format!("features @e.npz --out {target}"), "cannot write")]);
        }
    }
    assert_eq!(fs::read(&file).unwrap(), b"mine");
}

#[test]
fn a_failed_run_leaves_an_existing_folder_as_it_was() {
    let place = Place::new();
    let out = place.path("out");
    fs::create_dir(&out).unwrap();
    fs::write(out.join("summary.json"), "old").unwrap();
    place.file("bad.npz", "no");
    place.errors([("run @bad.npz --out @out", "@bad.npz")]);
    assert_eq!(names(&out), ["summary.json"]);
    assert_eq!(fs::read(out.join("summary.json")).unwrap(), b"old");
}

/// The recipe of the command's help that brings its own object, with one thing changed.
fn own(from: &str, to: &str) -> String {
    let help = Place::new().run("synth --help");
    let recipe = &help[help.find("{\"seed\": 7, \"grip_n\"").unwrap()..];
    let recipe = &recipe[..recipe.find("}}}").unwrap() + 3];
    assert!(recipe.contains(from), "{from} is in {recipe}");
    recipe.replacen(from, to, 1)
}

#[test]
fn the_recipe_of_the_help_is_generated() {
    let place = Place::new();
    place.file("r.json", own("\"seed\": 7", "\"seed\": 8, \"seconds\": 2.5"));
    place.run("synth --recipe @r.json --out @e.npz");
    let meta = Episode::read(place.path("e.npz")).unwrap().meta.other;
    assert_eq!((&meta["object"], &meta["object_kind"]), (&"my-rod".into(), &"tool".into()));
    assert_eq!((&meta["grip_n"], &meta["held_out"]), (&2.5.into(), &false.into()));
}

#[test]
fn recipes_that_cannot_be_generated() {
    let place = Place::new();
    for (text, rule) in [
        (r#"{"seed": 1, "sensors": 4}"#, "sensors is 4"),
        (r#"{"seed": 1, "platform": "umi", "sensors": 3}"#, "sensors is 3, but platform umi has at most 2"),
        (r#"{"seed": 1, "grip_n": -2}"#, "grip_n is -2, must be 0.3 to 12"),
        (r#"{"seed": 1, "grip_n": 50}"#, "grip_n is 50, must be 0.3 to 12"),
        (r#"{"seed": 1, "grip_n": NaN}"#, "not a recipe"),
        (r#"{"seed": 1, "object": {"named": "unobtainium"}}"#, "unobtainium"),
        (r#"{"seed": 1, "object": {"own": {"name": "my-rod"}}}"#, "missing field `kind`"),
        (
            &own("\"radius_mm\": 4", "\"radius_mm\": 14"),
            "\"my-rod\": shape (width across its axis) is 28, must be",
        ),
        (&own("\"mu_kinetic\": 0.43", "\"mu_kinetic\": 0.6"), "mu_kinetic is 0.6, must be at most mu_static"),
        (&own("\"roughness_um\": 0.8", "\"roughness_um\": -0.8"), "roughness_um is -0.8, must be"),
        (&own("\"mass_g\"", "\"weight_g\""), "unknown field `weight_g`"),
        (r#"{"seed": 1, "colour": "red"}"#, "unknown field `colour`"),
        (r#"{"sensors": 1}"#, "seed"),
        ("{", "not a recipe"),
    ] {
        place.file("r.json", text);
        let command = "synth --recipe @r.json --out @e.npz";
        place.errors([(command, rule), (command, "@r.json")]);
    }
}

#[test]
#[cfg(not(feature = "train"))]
fn the_trainer_is_in_another_build() {
    let command = |name: &str| {
        let line = format!("{name} --epochs 3");
        (line.clone(), format!("cargo run --release --features train -- {line}"))
    };
    let names = ["train", "quantize", "reproduce", "leave-out", "model compare e.npz", "model mean a b"];
    Place::new().errors(names.map(command));
}

#[test]
fn a_page_of_nothing_is_not_served() {
    let taken = TcpListener::bind("127.0.0.1:0").unwrap();
    let port = taken.local_addr().unwrap().port();
    let place = Place::with_files();
    place.errors([
        ("view @none.log", "none.log: cannot read the log"),
        ("view - --model @m.slipnet", "--model: a log holds the module's own decisions"),
    ]);
    place.errors([(format!("view --port {port}"), format!("port {port}: cannot listen on it"))]);
}
