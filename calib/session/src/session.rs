//! A session folder as a whole.

use crate::document::{parse, sections};
use crate::error::{InputError, SessionError, quote};
use crate::table::read_readings;
use crate::warning::SessionWarning;
use crate::whisker_meta::{self, MomentSection, TrajectorySection, WhiskerSection};
use crate::{transducer, whisker, whisker_checks};
use serde::Deserialize;
use std::collections::BTreeMap;
use std::path::{Component, Path, PathBuf};
use wcal_core::files::{MAX_DOCUMENT_BYTES, read_within};
use wcal_core::provenance::sha256_hex;
use wcal_core::shapes_document::ShapesSource;
use wcal_core::text::brief;
use wcal_core::{
    FbgSpec, InputFile, Purpose, Role, Sealed, SealedRows, SessionData, SessionKind,
    TransducerData, TransducerRow, WhiskerData, WhiskerRow, format, ranges,
};

const NAME: &str = "session.toml";

/// Format tag of `session.toml`.
pub const SESSION_FORMAT: &str = "wcal-session/1";

/// A session that was read and checked.
#[derive(Debug)]
pub struct LoadedSession {
    /// The folder.
    pub folder: PathBuf,
    /// Identifier.
    pub id: String,
    /// Surrounding medium, e.g. `air`, `water`; `unspecified` where the file does not say (kinds
    /// other than whisker).
    pub medium: String,
    /// Creation time as written, if given.
    pub created: Option<String>,
    /// Kind.
    pub kind: SessionKind,
    /// The data are simulated, not measured: `simulated = true` under `[provenance]`, of this
    /// session or of one joined with it.
    pub simulated: bool,
    /// Checked data, to be fitted.
    pub data: SessionData,
    /// Rows of the holdout, those with the role "holdout" in the points table among them.
    pub sealed: SealedRows,
    /// Folders of other sessions whose rows are held out for this one.
    pub holdout_folders: Vec<PathBuf>,
    /// Every file read, with its hash; paths relative to the folder.
    pub inputs: Vec<InputFile>,
    /// `session.toml` as written.
    pub meta: toml::Table,
    /// What deserves attention: unknown keys and columns, stage against groove, time, missing
    /// labels.
    pub warnings: Vec<SessionWarning>,
    /// Columns of the table that it was imported from, where they have other names there, by its
    /// own.
    pub imported: BTreeMap<String, String>,
    /// Name of the points table, relative to the folder.
    pub points_file: String,
    /// Folder with the pictures of its points, where it has them.
    pub pictures: Option<PathBuf>,
}

impl LoadedSession {
    /// The data of a whisker.
    ///
    /// # Errors
    /// Where it is a session of another kind.
    pub fn whisker(&self) -> Result<&WhiskerData, InputError> {
        let found = self.kind.to_string();
        match &self.data {
            SessionData::Whisker(data) => Ok(data),
            SessionData::Transducer(_) => {
                Err(InputError::new(NAME, "a session of kind \"whisker\"", found).field("kind"))
            }
        }
    }
}

/// `session.toml`.
#[derive(Deserialize)]
struct Document {
    id: String,
    kind: SessionKind,
    medium: Option<String>,
    created: Option<toml::Value>,
    files: Files,
    whisker: Option<WhiskerSection>,
    #[serde(default)]
    moments: MomentSection,
    #[serde(default)]
    fbg: FbgSpec,
    #[serde(default)]
    trajectory: Vec<TrajectorySection>,
    transducer: Option<TransducerData>,
    #[serde(default)]
    provenance: ProvenanceSection,
}

/// `[files]`.
#[derive(Deserialize)]
struct Files {
    points: String,
    holdout: Option<String>,
    twin: Option<String>,
    rest_shape: Option<String>,
    shapes: Option<String>,
    holdout_shapes: Option<String>,
    recording: Option<String>,
    pictures: Option<String>,
}

/// What a reader asks of `[provenance]`: whether the data are simulated, and which cameras and rig
/// its shapes come from.
#[derive(Default, Deserialize)]
#[serde(default)]
struct ProvenanceSection {
    simulated: bool,
    cameras_sha256: String,
    shapes_rig_sha256: String,
}

/// Keys that people and other programs write for themselves, and tables that are free.
const FREE: [&str; 5] = ["format", "note", "whisker_id", "devices", "provenance"];

/// Reads a session folder (or the path of its `session.toml`) and checks everything in it.
///
/// # Errors
/// The first thing that cannot be used: [`SessionError::Content`] with file, line, field, expected
/// and found, or [`SessionError::Io`].
pub fn load(folder: &Path) -> Result<LoadedSession, SessionError> {
    let folder = if folder.is_file() {
        folder.parent().unwrap_or(folder)
    } else {
        folder
    };
    if folder.exists() && !folder.is_dir() {
        return Err(InputError::new(
            &folder.display().to_string(),
            "a session folder",
            "a pipe or device",
        )
        .into());
    }
    let path = folder.join(NAME);
    let bytes = read_within(&path, MAX_DOCUMENT_BYTES).map_err(SessionError::reading)?;
    let meta = parse(NAME, &bytes)?;
    // Before any other key: those of another version may mean something else.
    format::expect(
        SESSION_FORMAT,
        meta.get("format").and_then(toml::Value::as_str),
    )
    .map_err(|e| InputError::new(NAME, format!("{:?}", e.expected), e.found).field("format"))?;
    ranges::check(&meta, &[whisker_meta::SESSION_RANGES])
        .map_err(|e| InputError::range(NAME, e))?;
    let mut unknown = Vec::new();
    let document: Document = sections(NAME, &meta, &mut unknown)?;
    let is_free = |key: &String| FREE.iter().any(|free| key.split('.').next() == Some(free));
    let unknown = unknown.iter().filter(|key| !is_free(key));
    let mut warnings: Vec<SessionWarning> = unknown
        .map(|key| {
            SessionWarning::other(
                NAME,
                format!("key {} is not known and not used", brief(key)),
            )
        })
        .collect();
    let mut inputs = vec![InputFile {
        path: NAME.to_owned(),
        sha256: sha256_hex(&bytes),
        purpose: Purpose::Description,
    }];
    let (id, kind, files) = (document.id.clone(), document.kind, &document.files);
    if id.trim().is_empty() {
        let error = InputError::new(NAME, "a session identifier", "an empty text");
        return Err(error.field("id").into());
    }
    let simulated = document.provenance.simulated;
    let created = document.created.as_ref();
    let created = created.map(|time| {
        time.as_str()
            .map_or_else(|| time.to_string(), str::to_owned)
    });
    let medium = document.medium.clone().unwrap_or_else(|| {
        if kind != SessionKind::Whisker {
            return "unspecified".to_owned();
        }
        let text = "medium is not given; taken as \"air\"";
        warnings.push(SessionWarning::other(NAME, text));
        "air".to_owned()
    });
    files.check(folder)?;
    if let Some(name) = files
        .recording
        .as_ref()
        .filter(|name| !folder.join(name).is_file())
    {
        let text = format!("the recording {name} is not there; tables cannot be rebuilt from it");
        warnings.push(SessionWarning::other(NAME, text));
    }
    let points_file = files.points.clone();
    let pictures = files.pictures.as_ref().map(|name| folder.join(name));
    let (data, sealed) = match kind {
        SessionKind::Whisker => {
            let (data, sealed) =
                load_whisker(document, folder, &medium, &mut inputs, &mut warnings)?;
            (SessionData::Whisker(data), SealedRows::Whisker(sealed))
        }
        SessionKind::Transducer | SessionKind::Axis => {
            let (data, sealed) = load_transducer(document, folder, &mut inputs, &mut warnings)?;
            (
                SessionData::Transducer(data),
                SealedRows::Transducer(sealed),
            )
        }
    };
    let folder = folder.to_owned();
    Ok(LoadedSession {
        folder,
        id,
        medium,
        created,
        kind,
        simulated,
        data,
        sealed,
        holdout_folders: Vec::new(),
        inputs,
        imported: imported_columns(&meta),
        meta,
        warnings,
        points_file,
        pictures,
    })
}

impl LoadedSession {
    /// The table that it was imported from, where it was: the first one, a second is a holdout.
    pub fn imported_from(&self) -> Option<InputFile> {
        let inputs = self.meta.get("provenance")?.get("inputs")?.as_array()?;
        let text = |key: &str| Some(inputs.first()?.get(key)?.as_str()?.to_owned());
        Some(InputFile {
            path: text("path")?,
            sha256: text("sha256")?,
            purpose: Purpose::Fit,
        })
    }
}

/// `[provenance] columns`, which an import writes.
fn imported_columns(meta: &toml::Table) -> BTreeMap<String, String> {
    let columns = meta
        .get("provenance")
        .and_then(|p| p.get("columns")?.as_table());
    let text =
        |(name, column): (&String, &toml::Value)| Some((name.clone(), column.as_str()?.to_owned()));
    columns.into_iter().flatten().filter_map(text).collect()
}

impl Files {
    /// Holds every name against the folder: a session that was handed on must not read anything
    /// else of this computer.
    fn check(&self, folder: &Path) -> Result<(), InputError> {
        let files = [
            ("points", Some(&self.points)),
            ("holdout", self.holdout.as_ref()),
            ("twin", self.twin.as_ref()),
            ("rest_shape", self.rest_shape.as_ref()),
            ("shapes", self.shapes.as_ref()),
            ("holdout_shapes", self.holdout_shapes.as_ref()),
            ("recording", self.recording.as_ref()),
            ("pictures", self.pictures.as_ref()),
        ];
        for (key, name) in files {
            let kind = if key == "pictures" {
                "a folder"
            } else {
                "a file"
            };
            if let Some(found) = name.and_then(|name| outside(folder, name, key == "pictures")) {
                let expected = format!(
                    "{kind} in the session's folder, its path relative to it and without \"..\""
                );
                return Err(InputError::new(NAME, expected, found).field(format!("files.{key}")));
            }
        }
        Ok(())
    }
}

/// Why a name in `[files]` is none of a file, or of a folder of `pictures`, in the session's
/// folder. A file that is not there is no matter of this check.
fn outside(folder: &Path, name: &str, pictures: bool) -> Option<String> {
    /// Longest name that a file system takes, bytes.
    const LONGEST: usize = 255;
    let plain = |c: Component<'_>| matches!(c, Component::Normal(_) | Component::CurDir);
    if name.is_empty() || name.len() > LONGEST || !Path::new(name).components().all(plain) {
        return Some(quote(name));
    }
    let path = folder.join(name);
    // Links are followed here, once, before anything is opened. The folder of a bare "session.toml"
    // is "".
    let root = if folder.as_os_str().is_empty() {
        Path::new(".")
    } else {
        folder
    };
    let (Ok(target), Ok(root)) = (path.canonicalize(), root.canonicalize()) else {
        return pictures.then(|| quote(name));
    };
    if !target.starts_with(root) {
        return Some(format!("{}, a link to {}", quote(name), target.display()));
    }
    match pictures {
        true => (!target.is_dir()).then(|| quote(name)),
        false => {
            (!target.is_file()).then(|| format!("{}, which is not a regular file", quote(name)))
        }
    }
}

fn no_section(name: &str) -> InputError {
    InputError::new(NAME, format!("a table [{name}]"), "nothing").field(name)
}

fn load_whisker(
    document: Document,
    folder: &Path,
    medium: &str,
    inputs: &mut Vec<InputFile>,
    warnings: &mut Vec<SessionWarning>,
) -> Result<(WhiskerData, Sealed<WhiskerRow>), SessionError> {
    let Document {
        id: session,
        files,
        whisker,
        moments,
        mut fbg,
        trajectory,
        provenance,
        ..
    } = document;
    let expected = ShapesSource {
        session: Some(session),
        cameras_sha256: provenance.cameras_sha256,
        rig_sha256: provenance.shapes_rig_sha256,
    };
    let shape = match &files.rest_shape {
        Some(name) => {
            let (points, input) = whisker_meta::read_polyline(folder, name, warnings)?;
            inputs.push(input);
            Some((name.as_str(), points))
        }
        None => None,
    };
    let whisker = whisker
        .ok_or_else(|| no_section("whisker"))?
        .spec(NAME, shape, warnings)?;
    let moments = moments.axes(NAME)?;
    let trajectories = whisker_meta::trajectories(NAME, trajectory)?;
    let mut read = |name: &str, purpose: Purpose| -> Result<Vec<_>, SessionError> {
        let table = read_readings(&folder.join(name), name)?;
        inputs.push(table.input(purpose));
        let table = whisker::read_rows(&table, &mut fbg, Some(&trajectories))?;
        whisker_checks::check(&table.rows, &whisker.rest_shape, &trajectories, warnings)?;
        warnings.extend(table.warnings);
        Ok(table.rows)
    };
    let mut rows = read(&files.points, Purpose::Fit)?;
    let pairs = |name: &Option<String>, rows: &mut [WhiskerRow], purpose: Purpose| match name {
        Some(name) => {
            crate::shapes::read(&folder.join(name), name, &expected, rows, purpose).map(Some)
        }
        None => Ok(None),
    };
    let shapes = pairs(&files.shapes, &mut rows, Purpose::Fit)?;
    // A row that is sealed takes its pair with it.
    let mut holdout = seal(&mut rows, |r| r.role);
    let mut sealed_shapes = None;
    if let Some(name) = &files.holdout {
        let mut sealed = read(name, Purpose::Holdout)?;
        // Seen by the same cameras, but no part of what is fitted: they show how far off the
        // contact is.
        sealed_shapes = pairs(&files.holdout_shapes, &mut sealed, Purpose::Holdout)?;
        holdout.extend(sealed);
    }
    for (found, input) in shapes.iter().chain(&sealed_shapes) {
        inputs.push(input.clone());
        if !found.left_out.is_empty() {
            warnings.push(SessionWarning::other(
                &found.file,
                crate::shapes::in_words(&found.left_out),
            ));
        }
    }
    let shapes = shapes.map(|(found, _)| found);
    // Where nothing was loaded there is nothing to predict but the zero.
    holdout.relabel(&(), |r, ()| r.sealed = r.role != Role::Rest);
    require_unsealed(&files.points, rows.len())?;
    let mut twin = Vec::new();
    if let Some(name) = &files.twin {
        let input;
        (twin, input) = whisker::read_twin(&folder.join(name), name, &rows, warnings)?;
        inputs.push(input);
    }
    let medium = medium.to_owned();
    Ok((
        WhiskerData {
            whisker,
            moments,
            fbg,
            medium,
            trajectories,
            rows,
            twin,
            shapes,
        },
        holdout,
    ))
}

fn load_transducer(
    document: Document,
    folder: &Path,
    inputs: &mut Vec<InputFile>,
    warnings: &mut Vec<SessionWarning>,
) -> Result<(TransducerData, Sealed<TransducerRow>), SessionError> {
    let files = document.files;
    let data = match document.kind {
        SessionKind::Axis => TransducerData::axis(Vec::new()),
        _ => document
            .transducer
            .ok_or_else(|| no_section("transducer"))?,
    };
    for (key, unit) in [
        ("stimulus_unit", &data.stimulus_unit),
        ("response_unit", &data.response_unit),
    ] {
        if unit.trim().is_empty() {
            let field = format!("transducer.{key}");
            return Err(InputError::new(NAME, "a unit, e.g. \"N\"", "an empty text")
                .field(field)
                .into());
        }
    }
    let reference = data.reference_sd;
    if !(reference >= 0.0 && reference.is_finite()) {
        let expected = "a standard uncertainty, 0 or more";
        return Err(InputError::new(NAME, expected, reference.to_string())
            .field("transducer.reference_sd")
            .into());
    }
    let mut read = |name: &str, purpose: Purpose| -> Result<_, SessionError> {
        let table = read_readings(&folder.join(name), name)?;
        inputs.push(table.input(purpose));
        Ok(transducer::read_rows(&table, data.model, warnings)?)
    };
    let (mut rows, covariates) = read(&files.points, Purpose::Fit)?;
    let mut holdout = seal(&mut rows, |r| r.role);
    if let Some(name) = &files.holdout {
        let (sealed, others) = read(name, Purpose::Holdout)?;
        check_covariates(name, &covariates, &others)?;
        holdout.extend(sealed);
    }
    require_unsealed(&files.points, rows.len())?;
    let data = TransducerData {
        covariates,
        rows,
        ..data
    };
    Ok((data, holdout))
}

/// Covariates of a holdout table must be those of the points table, in the same order.
pub(crate) fn check_covariates(
    name: &str,
    points: &[String],
    holdout: &[String],
) -> Result<(), InputError> {
    // A row's covariates are known by their order alone.
    if points == holdout {
        return Ok(());
    }
    let list = |names: &[String]| {
        if names.is_empty() {
            "none".to_owned()
        } else {
            names.join(", ")
        }
    };
    Err(InputError::new(
        name,
        format!("the covariates of the points table ({})", list(points)),
        list(holdout),
    )
    .at(1))
}

/// Takes the rows with the role "holdout" out of a points table.
fn seal<R>(rows: &mut Vec<R>, role: impl Fn(&R) -> Role) -> Sealed<R> {
    // From here on their values are seen by opening the seal alone.
    let (sealed, open) = std::mem::take(rows)
        .into_iter()
        .partition(|row| role(row) == Role::Holdout);
    *rows = open;
    Sealed::new(sealed)
}

fn require_unsealed(file: &str, rows: usize) -> Result<(), InputError> {
    if rows > 0 {
        return Ok(());
    }
    Err(InputError::new(
        file,
        "at least one row that is not holdout",
        "holdout rows only",
    )
    .field("role"))
}
