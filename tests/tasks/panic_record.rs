//! The record of a panic survives in RAM, and nothing else is taken for one.

use proptest::prelude::*;
use slipsense::board::panic_record::{FILE_BYTES, PANIC_WORDS, PanicRecord};

#[test]
fn a_record_is_read_back_and_counts() {
    let mut ram = [0xdead_beef; PANIC_WORDS];
    for count in 1..=3 {
        let before = PanicRecord::from_words(&ram);
        assert_eq!(before.is_some(), count > 1);
        ram = PanicRecord::new(before, "index out of bounds", "src/tasks/infer.rs", 77).to_words();
        let record = PanicRecord::from_words(&ram).unwrap();
        assert_eq!((record.count, record.line, record.file()), (count, 77, "src/tasks/infer.rs"));
    }
    // FNV-1a of the text, from an implementation of its own:
    // python3 -c "h=0x811c9dc5
    // for b in b'index out of bounds': h=(h^b)*0x01000193&0xffffffff
    // print(f'{h:08x}')"
    let text = PanicRecord::from_words(&ram).unwrap().to_string();
    assert_eq!(text, "panic 3 since power-on, at src/tasks/infer.rs:77, reason eb38696d");
}

#[test]
fn of_a_long_path_the_end_is_kept() {
    let path = format!("{}/src/a.rs", "long".repeat(20));
    let record = PanicRecord::new(None, "", &path, 1);
    assert_eq!(record.file(), &path[path.len() - FILE_BYTES..]);
}

#[test]
fn the_count_stays_at_its_largest_value() {
    let mut first = PanicRecord::new(None, "", "f", 1);
    first.count = u32::MAX;
    assert_eq!(PanicRecord::new(Some(first), "", "f", 1).count, u32::MAX);
}

#[test]
fn empty_ram_is_no_record() {
    for word in [0, u32::MAX, 0x5555_5555] {
        assert_eq!(PanicRecord::from_words(&[word; PANIC_WORDS]), None);
    }
}

proptest! {
    #[test]
    fn any_changed_bit_is_noticed(word in 0..PANIC_WORDS, bit in 0..32, reason: String, line: u32) {
        let mut ram = PanicRecord::new(None, reason, "src/main.rs", line).to_words();
        prop_assert!(PanicRecord::from_words(&ram).is_some());
        ram[word] ^= 1u32 << bit;
        prop_assert_eq!(PanicRecord::from_words(&ram), None);
    }
}
