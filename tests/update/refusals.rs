//! Every refusal, its reason, and that it leaves what runs alone.

use ed25519_dalek::{Signer, SigningKey};
use embassy_futures::block_on;
use slipsense::net::Aligned;
use slipsense::node::FileSink;
use slipsense::node::UpdateTarget::{Firmware, Model};
use slipsense::update::partitions::TRAILER_BYTES;
use slipsense::update::{HEADER_BYTES, Header, ImageVersion, Refusal, Run};

use super::device::{
    BOARD, Device, NEW, NEWEST, OLD, PLACE, Sink, feed, firmware, header, image, model, model_image, payload,
    sign,
};

/// The firmware that runs and the model are as before, and a good image is taken afterwards.
fn refused(device: &Device, target: slipsense::node::UpdateTarget, file: &[u8]) -> &'static str {
    let reason = device.install(OLD, target, file).expect_err("taken");
    let after = device.twin();
    assert_eq!((after.run(), after.boots()), (Run::Confirmed, OLD), "{reason}");
    assert_eq!(after.install(OLD, Firmware, &image(NEW)), Ok(()), "{reason}");
    assert_eq!(after.boots(), NEW, "{reason}");
    reason
}

#[test]
fn firmware_without_a_good_signature_is_refused_with_a_reason() {
    let device = Device::new();
    let refused = |file: &[u8]| refused(&device, Firmware, file);
    assert_eq!(refused(&firmware(NEW)), "unsigned: it has no image header");
    let mut unsigned = image(NEW);
    unsigned[64..128].fill(0);
    assert_eq!(refused(&unsigned), "unsigned: the signature is empty");
    let payload = firmware(NEW);
    let header = header(Firmware, NEW, &payload);
    let thief = SigningKey::from_bytes(&[9; 32]).sign(&header.signed_bytes()).to_bytes();
    let forged = [&header.encode(&thief)[..], &payload].concat();
    assert_eq!(refused(&forged), "the signature is not by this firmware's key");
    assert_eq!(refused(&model_image(NEW, 1)), "firmware and model mistaken for each other");
    assert_eq!(device.install(OLD, Model, &image(NEW)), Err("firmware and model mistaken for each other"));
    assert_eq!(device.steps(), 0, "nothing is erased before the header is good");
}

/// A wrong header is found whether it is signed or forged: no signature is checked for it, and nothing is erased.
#[test]
fn a_signature_is_checked_last() {
    let device = Device::new();
    for (change, reason) in [
        ((|header| header.target = Model) as fn(&mut Header), "firmware and model mistaken for each other"),
        (|header| header.board += 1, "for another board"),
        (|header| header.board = 0, "for another board"),
        (|header| header.version.minor = 0, "older than what is installed"),
        (|header| header.version = OLD_ER, "older than what is installed"),
        (|header| header.length = 0, "empty"),
        (|header| header.length = BOARD.active.bytes() - TRAILER_BYTES + 1, "longer than its slot"),
        (|header| header.length = BOARD.active.bytes(), "longer than its slot"),
        (|header| header.length = u32::MAX, "longer than its slot"),
    ] {
        let payload = firmware(NEW);
        let mut wrong = header(Firmware, NEW, &payload);
        change(&mut wrong);
        assert_eq!(refused(&device, Firmware, &sign(&wrong, &payload)), reason);
        assert_eq!(device.install(OLD, Firmware, &wrong.encode(&[1; 64])), Err(reason));
        assert_eq!(device.steps(), 0);
    }
    let forged = header(Firmware, NEW, &firmware(NEW)).encode(&[1; 64]);
    assert_eq!(device.install(OLD, Firmware, &forged), Err(Refusal::WrongSignature.reason()));
}

/// A header that somebody recorded on the bus costs neither the firmware to roll back to nor the one that waits.
#[test]
fn what_is_held_already_erases_nothing() {
    let device = Device::new();
    for file in [&image(OLD)[..], &image(OLD)[..HEADER_BYTES]] {
        assert_eq!(device.install(OLD, Firmware, file), Err(Refusal::Held.reason()));
        assert_eq!(device.steps(), 0);
    }
    device.sink(OLD, |sink| {
        assert_eq!(feed(sink, Firmware, &image(NEW)), Ok(()));
        let steps = device.steps();
        assert_eq!(feed(sink, Firmware, &image(NEW)[..HEADER_BYTES]), Err(Refusal::Held.reason()));
        assert_eq!(device.steps(), steps);
        // Another one takes its place, and then it may come again.
        assert_eq!(feed(sink, Firmware, &image(NEWEST)), Ok(()));
        assert_eq!(feed(sink, Firmware, &image(NEW)), Ok(()));
    });
    assert_eq!(device.boots(), NEW);
}

const OLD_ER: ImageVersion = ImageVersion { patch: OLD.patch - 1, ..OLD };

#[test]
fn the_same_version_may_come_again_and_the_longest_fits() {
    let device = Device::new();
    let another = payload(3, 1_000);
    assert_eq!(device.install(OLD, Firmware, &sign(&header(Firmware, OLD, &another), &another)), Ok(()));
    let payload = payload(5, (BOARD.active.bytes() - TRAILER_BYTES) as usize);
    let longest = sign(&header(Firmware, NEW, &payload), &payload);
    assert_eq!(device.install(OLD, Firmware, &longest), Ok(()));
    assert!(device.boot().is_ok());
    assert_eq!(device.run(), Run::OnTrial);
}

#[test]
fn every_truncation_is_refused() {
    let file = image(NEW);
    for length in
        (0..file.len()).filter(|length| *length < 160 || length % 13 == 0 || *length > file.len() - 40)
    {
        let device = Device::new();
        let reason = device.install(OLD, Firmware, &file[..length]).expect_err("taken");
        let expected = match length {
            // Not a piece has come.
            0 => Refusal::OutOfOrder,
            1..HEADER_BYTES => Refusal::ShorterThanHeader,
            _ => Refusal::Truncated,
        };
        assert_eq!(reason, expected.reason(), "{length} bytes");
        assert_eq!((device.run(), device.boots()), (Run::Confirmed, OLD));
    }
    let longer = [&file[..], &[0xFF]].concat();
    assert_eq!(refused(&Device::new(), Firmware, &longer), "it goes on behind its payload");
}

#[test]
fn damage_of_the_payload_is_found_in_flash() {
    let device = Device::new();
    for at in [HEADER_BYTES, HEADER_BYTES + 700, image(NEW).len() - 1] {
        let mut file = image(NEW);
        file[at] ^= 0x10;
        assert_eq!(refused(&device, Firmware, &file), "the payload's SHA-256 does not match");
    }
    // Right on its way, wrong in flash.
    let at = BOARD.dfu.start as usize + 32;
    let device = Device::new();
    device.sink(OLD, |sink| {
        let file = image(NEW);
        for (index, piece) in file.chunks(256).enumerate() {
            block_on(sink.write(Firmware, (index * 256) as u32, piece)).unwrap();
        }
        device.flip(at);
        let finished = block_on(sink.finish(Firmware, file.len() as u32));
        assert_eq!(finished, Err("the payload's SHA-256 does not match"));
    });
    device.cells.borrow_mut().stuck = Some(at);
    assert_eq!(device.install(OLD, Firmware, &image(NEW)), Err("the flash refused"));
    assert_eq!((device.run(), device.boots()), (Run::Confirmed, OLD));
}

#[test]
fn pieces_out_of_order() {
    let device = Device::new();
    let file = image(NEW);
    device.sink(OLD, |sink| {
        let write = |sink: &mut _, offset: usize| {
            block_on(FileSink::write(sink, Firmware, offset as u32, &file[offset..offset + 256]))
        };
        let out_of_order = Err(Refusal::OutOfOrder.reason());
        assert_eq!(write(sink, 256), out_of_order);
        assert_eq!((write(sink, 0), write(sink, 512)), (Ok(()), out_of_order));
        assert_eq!(write(sink, 256), out_of_order);
        // Offset 0 begins anew, in the middle too, whatever the pieces' size.
        assert_eq!((write(sink, 0), write(sink, 256), write(sink, 0)), (Ok(()), Ok(()), Ok(())));
        assert_eq!(block_on(sink.write(Model, 256, &file[256..512])), out_of_order);
        assert_eq!(block_on(sink.finish(Firmware, 256)), out_of_order);
    });
    for step in [1, 7, 31, 100, 1000] {
        device.sink(OLD, |sink| {
            for (index, piece) in file.chunks(step).enumerate() {
                block_on(sink.write(Firmware, (index * step) as u32, piece)).unwrap();
            }
            let finished = block_on(sink.finish(Firmware, file.len() as u32 - 1));
            assert_eq!(finished, Err(Refusal::OutOfOrder.reason()));
            assert_eq!(feed(sink, Firmware, &file), Ok(()));
        });
    }
    assert_eq!(device.boots(), NEW);
}

#[test]
fn models_are_refused_with_a_reason() {
    let device = Device::new();
    let refused = |payload: &[u8]| {
        let file = sign(&header(Model, NEW, payload), payload);
        let reason = device.install(OLD, Model, &file).expect_err("taken");
        // The one in the firmware runs.
        assert_eq!(device.model(), Err(Refusal::Blank));
        reason
    };
    let good = model(1);
    assert_eq!(refused(&[0; 100]), "corrupt model: it does not begin as a model does");
    assert_eq!(refused(&good[..good.len() - 4]), "corrupt model: it ends too early");
    let mut damaged = good.clone();
    damaged[100] ^= 1;
    assert_eq!(refused(&damaged), "corrupt model: its SHA-256 does not match");
    damaged[8] ^= 2;
    assert_eq!(refused(&damaged), "corrupt model: its format is unknown to this firmware");
    damaged = good.clone();
    damaged[12..14].copy_from_slice(&999u16.to_le_bytes());
    assert_eq!(refused(&damaged), "corrupt model: a size that this firmware has no room for");
    let mut overflowing = slipsense_recording::model_file::ModelFile::from_bytes(&good).unwrap();
    overflowing.tensor_mut("head", "bias")[0] = i32::MAX;
    overflowing.tensor_mut("head", "weight").fill(0x7FFF);
    assert_eq!(refused(&overflowing.to_bytes().unwrap()), "corrupt model: an accumulator could overflow");
    assert_eq!(refused(&payload(1, PLACE + 1)), "longer than its slot");

    let mut any = header(Model, NEW, &good);
    any.board = BOARD.id + 1;
    assert_eq!(device.install(OLD, Model, &sign(&any, &good)), Err("for another board"));
    // A good one, for any board; then an older one.
    any.board = 0;
    assert_eq!(device.install(OLD, Model, &sign(&any, &good)), Ok(()));
    assert_eq!(device.model(), Ok((NEW, good.clone())));
    assert_eq!(device.install(OLD, Model, &model_image(OLD, 2)), Err("older than what is installed"));
    assert_eq!(device.model(), Ok((NEW, good)));
    assert_eq!(device.install(OLD, Model, &model_image(NEWEST, 2)), Ok(()));
    assert_eq!(device.model(), Ok((NEWEST, model(2))));
    // Written by a probe perhaps: an older one does not run.
    let raised = Device { floor: ImageVersion { patch: NEWEST.patch + 1, ..NEWEST }, ..device.twin() };
    assert_eq!(raised.model(), Err(Refusal::Older));
    let mut slot = device.model_slot();
    slot.raise_floor(raised.floor);
    assert_eq!(block_on(slot.header()), Err(Refusal::Older));
    // Damage in flash: found at every start.
    device.cells.borrow_mut().bytes[BOARD.model.start as usize + 500] ^= 4;
    assert_eq!(device.model(), Err(Refusal::WrongHash));
}

#[test]
fn a_model_that_does_not_come_whole_leaves_the_installed_one() {
    let device = Device::new();
    let (installed, file) = (model(1), model_image(NEW, 1));
    assert_eq!(device.install(OLD, Model, &file), Ok(()));
    let steps = device.steps();
    // The header of the installed model again, and no more of it; another one that is cut off; the same once more.
    for (file, reason) in [
        (&file[..HEADER_BYTES], Err(Refusal::Truncated.reason())),
        (&model_image(NEWEST, 2)[..2 * HEADER_BYTES], Err(Refusal::Truncated.reason())),
        (&file[..], Ok(())),
    ] {
        assert_eq!(device.install(OLD, Model, file), reason);
        assert_eq!((device.steps(), device.model()), (steps, Ok((NEW, installed.clone()))));
    }
    assert_eq!(device.install(OLD, Model, &model_image(OLD, 2)), Err(Refusal::Older.reason()));
}

#[test]
fn a_board_without_bootloader_says_so() {
    let device = Device::new();
    let reason = "there is no bootloader on this board: cargo flash-boot-h743";
    let mut place = Box::new(Aligned([0; PLACE]));
    let mut sink = Sink::new(
        &BOARD,
        &[slipsense::update::DEVELOPMENT_KEY],
        None,
        Err(Refusal::NoBootloader),
        device.model_slot(),
        &mut place.0,
    );
    assert_eq!(feed(&mut sink, Firmware, &image(NEW)), Err(reason));
    assert_eq!(block_on(sink.write(Firmware, 0, &image(NEW)[..256])), Err(reason));
    assert_eq!(feed(&mut sink, Model, &model_image(NEW, 1)), Ok(()));
    assert!(sink.state().is_none());
}
