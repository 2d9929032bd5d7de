//! Levels and spectra of generated episodes against the ranges the physics asks for.
//! Vibration is measured without the parts' electrical noise, above 10 Hz, as the rms of the vector.

use slipsense_recording::Episode;
use slipsense_synth::labels::{NO_CONTACT, NO_SLIP, SLIP};
use slipsense_synth::{Recipe, ScenarioChoice, generate_set};

/// Vector rms in mg over the 128 samples before each frame tick, above 10 Hz (first-order, float).
fn rms_mg(e: &Episode, sensor: usize) -> Vec<f64> {
    let pole = 1.0 - std::f64::consts::TAU * 10.0 / 8000.0;
    let (mut last, mut y) = (e.xl[sensor][0].map(f64::from), [0.0; 3]);
    let mut running = vec![0.0];
    for sample in &e.xl[sensor] {
        let x = sample.map(f64::from);
        let mut power = 0.0;
        for axis in 0..3 {
            y[axis] = pole * (y[axis] + x[axis] - last[axis]);
            power += y[axis] * y[axis];
        }
        last = x;
        running.push(running[running.len() - 1] + power);
    }
    (0..e.frames())
        .map(|f| {
            let end = e.xl_end(f, sensor) as usize;
            let start = end.saturating_sub(128);
            ((running[end] - running[start]) / (end - start).max(1) as f64).sqrt() * e.meta.xl_lsb_g * 1e3
        })
        .collect()
}

fn median(values: &mut [f64]) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

fn of_label(e: &Episode, values: &[f64], label: u8) -> Vec<f64> {
    let labels = e.label.as_deref().unwrap_or(&[]);
    values.iter().zip(labels).filter(|(_, l)| **l == label).map(|(v, _)| *v).collect()
}

fn slips(speed_mm_s: f64, count: usize) -> Vec<Recipe> {
    let base = Recipe {
        scenario: ScenarioChoice::SixStep,
        speed_mm_s: Some(speed_mm_s),
        seconds: Some(3.0),
        sensors: 1,
        noise: 0.0,
        ..Recipe::new(4711)
    };
    base.series(count)
}

/// Median over episodes of the median slip level of each, mg.
fn slip_level(speed_mm_s: f64) -> f64 {
    let mut levels =
        generate_set(&slips(speed_mm_s, 8), |_, e| median(&mut of_label(&e, &rms_mg(&e, 0), SLIP))).unwrap();
    median(&mut levels)
}

#[test]
fn slip_levels_rise_with_speed_around_the_anchor() {
    let levels = [2.0, 5.0, 10.0, 18.0].map(slip_level);
    println!("slip rms at 2, 5, 10, 18 mm/s: {levels:.1?} mg (synthetic)");
    assert!(levels.is_sorted());
    assert!((2.0..12.0).contains(&levels[0]), "2 mm/s: {} mg", levels[0]);
    assert!((15.0..90.0).contains(&levels[2]), "10 mm/s: {} mg", levels[2]);
}

#[test]
fn spectral_centroid_rises_with_speed() {
    // Mean squared difference over mean square grows with frequency: 2 − 2 cos ω for a tone.
    let centre = |speed| {
        let mut centres = generate_set(&slips(speed, 8), |_, e| {
            let labels = e.label.as_deref().unwrap_or(&[]);
            let (mut differences, mut power) = (0.0, 0.0);
            for f in (0..e.frames()).filter(|&f| labels[f] == SLIP) {
                let batch = e.xl_batch(f, 0);
                let mean: [f64; 3] = std::array::from_fn(|a| {
                    batch.iter().map(|s| f64::from(s[a])).sum::<f64>() / batch.len() as f64
                });
                for pair in batch.windows(2) {
                    for axis in 0..3 {
                        let step = f64::from(pair[1][axis]) - f64::from(pair[0][axis]);
                        let level = f64::from(pair[1][axis]) - mean[axis];
                        differences += step * step;
                        power += level * level;
                    }
                }
            }
            libm::acos((1.0 - differences / power / 2.0).clamp(-1.0, 1.0)) / std::f64::consts::TAU * 8000.0
        })
        .unwrap();
        median(&mut centres)
    };
    let (slow, fast) = (centre(2.0), centre(18.0));
    println!("centroid at 2 mm/s {slow:.0} Hz, at 18 mm/s {fast:.0} Hz (synthetic)");
    assert!(fast > 1.1 * slow);
}

#[test]
fn disturbances_are_as_loud_as_slip() {
    let loud = |mut v: Vec<f64>| {
        v.sort_by(f64::total_cmp);
        v[v.len() * 95 / 100]
    };
    let recipes = Recipe { sensors: 1, noise: 0.0, ..Recipe::new(99) }.series(16);
    let episodes = generate_set(&recipes, |_, e| {
        let rms = rms_mg(&e, 0);
        [NO_CONTACT, NO_SLIP, SLIP].map(|label| of_label(&e, &rms, label))
    });
    let [mut idle, mut held, mut slip] = [const { Vec::new() }; 3];
    for [i, h, s] in episodes.unwrap() {
        idle.extend(i);
        held.extend(h);
        slip.extend(s);
    }
    let typical = median(&mut slip);
    let (idle, held) = (loud(idle), loud(held));
    println!("95th percentile: no contact {idle:.0} mg, no slip {held:.0} mg; median slip {typical:.0} mg");
    assert!(idle > typical && held > typical);
}
