//! Where the fields of the slip message lie, read from its DSDL definitions: what a DBC file and a C header need.

use anyhow::{Context, Result, bail};

const SLIP: &str = include_str!("../../../src/wire/dsdl/slipsense/6203.Slip.2.0.dsdl");
const CONTACT: &str = include_str!("../../../src/wire/dsdl/slipsense/SensorContact.2.0.dsdl");

/// A definition: its fields in order, each followed by what is said about it.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Definition {
    /// Fields, void ones left out.
    pub fields: Vec<Field>,
    /// Named values: name, value, what they mean.
    pub constants: Vec<(String, u32, String)>,
    pub bits: u32,
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Field {
    pub name: String,
    /// Bits from the start of the definition.
    pub offset: u32,
    /// Of an array: how many elements.
    pub count: Option<u32>,
    pub kind: Kind,
    pub comment: String,
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Kind {
    Bool,
    Unsigned(u32),
    /// Bits, two's complement.
    Signed(u32),
    Contact(Box<Definition>),
}

impl Kind {
    pub fn bits(&self) -> u32 {
        match self {
            Self::Bool => 1,
            Self::Unsigned(bits) | Self::Signed(bits) => *bits,
            Self::Contact(definition) => definition.bits,
        }
    }
}

/// A single value of a definition.
pub struct Leaf<'d> {
    /// The fields that lead to it and, of an array's element, its place there.
    pub path: Vec<(&'d Field, Option<u32>)>,
    /// Bits from the start of the definition.
    pub offset: u32,
}

impl Leaf<'_> {
    /// The field that it is, or an element of.
    pub fn field(&self) -> &Field {
        self.path.last().expect("a leaf is a field").0
    }
}

impl Definition {
    /// Its values one by one, in order.
    pub fn leaves(&self) -> Vec<Leaf<'_>> {
        let mut leaves = Vec::new();
        for field in &self.fields {
            for index in 0..field.count.unwrap_or(1) {
                let step = (field, field.count.map(|_| index));
                let start = field.offset + index * field.kind.bits();
                match &field.kind {
                    Kind::Contact(contact) => leaves.extend(contact.leaves().into_iter().map(|leaf| Leaf {
                        path: [vec![step], leaf.path].concat(),
                        offset: start + leaf.offset,
                    })),
                    _ => leaves.push(Leaf { path: vec![step], offset: start }),
                }
            }
        }
        leaves
    }
}

pub fn slip() -> Result<Definition> {
    parse(SLIP).context("6203.Slip.2.0.dsdl")
}

/// Fields, constants and comments of the subset of DSDL that the slip message is written in.
fn parse(text: &str) -> Result<Definition> {
    let mut definition = Definition::default();
    for (index, line) in text.lines().enumerate() {
        let (code, comment) =
            line.split_once('#').map_or((line, ""), |(code, comment)| (code, comment.trim()));
        let code = code.trim();
        if code.is_empty() {
            // A line of its own says something about the field above.
            if let Some(field) = definition.fields.last_mut().filter(|_| !comment.is_empty()) {
                field.comment = format!("{} {comment}", field.comment).trim().to_owned();
            }
            continue;
        }
        if code.starts_with('@') {
            continue;
        }
        definition.line(code, comment).with_context(|| format!("line {}: {code}", index + 1))?;
    }
    Ok(definition)
}

impl Definition {
    fn line(&mut self, code: &str, comment: &str) -> Result<()> {
        let (kind, rest) = code.split_once(' ').unwrap_or((code, ""));
        if let Some(bits) = kind.strip_prefix("void") {
            self.bits += bits.parse::<u32>()?;
            return Ok(());
        }
        if let Some((name, value)) = rest.split_once('=') {
            self.constants.push((name.trim().to_owned(), value.trim().parse()?, comment.to_owned()));
            return Ok(());
        }
        let (kind, count) = match kind.split_once('[') {
            Some((kind, count)) => (kind, Some(count.trim_end_matches(']').parse::<u32>()?)),
            None => (kind, None),
        };
        let kind = match kind {
            "bool" => Kind::Bool,
            "SensorContact.2.0" => Kind::Contact(Box::new(parse(CONTACT).context("SensorContact.2.0.dsdl")?)),
            kind => match (kind.strip_prefix("uint"), kind.strip_prefix("int")) {
                (Some(bits), _) => Kind::Unsigned(bits.parse()?),
                (_, Some(bits)) => Kind::Signed(bits.parse()?),
                _ => bail!("type {kind} is not known here"),
            },
        };
        let (offset, name) = (self.bits, rest.trim().to_owned());
        self.bits += kind.bits() * count.unwrap_or(1);
        self.fields.push(Field { name, offset, count, kind, comment: comment.to_owned() });
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use slipsense::wire::SLIP_BYTES;

    #[test]
    fn the_layout_is_as_long_as_the_message() {
        let slip = slip().unwrap();
        assert_eq!(slip.bits as usize, 8 * SLIP_BYTES);
        let flag = slip.fields.iter().find(|field| field.name == "slip").unwrap();
        assert_eq!((flag.offset, &flag.kind), (90, &Kind::Bool));
        assert!(flag.comment.starts_with("The flag to act on"), "{}", flag.comment);
        assert_eq!(slip.constants.len(), 15);
    }
}
