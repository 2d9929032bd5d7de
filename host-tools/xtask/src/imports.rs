//! No file of a crate imports another that imports it, directly or through others.
//!
//! An import is a path of a `use` or of an expression that leads to another file of the crate. A parent that lists its
//! children and re-exports what they hold imports nothing; neither do tests within a file.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

/// A module: names joined by `::`; the crate's root is empty.
type Module = String;

/// Source files by module, without comments and tests.
struct Crate(BTreeMap<Module, String>);

impl Crate {
    /// All files below the folder of this root file.
    fn read(root: &Path) -> Self {
        let folder = root.parent().unwrap();
        let mut files = BTreeMap::from([(Module::new(), source(&fs::read_to_string(root).unwrap()))]);
        let mut open = vec![(folder.to_owned(), Module::new())];
        while let Some((folder, parent)) = open.pop() {
            for path in fs::read_dir(&folder).unwrap().map(|entry| entry.unwrap().path()) {
                let name = path.file_stem().unwrap().to_str().unwrap().to_owned();
                let module = if parent.is_empty() { name.clone() } else { format!("{parent}::{name}") };
                if path.is_dir() {
                    open.push((path, module));
                } else if path.extension().is_some_and(|extension| extension == "rs") && path != root {
                    let module = if name == "mod" { parent.clone() } else { module };
                    files.insert(module, source(&fs::read_to_string(&path).unwrap()));
                }
            }
        }
        Self(files)
    }

    /// The module of the file that `path` leads to, seen from `from`.
    fn resolve(&self, from: &str, path: &str, depth: usize) -> Option<Module> {
        let mut at = from.to_owned();
        let mut names = path.split("::").peekable();
        match names.peek() {
            Some(&"crate") => (at, _) = (Module::new(), names.next()),
            Some(&"self") => _ = names.next(),
            Some(&"super") => {
                while names.next_if_eq(&"super").is_some() {
                    at = at.rsplit_once("::").map_or(Module::new(), |(parent, _)| parent.to_owned());
                }
            }
            // A module of this file, or another crate.
            Some(first) if self.0.contains_key(&join(&at, first)) => {}
            _ => return None,
        }
        for name in names {
            let child = join(&at, name);
            if self.0.contains_key(&child) {
                at = child;
                continue;
            }
            // Re-exported by this file: the import is of the file that holds it.
            let uses = uses(&self.0[&at]);
            let export = uses.iter().find(|(_, path)| path.rsplit("::").next() == Some(name));
            let target = export.and_then(|(_, path)| self.resolve(&at, path, depth.checked_sub(1)?));
            return Some(target.unwrap_or(at));
        }
        Some(at)
    }

    /// The modules that each one imports.
    fn imports(&self) -> BTreeMap<&str, BTreeSet<Module>> {
        let targets = |module: &Module, text: &str| {
            let is_name = |c: char| c.is_alphanumeric() || c == '_' || c == ':';
            let code = text.split(';').filter(|item| use_tree(item).is_none());
            let paths = code.flat_map(|item| item.split(|c| !is_name(c))).filter(|path| path.contains("::"));
            let mut paths: Vec<String> = paths.map(str::to_owned).collect();
            paths.extend(uses(text).into_iter().filter(|(is_export, _)| !is_export).map(|(_, path)| path));
            let targets = paths.iter().filter_map(|path| self.resolve(module, path, 8));
            targets.filter(|target| target != module).collect()
        };
        self.0.iter().map(|(module, text)| (module.as_str(), targets(module, text))).collect()
    }

    /// A circle, as modules of which each imports the next one.
    fn circle(&self) -> Option<Vec<Module>> {
        let imports = self.imports();
        // Leave out what imports nothing that is left, until nothing changes: what stays is on or before a circle.
        let mut left: BTreeSet<&str> = imports.keys().copied().collect();
        let leads_on =
            |left: &BTreeSet<&str>, module: &str| imports[module].iter().any(|to| left.contains(to.as_str()));
        while let Some(&leaf) = left.iter().find(|module| !leads_on(&left, module)) {
            left.remove(leaf);
        }
        let mut way = vec![(*left.first()?).to_owned()];
        loop {
            let next = imports[way.last()?.as_str()].iter().find(|to| left.contains(to.as_str()))?;
            if let Some(start) = way.iter().position(|module| module == next) {
                return Some(way.split_off(start));
            }
            way.push(next.clone());
        }
    }
}

fn join(parent: &str, name: &str) -> Module {
    if parent.is_empty() { name.to_owned() } else { format!("{parent}::{name}") }
}

/// Without tests, comments, and texts, which may name modules.
fn source(text: &str) -> String {
    let text = text.split("#[cfg(test)]\nmod ").next().unwrap_or_default().replace("'\"'", "");
    let (mut code, mut rest) = (String::new(), text.as_str());
    while let Some(start) = rest.find("//").into_iter().chain(rest.find('"')).min() {
        code += &rest[..start];
        let is_text = rest[start..].starts_with('"');
        rest = &rest[start + 1..];
        let mut escaped = false;
        let ends = |letter: char| {
            let ends = !escaped && letter == if is_text { '"' } else { '\n' };
            escaped = is_text && !escaped && letter == '\\';
            ends
        };
        rest = rest.split_once(ends).map_or("", |(_, rest)| rest);
        code.push('\n');
    }
    code + rest
}

/// The paths of all `use` items, one for each name, and whether they are re-exports.
fn uses(text: &str) -> Vec<(bool, String)> {
    let mut paths = Vec::new();
    for (is_export, tree) in text.split(';').filter_map(use_tree) {
        expand("", &tree.split_whitespace().collect::<String>(), is_export, &mut paths);
    }
    paths
}

/// Is this item a re-export, and of what? `None`: it is no `use`.
fn use_tree(item: &str) -> Option<(bool, &str)> {
    let (before, tree) = item.rsplit_once("use ")?;
    let visibility = before.rsplit('\n').next().unwrap_or_default().trim();
    (visibility.is_empty() || visibility.starts_with("pub")).then(|| (visibility.starts_with("pub"), tree))
}

/// `a::{b, c::{d, e}}` into its paths.
fn expand(prefix: &str, tree: &str, is_export: bool, paths: &mut Vec<(bool, String)>) {
    let Some((head, rest)) = tree.split_once('{') else {
        let path = format!("{prefix}{tree}");
        return paths.push((is_export, path.trim_end_matches("::self").to_owned()));
    };
    let (mut depth, mut part) = (0, String::new());
    for letter in rest.trim_end_matches('}').chars().chain([',']) {
        depth += i32::from(letter == '{') - i32::from(letter == '}');
        if letter != ',' || depth > 0 {
            part.push(letter);
        } else if !part.is_empty() {
            let closed = part.clone() + &"}".repeat(part.matches('{').count() - part.matches('}').count());
            expand(&format!("{prefix}{head}"), &closed, is_export, paths);
            part.clear();
        }
    }
    if !part.is_empty() {
        expand(&format!("{prefix}{head}"), part.trim_end_matches(','), is_export, paths);
    }
}

/// Crates that still hold a circle.
const OPEN: [&str; 7] = [
    "model",
    "host-tools/python",
    "host-tools/recording",
    "host-tools/cli",
    "host-tools/synth",
    "tests/twin",
    ".",
];

/// Root files of the crates of the repository.
fn roots(folder: &Path) -> Vec<PathBuf> {
    let mut found = Vec::new();
    for path in fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()) {
        let name = path.file_name().unwrap().to_str().unwrap();
        if path.is_dir() && !name.starts_with('.') && name != "target" {
            found.extend(roots(&path));
        }
    }
    if folder.join("Cargo.toml").exists() {
        found.extend(
            ["src/lib.rs", "src/main.rs"].map(|root| folder.join(root)).into_iter().find(|r| r.exists()),
        );
    }
    found
}

#[test]
fn no_crate_holds_a_circle() {
    let top = crate::process::root();
    let open = OPEN.map(|folder| top.join(folder).canonicalize().unwrap().join("src"));
    let roots = roots(top)
        .into_iter()
        .filter(|root| !open.contains(&root.canonicalize().unwrap().parent().unwrap().to_owned()));
    let circles = roots.filter_map(|root| {
        Some(format!("{}: {}", root.display(), Crate::read(&root).circle()?.join(" -> ")))
    });
    let circles: Vec<_> = circles.collect();
    assert!(circles.is_empty(), "files import each other:\n{}", circles.join("\n"));
}

#[test]
fn a_circle_is_found() {
    let files = |child: &str| {
        let parent = "mod a;\nmod b;\npub use a::{A, inner::{B, C}};\nfn f() { b::g() }";
        let files = [("", parent), ("a", "struct A; // use super::b"), ("a::inner", ""), ("b", child)];
        Crate(files.map(|(module, text)| (module.to_owned(), source(text))).into())
    };
    assert_eq!(files("use super::A; use crate::a::inner;").circle(), None);
    assert_eq!(files("fn g() { super::f() }").circle().unwrap(), ["", "b"]);
    assert_eq!(files("fn g() {}\n#[cfg(test)]\nmod tests { use super::super::f; }").circle(), None);
    let uses = uses("pub use a::{A, inner::{B, C}, d};");
    let paths: Vec<_> = uses.iter().map(|(_, path)| path.as_str()).collect();
    assert_eq!(paths, ["a::A", "a::inner::B", "a::inner::C", "a::d"]);
}
