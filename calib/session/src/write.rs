//! Writing so that a reader sees the old content or the new one, never half of it.

use crate::error::{InputError, SessionError};
use crate::session::{LoadedSession, load};
use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};

/// Writes `bytes` to `path` under a temporary name in the same folder, syncs, and renames.
/// The folder must exist. An existing file is replaced.
///
/// # Errors
/// [`SessionError::Io`]; `path` is then as it was before.
pub fn write_atomic(path: &Path, bytes: &[u8]) -> Result<(), SessionError> {
    let fail = |source| SessionError::Io { action: "writing", path: path.to_owned(), source };
    let folder = match path.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    };
    let mut builder = tempfile::Builder::new();
    builder.prefix(".wcal-").suffix(".tmp");
    #[cfg(unix)]
    {
        // The umask narrows this; the default of a temporary file would lock other readers out.
        use std::os::unix::fs::PermissionsExt;
        builder.permissions(fs::Permissions::from_mode(0o666));
    }
    let mut file = builder.tempfile_in(folder).map_err(fail)?;
    file.write_all(bytes).map_err(fail)?;
    file.as_file().sync_all().map_err(fail)?;
    file.persist(path).map_err(|e| fail(e.error))?;
    sync_folder(folder).map_err(fail)
}

/// A rename is only durable once the folder is.
fn sync_folder(folder: &Path) -> std::io::Result<()> {
    if cfg!(unix) { fs::File::open(folder)?.sync_all() } else { Ok(()) }
}

/// Files of a new session: `session.toml` and the tables it names.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct SessionFiles {
    /// Content of `session.toml`.
    pub session_toml: String,
    /// Name (relative, no folders) and content of every other file.
    pub tables: Vec<(String, Vec<u8>)>,
}

/// Writes a session folder in one step: everything goes to a temporary folder beside `folder`, is loaded from there with
/// every check, and only then renamed.
///
/// # Errors
/// Where `folder` exists and is not empty, where the content does not pass [`load`], or on I/O errors; nothing is left then.
pub fn write_session(folder: &Path, files: &SessionFiles) -> Result<LoadedSession, SessionError> {
    let fail = |source| SessionError::Io { action: "writing", path: folder.to_owned(), source };
    refuse_existing(folder)?;
    let name = folder.file_name().ok_or_else(|| {
        SessionError::from(InputError::new(
            &folder.display().to_string(),
            "the name of a new folder",
            "no name",
        ))
    })?;
    let parent = match folder.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    };
    fs::create_dir_all(parent).map_err(fail)?;
    let staging = Staging(parent.join(format!(".{}.{}.tmp", name.to_string_lossy(), std::process::id())));
    fs::create_dir(&staging.0).map_err(fail)?;
    for (table, bytes) in &files.tables {
        write_atomic(&staging.0.join(table), bytes)?;
    }
    write_atomic(&staging.0.join("session.toml"), files.session_toml.as_bytes())?;
    let mut session = load(&staging.0)?;
    fs::rename(&staging.0, folder).map_err(fail)?;
    sync_folder(parent).map_err(fail)?;
    folder.clone_into(&mut session.folder);
    Ok(session)
}

fn refuse_existing(folder: &Path) -> Result<(), SessionError> {
    let taken = match fs::read_dir(folder) {
        Ok(mut entries) => entries.next().is_some(),
        Err(_) => folder.exists(),
    };
    if taken {
        let name = folder.display().to_string();
        return Err(InputError::new(&name, "a folder that does not exist yet", "one with content").into());
    }
    Ok(())
}

/// A temporary folder that goes away with its owner, unless it was renamed.
struct Staging(PathBuf);

impl Drop for Staging {
    fn drop(&mut self) {
        // Renamed or never made: nothing to remove, and nothing to say.
        let _ = fs::remove_dir_all(&self.0);
    }
}
