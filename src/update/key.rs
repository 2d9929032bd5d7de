//! The key that images are signed with: whose signature this firmware, or this bootloader, believes.
//!
//! A build takes it from the environment variable `SLIPSENSE_UPDATE_KEY`, 64 hexadecimal digits, as `slipsense keygen`
//! prints them. Without it the development key is built in, **whose private half is public**: anybody can sign for
//! such a firmware, and it says so ([`KEY_NOTICE`]). Firmware and bootloader are built with the same.

/// The private half of the development key, an Ed25519 seed. Public on purpose: it proves nothing.
pub const DEVELOPMENT_SEED: [u8; 32] = *b"slipsense development key public";

/// The public half.
pub const DEVELOPMENT_KEY: [u8; 32] =
    from_hex(b"abceffcff5e9402a4fe34a02f80d483e05b8e8b3680c2185a2d315eaa1861a91");

/// The public key that images must be signed with.
pub const PUBLIC_KEY: [u8; 32] = match option_env!("SLIPSENSE_UPDATE_KEY") {
    Some(hex) => from_hex(hex.as_bytes()),
    None => DEVELOPMENT_KEY,
};

/// Is it the development key?
pub const IS_DEVELOPMENT_KEY: bool = same(&PUBLIC_KEY, &DEVELOPMENT_KEY);

/// What a firmware says about its key when it starts.
pub const KEY_NOTICE: Option<&str> = if IS_DEVELOPMENT_KEY {
    Some("updates: development key built in, anybody can sign; SLIPSENSE_UPDATE_KEY sets another")
} else {
    None
};

/// Checked while compiling: a key that is none ends the build.
const fn from_hex(digits: &[u8]) -> [u8; 32] {
    assert!(digits.len() == 64, "SLIPSENSE_UPDATE_KEY has 64 hexadecimal digits");
    let mut key = [0; 32];
    let mut index = 0;
    while index < 64 {
        let digit = match digits[index] {
            digit @ b'0'..=b'9' => digit - b'0',
            digit @ b'a'..=b'f' => digit - b'a' + 10,
            digit @ b'A'..=b'F' => digit - b'A' + 10,
            _ => panic!("SLIPSENSE_UPDATE_KEY has 64 hexadecimal digits"),
        };
        key[index / 2] = key[index / 2] << 4 | digit;
        index += 1;
    }
    key
}

const fn same(a: &[u8; 32], b: &[u8; 32]) -> bool {
    let mut index = 0;
    while index < 32 && a[index] == b[index] {
        index += 1;
    }
    index == 32
}
