//! Writing so that a reader sees the old content or the new one, never half of it.

use std::fs;
use std::io::{self, Write};
use std::path::{Path, PathBuf};

/// The file system refused.
#[derive(Debug, thiserror::Error)]
#[error("{action} {}: {source}", path.display())]
pub struct FileError {
    /// What was being done, e.g. `writing`.
    pub action: &'static str,
    /// File or folder.
    pub path: PathBuf,
    /// Cause.
    pub source: io::Error,
}

impl FileError {
    /// The error of `action` on `path`, for `map_err`.
    pub fn of<'a>(action: &'static str, path: &'a Path) -> impl Fn(io::Error) -> Self + 'a {
        move |source| Self { action, path: path.to_owned(), source }
    }
}

/// Writes `bytes` to `path` under a temporary name in the same folder, syncs, and renames.
/// The folder must exist. An existing file is replaced; two writers do not meet.
///
/// # Errors
/// [`FileError`]; `path` is then as it was before.
pub fn write_atomic(path: &Path, bytes: &[u8]) -> Result<(), FileError> {
    let fail = FileError::of("writing", path);
    let folder = folder_of(path);
    let mut builder = tempfile::Builder::new();
    builder.prefix(".wcal-").suffix(".tmp");
    #[cfg(unix)]
    {
        // The umask narrows this; the default of a temporary file would lock other readers out.
        use std::os::unix::fs::PermissionsExt;
        builder.permissions(fs::Permissions::from_mode(0o666));
    }
    let mut file = builder.tempfile_in(folder).map_err(&fail)?;
    file.write_all(bytes).map_err(&fail)?;
    file.as_file().sync_all().map_err(&fail)?;
    file.persist(path).map_err(|e| fail(e.error))?;
    sync_folder(folder)
}

/// Brings the names in a folder onto the disk: a rename is only durable once its folder is.
///
/// # Errors
/// [`FileError`] where the folder cannot be opened or synced.
pub fn sync_folder(folder: &Path) -> Result<(), FileError> {
    let synced = if cfg!(unix) { fs::File::open(folder).and_then(|f| f.sync_all()) } else { Ok(()) };
    synced.map_err(FileError::of("writing", folder))
}

/// The folder that holds `path`; the working folder for a bare name.
#[must_use]
pub fn folder_of(path: &Path) -> &Path {
    path.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_is_replaced_whole_and_nothing_else_is_left() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.txt");
        for text in ["first", "second, longer"] {
            write_atomic(&path, text.as_bytes()).unwrap();
            assert_eq!(fs::read_to_string(&path).unwrap(), text);
        }
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
        let error = write_atomic(&folder.path().join("missing/a.txt"), b"x").unwrap_err().to_string();
        assert!(error.starts_with("writing ") && error.contains("a.txt"), "{error}");
    }
}
