//! What a model costs, counted by hand.

use slipsense::net::Model;
use slipsense::net::format::Dims;
use slipsense_recording::model_file::ModelFile;
use slipsense_recording::model_file::cost::{LayerCost, layers, macs_per_frame};

/// Small enough to count by hand.
const SMALL: Dims =
    Dims { conv_channels: [1, 2, 3], embed: 4, xl_kernel: 2, xl_channels: 5, heads: 2, window: 7 };

fn small() -> ModelFile {
    let mut file = ModelFile::new(SMALL, "{}");
    for block in ["cross_piezo", "cross_xl", "temporal"] {
        file.tensor_mut(&format!("{block}.norm"), "epsilon")[0] = 1;
    }
    file
}

fn of<'l>(layers: &'l [LayerCost], name: &str) -> &'l LayerCost {
    layers.iter().find(|layer| layer.name == name).unwrap()
}

#[test]
fn macs_and_bytes_by_hand() {
    let bytes = small().to_bytes().unwrap();
    let layers = layers(&Model::parse(&bytes).unwrap());
    assert_eq!(layers.len(), 7 + 3 * 6 + 1);
    // Weights are four outputs side by side and two inputs per word, four numbers for the three of a kernel's column;
    // bias and multiplier of four outputs follow.
    let expected = [
        ("piezo.conv1", [1, 18], 32 * 32 * 18, 4 * 12 * 4 + 16 + 16),
        ("piezo.conv2", [2, 9], 16 * 16 * 18, 4 * 24 * 4 + 16 + 16),
        ("piezo.conv3", [3, 18], 8 * 8 * 54, 4 * 24 * 4 + 16 + 16),
        ("piezo.dense", [4, 48], 192, 4 * 32 * 4 + 16 + 16),
        ("xl.conv", [5, 64], 320, 8 * 32 * 4 + 32 + 32),
        // Inputs come by sixteens.
        ("xl.mix1", [5, 5], 25, 8 * 8 * 4 + 32 + 32),
        ("xl.mix2", [4, 5], 20, 4 * 8 * 4 + 16 + 16),
        ("cross_piezo.query", [4, 4], 16, 4 * 8 * 4 + 16 + 16),
        // 2 heads of 2 columns, 7 lags, once for the score and once for the value.
        ("cross_xl.score", [2, 7], 2 * 2 * 2 * 7, 16 + 32),
        ("temporal.score", [2, 7], 2 * 2 * 4 * 7, 16 + 32),
        ("temporal.norm", [1, 8], 0, 16 + 16 + 32 + 16 + 16),
        ("head", [4, 8], 32, 4 * 8 * 4 + 16 + 16),
    ];
    for (name, shape, macs, bytes) in expected {
        let layer = of(&layers, name);
        assert_eq!((layer.shape, layer.macs, layer.bytes), (shape, macs, bytes), "{name}");
    }
    // Encoders: 18432 + 4608 + 3456 + 192 + 320 + 25 + 20. The rest, once: 2 · (64 + 56) + 256 + 112 + 32.
    assert_eq!(macs_per_frame(&layers, 1), 27_053 + 640);
    assert_eq!(macs_per_frame(&layers, 3), 3 * 27_053 + 640);
    // What is not a layer: header, length and text of the provenance, hash.
    let of_layers: usize = layers.iter().map(|layer| layer.bytes).sum();
    assert_eq!(bytes.len() - of_layers, 36 + 4 + 4 + 32);
}

#[test]
fn head_room_by_hand() {
    let mut file = small();
    // 2 · 32768 · 64 + 0 = 2^22: nine bits are left.
    file.tensor_mut("xl.mix1", "weight")[..2].copy_from_slice(&[64, -64]);
    // Every product at most 127 · 32768, and the offset on top.
    file.tensor_mut("head", "weight").fill(-127);
    file.tensor_mut("head", "bias")[2] = -1_000_000_000;
    file.tensor_mut("cross_xl.norm", "gamma")[3] = -16_384;
    let bytes = file.to_bytes().unwrap();
    let layers = layers(&Model::parse(&bytes).unwrap());
    assert_eq!(of(&layers, "xl.mix1").head_room_bits(), 9.0);
    assert_eq!(of(&layers, "head").bound, 8 * 127 * 32_768 + 1_000_000_000);
    assert_eq!(of(&layers, "cross_xl.norm").head_room_bits(), 2.0);
    assert_eq!(of(&layers, "xl.conv").head_room_bits(), 31.0, "all weights are zero");
    // Weights of 2^15 in sum and values of 16 bits: just over 2^30.
    let score = of(&layers, "temporal.score").head_room_bits();
    assert!((0.99..1.0).contains(&score), "{score}");
}
