//! The contact summary against double precision; its sums, exactly: `sensor`.

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use slipsense::contact::ContactSummary;
use slipsense::params::{COL_PITCH_MM, ROW_PITCH_MM, TAXEL_TOUCH_MIN, TAXELS};
use slipsense::sensor::PiezoFrame;

use crate::on_pad;

/// An elliptical contact, centre and half axes in millimetres, on idle noise.
fn ellipse(rng: &mut ChaCha8Rng, centre: (f64, f64), half: (f64, f64), degrees: f64) -> PiezoFrame {
    let (sin, cos) = degrees.to_radians().sin_cos();
    let mut counts = [0; TAXELS];
    for (index, count) in counts.iter_mut().enumerate() {
        let (row, col) = (index / 32, index % 32);
        let x = col as f64 * f64::from(COL_PITCH_MM) - centre.0;
        let y = row as f64 * f64::from(ROW_PITCH_MM) - centre.1;
        let (along, across) = (x * cos + y * sin, y * cos - x * sin);
        let inside = 1.0 - (along / half.0).powi(2) - (across / half.1).powi(2);
        *count = if inside > 0.0 { (inside * 3000.0) as u16 } else { rng.random_range(0..3) };
    }
    PiezoFrame::from_scan(counts)
}

/// Angle of the long axis, degrees, and elongation.
fn exact(frame: &PiezoFrame) -> (f64, f64) {
    let counts = frame.counts().iter().enumerate().filter(|&(_, &count)| count >= TAXEL_TOUCH_MIN);
    let place = |(index, &count): (usize, &u16)| (f64::from(count), (index / 32) as f64, (index % 32) as f64);
    let touched: Vec<(f64, f64, f64)> = counts.map(place).collect();
    let weight: f64 = touched.iter().map(|t| t.0).sum();
    let mean = |f: &dyn Fn(&(f64, f64, f64)) -> f64| touched.iter().map(|t| t.0 * f(t)).sum::<f64>() / weight;
    let (row, col) = (mean(&|t| t.1), mean(&|t| t.2));
    let (pitch_y, pitch_x) = (f64::from(ROW_PITCH_MM), f64::from(COL_PITCH_MM));
    let yy = mean(&|t| ((t.1 - row) * pitch_y).powi(2));
    let xx = mean(&|t| ((t.2 - col) * pitch_x).powi(2));
    let xy = mean(&|t| (t.1 - row) * (t.2 - col) * pitch_x * pitch_y);
    let spread = ((xx - yy).powi(2) + 4.0 * xy * xy).sqrt();
    let elongation = 1.0 - ((xx + yy - spread).max(0.0) / (xx + yy + spread)).sqrt();
    (0.5 * (2.0 * xy).atan2(xx - yy).to_degrees(), elongation)
}

#[test]
fn an_idle_pad_has_a_sum_and_no_contact() {
    let mut counts = [1; TAXELS];
    counts[500] = TAXEL_TOUCH_MIN - 1;
    let summary = ContactSummary::new(&PiezoFrame::from_scan(counts));
    assert_eq!(summary, ContactSummary { sum: 941 + u32::from(TAXEL_TOUCH_MIN) - 1, ..Default::default() });
}

#[test]
fn ellipses_in_all_directions() {
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let (mut worst_degrees, mut worst_elongation) = (0f64, 0f64);
    for _ in 0..500 {
        let centre = (rng.random_range(8.0..14.0), rng.random_range(11.0..18.0));
        let long = rng.random_range(4.0..7.0);
        let half = (long, long * rng.random_range(0.2..0.7));
        let degrees = rng.random_range(-89.0..89.0);
        let frame = ellipse(&mut rng, centre, half, degrees);
        let (summary, (degrees, elongation)) = (ContactSummary::new(&frame), exact(&frame));
        let turn = (f64::from(summary.axis_deg) - degrees).rem_euclid(180.0);
        worst_degrees = worst_degrees.max(turn.min(180.0 - turn));
        let found = f64::from(summary.elongation.to_bits());
        worst_elongation = worst_elongation.max((found - 256.0 * elongation).abs());
    }
    assert!(worst_degrees < 1.0 && worst_elongation < 2.0);
}

#[test]
fn a_taxel_has_no_axis_and_a_column_has_one() {
    for index in (0..TAXELS).filter(|&index| on_pad(index)) {
        let mut counts = [0; TAXELS];
        counts[index] = 4095;
        let one = ContactSummary::new(&PiezoFrame::from_scan(counts));
        assert_eq!((one.axis_deg, one.elongation.to_bits()), (0, 0));
    }
    let mut column = [0; TAXELS];
    (0..32).for_each(|row| column[row * 32 + 16] = 100);
    let column = ContactSummary::new(&PiezoFrame::from_scan(column));
    assert_eq!((column.axis_deg, column.elongation.to_bits()), (-90, 255));
}
