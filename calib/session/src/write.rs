//! Writing a session folder in one step.

use crate::error::{InputError, SessionError};
use crate::session::{LoadedSession, load};
use std::fs;
use std::path::Path;
use wcal_core::files::{folder_of, sync_folder, write_atomic};

/// Files of a new session: `session.toml` and the tables it names.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct SessionFiles {
    /// Content of `session.toml`.
    pub session_toml: String,
    /// Name (relative, no folders) and content of every other file.
    pub tables: Vec<(String, Vec<u8>)>,
}

/// Writes a session folder in one step: everything goes to a temporary folder next to `folder`, is
/// loaded from there with every check, and only then renamed.
///
/// # Errors
/// Where `folder` exists and is not empty, where the content does not pass [`load`], or on I/O
/// errors; nothing remains then.
pub fn write_session(folder: &Path, files: &SessionFiles) -> Result<LoadedSession, SessionError> {
    let fail = |source| SessionError::Io {
        action: "writing",
        path: folder.to_owned(),
        source,
    };
    refuse_existing(folder)?;
    let name = folder.file_name().ok_or_else(|| {
        SessionError::from(InputError::new(
            &folder.display().to_string(),
            "the name of a new folder",
            "no name",
        ))
    })?;
    let parent = folder_of(folder);
    fs::create_dir_all(parent).map_err(fail)?;
    let staging = parent.join(format!(
        ".{}.{}.tmp",
        name.to_string_lossy(),
        std::process::id()
    ));
    fs::create_dir(&staging).map_err(fail)?;
    let written = staged(&staging, files).and_then(|session| {
        fs::rename(&staging, folder).map_err(fail)?;
        Ok(session)
    });
    let mut session = written.inspect_err(|_| {
        // Removing it may fail: that says nothing more than the error.
        let _ = fs::remove_dir_all(&staging);
    })?;
    sync_folder(parent)?;
    folder.clone_into(&mut session.folder);
    Ok(session)
}

fn staged(folder: &Path, files: &SessionFiles) -> Result<LoadedSession, SessionError> {
    for (table, bytes) in &files.tables {
        write_atomic(&folder.join(table), bytes)?;
    }
    write_atomic(&folder.join("session.toml"), files.session_toml.as_bytes())?;
    load(folder)
}

fn refuse_existing(folder: &Path) -> Result<(), SessionError> {
    let taken = match fs::read_dir(folder) {
        Ok(mut entries) => entries.next().is_some(),
        Err(_) => folder.exists(),
    };
    if taken {
        let name = folder.display().to_string();
        return Err(InputError::new(
            &name,
            "a folder that does not exist yet",
            "one with content",
        )
        .into());
    }
    Ok(())
}
