//! Keys and payloads of signed images, for `sign`, `keygen` and `image info`.

use std::fs;
use std::path::Path;

use anyhow::{Context, Result, anyhow, bail, ensure};
use clap::ValueEnum;
use ed25519_dalek::SigningKey;
use serde::Serialize;
use sha2::{Digest, Sha256};
use slipsense::net::Model;
use slipsense::net::format::MAGIC as MODEL_MAGIC;
use slipsense::node::UpdateTarget;
use slipsense::update::partitions::{FLASH_BASE, NUCLEO_H743ZI2, Partitions, TRAILER_BYTES};
use slipsense::update::{HEADER_BYTES, Header, ImageVersion};
use slipsense_recording::{firmware_elf, from_hex};

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum, Serialize)]
pub enum Board {
    /// NUCLEO-H743ZI2
    H743,
}

impl Board {
    pub fn partitions(self) -> &'static Partitions {
        match self {
            Self::H743 => &NUCLEO_H743ZI2,
        }
    }
}

pub fn read_key(path: &Path) -> Result<SigningKey> {
    let text =
        fs::read_to_string(path).with_context(|| format!("{}: cannot read the key", path.display()))?;
    let seed = from_hex(text.trim())
        .ok_or_else(|| anyhow!("{}: is not a key: a key has 64 hexadecimal digits", path.display()))?;
    Ok(SigningKey::from_bytes(&seed))
}

pub fn public_key(text: &str) -> Result<[u8; 32], String> {
    from_hex(text).ok_or_else(|| "a public key has 64 hexadecimal digits".to_owned())
}

/// The header of a payload, checked as far as a computer can; `name` is the file it came from.
pub fn header_for(
    file: &[u8],
    name: &str,
    board: Option<Board>,
    version: ImageVersion,
) -> Result<(Header, Vec<u8>)> {
    let is_model = file.starts_with(&MODEL_MAGIC);
    let (target, payload, room) = if is_model {
        Model::parse(file).with_context(|| format!("{name}: refused as a model"))?;
        let room = board.unwrap_or(Board::H743).partitions().model.bytes() - HEADER_BYTES as u32;
        (UpdateTarget::Model, file.to_vec(), room)
    } else {
        let Some(board) = board else {
            bail!("{name}: a firmware is for one board: --board says which");
        };
        let partitions = board.partitions();
        let payload = if firmware_elf::is_elf(file) {
            firmware_elf::flatten(file, name, partitions)?
        } else {
            file.to_vec()
        };
        check_vectors(&payload, name, partitions)?;
        (UpdateTarget::Firmware, payload, partitions.active.bytes() - TRAILER_BYTES)
    };
    let (bytes, kind) = (payload.len(), target.name());
    ensure!(bytes <= room as usize, "{name}: {bytes} bytes, the slot of a {kind} has room for {room}");
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
