//! Files as people give them: read whole and bounded, written so that a reader sees the old content
//! or the new one.

use crate::text;
use std::fs;
use std::io::{self, Read, Write};
use std::path::{Path, PathBuf};

/// Largest file that is read into memory (tables, weights, pictures), bytes.
pub const MAX_BYTES: u64 = 1 << 30;
/// Largest text document (TOML, JSON, YAML), bytes: parsed, it takes up to a hundred times as much
/// memory.
pub const MAX_DOCUMENT_BYTES: u64 = 16 << 20;

/// The file system refused.
#[derive(Debug, thiserror::Error)]
#[error("{action} {}: {source}", text::brief(&path.display().to_string()))]
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
        move |source| Self {
            action,
            path: path.to_owned(),
            source,
        }
    }

    /// A file that was read and holds something else than it should.
    pub fn invalid(
        path: &Path,
        found: impl Into<Box<dyn std::error::Error + Send + Sync>>,
    ) -> Self {
        Self::of("reading", path)(io::Error::new(io::ErrorKind::InvalidData, found))
    }
}

/// Opens a regular file for reading. A pipe would wait for a writer, and a device may never end.
///
/// # Errors
/// Where the path is something else, with what it is, or the file system refuses.
pub fn open(path: impl AsRef<Path>) -> Result<fs::File, FileError> {
    let path = path.as_ref();
    open_regular(path).map_err(FileError::of("reading", path))
}

fn open_regular(path: &Path) -> io::Result<fs::File> {
    let kind = fs::metadata(path)?.file_type();
    if kind.is_file() {
        return fs::File::open(path);
    }
    let found = if kind.is_dir() {
        "a folder"
    } else {
        "a device or a pipe (save what comes out of it as a file)"
    };
    Err(io::Error::new(
        io::ErrorKind::InvalidInput,
        format!("expected a file, found {found}"),
    ))
}

/// Reads a regular file of at most [`MAX_BYTES`] whole.
///
/// # Errors
/// As [`open`], or where the file is larger.
pub fn read(path: impl AsRef<Path>) -> Result<Vec<u8>, FileError> {
    read_within(path, MAX_BYTES)
}

/// Reads a text document of at most [`MAX_DOCUMENT_BYTES`]; a byte order mark is omitted.
///
/// # Errors
/// As [`open`], or where the file is larger or no UTF-8 text, with what it is instead.
pub fn read_text(path: impl AsRef<Path>) -> Result<String, FileError> {
    let path = path.as_ref();
    let bytes = read_within(path, MAX_DOCUMENT_BYTES)?;
    let invalid = |found| FileError::invalid(path, found);
    Ok(text::utf8(&bytes).map_err(invalid)?.to_owned())
}

/// Reads a regular file of at most `most` bytes whole.
///
/// # Errors
/// As [`open`], or where the file is larger.
pub fn read_within(path: impl AsRef<Path>, most: u64) -> Result<Vec<u8>, FileError> {
    let path = path.as_ref();
    let fail = FileError::of("reading", path);
    let file = open(path)?;
    let size = file.metadata().map_err(&fail)?.len();
    let mut bytes = Vec::new();
    if size <= most {
        // A file that grows meanwhile ends where it would be too large.
        bytes.reserve_exact(usize::try_from(size).unwrap_or(0));
        file.take(most + 1).read_to_end(&mut bytes).map_err(&fail)?;
    }
    if size.max(bytes.len() as u64) > most {
        let found = format!(
            "expected a file of at most {most} bytes, found {}",
            size.max(most + 1)
        );
        return Err(fail(io::Error::new(io::ErrorKind::FileTooLarge, found)));
    }
    Ok(bytes)
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
    builder.prefix(HALF_WRITTEN[0]).suffix(HALF_WRITTEN[1]);
    #[cfg(unix)]
    {
        // The umask narrows this; the default of a temporary file would lock other readers out.
        use std::os::unix::fs::PermissionsExt;
        builder.permissions(fs::Permissions::from_mode(0o666));
    }
    let mut file = builder.tempfile_in(folder).map_err(&fail)?;
    // Whoever tidies the folder meanwhile sees that somebody is at work; a file system without
    // locks tidies nothing.
    let _ = file.as_file().try_lock();
    file.write_all(bytes).map_err(&fail)?;
    file.as_file().sync_all().map_err(&fail)?;
    file.persist(path).map_err(|e| fail(e.error))?;
    sync_folder(folder)
}

/// Begin and end of the names of files and folders that are being written.
pub const HALF_WRITTEN: [&str; 2] = [".wcal-", ".tmp"];

/// A file or folder that is being written, locked until the result is dropped; none where somebody
/// else holds it, or the file system has no locks.
pub fn hold(path: &Path) -> Option<fs::File> {
    fs::File::open(path)
        .ok()
        .filter(|open| open.try_lock().is_ok())
}

/// Removes what programs that were killed left half-written in a folder: what nobody holds locked
/// any more.
pub fn remove_abandoned(folder: &Path) {
    // What cannot be read or removed stays: it is in nobody's way.
    for entry in fs::read_dir(folder).into_iter().flatten().flatten() {
        let (name, path) = (entry.file_name(), entry.path());
        let name = name.to_string_lossy();
        let plain = entry
            .file_type()
            .is_ok_and(|kind| kind.is_file() || kind.is_dir());
        if plain
            && name.starts_with(HALF_WRITTEN[0])
            && name.ends_with(HALF_WRITTEN[1])
            && hold(&path).is_some()
        {
            let _ = if path.is_dir() {
                fs::remove_dir_all(&path)
            } else {
                fs::remove_file(&path)
            };
        }
    }
}

/// Brings the names in a folder onto the disk: a rename is only durable once its folder is.
///
/// # Errors
/// [`FileError`] where the folder cannot be opened or synced.
pub fn sync_folder(folder: &Path) -> Result<(), FileError> {
    let synced = if cfg!(unix) {
        fs::File::open(folder).and_then(|f| f.sync_all())
    } else {
        Ok(())
    };
    synced.map_err(FileError::of("writing", folder))
}

/// The folder that holds `path`; the working folder for a bare name.
pub fn folder_of(path: &Path) -> &Path {
    path.parent()
        .filter(|parent| !parent.as_os_str().is_empty())
        .unwrap_or(Path::new("."))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_folder_a_device_and_a_file_without_end_are_refused_and_a_file_is_read() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.txt");
        fs::write(&path, "\u{feff}a = 1\n").unwrap();
        assert_eq!(read_text(&path).unwrap(), "a = 1\n");
        assert_eq!(read(&path).unwrap().len(), 9);
        assert!(
            read(folder.path())
                .unwrap_err()
                .to_string()
                .contains("a folder")
        );
        let missing = read(folder.path().join("b")).unwrap_err();
        assert_eq!(missing.source.kind(), io::ErrorKind::NotFound);
        // Every reader names its file once, and no other one.
        let said = missing.to_string();
        assert!(said.starts_with("reading ") && said.matches("/b: ").count() == 1);
        assert!(!said.contains("a.txt"), "{said}");
        if cfg!(unix) {
            assert!(
                read(Path::new("/dev/zero"))
                    .unwrap_err()
                    .to_string()
                    .contains("a device")
            );
        }
        // A file with a hole: as large as it says, and not on the disk.
        fs::File::create(&path)
            .unwrap()
            .set_len(MAX_BYTES + 1)
            .unwrap();
        assert_eq!(
            read(&path).unwrap_err().source.kind(),
            io::ErrorKind::FileTooLarge
        );
        fs::write(&path, b"Temp (\xb0C)\n").unwrap();
        assert!(
            read_text(&path)
                .unwrap_err()
                .to_string()
                .contains("Latin-1")
        );
    }

    #[test]
    fn a_file_is_replaced_whole_and_nothing_else_is_left() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.txt");
        for text in ["first", "second, longer"] {
            write_atomic(&path, text.as_bytes()).unwrap();
            assert_eq!(fs::read_to_string(&path).unwrap(), text);
        }
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
        let error = write_atomic(&folder.path().join("missing/a.txt"), b"x")
            .unwrap_err()
            .to_string();
        assert!(
            error.starts_with("writing ") && error.contains("a.txt"),
            "{error}"
        );
    }

    #[test]
    fn what_a_killed_program_left_goes_and_what_is_being_written_stays() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        fs::create_dir(path(".wcal-a1B2c3.tmp")).unwrap();
        for name in [
            ".wcal-a1B2c3.tmp/points.csv",
            ".wcal-left99.tmp",
            ".wcal-reserve.tmp",
            "points.csv",
            ".wcal-x",
        ] {
            fs::write(path(name), "x").unwrap();
        }
        let held = fs::File::create(path(".wcal-held00.tmp")).unwrap();
        held.try_lock().unwrap();
        remove_abandoned(folder.path());
        let mut left: Vec<_> = fs::read_dir(folder.path())
            .unwrap()
            .map(|e| e.unwrap().file_name())
            .collect();
        left.sort();
        assert_eq!(left, [".wcal-held00.tmp", ".wcal-x", "points.csv"]);
        drop(held);
        remove_abandoned(folder.path());
        assert!(
            !path(".wcal-held00.tmp").exists(),
            "control: its program has ended"
        );
    }
}
