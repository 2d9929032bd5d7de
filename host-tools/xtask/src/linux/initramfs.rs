//! The root of the emulated computer: busybox, the command with its libraries, the modules that it loads.

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::{BufWriter, Cursor, Write};
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};
use cpio::NewcBuilder;
use object::{Object, ObjectSection};

use super::packages::Debian;
use crate::process::{answer, command};

const INIT: &str = include_str!("init.sh");
/// SocketCAN with an interface of its own, and the folder that it shares with this computer.
const MODULES: [&str; 5] = ["can-raw", "vcan", "virtio_pci", "9pnet_virtio", "9p"];
const FOLDERS: [&str; 8] = ["bin", "dev", "modules", "proc", "share", "sys", "tmp", "lib"];
const S_IFDIR: u32 = 0o040_000;
const S_IFREG: u32 = 0o100_000;
/// Mode and content.
const FOLDER: (u32, Vec<u8>) = (S_IFDIR | 0o755, Vec::new());

/// Write it to `path`, with the program `slipsense`.
pub fn write(path: &Path, debian: &Debian, slipsense: &Path) -> Result<()> {
    let mut entries = BTreeMap::from(FOLDERS.map(|name| (PathBuf::from(name), FOLDER)));
    let program = |file: &Path| Ok::<_, anyhow::Error>((S_IFREG | 0o755, read(file)?));
    entries.insert("init".into(), (S_IFREG | 0o755, INIT.as_bytes().to_vec()));
    entries.insert("bin/busybox".into(), program(&debian.busybox)?);
    entries.insert("bin/slipsense".into(), program(slipsense)?);
    for library in libraries(slipsense)? {
        let name = library.strip_prefix("/").unwrap_or(&library);
        let folders = name.ancestors().skip(1).filter(|folder| !folder.as_os_str().is_empty());
        entries.extend(folders.map(|folder| (folder.to_owned(), FOLDER)));
        entries.insert(name.to_owned(), program(&library)?);
    }
    let mut order = String::new();
    for (name, module) in modules(&debian.modules)? {
        order += &format!("{name}.ko\n");
        entries.insert(format!("modules/{name}.ko").into(), (S_IFREG | 0o644, module));
    }
    entries.insert("modules/order".into(), (S_IFREG | 0o644, order.into_bytes()));
    // By name: a folder comes before what is in it.
    let inputs = entries.into_iter().map(|(name, (mode, content))| {
        (NewcBuilder::new(&name.to_string_lossy()).mode(mode), Cursor::new(content))
    });
    let file = File::create(path).with_context(|| path.display().to_string())?;
    let written = cpio::write_cpio(inputs, BufWriter::new(file)).and_then(|mut file| file.flush());
    written.with_context(|| path.display().to_string())
}

fn read(path: &Path) -> Result<Vec<u8>> {
    fs::read(path).with_context(|| format!("{}: cannot read", path.display()))
}

/// The libraries that a program is linked to, and what loads them; none of a static one.
fn libraries(program: &Path) -> Result<Vec<PathBuf>> {
    let text =
        answer(command("ldd").arg(program)).with_context(|| format!("ldd {}: failed", program.display()))?;
    let path = |line: &str| line.split_whitespace().find(|word| word.starts_with('/')).map(PathBuf::from);
    Ok(text.lines().filter_map(path).collect())
}

/// The modules that are wanted, each behind those that it depends on. What the kernel has built in is left out.
fn modules(folder: &Path) -> Result<Vec<(String, Vec<u8>)>> {
    let list = |name: &str| {
        let path = folder.join(name);
        fs::read_to_string(&path).with_context(|| path.display().to_string())
    };
    let (modular, builtin) = (list("modules.order")?, list("modules.builtin")?);
    let mut loaded: Vec<(String, Vec<u8>)> = Vec::new();
    let mut wanted: Vec<String> = MODULES.iter().rev().map(|name| same(name)).collect();
    while let Some(name) = wanted.pop() {
        if loaded.iter().any(|(known, _)| *known == name) || path_of(&builtin, &name).is_some() {
            continue;
        }
        let path = path_of(&modular, &name);
        let path = path.with_context(|| format!("{}: the kernel has no module {name}", folder.display()))?;
        let module = unpack(&folder.join(path))?;
        let missing: Vec<_> = depends(&module).with_context(|| format!("module {name}"))?;
        let is_ready = |needed: &String| {
            loaded.iter().any(|(known, _)| known == needed) || path_of(&builtin, needed).is_some()
        };
        match missing.into_iter().find(|needed| !is_ready(needed)) {
            Some(needed) => wanted.extend([name, needed]),
            None => loaded.push((name, module)),
        }
    }
    Ok(loaded)
}

/// File and module names differ by this.
fn same(name: &str) -> String {
    name.replace('-', "_")
}

fn path_of<'l>(list: &'l str, name: &str) -> Option<&'l str> {
    list.lines().find(|path| {
        let file = path.rsplit('/').next().unwrap_or_default();
        file.split_once(".ko").is_some_and(|(stem, _)| same(stem) == name)
    })
}

/// The module as it is loaded: the lists name it without the ending of its compression.
fn unpack(path: &Path) -> Result<Vec<u8>> {
    if path.exists() {
        return read(path);
    }
    let packed = path.with_extension("ko.xz");
    ensure!(packed.exists(), "{}: neither there nor as .xz", path.display());
    let output =
        command("xz").args(["--decompress", "--stdout"]).arg(&packed).output().context("cannot start xz")?;
    ensure!(output.status.success(), "{}: xz cannot unpack it", packed.display());
    Ok(output.stdout)
}

fn depends(module: &[u8]) -> Result<Vec<String>> {
    let elf = object::File::parse(module).context("no ELF")?;
    let info = elf.section_by_name(".modinfo").context("has no .modinfo")?.data()?;
    let depends = info.split(|&byte| byte == 0).find_map(|field| field.strip_prefix(b"depends="));
    let depends = String::from_utf8_lossy(depends.context("says not what it depends on")?).into_owned();
    Ok(depends.split(',').filter(|name| !name.is_empty()).map(same).collect())
}
