//! What a firmware finds out about itself when it starts, and what it says of it.

use embassy_futures::block_on;
use slipsense::node::UpdateTarget::{Firmware, Model};
use slipsense::node::{Severity, Version};
use slipsense::update::partitions::{FLASH_BASE, NUCLEO_H743ZI2};
use slipsense::update::{
    DEVELOPMENT_KEY, KEY_NOTICE, Notice, Refusal, Run, SlotModel, find_bootloader, running_header,
};

use super::device::{BOARD, Device, OLD};

#[test]
fn a_bootloader_begins_in_its_own_partition() {
    let device = Device::new();
    let boot = BOARD.boot;
    let find = || block_on(find_bootloader(&mut device.part(boot), &BOARD));
    let write = |words| device.write_vectors(boot, words);
    // Blank, and the two words that lead to the firmware (`board.x`).
    assert_eq!(find(), Err(Refusal::NoBootloader));
    write([0x2000_6000, FLASH_BASE + BOARD.active.start + 0x299]);
    assert_eq!(find(), Err(Refusal::NoBootloader));
    write([0x2400_8000, FLASH_BASE + boot.start + 0x299]);
    assert_eq!(find(), Ok(()));
    for (reset, is_there) in [(boot.start + 1, true), (boot.end - 1, true), (boot.end + 1, false)] {
        write([0x2400_8000, FLASH_BASE + reset]);
        assert_eq!(find().is_ok(), is_there, "{reset:#x}");
    }
    write([0x2400_8000, boot.start + 0x299]);
    assert_eq!(find(), Err(Refusal::NoBootloader), "not in flash");
    // No address of an instruction.
    write([0x2400_8000, FLASH_BASE + boot.start + 0x298]);
    assert_eq!(find(), Err(Refusal::NoBootloader));
}

/// Sectors of 128 KB (RM0433, embedded flash memory): a board in the field keeps its settings where they are.
#[test]
fn the_partitions_of_the_board_are_where_they_were() {
    let board = NUCLEO_H743ZI2;
    let spans =
        [board.boot, board.active, board.dfu, board.state, board.model, board.settings, board.written()];
    assert_eq!(
        spans.map(|span| (span.start, span.end)),
        [
            (0, 0x2_0000),
            (0x2_0000, 0x8_0000),
            (0x10_0000, 0x18_0000),
            (0x18_0000, 0x1A_0000),
            (0x1A_0000, 0x1C_0000),
            (0x1C_0000, 0x20_0000),
            (0x10_0000, 0x20_0000)
        ]
    );
}

#[test]
fn a_sink_knows_what_runs_and_has_the_bootloaders_state() {
    Device::new().sink(OLD, |sink| {
        assert_eq!(sink.running().map(|header| header.version), Some(OLD));
        assert!(sink.state().is_some());
    });
}

#[test]
fn a_firmware_knows_its_version_by_the_signed_header_only() {
    let device = Device::new();
    let running = || block_on(running_header(&mut device.part(BOARD.active), &BOARD, &[DEVELOPMENT_KEY]));
    assert_eq!(running().unwrap().version, OLD);
    device.flip(BOARD.active.end as usize - 1);
    assert_eq!(running(), None, "forged");
    let header = BOARD.active.end as usize - 128..BOARD.active.end as usize;
    device.cells.borrow_mut().bytes[header].fill(0xFF);
    assert_eq!(running(), None, "blank: a probe wrote it");
    assert_eq!(Version::from(OLD), Version { major: 1, minor: 0 });
}

#[test]
fn notices_fit_a_record_and_say_what_matters() {
    let model = SlotModel::BuiltIn(Refusal::Blank);
    for (notice, severity, text) in [
        (Notice::DevelopmentKey, Severity::Notice, KEY_NOTICE.unwrap()),
        (Notice::Firmware(OLD, Run::Confirmed), Severity::Info, "firmware 1.0.3, confirmed"),
        (
            Notice::Firmware(OLD, Run::OnTrial),
            Severity::Notice,
            "firmware 1.0.3, on trial: a restart before it confirms brings back the one before",
        ),
        (
            Notice::Firmware(OLD, Run::RolledBack),
            Severity::Warning,
            "firmware 1.0.3, back: the one after it did not confirm",
        ),
        (
            Notice::FirmwareStays(OLD, Refusal::NoBootloader),
            Severity::Notice,
            "firmware 1.0.3; no update of it: there is no bootloader on this board: cargo flash-boot-h743",
        ),
        (Notice::Model(model), Severity::Info, "model: the one in the firmware"),
        (Notice::Model(SlotModel::Slot(OLD)), Severity::Info, "model: version 1.0.3 of the model slot"),
        (
            Notice::Model(SlotModel::BuiltIn(Refusal::WrongHash)),
            Severity::Warning,
            "model: the one in the firmware; that of the slot: the payload's SHA-256 does not match",
        ),
        (Notice::Confirmed(Firmware, OLD), Severity::Notice, "firmware 1.0.3 has confirmed"),
        (Notice::NotConfirmed(Model, OLD), Severity::Error, "model 1.0.3 cannot confirm: the flash refused"),
    ] {
        assert_eq!((notice.to_string().as_str(), notice.severity()), (text, severity));
        assert!(text.len() <= slipsense::node::RECORD_TEXT_MAX, "{text}");
    }
}
