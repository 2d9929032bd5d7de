//! `slipsense sign`: from a firmware or a model to the image that a board takes over the bus.

use std::path::PathBuf;

use anyhow::{Context, Result};
use ed25519_dalek::SigningKey;
use slipsense::update::{DEVELOPMENT_SEED, ImageVersion};

use super::Print;
use super::image::ImageInfo;
use crate::output::{check_file, write_file};
use crate::signing::{Board, header_for, read_key, sign};

/// Sign a firmware or a model, so that boards take it over the bus
///
/// What the file is, it says itself: a model file is a model, everything else a firmware, as ELF or as the bytes of its
/// slot. A model is checked as the board checks it; a firmware must be linked for the board's slot. Boards refuse a
/// version below the one they have.
#[derive(clap::Args)]
#[command(after_help = "\
Examples:
  slipsense sign target/thumbv7em-none-eabihf/firmware/slipsense-firmware --board h743 \\
      --version 1.2.0 --key fleet.key --out firmware.slip
  slipsense sign mine.slipnet --version 1.0.0 --key fleet.key --out model.slip      for any board
  slipsense sign mine.slipnet --version 1.0.0 --development-key --out model.slip    for firmware built without a key")]
pub struct Args {
    /// Firmware (ELF or binary) or model file
    #[arg(value_name = "FILE")]
    file: PathBuf,
    /// The board it is for; a model without this is for any
    #[arg(long)]
    board: Option<Board>,
    /// MAJOR.MINOR.PATCH
    #[arg(long)]
    version: ImageVersion,
    /// Private key, from `slipsense keygen`
    #[arg(long, value_name = "FILE", required_unless_present = "development_key")]
    key: Option<PathBuf>,
    /// Sign with the development key, which everybody has
    #[arg(long, conflicts_with = "key")]
    development_key: bool,
    /// The image
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    #[command(flatten)]
    print: Print,
}

impl Args {
    pub fn run(self) -> Result<()> {
        let name = self.file.display().to_string();
        let file = std::fs::read(&self.file).with_context(|| format!("{name}: cannot read"))?;
        let key = match &self.key {
            Some(path) => read_key(path)?,
            None => SigningKey::from_bytes(&DEVELOPMENT_SEED),
        };
        let (header, payload) = header_for(&file, &name, self.board, self.version)?;
        let image = sign(&key, &header, &payload);
        let out = self.out.display().to_string();
        let info = ImageInfo::new(&image, &out, Some(key.verifying_key().to_bytes()))?;
        check_file(&self.out)?;
        write_file(&self.out, &image)?;
        info.print(&self.print)
    }
}
