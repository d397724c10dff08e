//! The folder of a session before its first move: locked, new or begun with the same rig and plan,
//! and as it was when nothing comes of it.

use crate::AcquisitionError;
use crate::reduce::{recordings, refuse_empty};
use crate::replay::completed_steps;
use crate::run_file::RunFile;
use std::collections::BTreeSet;
use std::fs;
use std::io::Read;
use std::path::{Path, PathBuf};
use wcal_core::files::{FileError, read_text, remove_abandoned, write_atomic};
use wcal_core::lock::{FileLock, LockError};
use wcal_core::rig_devices::StageRig;

/// What to record and where.
#[derive(Debug, Clone)]
pub struct RecordRequest {
    /// Text of rig.toml.
    pub rig: String,
    /// Text of the plan.
    pub plan: String,
    /// Where both were read, for messages.
    pub places: [String; 2],
    /// Session folder; new, or with `resume` one that was begun.
    pub folder: PathBuf,
    /// Go on where an earlier run stopped.
    pub resume: bool,
    /// Search the reference where there is none.
    pub home: bool,
    /// Time of creation, RFC 3339.
    pub created: String,
    /// Command line.
    pub command: Vec<String>,
}

/// Held while a sweep records into the folder. The name is that of a file half-written: nobody
/// takes it for a result.
const LOCK: &str = ".wcal-session.tmp";
/// Space that is given back when the sweep has ended: of a disk that is full there are tables all
/// the same.
const RESERVE: &str = ".wcal-reserve.tmp";

/// A session's folder, this process's own. What was made in it goes again unless the sweep keeps
/// it: a device that could not be opened leaves nothing that would block the next attempt.
pub(crate) struct OwnedSessionFolder {
    folder: PathBuf,
    /// Files and folders made, in order.
    made: Vec<PathBuf>,
    kept: bool,
    lock: Option<FileLock>,
    reserve: Option<fs::File>,
}

impl OwnedSessionFolder {
    /// A new folder with copies of rig and plan, or an old one that has the same; steps done
    /// already.
    ///
    /// # Errors
    /// When another sweep records there, or something else is there.
    pub(crate) fn open(request: &RecordRequest) -> Result<(Self, BTreeSet<u32>), AcquisitionError> {
        let folder = &request.folder;
        let mut begun = Self {
            folder: folder.clone(),
            made: Vec::new(),
            kept: false,
            lock: None,
            reserve: None,
        };
        // The lock is a file of the folder: the folder comes first.
        if !request.resume {
            begun.make_folder()?;
        }
        begun.take_lock()?;
        let skip = if request.resume {
            begun.resume(request)?
        } else {
            begun.begin(request)?
        };
        Ok((begun, skip))
    }

    /// A file that this run makes.
    pub(crate) fn makes(&mut self, name: &str) -> PathBuf {
        let path = self.folder.join(name);
        self.made.push(path.clone());
        path
    }

    /// Takes the space that the tables will need, bytes; a disk that has none is known before
    /// anything moves.
    ///
    /// # Errors
    /// When the disk is full.
    pub(crate) fn reserve(&mut self, bytes: u64) -> Result<(), AcquisitionError> {
        let path = self.folder.join(RESERVE);
        let mut file = fs::File::create_new(&path).map_err(FileError::of("creating", &path))?;
        // A lock tells what tidies up that the reserve is in use.
        let _ = file.try_lock();
        // Written in full: a file with a hole in it would reserve nothing.
        let zeros = std::io::copy(&mut std::io::repeat(0).take(bytes), &mut file);
        self.reserve = Some(file);
        zeros.map_err(FileError::of("writing", &path))?;
        Ok(())
    }

    /// Gives the reserved space back.
    pub(crate) fn release(&mut self) {
        if self.reserve.take().is_some() {
            // What cannot be removed is tidied away by the next run.
            let _ = fs::remove_file(self.folder.join(RESERVE));
        }
    }

    /// Something was recorded: it stays.
    pub(crate) fn keep(&mut self) {
        self.kept = true;
    }

    fn make_folder(&mut self) -> Result<(), AcquisitionError> {
        // Missing parents are noted, too: a run that records nothing leaves the disk as it was.
        let missing = self
            .folder
            .ancestors()
            .take_while(|a| !a.as_os_str().is_empty() && !a.exists());
        self.made = missing.map(Path::to_owned).collect();
        self.made.reverse();
        Ok(fs::create_dir_all(&self.folder).map_err(FileError::of("creating", &self.folder))?)
    }

    fn take_lock(&mut self) -> Result<(), AcquisitionError> {
        // A session to go on with that is not there is named by its missing file.
        if !self.folder.is_dir() {
            return Ok(());
        }
        let purpose = purpose(&self.folder);
        let lock = FileLock::take(&self.folder.join(LOCK), &purpose);
        let place = self.folder.display().to_string();
        self.lock = Some(lock.map_err(|e| held(e, place, "a session that no sweep records now"))?);
        // Under the lock: no sweep of this session is writing now.
        remove_abandoned(&self.folder);
        Ok(())
    }

    fn begin(&mut self, request: &RecordRequest) -> Result<BTreeSet<u32>, AcquisitionError> {
        if self.folder.join("rig.toml").exists() {
            let (place, expected) = (
                self.folder.display().to_string(),
                "a new folder (or --resume)",
            );
            return Err(AcquisitionError::input(
                place,
                expected,
                "one that holds a session",
            ));
        }
        // Own copies: the recording can be reduced anew whatever becomes of the originals.
        for (name, text) in [("rig.toml", &request.rig), ("plan.toml", &request.plan)] {
            write_atomic(&self.makes(name), text.as_bytes())?;
        }
        Ok(BTreeSet::new())
    }

    fn resume(&mut self, request: &RecordRequest) -> Result<BTreeSet<u32>, AcquisitionError> {
        // Steps are known by their numbers: in another plan they would be other poses.
        for (name, text) in [("rig.toml", &request.rig), ("plan.toml", &request.plan)] {
            same(&self.folder, name, text)?;
        }
        let parts = recordings(&self.folder);
        refuse_empty(&parts)?;
        let mut skip = BTreeSet::new();
        for part in parts {
            skip.extend(completed_steps(&part)?);
        }
        Ok(skip)
    }
}

impl Drop for OwnedSessionFolder {
    fn drop(&mut self) {
        self.release();
        // The lock's file goes first, since a folder that is not empty cannot be removed.
        self.lock = None;
        if self.kept {
            return;
        }
        for path in self.made.iter().rev() {
            // A folder that somebody has put something into meanwhile stays.
            let _ = if path.is_dir() {
                fs::remove_dir(path)
            } else {
                fs::remove_file(path)
            };
        }
    }
}

/// Whether the last run into a session came to its end.
///
/// # Errors
/// Where the session has another rig or plan.
pub fn is_finished(folder: &Path, rig: &str, plan: &str) -> Result<bool, AcquisitionError> {
    same(folder, "rig.toml", rig)?;
    same(folder, "plan.toml", plan)?;
    let run = RunFile::read(&folder.join("run.json"));
    // Of a run that was killed there is none.
    Ok(run.is_ok_and(|run| run.runs.last().is_some_and(|r| r.ending == "finished")))
}

/// The stage of a rig, driven by nobody else on this machine.
///
/// # Errors
/// Who drives it.
pub(crate) fn stage_lock(
    rig: &StageRig,
    session: &Path,
) -> Result<Vec<FileLock>, AcquisitionError> {
    // By the port and not the session: two sessions may name the same stage.
    let lock = FileLock::of_port(&rig.port, &purpose(session));
    lock.map_err(|e| {
        held(
            e,
            format!("stage {}", rig.port),
            "a stage that no other program drives",
        )
    })
}

fn purpose(session: &Path) -> String {
    format!("stage-sweep, session {}", session.display())
}

fn held(error: LockError, place: String, expected: &str) -> AcquisitionError {
    match error {
        LockError::Held(who) => {
            AcquisitionError::input(place, expected, format!("one that {who} works on"))
        }
        LockError::File(e) => e.into(),
    }
}

/// Ports may differ between the runs of one session, plans and geometry may not.
fn same(folder: &Path, name: &str, text: &str) -> Result<(), AcquisitionError> {
    let path = folder.join(name);
    let old = read_text(&path)?;
    if without_links(&old) == without_links(text) {
        return Ok(());
    }
    Err(AcquisitionError::input(
        path.display().to_string(),
        "the same content as when the session was begun",
        "other content",
    ))
}

/// A document without the devices' addresses; `None` where it is no TOML.
fn without_links(text: &str) -> Option<toml::Table> {
    let mut table: toml::Table = text.parse().ok()?;
    for (section, keys) in [
        ("stage", &["port", "baud"][..]),
        ("interrogator", &["address", "peaks_address"]),
        ("camera", &["source"]),
    ] {
        let entries: Vec<&mut toml::Table> = match table.get_mut(section) {
            Some(toml::Value::Table(one)) => vec![one],
            Some(toml::Value::Array(many)) => many
                .iter_mut()
                .filter_map(toml::Value::as_table_mut)
                .collect(),
            _ => Vec::new(),
        };
        for entry in entries {
            keys.iter().for_each(|k| drop(entry.remove(*k)));
        }
    }
    Some(table)
}
