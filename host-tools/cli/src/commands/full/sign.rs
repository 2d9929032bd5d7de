//! `slipsense sign`: from a firmware or a model to the image that a board takes over the bus.

use std::path::PathBuf;

use anyhow::{Context, Result};
use ed25519_dalek::{Signer, SigningKey};
use serde_json::json;
use slipsense::node::{CHALLENGE_BYTES, UNLOCK_PREFIX};
use slipsense::update::{DEVELOPMENT_SEED, ImageVersion};
use slipsense_recording::from_hex;

use super::Print;
use super::image::ImageInfo;
use crate::output::{check_file, write_file};
use crate::signing::{Board, header_for, read_key};
use crate::summary::hex;

/// Sign a firmware or a model, so that boards take it over the bus
///
/// What the file is, it says itself: a model file is a model, everything else a firmware, as ELF or as the bytes of its
/// slot. A model is checked as the board checks it; a firmware must be linked for the board's slot. Boards refuse a
/// version below the one they have. With --challenge, prints the signature that unlocks a locked board instead.
#[derive(clap::Args)]
#[command(after_help = "\
Examples:
  slipsense sign target/thumbv7em-none-eabihf/firmware/slipsense-firmware --board h743 \\
      --version 1.2.0 --key fleet.key --out firmware.slip
  slipsense sign mine.slipnet --version 1.0.0 --key fleet.key --out model.slip      for any board
  slipsense sign mine.slipnet --version 1.0.0 --development-key --out model.slip    for firmware built without a key
  slipsense sign --challenge 3132...00 --key fleet.key      64 bytes for ExecuteCommand 2, of slipsense.lock.challenge")]
pub struct Args {
    /// Firmware (ELF or binary) or model file
    #[arg(value_name = "FILE", required_unless_present = "challenge")]
    file: Option<PathBuf>,
    /// Sign the challenge of a locked board, 64 hexadecimal digits, and print the signature
    #[arg(long, value_name = "HEX", value_parser = challenge, conflicts_with_all = ["file", "board", "version", "out"])]
    challenge: Option<[u8; CHALLENGE_BYTES]>,
    /// The board it is for; a model without this is for any
    #[arg(long)]
    board: Option<Board>,
    /// MAJOR.MINOR.PATCH
    #[arg(long, required_unless_present = "challenge")]
    version: Option<ImageVersion>,
    /// Private key, from `slipsense keygen`
    #[arg(long, value_name = "FILE", required_unless_present = "development_key")]
    key: Option<PathBuf>,
    /// Sign with the development key, which everybody has
    #[arg(long, conflicts_with = "key")]
    development_key: bool,
    /// The image
    #[arg(long, value_name = "FILE", required_unless_present = "challenge")]
    out: Option<PathBuf>,
    #[command(flatten)]
    print: Print,
}

impl Args {
    pub fn run(self) -> Result<()> {
        let key = match &self.key {
            Some(path) => read_key(path)?,
            None => SigningKey::from_bytes(&DEVELOPMENT_SEED),
        };
        let (Some(file), Some(version), Some(out)) = (&self.file, self.version, &self.out) else {
            let challenge = self.challenge.unwrap_or_default();
            let signature = hex(&key.sign(&[&UNLOCK_PREFIX[..], &challenge].concat()).to_bytes());
            return self.print.show(&json!({"signature": signature}), || format!("{signature}\n"));
        };
        let name = file.display().to_string();
        let bytes = std::fs::read(file).with_context(|| format!("{name}: cannot read"))?;
        let (header, payload) = header_for(&bytes, &name, self.board, version)?;
        let signature = key.sign(&header.signed_bytes()).to_bytes();
        let image = [&header.encode(&signature)[..], &payload].concat();
        let info = ImageInfo::new(&image, &out.display().to_string(), Some(key.verifying_key().to_bytes()))?;
        check_file(out)?;
        write_file(out, &image)?;
        info.print(&self.print)
    }
}

fn challenge(text: &str) -> Result<[u8; CHALLENGE_BYTES], String> {
    from_hex(text).ok_or_else(|| "a challenge has 64 hexadecimal digits".to_owned())
}
