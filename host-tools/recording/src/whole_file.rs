//! A file appears whole or not at all.

use std::fs::File;
use std::io;
use std::path::Path;

/// Let `fill` write a temporary file in the same folder and rename it to `path` when it is complete, so that an error
/// leaves neither half a file nor a damaged old one.
pub fn write_whole<T, E: From<io::Error>>(
    path: &Path,
    fill: impl FnOnce(&mut File) -> Result<T, E>,
) -> Result<T, E> {
    let folder = path.parent().filter(|folder| *folder != Path::new("")).unwrap_or(Path::new("."));
    let mut builder = tempfile::Builder::new();
    builder.prefix(".slipsense-").suffix(".partial");
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        // Temporary files are private by default; a result is as readable as the umask lets it be.
        builder.permissions(std::fs::Permissions::from_mode(0o666));
    }
    let mut file = builder.tempfile_in(folder)?;
    // Past the temporary file's own methods, whose errors name it and not the file that is wanted.
    let result = fill(file.as_file_mut())?;
    file.persist(path).map_err(|error| error.error)?;
    Ok(result)
}
