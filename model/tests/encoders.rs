//! The paper's encoders against published implementations (tests/python/make_encoder_vectors.py). Weights and inputs
//! follow from names, so that the file holds outputs only.

use burn::module::Module;
use burn::tensor::{Device, Tensor, TensorData};
use serde_json::Value;
use slipsense::params::{MEL_BINS, TAXEL_COLS, TAXEL_ROWS, TAXELS};
use slipsense_model::encoders::named::{self, Named, Numbers};
use slipsense_model::encoders::{CausalCnn, EMBED, MaskedPatches, Mlp, ResNet18, Ssast, VitMae};

const LARGEST_ERROR: f64 = 1e-4;

/// Numbers from -1 to 1: FNV-1a of the name, then splitmix64 of the place.
fn value(name: &str, count: usize) -> Vec<f32> {
    let hash = |seed: u64, byte: u8| (seed ^ u64::from(byte)).wrapping_mul(0x100_0000_01b3);
    let seed = name.bytes().fold(0xcbf2_9ce4_8422_2325, hash);
    let draw = |place: usize| {
        let mut z = seed.wrapping_add((place as u64 + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15));
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        (((z ^ (z >> 31)) >> 40) as f64 / f64::from(1 << 23) - 1.0) as f32
    };
    (0..count).map(draw).collect()
}

fn filled<M: Module>(module: M) -> M {
    let mut named = named::get(&module);
    for (name, Numbers { shape, values }) in &mut named {
        let part = name.rsplit('.').next().unwrap();
        let inputs = if shape.len() == 2 { shape[0] } else { shape[1..].iter().product() };
        let (middle, half) = match part {
            "weight" => (0.0, (3.0 / inputs as f32).sqrt()),
            "running_var" => (1.0, 0.5),
            "gamma" => (1.0, 0.1),
            _ => (0.0, 0.1),
        };
        *values = value(name, values.len()).into_iter().map(|x| middle + half * x).collect();
    }
    named::put(module, &named)
}

fn tensor<const D: usize>(values: Vec<f32>, shape: [usize; D]) -> Tensor<D> {
    Tensor::from_data(TensorData::new(values, shape), &Device::flex())
}

fn numbers(value: &Value) -> Vec<f64> {
    match value {
        Value::Array(parts) => parts.iter().flat_map(numbers).collect(),
        number => vec![number.as_f64().expect("a number")],
    }
}

fn assert_near<const D: usize>(what: &str, ours: Tensor<D>, expected: &Value) {
    let ours: Vec<f32> = ours.into_data().iter::<f32>().collect();
    let expected = numbers(expected);
    assert_eq!(ours.len(), expected.len(), "{what}");
    let size = expected.iter().fold(0f64, |largest, x| largest.max(x.abs()));
    let error = ours.iter().zip(&expected).map(|(&x, y)| (f64::from(x) - y).abs()).fold(0.0, f64::max);
    println!("{what}: {} numbers up to {size:.3}, off by {error:.1e} at most", ours.len());
    assert!(error < LARGEST_ERROR && size > 0.1, "{what}");
}

fn vectors(of: &str) -> Value {
    let file = include_str!("../../tests/vectors/encoder_vectors.json");
    let mut file: Value = serde_json::from_str(file).expect("the vectors are JSON");
    file[of].take()
}

#[test]
fn the_mlp_drops_in_training_alone_and_by_its_seed() {
    let named = named::get(&filled(Mlp::new(&Device::flex())));
    let run = |device: Device, seed: u64| {
        let frames = TensorData::new(value("frames", 8 * MEL_BINS), [1, 8, MEL_BINS]);
        let embedded =
            named::put(Mlp::new(&device), &named).forward(Tensor::from_data(frames, &device), seed);
        embedded.into_data().iter::<f32>().collect::<Vec<_>>()
    };
    let training = |seed| run(Device::flex().autodiff(), seed);
    assert_eq!(training(1), training(1));
    assert_ne!(training(1), training(2));
    assert_ne!(training(1), run(Device::flex(), 1));
    assert_eq!(run(Device::flex(), 1), run(Device::flex(), 2));
}

#[test]
fn resnet18_is_torchvisions_of_one_channel() {
    let expected = vectors("resnet18");
    let resnet = filled(ResNet18::new(&Device::flex()));
    // Running statistics are not trained.
    let statistics = named::get(&resnet).into_iter().filter(|(name, _)| name.contains("running"));
    let statistics: usize = statistics.map(|(_, numbers)| numbers.values.len()).sum();
    assert_eq!(resnet.num_params() - statistics, expected["parameters"]);
    let scans = tensor(value("scans", 2 * TAXELS), [2, 1, TAXEL_ROWS, TAXEL_COLS]);
    assert_near("ResNet-18", resnet.forward(scans), &expected["embedding"]);
}

#[test]
fn vit_mae_is_that_of_transformers() {
    let expected = vectors("vit_mae");
    let mae = filled(VitMae::new(&Device::flex()));
    assert_eq!(mae.num_params(), expected["parameters"]);
    assert_eq!(mae.vit.num_params(), expected["encoder_parameters"]);
    let scans = || tensor(value("scans", 2 * TAXELS), [2, TAXELS]);
    assert_near("ViT, class token", mae.vit.forward(scans()), &expected["embedding"]);
    let order =
        numbers(&expected["order"]).chunks(64).map(|row| row.iter().map(|&p| p as usize).collect()).collect();
    let masked = MaskedPatches { order, shown: 16 };
    let patches = mae.reconstruct(scans(), &masked);
    for (at, expected) in expected["patches"].as_object().unwrap() {
        let ours = patches.clone().narrow(1, at.parse().unwrap(), 1);
        assert_near(&format!("ViT-MAE, patch {at}"), ours, expected);
    }
    assert_near("ViT-MAE, loss", mae.loss(scans(), &masked), &expected["loss"]);
}

#[test]
fn ssast_tiny_is_an_ast_of_transformers() {
    let expected = vectors("ssast");
    let ssast = filled(Ssast::new(&Device::flex()));
    // Without the projection to the embedding, which is the paper's.
    assert_eq!(ssast.num_params() - (192 + 1) * EMBED, expected["parameters"]);
    let hidden = ssast.hidden(tensor(value("frames", 60 * MEL_BINS), [1, 60, MEL_BINS]), false);
    for (at, expected) in expected["hidden"].as_object().unwrap() {
        let ours = hidden.clone().narrow(1, at.parse().unwrap(), 1);
        assert_near(&format!("SSAST-Tiny, token {at}"), ours, expected);
    }
}

#[test]
fn no_encoder_of_frames_sees_what_is_still_to_come() {
    let device = Device::flex();
    let (ssast, cnn, mlp) =
        (filled(Ssast::new(&device)), filled(CausalCnn::new(&device)), filled(Mlp::new(&device)));
    let encoders: [(&str, &dyn Fn(Tensor<3>) -> Tensor<3>); 3] =
        [("SSAST", &|x| ssast.stream(x)), ("CNN", &|x| cnn.forward(x)), ("MLP", &|x| mlp.forward(x, 0))];
    let frames = value("frames", 100 * MEL_BINS);
    let all = |values: &[f32]| tensor(values.to_vec(), [1, values.len() / MEL_BINS, MEL_BINS]);
    for (name, embed) in encoders {
        let whole = embed(all(&frames));
        assert_eq!(whole.dims(), [1, 100, EMBED]);
        for end in [1, 45, 61, 93] {
            let short = embed(all(&frames[..end * MEL_BINS]));
            let off = (short - whole.clone().narrow(1, 0, end)).abs().max().into_scalar::<f32>();
            assert!(off < 1e-4, "{name}, {end} frames: {off}");
        }
        let mut late = frames.clone();
        late[95 * MEL_BINS..].fill(0.0);
        let off = (embed(all(&late)) - whole).abs().max().into_scalar::<f32>();
        assert!(off > 1e-3, "{name}: {off}");
    }
}

/// A file as the authors', of numbers that tell where they come from.
fn authors() -> Named {
    let mut file = Named::new();
    let mut put = |name: &str, shape: &[usize]| {
        let name = format!("module.v.{name}");
        let values = value(&name, shape.iter().product()).into_iter().map(|x| 0.05 * x).collect();
        file.insert(name, Numbers { shape: shape.to_vec(), values });
    };
    for token in ["cls_token", "dist_token"] {
        put(token, &[1, 1, 192]);
    }
    put("pos_embed", &[1, 514, 192]);
    put("patch_embed.proj.weight", &[192, 1, 128, 2]);
    let mut layer = |name: &str, shape: &[usize]| {
        put(&format!("{name}.weight"), shape);
        put(&format!("{name}.bias"), &shape[..1]);
    };
    layer("norm", &[192]);
    for block in 0..12 {
        for (part, shape) in [
            ("norm1", &[192][..]),
            ("norm2", &[192]),
            ("attn.qkv", &[576, 192]),
            ("attn.proj", &[192, 192]),
            ("mlp.fc1", &[768, 192]),
            ("mlp.fc2", &[192, 768]),
        ] {
            layer(&format!("blocks.{block}.{part}"), shape);
        }
    }
    file
}

#[test]
fn the_authors_file_is_taken_over_and_another_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("ssast.safetensors");
    let write = |file: &Named| std::fs::write(&path, named::to_bytes(file).unwrap()).unwrap();
    let load = || named::first(Ssast::new(&Device::flex()), 1).with_authors(&path);
    write(&authors());
    let ours = named::get(&load().unwrap());
    let theirs = authors();
    let (qkv, key) = (&theirs["module.v.blocks.7.attn.qkv.weight"], &ours["encoder.layers.7.mha.key.weight"]);
    assert_eq!(key.values[3 * 192 + 5], qkv.values[(192 + 5) * 192 + 3], "turned");
    let positions = &theirs["module.v.pos_embed"].values;
    let middle = (2 + 256 - 30) * 192;
    assert_eq!(ours["positions"].values[2 * 192..], positions[middle..middle + 60 * 192]);
    assert_eq!(ours["encoder.layers.0.norm_2.gamma"].values, theirs["module.v.blocks.0.norm1.weight"].values);
    let first = named::get(&named::first(Ssast::new(&Device::flex()), 1));
    let same: Vec<&str> =
        ours.iter().filter(|(name, numbers)| first[*name] == **numbers).map(|(name, _)| &name[..]).collect();
    assert_eq!(same, ["out.bias", "out.weight", "patch.bias", "patch.weight"]);

    let error = || format!("{:#}", load().unwrap_err());
    let refused = |end: &str| assert!(error().ends_with(end), "{}", error());
    let mut base = authors();
    base.get_mut("module.v.cls_token").unwrap().shape = vec![1, 192];
    write(&base);
    refused("tensor v.cls_token has shape [1, 192], must be [1, 1, 192] for SSAST-Tiny");
    let mut base = authors();
    base.remove("module.v.blocks.11.mlp.fc2.bias");
    write(&base);
    refused("tensor v.blocks.11.mlp.fc2.bias is missing: not SSAST-Tiny");
    std::fs::write(&path, b"PK\x03\x04 a state dict").unwrap();
    assert!(error().contains("not a safetensors file") && !error().contains('\n'), "{}", error());
    std::fs::remove_file(&path).unwrap();
    assert!(error().starts_with("cannot read "), "{}", error());
}
