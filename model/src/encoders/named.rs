//! A module's numbers by the path of their parameter, `encoder.layers.0.norm_1.gamma`: first values, averages, files.

use std::collections::BTreeMap;
use std::path::Path;

use anyhow::{Context, Result, ensure};
use burn::module::{Module, ModuleMapper, ModuleVisitor, Param};
use burn::tensor::{Tensor, TensorData};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use safetensors::{Dtype, SafeTensors};

use crate::weights::approach;
use crate::{output, tensors_file};

#[derive(Clone, Debug, Default, PartialEq)]
pub struct Numbers {
    pub shape: Vec<usize>,
    pub values: Vec<f32>,
}

pub type Named = BTreeMap<String, Numbers>;

/// All of a module's, running statistics included.
pub fn get(module: &impl Module) -> Named {
    #[derive(Default)]
    struct Get {
        path: Vec<String>,
        named: Named,
    }
    impl ModuleVisitor for Get {
        fn enter_module(&mut self, name: &str, _: &str) {
            self.path.push(name.to_owned());
        }
        fn exit_module(&mut self, _: &str, _: &str) {
            self.path.pop();
        }
        fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
            let shape = param.val().dims().to_vec();
            let values = param.val().into_data().iter::<f32>().collect();
            self.named.insert(self.path.join("."), Numbers { shape, values });
        }
    }
    let mut get = Get::default();
    module.visit(&mut get);
    get.named
}

/// The module with these numbers where it has such parameters; the others are left alone.
///
/// # Panics
/// If a shape is another.
pub fn put<M: Module>(module: M, named: &Named) -> M {
    struct Put<'a> {
        path: Vec<String>,
        named: &'a Named,
    }
    impl ModuleMapper for Put<'_> {
        fn enter_module(&mut self, name: &str, _: &str) {
            self.path.push(name.to_owned());
        }
        fn exit_module(&mut self, _: &str, _: &str) {
            self.path.pop();
        }
        fn map_float<const D: usize>(&mut self, param: Param<Tensor<D>>) -> Param<Tensor<D>> {
            let Some(numbers) = self.named.get(&self.path.join(".")) else { return param };
            param.map(|tensor| {
                assert_eq!(tensor.dims().to_vec(), numbers.shape, "{}", self.path.join("."));
                let data = TensorData::new(numbers.values.clone(), numbers.shape.clone());
                let new = Tensor::from_data(data, &tensor.device());
                if tensor.is_require_grad() { new.require_grad() } else { new }
            })
        }
    }
    module.map(&mut Put { path: Vec::new(), named })
}

/// The module before training: weights uniform with variance 2 / inputs, ahead of a ReLU, where they are filters, 1 /
/// inputs where they are matrices; tokens and positions small; norms neutral, biases zero.
pub fn first<M: Module>(module: M, seed: u64) -> M {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut named = get(&module);
    for (name, numbers) in &mut named {
        let part = name.rsplit('.').next().unwrap_or_default();
        let limit = match (part, &numbers.shape[..]) {
            ("weight", [inputs, _]) => (3.0 / *inputs as f32).sqrt(),
            ("weight", [_, inputs @ ..]) => (6.0 / inputs.iter().product::<usize>() as f32).sqrt(),
            (_, [_, _, _]) => 0.02,
            _ => 0.0,
        };
        let neutral = if matches!(part, "gamma" | "running_var") { 1.0 } else { 0.0 };
        let mut value = || if limit > 0.0 { rng.random_range(-limit..limit) } else { neutral };
        numbers.values.iter_mut().for_each(|x| *x = value());
    }
    put(module, &named)
}

/// Move towards `newer`, as [`Weights::average`](crate::weights::Weights::average).
pub fn average(named: &mut Named, newer: &Named, decay: f32) {
    for (mine, newer) in named.values_mut().zip(newer.values()) {
        approach(&mut mine.values, &newer.values, decay);
    }
}

pub fn to_bytes(named: &Named) -> Result<Vec<u8>> {
    let tensors = named.iter().map(|(name, Numbers { shape, values })| {
        (name.clone(), Dtype::F32, shape.clone(), tensors_file::bytes_of(values))
    });
    tensors_file::to_bytes(tensors, None)
}

/// All tensors of such a file; refuses one that is not of finite f32 numbers.
pub fn from_bytes(bytes: &[u8]) -> Result<Named> {
    let file = SafeTensors::deserialize(bytes).context("not a safetensors file")?;
    let tensors = file.tensors().into_iter().map(|(name, view)| {
        let values = tensors_file::finite(&name, &view)?;
        Ok((name, Numbers { shape: view.shape().to_vec(), values }))
    });
    tensors.collect()
}

/// A file's numbers; refuses a file that is not of exactly such a module.
pub fn read(path: &Path, module: &impl Module) -> Result<Named> {
    let named = from_bytes(&output::read(path)?).with_context(|| format!("cannot use {}", path.display()))?;
    for (name, Numbers { shape, .. }) in get(module) {
        let place = || format!("{}: tensor {name}", path.display());
        let theirs = &named.get(&name).with_context(|| format!("{} is missing", place()))?.shape;
        ensure!(*theirs == shape, "{} has shape {theirs:?}, must be {shape:?}", place());
    }
    Ok(named)
}
