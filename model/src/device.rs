//! What runs the tensor library: the cores of this computer, or a graphics processor.

use anyhow::Result;
use burn::tensor::{Device, Tensor, TensorData};
use clap::ValueEnum;
use serde::{Deserialize, Serialize};

/// Where tensors are. Convolutions over the taxels of our own networks run on the CPU in any case.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum DeviceName {
    /// The cores of this computer
    #[default]
    Cpu,
    /// A graphics processor, by Vulkan, Metal, DirectX 12 or OpenGL; in a build with the feature `gpu`
    Gpu,
}

impl DeviceName {
    /// A plain device; an error without a graphics processor, or in a build that cannot use one.
    pub fn open(self) -> Result<Device> {
        match self {
            Self::Cpu => Ok(Device::flex()),
            Self::Gpu => gpu(),
        }
    }

    /// As tables have it.
    pub(crate) const fn name(self) -> &'static str {
        match self {
            Self::Cpu => "CPU",
            Self::Gpu => "GPU",
        }
    }
}

/// Is this device, plain or with gradients, the CPU.
pub(crate) fn is_cpu(device: &Device) -> bool {
    device.clone().inner() == Device::flex()
}

/// All numbers of a tensor, the last axis the fastest.
pub(crate) fn numbers<const D: usize>(tensor: Tensor<D>) -> Vec<f32> {
    tensor.into_data().iter::<f32>().collect()
}

pub(crate) fn tensor<const D: usize>(values: Vec<f32>, shape: [usize; D], device: &Device) -> Tensor<D> {
    Tensor::from_data(TensorData::new(values, shape), device)
}

#[cfg(feature = "gpu")]
fn gpu() -> Result<Device> {
    use std::sync::OnceLock;

    // A process can open it once.
    static OPEN: OnceLock<Result<Device, String>> = OnceLock::new();
    let open = OPEN.get_or_init(|| match Device::wgpu_options().init_with_setup() {
        Ok((device, setup)) => {
            let about = setup.adapter.get_info();
            eprintln!("GPU: {} ({})", about.name, about.backend);
            Ok(device)
        }
        Err(error) => Err(format!("--device gpu: no graphics processor can be used: {error}")),
    });
    open.clone().map_err(anyhow::Error::msg)
}

#[cfg(not(feature = "gpu"))]
fn gpu() -> Result<Device> {
    anyhow::bail!(
        "--device gpu: this command was built without it; build it with --features gpu instead of train"
    )
}
