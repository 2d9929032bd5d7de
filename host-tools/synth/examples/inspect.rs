//! Write a generated episode: `inspect OUT.npz RECIPE.json` or `inspect OUT.npz SEED`.
fn main() -> Result<(), Box<dyn std::error::Error>> {
    let args: Vec<String> = std::env::args().collect();
    let recipe = match args[2].parse::<u64>() {
        Ok(seed) => slipsense_synth::Recipe::new(seed),
        Err(_) => serde_json::from_str(&args[2])?,
    };
    let t = std::time::Instant::now();
    let e = slipsense_synth::generate(&recipe)?;
    eprintln!("{} s of {} in {:?}", e.frames() as f64 / 240.0, e.meta.other["scenario"], t.elapsed());
    e.write(&args[1])?;
    Ok(())
}
