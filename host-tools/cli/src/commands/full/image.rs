//! `slipsense image`: what is in a signed image.

use std::path::PathBuf;

use anyhow::{Context, Result, anyhow};
use clap::Subcommand;
use serde::Serialize;
use sha2::{Digest, Sha256};
use slipsense::update::partitions::NUCLEO_H743ZI2;
use slipsense::update::{DEVELOPMENT_KEY, HEADER_BYTES, Header, Refusal};

use super::Print;
use crate::signing::public_key;
use crate::summary::hex;

/// Look into a signed image
#[derive(clap::Args)]
#[command(after_help = "\
Examples:
  slipsense image info firmware.slip
  slipsense image info firmware.slip --public-key 3f… --json | jq .signature")]
pub struct Args {
    #[command(subcommand)]
    what: What,
}

#[derive(Subcommand)]
enum What {
    Info(InfoArgs),
}

/// Say what an image is, for which board, of which version, whether it is whole and who signed it
#[derive(clap::Args)]
#[command(after_help = "\
Signature:
  valid            by the key of --public-key
  development key  by the key that everybody has
  other key        by neither, or the header was changed
  none             unsigned

Examples:
  slipsense image info firmware.slip
  slipsense image info firmware.slip --public-key 3f… --json | jq .signature")]
pub struct InfoArgs {
    /// The image
    #[arg(value_name = "IMAGE")]
    file: PathBuf,
    /// The key that the signature is to be by, as `slipsense keygen` printed it
    #[arg(long, value_name = "HEX", value_parser = public_key)]
    public_key: Option<[u8; 32]>,
    #[command(flatten)]
    print: Print,
}

impl Args {
    pub fn run(self) -> Result<()> {
        let What::Info(args) = self.what;
        let name = args.file.display().to_string();
        let image = std::fs::read(&args.file).with_context(|| format!("{name}: cannot read"))?;
        ImageInfo::new(&image, &name, args.public_key)?.print(&args.print)
    }
}

/// What an image says of itself, and whether it is true.
#[derive(Serialize)]
pub struct ImageInfo {
    file: String,
    kind: &'static str,
    board: String,
    version: String,
    payload_bytes: u32,
    sha256: String,
    /// Is the payload what the header says?
    whole: bool,
    signature: &'static str,
}

impl ImageInfo {
    /// `key`: the public key that it is to be signed with, if one is named.
    pub fn new(image: &[u8], name: &str, key: Option<[u8; 32]>) -> Result<Self> {
        let (raw, payload) = image
            .split_first_chunk::<HEADER_BYTES>()
            .ok_or_else(|| anyhow!("{name}: {}", Refusal::ShorterThanHeader))?;
        let header = Header::inspect(raw).with_context(|| name.to_owned())?;
        let by = |key: [u8; 32]| Header::verify(raw, &[key]);
        let signature = match key.map(by) {
            Some(Ok(_)) => "valid",
            _ => match by(DEVELOPMENT_KEY) {
                Ok(_) => "development key",
                Err(Refusal::Unsigned) => "none",
                Err(_) => "other key",
            },
        };
        let board = match header.board {
            0 => "any".to_owned(),
            id if id == NUCLEO_H743ZI2.id => NUCLEO_H743ZI2.label.to_owned(),
            id => format!("unknown, {id}"),
        };
        let sha256: [u8; 32] = Sha256::digest(payload).into();
        Ok(Self {
            file: name.to_owned(),
            kind: header.target.name(),
            board,
            version: header.version.to_string(),
            payload_bytes: header.length,
            sha256: hex(&header.sha256),
            whole: payload.len() == header.length as usize && sha256 == header.sha256,
            signature,
        })
    }

    pub fn print(&self, printer: &Print) -> Result<()> {
        printer.show(self, || {
            let whole = if self.whole { "whole" } else { "NOT what the header says" };
            let payload = format!("{} bytes, {whole}", self.payload_bytes);
            let rows: [(&str, &str); 7] = [
                ("image", &self.file),
                ("kind", self.kind),
                ("board", &self.board),
                ("version", &self.version),
                ("payload", &payload),
                ("sha-256", &self.sha256),
                ("signature", self.signature),
            ];
            rows.map(|(name, value)| format!("{name:<10} {value}\n")).concat()
        })
    }
}
