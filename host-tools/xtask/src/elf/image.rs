//! Functions, sections and stack frames of an ELF file.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

use anyhow::{Context, Result, ensure};
use object::elf;
use object::{Object, ObjectSection, ObjectSymbol, SectionFlags, SymbolKind};

/// Where LLVM lists what each function takes of the stack (`-Z emit-stack-sizes`).
const STACK_SIZES: &str = ".stack_sizes";

#[derive(Default)]
pub struct Function {
    /// All that lie here, demangled, without the hash, in the order of the alphabet; and the first of them.
    pub names: Vec<String>,
    pub name: String,
    /// Bytes, the Thumb bit not set.
    pub address: u64,
    pub bytes: u64,
    /// Bytes that its frame takes, where the compiler says so.
    pub frame: Option<u64>,
}

pub struct Section {
    pub name: String,
    pub address: u64,
    pub bytes: u64,
    pub is_code: bool,
    /// Constants among them, and the first content of what is in RAM.
    pub is_in_flash: bool,
    /// What flash holds of it; nothing of what the start fills with zeros.
    content: Vec<u8>,
}

impl Section {
    /// The aligned words of its content.
    pub fn words(&self) -> impl Iterator<Item = u32> {
        self.content.as_chunks().0.iter().map(|&word| u32::from_le_bytes(word))
    }

    /// The same, without those of `data` if it is part of it.
    pub fn words_outside(&self, data: &[u8]) -> impl Iterator<Item = u32> {
        let at = self.content.windows(data.len()).position(|part| part == data);
        let hole = at.map_or(0..0, |at| at..at + data.len());
        self.words().zip((0..).step_by(4)).filter(move |(_, at)| !hole.contains(at)).map(|(word, _)| word)
    }
}

pub struct Image {
    /// By address.
    pub functions: Vec<Function>,
    pub sections: Vec<Section>,
    /// Symbols that are no functions: the linker script's among them.
    values: BTreeMap<String, u64>,
    /// Stretches of `$d`: data between instructions, by their first address, and where they end.
    data_in_code: BTreeMap<u64, u64>,
}

impl Image {
    pub fn read(path: &Path) -> Result<Self> {
        let bytes = fs::read(path).with_context(|| format!("cannot read {}", path.display()))?;
        Self::parse(&bytes).with_context(|| path.display().to_string())
    }

    fn parse(bytes: &[u8]) -> Result<Self> {
        let file = object::File::parse(bytes).context("not an ELF file")?;
        let mut image = Self {
            functions: functions(&file),
            sections: Vec::new(),
            values: BTreeMap::new(),
            data_in_code: data_in_code(&file),
        };
        ensure!(!image.functions.is_empty(), "the file has no symbols of functions");
        for symbol in file.symbols().filter(|symbol| symbol.kind() != SymbolKind::Text) {
            image.values.insert(symbol.name()?.to_owned(), symbol.address());
        }
        for section in file.sections() {
            let name = section.name()?.to_owned();
            if name == STACK_SIZES {
                add_frames(&mut image.functions, section.data()?)?;
            }
            let SectionFlags::Elf { sh_flags, .. } = section.flags() else { continue };
            let is = |flag: elf::SectionFlags| sh_flags & flag == flag;
            if !is(elf::SHF_ALLOC) || section.size() == 0 {
                continue;
            }
            let content = section.data()?.to_vec();
            let is_code = is(elf::SHF_EXECINSTR);
            image.sections.push(Section {
                name,
                address: section.address(),
                bytes: section.size(),
                is_code,
                is_in_flash: is_code || !is(elf::SHF_WRITE) || !content.is_empty(),
                content,
            });
        }
        Ok(image)
    }

    /// The function that this address lies in.
    pub fn function_at(&self, address: u64) -> Option<usize> {
        let index = self.functions.partition_point(|function| function.address <= address).checked_sub(1)?;
        let function = &self.functions[index];
        (address < function.address + function.bytes.max(1)).then_some(index)
    }

    /// The function that a pointer points to: to its first instruction, with the Thumb bit.
    pub fn function_of_pointer(&self, pointer: u32) -> Option<usize> {
        let address = u64::from(pointer & !1);
        let found = self.functions.binary_search_by_key(&address, |function| function.address);
        found.ok().filter(|_| pointer & 1 == 1)
    }

    /// Address of a symbol that is no function.
    pub fn value(&self, name: &str) -> Result<u64> {
        self.values.get(name).copied().with_context(|| format!("the program has no symbol `{name}`"))
    }

    /// The stretches of instructions of a function, each with its first address.
    pub fn code(&self, function: &Function) -> Vec<(u64, &[u8])> {
        let end = function.address + function.bytes;
        let mut stretches = Vec::new();
        let mut from = function.address;
        for (&data, &data_end) in self.data_in_code.range(function.address..end) {
            stretches.push((from, data));
            from = data_end;
        }
        stretches.push((from, end));
        stretches.retain(|(from, to)| from < to);
        stretches.into_iter().filter_map(|(from, to)| Some((from, self.bytes(from, to)?))).collect()
    }

    fn bytes(&self, from: u64, to: u64) -> Option<&[u8]> {
        self.sections.iter().find_map(|Section { address, content, .. }| {
            let from = usize::try_from(from.checked_sub(*address)?).ok()?;
            content.get(from..usize::try_from(to - address).ok()?)
        })
    }
}

/// One per address, by address.
fn functions(file: &object::File<'_>) -> Vec<Function> {
    let mut at = BTreeMap::<u64, Function>::new();
    for symbol in file.symbols().filter(|symbol| symbol.kind() == SymbolKind::Text && !symbol.is_undefined())
    {
        let Ok(name) = symbol.name() else { continue };
        if name.starts_with('$') {
            continue;
        }
        let name = format!("{:#}", rustc_demangle::demangle(name));
        let address = symbol.address() & !1;
        let function = at.entry(address).or_insert_with(|| Function { address, ..Function::default() });
        function.bytes = function.bytes.max(symbol.size());
        function.names.push(name);
    }
    for function in at.values_mut() {
        function.names.sort_unstable();
        function.name = function.names[0].clone();
    }
    // Assembly without a size reaches to the next function.
    let starts: Vec<u64> = at.keys().copied().collect();
    for (function, next) in at.values_mut().zip(starts.iter().skip(1)) {
        if function.bytes == 0 {
            function.bytes = next - function.address;
        }
    }
    at.into_values().collect()
}

/// From the mapping symbols: `$d` begins data, `$t` begins instructions again.
fn data_in_code(file: &object::File<'_>) -> BTreeMap<u64, u64> {
    let mut marks: Vec<(u64, bool)> = file
        .symbols()
        .filter_map(|symbol| {
            let name = symbol.name().ok()?;
            let is = |kind: &str| name == kind || name.starts_with(&format!("{kind}."));
            (is("$d") || is("$t")).then(|| (symbol.address() & !1, is("$d")))
        })
        .collect();
    marks.sort_unstable();
    let next = marks.iter().skip(1).map(|&(address, _)| address).chain([u64::MAX]);
    marks.iter().zip(next).filter(|((_, data), _)| *data).map(|(&(from, _), to)| (from, to)).collect()
}

/// LLVM's list: address (4 bytes), then the frame's bytes as ULEB128.
fn add_frames(functions: &mut [Function], mut list: &[u8]) -> Result<()> {
    while let Some((address, rest)) = list.split_first_chunk() {
        let address = u64::from(u32::from_le_bytes(*address) & !1);
        let (frame, rest) = uleb128(rest).context("the list of stack frames ends inside an entry")?;
        list = rest;
        if let Ok(index) = functions.binary_search_by_key(&address, |function| function.address) {
            functions[index].frame = Some(frame);
        }
    }
    Ok(())
}

fn uleb128(bytes: &[u8]) -> Option<(u64, &[u8])> {
    let length = 1 + bytes.iter().position(|byte| byte & 0x80 == 0)?;
    let (number, rest) = bytes.split_at(length);
    Some((number.iter().rev().fold(0, |value, byte| value << 7 | u64::from(byte & 0x7f)), rest))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_of_the_compiler_find_their_function() {
        let mut functions = [0x100, 0x200].map(|address| Function { address, ..Function::default() });
        // 0x101 with the Thumb bit: 624485 bytes; 0x300 is no function.
        let list = [&[1, 1, 0, 0, 0xe5, 0x8e, 0x26][..], &[0, 3, 0, 0, 8]].concat();
        add_frames(&mut functions, &list).unwrap();
        assert_eq!(functions.map(|function| function.frame), [Some(624_485), None]);
        assert!(add_frames(&mut [], &[1, 1, 0, 0, 0x80]).is_err(), "a cut entry");
    }
}
