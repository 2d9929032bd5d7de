//! `slipsense label` without hardware: synthetic episodes lose their labels and get them back from a log as
//! a test stand would write it.

use std::fmt::Write;

use crate::support::{Place, number, unlabelled_episode};
use slipsense_recording::Episode;
use slipsense_recording::label::{NO_CONTACT, SLIP};
use slipsense_synth::{Recipe, generate};

const FRAME_HZ: f64 = 240.0;

fn synthetic(seed: u64) -> Episode {
    let recipe = format!(r#"{{"seed": {seed}, "scenario": "six_step", "object": "train"}}"#);
    generate(&serde_json::from_str::<Recipe>(&recipe).unwrap()).unwrap()
}

/// The episode as the recording `r.npz` would be, without what only the generator knows, and the stand's log of it.
fn recorded(episode: &Episode, stand: &Stand<'_>) -> Place {
    let place = Place::new();
    let mut bare = episode.clone();
    (bare.label, bare.displacement_mm, bare.slip_true_mm_s, bare.slip_fraction) = (None, None, None, None);
    bare.meta.other.clear();
    bare.write(place.path("r.npz")).unwrap();
    stand.write(&place, episode);
    place
}

/// The crosshead's log as a stand with another clock, other rate and unsteady last digits writes it.
struct Stand<'a> {
    rate_hz: f64,
    /// What its clock showed when the recording began.
    offset_s: f64,
    noise_mm: f64,
    knocks_s: &'a [f64],
}

impl Stand<'_> {
    fn write(&self, place: &Place, episode: &Episode) {
        let mm = episode.displacement_mm.as_ref().unwrap();
        let seconds = mm.len() as f64 / FRAME_HZ + self.offset_s + 1.0;
        let mut text =
            "Mark-10 test stand\nOperator,me\n\nReading,Load [N],Travel [mm],Time [sec]\n".to_owned();
        let mut state = 12345u32;
        for reading in 0..(seconds * self.rate_hz) as usize {
            let clock_s = reading as f64 / self.rate_hz;
            let at = ((clock_s - self.offset_s) * FRAME_HZ - 1.0).clamp(0.0, (mm.len() - 1) as f64);
            let (before, after) = (f64::from(mm[at as usize]), f64::from(mm[at.ceil() as usize]));
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            let noise = f64::from(state >> 16) / 32768.0 - 1.0;
            let travel_mm = before + (after - before) * at.fract() + self.noise_mm * noise;
            let near =
                self.knocks_s.iter().any(|k| (clock_s - self.offset_s - k).abs() <= 0.5 / self.rate_hz);
            let load_n = 0.05 * noise + if near { 8.0 } else { 0.0 };
            let _ = writeln!(text, "{},{load_n:.2},{travel_mm:.4},{clock_s:.5}", reading + 1);
        }
        place.file("r.csv", text);
    }
}

/// The command that labels `r.npz` by `r.csv`.
fn label(options: &str) -> String {
    format!("label @r.npz --displacement @r.csv {options} --object my-mug --out @out.npz")
}

fn labelled(place: &Place) -> Episode {
    Episode::read(place.path("out.npz")).unwrap()
}

/// Frames labelled otherwise than in the episode, and how far each is from the next edge of the truth.
fn differences(episode: &Episode, label: &[u8]) -> Vec<usize> {
    let truth = episode.label.as_ref().unwrap();
    assert!(truth.contains(&SLIP) && truth.len() == label.len());
    let edges: Vec<usize> = (1..truth.len()).filter(|&f| truth[f] != truth[f - 1]).collect();
    let different = (0..truth.len()).filter(|&f| truth[f] != label[f]);
    different.map(|f| edges.iter().map(|e| e.abs_diff(f)).min().unwrap_or(usize::MAX)).collect()
}

/// A log that has the encoder's position at every tick gives every label back: it is the same rule.
#[test]
fn a_perfect_log_gives_the_generators_labels_back() {
    let stand = Stand { rate_hz: FRAME_HZ, offset_s: 2.0, noise_mm: 0.0, knocks_s: &[] };
    for seed in 1..4 {
        let episode = synthetic(seed);
        let place = recorded(&episode, &stand);
        place.run(&label("--offset-s 2"));
        let off = differences(&episode, &labelled(&place).label.unwrap());
        assert!(off.is_empty(), "seed {seed}: {off:?}");
    }
}

/// With another rate, noise and an offset, labels differ at the edges of slips only, by what lies between two
/// readings (10 ms, 2.4 frames), and by one step more where the noise rounds the other way.
#[test]
fn a_real_log_gives_99_percent_of_the_labels_back() {
    let (mut frames, mut wrong) = (0, 0);
    let stand = Stand { rate_hz: 100.0, offset_s: 3.217, noise_mm: 0.004, knocks_s: &[] };
    for seed in 1..5 {
        let episode = synthetic(seed);
        let place = recorded(&episode, &stand);
        let text = place.run(&label("--offset-s 3.217 --unit a --unit b --platform umi"));
        assert!(text.contains("100 readings/s") && text.contains("my-mug"), "{text}");

        let labelled = labelled(&place);
        let meta = &labelled.meta.other;
        assert_eq!((&meta["object"], &meta["platform"]), (&"my-mug".into(), &"umi".into()));
        assert_eq!((&meta["units"][1], &meta["label_rule"]), (&"b".into(), &"encoder".into()));
        assert_eq!((&meta["label"]["offset_s"], &meta["label"]["file"]), (&3.217.into(), &"r.csv".into()));
        assert_eq!(labelled.piezo, episode.piezo);
        let (off, of) = (differences(&episode, labelled.label.as_ref().unwrap()), episode.frames());
        println!("seed {seed}: {} of {of} frames differ, {off:?} frames from an edge", off.len());
        assert!(off.iter().all(|&f| f <= 8), "{off:?}");
        frames += of;
        wrong += off.len();
    }
    assert!(wrong * 100 <= frames, "{wrong} of {frames} frames differ");
}

/// An episode whose crosshead rests at first, and a knock on each accelerometer at these times.
fn knocked(at_s: &[f64]) -> Episode {
    let rests = |episode: &Episode| {
        let mm = episode.displacement_mm.as_ref().unwrap();
        mm[..(2.2 * FRAME_HZ) as usize].iter().all(|x| (x - mm[0]).abs() < 0.01)
    };
    let mut episode = (1..60).map(synthetic).find(rests).expect("a seed whose crosshead rests");
    for sensor in 0..episode.sensors {
        for &time_s in at_s {
            // The accelerometer's own clock is some percent off: the frame says which sample it is.
            let start = episode.xl_end((time_s * FRAME_HZ) as usize, sensor) as usize;
            for (i, sample) in episode.xl[sensor][start..start + 40].iter_mut().enumerate() {
                let ring = 20_000.0 * (-(i as f64) / 8.0).exp() * (i as f64 * 1.9).cos();
                sample[2] = sample[2].saturating_add(ring as i16);
            }
        }
    }
    episode
}

#[test]
fn two_knocks_align_the_clocks() {
    let knocks_s = [0.613, 1.442];
    let episode = knocked(&knocks_s);
    let stand = Stand { rate_hz: 100.0, offset_s: 1.386, noise_mm: 0.004, knocks_s: &knocks_s };
    let place = recorded(&episode, &stand);
    let json = place.json(&label("--knocks"));
    println!("{json}");
    let found_s = number(&json["label"]["offset_s"]);
    assert!((found_s - 1.386).abs() < 0.012, "{found_s}");
    assert_eq!(json["label"]["knocks"], 2);
    assert!(number(&json["label"]["confidence"]) > 0.3, "{json}");
    let off = differences(&episode, &labelled(&place).label.unwrap());
    assert!(off.len() * 100 <= episode.frames(), "{off:?}");
}

#[test]
fn knocks_that_are_missing_or_ambiguous_are_refused() {
    // Twice the same pair: the log's one pair fits to either.
    let episode = knocked(&[0.3, 0.7, 1.5, 1.9]);
    for (knocks_s, rule) in [
        (&[0.3, 0.7][..], "ambiguous; give --offset-s instead"),
        (&[0.3], "no two knocks fall together"),
        (&[], "no two knocks fall together"),
    ] {
        let place = recorded(&episode, &Stand { rate_hz: 100.0, offset_s: 1.0, noise_mm: 0.0, knocks_s });
        place.errors([(label("--knocks"), format!("@r.csv … {rule}"))]);
    }
}

#[test]
fn pulls_are_listed_and_chosen() {
    let stand = Stand { rate_hz: 200.0, offset_s: 0.5, noise_mm: 0.0, knocks_s: &[] };
    let place = recorded(&synthetic(1), &stand);
    let text = place.run(&label("--offset-s 0.5 --pulls"));
    assert!(text.contains("Nothing was written"), "{text}");
    assert_eq!(place.names(), ["r.csv", "r.npz"]);
    let json = place.json(&label("--offset-s 0.5 --pulls"));
    let pulls = json["pulls"].as_array().unwrap();
    let held = pulls.iter().position(|pull| pull["frames_with_contact"] != 0).unwrap();
    assert!(pulls.len() >= 2, "{json}");
    place.errors([(label("--offset-s 0.5 --only 99"), "--only: there is no pull 99")]);

    place.run(&label(&format!("--offset-s 0.5 --only {}", held + 1)));
    let labels = labelled(&place).label.unwrap();
    let onset = pulls[held]["onset_frame"].as_u64().unwrap() as usize;
    assert_eq!((labels[onset - 1], labels[onset]), (1, SLIP));
}

#[test]
fn intervals_by_hand_and_recordings_without_slip() {
    let place = Place::new();
    unlabelled_episode().write(place.path("r.npz")).unwrap();
    let text = place.run("label @r.npz --manual 0.05:0.125 --object tape --out @out.npz");
    assert!(text.contains("no contact"), "{text}");
    // Pressed from frame 20 on; by hand from 12 to 30.
    let expected = [vec![NO_CONTACT; 20], vec![SLIP; 10], vec![1; 10]].concat();
    assert_eq!(labelled(&place).label.unwrap(), expected);
    assert!(text.contains("8 frames of pulls or intervals have no contact"), "{text}");

    // The output may be labelled again; its object is kept.
    place.run("label @out.npz --no-slip --out @out.npz");
    let again = labelled(&place);
    assert!(!again.label.unwrap().contains(&SLIP));
    let meta = &again.meta.other;
    assert_eq!((&meta["object"], &meta["label_rule"]), (&"tape".into(), &"no_slip".into()));
}

#[test]
fn what_cannot_be_labelled_is_refused_and_leaves_nothing() {
    let place = Place::with_files();
    place.file("bad.csv", "Time [s],Travel [mm]\n0,0\n0.1,oops\n");
    place.file("short.csv", "Time [s],Travel [mm]\n0,0\n0.1,0\n");
    let cases = [
        ("--object x --unit a --no-slip", "--unit is given 1 times, must be once for"),
        ("--object x --manual 0:9", "--manual: interval 1 (\"0:9\") must end within"),
        (
            "--object x --displacement @bad.csv --offset-s 0",
            "bad.csv: line 3, column \"Travel [mm]\": is \"oops\", must be a number",
        ),
        (
            "--object x --displacement @short.csv --offset-s 50",
            "short.csv: covers 0.000 s to 0.100 s, but the recording lasts from 50.000 s",
        ),
        ("--object x --displacement @short.csv --knocks", "short.csv: has no load column"),
        ("--object x --displacement @none.csv --offset-s 0", "none.csv: cannot read"),
        ("--no-slip", "has no \"object\" in its meta: say --object NAME"),
    ];
    place.errors(cases.map(|(options, rule)| (format!("label @e.npz {options} --out @o.npz"), rule)));
    place.errors([
        ("label @none.npz --no-slip --object x --out @o.npz", "none.npz: cannot read"),
        ("label @e.npz --no-slip --object x --out @no/o.npz", "cannot write into this folder"),
    ]);
}
