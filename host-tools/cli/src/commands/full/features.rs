//! `slipsense features`: the front end alone.

use std::path::PathBuf;

use anyhow::Result;
use serde_json::json;
use slipsense::features::XlFrontEnd;
use slipsense::params::MEL_BINS;
use slipsense_recording::npz::write_file;
use slipsense_recording::{Episode, logmel_g2, logmel_std};

use super::Print;
use crate::output::check_file;

/// Write the log-mel features of an episode's accelerometers
///
/// High-pass, 128-sample window, FFT, power summed over the axes, 16 mel bins, logarithm,
/// standardisation: integers, as the microcontroller computes them.
#[derive(clap::Args)]
#[command(after_help = "\
Arrays written, float32 [frames, sensors, 16]:
  logmel      natural log of the axis-summed mel power, in g²
  logmel_std  the same standardised over its 16 bins, what the network sees

Example:
  slipsense features grasp.npz --out features.npz
  python3 -c \"import numpy; print(numpy.load('features.npz')['logmel'].shape)\"")]
pub struct Args {
    /// Episode to read, an .npz file
    #[arg(value_name = "EPISODE.npz")]
    episode: PathBuf,
    /// File to write
    #[arg(long, value_name = "F.npz")]
    out: PathBuf,
    #[command(flatten)]
    print: Print,
}

impl Args {
    pub fn run(self) -> Result<()> {
        check_file(&self.out)?;
        let episode = Episode::read(&self.episode)?;
        let (frames, sensors) = (episode.frames(), episode.sensors);
        let mut front_ends = vec![XlFrontEnd::new(); sensors];
        let (mut logmel, mut standardised) = (Vec::new(), Vec::new());
        self.print.progress(frames, "frames", |bar| {
            for frame in 0..frames {
                for (sensor, front_end) in front_ends.iter_mut().enumerate() {
                    front_end.push(episode.xl_batch(frame, sensor));
                    let features = front_end.log_mel();
                    logmel.extend(logmel_g2(&features, episode.meta.xl_lsb_g));
                    standardised.extend(logmel_std(&features));
                }
                bar.inc(1);
            }
        });
        let shape = [frames, sensors, MEL_BINS];
        write_file(&self.out, |npz| {
            npz.array("logmel", &shape, logmel)?;
            npz.array("logmel_std", &shape, standardised)
        })?;
        let out = self.out.display().to_string();
        self.print.show(&json!({"file": out, "shape": shape}), || {
            format!("{frames} frames of {sensors} sensors, {MEL_BINS} bins each: {out}\n")
        })
    }
}
