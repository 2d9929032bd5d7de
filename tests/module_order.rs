//! The modules of the library stand in the order of dependence: none imports one that stands below it.

use std::fs;
use std::path::{Path, PathBuf};

/// The `.rs` files of a module: its file, and all below its folder.
fn files(module: &str) -> Vec<PathBuf> {
    let src = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let (mut found, mut folders) = (Vec::new(), vec![src.join(module)]);
    found.extend(Some(src.join(format!("{module}.rs"))).filter(|file| file.exists()));
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(folder).into_iter().flatten() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
            } else if path.extension().is_some_and(|extension| extension == "rs") {
                found.push(path);
            }
        }
    }
    found
}

#[test]
fn no_module_imports_one_that_stands_below_it() {
    let lib = include_str!("../src/lib.rs");
    let modules: Vec<&str> =
        lib.lines().filter_map(|line| line.strip_prefix("pub mod ")?.strip_suffix(';')).collect();
    assert!(modules.contains(&"params") && modules.contains(&"tasks"), "{modules:?}");
    let mut upwards = Vec::new();
    for (index, module) in modules.iter().enumerate() {
        let files = files(module);
        assert!(!files.is_empty(), "{module}");
        for file in files {
            let text = fs::read_to_string(&file).unwrap();
            // Links in comments may point anywhere.
            let code = text.lines().filter(|line| !line.trim_start().starts_with("//"));
            for (line, later) in
                code.flat_map(|line| modules[index + 1..].iter().map(move |later| (line, later)))
            {
                let is_import = |(at, _): (usize, &str)| {
                    !line[at..]
                        .trim_start_matches("crate::")
                        .trim_start_matches(later)
                        .starts_with(|c: char| c.is_alphanumeric() || c == '_')
                };
                if line.match_indices(&format!("crate::{later}")).any(is_import) {
                    upwards.push(format!("{}: {line}", file.display()));
                }
            }
        }
    }
    assert!(upwards.is_empty(), "{}", upwards.join("\n"));
}
