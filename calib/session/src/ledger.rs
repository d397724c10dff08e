//! unsealed.json: which held-out files met which decision, when and by which program. One entry a look, written before the rows come out.

use crate::session::LoadedSession;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;
use std::io;
use std::path::{Path, PathBuf};
use wcal_core::files::{folder_of, read_text, write_atomic};
use wcal_core::{InputFile, Ledger, Opening, Provenance, Purpose, document};

/// Name of the file, beside the session or in the output folder.
const NAME: &str = "unsealed.json";
/// Format tag of `unsealed.json`.
const FORMAT: &str = "wcal-unsealed/2";

/// A held-out file.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, JsonSchema)]
pub struct OpenedFile {
    /// Hash of the file.
    #[schemars(regex(pattern = "^[0-9a-f]{64}$"))]
    sha256: String,
    /// Its path then.
    path: String,
}

/// A decision that met held-out files.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct RecordedLook {
    /// Number of the decision among those that one of these files has met.
    look: usize,
    /// When, RFC 3339, UTC.
    when: String,
    /// By which version of the program.
    program: String,
    /// The files.
    files: Vec<OpenedFile>,
    /// Hash of the decision, as in verify.json; null where rows were read without one (`predict`).
    #[schemars(regex(pattern = "^[0-9a-f]{64}$"))]
    decision: Option<String>,
}

impl RecordedLook {
    fn hashes(&self) -> BTreeSet<&str> {
        self.files.iter().map(|f| f.sha256.as_str()).collect()
    }
}

/// Looks at held-out files, in order; kept with the session.
#[derive(Debug, Default, Serialize, Deserialize, JsonSchema)]
pub struct LedgerFile {
    /// Format and version.
    #[schemars(extend("const" = FORMAT))]
    format: String,
    /// In order.
    looks: Vec<RecordedLook>,
}

/// A ledger cannot be read or written.
#[derive(Debug, thiserror::Error)]
pub enum LedgerError {
    /// What is there is none: it may say that the holdout was opened.
    #[error("reading {place}: {detail}")]
    Unreadable {
        /// File.
        place: String,
        /// What is wrong.
        detail: String,
    },
    /// None of the places can be written to.
    #[error("recording that the holdout is opened: expected a folder that can be written to, found {0}")]
    Unwritable(String),
}

/// Looks recorded at a place; none where nothing is there.
fn read(path: &Path) -> Result<Vec<RecordedLook>, LedgerError> {
    let wrong = |detail: String| LedgerError::Unreadable { place: path.display().to_string(), detail };
    let text = match read_text(path) {
        Err(e) if e.kind() == io::ErrorKind::NotFound => return Ok(Vec::new()),
        other => other.map_err(|e| wrong(e.to_string()))?,
    };
    let file: LedgerFile = document::json_as(&text).map_err(|e| wrong(e.to_string()))?;
    wcal_core::format::expect(FORMAT, Some(&file.format)).map_err(|e| wrong(e.to_string()))?;
    Ok(file.looks)
}

/// Where it is recorded that a session's held-out files were opened: beside the session and beside every session whose files are held out for it, so
/// that another output folder does not forget it; in the output folder where none of them can be written to.
#[derive(Debug, Clone)]
pub struct SessionLedger {
    places: Vec<PathBuf>,
    out: PathBuf,
    files: Vec<OpenedFile>,
    program: String,
    when: String,
}

impl SessionLedger {
    /// Of a session's held-out files.
    pub fn new(session: &LoadedSession, out: &Path, provenance: &Provenance) -> Self {
        let held_out = session.inputs.iter().filter(|i| i.purpose == Purpose::Holdout);
        let files: Vec<InputFile> = held_out.cloned().collect();
        let mut places = vec![session.folder.join(NAME)];
        // A holdout of another session belongs to that one, too.
        places.extend(session.holdout_folders.iter().map(|folder| folder.join(NAME)));
        Self::of(places, out, files, provenance)
    }

    fn of(places: Vec<PathBuf>, out: &Path, files: Vec<InputFile>, provenance: &Provenance) -> Self {
        let file = |f: InputFile| OpenedFile { sha256: f.sha256, path: f.path };
        Self {
            places,
            out: out.join(NAME),
            files: files.into_iter().map(file).collect(),
            program: provenance.program.clone(),
            when: provenance.created.clone(),
        }
    }

    /// Records that `table` was read without a decision, where the session in whose folder it lies holds it out; true where it does. `out`: where the
    /// record goes if the session cannot be written to.
    ///
    /// # Errors
    /// As [`SessionLedger::record`].
    pub fn of_table(table: &Path, out: &Path, provenance: &Provenance) -> Result<bool, LedgerError> {
        let folder = folder_of(table);
        // A folder that is no session seals nothing.
        let is_session = folder.join("session.toml").is_file();
        let Some(session) = is_session.then(|| crate::load(folder).ok()).flatten() else { return Ok(false) };
        let read = |f: &&InputFile| {
            f.purpose == Purpose::Holdout && provenance.inputs.iter().any(|r| r.sha256 == f.sha256)
        };
        let files: Vec<InputFile> = session.inputs.iter().filter(read).cloned().collect();
        if files.is_empty() {
            return Ok(false);
        }
        let ledger = Self::of(vec![session.folder.join(NAME)], folder_of(out), files, provenance);
        ledger.record(None)?;
        Ok(true)
    }

    /// The ledger as [`wcal_core::Sealed::unseal`] asks for it.
    pub fn ledger(&self) -> Ledger {
        let own = self.clone();
        Ledger::new(move |opening: &Opening<'_>| {
            own.record(Some(opening.decision_sha256)).map_err(|e| e.to_string())
        })
    }

    /// Writes down that `decision` meets the files, and gives the number of its look. The same decision on the same files is the same look: nothing is
    /// added then.
    ///
    /// # Errors
    /// Where a record cannot be read, or none of the places can be written to.
    pub fn record(&self, decision: Option<&str>) -> Result<usize, LedgerError> {
        let own: BTreeSet<&str> = self.files.iter().map(|f| f.sha256.as_str()).collect();
        let all: Vec<&PathBuf> = self.places.iter().chain([&self.out]).collect();
        let known: Vec<Vec<RecordedLook>> = all.iter().map(|p| read(p)).collect::<Result<_, _>>()?;
        let looks = || known.iter().flatten().filter(|l| !l.hashes().is_disjoint(&own));
        let same = |l: &&RecordedLook| l.decision.as_deref() == decision && l.hashes() == own;
        // Reading without a decision is a look each time: what was seen then is not known.
        if let Some(again) = looks().find(same).filter(|_| decision.is_some()) {
            return Ok(again.look);
        }
        let look = 1 + looks().map(|l| l.look).max().unwrap_or(0);
        let entry = RecordedLook {
            look,
            when: self.when.clone(),
            program: self.program.clone(),
            files: self.files.clone(),
            decision: decision.map(str::to_owned),
        };
        let write = |path: &Path, known: &[RecordedLook]| -> Result<(), String> {
            let looks = known.iter().cloned().chain([entry.clone()]).collect();
            let file = LedgerFile { format: FORMAT.to_owned(), looks };
            let text = serde_json::to_vec_pretty(&file).map_err(|e| e.to_string())?;
            write_atomic(path, &text).map_err(|e| e.to_string())
        };
        let beside = self.places.iter().zip(&known).map(|(path, known)| write(path, known));
        let beside: Vec<Result<(), String>> = beside.collect();
        if beside.iter().all(Result::is_err) {
            let own = known.last().map_or(&[][..], Vec::as_slice);
            write(&self.out, own).map_err(LedgerError::Unwritable)?;
        }
        Ok(look)
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "a test that fails should say where")]

    use super::*;

    fn ledger(places: &[&Path], out: &Path, hash: &str) -> SessionLedger {
        let file = InputFile { path: "h.csv".into(), sha256: hash.into(), purpose: Purpose::Holdout };
        let places = places.iter().map(|p| p.join(NAME)).collect();
        SessionLedger::of(places, out, vec![file], &Provenance::default())
    }

    #[test]
    fn another_decision_is_another_look_and_the_same_one_is_not() {
        let [session, out] = [tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap()];
        let own = ledger(&[session.path()], out.path(), "a");
        assert_eq!(own.record(Some("first")).unwrap(), 1);
        assert_eq!(own.record(Some("second")).unwrap(), 2);
        assert_eq!(own.record(Some("first")).unwrap(), 1, "a reproduction");
        assert_eq!(own.record(None).unwrap(), 3, "rows that were read without a decision");
        assert_eq!(own.record(Some("third")).unwrap(), 4);
        // Another file has met nothing.
        assert_eq!(ledger(&[session.path()], out.path(), "b").record(Some("second")).unwrap(), 1);
        assert_eq!(read(&session.path().join(NAME)).unwrap().len(), 5);
        assert!(!out.path().join(NAME).exists());
    }

    #[test]
    fn a_look_is_known_beside_the_session_whose_file_it_was() {
        let [one, other, out] = [(); 3].map(|()| tempfile::tempdir().unwrap());
        ledger(&[one.path(), other.path()], out.path(), "a").record(Some("x")).unwrap();
        assert_eq!(ledger(&[other.path()], out.path(), "a").record(Some("y")).unwrap(), 2);
    }

    #[test]
    fn what_cannot_be_written_beside_the_session_goes_to_the_output_or_nowhere() {
        let out = tempfile::tempdir().unwrap();
        let nowhere = out.path().join("not there");
        let own = ledger(&[&nowhere], out.path(), "a");
        assert_eq!(own.record(Some("x")).unwrap(), 1);
        assert_eq!(own.record(Some("y")).unwrap(), 2, "the output's record is asked, too");
        let error = ledger(&[&nowhere], &nowhere, "a").record(Some("x")).unwrap_err();
        assert!(matches!(error, LedgerError::Unwritable(_)), "{error}");
        // A record that means nothing may say that it was opened.
        std::fs::write(out.path().join(NAME), "{}").unwrap();
        assert!(matches!(own.record(Some("x")).unwrap_err(), LedgerError::Unreadable { .. }));
    }
}
