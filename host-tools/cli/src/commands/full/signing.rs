//! `slipsense keygen`, `sign` and `image`: keys, what boards take over the bus, and what is in it.

use std::fs::{self, File, OpenOptions};
use std::io::{ErrorKind, Write};
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, anyhow, ensure};
use clap::{Subcommand, ValueEnum};
use ed25519_dalek::{Signer, SigningKey};
use serde::Serialize;
use serde_json::json;
use sha2::{Digest, Sha256};
use slipsense::net::Model;
use slipsense::net::format::MAGIC as MODEL_MAGIC;
use slipsense::node::{CHALLENGE_BYTES, UNLOCK_PREFIX, UpdateTarget};
use slipsense::params::limits::MODEL_BYTES;
use slipsense::update::partitions::{FLASH_BASE, NUCLEO_H743ZI2, Partitions, TRAILER_BYTES};
use slipsense::update::{DEVELOPMENT_KEY, DEVELOPMENT_SEED, HEADER_BYTES, Header, ImageVersion, Refusal};
use slipsense_recording::{firmware_elf, from_hex};

use super::Print;
use crate::output::{check_file, write_file};
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
pub struct KeygenArgs {
    /// Where the private half goes; a file that is there is not overwritten
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    #[command(flatten)]
    print: Print,
}

impl KeygenArgs {
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
    let (name, file) = (path.display(), options.open(path));
    let is_there = file.as_ref().is_err_and(|error| error.kind() == ErrorKind::AlreadyExists);
    ensure!(!is_there, "{name}: exists already, and a key is not overwritten");
    file.with_context(|| format!("{name}: cannot write"))
}

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
pub struct SignArgs {
    /// Firmware (ELF or binary) or model file
    #[arg(value_name = "FILE", required_unless_present = "challenge")]
    file: Option<PathBuf>,
    /// Sign the challenge of a locked board, 64 hexadecimal digits, and print the signature
    #[arg(long, value_name = "HEX", value_parser = bytes_of("challenge"), conflicts_with_all = ["file", "board", "version", "out"])]
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

impl SignArgs {
    pub fn run(self) -> Result<()> {
        let development = || Ok(SigningKey::from_bytes(&DEVELOPMENT_SEED));
        let key = self.key.as_deref().map_or_else(development, read_key)?;
        let (Some(file), Some(version), Some(out)) = (&self.file, self.version, &self.out) else {
            let challenge = self.challenge.unwrap_or_default();
            let signature = hex(&key.sign(&[&UNLOCK_PREFIX[..], &challenge].concat()).to_bytes());
            return self.print.show(&json!({"signature": signature}), || format!("{signature}\n"));
        };
        let name = file.display().to_string();
        let bytes = fs::read(file).with_context(|| format!("{name}: cannot read"))?;
        let (header, payload) = header_for(&bytes, &name, self.board, version)?;
        let signature = key.sign(&header.signed_bytes()).to_bytes();
        let image = [&header.encode(&signature)[..], &payload].concat();
        let info = ImageInfo::new(&image, &out.display().to_string(), Some(key.verifying_key().to_bytes()))?;
        check_file(out)?;
        write_file(out, &image)?;
        info.print(&self.print)
    }
}

#[derive(Clone, Copy, ValueEnum)]
enum Board {
    /// NUCLEO-H743ZI2
    H743,
}

impl Board {
    fn partitions(self) -> &'static Partitions {
        match self {
            Self::H743 => &NUCLEO_H743ZI2,
        }
    }
}

fn read_key(path: &Path) -> Result<SigningKey> {
    let name = path.display();
    let text = fs::read_to_string(path).with_context(|| format!("{name}: cannot read the key"))?;
    let seed = from_hex(text.trim());
    let seed = seed.with_context(|| format!("{name}: is not a key: a key has 64 hexadecimal digits"))?;
    Ok(SigningKey::from_bytes(&seed))
}

/// The header of a payload, checked as far as a computer can; `name` is the file it came from.
fn header_for(
    file: &[u8],
    name: &str,
    board: Option<Board>,
    version: ImageVersion,
) -> Result<(Header, Vec<u8>)> {
    let is_model = file.starts_with(&MODEL_MAGIC);
    let (target, payload, room) = if is_model {
        Model::parse(file).with_context(|| format!("{name}: refused as a model"))?;
        (UpdateTarget::Model, file.to_vec(), MODEL_BYTES as u32)
    } else {
        let board =
            board.with_context(|| format!("{name}: a firmware is for one board: --board says which"))?;
        let partitions = board.partitions();
        let payload = match firmware_elf::is_elf(file) {
            true => firmware_elf::flatten(file, name, partitions)?,
            false => file.to_vec(),
        };
        check_vectors(&payload, name, partitions)?;
        (UpdateTarget::Firmware, payload, partitions.active.bytes() - TRAILER_BYTES)
    };
    let (bytes, kind) = (payload.len(), target.name());
    ensure!(bytes <= room as usize, "{name}: {bytes} bytes, a board has room for a {kind} of {room}");
    let sha256 = Sha256::digest(&payload).into();
    let board = board.map_or(0, |board| board.partitions().id);
    let header = Header { target, board, version, length: bytes as u32, sha256 };
    Ok((header, payload))
}

/// Its reset vector must point into the slot.
fn check_vectors(payload: &[u8], name: &str, board: &Partitions) -> Result<()> {
    let reset = payload.get(4..8).and_then(|bytes| bytes.try_into().ok()).map_or(0, u32::from_le_bytes);
    let begin = FLASH_BASE + board.active.start;
    ensure!(
        (begin..begin + payload.len() as u32).contains(&reset) && reset % 2 == 1,
        "{name}: is not a firmware of the {}: it would start at {reset:#x}, its slot at {begin:#x}",
        board.label
    );
    Ok(())
}

/// Look into a signed image
#[derive(clap::Args)]
#[command(after_help = "\
Examples:
  slipsense image info firmware.slip
  slipsense image info firmware.slip --public-key 3f… --json | jq .signature")]
pub struct ImageArgs {
    #[command(subcommand)]
    what: What,
}

#[derive(Subcommand)]
enum What {
    Info(InfoArgs),
}

/// Say what an image is, for which board, of which version, whether it is whole and who signed it
///
/// With --public-key it is an error if the image is not whole or not signed by this key.
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
struct InfoArgs {
    /// The image
    #[arg(value_name = "IMAGE")]
    file: PathBuf,
    /// The key that the signature is to be by, as `slipsense keygen` printed it
    #[arg(long, value_name = "HEX", value_parser = bytes_of("public key"))]
    public_key: Option<[u8; 32]>,
    #[command(flatten)]
    print: Print,
}

impl ImageArgs {
    pub fn run(self) -> Result<()> {
        let What::Info(args) = self.what;
        let name = args.file.display().to_string();
        let image = fs::read(&args.file).with_context(|| format!("{name}: cannot read"))?;
        let info = ImageInfo::new(&image, &name, args.public_key)?;
        let named = args.public_key.is_some();
        ensure!(!named || info.signature == "valid", "{name}: not signed by the key of --public-key");
        ensure!(!named || info.whole, "{name}: the payload is not what the header says");
        info.print(&args.print)
    }
}

/// Parser of an option that is 32 bytes.
fn bytes_of(what: &'static str) -> impl Fn(&str) -> Result<[u8; 32], String> + Clone {
    move |text| from_hex(text).ok_or_else(|| format!("a {what} has 64 hexadecimal digits"))
}

/// What an image says of itself, and whether it is true.
#[derive(Serialize)]
struct ImageInfo {
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
    fn new(image: &[u8], name: &str, key: Option<[u8; 32]>) -> Result<Self> {
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

    fn print(&self, printer: &Print) -> Result<()> {
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
