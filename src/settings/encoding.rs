//! A configuration as bytes of flash.
//!
//! One byte of version, then for every setting: its number, its kind's bytes per element, its number of
//! elements, the elements, low byte first. What an older or newer firmware has stored is read as far as it
//! is known here; a setting that is missing or not valid any more is its default, and is reported.

use super::table::ELEMENT_BYTES;
use super::{ELEMENTS_MAX, Setting, Settings, TABLE};

const VERSION: u8 = 1;
const ENTRY_BYTES: usize = 3;

/// Bytes of an encoded configuration.
pub const ENCODED_MAX: usize = 1 + TABLE.len() * ENTRY_BYTES + ELEMENT_BYTES;

/// What was not as it should be in stored bytes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Damage {
    /// Bit n: setting number n was missing or not valid, and is its default.
    pub settings: u32,
    /// Entries of settings that this firmware does not know; passed over.
    pub unknown: u8,
    /// The bytes end inside an entry, or are of another version.
    pub cut: bool,
}

const _: () = assert!(TABLE.len() <= 32, "a bit for every setting");

impl Settings {
    /// The bytes to store.
    pub fn encode(&self) -> [u8; ENCODED_MAX] {
        let mut out = [0; ENCODED_MAX];
        let mut writer = crate::wire::bytes::Writer::new(&mut out);
        writer.put(&[VERSION]);
        for definition in &TABLE {
            let (elements, bytes) = (self.get(definition.setting), definition.kind.bytes());
            writer.put(&[definition.setting as u8, bytes as u8, elements.len() as u8]);
            for element in elements {
                writer.put(element.to_le_bytes().get(..bytes).unwrap_or(&[]));
            }
        }
        out
    }

    /// What the bytes hold, and defaults for the rest.
    pub fn decode(bytes: &[u8]) -> (Self, Damage) {
        let mut settings = Self::new();
        let mut damage = Damage { settings: u32::MAX >> (32 - TABLE.len()), ..Damage::default() };
        let mut rest = match bytes.split_first() {
            Some((&VERSION, rest)) => rest,
            _ => return (settings, Damage { cut: true, ..damage }),
        };
        while let Some((&[number, size, count], after)) = rest.split_first_chunk::<ENTRY_BYTES>() {
            let length = usize::from(size) * usize::from(count);
            let Some((entry, after)) = after.split_at_checked(length) else {
                return (settings, Damage { cut: true, ..damage });
            };
            rest = after;
            let Some(setting) = Setting::from_number(number) else {
                damage.unknown = damage.unknown.saturating_add(1);
                continue;
            };
            if settings.take_entry(setting, usize::from(size), entry) {
                damage.settings &= !(1 << number);
            }
        }
        damage.cut = !rest.is_empty();
        (settings, damage)
    }

    fn take_entry(&mut self, setting: Setting, size: usize, entry: &[u8]) -> bool {
        let kind = setting.definition().kind;
        if size != kind.bytes() {
            return false;
        }
        let mut elements = heapless::Vec::<i64, ELEMENTS_MAX>::new();
        for bytes in entry.chunks_exact(size) {
            let Some(element) = kind.read(bytes) else { return false };
            if elements.push(element).is_err() {
                return false;
            }
        }
        self.set(setting, &elements).is_ok()
    }
}
