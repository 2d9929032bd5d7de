//! The key that images are signed with: whose signature this firmware, or this bootloader, believes.
//!
//! A build takes it from the environment variable `SLIPSENSE_UPDATE_KEY`, 64 hexadecimal digits, as `slipsense keygen`
//! prints them. Without it the development key is built in, **whose private half is public**: anybody can sign for
//! such a firmware, and it says so ([`KEY_NOTICE`]). Firmware and bootloader are built with the same.
//!
//! To change keys, build with both: `SLIPSENSE_UPDATE_KEY_NEXT` is believed too. A build with `SLIPSENSE_RELEASE` set
//! refuses the development key.

use ed25519_dalek::{Signature, VerifyingKey};

use super::Refusal;
use crate::node::{CHALLENGE_BYTES, SIGNATURE_BYTES, UNLOCK_PREFIX};
use crate::wire::bytes::Writer;

/// The private half of the development key, an Ed25519 seed. Public on purpose: it proves nothing.
pub const DEVELOPMENT_SEED: [u8; 32] = *b"slipsense development key public";

/// The public half.
pub const DEVELOPMENT_KEY: [u8; 32] =
    from_hex(b"abceffcff5e9402a4fe34a02f80d483e05b8e8b3680c2185a2d315eaa1861a91");

/// The public keys that images may be signed with, Ed25519; all are equal in rank.
pub type Keys = [[u8; 32]];

const FIRST: [u8; 32] = match option_env!("SLIPSENSE_UPDATE_KEY") {
    Some(hex) => from_hex(hex.as_bytes()),
    None => DEVELOPMENT_KEY,
};
const NEXT: Option<[u8; 32]> = match option_env!("SLIPSENSE_UPDATE_KEY_NEXT") {
    Some(hex) => Some(from_hex(hex.as_bytes())),
    None => None,
};

/// The public keys of this build: one, or two while keys change.
pub const PUBLIC_KEYS: &Keys = match NEXT {
    Some(next) => &[FIRST, next],
    None => &[FIRST],
};

/// Is the development key among them?
pub const IS_DEVELOPMENT_KEY: bool =
    matches!(FIRST, DEVELOPMENT_KEY) || matches!(NEXT, Some(DEVELOPMENT_KEY));

const _: () = assert!(
    option_env!("SLIPSENSE_RELEASE").is_none() || !IS_DEVELOPMENT_KEY,
    "a release needs a key of its own in SLIPSENSE_UPDATE_KEY: the development key's private half is public"
);

/// Did the holder of the private half of one of `keys` sign the message?
// Once in a firmware: checking a signature is the longest thing that it does with an image.
#[inline(never)]
pub(super) fn verify(message: &[u8], signature: &[u8; 64], keys: &Keys) -> Result<(), Refusal> {
    let signature = Signature::from_slice(signature).map_err(|_| Refusal::WrongSignature)?;
    let mut refusal = Refusal::BadKey;
    for key in keys {
        let Ok(key) = VerifyingKey::from_bytes(key) else { continue };
        if key.verify_strict(message, &signature).is_ok() {
            return Ok(());
        }
        refusal = Refusal::WrongSignature;
    }
    Err(refusal)
}

/// Does this signature of [`UNLOCK_PREFIX`] and the challenge unlock a node?
pub fn unlocks(challenge: &[u8; CHALLENGE_BYTES], signature: &[u8; SIGNATURE_BYTES], keys: &Keys) -> bool {
    let mut message = [0; UNLOCK_PREFIX.len() + CHALLENGE_BYTES];
    let mut writer = Writer::new(&mut message);
    writer.put(UNLOCK_PREFIX);
    writer.put(challenge);
    verify(&message, signature, keys).is_ok()
}

/// What a firmware says about its key when it starts.
pub const KEY_NOTICE: Option<&str> = if IS_DEVELOPMENT_KEY {
    Some("updates: development key built in, anybody can sign; SLIPSENSE_UPDATE_KEY sets another")
} else {
    None
};

/// Checked while compiling: a key that is none ends the build.
const fn from_hex(digits: &[u8]) -> [u8; 32] {
    assert!(digits.len() == 64, "a public key has 64 hexadecimal digits");
    let mut key = [0; 32];
    let mut index = 0;
    while index < 64 {
        let digit = match digits[index] {
            digit @ b'0'..=b'9' => digit - b'0',
            digit @ b'a'..=b'f' => digit - b'a' + 10,
            digit @ b'A'..=b'F' => digit - b'A' + 10,
            _ => panic!("a public key has 64 hexadecimal digits"),
        };
        key[index / 2] = key[index / 2] << 4 | digit;
        index += 1;
    }
    key
}

#[cfg(test)]
mod tests {
    #[test]
    fn a_key_is_read_in_both_cases() {
        let key = super::from_hex(b"0123456789abcdefABCDEF0123456789abcdefABCDEF0123456789abcdefABCD");
        assert_eq!(key[..11], [0x01, 0x23, 0x45, 0x67, 0x89, 0xAB, 0xCD, 0xEF, 0xAB, 0xCD, 0xEF]);
    }
}
