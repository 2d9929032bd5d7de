//! What a grasp's draw adds to the layer: unevenness that travels with the object.

use super::*;
use crate::draw::{Stream, stream};
use crate::objects::named;

/// Relative rms of the pressure of the cells well inside the patch while the object slides 12 mm along
/// its axis, and the rms drawn, both as means over grasps.
fn flutter(name: &str) -> (f64, f64) {
    let object = named(name).unwrap();
    let (mut measured, mut drawn) = (0.0, 0.0);
    for seed in 0..20 {
        let mut rng = stream(seed, Stream::Contact, 1);
        let pose = Pose { x_mm: 0.2, y_mm: -4.0, yaw_rad: 0.0, tilt: [0.0; 2] };
        let mut contact = Contact::draw(&mut rng, object, pose, Region::Centre);
        drawn += contact.uneven_rms / 20.0;
        let mut map = PressureMap::empty();
        // Rows 12–19 of the middle columns stay under the object all the way.
        let cells: Vec<usize> = (12..20).flat_map(|row| [15, 16].map(|col| row * TAXEL_COLS + col)).collect();
        let mut sums = vec![(0.0, 0.0); cells.len()];
        for step in 0..=60 {
            contact.place([0.0, 0.2 * f64::from(step)], 0.0, [0.0; 2]);
            contact.pressures(3.0, [0.0; 2], &mut map);
            for (sum, &cell) in sums.iter_mut().zip(&cells) {
                *sum = (sum.0 + map.kpa[cell], sum.1 + map.kpa[cell] * map.kpa[cell]);
            }
        }
        let relative = |&(first, second): &(f64, f64)| (second * 61.0 / (first * first) - 1.0).max(0.0);
        measured += (sums.iter().map(relative).sum::<f64>() / sums.len() as f64).sqrt() / 20.0;
    }
    (measured, drawn)
}

#[test]
fn pressure_flutters_as_drawn_while_a_block_slides_and_hardly_under_a_cable() {
    let (block, drawn) = flutter("shore-60-block");
    println!("block sliding 12 mm: pressure varies by {:.1} % rms, drawn {:.1} %", 1e2 * block, 1e2 * drawn);
    assert!((0.02..0.08).contains(&block) && (0.7..1.2).contains(&(block / drawn)));
    let (cable, drawn) = flutter("coax-cable");
    println!("cable sliding 12 mm: pressure varies by {:.1} % rms, drawn {:.1} %", 1e2 * cable, 1e2 * drawn);
    assert!(cable < 0.6 * block);
}

#[test]
fn a_relief_travels_over_the_pad() {
    let pose = Pose { x_mm: 0.0, y_mm: 0.0, yaw_rad: 0.0, tilt: [0.0; 2] };
    let mut contact = Contact::new(named("dsub-hood").unwrap(), pose, 2500.0, 0.3);
    let mut map = PressureMap::empty();
    let mut column = |shift_mm: f64| -> Vec<f64> {
        contact.place([0.0, shift_mm], 0.0, [0.0; 2]);
        contact.pressures(4.0, [0.0; 2], &mut map);
        (8..24).map(|row| map.kpa[row * TAXEL_COLS + 16]).collect()
    };
    let (start, half, whole) = (column(0.0), column(2.5), column(5.0));
    let apart = |a: &[f64], b: &[f64]| {
        let (d, s) = a.iter().zip(b).fold((0.0, 0.0), |(d, s), (x, y)| (d + (x - y).abs(), s + x + y));
        d / s
    };
    let (far, near) = (apart(&start, &half), apart(&start, &whole));
    println!("ridges 5 mm apart: pattern differs by {far:.3} after 2.5 mm and by {near:.3} after 5 mm");
    assert!(far > 0.1 && near < 0.3 * far);
}

/// Everything that [`Contact::draw`] draws can be written down; what follows from it is left out.
#[test]
fn the_draws_of_a_grasp_can_be_logged() {
    let pose = Pose { x_mm: 1.0, y_mm: 2.0, yaw_rad: 0.1, tilt: [0.0; 2] };
    let mut rng = stream(1, Stream::Contact, 1);
    let contact = Contact::draw(&mut rng, named("hex-key").unwrap(), pose, Region::Palm);
    let log = serde_json::to_value(&contact).unwrap();
    let mut keys: Vec<_> = log.as_object().unwrap().keys().map(String::as_str).collect();
    keys.sort_unstable();
    assert_eq!(keys, ["layer", "pose", "stiffness_kpa_per_mm", "uneven_mm", "uneven_rms"]);
    assert!(log["layer"]["local_stiffening"].as_f64().unwrap() >= 1.4);
}
