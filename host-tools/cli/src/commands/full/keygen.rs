//! `slipsense keygen`: a key to sign updates with.

use std::fs::{File, OpenOptions};
use std::io::Write;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, anyhow, bail};
use ed25519_dalek::SigningKey;
use serde_json::json;

use super::Print;
use crate::summary::hex;

/// Make a key to sign updates with
///
/// The private half goes into the file, which only its owner may read: whoever has it can put a firmware onto every
/// board that believes it, and without it no update can be signed. The public half is printed; firmware and bootloader
/// are built with it in the environment variable SLIPSENSE_UPDATE_KEY.
#[derive(clap::Args)]
#[command(after_help = "\
Examples:
  slipsense keygen --out fleet.key
  SLIPSENSE_UPDATE_KEY=$(slipsense keygen --out fleet.key --json | jq -r .public_key) cargo build-h743")]
pub struct Args {
    /// Where the private half goes; a file that is there is not overwritten
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    #[command(flatten)]
    print: Print,
}

impl Args {
    pub fn run(self) -> Result<()> {
        let mut seed = [0; 32];
        getrandom::fill(&mut seed).map_err(|error| anyhow!("no random numbers from the system: {error}"))?;
        let public_key = hex(SigningKey::from_bytes(&seed).verifying_key().as_bytes());
        let mut file = new_private_file(&self.out)?;
        writeln!(file, "{}", hex(&seed)).with_context(|| format!("{}: cannot write", self.out.display()))?;
        let out = self.out.display().to_string();
        self.print.show(&json!({"private_key_file": out, "public_key": public_key}), || {
            format!(
                "private key  {out}\npublic key   {public_key}\n\n\
                 Build firmware and bootloader with SLIPSENSE_UPDATE_KEY={public_key}\n"
            )
        })
    }
}

/// A file that was not there, for its owner only.
fn new_private_file(path: &Path) -> Result<File> {
    let mut options = OpenOptions::new();
    options.write(true).create_new(true);
    #[cfg(unix)]
    std::os::unix::fs::OpenOptionsExt::mode(&mut options, 0o600);
    match options.open(path) {
        Ok(file) => Ok(file),
        Err(error) if error.kind() == std::io::ErrorKind::AlreadyExists => {
            bail!("{}: exists already, and a key is not overwritten", path.display())
        }
        Err(error) => Err(error).with_context(|| format!("{}: cannot write", path.display())),
    }
}
