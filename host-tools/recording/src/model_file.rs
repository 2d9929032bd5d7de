//! The writing half of [`slipsense::net::format`], for the exporter, for what changes a file and for tests, and
//! what a file costs to run ([`cost`]).

use sha2::{Digest, Sha256};
use slipsense::net::format::{
    Dims, FORMAT_VERSION, HEADER_BYTES, Kind, MAGIC, OperatingPoint, TENSORS, TensorSpec, layout,
};
use slipsense::net::packing::{self, Inputs};
use slipsense::net::{Model, ModelError};

pub mod cost;
mod random;

pub use random::random_model;

/// Key, in a model's provenance, of the real value of one unit of every activation.
pub const SCALES_KEY: &str = "scales";

/// A model file in the making: dimensions, operating point, provenance and every tensor as plain integers.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ModelFile {
    dims: Dims,
    /// When the alarm sounds; [`OperatingPoint::EVEN`] if not set.
    pub point: OperatingPoint,
    /// How the model was made: JSON text.
    pub provenance: String,
    tensors: Vec<Vec<i32>>,
}

impl ModelFile {
    /// All tensors zero; `provenance` is JSON text.
    pub fn new(dims: Dims, provenance: impl Into<String>) -> Self {
        let tensors = layout(&dims).iter().map(|spec| vec![0; spec.len()]).collect();
        Self { dims, point: OperatingPoint::EVEN, provenance: provenance.into(), tensors }
    }

    /// Read a file that [`Model::parse`] accepts; [`to_bytes`](Self::to_bytes) gives the same bytes again.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, ModelError> {
        let model = Model::parse(bytes)?;
        let mut file = Self::new(model.dims, model.provenance);
        file.point = model.point;
        let mut rest = &bytes[HEADER_BYTES..];
        for (spec, tensor) in layout(&model.dims).iter().zip(&mut file.tensors) {
            let (padded, behind) = rest.split_at(spec.padded_bytes());
            *tensor = read_tensor(spec, padded);
            rest = behind;
        }
        Ok(file)
    }

    pub fn dims(&self) -> &Dims {
        &self.dims
    }

    /// What tensors there are, in file order.
    pub fn specs(&self) -> [TensorSpec; TENSORS] {
        layout(&self.dims)
    }

    /// What the weights of a layer, such as `"piezo.conv1"`, are for.
    ///
    /// # Panics
    /// As [`tensor`](Self::tensor).
    pub fn inputs(&self, layer: &str) -> Inputs {
        match self.specs()[self.index(layer, "weight")].kind {
            Kind::Weights(inputs) => inputs,
            Kind::I16 | Kind::I32 => unreachable!("the layout has weights under that name"),
        }
    }

    /// The numbers of a tensor, such as `("piezo.conv1", "weight")`, row by row.
    ///
    /// # Panics
    /// If there is no tensor of that name: names come from the layout, not from users.
    pub fn tensor(&self, layer: &str, part: &str) -> &[i32] {
        &self.tensors[self.index(layer, part)]
    }

    /// The same, to be written.
    ///
    /// # Panics
    /// As [`tensor`](Self::tensor).
    pub fn tensor_mut(&mut self, layer: &str, part: &str) -> &mut Vec<i32> {
        let index = self.index(layer, part);
        &mut self.tensors[index]
    }

    fn index(&self, layer: &str, part: &str) -> usize {
        let index = self.specs().iter().position(|spec| spec.layer == layer && spec.part == part);
        index.unwrap_or_else(|| panic!("the model file has no tensor {layer} {part}"))
    }

    /// The file's bytes. Fails, naming the tensor, where a number, or what the file has in place of weights, does not
    /// fit its storage or a tensor has the wrong length; bounds and the operating point are for [`Model::parse`] to check.
    pub fn to_bytes(&self) -> Result<Vec<u8>, String> {
        let mut out = Vec::new();
        out.extend(MAGIC);
        out.extend(FORMAT_VERSION.to_le_bytes());
        out.extend((HEADER_BYTES as u16).to_le_bytes());
        for field in self.dims.to_fields() {
            out.extend((field as u16).to_le_bytes());
        }
        out.extend(self.point.threshold.to_bits().to_le_bytes());
        out.extend([self.point.k, self.point.n]);
        pad(&mut out);
        for (spec, tensor) in self.specs().iter().zip(&self.tensors) {
            write_tensor(spec, tensor, &mut out)?;
        }
        let length = u32::try_from(self.provenance.len()).map_err(|_| "provenance too long")?;
        out.extend(length.to_le_bytes());
        out.extend(self.provenance.bytes());
        pad(&mut out);
        let hash = Sha256::digest(&out);
        out.extend(hash);
        Ok(out)
    }
}

fn write_tensor(spec: &TensorSpec, tensor: &[i32], out: &mut Vec<u8>) -> Result<(), String> {
    let name = || format!("{} {}", spec.layer, spec.part);
    if tensor.len() != spec.len() {
        return Err(format!("{} has {} numbers, the layout has {}", name(), tensor.len(), spec.len()));
    }
    let mut stored = vec![0; spec.padded_bytes()];
    let mut put = |place: usize, what: &str, index: usize, value: i32| {
        if !matches!(spec.kind, Kind::I32) && i16::try_from(value).is_err() {
            return Err(format!("{}{what} {index} is {value}, does not fit 16 bits", name()));
        }
        let width = spec.kind.bytes();
        stored[place * width..][..width].copy_from_slice(&value.to_le_bytes()[..width]);
        Ok(())
    };
    match spec.kind {
        Kind::Weights(inputs) => {
            for (output, row) in tensor.chunks_exact(spec.cols.max(1)).enumerate() {
                for index in 0..inputs.coefficients() {
                    let value = inputs.coefficient(index, |input| row[input]);
                    let what = if inputs.coefficients() == spec.cols { "" } else { " coefficient" };
                    let place = packing::place(inputs, output, index);
                    put(place, what, output * inputs.coefficients() + index, value)?;
                }
            }
        }
        Kind::I16 | Kind::I32 => {
            tensor.iter().enumerate().try_for_each(|(index, &value)| put(index, "", index, value))?;
        }
    }
    out.extend(stored);
    Ok(())
}

fn read_tensor(spec: &TensorSpec, bytes: &[u8]) -> Vec<i32> {
    let width = spec.kind.bytes();
    let number = |place: usize| match bytes[place * width..][..width] {
        [a, b] => i32::from(i16::from_le_bytes([a, b])),
        [a, b, c, d] => i32::from_le_bytes([a, b, c, d]),
        _ => unreachable!("a number has 2 or 4 bytes"),
    };
    let weight = |inputs: Inputs, index: usize| {
        let output = index / spec.cols;
        inputs.weight(index % spec.cols, |coefficient| number(packing::place(inputs, output, coefficient)))
    };
    let one = |index| match spec.kind {
        Kind::Weights(inputs) => weight(inputs, index),
        Kind::I16 | Kind::I32 => number(index),
    };
    (0..spec.len()).map(one).collect()
}

fn pad(out: &mut Vec<u8>) {
    out.resize(out.len().next_multiple_of(4), 0);
}
