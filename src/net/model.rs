//! A trained network in a model file, read in place. [`Model::parse`] proves what the kernels rely on: every size fits
//! [`limits`](crate::params::limits), and no accumulator can leave `i32` for any input.

use sha2::{Digest, Sha256};

use bytemuck::AnyBitPattern;

use super::format::{
    Dims, FORMAT_VERSION, HASH_BYTES, HEADER_BYTES, Kind, MAGIC, OperatingPoint, TENSORS, TensorSpec, lay_out,
};
use super::model_error::ModelError;
use super::packing::{self, Inputs};
use crate::fixed::Logit;
use crate::simd::{LayerParams, halves};

#[cfg(not(target_endian = "little"))]
compile_error!("a model file is little endian and read in place");

/// A dense layer or a convolution.
#[derive(Clone, Copy, Debug)]
pub struct Layer<'a> {
    /// `i16`, two per word, as [`packing`] says.
    pub weights: &'a [u32],
    /// One per output channel, at the accumulator's scale; zeros up to a multiple of four.
    pub bias: &'a [i32],
    /// One per output channel, see [`scale_q32`](crate::fixed::scale_q32); zeros up to a multiple of four.
    pub multiplier: &'a [i32],
    /// What it takes.
    pub inputs: Inputs,
    /// Output channels.
    pub outputs: usize,
}

impl<'a> Layer<'a> {
    /// For a kernel.
    pub const fn params(&self) -> LayerParams<'a> {
        LayerParams { weights: self.weights, bias: self.bias, multiplier: self.multiplier }
    }

    /// Weight of `output` for input `index`, counted as the model counts them.
    pub fn weight(self, output: usize, index: usize) -> i32 {
        self.inputs.weight(index, |coefficient| self.coefficient(output, coefficient))
    }

    /// The number in the file, see [`packing`].
    fn coefficient(self, output: usize, coefficient: usize) -> i32 {
        let place = packing::place(self.inputs, output, coefficient);
        self.weights.get(place / 2).map_or(0, |&word| halves(word)[place % 2]) as i32
    }

    /// Of every output channel the largest magnitude that its accumulator can reach for any input of the layer's
    /// [`magnitude`](Inputs::magnitude): `gain · Σ|w| · magnitude + |bias|`.
    pub fn accumulator_bounds(self) -> impl Iterator<Item = i64> + 'a {
        let inputs = self.inputs;
        let most = inputs.gain() as i64 * inputs.magnitude() as i64;
        self.bias.iter().take(self.outputs).enumerate().map(move |(output, &bias)| {
            let sum: i64 = (0..inputs.count()).map(|index| (self.weight(output, index) as i64).abs()).sum();
            sum * most + (bias as i64).abs()
        })
    }

    /// The first output whose coefficients are not those of its weights.
    fn bad_kernel(self) -> Option<usize> {
        (0..self.outputs).find(|&output| {
            (0..self.inputs.coefficients()).any(|coefficient| {
                let meant = self.inputs.coefficient(coefficient, |index| self.weight(output, index));
                meant != self.coefficient(output, coefficient)
            })
        })
    }

    /// Are all numbers zero that belong to no output and no input?
    fn is_padded_with_zeros(self) -> bool {
        let all: i64 = self.weights.iter().flat_map(|&word| halves(word)).map(|w| (w as i64).abs()).sum();
        let inputs = self.inputs.coefficients();
        let named = (0..self.outputs).flat_map(|output| (0..inputs).map(move |index| (output, index)));
        let named: i64 = named.map(|(output, index)| (self.coefficient(output, index) as i64).abs()).sum();
        let behind = |values: &[i32]| values.iter().skip(self.outputs).all(|&value| value == 0);
        all == named && behind(self.bias) && behind(self.multiplier)
    }
}

/// LayerNorm with its affine part.
#[derive(Clone, Copy, Debug, Default)]
pub struct Norm<'a> {
    /// From the activation that is added to the residual sum to the sum's scale, 1/2^16: 0 to 2^15.
    pub residual: i32,
    /// Gain of each channel.
    pub gamma: &'a [i16],
    /// Offset of each channel, at the scale of `gamma · 2^-11`.
    pub beta: &'a [i32],
    /// To the output's scale.
    pub multiplier: i32,
    /// Added to the variance, in squared units of the residual sum.
    pub epsilon: u64,
}

impl<'a> Norm<'a> {
    /// Of every channel the largest magnitude that gain and offset together can reach.
    pub fn accumulator_bounds(self) -> impl Iterator<Item = i64> + 'a {
        let affine = self.gamma.iter().zip(self.beta.iter());
        affine.map(|(&gamma, &beta)| (gamma as i64).abs() * ACTIVATION_MAX + (beta as i64).abs())
    }
}

/// Learned score offset per head and lag, log2 units with 10 fraction bits.
#[derive(Clone, Copy, Debug, Default)]
pub struct LagBias<'a> {
    values: &'a [i16],
    window: usize,
}

impl<'a> LagBias<'a> {
    /// `values`: `window` offsets of each head, head after head.
    pub const fn new(values: &'a [i16], window: usize) -> Self {
        Self { values, window }
    }

    /// Offsets of one head, lag 0 first.
    #[inline]
    pub fn head(self, head: usize) -> &'a [i16] {
        self.values.get(head * self.window..(head + 1) * self.window).unwrap_or_default()
    }
}

/// One attention block.
#[derive(Clone, Copy, Debug)]
pub struct Attention<'a> {
    /// The prefix of its layers' names, such as `temporal`.
    pub name: &'static str,
    /// Projection of the asking frame.
    pub query: Layer<'a>,
    /// Projection of the frames attended to.
    pub key: Layer<'a>,
    /// What is taken from them.
    pub value: Layer<'a>,
    /// Projection of the context; its multiplier leads to the residual sum's scale.
    pub out: Layer<'a>,
    /// Heads of equal width.
    pub heads: usize,
    /// From a product of query and key to log2 units with 10 fraction bits.
    pub score_multiplier: i32,
    /// Offset by lag.
    pub bias: LagBias<'a>,
    /// After the residual.
    pub norm: Norm<'a>,
}

/// A checked model file.
#[derive(Clone, Copy, Debug)]
#[expect(missing_docs, reason = "the fields are named after what they are")]
pub struct Model<'a> {
    pub dims: Dims,
    /// When the flag is up.
    pub point: OperatingPoint,
    pub conv: [Layer<'a>; 3],
    /// Taxel features to the embedding.
    pub piezo_dense: Layer<'a>,
    /// Causal convolution over time, then two layers within the frame.
    pub xl: [Layer<'a>; 3],
    /// Piezo asks, accelerometer answers.
    pub cross_piezo: Attention<'a>,
    /// Accelerometer asks, piezo answers.
    pub cross_xl: Attention<'a>,
    /// The fused vector over its own past.
    pub temporal: Attention<'a>,
    pub head: Layer<'a>,
    /// How the model was made: UTF-8 JSON.
    pub provenance: &'a str,
    /// SHA-256 of the file: the model's identity.
    pub hash: [u8; HASH_BYTES],
}

impl<'a> Model<'a> {
    /// Read a model file, which must start at a multiple of four bytes in memory, and prove its bounds.
    // Once in a firmware, which calls it from several places.
    #[inline(never)]
    pub fn parse(bytes: &'a [u8]) -> Result<Self, ModelError> {
        let mut rest = Bytes(bytes);
        if rest.take(MAGIC.len(), "header", "magic").map_err(|_| ModelError::BadMagic)? != MAGIC {
            return Err(ModelError::BadMagic);
        }
        let found = rest.u16("version")?;
        if found != FORMAT_VERSION {
            return Err(ModelError::UnknownVersion { found });
        }
        let header = rest.u16("length")?;
        if header as usize != HEADER_BYTES {
            return Err(ModelError::BadHeader { bytes: header });
        }
        let mut fields = [0; Dims::FIELDS.len()];
        for (field, name) in fields.iter_mut().zip(Dims::FIELDS) {
            *field = rest.u16(name)? as usize;
        }
        let dims = Dims::from_fields(fields).map_err(ModelError::BadDimension)?;
        let point = rest.operating_point()?;

        let mut specs = [TensorSpec::NONE; TENSORS];
        lay_out(&dims, &mut specs);
        let mut data: [&[u8]; TENSORS] = [&[]; TENSORS];
        for (data, spec) in data.iter_mut().zip(&specs) {
            *data = rest.take(spec.padded_bytes(), spec.layer, spec.part)?;
        }
        let length = rest.take(4, "provenance", "length")?;
        let length = length.iter().rev().fold(0usize, |n, &byte| n << 8 | byte as usize);
        let padded = length.checked_next_multiple_of(4).unwrap_or(usize::MAX);
        let text = rest.take(padded, "provenance", "text")?;
        let provenance = core::str::from_utf8(text.get(..length).unwrap_or_default())
            .map_err(|_| ModelError::BadProvenance)?;
        let hashed = bytes.get(..bytes.len() - rest.0.len()).unwrap_or_default();
        let stored = rest.take(HASH_BYTES, "hash", "sha-256")?;
        if !rest.0.is_empty() {
            return Err(ModelError::TrailingBytes { count: rest.0.len() });
        }
        let hash: [u8; HASH_BYTES] = Sha256::digest(hashed).into();
        if hash != stored {
            return Err(ModelError::HashMismatch);
        }

        let mut tensors = Tensors { entries: specs.iter().zip(&data) };
        Ok(Self {
            dims,
            point,
            conv: [tensors.layer()?, tensors.layer()?, tensors.layer()?],
            piezo_dense: tensors.layer()?,
            xl: [tensors.layer()?, tensors.layer()?, tensors.layer()?],
            cross_piezo: tensors.attention("cross_piezo", &dims)?,
            cross_xl: tensors.attention("cross_xl", &dims)?,
            temporal: tensors.attention("temporal", &dims)?,
            head: tensors.layer()?,
            provenance,
            hash,
        })
    }
}

/// Bytes at an address where [`Model::parse`] can read them.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(4))]
pub struct Aligned<B: ?Sized>(pub B);

/// Largest magnitude of an `i16` activation.
pub const ACTIVATION_MAX: i64 = 1 << 15;

/// What is left of the file.
struct Bytes<'a>(&'a [u8]);

impl<'a> Bytes<'a> {
    fn take(
        &mut self,
        count: usize,
        layer: &'static str,
        part: &'static str,
    ) -> Result<&'a [u8], ModelError> {
        let (taken, rest) = self.0.split_at_checked(count).ok_or(ModelError::Truncated { layer, part })?;
        self.0 = rest;
        Ok(taken)
    }

    fn u16(&mut self, part: &'static str) -> Result<u16, ModelError> {
        let bytes = self.take(2, "header", part)?;
        Ok(bytes.iter().rev().fold(0, |n, &byte| n << 8 | byte as u16))
    }

    /// The operating point and the zeros behind it.
    fn operating_point(&mut self) -> Result<OperatingPoint, ModelError> {
        let bytes = self.take(8, "header", "operating point")?;
        let &[t0, t1, t2, t3, k, n, ..] = bytes else {
            return Err(ModelError::Truncated { layer: "header", part: "operating point" });
        };
        let point =
            OperatingPoint { threshold: Logit::from_bits(i32::from_le_bytes([t0, t1, t2, t3])), k, n };
        point.check().map_err(ModelError::BadOperatingPoint)?;
        Ok(point)
    }
}

/// The tensors in file order, handed to the layers they belong to.
struct Tensors<'s, 'a> {
    entries: core::iter::Zip<core::slice::Iter<'s, TensorSpec>, core::slice::Iter<'s, &'a [u8]>>,
}

impl<'a> Tensors<'_, 'a> {
    /// The next tensor, padding included; `layout` has as many as are asked for.
    fn next<T: AnyBitPattern>(&mut self) -> Result<(TensorSpec, &'a [T]), ModelError> {
        let (spec, data) =
            self.entries.next().map_or((TensorSpec::NONE, &[][..]), |(&spec, &data)| (spec, data));
        let numbers = bytemuck::try_cast_slice(data).map_err(|_| ModelError::Misaligned)?;
        Ok((spec, numbers))
    }

    /// The next tensor without what is behind its numbers.
    fn numbers<T: AnyBitPattern>(&mut self) -> Result<(TensorSpec, &'a [T]), ModelError> {
        let (spec, padded) = self.next()?;
        Ok((spec, padded.get(..spec.len()).unwrap_or_default()))
    }

    fn layer(&mut self) -> Result<Layer<'a>, ModelError> {
        let (spec, weights) = self.next()?;
        let (_, bias) = self.next()?;
        let (scale, multiplier) = self.next()?;
        let inputs = match spec.kind {
            Kind::Weights(inputs) => inputs,
            _ => Inputs::Vector { count: spec.cols },
        };
        let words = packing::len(inputs, spec.rows) / 2;
        let weights = weights.get(..words).unwrap_or_default();
        let layer = Layer { weights, bias, multiplier, inputs, outputs: spec.rows };
        if let Some(channel) = layer.bad_kernel() {
            return Err(ModelError::BadKernel { layer: spec.layer, channel });
        }
        check_bounds(spec.layer, layer.accumulator_bounds())?;
        check_least(&scale, multiplier, 0)?;
        if !layer.is_padded_with_zeros() {
            return Err(ModelError::BadPadding { layer: spec.layer });
        }
        Ok(layer)
    }

    /// A tensor of one number, at least `least`.
    fn scalar(&mut self, least: i32) -> Result<i32, ModelError> {
        let (spec, values) = self.numbers()?;
        check_least(&spec, values, least)?;
        Ok(values.first().copied().unwrap_or_default())
    }

    fn attention(&mut self, name: &'static str, dims: &Dims) -> Result<Attention<'a>, ModelError> {
        let [query, key, value, out] = [self.layer()?, self.layer()?, self.layer()?, self.layer()?];
        let score_multiplier = self.scalar(0)?;
        let (_, values) = self.numbers()?;
        let residual = self.scalar(0)?;
        let (_, gamma) = self.numbers()?;
        let (beta_spec, beta) = self.numbers()?;
        let multiplier = self.scalar(0)?;
        let epsilon = self.scalar(1)?.max(1).unsigned_abs() as u64;
        let norm = Norm { residual, gamma, beta, multiplier, epsilon };
        check_bounds(beta_spec.layer, norm.accumulator_bounds())?;
        let bias = LagBias::new(values, dims.window);
        Ok(Attention { name, query, key, value, out, heads: dims.heads, score_multiplier, bias, norm })
    }
}

/// The bound of every output channel must fit an `i32`: then so does every partial sum, for any input.
fn check_bounds(layer: &'static str, bounds: impl Iterator<Item = i64>) -> Result<(), ModelError> {
    for (channel, bound) in bounds.enumerate() {
        if bound > i32::MAX as i64 {
            return Err(ModelError::AccumulatorOverflow { layer, channel, bound });
        }
    }
    Ok(())
}

fn check_least(spec: &TensorSpec, values: &[i32], least: i32) -> Result<(), ModelError> {
    for (channel, &value) in values.iter().enumerate() {
        if value < least {
            return Err(ModelError::BadScale { layer: spec.layer, part: spec.part, channel, value });
        }
    }
    Ok(())
}
