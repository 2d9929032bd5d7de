//! The header of a `.npy` array: a Python dictionary literal of three known keys.

use std::io::{self, Read};

/// Longest header text accepted. NumPy writes about 100 bytes and refuses more than this by default.
const TEXT_BYTES_MAX: usize = 10_000;
/// NumPy aligns the data to this many bytes.
const ALIGN: usize = 64;
const MAGIC: &[u8; 6] = b"\x93NUMPY";

#[derive(Debug, PartialEq, Eq)]
pub(super) struct Header {
    /// Type string such as `<u2`; for a structured type, its whole literal.
    pub descr: String,
    pub fortran_order: bool,
    pub shape: Vec<u64>,
    /// Bytes from the magic to the first element.
    pub bytes: u64,
}

/// Read a header of `.npy` version 1, 2 or 3. An error says what is wrong in one line.
pub(super) fn read(from: &mut impl Read) -> Result<Header, String> {
    let cut = |e: io::Error| format!("has no .npy header: {e}");
    let mut start = [0; 8];
    from.read_exact(&mut start).map_err(cut)?;
    if start[..6] != *MAGIC {
        return Err("is not in .npy format".into());
    }
    let len_bytes = match start[6] {
        1 => 2,
        2 | 3 => 4,
        version => return Err(format!("is of .npy version {version}, must be 1, 2 or 3")),
    };
    let mut len = [0; 4];
    from.read_exact(&mut len[..len_bytes]).map_err(cut)?;
    let text_bytes = u32::from_le_bytes(len) as usize;
    if text_bytes > TEXT_BYTES_MAX {
        return Err(format!(".npy header of {text_bytes} bytes, must be at most {TEXT_BYTES_MAX}"));
    }
    let mut text = vec![0; text_bytes];
    from.read_exact(&mut text).map_err(cut)?;
    let text = String::from_utf8(text).map_err(|_| "has a .npy header that is not text")?;
    let (descr, fortran_order, shape) =
        Literal(&text).dictionary().ok_or("has a .npy header that is not the dictionary NumPy writes")?;
    Ok(Header { descr, fortran_order, shape, bytes: (start.len() + len_bytes + text_bytes) as u64 })
}

/// A version 1 header as NumPy writes it.
pub(super) fn write(descr: &str, shape: &[usize]) -> Vec<u8> {
    let shape: String = shape.iter().map(|n| format!("{n}, ")).collect();
    let shape = if shape.matches(',').count() == 1 { shape.trim_end() } else { shape.trim_end_matches(", ") };
    let text = format!("{{'descr': '{descr}', 'fortran_order': False, 'shape': ({shape}), }}");
    let prefix = MAGIC.len() + 4;
    let text_bytes = (prefix + text.len() + 1).next_multiple_of(ALIGN) - prefix;
    let mut header = MAGIC.to_vec();
    header.extend([1, 0]);
    header.extend((text_bytes as u16).to_le_bytes());
    header.extend(format!("{text:<width$}\n", width = text_bytes - 1).bytes());
    header
}

/// Scanner over the rest of a Python literal; every method is `None` on what it does not know.
struct Literal<'a>(&'a str);

impl<'a> Literal<'a> {
    fn dictionary(&mut self) -> Option<(String, bool, Vec<u64>)> {
        let (mut descr, mut fortran_order, mut shape) = (None, None, None);
        self.eat("{")?;
        while self.eat("}").is_none() {
            let key = self.string()?;
            self.eat(":")?;
            match key {
                "descr" => descr = Some(self.descr()?),
                "fortran_order" => fortran_order = Some(self.boolean()?),
                "shape" => shape = Some(self.tuple()?),
                _ => return None,
            }
            if self.eat(",").is_none() && !self.0.trim_start().starts_with('}') {
                return None;
            }
        }
        self.0.trim().is_empty().then_some(())?;
        Some((descr?, fortran_order?, shape?))
    }

    fn eat(&mut self, token: &str) -> Option<()> {
        self.0 = self.0.trim_start().strip_prefix(token)?;
        Some(())
    }

    fn string(&mut self) -> Option<&'a str> {
        let quote = if self.eat("'").is_some() { '\'' } else { self.eat("\"").map(|()| '"')? };
        let (string, rest) = self.0.split_once(quote)?;
        self.0 = rest;
        Some(string)
    }

    /// A type string, or a structured type as the list that it is, to be named when it is refused.
    fn descr(&mut self) -> Option<String> {
        if !self.0.trim_start().starts_with('[') {
            return self.string().map(str::to_owned);
        }
        let mut depth = 0usize;
        let end = self.0.find(|c| {
            match c {
                '[' => depth += 1,
                ']' => depth -= 1,
                _ => {}
            }
            c == ']' && depth == 0
        })?;
        let (list, rest) = self.0.split_at(end + 1);
        self.0 = rest;
        Some(list.trim_start().to_owned())
    }

    fn boolean(&mut self) -> Option<bool> {
        self.eat("True").map(|()| true).or_else(|| self.eat("False").map(|()| false))
    }

    fn tuple(&mut self) -> Option<Vec<u64>> {
        self.eat("(")?;
        let mut numbers = Vec::new();
        while self.eat(")").is_none() {
            let text = self.0.trim_start();
            let digits = text.len() - text.trim_start_matches(|c: char| c.is_ascii_digit()).len();
            numbers.push(text[..digits].parse().ok()?);
            self.0 = &text[digits..];
            if self.eat(",").is_none() && !self.0.trim_start().starts_with(')') {
                return None;
            }
        }
        Some(numbers)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Bytes of `numpy.save` (NumPy 2.2) for `numpy.zeros(shape, dtype)`, header only.
    fn numpy(text: &str) -> Vec<u8> {
        let mut bytes = b"\x93NUMPY\x01\x00\x76\x00".to_vec();
        bytes.extend(format!("{text:<117}\n").bytes());
        bytes
    }

    #[test]
    fn headers_are_the_bytes_that_numpy_writes() {
        for (descr, shape, text) in [
            (
                "<u2",
                &[7, 2, 32, 32][..],
                "{'descr': '<u2', 'fortran_order': False, 'shape': (7, 2, 32, 32), }",
            ),
            ("|u1", &[5], "{'descr': '|u1', 'fortran_order': False, 'shape': (5,), }"),
            ("<f4", &[], "{'descr': '<f4', 'fortran_order': False, 'shape': (), }"),
        ] {
            assert_eq!(write(descr, shape), numpy(text));
            let header = read(&mut &numpy(text)[..]).unwrap();
            assert_eq!(header.descr, descr);
            assert_eq!(header.shape, shape.iter().map(|&n| n as u64).collect::<Vec<_>>());
            assert!(!header.fortran_order);
            assert_eq!(header.bytes, 128);
        }
    }

    #[test]
    fn other_layouts_of_the_same_dictionary_are_read() {
        let header =
            read(&mut &numpy("{\"shape\":(3 ,4),\"fortran_order\":True,\"descr\":\">i4\"}")[..]).unwrap();
        assert_eq!(
            (header.descr.as_str(), header.fortran_order, &header.shape[..]),
            (">i4", true, &[3, 4][..])
        );
        let list = "[('a', '<u2', (2,)), ('b', [('c', '<f4')])]";
        let text = format!("{{'descr': {list}, 'fortran_order': False, 'shape': (3,), }}");
        assert_eq!(read(&mut &numpy(&text)[..]).unwrap().descr, list);
    }

    #[test]
    fn what_is_not_a_header_is_refused() {
        for text in [
            "",
            "{",
            "{}",
            "{'descr': '<u2', 'fortran_order': False}",
            "{'descr': '<u2', 'fortran_order': 0, 'shape': (1,)}",
            "{'descr': '<u2', 'fortran_order': False, 'shape': (-1,)}",
            "{'descr': '<u2', 'fortran_order': False, 'shape': (18446744073709551616,)}",
            "{'descr': '<u2', 'fortran_order': False, 'shape': (1 2)}",
            "{'descr': '<u2', 'fortran_order': False, 'shape': (,)}",
            "{'descr': '<u2' 'fortran_order': False, 'shape': (1,)}",
            "{'descr': '<u2', 'fortran_order': False, 'shape': (1,)} x",
            "{'descr': ], 'fortran_order': False, 'shape': (1,)}",
            "{'descr': [], 'descr': []], 'fortran_order': False, 'shape': (1,)}",
        ] {
            let error = read(&mut &numpy(text)[..]).unwrap_err();
            assert!(error.contains("not the dictionary"), "{text}: {error}");
        }
        let start = |bytes: &[u8]| read(&mut &bytes[..]).unwrap_err();
        assert!(start(b"\x93NUM").contains("no .npy header"));
        assert!(start(b"PK\x03\x04....").contains("not in .npy format"));
        assert!(start(b"\x93NUMPY\x04\x00....").contains("version 4, must be 1, 2 or 3"));
        assert!(
            start(b"\x93NUMPY\x02\x00\xff\xff\xff\xff").contains("4294967295 bytes, must be at most 10000")
        );
        assert!(start(b"\x93NUMPY\x01\x00\x02\x00\xff\xff").contains("not text"));
        assert!(start(b"\x93NUMPY\x01\x00\x20\x00{").contains("no .npy header"));
    }
}
