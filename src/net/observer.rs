//! Records the activations inside the network, for the host's comparison with the float one. The microcontroller runs
//! with the observer `()`, which compiles to nothing.

use crate::simd::{Map, halves};

/// Gets every activation of a frame in the order of computation, sensor after sensor.
///
/// A `layer` is named as in [`super::format::layout`], where the activation is what a layer gives;
/// an embedding is called `piezo` or `xl`, the inputs `taxels` and `log_mel`, the vector that the temporal
/// block takes `fused`, the one that the head takes `hidden`. Values of one activation may come in several
/// parts.
pub trait Observer {
    /// Whether it records: else the network may skip what needs no computing.
    const ENABLED: bool = true;

    /// Activations at the scale of `layer`'s output.
    fn record(&mut self, _layer: &'static str, _values: &[i16]) {}

    /// A map of `channels` channels, value by value without the border, in row, column, channel order.
    fn record_map(&mut self, layer: &'static str, channels: usize, map: Map<'_>) {
        let shape = map.shape;
        let columns = (0..shape.side).flat_map(|row| (0..shape.side).map(move |col| (row, col)));
        for (row, col) in columns.take(if Self::ENABLED { usize::MAX } else { 0 }) {
            for channel in 0..channels {
                let word = map.words.get(shape.at(row, channel / 2, col)).copied().unwrap_or_default();
                self.record(layer, &[halves(word)[channel % 2]]);
            }
        }
    }

    /// Residual sums of the attention block `block`, at a 16th of the scale of what it was added to.
    fn record_residual(&mut self, _block: &'static str, _values: &[i32]) {}

    /// Activations of one part, `query`, `key` or `value`, of the attention block `block`.
    fn record_part(&mut self, _block: &'static str, _part: &'static str, _values: &[i16]) {}
}

/// Records nothing.
impl Observer for () {
    const ENABLED: bool = false;
}
