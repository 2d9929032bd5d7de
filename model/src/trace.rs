//! The activations of the float and the integer network: their names, largest magnitudes and values.

use std::collections::BTreeMap;

use slipsense::net::Observer;

/// Activations in the order of their computation; the quantizer derives a real scale of each from its range.
pub const ACTIVATIONS: [&str; 24] = [
    "taxels",
    "piezo.conv1",
    "piezo.conv2",
    "piezo.conv3",
    "piezo",
    "log_mel",
    "xl.conv",
    "xl.mix1",
    "xl",
    "cross_piezo.query",
    "cross_piezo.key",
    "cross_piezo.value",
    "cross_piezo.residual",
    "cross_xl.query",
    "cross_xl.key",
    "cross_xl.value",
    "cross_xl.residual",
    "fused",
    "temporal.query",
    "temporal.key",
    "temporal.value",
    "temporal.residual",
    "hidden",
    "logits",
];

/// Largest magnitude seen of every activation.
#[derive(Clone, Debug, Default)]
pub struct Ranges {
    largest: [f32; ACTIVATIONS.len()],
}

impl Ranges {
    pub fn of(trace: &Trace) -> Self {
        let largest = |values: &Vec<f32>| values.iter().fold(0.0, |m: f32, x| m.max(x.abs()));
        Self { largest: trace.values.each_ref().map(largest) }
    }

    /// Largest magnitude seen of one of [`ACTIVATIONS`], real units. Panics at other names.
    pub fn largest(&self, activation: &str) -> f32 {
        self.largest[index_of(activation)]
    }

    /// Include the ranges of another pass.
    pub fn merge(&mut self, other: &Self) {
        for (mine, other) in self.largest.iter_mut().zip(other.largest) {
            *mine = mine.max(other);
        }
    }
}

fn index_of(activation: &str) -> usize {
    ACTIVATIONS.iter().position(|&listed| listed == activation).expect("activations are listed")
}

/// Values in real units, in the order of [`ACTIVATIONS`]; sensors one after the other, in order.
#[derive(Clone, Debug, Default)]
pub struct Trace {
    values: [Vec<f32>; ACTIVATIONS.len()],
}

impl Trace {
    /// Add values of one of [`ACTIVATIONS`]. Panics at other names.
    pub fn record(&mut self, activation: &str, values: impl IntoIterator<Item = f32>) {
        self.values[index_of(activation)].extend(values);
    }

    pub fn values(&self) -> impl Iterator<Item = &[f32]> {
        self.values.iter().map(Vec::as_slice)
    }

    /// Forget them, for the next frame.
    pub fn clear(&mut self) {
        self.values.iter_mut().for_each(Vec::clear);
    }
}

/// Records the real values of the integer network's activations.
#[derive(Debug)]
pub struct IntegerTrace<'s> {
    /// Real value of one unit of each activation; all are there.
    pub scales: &'s BTreeMap<String, f64>,
    pub trace: Trace,
}

impl IntegerTrace<'_> {
    fn record_scaled<T: Copy + Into<f64>>(&mut self, activation: &str, values: &[T]) {
        let scale = self.scales[activation];
        self.trace.record(activation, values.iter().map(|&value| (value.into() * scale) as f32));
    }
}

impl Observer for IntegerTrace<'_> {
    fn record(&mut self, layer: &'static str, values: &[i16]) {
        self.record_scaled(layer, values);
    }

    fn record_residual(&mut self, block: &'static str, values: &[i32]) {
        self.record_scaled(&format!("{block}.residual"), values);
    }

    fn record_part(&mut self, block: &'static str, part: &'static str, values: &[i16]) {
        self.record_scaled(&format!("{block}.{part}"), values);
    }
}
