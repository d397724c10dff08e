//! unsealed.json: which held-out files were opened, when and by which program.

use anyhow::Context;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};
use wcal_core::document;
use wcal_core::{InputFile, Ledger, Provenance, Purpose, Seal, Unsealing};
use wcal_session::LoadedSession;

/// A held-out file that was opened.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Unsealed {
    /// Hash of the file.
    #[schemars(regex(pattern = "^[0-9a-f]{64}$"))]
    sha256: String,
    /// Its path then.
    path: String,
    /// When, RFC 3339, UTC.
    when: String,
    /// By which version of the program.
    program: String,
}

/// Format tag of `unsealed.json`.
const FORMAT: &str = "wcal-unsealed/1";

/// Held-out files that were opened, with when and by what; kept with the session.
#[derive(Debug, Default, Serialize, Deserialize, JsonSchema)]
pub struct UnsealedFile {
    /// Format and version.
    #[schemars(extend("const" = FORMAT))]
    format: String,
    /// In order.
    opened: Vec<Unsealed>,
}

/// Record of unsealing in a folder.
fn read_unsealed(path: &Path) -> anyhow::Result<Vec<Unsealed>> {
    let reading = || format!("reading {}", path.display());
    let text = match wcal_core::files::read_text(path) {
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Ok(Vec::new()),
        // What cannot be read may say that the holdout was opened.
        other => other.with_context(reading)?,
    };
    let file: UnsealedFile = document::json_as(&text).with_context(reading)?;
    wcal_core::format::expect(FORMAT, Some(&file.format))
        .map_err(anyhow::Error::msg)
        .with_context(reading)?;
    Ok(file.opened)
}

/// Where it is recorded which held-out files were opened: beside the session, so that another output folder does not forget it, or in the
/// output folder where the session cannot be written to.
#[derive(Clone)]
pub struct UnsealRecord {
    places: [PathBuf; 2],
    known: [Vec<Unsealed>; 2],
}

impl UnsealRecord {
    pub fn read(session: &LoadedSession, out: &Path) -> anyhow::Result<Self> {
        const NAME: &str = "unsealed.json";
        let places = [session.folder.join(NAME), out.join(NAME)];
        let known = [read_unsealed(&places[0])?, read_unsealed(&places[1])?];
        Ok(Self { places, known })
    }

    /// Records that `table` was opened, where the session in whose folder it lies seals it; true where it does. `out`: where the record goes
    /// if the session cannot be written to.
    pub fn of_table(table: &Path, out: &Path, provenance: &Provenance) -> anyhow::Result<bool> {
        let folder = |path: &Path| {
            path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new(".")).to_path_buf()
        };
        let session = folder(table);
        // A folder that is no session seals nothing.
        let Some(session) =
            session.join("session.toml").is_file().then(|| wcal_session::load(&session).ok()).flatten()
        else {
            return Ok(false);
        };
        let record = Self::read(&session, &folder(out))?;
        let sealed = record.seal(&session, provenance).files;
        let read = &provenance.inputs;
        let files: Vec<InputFile> =
            sealed.into_iter().filter(|f| read.iter().any(|r| r.sha256 == f.sha256)).collect();
        if files.is_empty() {
            return Ok(false);
        }
        let program = provenance.program.clone();
        record.add(&Unsealing { files, seen_before: false, program, rows: 0 }, provenance)?;
        Ok(true)
    }

    /// What is known of the session's sealed files.
    pub fn seal(&self, session: &LoadedSession, provenance: &Provenance) -> Seal {
        Seal {
            files: session.inputs.iter().filter(|i| i.purpose == Purpose::Holdout).cloned().collect(),
            opened_before: self.known.iter().flatten().map(|u| u.sha256.clone()).collect(),
            program: provenance.program.clone(),
            ..Seal::default()
        }
    }

    /// Writes each unsealing down before a row comes out.
    pub fn ledger(&self, provenance: &Provenance) -> Ledger {
        let (record, provenance) = (self.clone(), provenance.clone());
        Ledger::new(move |unsealing| record.add(unsealing, &provenance).map_err(|e| format!("{e:#}")))
    }

    /// Records an unsealing for good.
    pub fn add(&self, unsealing: &Unsealing, provenance: &Provenance) -> anyhow::Result<()> {
        let record = |known: &[Unsealed]| -> anyhow::Result<Vec<u8>> {
            let mut opened = known.to_vec();
            let new = unsealing.files.iter().filter(|f| known.iter().all(|u| u.sha256 != f.sha256));
            opened.extend(new.map(|f| Unsealed {
                sha256: f.sha256.clone(),
                path: f.path.clone(),
                when: provenance.created.clone(),
                program: unsealing.program.clone(),
            }));
            Ok(serde_json::to_vec_pretty(&UnsealedFile { format: FORMAT.to_owned(), opened })?)
        };
        let [beside, out] = &self.places;
        if crate::output::write_file(beside, &record(&self.known[0])?).is_err() {
            eprintln!(
                "{} cannot be written; that the holdout was opened is recorded in {} only",
                beside.display(),
                out.display()
            );
            crate::output::write_file(out, &record(&self.known[1])?)?;
        }
        Ok(())
    }
}
