//! One master a session and a stage: a file that a process holds locked while it works.
//!
//! The system gives the lock back when the process ends, however it ends: a file that was left
//! behind locks nobody out.

use crate::files::FileError;
use std::collections::BTreeSet;
use std::fs::{File, OpenOptions, TryLockError};
use std::io::{ErrorKind, Read, Write};
use std::net::{IpAddr, Ipv4Addr, SocketAddr, ToSocketAddrs, UdpSocket};
use std::path::{Path, PathBuf};

/// Longest text of a holder, bytes.
const TEXT_LIMIT: u64 = 1024;

/// Folder of the locks of ports: the same for every process of this machine, whatever its
/// environment says.
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
    /// Locks `path`, which is made anew; `purpose` is what another process reads, e.g.
    /// `stage-sweep of s1`.
    ///
    /// # Errors
    /// [`LockError::Held`] with process and purpose of the holder, or what is there in place of a
    /// file.
    pub fn take(path: &Path, purpose: &str) -> Result<Self, LockError> {
        let fail = FileError::of("locking", path);
        for _ in 0..ATTEMPTS {
            // Only a file that this process makes is written to: a name may be a link to somebody's
            // file.
            let made = OpenOptions::new()
                .read(true)
                .write(true)
                .create_new(true)
                .open(path);
            let (mut file, own) = match made {
                Ok(file) => (file, true),
                Err(e) if e.kind() == ErrorKind::AlreadyExists => match open_plain(path) {
                    Ok(file) => (file, false),
                    Err(e) if e.kind() == ErrorKind::NotFound => continue,
                    Err(e) => return Err(fail(e).into()),
                },
                Err(e) => return Err(fail(e).into()),
            };
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
            // The holder before may have removed the file between the two calls: a lock on a file
            // without a name keeps nobody out. One that was left behind is removed; where another
            // user's cannot be, it is locked without words.
            if !is_at(&file, path) || !own && std::fs::remove_file(path).is_ok() {
                continue;
            }
            if own {
                // The words are for people.
                let _ = file
                    .write_all(format!("process {} ({purpose})\n", std::process::id()).as_bytes());
            }
            return Ok(Self {
                file,
                path: path.to_owned(),
            });
        }
        Err(LockError::Held("another process".to_owned()))
    }

    /// Locks a port for this machine: the path of a serial port, links resolved, or every address
    /// that `host:port` stands for.
    ///
    /// # Errors
    /// As for [`FileLock::take`].
    pub fn of_port(port: &str, purpose: &str) -> Result<Vec<Self>, LockError> {
        let take = |name: &String| {
            let hash = crate::provenance::sha256_hex(name.as_bytes());
            Self::take(
                &Path::new(PORT_LOCKS).join(format!("wcal-port-{}.lock", &hash[..16])),
                purpose,
            )
        };
        names_of(port).iter().map(take).collect()
    }
}

impl Drop for FileLock {
    fn drop(&mut self) {
        // Removed while it is still locked, so that nobody loses a file of his own; one of another
        // user stays, unlocked.
        let _ = std::fs::remove_file(&self.path);
        let _ = self.file.unlock();
    }
}

/// The names of a port, the same however it is written: the addresses behind a host's name, or the
/// path behind links.
fn names_of(port: &str) -> BTreeSet<String> {
    let Some(address) = port.strip_prefix("tcp://") else {
        let path = std::fs::canonicalize(port)
            .map_or_else(|_| port.to_owned(), |p| p.display().to_string());
        return BTreeSet::from([path]);
    };
    match address.to_socket_addrs() {
        Ok(all) => all
            .map(|one| format!("tcp://{}", SocketAddr::new(host_of(one.ip()), one.port())))
            .collect(),
        // A name that nobody knows opens no link.
        Err(_) => BTreeSet::from([port.to_lowercase()]),
    }
}

/// One address for a host: this machine's own are the loopback's.
fn host_of(ip: IpAddr) -> IpAddr {
    let ip = ip.to_canonical();
    // Only an address of this machine can be bound.
    let own = ip.is_loopback() || UdpSocket::bind((ip, 0)).is_ok();
    if own { Ipv4Addr::LOCALHOST.into() } else { ip }
}

/// Opens a plain file, never what a link points to; for reading alone where it is another user's.
fn open_plain(path: &Path) -> std::io::Result<File> {
    let refuse = || {
        std::io::Error::new(
            ErrorKind::InvalidInput,
            "expected a plain file, found a link or a folder",
        )
    };
    if !std::fs::symlink_metadata(path)?.is_file() {
        return Err(refuse());
    }
    match OpenOptions::new().read(true).write(true).open(path) {
        Err(e) if e.kind() == ErrorKind::PermissionDenied => {
            crate::files::open(path).map_err(|e| e.source)
        }
        other => other,
    }
}

/// Whether the open file is still the one of this name.
#[cfg(unix)]
fn is_at(file: &File, path: &Path) -> bool {
    use std::os::unix::fs::MetadataExt;
    let (Ok(own), Ok(there)) = (file.metadata(), std::fs::symlink_metadata(path)) else {
        return false;
    };
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
        let LockError::Held(who) = FileLock::take(&path, "sweep of s2").unwrap_err() else {
            panic!("held")
        };
        assert_eq!(who, format!("process {} (sweep of s1)", std::process::id()));
        drop(first);
        assert!(!path.exists(), "nothing remains");
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
        assert_eq!(names_of(&device), names_of(&link));
        let names = [
            "127.1",
            "0.0.0.0",
            "LOCALHOST",
            "127.0.0.1",
            "[::1]",
            "[::ffff:127.0.0.1]",
        ];
        for (host, port) in names
            .iter()
            .flat_map(|host| [(host, "5000"), (host, "05000")])
        {
            assert_eq!(
                names_of(&format!("tcp://{host}:{port}")),
                names_of("tcp://127.0.0.1:5000"),
                "{host}:{port}"
            );
        }
        for other in ["127.0.0.1:5001", "192.0.2.7:5000", "[2001:db8::1]:5000"] {
            assert!(
                names_of(&format!("tcp://{other}")).is_disjoint(&names_of("tcp://localhost:5000")),
                "control: {other}"
            );
        }
        assert_eq!(
            names_of("tcp://[::ffff:192.0.2.7]:5000"),
            names_of("tcp://192.0.2.7:5000")
        );
        let held = FileLock::of_port(&device, "a").unwrap();
        assert!(matches!(
            FileLock::of_port(&link, "b"),
            Err(LockError::Held(_))
        ));
        drop(held);
        FileLock::of_port(&link, "b").unwrap();
    }

    /// A session from elsewhere, or another user of this machine, may have laid a link where a lock
    /// is to be.
    #[test]
    fn what_a_link_in_place_of_a_lock_points_to_stays_as_it_is() {
        let folder = tempfile::tempdir().unwrap();
        let [victim, link, hard] =
            ["victim", "link.lock", "hard.lock"].map(|name| folder.path().join(name));
        std::fs::write(&victim, "kept").unwrap();
        std::os::unix::fs::symlink(&victim, &link).unwrap();
        let why = FileLock::take(&link, "sweep of s1")
            .unwrap_err()
            .to_string();
        assert!(
            why.contains("link.lock") && why.contains("found a link"),
            "{why}"
        );
        std::fs::hard_link(&victim, &hard).unwrap();
        drop(FileLock::take(&hard, "sweep of s1").unwrap());
        // One that leads to nothing yet makes nothing.
        let nowhere = folder.path().join("nowhere.lock");
        std::os::unix::fs::symlink(folder.path().join("new"), &nowhere).unwrap();
        assert!(FileLock::take(&nowhere, "sweep of s1").is_err());
        assert!(!folder.path().join("new").exists());
        assert_eq!(std::fs::read_to_string(&victim).unwrap(), "kept");
    }
}
