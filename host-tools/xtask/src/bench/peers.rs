//! Kernels of other libraries: those in Rust and the FFT of CMSIS-DSP are measured; of the others in C, which need
//! sources that no registry of ours has, the figures are an earlier measurement.

use serde::Serialize;

use super::emulated::Kernel;

/// Where a figure is from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub enum Source {
    #[serde(rename = "this run")]
    ThisRun,
    #[serde(rename = "committed figure: QEMU mps2-an500, gcc 12.2 -O3")]
    Committed,
}

impl Source {
    pub fn name(self) -> &'static str {
        match self {
            Self::ThisRun => "this run",
            Self::Committed => "committed, same emulator, gcc 12.2 -O3",
        }
    }
}

/// A kernel of another library.
#[derive(Clone, Debug, Serialize)]
pub struct Peer {
    #[serde(flatten)]
    pub kernel: Kernel,
    pub source: Source,
}

/// Name, multiply-accumulates, instructions. Convolutions requantize and clamp; they do not pool.
const COMMITTED: [(&str, u32, u32); 14] = [
    ("CMSIS-NN s8: conv 3x3 32x32x1->8", 73_728, 1_055_300),
    ("CMSIS-NN s8: conv 3x3 16x16x8->16", 294_912, 851_233),
    ("CMSIS-NN s8: conv 3x3 8x8x16->32", 294_912, 631_937),
    ("CMSIS-NN s8: max-pool of 32x32x8", 0, 106_834),
    ("CMSIS-NN s8: max-pool of 16x16x16", 0, 44_258),
    ("CMSIS-NN s8: max-pool of 8x8x32", 0, 19_978),
    ("CMSIS-NN s8: dense 512->128", 65_536, 129_360),
    ("CMSIS-NN s8: dense 128->128", 16_384, 37_200),
    ("CMSIS-NN s16x8: conv 3x3 16x16x8->16", 294_912, 896_296),
    ("CMSIS-NN s16x8: conv 3x3 8x8x16->32", 294_912, 705_556),
    ("CMSIS-NN s16x8: dense 512->128", 65_536, 162_378),
    ("CMSIS-NN s16, by table: softmax 4x60", 0, 12_753),
    ("CMSIS-DSP: rfft_q15 128", 0, 3_979),
    ("TFLM micro frontend: log-mel of one axis, 128/16", 0, 20_650),
];

/// Those that the emulated program measured.
pub fn of_this_run(measured: Vec<Kernel>) -> Vec<Peer> {
    measured.into_iter().map(|kernel| Peer { kernel, source: Source::ThisRun }).collect()
}

/// Those of an earlier measurement.
pub fn committed() -> impl Iterator<Item = Peer> {
    COMMITTED.iter().map(|&(name, macs, instructions)| Peer {
        kernel: Kernel { name: name.to_owned(), macs, instructions },
        source: Source::Committed,
    })
}
