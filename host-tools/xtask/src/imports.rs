//! No file of a crate imports another that imports it, directly or through others.
//!
//! An import is a path of a `use` or of an expression that leads to another file of the crate. A parent that lists its
//! children and re-exports what they hold imports nothing; neither do tests within a file. And the modules of the library
//! stand in dependency order.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::LazyLock;

use regex::Regex;

/// Names joined by `::`; the crate's root is empty.
type Module = String;

/// What a file says, without comments and tests.
struct Source {
    /// The paths of its `use` items, one for each name, and whether they are re-exports.
    uses: Vec<(bool, String)>,
    paths: Vec<String>,
}

static TEXT: LazyLock<Regex> = LazyLock::new(|| Regex::new(r#""(?s:\\.|[^"\\])*"|//.*"#).unwrap());
static USE: LazyLock<Regex> =
    LazyLock::new(|| Regex::new(r"(?m)^ *(pub(?:\([^)]*\))? )?use ([^;]+);").unwrap());
static PATH: LazyLock<Regex> = LazyLock::new(|| Regex::new(r"\w+(::\w+)+").unwrap());

impl Source {
    fn new(text: &str) -> Self {
        let text = text.split("#[cfg(test)]\nmod ").next().unwrap_or_default().replace("'\"'", "");
        let code = TEXT.replace_all(&text, "");
        let mut uses = Vec::new();
        for found in USE.captures_iter(&code) {
            let tree: String = found[2].split_whitespace().collect();
            expand("", &tree, &mut |path| uses.push((found.get(1).is_some(), path)));
        }
        let rest = USE.replace_all(&code, "");
        Self { uses, paths: PATH.find_iter(&rest).map(|found| found.as_str().to_owned()).collect() }
    }
}

/// `a::{b, c::{d, e}}` into its paths.
fn expand(prefix: &str, tree: &str, push: &mut dyn FnMut(String)) {
    let Some((head, rest)) = tree.split_once('{') else {
        return push(format!("{prefix}{tree}").trim_end_matches("::self").to_owned());
    };
    let (mut depth, mut start) = (0, 0);
    for (at, letter) in rest.char_indices() {
        depth += i32::from(letter == '{') - i32::from(letter == '}');
        if depth < 0 || depth == 0 && letter == ',' {
            if start < at {
                expand(&format!("{prefix}{head}"), &rest[start..at], push);
            }
            start = at + 1;
        }
    }
}

struct Crate(BTreeMap<Module, Source>);

impl Crate {
    /// All files below the folder of this root file.
    fn read(root: &Path) -> Self {
        let folder = root.parent().unwrap();
        let module = |path: &Path| {
            let name = path.strip_prefix(folder).unwrap().with_extension("");
            let names = name.iter().map(|name| name.to_str().unwrap()).filter(|&name| name != "mod");
            if path == root { Module::new() } else { names.collect::<Vec<_>>().join("::") }
        };
        let source = |path: PathBuf| (module(&path), Source::new(&fs::read_to_string(path).unwrap()));
        Self(files(folder).into_iter().map(source).collect())
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
            // What the file has from another one: the import is of that.
            let mut uses = self.0.get(&at)?.uses.iter();
            let source = uses.find(|(_, path)| path.rsplit("::").next() == Some(name));
            let target = source.and_then(|(_, path)| self.resolve(&at, path, depth.checked_sub(1)?));
            return Some(target.unwrap_or(at));
        }
        Some(at)
    }

    /// A circle, as modules of which each imports the next one.
    fn circle(&self) -> Option<Vec<Module>> {
        let targets = |(module, source): (&Module, &Source)| {
            let uses = source.uses.iter().filter(|(is_export, _)| !is_export).map(|(_, path)| path);
            let targets = source.paths.iter().chain(uses).filter_map(|path| self.resolve(module, path, 8));
            (module.clone(), targets.filter(|target| target != module).collect::<BTreeSet<_>>())
        };
        let mut imports: BTreeMap<Module, BTreeSet<Module>> = self.0.iter().map(targets).collect();
        // Leave out what imports nothing that is left, until nothing changes: what stays is on or before a circle.
        while let Some(leaf) = imports.iter().find_map(|(module, to)| to.is_empty().then(|| module.clone())) {
            imports.remove(&leaf);
            imports.values_mut().for_each(|to| _ = to.remove(&leaf));
        }
        let mut way = vec![imports.first_key_value()?.0.clone()];
        loop {
            let next = imports[way.last()?].first()?;
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

/// All Rust files below a folder.
fn files(folder: &Path) -> Vec<PathBuf> {
    let mut found = Vec::new();
    for path in fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()) {
        let name = path.file_name().unwrap().to_str().unwrap();
        if path.is_dir() && !name.starts_with('.') && name != "target" {
            found.extend(files(&path));
        } else if path.extension().is_some_and(|extension| extension == "rs") {
            found.push(path);
        }
    }
    found
}

#[test]
fn no_crate_holds_a_circle() {
    let circle =
        |root: PathBuf| Some(format!("{}: {}", root.display(), Crate::read(&root).circle()?.join(" -> ")));
    let is_root = |path: &PathBuf| {
        let is_crate = path.ancestors().nth(2).is_some_and(|folder| folder.join("Cargo.toml").exists());
        let is_main = path.ends_with("src/main.rs") && !path.with_file_name("lib.rs").exists();
        is_crate && (path.ends_with("src/lib.rs") || is_main)
    };
    let roots = files(crate::process::root()).into_iter().filter(is_root);
    let circles: Vec<_> = roots.filter_map(circle).collect();
    assert!(circles.is_empty(), "files import each other:\n{}", circles.join("\n"));
}

#[test]
fn no_module_of_the_library_imports_one_that_stands_below_it() {
    let root = crate::process::root().join("src/lib.rs");
    let text = fs::read_to_string(&root).unwrap();
    let order: Vec<_> =
        text.lines().filter_map(|line| line.strip_prefix("pub mod ")?.strip_suffix(';')).collect();
    assert!(order.contains(&"params") && order.contains(&"tasks"), "{order:?}");
    let place = |path: &str| order.iter().position(|module| path.split("::").next() == Some(module));
    let files = Crate::read(&root).0;
    let listed: Vec<_> =
        files.iter().filter_map(|(name, source)| Some((name, source, place(name)?))).collect();
    let found: BTreeSet<_> = listed.iter().map(|(.., place)| place).collect();
    assert_eq!(found.len(), order.len(), "every module has files");
    for (module, source, own) in listed {
        for path in source.uses.iter().map(|(_, path)| path).chain(&source.paths) {
            let target = path.strip_prefix("crate::").and_then(place);
            assert!(target.is_none_or(|target| target <= own), "{module} imports {path}");
        }
    }
}

#[test]
fn a_circle_is_found() {
    let files = |child: &str| {
        let parent = "mod a;\nmod b;\npub use a::{A, inner::{B, C}};\nfn f() { b::g() }";
        let files = [("", parent), ("a", "struct A; // super::b::g"), ("a::inner", ""), ("b", child)];
        Crate(files.map(|(module, text)| (module.to_owned(), Source::new(text))).into())
    };
    assert_eq!(files("use super::A;\nuse crate::a::inner;").circle(), None);
    assert_eq!(files("fn g() { super::f() }").circle().unwrap(), ["", "b"]);
    assert_eq!(files("fn g() {}\n#[cfg(test)]\nmod tests { use super::super::f; }").circle(), None);
    let source = Source::new("pub use a::{\n    A, inner::{B, C},\n    d,\n};");
    let paths: Vec<_> = source.uses.iter().map(|(_, path)| path.as_str()).collect();
    assert_eq!(paths, ["a::A", "a::inner::B", "a::inner::C", "a::d"]);
}
