//! The bill of materials: every crate that the release is built from, by `cargo tree`, as CycloneDX.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::Path;

use anyhow::{Context as _, Result};
use serde_json::{Value, json};

use crate::firmware::FEATURE;
use crate::process::{answer, cargo, python, root, run};
use crate::toolchain::{TARGET, Toolchain, WEB_TARGET};

/// What is built, and how `cargo tree` selects it.
const PARTS: [(&str, &[&str]); 4] = [
    ("command", &["--package", "slipsense-cli", "--features", "train"]),
    ("wheel", &["--package", "slipsense-python"]),
    ("page", &["--package", "slipsense-view", "--target", WEB_TARGET]),
    ("firmware", &["--package", "slipsense", "--features", FEATURE, "--target", TARGET]),
];
/// Of CycloneDX' own library.
const VALIDATE: &str = "
import pathlib, sys
from cyclonedx.schema import SchemaVersion
from cyclonedx.validation.json import JsonStrictValidator
error = JsonStrictValidator(SchemaVersion.V1_6).validate_str(pathlib.Path(sys.argv[1]).read_text('utf-8'))
sys.exit(error and f'{sys.argv[1]}: {error}')
";

/// Of a crate: its licence, and the parts that it is in.
type Crates = BTreeMap<(String, String), (String, BTreeSet<&'static str>)>;

/// Write it, and let CycloneDX' own library check it.
pub fn write(path: &Path, commit: &str, timestamp: &str) -> Result<()> {
    let text = serde_json::to_string_pretty(&bill(commit, timestamp)?)? + "\n";
    fs::write(path, text).with_context(|| path.display().to_string())?;
    run(python()?.args(["-c", VALIDATE]).arg(path))
}

fn bill(commit: &str, timestamp: &str) -> Result<Value> {
    let lock = fs::read_to_string(root().join("Cargo.lock")).context("Cargo.lock")?;
    let mut crates = Crates::new();
    for (part, selection) in PARTS {
        let mut tree = cargo();
        tree.args(["tree", "--locked", "--edges", "normal,build", "--prefix", "none", "--no-dedupe"]);
        let tree = answer(tree.args(["--format", "{p}|{l}"]).args(selection)).context("cargo tree fails")?;
        for line in tree.lines() {
            let (package, licence) = line.split_once('|').with_context(|| line.to_owned())?;
            let mut words = package.split(' ');
            let (name, version) = words.next().zip(words.next()).with_context(|| line.to_owned())?;
            let key = (name.to_owned(), version.trim_start_matches('v').to_owned());
            crates.entry(key).or_insert_with(|| (expression(licence), BTreeSet::new())).1.insert(part);
        }
    }
    let components = crates.iter().map(|((name, version), (licence, parts))| {
        let purl = format!("pkg:cargo/{name}@{version}");
        let parts = parts.iter().map(|part| json!({"name": "slipsense:part", "value": part}));
        let mut component = json!({
            "type": "library", "bom-ref": purl, "name": name, "version": version, "purl": purl,
            "licenses": [{"expression": licence}], "properties": parts.collect::<Vec<_>>(),
        });
        if let Some(sha256) = checksum(&lock, name, version) {
            component["hashes"] = json!([{"alg": "SHA-256", "content": sha256}]);
        }
        component
    });
    let compiler = |what, version: Option<String>| json!({"type": "application", "name": what, "version": version.unwrap_or_default()});
    let compilers = [
        compiler("rustc of the computer's programs", Toolchain::Host.version()),
        compiler("rustc of the board's programs", Toolchain::get()?.version()),
    ];
    Ok(json!({
        "bomFormat": "CycloneDX", "specVersion": "1.6", "version": 1,
        "metadata": {
            "timestamp": timestamp,
            "tools": {"components": compilers},
            "component": {"type": "application", "name": "slipsense", "version": env!("CARGO_PKG_VERSION")},
            "properties": [{"name": "slipsense:commit", "value": commit}],
        },
        "components": components.collect::<Vec<_>>(),
    }))
}

/// As SPDX writes it: older crates have a slash.
fn expression(licence: &str) -> String {
    licence.split('/').map(str::trim).collect::<Vec<_>>().join(" OR ")
}

/// Of the archive on crates.io; our own packages have none.
fn checksum<'l>(lock: &'l str, name: &str, version: &str) -> Option<&'l str> {
    let (_, rest) = lock.split_once(&format!("name = \"{name}\"\nversion = \"{version}\"\n"))?;
    rest.split("\n\n").next()?.split_once("checksum = \"")?.1.split('"').next()
}
