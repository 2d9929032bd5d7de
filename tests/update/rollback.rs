//! A new firmware on trial, confirmed or not.

use slipsense::node::UpdateTarget::Firmware;
use slipsense::update::boot::{self, BootFailure};
use slipsense::update::{CONFIRM_FRAMES, CONFIRM_HEARTBEATS, Evidence, HEADER_BYTES, Refusal, Run, Trial};

use super::device::{BOARD, Device, NEW, NEWEST, OLD, image};
use super::flash::SECTOR;

#[test]
fn a_firmware_that_confirms_stays() {
    let device = Device::new();
    assert_eq!((device.boots(), device.run()), (OLD, Run::Confirmed));
    assert_eq!(device.install(OLD, Firmware, &image(NEW)), Ok(()));
    assert_eq!(device.run(), Run::Pending);
    assert_eq!((device.boots(), device.run()), (NEW, Run::OnTrial));
    device.confirm();
    for _ in 0..3 {
        assert_eq!((device.boots(), device.run()), (NEW, Run::Confirmed));
    }
    // And the next one, the other way round in the slots.
    assert_eq!(device.install(NEW, Firmware, &image(NEWEST)), Ok(()));
    assert_eq!(device.boots(), NEWEST);
    assert_eq!((device.boots(), device.run()), (NEW, Run::RolledBack));
}

#[test]
fn a_firmware_that_does_not_confirm_is_swapped_out() {
    let device = Device::on_trial();
    // On trial it takes no other: the one to roll back to lies where that would go.
    let before = device.steps();
    assert_eq!(device.install(NEW, Firmware, &image(NEWEST)), Err(Refusal::OnTrial.reason()));
    assert_eq!(device.steps(), before);
    for _ in 0..3 {
        assert_eq!((device.boots(), device.run()), (OLD, Run::RolledBack));
    }
    // It may be tried again; one that is ready may be replaced before it ran.
    assert_eq!(device.install(OLD, Firmware, &image(NEW)), Ok(()));
    assert_eq!(device.install(OLD, Firmware, &image(NEWEST)), Ok(()));
    assert_eq!(device.boots(), NEWEST);
    device.confirm();
    assert_eq!((device.boots(), device.run()), (NEWEST, Run::Confirmed));
}

#[test]
fn a_pending_firmware_is_withdrawn_while_another_comes() {
    let device = Device::updating();
    let cut = &image(NEWEST)[..900];
    assert_eq!(device.install(OLD, Firmware, cut), Err(Refusal::Truncated.reason()));
    assert_eq!((device.run(), device.boots()), (Run::Confirmed, OLD));
}

#[test]
fn the_bootloader_swaps_only_what_is_signed_and_whole() {
    let dfu = BOARD.dfu.start as usize;
    let trailer = dfu + BOARD.active.bytes() as usize - HEADER_BYTES;
    for at in [dfu, dfu + 1400, trailer + 20, trailer + 100] {
        let device = Device::updating();
        device.flip(at);
        assert_eq!((device.boots(), device.run()), (OLD, Run::Confirmed), "{at:#x}");
    }
}

#[test]
fn what_goes_wrong_in_the_swap_is_swapped_back() {
    // A cell of the active slot that does not keep what the swap writes, found by reading it back.
    let weak = Device::updating();
    weak.cells.borrow_mut().weak = Some(BOARD.active.start as usize);
    assert_eq!((weak.boots(), weak.run()), (OLD, Run::RolledBack));
    let swapped = Device::on_trial();
    swapped.flip(BOARD.active.start as usize);
    // Such a firmware is not jumped to; on trial, the next start rolls back.
    assert_eq!((swapped.boots(), swapped.run()), (OLD, Run::RolledBack));
}

#[test]
fn a_firmware_from_a_probe_has_vectors_or_is_not_jumped_to() {
    let device = Device::new();
    let active = BOARD.active;
    let write = |words: [u32; 2]| {
        device.cells.borrow_mut().bytes[active.start as usize..active.end as usize].fill(0xFF);
        device.write_vectors(active, words);
    };
    let begin = 0x0800_0000 + active.start;
    write([0x2000_6000, begin + 0x299]);
    assert_eq!(device.boot(), Ok(boot::Firmware::Flashed));
    let none = BootFailure::NoFirmware(Refusal::Blank);
    assert_eq!(none.to_string(), format!("no firmware: {}", Refusal::Blank));
    for words in [
        [u32::MAX, u32::MAX],
        [0x2000_6000, begin + 0x298],
        [0x2000_6000, begin - 1],
        [0x0800_0000, begin + 1],
        [0, begin + 1],
    ] {
        write(words);
        assert_eq!(device.boot(), Err(none), "{words:x?}");
    }
    // An old header under a firmware that is another.
    let device = Device::new();
    device.flip(active.start as usize + 9);
    assert_eq!(device.boot(), Err(BootFailure::NoFirmware(Refusal::WrongHash)));
}

/// As if an instruction had been skipped in the first look.
#[test]
fn the_second_look_refuses_what_the_first_may_have_passed() {
    let device = Device::new();
    let found = device.boot().unwrap();
    let boot::Firmware::Signed { version, hash } = found else { panic!("{found:?}") };
    let refused = |why| Err(BootFailure::NoFirmware(why));
    let mut other = hash;
    other[31] ^= 1;
    let damaged = boot::Firmware::Signed { version, hash: other };
    assert_eq!(device.check_again(&damaged), refused(Refusal::WrongHash));
    // There is a header.
    assert_eq!(device.check_again(&boot::Firmware::Flashed), refused(Refusal::WrongSignature));
    let header = BOARD.active.end as usize - HEADER_BYTES;
    let write = |byte: u8| device.cells.borrow_mut().bytes[header + 64..][..64].fill(byte);
    write(1);
    assert_eq!(device.check_again(&found), refused(Refusal::WrongSignature));
    device.cells.borrow_mut().bytes[header..][..HEADER_BYTES].fill(0xFF);
    assert_eq!(device.check_again(&found), refused(Refusal::Blank));
    device.write_vectors(BOARD.active, [u32::MAX; 2]);
    assert_eq!(device.check_again(&boot::Firmware::Flashed), refused(Refusal::Blank), "no vectors");
}

#[test]
fn a_trial_ends_once_and_only_with_all_evidence() {
    let mut trial = Trial::new(Run::OnTrial);
    let least =
        Evidence { frames: CONFIRM_FRAMES, heartbeats: CONFIRM_HEARTBEATS, requests: 1, senses: true };
    let most = Evidence { frames: u32::MAX, heartbeats: u32::MAX, requests: u32::MAX, senses: true };
    assert!(!trial.observe(Evidence { frames: CONFIRM_FRAMES - 1, ..most }));
    assert!(!trial.observe(Evidence { heartbeats: CONFIRM_HEARTBEATS - 1, ..most }));
    assert!(!trial.observe(Evidence { requests: 0, ..most }));
    assert!(!trial.observe(Evidence { senses: false, ..most }));
    assert!(trial.observe(least));
    assert!(!trial.observe(most));
    for run in [Run::Confirmed, Run::Pending, Run::RolledBack] {
        assert!(!Trial::new(run).observe(most));
    }
}

#[test]
fn a_damaged_firmware_gives_way_to_the_whole_one_in_the_other_slot() {
    let device = Device::on_trial();
    device.confirm();
    device.flip(BOARD.active.start as usize + 40);
    // Neither is whole.
    device.flip(BOARD.dfu.start as usize + 40 + SECTOR);
    assert_eq!(device.boot(), Err(BootFailure::NoFirmware(Refusal::WrongHash)));
    // A new one has come whole, and was not marked when the power failed.
    let pending = Device::updating();
    pending.confirm();
    pending.flip(BOARD.active.start as usize + 40);
    assert_eq!((pending.boots(), pending.run()), (NEW, Run::Confirmed));
}
