//! uavcan.register: every setting by name, and the state of the node.
//!
//! The list has the settings first, then what can only be read, then for every setting its largest (`<`), smallest (`>`)
//! and default (`=`) value, registers of their own by the standard. The answer to a write is what the register holds
//! afterwards: a value that is refused shows there, and is named in a diagnostic record.

mod read_only;
mod value;

use heapless::Vec;

use super::fields::Fields;
use crate::settings::{Definition, ELEMENTS_MAX, Setting, SettingError, Settings, TABLE};
use crate::wire::bytes::Writer;
pub(super) use read_only::NodeState;
use read_only::{Answer, READ_ONLY, ReadOnly};
use value::Written;

/// Service of uavcan.register.Access.1.0.
pub const ACCESS_PORT: u16 = 384;
/// Service of uavcan.register.List.1.0.
pub const LIST_PORT: u16 = 385;
/// Registers of a node.
pub const REGISTERS: usize = TABLE.len() + READ_ONLY.len() + 3 * TABLE.len();

const NAME_MAX: usize = 64;
/// Bytes of the longest answer: time, flags, and a mask of taxels.
pub(super) const ACCESS_BYTES: usize = 7 + 1 + 1 + 2 + 8 * ELEMENTS_MAX;
pub(super) const LIST_BYTES: usize = 1 + NAME_MAX;

const MUTABLE: u8 = 1;
const PERSISTENT: u8 = 2;

#[derive(Clone, Copy)]
enum Register {
    Setting(Setting),
    /// One of the three that the standard derives from a setting.
    Derived(Setting, u8),
    ReadOnly(&'static str, ReadOnly),
}

const SUFFIXES: [u8; 3] = *b"<>=";

impl Register {
    fn from_name(name: &[u8]) -> Option<Self> {
        if let Some(setting) = Setting::from_name(name) {
            return Some(Self::Setting(setting));
        }
        if let Some(&(name, what)) = READ_ONLY.iter().find(|(other, _)| other.as_bytes() == name) {
            return Some(Self::ReadOnly(name, what));
        }
        let (&suffix, name) = name.split_last()?;
        let setting = Setting::from_name(name).filter(|_| SUFFIXES.contains(&suffix))?;
        Some(Self::Derived(setting, suffix))
    }
}

/// The answer to a List request; its length. An empty name: there are no more.
pub(super) fn list(request: &[u8], out: &mut [u8; LIST_BYTES]) -> usize {
    let index = Fields::new(request).unsigned::<2>() as usize;
    let (name, suffix) = name(index);
    let mut writer = Writer::new(out);
    writer.put(&[(name.len() + usize::from(suffix.is_some())) as u8]);
    writer.put(name.as_bytes());
    if let Some(suffix) = suffix {
        writer.put(&[suffix]);
    }
    writer.len()
}

fn name(index: usize) -> (&'static str, Option<u8>) {
    if let Some(definition) = TABLE.get(index) {
        return (definition.name, None);
    }
    let index = index.saturating_sub(TABLE.len());
    if let Some((name, _)) = READ_ONLY.get(index) {
        return (name, None);
    }
    let index = index.saturating_sub(READ_ONLY.len());
    match (TABLE.get(index / SUFFIXES.len()), SUFFIXES.get(index % SUFFIXES.len())) {
        (Some(definition), Some(&suffix)) => (definition.name, Some(suffix)),
        _ => ("", None),
    }
}

/// What an Access request led to.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Effect {
    Read,
    /// A setting has a new value.
    Changed(Setting),
    /// The node is locked, and a setting stays as it is.
    Locked(&'static str),
    /// A value was refused by its rule.
    Refused(SettingError),
    /// This register cannot be written, or not with such a value.
    NotWritable(&'static str),
}

/// Serve an Access request; length of the answer, and what it led to. `bus_time_us` is 0 where it is not
/// known. `None`: the request is damaged, and an answer would claim otherwise.
pub(super) fn access(
    request: &[u8],
    settings: &mut Settings,
    state: &NodeState<'_>,
    bus_time_us: u64,
    out: &mut [u8; ACCESS_BYTES],
) -> Option<(usize, Effect)> {
    let mut fields = Fields::new(request);
    let length = fields.unsigned::<1>() as usize;
    let name = fields.slice(length);
    if !fields.is_whole() {
        return None;
    }
    let written = value::read(&mut fields);
    let register = Register::from_name(name);
    let effect = match (register, written) {
        (_, Written::Nothing) | (None, _) => Effect::Read,
        (Some(Register::Setting(setting)), _) if state.locked => Effect::Locked(setting.definition().name),
        (Some(Register::Setting(setting)), Written::Numbers(numbers)) => {
            match settings.set(setting, &numbers) {
                Ok(true) => Effect::Changed(setting),
                Ok(false) => Effect::Read,
                Err(error) => Effect::Refused(error),
            }
        }
        (Some(Register::Setting(setting)), Written::Unusable) | (Some(Register::Derived(setting, _)), _) => {
            Effect::NotWritable(setting.definition().name)
        }
        (Some(Register::ReadOnly(name, _)), _) => Effect::NotWritable(name),
    };
    let mut writer = Writer::new(out);
    writer.put_saturated::<7>(bus_time_us);
    match register {
        None => writer.put(&[0, value::TAG_EMPTY]),
        Some(Register::Setting(setting)) => {
            writer.put(&[MUTABLE | PERSISTENT]);
            value::put_numbers(&mut writer, setting.definition().kind, settings.get(setting));
        }
        Some(Register::Derived(setting, suffix)) => {
            writer.put(&[PERSISTENT]);
            let definition = setting.definition();
            value::put_numbers(&mut writer, definition.kind, &derived(definition, suffix));
        }
        Some(Register::ReadOnly(_, what)) => {
            writer.put(&[0]);
            match state.answer(what) {
                Answer::Numbers(kind, numbers) => value::put_numbers(&mut writer, kind, &numbers),
                Answer::Bytes(bytes) => value::put_bytes(&mut writer, bytes),
            }
        }
    }
    Some((writer.len(), effect))
}

fn derived(definition: &Definition, suffix: u8) -> Vec<i64, ELEMENTS_MAX> {
    let mut elements = Vec::new();
    for (index, &default) in definition.default.iter().enumerate() {
        let (min, max) = definition.rule(index).bounds();
        // There is room: no setting is longer.
        let _ = elements.push(match suffix {
            b'<' => max,
            b'>' => min,
            _ => default,
        });
    }
    elements
}
