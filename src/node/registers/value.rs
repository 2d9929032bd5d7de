//! uavcan.register.Value.1.0: a union of arrays. The tag says of what, a length how many follow.

use heapless::Vec;

use super::super::fields::Fields;
use crate::settings::{ELEMENTS_MAX, Kind};
use crate::wire::bytes::Writer;

/// No value: there is no such register, or nothing is written.
pub(super) const TAG_EMPTY: u8 = 0;
const TAG_UNSTRUCTURED: u8 = 2;
/// The kinds of numbers in the order of their tags, from 3 on.
const KINDS: [Kind; 9] = [
    Kind::Bit,
    Kind::Integer64,
    Kind::Integer32,
    Kind::Integer16,
    Kind::Integer8,
    Kind::Natural64,
    Kind::Natural32,
    Kind::Natural16,
    Kind::Natural8,
];
const TAG_FIRST: u8 = 3;

/// The length before the elements has 16 bits where there may be more than 255: bits and single bytes.
fn length_bytes(kind: Kind) -> usize {
    if kind.bytes() == 1 { 2 } else { 1 }
}

/// What somebody wants to write.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Written {
    Nothing,
    Numbers(Vec<i64, ELEMENTS_MAX>),
    /// Text, bytes or real numbers, more numbers than any setting has, or bytes that are no value.
    Unusable,
}

/// Read a value. Numbers of every kind are taken: their range is what a setting looks at.
pub(super) fn read(fields: &mut Fields<'_>) -> Written {
    let tag = fields.unsigned::<1>() as u8;
    // Without any value there is only a name: as the zeros that DSDL puts there.
    if tag == TAG_EMPTY {
        return Written::Nothing;
    }
    let Some(&kind) = tag.checked_sub(TAG_FIRST).and_then(|index| KINDS.get(usize::from(index))) else {
        return Written::Unusable;
    };
    let count =
        if length_bytes(kind) == 2 { fields.unsigned::<2>() } else { fields.unsigned::<1>() } as usize;
    let mut numbers = Vec::new();
    if count > ELEMENTS_MAX {
        return Written::Unusable;
    }
    if kind == Kind::Bit {
        let bytes = fields.slice(count.div_ceil(8));
        for index in 0..count {
            let byte = bytes.get(index / 8).copied().unwrap_or(0);
            // There is room: `count` is at most the capacity.
            let _ = numbers.push(i64::from(byte >> (index % 8) & 1));
        }
    } else {
        for _ in 0..count {
            let Some(number) = kind.read(fields.slice(kind.bytes())) else { return Written::Unusable };
            let _ = numbers.push(number);
        }
    }
    if fields.is_whole() { Written::Numbers(numbers) } else { Written::Unusable }
}

pub(super) fn put_numbers(writer: &mut Writer<'_>, kind: Kind, numbers: &[i64]) {
    let index = KINDS.iter().position(|&other| other == kind).unwrap_or(0);
    writer.put(&[TAG_FIRST + index as u8]);
    writer.put((numbers.len() as u16).to_le_bytes().get(..length_bytes(kind)).unwrap_or(&[]));
    if kind == Kind::Bit {
        for bits in numbers.chunks(8) {
            let byte = bits.iter().rev().fold(0, |byte, &bit| byte << 1 | u8::from(bit != 0));
            writer.put(&[byte]);
        }
    } else {
        for number in numbers {
            writer.put(number.to_le_bytes().get(..kind.bytes()).unwrap_or(&[]));
        }
    }
}

pub(super) fn put_bytes(writer: &mut Writer<'_>, bytes: &[u8]) {
    writer.put(&[TAG_UNSTRUCTURED]);
    writer.put(&(bytes.len() as u16).to_le_bytes());
    writer.put(bytes);
}
