//! What a user can get wrong: exit code 2, one line that names the thing, nothing left behind.

mod support;

use std::fs;
use std::path::Path;

use slipsense::params::TAXEL_COLS;
use slipsense_recording::Episode;
use support::{Arrays, Place, fails, model, names, succeeds};

/// Run an episode file that must be refused.
fn refused(place: &Place, episode: &Path) -> String {
    let before = place.names();
    let model = place.path("m.slipnet");
    fs::write(&model, model_bytes()).unwrap();
    let out = place.path("out");
    let args = ["run".as_ref(), episode.as_os_str(), "--out".as_ref(), out.as_os_str(), "--model".as_ref()];
    let error = fails(args.into_iter().chain([model.as_os_str()]));
    fs::remove_file(model).unwrap();
    assert_eq!(place.names(), before, "no output");
    assert!(error.contains(&episode.display().to_string()), "names the file: {error}");
    error
}

fn model_bytes() -> Vec<u8> {
    model().to_bytes().unwrap()
}

/// Run a valid episode with a model that must be refused.
fn refused_model(content: &[u8]) -> String {
    let place = Place::new();
    Arrays::valid().write(&place.path("e.npz"));
    let model = place.file("broken.slipnet", content);
    let (episode, out) = (place.path("e.npz"), place.path("out"));
    let error = fails(["run", "--out"].map(Into::into).into_iter().chain([
        out,
        episode,
        "--model".into(),
        model.clone(),
    ]));
    assert_eq!(place.names(), ["broken.slipnet", "e.npz"], "no output");
    assert!(error.contains(&model.display().to_string()), "names the file: {error}");
    error
}

#[test]
fn every_rule_of_the_episode_format() {
    type Break = fn(&mut Arrays);
    let cases: [(Break, &str); 15] = [
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
    ];
    let place = Place::new();
    let path = place.path("e.npz");
    for (break_it, rule) in cases {
        let mut arrays = Arrays::valid();
        break_it(&mut arrays);
        arrays.write(&path);
        let error = refused(&place, &path);
        assert!(error.contains(rule), "{error:?} says {rule:?}");
    }
}

#[test]
fn sensors_that_do_not_fit() {
    let place = Place::new();
    let path = place.path("e.npz");
    let mut arrays = Arrays::valid();
    // The same numbers read as four sensors of half the frames.
    (arrays.frames, arrays.sensors) = (20, 4);
    arrays.xl = vec![0; 4 * 1000 * 3];
    arrays.label.clear();
    arrays.slip_true.truncate(20);
    arrays.write(&path);
    let error = refused(&place, &path);
    assert!(error.contains("array `piezo`") && error.contains("S from 1 to 3"), "{error}");
}

#[test]
fn damaged_and_missing_episodes() {
    let place = Place::new();
    let path = place.path("e.npz");
    Arrays::valid().write(&path);
    let whole = fs::read(&path).unwrap();
    for length in [0, 1, 100, whole.len() / 2, whole.len() - 1] {
        fs::write(&path, &whole[..length]).unwrap();
        refused(&place, &path);
    }
    fs::write(&path, "frame,pressure\n").unwrap();
    assert!(refused(&place, &path).contains("not an .npz"));
    assert!(refused(&place, &place.path("none.npz")).contains("No such file"));
    fs::create_dir(place.path("folder")).unwrap();
    assert!(refused(&place, &place.path("folder")).contains("is a folder"));
}

#[test]
fn model_of_an_unknown_version() {
    let mut bytes = model_bytes();
    bytes[8] = 9;
    assert!(refused_model(&bytes).contains("model format version 9 is unknown"));
}

#[test]
fn model_whose_accumulators_could_overflow() {
    let mut file = model();
    file.tensor_mut("head", "bias")[2] = i32::MAX;
    let error = refused_model(&file.to_bytes().unwrap());
    assert!(error.contains("head channel 2: accumulator can reach"), "{error}");
}

#[test]
fn damaged_and_missing_models() {
    let whole = model_bytes();
    assert!(refused_model(b"").contains("not a SlipSense model file"));
    assert!(refused_model(&whole[..whole.len() / 2]).contains("file ends inside"));
    let mut flipped = whole.clone();
    flipped[100] ^= 1;
    assert!(refused_model(&flipped).contains("damaged"));

    let place = Place::new();
    Arrays::valid().write(&place.path("e.npz"));
    let missing = place.path("none.slipnet");
    let (episode, out) = (place.path("e.npz"), place.path("out"));
    let error = fails(["run".into(), episode, "--out".into(), out, "--model".into(), missing.clone()]);
    assert!(error.starts_with(&format!("{}: cannot read the model", missing.display())), "{error}");
    assert_eq!(place.names(), ["e.npz"]);
}

/// Root may write into any folder, so permissions would prove nothing; these fail for everyone.
#[test]
fn folders_that_cannot_be_written() {
    let place = Place::new();
    let file = place.file("file", "mine");
    Arrays::valid().write(&place.path("e.npz"));
    let episode = place.path("e.npz");
    let mut targets = vec![file.clone(), file.join("out"), file.join("a/b")];
    if Path::new("/proc/self").is_dir() {
        targets.push("/proc/slipsense/out".into());
    }
    for target in targets {
        let shown = target.display().to_string();
        let synth = ["synth", "--split", "val", "--frames", "1"].map(Into::into).to_vec();
        for command in [vec!["run".into(), episode.clone()], vec!["demo".into()], synth] {
            let error = fails(command.into_iter().chain(["--out".into(), target.clone()]));
            assert!(error.starts_with(&shown), "{error} names {shown}");
        }
        if target != file {
            let command = ["features".into(), episode.clone(), "--out".into(), target.clone()];
            let error = fails(command);
            assert!(error.contains("cannot write"), "{error}");
        }
    }
    assert_eq!(place.names(), ["e.npz", "file"]);
    assert_eq!(fs::read(&file).unwrap(), b"mine");
}

#[test]
fn a_failed_run_leaves_an_existing_folder_as_it_was() {
    let place = Place::new();
    let out = place.path("out");
    fs::create_dir(&out).unwrap();
    fs::write(out.join("summary.json"), "old").unwrap();
    let bad = place.file("bad.npz", "no");
    fails(["run".into(), bad, "--out".into(), out.clone()]);
    assert_eq!(names(&out), ["summary.json"]);
    assert_eq!(fs::read(out.join("summary.json")).unwrap(), b"old");
}

#[test]
fn features_of_a_broken_episode() {
    let place = Place::new();
    let bad = place.file("bad.npz", "no");
    let error = fails(["features".into(), bad.clone(), "--out".into(), place.path("f.npz")]);
    assert!(error.contains(&bad.display().to_string()), "{error}");
    let folder = place.path("folder");
    fs::create_dir(&folder).unwrap();
    assert!(fails(["features".into(), bad, "--out".into(), folder]).contains("is a folder"));
    assert_eq!(place.names(), ["bad.npz", "folder"]);
}

/// The recipe of the command's help that brings its own object, with one thing changed.
fn own(from: &str, to: &str) -> String {
    let help = succeeds(["synth", "--help"]);
    let recipe = &help[help.find("{\"seed\": 7, \"grip_n\"").unwrap()..];
    let recipe = &recipe[..recipe.find("}}}").unwrap() + 3];
    assert!(recipe.contains(from), "{from} is in {recipe}");
    recipe.replacen(from, to, 1)
}

#[test]
fn the_recipe_of_the_help_is_generated() {
    let place = Place::new();
    let recipe = place.file("r.json", own("\"seed\": 7", "\"seed\": 8, \"seconds\": 2.5"));
    let out = place.path("e.npz");
    succeeds(["synth".into(), "--recipe".into(), recipe, "--out".into(), out.clone()]);
    let meta = Episode::read(&out).unwrap().meta.other;
    assert_eq!((&meta["object"], &meta["object_kind"]), (&"my-rod".into(), &"tool".into()));
    assert_eq!((&meta["grip_n"], &meta["held_out"]), (&2.5.into(), &false.into()));
}

#[test]
fn recipes_that_cannot_be_generated() {
    let place = Place::new();
    let recipe = place.path("r.json");
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
        fs::write(&recipe, text).unwrap();
        let error =
            fails(["synth".into(), "--recipe".into(), recipe.clone(), "--out".into(), place.path("e.npz")]);
        assert!(error.contains(rule) && error.contains(&recipe.display().to_string()), "{error}");
    }
    assert_eq!(place.names(), ["r.json"]);
}

#[test]
#[cfg(not(feature = "train"))]
fn the_trainer_is_elsewhere() {
    for command in ["train", "quantize", "compare-networks"] {
        let error = fails([command, "--epochs", "3"]);
        assert!(
            error.contains(&format!("cargo run --release --features train -- {command} --epochs 3")),
            "{error}"
        );
    }
}

#[test]
fn a_page_of_nothing_is_not_served() {
    let place = Place::new();
    let missing = fails(["view".as_ref(), place.path("none.log").as_os_str()]);
    assert!(missing.contains("none.log: cannot read the log"), "{missing}");
    let no_episode = fails(["view".as_ref(), place.file("bad.npz", b"no zip").as_os_str()]);
    assert!(no_episode.contains("bad.npz"), "{no_episode}");
    let with_model = fails(["view", "-", "--model", "m.slipnet"]);
    assert!(with_model.contains("m.slipnet"), "{with_model}");

    let taken = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let port = taken.local_addr().unwrap().port().to_string();
    let error = fails(["view", "--port", &port]);
    assert!(error.contains(&format!("port {port}: cannot listen on it")), "{error}");
}
