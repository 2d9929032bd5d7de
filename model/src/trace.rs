//! The activations of the network: their names, their largest magnitudes, and their values in one frame, from the
//! float network or from the integer one.

use std::collections::BTreeMap;

use slipsense::net::Observer;

/// Activations in the order of their computation, each with one real scale, which the quantizer derives from
/// their ranges.
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
    pub(crate) fn record(&mut self, activation: &str, values: &[f32]) {
        let largest = &mut self.largest[index_of(activation)];
        *largest = values.iter().fold(*largest, |m, x| m.max(x.abs()));
    }

    /// Largest magnitude seen of an activation, real units.
    ///
    /// # Panics
    /// If [`ACTIVATIONS`] does not list it.
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
    /// Add values of an activation.
    ///
    /// # Panics
    /// If [`ACTIVATIONS`] does not list it.
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
    /// Real value of one unit of each activation, as
    /// [`activation_scales`](crate::quantize::activation_scales) gives them; all are there.
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
