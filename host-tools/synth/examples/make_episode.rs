//! Generate one episode: `make_episode OUT.npz RECIPE`, where RECIPE is the JSON text of a recipe, for
//! example `'{"seed":1,"scenario":"six_step","speed_mm_s":10}'`.

use std::error::Error;

fn main() -> Result<(), Box<dyn Error>> {
    let mut args = std::env::args().skip(1);
    let (Some(file), Some(recipe)) = (args.next(), args.next()) else {
        return Err("usage: make_episode OUT.npz RECIPE".into());
    };
    let episode = slipsense_synth::generate(&serde_json::from_str(&recipe)?)?;
    episode.write(&file)?;
    println!("{file}: {} frames of {}", episode.frames(), episode.meta.other["scenario"]);
    Ok(())
}
