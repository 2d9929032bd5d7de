//! A folder of results that appears whole or not at all.
//!
//! Files are written into a temporary folder on the same file system and moved when all are there.

use std::fs;
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use tempfile::TempDir;

/// A result folder in the making. Dropped before [`commit`](Self::commit), it leaves nothing.
#[derive(Debug)]
pub struct OutputDir {
    target: PathBuf,
    existed: bool,
    /// Folders that had to be made to reach the target, outermost first.
    made: Vec<PathBuf>,
    staging: TempDir,
    committed: bool,
}

impl OutputDir {
    /// Check that `target` can be written, before any work is done.
    pub fn prepare(target: &Path) -> Result<Self> {
        let cannot = || format!("{}: cannot write this folder", target.display());
        if target.exists() && !target.is_dir() {
            bail!("{}: is a file, the output must be a folder", target.display());
        }
        let existed = target.is_dir();
        // Beside a folder that is there already may not be writable, or be another file system.
        let home = if existed { target } else { parent(target) };
        let mut made = Vec::new();
        let staging = make_folders(home, &mut made).and_then(|()| {
            let staging =
                tempfile::Builder::new().prefix(".slipsense-").suffix(".partial").tempdir_in(home)?;
            // Made by the umask's rules, unlike the private temporary folder around it.
            fs::create_dir(staging.path().join(FILES))?;
            Ok(staging)
        });
        match staging {
            Ok(staging) => Ok(Self { target: target.to_owned(), existed, made, staging, committed: false }),
            Err(error) => {
                remove_folders(&made);
                Err(error).with_context(cannot)
            }
        }
    }

    /// Where to write the file of this name.
    pub fn path(&self, name: &str) -> PathBuf {
        self.staging.path().join(FILES).join(name)
    }

    /// Write a file of text or bytes.
    pub fn write(&self, name: &str, content: impl AsRef<[u8]>) -> Result<()> {
        fs::write(self.path(name), content)
            .with_context(|| format!("{}: cannot write", self.target.join(name).display()))
    }

    /// Move everything into place.
    pub fn commit(mut self) -> Result<()> {
        self.rename().with_context(|| format!("{}: cannot move the results here", self.target.display()))?;
        self.committed = true;
        Ok(())
    }

    fn rename(&self) -> io::Result<()> {
        let files = self.staging.path().join(FILES);
        if !self.existed {
            return fs::rename(files, &self.target);
        }
        for entry in fs::read_dir(files)? {
            let entry = entry?;
            fs::rename(entry.path(), self.target.join(entry.file_name()))?;
        }
        Ok(())
    }
}

/// Folder inside the temporary one.
const FILES: &str = "files";

impl Drop for OutputDir {
    fn drop(&mut self) {
        if !self.committed {
            // What cannot be removed here is an empty folder at most.
            let _ = fs::remove_dir_all(self.staging.path());
            remove_folders(&self.made);
        }
    }
}

/// Check, before any work is done, that a file can be written at `path`.
pub fn check_file(path: &Path) -> Result<()> {
    if path.is_dir() {
        bail!("{}: is a folder, the output must be a file", path.display());
    }
    let folder = parent(path);
    tempfile::Builder::new()
        .prefix(".slipsense-")
        .tempfile_in(folder)
        .map(drop)
        .with_context(|| format!("{}: cannot write into this folder", folder.display()))
}

/// Write a file that appears whole or not at all.
pub(crate) fn write_whole(file: &Path, content: impl AsRef<[u8]>) -> io::Result<()> {
    let mut builder = tempfile::Builder::new();
    builder.prefix(".slipsense-").suffix(".partial");
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        // Temporary files are private by default; a result is as readable as the umask lets it be.
        builder.permissions(fs::Permissions::from_mode(0o666));
    }
    let mut partial = builder.tempfile_in(parent(file))?;
    partial.as_file_mut().write_all(content.as_ref())?;
    partial.persist(file).map_err(|error| error.error)?;
    Ok(())
}

/// Make a folder and what is missing above it, keeping note of what was made.
pub(crate) fn make_folders(folder: &Path, made: &mut Vec<PathBuf>) -> io::Result<()> {
    if folder.is_dir() {
        return Ok(());
    }
    if let Some(above) = folder.parent().filter(|above| *above != Path::new("")) {
        make_folders(above, made)?;
    }
    fs::create_dir(folder)?;
    made.push(folder.to_owned());
    Ok(())
}

pub(crate) fn remove_folders(made: &[PathBuf]) {
    for folder in made.iter().rev() {
        // Only an empty folder goes; one that somebody else used meanwhile stays.
        let _ = fs::remove_dir(folder);
    }
}

fn parent(path: &Path) -> &Path {
    path.parent().filter(|parent| *parent != Path::new("")).unwrap_or(Path::new("."))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(folder: &Path) -> Vec<String> {
        let mut names: Vec<_> =
            fs::read_dir(folder).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
        names.sort();
        names
    }

    #[test]
    fn a_new_folder_appears_at_commit_only() {
        let home = tempfile::tempdir().unwrap();
        let target = home.path().join("a/b/out");
        let out = OutputDir::prepare(&target).unwrap();
        out.write("x.txt", "x").unwrap();
        assert!(!target.exists());
        out.commit().unwrap();
        assert_eq!(names(&target), ["x.txt"]);
        assert_eq!(names(&home.path().join("a/b")), ["out"]);
    }

    #[test]
    fn an_abandoned_folder_leaves_nothing() {
        let home = tempfile::tempdir().unwrap();
        let out = OutputDir::prepare(&home.path().join("a/b/out")).unwrap();
        out.write("x.txt", "x").unwrap();
        drop(out);
        assert!(names(home.path()).is_empty());
    }

    #[test]
    fn an_existing_folder_keeps_its_other_files() {
        let home = tempfile::tempdir().unwrap();
        fs::write(home.path().join("mine"), "mine").unwrap();
        fs::write(home.path().join("x.txt"), "old").unwrap();
        let out = OutputDir::prepare(home.path()).unwrap();
        out.write("x.txt", "new").unwrap();
        assert_eq!(fs::read(home.path().join("x.txt")).unwrap(), b"old");
        out.commit().unwrap();
        assert_eq!(names(home.path()), ["mine", "x.txt"]);
        assert_eq!(fs::read(home.path().join("x.txt")).unwrap(), b"new");
    }

    #[test]
    fn a_file_where_a_folder_must_be_is_refused() {
        let home = tempfile::tempdir().unwrap();
        let file = home.path().join("file");
        fs::write(&file, "").unwrap();
        assert!(OutputDir::prepare(&file).is_err());
        assert!(OutputDir::prepare(&file.join("out")).is_err());
        assert_eq!(names(home.path()), ["file"]);
    }
}
