//! unsealed.json: which held-out rows met which decision, when and by which program. One entry a
//! look, written before the rows come out.
//!
//! ```text
//! two sets A, B of rows are of one holdout where 2 |A and B| >= min(|A|, |B|)
//! ```
//!
//! Rows are known by a hash of what was set and read, whatever file, form and order they stand in.
//! Single rows of coarse readings agree by chance, half of them do not.

use crate::error::SessionError;
use crate::foreign::as_imported;
use crate::session::{LoadedSession, load};
use crate::table::read_own;
use crate::whisker::{PM_PER_NM, load_table};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};
use std::io;
use std::path::{Path, PathBuf};
use wcal_core::files::{folder_of, read_text, write_atomic};
use wcal_core::{
    FbgSpec, Ledger, Opening, Provenance, SealedRows, SessionData, TransducerRow, WhiskerRow,
    document, fingerprint,
};

/// Name of the file, beside the session or in the output folder.
const NAME: &str = "unsealed.json";
/// Format tag of `unsealed.json`.
const FORMAT: &str = "wcal-unsealed/3";

/// A decision that met held-out rows.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
struct RecordedLook {
    /// Number of the decision among those that these rows have met.
    look: usize,
    /// When, RFC 3339, UTC.
    when: String,
    /// By which version of the program.
    program: String,
    /// The rows, each by the first 16 hex digits of the SHA-256 of what was set and read.
    #[schemars(with = "Vec<String>")]
    rows: BTreeSet<String>,
    /// The files that they stood in then.
    #[schemars(with = "Vec<String>")]
    files: BTreeSet<String>,
    /// Hash of the decision, as in verify.json; null where rows were read without one (`predict`).
    #[schemars(regex(pattern = "^[0-9a-f]{64}$"))]
    decision: Option<String>,
}

impl RecordedLook {
    /// Whether most of its rows are among `rows`, or most of these among its own.
    fn met(&self, rows: &BTreeSet<String>) -> bool {
        2 * self.rows.intersection(rows).count() >= self.rows.len().min(rows.len())
    }
}

/// Looks at held-out rows, in order; kept with the session.
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
    #[error(
        "recording that the holdout is opened: expected a folder that can be written to, found {0}"
    )]
    Unwritable(String),
}

/// Looks recorded at a place; none where nothing is there.
fn read(path: &Path) -> Result<Vec<RecordedLook>, LedgerError> {
    let wrong = |detail: String| LedgerError::Unreadable {
        place: path.display().to_string(),
        detail,
    };
    let text = match read_text(path) {
        Err(e) if e.source.kind() == io::ErrorKind::NotFound => return Ok(Vec::new()),
        other => other.map_err(|e| wrong(e.source.to_string()))?,
    };
    let file: LedgerFile =
        document::from_json(&text, FORMAT, &[]).map_err(|e| wrong(e.to_string()))?;
    Ok(file.looks)
}

/// What was set and read at a whisker's row: its wavelengths, nm, which tell it from any other.
fn of_whisker(row: &WhiskerRow, fbg: &FbgSpec) -> (String, Vec<f64>) {
    // By wavelength: sessions of other nominal ones state other shifts of one reading.
    let nominal_nm = fbg.nominal_nm.unwrap_or_default();
    (
        row.source.clone(),
        [0, 1]
            .map(|g| nominal_nm[g] + row.shift_pm[g] / PM_PER_NM)
            .to_vec(),
    )
}

fn of_transducer(row: &TransducerRow, (): &()) -> (String, Vec<f64>) {
    (row.source.clone(), vec![row.stimulus, row.response])
}

/// A session's sealed rows by their hashes, each with its file.
fn sealed_rows(session: &LoadedSession) -> BTreeMap<String, String> {
    match (&session.sealed, &session.data) {
        (SealedRows::Whisker(rows), SessionData::Whisker(data)) => {
            rows.fingerprints(&data.fbg, of_whisker)
        }
        (SealedRows::Transducer(rows), _) => rows.fingerprints(&(), of_transducer),
        (SealedRows::Whisker(_), _) => BTreeMap::new(),
    }
}

/// The rows of a table as the session would have them, by their hashes; those with a gap left out.
fn rows_of(table: &Path, session: &LoadedSession) -> Result<BTreeSet<String>, SessionError> {
    let columns = match &session.data {
        SessionData::Whisker(data) => {
            let rows = load_table(table, &data.fbg)?.rows;
            return Ok(rows
                .iter()
                .map(|row| fingerprint(&of_whisker(row, &data.fbg).1))
                .collect());
        }
        SessionData::Transducer(data) => data.model.columns(),
    };
    let (name, kept) = (table.display().to_string(), columns.map(str::to_owned));
    let table = match as_imported(table, &name, &session.imported, &kept, &[])? {
        Some(table) => table,
        None => read_own(table, &name)?,
    };
    let number = |row, column| table.number(row, table.place(column)?).ok().flatten();
    let numbers = |row| Some([number(row, columns[0])?, number(row, columns[1])?]);
    Ok((0..table.rows.len())
        .filter_map(numbers)
        .map(|numbers| fingerprint(&numbers))
        .collect())
}

/// Where it is recorded that a session's held-out rows were opened: beside the session and beside
/// every session whose files are held out for it, so that another output folder does not forget it;
/// in the output folder where none of them can be written to.
#[derive(Debug, Clone)]
pub struct SessionLedger {
    places: Vec<PathBuf>,
    out: PathBuf,
    rows: BTreeMap<String, String>,
    program: String,
    when: String,
}

impl SessionLedger {
    /// Of a session's held-out rows.
    pub fn new(session: &LoadedSession, out: &Path, provenance: &Provenance) -> Self {
        let mut places = vec![session.folder.join(NAME)];
        // A holdout of another session belongs to that one, too.
        places.extend(
            session
                .holdout_folders
                .iter()
                .map(|folder| folder.join(NAME)),
        );
        Self::of(places, out, sealed_rows(session), provenance)
    }

    fn of(
        places: Vec<PathBuf>,
        out: &Path,
        rows: BTreeMap<String, String>,
        provenance: &Provenance,
    ) -> Self {
        let Provenance {
            program,
            created: when,
            ..
        } = provenance.clone();
        Self {
            places,
            out: out.join(NAME),
            rows,
            program,
            when,
        }
    }

    /// Records that `table` was read without a decision, as far as the session in whose folder it
    /// lies seals its rows; true where it does. `out`: where the record goes if the session cannot
    /// be written to.
    ///
    /// # Errors
    /// As [`SessionLedger::record`].
    pub fn of_table(
        table: &Path,
        out: &Path,
        provenance: &Provenance,
    ) -> Result<bool, LedgerError> {
        let folder = folder_of(table);
        // A folder that is no session seals nothing.
        let is_session = folder.join("session.toml").is_file();
        let Some(session) = is_session.then(|| load(folder).ok()).flatten() else {
            return Ok(false);
        };
        // What cannot be read was not shown.
        let read = rows_of(table, &session).unwrap_or_default();
        let mut rows = sealed_rows(&session);
        rows.retain(|row, _| read.contains(row));
        if rows.is_empty() {
            return Ok(false);
        }
        Self::of(
            vec![session.folder.join(NAME)],
            folder_of(out),
            rows,
            provenance,
        )
        .record(None)?;
        Ok(true)
    }

    /// The ledger as [`wcal_core::Sealed::unseal`] asks for it.
    pub fn ledger(&self) -> Ledger {
        let own = self.clone();
        Ledger::new(move |opening: &Opening<'_>| {
            own.record(Some(opening.decision_sha256))
                .map_err(|e| e.to_string())
        })
    }

    /// Writes down that `decision` meets the rows, and gives the number of its look. The same
    /// decision on the same rows is the same look: nothing is added then.
    ///
    /// # Errors
    /// Where a record cannot be read, or none of the places can be written to.
    pub fn record(&self, decision: Option<&str>) -> Result<usize, LedgerError> {
        let own: BTreeSet<String> = self.rows.keys().cloned().collect();
        // Of all places: a look counts that only one of them knows.
        let all: Vec<&PathBuf> = self.places.iter().chain([&self.out]).collect();
        let known: Vec<Vec<RecordedLook>> =
            all.iter().map(|p| read(p)).collect::<Result<_, _>>()?;
        let looks = || known.iter().flatten().filter(|l| l.met(&own));
        let same = |l: &&RecordedLook| l.decision.as_deref() == decision && l.rows == own;
        // Reading without a decision is a look each time: what was seen then is not known.
        if let Some(again) = looks().find(same).filter(|_| decision.is_some()) {
            return Ok(again.look);
        }
        let look = 1 + looks().map(|l| l.look).max().unwrap_or(0);
        let entry = RecordedLook {
            look,
            when: self.when.clone(),
            program: self.program.clone(),
            rows: own.clone(),
            files: self.rows.values().cloned().collect(),
            decision: decision.map(str::to_owned),
        };
        let write = |path: &Path, known: &[RecordedLook]| -> Result<(), String> {
            let looks = known.iter().cloned().chain([entry.clone()]).collect();
            let file = LedgerFile {
                format: FORMAT.to_owned(),
                looks,
            };
            let text = serde_json::to_vec_pretty(&file).map_err(|e| e.to_string())?;
            write_atomic(path, &text).map_err(|e| e.to_string())
        };
        // Everywhere: whoever opens one of these sessions later finds the look.
        let beside = self
            .places
            .iter()
            .zip(&known)
            .map(|(path, known)| write(path, known));
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

    /// Of rows that a letter each stands for.
    fn ledger(places: &[&Path], out: &Path, rows: &str) -> SessionLedger {
        let places = places.iter().map(|p| p.join(NAME)).collect();
        let rows = rows
            .chars()
            .map(|row| (row.to_string(), "h.csv".to_owned()))
            .collect();
        SessionLedger::of(places, out, rows, &Provenance::default())
    }

    #[test]
    fn another_decision_is_another_look_and_the_same_one_is_not() {
        let [session, out] = [tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap()];
        let own = ledger(&[session.path()], out.path(), "a");
        assert_eq!(own.record(Some("first")).unwrap(), 1);
        assert_eq!(own.record(Some("second")).unwrap(), 2);
        assert_eq!(own.record(Some("first")).unwrap(), 1, "a reproduction");
        assert_eq!(
            own.record(None).unwrap(),
            3,
            "rows that were read without a decision"
        );
        assert_eq!(own.record(Some("third")).unwrap(), 4);
        // Another file has met nothing.
        assert_eq!(
            ledger(&[session.path()], out.path(), "b")
                .record(Some("second"))
                .unwrap(),
            1
        );
        assert_eq!(read(&session.path().join(NAME)).unwrap().len(), 5);
        assert!(!out.path().join(NAME).exists());
    }

    #[test]
    fn rows_that_most_are_known_of_are_no_new_holdout() {
        let [session, out] = [tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap()];
        let look = |rows: &str, decision| {
            ledger(&[session.path()], out.path(), rows)
                .record(decision)
                .unwrap()
        };
        assert_eq!(look("abcd", Some("first")), 1);
        assert_eq!(look("dcba", Some("first")), 1, "in another order");
        assert_eq!(
            look("anopqrst", Some("second")),
            1,
            "negative control: new rows, of which one agrees"
        );
        for (number, more) in ["abc", "ab", "abcdefgh", "abxy", "a"]
            .into_iter()
            .enumerate()
        {
            assert_eq!(look(more, Some("first")), number + 2, "{more}");
        }
    }

    #[test]
    fn a_look_is_known_beside_the_session_whose_file_it_was() {
        let [one, other, out] = [(); 3].map(|()| tempfile::tempdir().unwrap());
        ledger(&[one.path(), other.path()], out.path(), "a")
            .record(Some("x"))
            .unwrap();
        assert_eq!(
            ledger(&[other.path()], out.path(), "a")
                .record(Some("y"))
                .unwrap(),
            2
        );
    }

    #[test]
    fn what_cannot_be_written_beside_the_session_goes_to_the_output_or_nowhere() {
        let out = tempfile::tempdir().unwrap();
        let nowhere = out.path().join("not there");
        let own = ledger(&[&nowhere], out.path(), "a");
        assert_eq!(own.record(Some("x")).unwrap(), 1);
        assert_eq!(
            own.record(Some("y")).unwrap(),
            2,
            "the output's record is asked, too"
        );
        let error = ledger(&[&nowhere], &nowhere, "a")
            .record(Some("x"))
            .unwrap_err();
        assert!(matches!(error, LedgerError::Unwritable(_)), "{error}");
        // A record that means nothing may say that it was opened.
        let said = |text: &str| {
            std::fs::write(out.path().join(NAME), text).unwrap();
            let error = own.record(Some("x")).unwrap_err();
            assert!(matches!(error, LedgerError::Unreadable { .. }), "{error}");
            error.to_string()
        };
        said("{}");
        let older = said(r#"{"format":"wcal-unsealed/1","opened":[]}"#);
        assert!(older.contains("an older version"), "{older}");
        let own = said(r#"{"format":"wcal-unsealed/3"}"#);
        assert!(own.contains("missing field"), "negative control: {own}");
    }
}
