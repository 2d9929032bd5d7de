//! What a user can get wrong: exit code 2, one line that names the thing, nothing left behind.

use std::fs;
use std::io::{BufRead, BufReader};
use std::net::TcpListener;
use std::path::Path;

use slipsense_recording::Episode;
use slipsense_recording::npz::write_file;

use crate::support::{Place, model, model_bytes, names};

fn run(episode: &str) -> String {
    format!("run @{episode} --out @deep/out --model @m.slipnet")
}

/// Each rule of an episode has its test in the crate slipsense-recording, `rules.rs`.
#[test]
fn wrong_damaged_and_missing_episodes() {
    let place = Place::with_files();
    let whole = fs::read(place.path("e.npz")).unwrap();
    for length in [0, 1, 100, whole.len() / 2, whole.len() - 1] {
        place.file("cut.npz", &whole[..length]);
        place.errors([(run("cut.npz"), "@cut.npz")]);
    }
    place.file("cut.npz", "frame,pressure\n");
    write_file(place.path("bare.npz"), |npz| npz.array("meta", &[2], *b"{}")).unwrap();
    fs::create_dir(place.path("folder")).unwrap();
    place.errors([
        (run("bare.npz"), "@bare.npz … array `piezo` is missing"),
        (run("cut.npz"), "@cut.npz … not an .npz"),
        (run("none.npz"), "@none.npz … No such file"),
        (run("folder"), "@folder … is a folder"),
        ("features @cut.npz --out @f.npz".to_owned(), "@cut.npz"),
        ("features @cut.npz --out @folder".to_owned(), "is a folder"),
        ("view @cut.npz".to_owned(), "cut.npz"),
    ]);
}

/// Each rule has its test in the crate slipsense, `network/model_file.rs`.
#[test]
fn models_that_cannot_be_used() {
    let place = Place::with_files();
    let whole = model_bytes();
    let (mut flipped, mut overflowing) = (whole.clone(), model());
    flipped[100] ^= 1;
    overflowing.tensor_mut("head", "bias")[2] = i32::MAX;
    for (content, rule) in [
        (overflowing.to_bytes().unwrap(), "head channel 2: accumulator can reach"),
        (whole[..whole.len() / 2].to_vec(), "file ends inside"),
        (flipped, "damaged"),
    ] {
        place.file("b.slipnet", content);
        let commands = [
            "run @e.npz --out @out --model @b.slipnet",
            "model info @b.slipnet",
            "tune @b.slipnet --out @t.slipnet",
        ];
        place.errors(commands.map(|line| (line, format!("@b.slipnet … {rule}"))));
    }
    let missing = "@none.slipnet: cannot read the model";
    place.errors([
        ("run @e.npz --out @out --model @none.slipnet", missing),
        ("model info @none.slipnet", missing),
        ("grasp --model @none.slipnet", missing),
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

/// Each rule has its test in the crate slipsense-synth, `tests/recipe.rs` and `objects/tests.rs`.
#[test]
fn recipes_that_cannot_be_generated() {
    let place = Place::new();
    for (text, rule) in [
        (r#"{"seed": 1, "sensors": 4}"#, "sensors is 4"),
        (r#"{"seed": 1, "grip_n": NaN}"#, "not a recipe"),
        (r#"{"seed": 1, "object": {"own": {"name": "my-rod"}}}"#, "missing field `kind`"),
        (&own("\"mass_g\"", "\"weight_g\""), "unknown field `weight_g`"),
        (r#"{"seed": 1, "colour": "red"}"#, "unknown field `colour`"),
        (r#"{"sensors": 1}"#, "seed"),
        ("{", "not a recipe"),
    ] {
        place.file("r.json", text);
        place.errors([("synth --recipe @r.json --out @e.npz", format!("@r.json … {rule}"))]);
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
        ("view @x.mcap", "@x.mcap: an MCAP recording; `slipsense convert` makes a log"),
    ]);
    place.errors([(format!("view --port {port}"), format!("port {port}: cannot listen on it"))]);
    let log = place.file("bad.log", "bad\n");
    let (mut page, mut said) = (place.start("view @bad.log --port 0"), String::new());
    BufReader::new(page.stderr.take().unwrap()).read_line(&mut said).unwrap();
    page.kill().unwrap();
    page.wait().unwrap();
    assert!(said.starts_with(&format!("error: {}: line 1: ", log.display())), "{said}");
}
