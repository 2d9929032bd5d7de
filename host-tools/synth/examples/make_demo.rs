//! Make the demo episode again from the recipe beside it:
//! `cargo run --release -p slipsense-synth --example make_demo`.

use std::path::Path;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let demo = Path::new(env!("CARGO_MANIFEST_DIR")).join("../cli/demo");
    let recipe = std::fs::read_to_string(demo.join("recipe.json"))?;
    let episode = slipsense_synth::generate(&serde_json::from_str(&recipe)?)?;
    let file = demo.join("episode.npz");
    episode.write(&file)?;
    println!("{}: {} bytes, {} frames", file.display(), std::fs::metadata(&file)?.len(), episode.frames());
    Ok(())
}
