//! `slipsense busload` through the binary: loads, latency, warnings, picture, errors.

mod support;

use serde_json::Value;
use support::{Arrays, Place, fails, succeeds};

fn json(args: &[&str]) -> Value {
    let args = ["busload", "--json"].into_iter().chain(args.iter().copied());
    serde_json::from_str(&succeeds(args)).unwrap()
}

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or_else(|| panic!("{value} is a number"))
}

/// The wait on a bus at 1/8 Mbit/s that raw messages fill. Compressed ones come in frames of 48 bytes, so that it is
/// less than a quarter of a millisecond whatever the data; plain ones in frames of 64, of which those of idle taxels
/// are full of stuff bits, take 2 % more than that, and data made to need the most stuff bits 5 %.
#[test]
fn the_flag_waits_a_quarter_of_a_millisecond_on_a_full_bus() {
    for (raw, bounds_us) in [("compressed", [250.0, 250.0]), ("plain", [255.0, 263.0])] {
        let bus = &json(&["--bitrate", "1/8", "--raw", raw])["buses"][0];
        let of = |what: &str, how: &str| number(&bus[what][how]);
        for (what, bound_us) in ["latency_exact", "latency_worst"].into_iter().zip(bounds_us) {
            let (calculated, simulated) = (of(what, "calculated_us"), of(what, "simulated_us"));
            println!("{raw}, {what}: reckoned {calculated} us, on the modelled bus {simulated} us");
            assert!(simulated <= calculated && calculated <= bound_us, "{what}: {bus}");
            assert!(simulated > 0.9 * calculated, "{what}: {bus}");
        }
    }
}

#[test]
fn three_sensors_compressed_fit_one_bus() {
    let fits = |args: &[&str]| {
        let args = ["--raw", "compressed", "--limit", "70"].iter().chain(args).copied().collect::<Vec<_>>();
        let bus = &json(&args)["buses"][0];
        let percent = number(&bus["exact"]["total_percent"]);
        println!("{args:?}: {percent:.1} %");
        assert!(percent <= 70.0, "{bus}");
    };
    fits(&["--sensors", "3", "--bitrate", "1/8"]);
    fits(&["--sensors", "2", "--bitrate", "1/5"]);
}

#[test]
fn what_does_not_fit_is_warned_of() {
    let warnings = |args: &[&str]| json(args)["warnings"].as_array().unwrap().len();
    assert_eq!(warnings(&["--sensors", "1", "--bitrate", "1/8"]), 0);
    assert_eq!(warnings(&["--sensors", "1", "--bitrate", "1/8", "--limit", "50"]), 1);
    let three = json(&["--sensors", "3"]);
    assert_eq!(three["warnings"].as_array().unwrap().len(), 2);
    assert!(three["warnings"][0].as_str().unwrap().contains("raw messages will be lost"), "{three}");
    let table = succeeds(["busload", "--sensors", "3"]);
    assert_eq!(table.matches("warning: ").count(), 2, "{table}");
    assert!(table.contains("1/5 ") && table.contains("1/8 "), "{table}");
}

#[test]
fn an_episode_of_ones_own_and_a_picture() {
    let place = Place::new();
    Arrays::valid().write(&place.path("e.npz"));
    let (episode, svg) = (place.path("e.npz").display().to_string(), place.path("load.svg"));
    let found = json(&[&episode, "--svg", svg.to_str().unwrap(), "--raw-every", "4", "--foreign", "20"]);
    assert_eq!(found["episode"]["frames"], 40);
    assert_eq!(found["sensors"], 2);
    let bus = &found["buses"][0];
    assert!(number(&bus["exact"]["total_percent"]) < number(&bus["worst"]["total_percent"]), "{bus}");
    assert_eq!(number(&bus["exact"]["foreign_percent"]), 20.0);
    let picture = std::fs::read_to_string(svg).unwrap();
    assert!(picture.starts_with("<svg") && picture.contains("worst case"), "{picture}");
}

#[test]
fn what_cannot_be_planned() {
    let place = Place::new();
    let error = |args: &[&str]| fails(["busload"].into_iter().chain(args.iter().copied()));
    assert!(error(&["--bitrate", "1/7"]).contains("80 MHz is no multiple of 7000000 bit/s"));
    let missing = place.path("none.npz").display().to_string();
    assert!(error(&[&missing]).contains("No such file"));
    let folder = place.path("").display().to_string();
    assert!(error(&["--svg", &folder]).contains("is a folder"));
    for args in [["--bitrate", "1/9"], ["--sensors", "4"], ["--nodes", "0"], ["--limit", "101"]] {
        let output = support::slipsense(["busload"].into_iter().chain(args));
        assert_eq!(output.status.code(), Some(2), "{args:?}");
    }
    assert!(place.names().is_empty());
}
