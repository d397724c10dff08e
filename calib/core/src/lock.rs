//! One master a session and a stage: a file that a process holds locked while it works.
//!
//! The system gives the lock back when the process ends, however it ends: a file that was left behind locks nobody out.

use crate::files::FileError;
use std::fs::{File, OpenOptions, TryLockError};
use std::io::{ErrorKind, Read, Seek, Write};
use std::path::{Path, PathBuf};

/// Longest text of a holder, bytes.
const TEXT_LIMIT: u64 = 1024;

/// Folder of the locks of ports: the same for every process of this machine, whatever its environment says.
const PORT_LOCKS: &str = "/tmp";

/// Attempts on a file whose holders come and go.
const ATTEMPTS: u32 = 100;

/// Why a lock was not given.
#[derive(Debug, thiserror::Error)]
pub enum LockError {
    /// Another process holds it; its own words.
    #[error("{0}")]
    Held(String),
    /// The file system refused.
    #[error(transparent)]
    File(#[from] FileError),
}

/// A lock; given back when dropped.
#[derive(Debug)]
pub struct FileLock {
    file: File,
    path: PathBuf,
}

impl FileLock {
    /// Locks `path`, which is made where it is missing; `purpose` is what another process is told, e.g. `stage-sweep of s1`.
    ///
    /// # Errors
    /// [`LockError::Held`] with process and purpose of the holder.
    pub fn take(path: &Path, purpose: &str) -> Result<Self, LockError> {
        let fail = FileError::of("locking", path);
        for _ in 0..ATTEMPTS {
            let mut file = open(path).map_err(&fail)?;
            match file.try_lock() {
                Ok(()) => {}
                Err(TryLockError::WouldBlock) => {
                    let mut text = String::new();
                    // A holder that has not written yet is one all the same.
                    let _ = file.take(TEXT_LIMIT).read_to_string(&mut text);
                    let who = text.lines().next().filter(|line| !line.is_empty());
                    return Err(LockError::Held(who.unwrap_or("another process").to_owned()));
                }
                // A file system without locks keeps nobody out, and must not keep everybody out.
                Err(TryLockError::Error(e)) if e.kind() == ErrorKind::Unsupported => {}
                Err(TryLockError::Error(e)) => return Err(fail(e).into()),
            }
            // The holder before may have removed the file between the two calls: a lock on a file without a name keeps nobody out.
            if !is_at(&file, path) {
                continue;
            }
            // The words are for people; a file of another user is locked without them.
            let text = format!("process {} ({purpose})\n", std::process::id());
            let _ =
                file.set_len(0).and_then(|()| file.rewind()).and_then(|()| file.write_all(text.as_bytes()));
            return Ok(Self { file, path: path.to_owned() });
        }
        Err(LockError::Held("another process".to_owned()))
    }

    /// Locks a port for this machine: the path of a serial port, links resolved, or `host:port`.
    ///
    /// # Errors
    /// As for [`FileLock::take`].
    pub fn of_port(port: &str, purpose: &str) -> Result<Self, LockError> {
        let name = crate::provenance::sha256_hex(same_port(port).as_bytes());
        Self::take(&Path::new(PORT_LOCKS).join(format!("wcal-port-{}.lock", &name[..16])), purpose)
    }
}

impl Drop for FileLock {
    fn drop(&mut self) {
        // Removed while it is still locked, so that nobody loses a file of his own; one of another user stays, unlocked.
        let _ = std::fs::remove_file(&self.path);
        let _ = self.file.unlock();
    }
}

/// One name for one port.
fn same_port(port: &str) -> String {
    match port.strip_prefix("tcp://") {
        Some(address) => format!("tcp://{}", address.to_lowercase().replace("localhost:", "127.0.0.1:")),
        None => std::fs::canonicalize(port).map_or_else(|_| port.to_owned(), |p| p.display().to_string()),
    }
}

/// For reading and writing, or for reading where the file is another user's.
fn open(path: &Path) -> std::io::Result<File> {
    let mut options = OpenOptions::new();
    options.read(true).write(true).create(true).truncate(false);
    match options.open(path) {
        Err(e) if e.kind() == ErrorKind::PermissionDenied => crate::files::open(path),
        other => other,
    }
}

/// Whether the open file is still the one of this name.
#[cfg(unix)]
fn is_at(file: &File, path: &Path) -> bool {
    use std::os::unix::fs::MetadataExt;
    let (Ok(own), Ok(there)) = (file.metadata(), std::fs::metadata(path)) else { return false };
    (own.dev(), own.ino()) == (there.dev(), there.ino())
}

#[cfg(not(unix))]
fn is_at(_: &File, path: &Path) -> bool {
    path.exists()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_second_taker_is_told_who_holds_it_and_a_file_left_behind_locks_nobody_out() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.lock");
        std::fs::write(&path, "process 1 (killed)\n").unwrap();
        let first = FileLock::take(&path, "sweep of s1").unwrap();
        let LockError::Held(who) = FileLock::take(&path, "sweep of s2").unwrap_err() else { panic!("held") };
        assert_eq!(who, format!("process {} (sweep of s1)", std::process::id()));
        drop(first);
        assert!(!path.exists(), "nothing is left");
        // Control: given back, it is there for the next.
        FileLock::take(&path, "sweep of s2").unwrap();
    }

    #[test]
    fn a_port_has_one_lock_whatever_it_is_called() {
        let folder = tempfile::tempdir().unwrap();
        let device = folder.path().join("ttyUSB0");
        std::fs::write(&device, "").unwrap();
        let link = folder.path().join("by-id");
        std::os::unix::fs::symlink(&device, &link).unwrap();
        let [device, link] = [device, link].map(|p| p.display().to_string());
        assert_eq!(same_port(&device), same_port(&link));
        assert_eq!(same_port("tcp://LOCALHOST:5000"), same_port("tcp://127.0.0.1:5000"));
        assert_ne!(same_port("tcp://localhost:5000"), same_port("tcp://localhost:5001"), "control");
        let held = FileLock::of_port(&device, "a").unwrap();
        assert!(matches!(FileLock::of_port(&link, "b"), Err(LockError::Held(_))));
        drop(held);
        FileLock::of_port(&link, "b").unwrap();
    }
}
