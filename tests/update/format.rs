//! The image format, against bytes that another program made, and the keys.

use ed25519_dalek::{Signer, SigningKey};
use slipsense::node::UpdateTarget;
use slipsense::update::{
    DEVELOPMENT_KEY, DEVELOPMENT_SEED, HEADER_BYTES, Header, IS_DEVELOPMENT_KEY, ImageVersion, KEY_NOTICE,
    PUBLIC_KEYS, Refusal,
};

/// Made by Python's `struct`, `hashlib` and the package `cryptography` 48 (OpenSSL), from the table in `image.rs`:
/// a firmware for board 1, version 2.7.515, of the bytes 0 to 255 three times and `end`.
const HEADER: &str = "\
534c4950494d4700010001000100020703020000030300003\
98cc8a909372ba126b671e342b2dd7ce3f9b5da1fc6b44e994bc9a24e20f14b0000000000000000\
7518b7cc8185bce220348e45d8cd0c08f6c62296bee3d4cd6353c7c6219cb0cd\
27f59f8862d6cb6a7fd1fb5eb51405f79e060fa3d64739bdcbe0a83d69380b0e";

fn bytes() -> [u8; HEADER_BYTES] {
    std::array::from_fn(|i| u8::from_str_radix(&HEADER[2 * i..2 * i + 2], 16).unwrap())
}

#[test]
fn a_header_that_another_program_signed() {
    let header = Header::verify(&bytes(), &[DEVELOPMENT_KEY]).unwrap();
    assert_eq!((header.target, header.board), (UpdateTarget::Firmware, 1));
    assert_eq!((header.version.to_string().as_str(), header.length), ("2.7.515", 771));
    assert_eq!(Header::inspect(&bytes()).unwrap(), header);
    let signature = std::array::from_fn(|i| bytes()[64 + i]);
    assert_eq!(header.encode(&signature), bytes());
}

#[test]
fn every_bit_of_a_header_is_signed() {
    for bit in 0..8 * HEADER_BYTES {
        let mut bytes = bytes();
        bytes[bit / 8] ^= 1 << (bit % 8);
        let expected = match bit / 8 {
            0..8 => Refusal::NoHeader,
            8..10 => Refusal::UnknownFormat,
            _ => Refusal::WrongSignature,
        };
        assert_eq!(Header::verify(&bytes, &[DEVELOPMENT_KEY]), Err(expected), "bit {bit}");
    }
    // What this version does not know is refused, also if it is signed.
    for reserved in [13, 18, 19].into_iter().chain(56..64) {
        let mut bytes = bytes();
        bytes[reserved] = 1;
        let signature = SigningKey::from_bytes(&DEVELOPMENT_SEED).sign(&bytes[..64]).to_bytes();
        bytes[64..].copy_from_slice(&signature);
        let found = Header::verify(&bytes, &[DEVELOPMENT_KEY]);
        assert_eq!(found, Err(Refusal::UnknownFormat), "byte {reserved}");
    }
}

#[test]
fn versions_are_read_and_compared() {
    let version = |text: &str| text.parse::<ImageVersion>();
    assert_eq!(version("1.2.3"), Ok(ImageVersion { major: 1, minor: 2, patch: 3 }));
    assert_eq!(version("255.255.65535").unwrap().to_string(), "255.255.65535");
    let texts = "1 1.2 1.2. .1.2 1..2 1.2.3.4 256.0.0 0.256.0 0.0.65536 1.2.x 1.2.000003 4294967297.0.0";
    for wrong in texts.split(' ').chain([""]) {
        let rule = "a version is MAJOR.MINOR.PATCH, up to 255.255.65535";
        assert_eq!(version(wrong).unwrap_err().to_string(), rule, "{wrong}");
    }
    let rising = ["0.0.1", "0.0.300", "0.1.0", "0.255.65535", "1.0.0"].map(|text| version(text).unwrap());
    assert!(rising.windows(2).all(|pair| pair[0] < pair[1]));
    assert_eq!(ImageVersion::SOFTWARE.to_string(), env!("CARGO_PKG_VERSION"));
}

#[test]
fn the_development_key_is_known_for_what_it_is_and_while_keys_change_both_are_believed() {
    assert_eq!(SigningKey::from_bytes(&DEVELOPMENT_SEED).verifying_key().to_bytes(), DEVELOPMENT_KEY);
    assert_eq!(IS_DEVELOPMENT_KEY, PUBLIC_KEYS == [DEVELOPMENT_KEY]);
    assert_eq!(KEY_NOTICE.is_some(), IS_DEVELOPMENT_KEY);
    let other = SigningKey::from_bytes(&[7; 32]).verifying_key().to_bytes();
    assert!(Header::verify(&bytes(), &[other, DEVELOPMENT_KEY]).is_ok());
    assert_eq!(Header::verify(&bytes(), &[other]), Err(Refusal::WrongSignature));
    assert_eq!(Header::verify(&bytes(), &[]), Err(Refusal::BadKey));
}
