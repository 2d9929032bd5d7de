//! The values of all activations of one frame, from the float network or from the integer one.

use std::collections::BTreeMap;

use slipsense::net::Observer;

use crate::reference::ACTIVATIONS;

/// Values in real units, in the order of [`ACTIVATIONS`]; sensors one after the other, in order.
#[derive(Clone, Debug, Default)]
pub struct Trace {
    values: [Vec<f32>; ACTIVATIONS.len()],
}

impl Trace {
    /// Take in values of an activation.
    ///
    /// # Panics
    /// If [`ACTIVATIONS`] does not list it.
    pub fn see(&mut self, activation: &str, values: impl IntoIterator<Item = f32>) {
        let index = ACTIVATIONS.iter().position(|&a| a == activation);
        self.values[index.expect("activations are listed")].extend(values);
    }

    /// The values of each activation.
    pub fn values(&self) -> impl Iterator<Item = &[f32]> {
        self.values.iter().map(Vec::as_slice)
    }

    /// Forget them, for the next frame.
    pub fn clear(&mut self) {
        self.values.iter_mut().for_each(Vec::clear);
    }
}

/// Looks at the integer network and writes down what its numbers stand for.
#[derive(Debug)]
pub struct IntegerTrace<'s> {
    /// Real value of one unit of each activation, as
    /// [`activation_scales`](crate::quantize::activation_scales) gives them; all are there.
    pub scales: &'s BTreeMap<String, f64>,
    /// The values so far.
    pub trace: Trace,
}

impl IntegerTrace<'_> {
    fn see_scaled<T: Copy + Into<f64>>(&mut self, activation: &str, values: &[T]) {
        let scale = self.scales[activation];
        self.trace.see(activation, values.iter().map(|&value| (value.into() * scale) as f32));
    }
}

impl Observer for IntegerTrace<'_> {
    fn record(&mut self, layer: &'static str, values: &[i16]) {
        self.see_scaled(layer, values);
    }

    fn record_residual(&mut self, block: &'static str, values: &[i32]) {
        self.see_scaled(&format!("{block}.residual"), values);
    }

    fn record_part(&mut self, block: &'static str, part: &'static str, values: &[i16]) {
        self.see_scaled(&format!("{block}.{part}"), values);
    }
}
