//! Results that appear whole or not at all: written beside their place and moved when they are complete.

use std::fs;
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};
use slipsense_recording::write_whole;
use tempfile::{Builder, TempDir};

const PREFIX: &str = ".slipsense-";
const SUFFIX: &str = ".partial";
/// Folder inside the temporary one, which is private: this one is as readable as the umask lets it be.
const FILES: &str = "files";

/// A result folder in the making. Dropped before [`commit`](Self::commit), it leaves nothing.
#[derive(Debug)]
pub struct OutputDir {
    target: PathBuf,
    staging: TempDir,
}

impl OutputDir {
    /// Check that `target` can be written, before any work is done.
    pub fn prepare(target: &Path) -> Result<Self> {
        refuse_file(target)?;
        // In the nearest folder that exists, the target itself if it does: the same file system in any case.
        let home = target.ancestors().find(|above| above.exists()).unwrap_or(Path::new("."));
        let staging = Builder::new().prefix(PREFIX).suffix(SUFFIX).tempdir_in(home).and_then(|staging| {
            fs::create_dir(staging.path().join(FILES))?;
            Ok(staging)
        });
        let staging = staging.with_context(|| format!("{}: cannot write this folder", target.display()))?;
        Ok(Self { target: target.to_owned(), staging })
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.staging.path().join(FILES).join(name)
    }

    pub fn write(&self, name: &str, content: impl AsRef<[u8]>) -> Result<()> {
        fs::write(self.path(name), content)
            .with_context(|| format!("{}: cannot write", self.target.join(name).display()))
    }

    /// Move everything into place; other files of a folder that existed stay.
    pub fn commit(self) -> Result<()> {
        self.rename().with_context(|| format!("{}: cannot move the results here", self.target.display()))
    }

    fn rename(&self) -> io::Result<()> {
        let files = self.staging.path().join(FILES);
        if !self.target.is_dir() {
            fs::create_dir_all(folder_of(&self.target))?;
            return fs::rename(files, &self.target);
        }
        for entry in fs::read_dir(files)? {
            let entry = entry?;
            fs::rename(entry.path(), self.target.join(entry.file_name()))?;
        }
        Ok(())
    }
}

/// A folder cannot be written where a file is.
pub fn refuse_file(folder: &Path) -> Result<()> {
    let is_file = folder.exists() && !folder.is_dir();
    ensure!(!is_file, "{}: is a file, the output must be a folder", folder.display());
    Ok(())
}

/// Check, before any work is done, that a file can be written at `path`.
pub fn check_file(path: &Path) -> Result<()> {
    ensure!(!path.is_dir(), "{}: is a folder, the output must be a file", path.display());
    let folder = folder_of(path);
    let test = Builder::new().prefix(PREFIX).tempfile_in(folder);
    test.map(drop).with_context(|| format!("{}: cannot write into this folder", folder.display()))
}

pub fn write_file(path: &Path, content: impl AsRef<[u8]>) -> Result<()> {
    write_whole(path, |file| file.write_all(content.as_ref()))
        .with_context(|| format!("{}: cannot write", path.display()))
}

/// What a process that was killed left of a file or folder in the making.
pub fn is_partial(path: &Path) -> bool {
    path.extension().is_some_and(|extension| SUFFIX[1..] == *extension)
}

fn folder_of(path: &Path) -> &Path {
    path.parent().filter(|parent| *parent != Path::new("")).unwrap_or(Path::new("."))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nothing_is_changed_before_the_commit() {
        let home = tempfile::tempdir().unwrap();
        let (folder, file) = (home.path().join("a/out"), home.path().join("a/out/x.txt"));
        for before in [None, Some("old")] {
            if let Some(text) = before {
                fs::write(&file, text).unwrap();
            }
            let now = || fs::read_to_string(&file).ok();
            for commit in [false, true] {
                let out = OutputDir::prepare(&folder).unwrap();
                out.write("x.txt", "new").unwrap();
                assert_eq!(now().as_deref(), before);
                if commit {
                    out.commit().unwrap();
                } else {
                    drop(out);
                    assert_eq!(folder.exists(), before.is_some());
                }
            }
            assert_eq!(now().as_deref(), Some("new"));
            assert_eq!(fs::read_dir(home.path()).unwrap().count(), 1, "nothing is left beside it");
        }
    }
}
