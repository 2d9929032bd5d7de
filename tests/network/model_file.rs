//! What a model file must be: each rule broken once.

use super::inputs::SHAPES;
use sha2::{Digest, Sha256};
use slipsense::fixed::Logit;
use slipsense::net::format::{Dims, HEADER_BYTES, OperatingPoint};
use slipsense::net::{Model, ModelError};
use slipsense_recording::model_file::{ModelFile, random_model};

fn good() -> ModelFile {
    random_model(SHAPES[0], 1)
}

fn refusal(bytes: &[u8]) -> ModelError {
    Model::parse(bytes).expect_err("must be refused")
}

/// With the hash at the end made anew.
fn hashed(mut bytes: Vec<u8>) -> Vec<u8> {
    let (content, hash) = bytes.split_last_chunk_mut::<32>().unwrap();
    *hash = Sha256::digest(content).into();
    bytes
}

#[test]
fn a_written_file_is_read_back() {
    let mut file = good();
    file.point = OperatingPoint { threshold: Logit::from_bits(-1_234), k: 3, n: 5 };
    let bytes = file.to_bytes().unwrap();
    let model = Model::parse(&bytes).unwrap();
    assert_eq!((model.dims, model.point), (SHAPES[0], file.point));
    assert_eq!(model.provenance, "{\"random\":true}");
    let [_, conv2, _] = model.conv;
    assert_eq!(&conv2.bias[..conv2.outputs], file.tensor("piezo.conv2", "bias"));
    for (layer, name) in [(conv2, "piezo.conv2"), (model.temporal.out, "temporal.out"), (model.head, "head")]
    {
        let inputs = layer.inputs.count();
        for (index, &weight) in file.tensor(name, "weight").iter().enumerate() {
            assert_eq!(layer.weight(index / inputs, index % inputs), weight, "{name} {index}");
        }
    }
    let lag_bias: Vec<i32> = model.cross_xl.bias.head(2).iter().map(|&x| x.into()).collect();
    assert_eq!(lag_bias, &file.tensor("cross_xl.score", "bias")[120..180]);
    assert_eq!(ModelFile::from_bytes(&bytes).unwrap(), file);
    assert_eq!(Model::parse(&good().to_bytes().unwrap()).unwrap().point, OperatingPoint::EVEN);
}

#[test]
fn every_truncation_is_refused() {
    let bytes = good().to_bytes().unwrap();
    for length in (0..bytes.len()).step_by(97).chain([bytes.len() - 1]) {
        let error = refusal(&bytes[..length]);
        let expected = matches!(error, ModelError::Truncated { .. }) || length < 8;
        assert!(expected, "{length} bytes: {error}");
    }
    assert_eq!(refusal(&bytes[..50]).to_string(), "file ends inside piezo.conv1 weight");
}

#[test]
fn other_files_and_damage() {
    for other in [&b""[..], b"PK\x03\x04 not a model at all"] {
        assert_eq!(refusal(other).to_string(), "not a SlipSense model file (wrong first bytes)");
    }
    let mut bytes = good().to_bytes().unwrap();
    assert_eq!(refusal(&[&bytes[..], &[0]].concat()), ModelError::TrailingBytes { count: 1 });
    bytes[200] ^= 1;
    assert_eq!(refusal(&bytes), ModelError::HashMismatch);
    for other in [4, 9] {
        bytes[8] = other;
        let expected = format!("model format version {other} is unknown; this build reads version 6");
        assert_eq!(refusal(&bytes).to_string(), expected);
    }
}

#[test]
fn an_odd_address() {
    let bytes = good().to_bytes().unwrap();
    let mut buffer = vec![0; bytes.len() + 4];
    let start = if (buffer.as_ptr() as usize).is_multiple_of(2) { 1 } else { 2 };
    buffer[start..start + bytes.len()].copy_from_slice(&bytes);
    let refused = refusal(&buffer[start..start + bytes.len()]);
    assert_eq!(refused.to_string(), "the file does not start at a multiple of four bytes in memory");
}

#[test]
fn numbers_that_belong_to_nothing() {
    // Outputs lie side by side in fours; this layer has eleven.
    let file = random_model(SHAPES[2], 1);
    let bytes = file.to_bytes().unwrap();
    let specs = file.specs();
    let at = specs.iter().position(|spec| (spec.layer, spec.part) == ("xl.mix1", "weight")).unwrap();
    let start = HEADER_BYTES + specs[..at].iter().map(|spec| spec.padded_bytes()).sum::<usize>();
    let (weights, biases) = (specs[at].padded_bytes(), specs[at + 1].padded_bytes());
    for (offset, what) in [(weights / 3 * 2 + 12, "a weight"), (weights + biases - 4, "a bias")] {
        let mut bytes = bytes.clone();
        bytes[start + offset] = 1;
        assert_eq!(refusal(&hashed(bytes)).to_string(), "xl.mix1: the padding is not zero", "{what}");
    }
}

#[test]
fn numbers_that_no_kernel_gives() {
    let file = good();
    let bytes = file.to_bytes().unwrap();
    let conv1 = file.specs()[0];
    assert_eq!((conv1.layer, conv1.part), ("piezo.conv1", "weight"));
    // Output 1's first column: a sum, and behind the planes of sums and alternating sums twice an upper weight.
    for word in [1, 6 * 4 + 1] {
        let mut bytes = bytes.clone();
        bytes[HEADER_BYTES + 4 * word] ^= 1;
        let expected =
            "piezo.conv1 channel 1: the numbers are not sums and differences of a kernel's weights";
        assert_eq!(refusal(&hashed(bytes)).to_string(), expected);
    }
}

#[test]
fn sizes_beyond_the_limits() {
    let refused = |change: fn(&mut Dims)| {
        let mut dims = SHAPES[0];
        change(&mut dims);
        let bytes = ModelFile::new(dims, "{}").to_bytes().unwrap();
        refusal(&bytes).to_string()
    };
    assert_eq!(refused(|d| d.conv_channels[1] = 17), "conv2 channels is 17, allowed are 1 to 16");
    assert_eq!(refused(|d| d.window = 61), "window is 61, allowed are 1 to 60");
    assert_eq!(refused(|d| d.xl_kernel = 0), "accelerometer kernel is 0, allowed are 1 to 6");
    assert!(refused(|d| d.heads = 5).starts_with("heads (must divide"));
    assert!(refused(|d| d.heads = 1).contains("could overflow"));
}

/// What is said of the good file after a change, by the writer or the reader.
fn refused(change: impl FnOnce(&mut ModelFile)) -> String {
    let mut file = good();
    change(&mut file);
    file.to_bytes().map_or_else(|error| error, |bytes| refusal(&bytes).to_string())
}

/// Of all rules of an operating point: `decision`.
#[test]
fn numbers_out_of_range() {
    assert_eq!(refused(|file| file.point.k = 2), "operating point k is 2, allowed are 1 to 1");
    let set = |layer, part, index: usize, to| refused(|file| file.tensor_mut(layer, part)[index] = to);
    assert_eq!(set("xl.mix1", "multiplier", 7, -1), "xl.mix1 multiplier 7 is -1, out of range");
    assert_eq!(set("cross_xl.norm", "epsilon", 0, 0), "cross_xl.norm epsilon 0 is 0, out of range");
    assert_eq!(set("head", "weight", 4, 32_768), "head weight 4 is 32768, does not fit 16 bits");
    let coefficient = refused(|file| {
        // Twice the first weight of output 1; conv1 has four numbers for three weights of 18.
        file.tensor_mut("piezo.conv1", "weight")[18..36].fill(0);
        file.tensor_mut("piezo.conv1", "weight")[18] = 16_384;
    });
    assert_eq!(coefficient, "piezo.conv1 weight coefficient 36 is 32768, does not fit 16 bits");
}

#[test]
fn accumulators_that_could_overflow() {
    let reached = refused(|file| {
        // 127 · 256 · 32768 is half of what fits; a bias takes the rest.
        file.tensor_mut("piezo.dense", "weight")[256..512].fill(-127);
        file.tensor_mut("piezo.dense", "bias")[1] = i32::MIN + 1;
    });
    assert_eq!(reached, "piezo.dense channel 1: accumulator can reach 3212836863, more than 2147483647");
    let reached = refused(|file| {
        file.tensor_mut("temporal.norm", "gamma")[3] = 32767;
        file.tensor_mut("temporal.norm", "beta")[3] = 1 << 30 | 1 << 20;
    });
    assert!(reached.starts_with("temporal.norm channel 3: accumulator can reach"), "{reached}");
}
