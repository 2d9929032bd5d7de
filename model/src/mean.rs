//! Mean weights of several trainings.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};
use serde_json::{Value, json};

use crate::output;
use crate::train::{RECORD, WEIGHTS};
use crate::weights::Weights;

/// Write the mean weights of the trainings in `folders`, and of what they are the mean, to the folder `out`.
/// Returns the weights' path. All must have the same sizes and the same validation and test objects.
pub fn mean_of(folders: &[PathBuf], out: &Path) -> Result<PathBuf> {
    let mut trainings = Vec::new();
    let mut all = Vec::new();
    for folder in folders {
        let path = folder.join(RECORD);
        let record: Value =
            output::read_json(&path)?.with_context(|| format!("{} is missing", path.display()))?;
        trainings.push(record);
        all.push(Weights::read(&folder.join(WEIGHTS))?);
    }
    let (Some(first), Some(record)) = (all.first(), trainings.first()) else {
        anyhow::bail!("a mean needs a training");
    };
    let objects = record["recipe"].get("objects").cloned();
    for ((folder, weights), record) in folders.iter().zip(&all).zip(&trainings) {
        let [sizes, wanted] = [weights, first].map(|weights| weights.dims.to_fields());
        ensure!(sizes == wanted, "{}: sizes are {sizes:?}, of the first {wanted:?}", folder.display());
        ensure!(
            record["recipe"].get("objects") == objects.as_ref(),
            "{}: its objects for training, validation and test are not those of the first",
            folder.display()
        );
    }
    let mean = Weights::mean(&all);
    let hashes: Vec<&Value> = trainings.iter().map(|record| &record["weights_sha256"]).collect();
    let mut recipe = json!({ "mean_of_sha256": hashes });
    if let Some(objects) = objects {
        recipe["objects"] = objects;
    }
    let record = json!({
        "recipe": recipe,
        "trainings": trainings,
        "parameters": mean.count(),
        "weights_sha256": output::sha256_hex(&mean.to_bytes()?),
    });
    let path = out.join(WEIGHTS);
    std::fs::create_dir_all(out).with_context(|| format!("cannot make {}", out.display()))?;
    mean.write(&path)?;
    output::write_json(&out.join(RECORD), &record)?;
    Ok(path)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::weights::dims_of_size;

    fn training(place: &Path, name: &str, size: usize, seed: u64, recipe: Value) -> PathBuf {
        let folder = place.join(name);
        std::fs::create_dir(&folder).unwrap();
        let weights = Weights::init(dims_of_size(size), seed);
        weights.write(&folder.join(WEIGHTS)).unwrap();
        let record =
            json!({"recipe": recipe, "weights_sha256": output::sha256_hex(&weights.to_bytes().unwrap())});
        output::write(&folder.join(RECORD), record.to_string().as_bytes()).unwrap();
        folder
    }

    #[test]
    fn each_number_is_the_mean_and_the_record_says_of_what() {
        let place = tempfile::tempdir().unwrap();
        let folders: Vec<_> = [1, 2, 3]
            .map(|seed| training(place.path(), &seed.to_string(), 1, seed, json!({"objects": "o"})))
            .into();
        let out = place.path().join("new").join("mean");
        let mean = Weights::read(&mean_of(&folders, &out).unwrap()).unwrap();
        let all: Vec<_> =
            folders.iter().map(|folder| Weights::read(&folder.join(WEIGHTS)).unwrap()).collect();
        for (tensor, values) in mean.tensors.iter().enumerate() {
            for (index, value) in values.iter().enumerate() {
                let [a, b, c] = [0, 1, 2].map(|one: usize| f64::from(all[one].tensors[tensor][index]));
                assert_eq!(*value, ((a + b + c) / 3.0) as f32);
            }
        }
        let record: Value = output::read_json(&out.join(RECORD)).unwrap().unwrap();
        assert_eq!(record["recipe"]["objects"], "o");
        for (training, hash) in all.iter().zip(record["recipe"]["mean_of_sha256"].as_array().unwrap()) {
            assert_eq!(hash, &output::sha256_hex(&training.to_bytes().unwrap()));
        }
        assert_eq!(record["trainings"].as_array().unwrap().len(), 3);
    }

    #[test]
    fn what_has_no_mean_is_refused_by_name_and_nothing_is_written() {
        let place = tempfile::tempdir().unwrap();
        let first = training(place.path(), "first", 1, 1, json!({}));
        let large = training(place.path(), "large", 2, 1, json!({}));
        let others = training(place.path(), "others", 1, 1, json!({"objects": "o"}));
        for (other, said) in
            [(large, "large: sizes"), (others, "others: its objects"), ("no".into(), "train.json is missing")]
        {
            let error = mean_of(&[first.clone(), other], &place.path().join("out")).unwrap_err();
            assert!(format!("{error:#}").contains(said), "{error:#}");
        }
        assert!(!place.path().join("out").exists());
    }
}
