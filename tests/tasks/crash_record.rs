//! The record of a crash survives in RAM, and nothing else is taken for one.

use proptest::prelude::*;
use slipsense::board::crash_record::{
    CRASH_WORDS, CrashKind, CrashRecord, FILE_BYTES, Fault, ResetCause, Stall, Start,
};

#[test]
fn a_record_is_read_back_and_counts() {
    let mut ram = [0xdead_beef; CRASH_WORDS];
    for count in 1..=3 {
        let before = CrashRecord::from_words(&ram);
        assert_eq!(before.is_some(), count > 1);
        ram = CrashRecord::new(before, "index out of bounds", "src/tasks/infer.rs", 77).to_words();
        let record = CrashRecord::from_words(&ram).unwrap();
        assert_eq!((record.count, record.line, record.file()), (count, 77, "src/tasks/infer.rs"));
    }
    // FNV-1a of the text, from an implementation of its own:
    // python3 -c "h=0x811c9dc5
    // for b in b'index out of bounds': h=(h^b)*0x01000193&0xffffffff
    // print(f'{h:08x}')"
    let text = CrashRecord::from_words(&ram).unwrap().to_string();
    assert_eq!(text, "panic 3 since power-on, at src/tasks/infer.rs:77, reason eb38696d");
}

#[test]
fn the_end_of_a_long_path_and_the_largest_count_are_kept_and_empty_ram_is_no_record() {
    let path = format!("{}/src/a.rs", "long".repeat(20));
    let mut record = CrashRecord::new(None, "", &path, 1);
    assert_eq!(record.file(), &path[path.len() - FILE_BYTES..]);
    record.count = u32::MAX;
    assert_eq!(CrashRecord::new(Some(record), "", "f", 1).count, u32::MAX);
    for word in [0, u32::MAX, 0x5555_5555] {
        assert_eq!(CrashRecord::from_words(&[word; CRASH_WORDS]), None);
    }
}

proptest! {
    #[test]
    fn any_changed_bit_is_noticed(word in 0..CRASH_WORDS, bit in 0..32, reason: String, line: u32) {
        let mut ram = CrashRecord::new(None, reason, "src/main.rs", line).to_words();
        prop_assert!(CrashRecord::from_words(&ram).is_some());
        ram[word] ^= 1u32 << bit;
        prop_assert_eq!(CrashRecord::from_words(&ram), None);
    }
}

#[test]
fn faults_and_stalls_are_named() {
    let fault = Fault { pc: 0x0802_1234, lr: 0x0802_0001, cfsr: 0x8200, address: 0x1FF0_0000 };
    let stored = |record: CrashRecord| CrashRecord::from_words(&record.to_words()).unwrap();
    let record = stored(CrashRecord::of(None, CrashKind::Fault(fault)));
    assert_eq!((record.kind, record.count), (CrashKind::Fault(fault), 1));
    let text = "fault 1 since power-on, pc 08021234, lr 08020001, cfsr 00008200, at 1ff00000";
    assert_eq!(record.to_string(), text);
    let stall = |tasks| Stall { tasks, pc: 0x0802_1234, lr: 0xFFFF_FFE9 };
    let stall = |tasks| stored(CrashRecord::of(Some(record), CrashKind::Stall(stall(tasks))));
    let text = "watchdog 2 since power-on, pc 08021234, lr ffffffe9, stalled:";
    assert_eq!(stall(0b1010).to_string(), format!("{text} infer services"));
    assert_eq!(stall(0).to_string(), format!("{text} all that look"));
    let start = Start { cause: ResetCause::Watchdog, crash: Some(stall(0b1010)) };
    assert_eq!(start.numbers(), [5, 3, 0x0802_1234, 0xFFFF_FFE9, 0b1010, 0]);
    let clock = stored(CrashRecord::of(None, CrashKind::NoClock(25_000_000)));
    assert_eq!(clock.to_string(), "start 1 since power-on without its clock, 25000000 Hz found");
}

#[test]
fn the_reset_flags_name_the_cause() {
    // RM0433, reset and clock control, RCC_RSR after each kind of reset.
    for (flags, cause) in [
        (0x00FE_0000, ResetCause::PowerOn),
        (0x0060_0000 | 1 << 17, ResetCause::BrownOut),
        (0x0440_0000 | 1 << 17, ResetCause::Watchdog),
        (0x0140_0000 | 1 << 17, ResetCause::Software),
        (0x0040_0000 | 1 << 17, ResetCause::Pin),
        (0, ResetCause::Unknown),
    ] {
        assert_eq!(ResetCause::from_flags(flags), cause, "{flags:#010x}");
    }
}
