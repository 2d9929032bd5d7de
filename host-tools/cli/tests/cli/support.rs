//! The binary, and small inputs for it.

use std::ffi::OsStr;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};

use serde_json::Value;
use slipsense::net::format::Dims;
use slipsense::params::{TAXEL_COLS, TAXELS};
use slipsense::sensor::PiezoFrame;
use slipsense_recording::model_file::{ModelFile, random_model};
use slipsense_recording::{Episode, Meta};
use tempfile::TempDir;

pub fn slipsense(args: impl IntoIterator<Item = impl AsRef<OsStr>>) -> Output {
    Command::new(env!("CARGO_BIN_EXE_slipsense")).args(args).output().expect("the binary starts")
}

/// A folder for one test. In its command lines a word `@NAME` is the path of a file in it.
pub struct Place(TempDir);

impl Place {
    pub fn new() -> Self {
        Self(tempfile::tempdir().expect("a temporary folder"))
    }

    /// With a small valid episode `e.npz` and a small model `m.slipnet`.
    pub fn with_files() -> Self {
        let place = Self::new();
        episode().write(place.path("e.npz")).expect("an archive");
        place.file("m.slipnet", model_bytes());
        place
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    /// What is there, sorted.
    pub fn names(&self) -> Vec<String> {
        names(self.0.path())
    }

    pub fn file(&self, name: &str, content: impl AsRef<[u8]>) -> PathBuf {
        fs::write(self.path(name), content).expect("a file in a temporary folder");
        self.path(name)
    }

    pub fn words(&self, line: &str) -> Vec<String> {
        let word = |word: &str| match word.strip_prefix('@') {
            Some(name) => self.path(name).display().to_string(),
            None => word.to_owned(),
        };
        line.split_whitespace().map(word).collect()
    }

    /// A command that goes on by itself.
    pub fn start(&self, line: &str) -> Child {
        spawn(Command::new(env!("CARGO_BIN_EXE_slipsense")).args(self.words(line)))
    }

    /// The same where no file may be longer than this many blocks: a write fails as on a full disk.
    pub fn start_limited(&self, blocks: u32, line: &str) -> Child {
        let script = format!("trap '' XFSZ; ulimit -f {blocks}; exec \"$@\"");
        let command = ["-c", &script, "sh", env!("CARGO_BIN_EXE_slipsense")];
        spawn(Command::new("sh").args(command).args(self.words(line)))
    }

    /// Standard output of a command that must succeed.
    pub fn run(&self, line: &str) -> String {
        let output = slipsense(self.words(line));
        let error = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(output.status.success(), "{line}: {error}");
        assert_eq!(error, "", "{line}: nothing on standard error");
        String::from_utf8(output.stdout).expect("UTF-8")
    }

    pub fn json(&self, line: &str) -> Value {
        serde_json::from_str(&self.run(&format!("{line} --json"))).expect("JSON")
    }

    /// The error of a command that must fail: exit code 2, one line, but for an error in the command line itself.
    pub fn error(&self, line: &str) -> String {
        let output = slipsense(self.words(line));
        let error = String::from_utf8(output.stderr).expect("UTF-8");
        assert_eq!(output.status.code(), Some(2), "{line}: {error}");
        assert_eq!(String::from_utf8_lossy(&output.stdout), "", "{line}: nothing on standard output");
        let usage = error.contains("For more information, try '--help'");
        assert!(usage || error.lines().count() == 1, "{line}: one line: {error:?}");
        let text = error.trim_end().strip_prefix("error: ");
        text.unwrap_or_else(|| panic!("{line}: error: {error:?}")).to_owned()
    }

    /// Commands that must fail with a message that contains these words (`@NAME` as in the command, `…` for what stands
    /// between), and leave nothing behind.
    pub fn errors<L: AsRef<str>, R: AsRef<str>>(&self, cases: impl IntoIterator<Item = (L, R)>) {
        let before = self.names();
        for (line, rule) in cases {
            let (line, rule) = (line.as_ref(), self.words(rule.as_ref()).join(" "));
            let error = self.error(line);
            assert!(
                rule.split(" … ").all(|words| error.contains(words)),
                "{line}: {error:?} contains {rule:?}"
            );
            assert_eq!(self.names(), before, "{line}: nothing is left behind");
        }
    }
}

fn spawn(command: &mut Command) -> Child {
    command.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped());
    command.spawn().expect("it starts")
}

/// Names in a folder, sorted.
pub fn names(folder: &Path) -> Vec<String> {
    let entries = fs::read_dir(folder).expect("a folder");
    let mut names: Vec<_> =
        entries.map(|entry| entry.expect("an entry").file_name().into_string().expect("UTF-8")).collect();
    names.sort();
    names
}

/// A small episode with two sensors, of which the first is pressed from frame 20 on and slips from frame 30 on.
pub fn episode() -> Episode {
    const FRAMES: usize = 40;
    let counts = |frame: usize, sensor: usize| {
        let mut counts = [0; TAXELS];
        if sensor == 0 && frame >= 20 {
            for cell in 0..64 {
                let (row, col) = (12 + cell / 8, 12 + cell % 8);
                counts[row * TAXEL_COLS + col] = (100 + cell + frame) as u16;
            }
        }
        PiezoFrame::from_counts(counts).expect("counts")
    };
    // Any signal will do: a number generator's noise.
    let mut state = 1u32;
    let mut noise = || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 20) as i16 - 2048
    };
    let label: Vec<u8> = (0..FRAMES).map(|f| u8::from(f >= 20) + u8::from(f >= 30)).collect();
    Episode {
        sensors: 2,
        piezo: (0..2 * FRAMES).map(|i| counts(i / 2, i % 2)).collect(),
        xl: [(); 2].map(|()| (0..34 * FRAMES).map(|_| [(); 3].map(|()| noise())).collect()).to_vec(),
        xl_end: (0..2 * FRAMES).map(|i| ((i / 2 + 1) * 100 / 3) as u32).collect(),
        slip_true_mm_s: Some(label.iter().map(|&l| if l == 2 { 5.0 } else { 0.0 }).collect()),
        label: Some(label),
        meta: Meta::nominal(0.000488),
        ..Episode::default()
    }
}

pub fn unlabelled_episode() -> Episode {
    Episode { label: None, ..episode() }
}

/// That a text has all these words.
pub fn assert_says(text: &str, words: &[&str]) {
    for words in words {
        assert!(text.contains(words), "{words} is missing in\n{text}");
    }
}

/// The header of an ELF of 32 bits for ARM: where its segments and its sections are described, and how many they are.
/// The names of sections are in the last.
pub fn elf_header(segments: (u32, u16), sections: (u32, u16)) -> Vec<u8> {
    let half = |value: u16| value.to_le_bytes().to_vec();
    let word = |value: u32| value.to_le_bytes().to_vec();
    [
        b"\x7fELF\x01\x01\x01".to_vec(),
        vec![0; 9],
        [2, 40].map(half).concat(),
        [1, 0, segments.0, sections.0, 0].map(word).concat(),
        [52, 32, segments.1, 40, sections.1, sections.1.saturating_sub(1)].map(half).concat(),
    ]
    .concat()
}

/// A model that decides nothing, small so that an unoptimised build is fast.
pub fn model() -> ModelFile {
    let dims = Dims { conv_channels: [2, 2, 2], embed: 4, xl_kernel: 2, xl_channels: 4, heads: 2, window: 8 };
    random_model(dims, 1)
}

pub fn model_bytes() -> Vec<u8> {
    model().to_bytes().expect("a model")
}

pub fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or_else(|| panic!("{value} is a number"))
}
