//! `slipsense busload`: loads, latency, warnings, picture, errors.

use serde_json::Value;

use crate::support::{Place, number};

fn first_bus(options: &str) -> Value {
    Place::new().json(&format!("busload {options}"))["buses"][0].clone()
}

/// The wait on a bus at 1/8 Mbit/s that raw messages fill. Compressed ones come in frames of 48 bytes, so that it is
/// less than a quarter of a millisecond whatever the data; plain ones in frames of 64, of which those of idle taxels
/// are full of stuff bits, take 2 % more than that, and data made to need the most stuff bits 5 %.
#[test]
fn the_flag_waits_a_quarter_of_a_millisecond_on_a_full_bus() {
    for (raw, bounds_us) in [("compressed", [250.0, 250.0]), ("plain", [255.0, 263.0])] {
        let bus = first_bus(&format!("--bitrate 1/8 --raw {raw}"));
        for (what, bound_us) in ["latency_exact", "latency_worst"].into_iter().zip(bounds_us) {
            let (calculated, simulated) =
                (number(&bus[what]["calculated_us"]), number(&bus[what]["simulated_us"]));
            println!("{raw}, {what}: calculated {calculated} us, on the simulated bus {simulated} us");
            assert!(simulated <= calculated && calculated <= bound_us, "{what}: {bus}");
            assert!(simulated > 0.9 * calculated, "{what}: {bus}");
        }
    }
}

#[test]
fn three_sensors_compressed_fit_one_bus() {
    for options in ["--sensors 3 --bitrate 1/8", "--sensors 2 --bitrate 1/5"] {
        let bus = first_bus(&format!("--raw compressed --limit 70 {options}"));
        let percent = number(&bus["exact"]["total_percent"]);
        println!("{options}: {percent:.1} %");
        assert!(percent <= 70.0, "{bus}");
    }
}

#[test]
fn what_does_not_fit_is_warned_of() {
    let place = Place::new();
    for (options, count) in [("1 --bitrate 1/8", 0), ("1 --bitrate 1/8 --limit 50", 1), ("3", 2)] {
        let result = place.json(&format!("busload --sensors {options}"));
        let warnings = result["warnings"].as_array().unwrap();
        assert_eq!(warnings.len(), count, "{options}");
        assert!(count < 2 || warnings[0].as_str().unwrap().contains("raw messages will be lost"), "{result}");
    }
    let table = place.run("busload --sensors 3");
    assert_eq!(table.matches("warning: ").count(), 2, "{table}");
    assert!(table.contains("1/5 ") && table.contains("1/8 "), "{table}");
}

#[test]
fn an_episode_of_ones_own_and_a_picture() {
    let place = Place::with_files();
    let found = place.json("busload @e.npz --svg @load.svg --raw-every 4 --foreign 20");
    assert_eq!((&found["episode"]["frames"], &found["sensors"]), (&40.into(), &2.into()));
    let bus = &found["buses"][0];
    assert!(number(&bus["exact"]["total_percent"]) < number(&bus["worst"]["total_percent"]), "{bus}");
    assert_eq!(number(&bus["exact"]["foreign_percent"]), 20.0);
    let picture = std::fs::read_to_string(place.path("load.svg")).unwrap();
    assert!(picture.starts_with("<svg") && picture.contains("worst case"), "{picture}");
}

#[test]
fn what_cannot_be_planned() {
    Place::new().errors([
        ("busload --bitrate 1/7", "80 MHz is no multiple of 7000000 bit/s"),
        ("busload @none.npz", "No such file"),
        ("busload --svg @", "is a folder"),
        ("busload --bitrate 1/9", "--bitrate"),
        ("busload --sensors 4", "--sensors"),
        ("busload --nodes 0", "--nodes"),
        ("busload --limit 101", "--limit"),
    ]);
}
