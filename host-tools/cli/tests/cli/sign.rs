//! Signing: what comes out, what `image info` says of it, and what is refused.

use std::fs;

use crate::support::{Place, elf_header, model_bytes};
use slipsense::net::format::Dims;
use slipsense::update::partitions::{FLASH_BASE, NUCLEO_H743ZI2};
use slipsense::update::{DEVELOPMENT_KEY, HEADER_BYTES, Header, PUBLIC_KEYS};
use slipsense_recording::from_hex;
use slipsense_recording::model_file::random_model;

/// The least that passes for a firmware: a stack, where it begins, and something.
fn binary() -> Vec<u8> {
    let begin = FLASH_BASE + NUCLEO_H743ZI2.active.start;
    let mut bytes = vec![0x5A; 1000];
    bytes[..4].copy_from_slice(&0x2000_6000u32.to_le_bytes());
    bytes[4..8].copy_from_slice(&(begin + 0x299).to_le_bytes());
    bytes
}

/// An ELF of 32 bits for ARM with these segments: address in flash and content.
fn elf(segments: &[(u32, &[u8])]) -> Vec<u8> {
    let mut elf = elf_header((52, segments.len() as u16), (0, 0));
    let mut offset = 52 + 32 * segments.len() as u32;
    for (address, data) in segments {
        let length = data.len() as u32;
        elf.extend([1, offset, 0x2000_0000, *address, length, length, 4, 4].map(u32::to_le_bytes).concat());
        offset += length;
    }
    segments.iter().for_each(|(_, data)| elf.extend(*data));
    elf
}

#[test]
fn a_firmware_is_signed_and_looked_into() {
    let place = Place::new();
    let key = place.json("keygen --out @fleet.key");
    let public = key["public_key"].as_str().unwrap();
    place.file("fw.bin", binary());
    let sign = "sign @fw.bin --board h743 --version 1.2.3 --key @fleet.key --out @fw.slip";
    assert!(place.run(sign).contains("signature  valid"));

    let image = fs::read(place.path("fw.slip")).unwrap();
    let key = from_hex(public).unwrap();
    let header = Header::verify(image.first_chunk::<HEADER_BYTES>().unwrap(), &[key]).unwrap();
    assert_eq!((header.board, header.version.to_string().as_str()), (1, "1.2.3"));
    assert_eq!(image[HEADER_BYTES..], binary());

    let info = |more: &str| place.json(&format!("image info @fw.slip {more}"));
    assert_eq!((&info("")["signature"], &info("")["whole"]), (&"other key".into(), &true.into()));
    assert_eq!(info(&format!("--public-key {public}"))["signature"], "valid");
    assert_eq!((&info("")["kind"], &info("")["board"]), (&"firmware".into(), &"NUCLEO-H743ZI2".into()));

    let mut damaged = image.clone();
    damaged[HEADER_BYTES + 5] ^= 1;
    place.file("fw.slip", &damaged);
    assert_eq!(info("")["whole"], false);
    assert!(place.run("image info @fw.slip").contains("NOT what the header says"));
    place.errors([
        (
            format!("image info @fw.slip --public-key {public}"),
            "fw.slip: the payload is not what the header says",
        ),
        (format!("image info @fw.slip --public-key {}", "05".repeat(32)), "fw.slip: not signed by the key"),
    ]);
    damaged[64..128].fill(0);
    place.file("fw.slip", &damaged);
    assert_eq!(info("")["signature"], "none");
}

#[test]
fn an_elf_becomes_the_bytes_of_its_slot() {
    let place = Place::new();
    let [begin, end] = [NUCLEO_H743ZI2.active.start, NUCLEO_H743ZI2.active.end].map(|at| FLASH_BASE + at);
    let binary = binary();
    // As the linker makes it: out of order, with a gap, the stub for reset and the blank trailer beside it.
    let segments = [
        (begin + 1200, &b"behind"[..]),
        (FLASH_BASE, &[1; 8]),
        (end - 1024, &[0xFF; 1024]),
        (begin, &binary),
        (0x2400_0000, b""),
    ];
    place.file("fw.elf", elf(&segments));
    let text = place.run("sign @fw.elf --board h743 --version 0.1.0 --development-key --out @fw.slip");
    assert!(text.contains("payload    1206 bytes, whole"), "{text}");
    let image = fs::read(place.path("fw.slip")).unwrap();
    assert_eq!(image[HEADER_BYTES..], [&binary[..], &[0xFF; 200], b"behind"].concat());

    place.file("far.elf", elf(&[(begin, &binary), (end - 1030, &[0; 10])]));
    place.file("host.elf", [&b"\x7fELF\x02\x01\x01"[..], &[0; 60]].concat());
    place.file("no.elf", elf(&[(FLASH_BASE, &[1; 8])]));
    let sign = |file| format!("sign {file} --board h743 --version 0.1.0 --development-key --out @x");
    place.errors([
        (sign("@far.elf"), "far.elf: the program leaves its slot"),
        (sign("@host.elf"), "host.elf: is not a program of the microcontroller"),
        (sign("@no.elf"), "nothing of the program lies in the slot of the NUCLEO-H743ZI2"),
    ]);
}

#[test]
fn a_model_is_signed_for_any_board() {
    let place = Place::new();
    place.file("m.slipnet", model_bytes());
    let text = place.run("sign @m.slipnet --version 0.2.0 --development-key --out @m.slip");
    assert!(text.contains("kind       model\nboard      any\nversion    0.2.0\n"), "{text}");
    let raw = fs::read(place.path("m.slip")).unwrap();
    assert!(Header::verify(raw.first_chunk().unwrap(), &[DEVELOPMENT_KEY]).is_ok());
    let text = place.run("image info @m.slip");
    assert!(text.contains("signature  development key"), "{text}");
    assert_eq!(PUBLIC_KEYS, [DEVELOPMENT_KEY], "these tests are built without a key");
}

#[test]
fn what_cannot_be_signed() {
    let place = Place::new();
    place.file("fw.bin", binary());
    let mut broken = model_bytes();
    broken[100] ^= 1;
    place.file("m.slipnet", broken);
    place.file("bad.key", "0123");
    place.file("text", "hello");
    let dev = "--version 1.0.0 --development-key --out @x";
    let mut long = binary();
    long.resize(500_000, 0);
    place.file("long.bin", long);
    let fields = [8, 16, 32, 64, 6, 96, 8, 60];
    let large = random_model(Dims::from_fields(fields).unwrap(), 1).to_bytes().unwrap();
    let too_large = format!("{} bytes, a board has room for a model of 129024", large.len());
    place.file("large.slipnet", large);
    place.errors([
        (format!("sign @fw.bin {dev}"), "fw.bin: a firmware is for one board: --board says which"),
        (format!("sign @text --board h743 {dev}"), "text: is not a firmware of the NUCLEO-H743ZI2"),
        (format!("sign @m.slipnet {dev}"), "m.slipnet: refused as a model: SHA-256 does not match"),
        (format!("sign @large.slipnet {dev}"), too_large.as_str()),
        (format!("sign @none {dev}"), "none: cannot read"),
        ("sign @fw.bin --board h743 --version 1.0.0 --key @bad.key --out @x".into(), "bad.key: is not a key"),
        (format!("sign @fw.bin --board h743 {dev}/y"), "cannot write"),
        ("image info @text".into(), "text: truncated: shorter than the header of an image"),
        ("image info @fw.bin".into(), "fw.bin: unsigned: it has no image header"),
        ("keygen --out @fw.bin".into(), "fw.bin: exists already, and a key is not overwritten"),
        (
            format!("sign @long.bin --board h743 {dev}"),
            "500000 bytes, a board has room for a firmware of 392192",
        ),
    ]);
}

#[cfg(unix)]
#[test]
fn a_private_key_is_private() {
    use std::os::unix::fs::PermissionsExt;
    let place = Place::new();
    place.run("keygen --out @k");
    assert_eq!(fs::metadata(place.path("k")).unwrap().permissions().mode() & 0o777, 0o600);
}

#[test]
fn a_challenge_is_signed_and_unlocks() {
    let place = Place::new();
    let challenge = [5; 32];
    let hex = "05".repeat(32);
    let text = place.run(&format!("sign --challenge {hex} --development-key"));
    let json = place.json(&format!("sign --challenge {hex} --development-key"));
    assert_eq!(json["signature"], text.trim());
    let signature: Vec<u8> =
        (0..64).map(|at| u8::from_str_radix(&text.trim()[2 * at..2 * at + 2], 16).unwrap()).collect();
    let signature = signature.try_into().unwrap();
    assert!(slipsense::update::unlocks(&challenge, &signature, &[DEVELOPMENT_KEY]));
    place.errors([
        ("sign --challenge 05 --development-key".to_owned(), "a challenge has 64 hexadecimal digits"),
        (format!("sign @m --challenge {hex} --development-key"), "cannot be used with"),
        ("sign --version 1.0.0 --development-key --out @x".to_owned(), "<FILE>"),
    ]);
}
