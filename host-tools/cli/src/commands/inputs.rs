//! What `SPLIT_OR_DIR` on the command line means.

use std::path::Path;

use anyhow::{Result, bail};
use slipsense_bench::source::Input;
use slipsense_synth::Split;

/// The episodes of a folder, or of a split's frozen set, to be generated while they are used. A split is looked
/// for in `data` first.
pub(super) fn input(input: &str, data: Option<&Path>) -> Result<Input> {
    if let Some(data) = data {
        if !data.is_dir() {
            bail!("--data {}: no such folder, looked for {input} in it", data.display());
        }
        if data.join(input).is_dir() {
            return Input::folder(input, &data.join(input));
        }
    }
    let folder = Path::new(input);
    if !folder.exists() {
        if let Ok(split) = input.parse::<Split>() {
            let frozen = split.frozen()?;
            return Ok(Input::recipes(
                input,
                frozen.episodes.into_iter().map(|e| (e.name, e.recipe)).collect(),
            ));
        }
        let names = Split::ALL.map(Split::name).join(", ");
        bail!("{input}: no such folder, and no split ({names})");
    }
    let name = folder.file_name().map_or_else(|| input.into(), |name| name.to_string_lossy());
    Input::folder(&name, folder)
}

/// All of them; no two may have one name.
pub(super) fn inputs(named: &[String], data: Option<&Path>) -> Result<Vec<Input>> {
    let inputs = named.iter().map(|name| input(name, data)).collect::<Result<Vec<Input>>>()?;
    for (i, input) in inputs.iter().enumerate() {
        if inputs[..i].iter().any(|other| other.name == input.name) {
            bail!("two inputs are called {}; rename one", input.name);
        }
    }
    Ok(inputs)
}
