//! A session folder as a whole.

use crate::document::{self, Section};
use crate::error::{InputError, SessionError, quote};
use crate::shapes::Expected;
use crate::warning::{SessionWarning, WarningKind};
use crate::whisker::{self, ColumnRequirement};
use crate::{axis, transducer, whisker_checks, whisker_meta};
use std::path::{Component, Path, PathBuf};
use wcal_core::files::{MAX_DOCUMENT_BYTES, read_within};
use wcal_core::format::is_newer;
use wcal_core::provenance::sha256_hex;
use wcal_core::ranges;
use wcal_core::{
    AxisData, AxisRow, InputFile, Purpose, Role, Sealed, SessionData, SessionKind, TransducerData,
    WhiskerData, WhiskerRow,
};

/// Format tag of `session.toml`.
pub const SESSION_FORMAT: &str = "wcal-session/1";

/// A session that was read and checked.
#[derive(Debug, Clone, PartialEq)]
pub struct LoadedSession {
    /// The folder.
    pub folder: PathBuf,
    /// Identifier.
    pub id: String,
    /// Surrounding medium, e.g. `air`, `water`; `unspecified` where the file does not say (kinds other than whisker).
    pub medium: String,
    /// Creation time as written, if given.
    pub created: Option<String>,
    /// Kind.
    pub kind: SessionKind,
    /// The data are simulated, not measured: `simulated = true` under `[provenance]`, of this session or of one joined with it.
    pub simulated: bool,
    /// Checked data. Rows with the role "holdout" in the points table are moved to `holdout`, so nothing fits them by mistake.
    pub data: SessionData,
    /// Every file read, with its hash; paths relative to the folder.
    pub inputs: Vec<InputFile>,
    /// `session.toml` as written.
    pub meta: toml::Table,
    /// What deserves attention: unknown keys and columns, stage against groove, time, missing labels.
    pub warnings: Vec<SessionWarning>,
    /// Name of the points table, relative to the folder.
    pub points_file: String,
    /// Folder with the pictures of its points, where it has them.
    pub pictures: Option<PathBuf>,
}

struct Files {
    points: String,
    holdout: Option<String>,
    twin: Option<String>,
    rest_shape: Option<String>,
    shapes: Option<String>,
    holdout_shapes: Option<String>,
    pictures: Option<PathBuf>,
}

/// Reads a session folder (or the path of its `session.toml`) and checks everything in it.
///
/// # Errors
/// The first thing that cannot be used: [`SessionError::Content`] with file, line, field, expected and found, or
/// [`SessionError::Io`].
pub fn load(folder: &Path) -> Result<LoadedSession, SessionError> {
    let folder = if folder.is_file() { folder.parent().unwrap_or(folder) } else { folder };
    if folder.exists() && !folder.is_dir() {
        return Err(
            InputError::new(&folder.display().to_string(), "a session folder", "a pipe or device").into()
        );
    }
    const NAME: &str = "session.toml";
    let path = folder.join(NAME);
    let bytes = read_within(&path, MAX_DOCUMENT_BYTES).map_err(|e| SessionError::io("reading", &path, e))?;
    let meta = document::parse(NAME, &bytes)?;
    let root = Section::root(NAME, &meta);
    check_format(&root)?;
    ranges::check(&meta, &[whisker_meta::SESSION_RANGES]).map_err(|e| InputError::range(NAME, e))?;
    let mut warnings = Vec::new();
    let mut inputs =
        vec![InputFile { path: NAME.to_owned(), sha256: sha256_hex(&bytes), purpose: Purpose::Description }];
    let id = root.required_text("id", "a session identifier")?;
    let kind = read_kind(&root)?;
    let created = root.text("created")?;
    let medium = read_medium(&root, kind, &mut warnings)?;
    let files = read_files(&root, folder, &mut warnings)?;
    for free in ["note", "whisker_id", "devices"] {
        root.value(free);
    }
    let simulated = read_simulated(&root)?;
    let data = match kind {
        SessionKind::Whisker => {
            let expected = expected_shapes(&root, &id)?;
            let data = load_whisker(&root, folder, &files, &medium, &expected, &mut inputs, &mut warnings)?;
            SessionData::Whisker(data)
        }
        SessionKind::Transducer => {
            SessionData::Transducer(load_transducer(&root, folder, &files, &mut inputs, &mut warnings)?)
        }
        SessionKind::Axis => SessionData::Axis(load_axis(folder, &files, &mut inputs, &mut warnings)?),
    };
    whisker_meta::warn_unknown(&root, &mut warnings);
    let folder = folder.to_owned();
    let points_file = files.points;
    Ok(LoadedSession {
        folder,
        id,
        medium,
        created,
        kind,
        simulated,
        data,
        inputs,
        meta,
        warnings,
        points_file,
        pictures: files.pictures,
    })
}

/// The mark of simulated data; sessions from before it, and other content of `[provenance]`, are taken as measured.
fn read_simulated(root: &Section<'_>) -> Result<bool, InputError> {
    match root.value("provenance") {
        Some(toml::Value::Table(_)) => {
            let section = root.section("provenance")?;
            Ok(section.map(|s| s.flag("simulated")).transpose()?.flatten().unwrap_or(false))
        }
        _ => Ok(false),
    }
}

/// What the session says of the cameras and the rig that its shapes come from.
fn expected_shapes(root: &Section<'_>, id: &str) -> Result<Expected, InputError> {
    let mut expected = Expected { session: id.to_owned(), ..Expected::default() };
    if let Some(toml::Value::Table(_)) = root.value("provenance")
        && let Some(section) = root.section("provenance")?
    {
        expected.cameras_sha256 = section.text("cameras_sha256")?;
        expected.rig_sha256 = section.text("shapes_rig_sha256")?;
    }
    Ok(expected)
}

fn check_format(root: &Section<'_>) -> Result<(), InputError> {
    let format = root.required_text("format", &format!("{SESSION_FORMAT:?}"))?;
    if format == SESSION_FORMAT {
        return Ok(());
    }
    let error = root.error("format", format!("{SESSION_FORMAT:?}"), quote(&format));
    Err(if is_newer(SESSION_FORMAT, &format) {
        error.hint("the session was written in a newer format; update wcal to read it")
    } else {
        error
    })
}

fn read_kind(root: &Section<'_>) -> Result<SessionKind, InputError> {
    let expected = "\"whisker\", \"transducer\" or \"axis\"";
    match root.required_text("kind", expected)?.as_str() {
        "whisker" => Ok(SessionKind::Whisker),
        "transducer" => Ok(SessionKind::Transducer),
        "axis" => Ok(SessionKind::Axis),
        other => Err(root.error("kind", expected, quote(other))),
    }
}

fn read_medium(
    root: &Section<'_>,
    kind: SessionKind,
    warnings: &mut Vec<SessionWarning>,
) -> Result<String, InputError> {
    match root.text("medium")? {
        Some(medium) => Ok(medium),
        None if kind == SessionKind::Whisker => {
            warnings.push(SessionWarning::new("session.toml", WarningKind::NoMedium));
            Ok("air".to_owned())
        }
        None => Ok("unspecified".to_owned()),
    }
}

fn read_files(
    root: &Section<'_>,
    folder: &Path,
    warnings: &mut Vec<SessionWarning>,
) -> Result<Files, InputError> {
    let section = root.section("files")?;
    let section = section.ok_or_else(|| root.error("files", "a table [files]", "nothing"))?;
    let relative = |key: &str| -> Result<Option<String>, InputError> {
        let Some(name) = section.text(key)? else { return Ok(None) };
        match outside(folder, &name) {
            Some(found) => {
                let expected = "a file in the session's folder, its path relative to it and without \"..\"";
                Err(section.error(key, expected, found))
            }
            None => Ok(Some(name)),
        }
    };
    let points = relative("points")?
        .ok_or_else(|| section.error("points", "the name of the points table", "nothing"))?;
    let files = Files {
        points,
        holdout: relative("holdout")?,
        twin: relative("twin")?,
        rest_shape: relative("rest_shape")?,
        shapes: relative("shapes")?,
        holdout_shapes: relative("holdout_shapes")?,
        pictures: pictures_folder(&section, folder)?,
    };
    if let Some(name) = relative("recording")?.filter(|name| !folder.join(name).is_file()) {
        warnings.push(SessionWarning::new("session.toml", WarningKind::NoRecording(name)));
    }
    whisker_meta::warn_unknown(&section, warnings);
    Ok(files)
}

/// `pictures` of `[files]`: a folder inside the session's.
fn pictures_folder(section: &Section<'_>, folder: &Path) -> Result<Option<PathBuf>, InputError> {
    let Some(name) = section.text("pictures")? else { return Ok(None) };
    let path = folder.join(&name);
    let plain = |c: Component<'_>| matches!(c, Component::Normal(_) | Component::CurDir);
    // A link could lead out of the session.
    let linked = path.symlink_metadata().is_ok_and(|about| about.is_symlink());
    if name.is_empty() || !Path::new(&name).components().all(plain) || linked || !path.is_dir() {
        let expected = "a folder in the session's, its path relative to it and without \"..\"";
        return Err(section.error("pictures", expected, quote(&name)));
    }
    Ok(Some(path))
}

/// Why a name in `[files]` is none of a file in the folder: a session that was handed on must not read anything else of this computer.
/// A file that is not there is no matter of this check.
fn outside(folder: &Path, name: &str) -> Option<String> {
    /// Longest name that a file system takes, bytes.
    const LONGEST: usize = 255;
    let plain = |c: Component<'_>| matches!(c, Component::Normal(_) | Component::CurDir);
    if name.is_empty() || name.len() > LONGEST || !Path::new(name).components().all(plain) {
        return Some(quote(name));
    }
    let path = folder.join(name);
    // Links are followed here, once, before anything is opened. The folder of a bare "session.toml" is "".
    let root = if folder.as_os_str().is_empty() { Path::new(".") } else { folder };
    let (Ok(target), Ok(root)) = (path.canonicalize(), root.canonicalize()) else { return None };
    if !target.starts_with(root) {
        return Some(format!("{}, a link to {}", quote(name), target.display()));
    }
    (!target.is_file()).then(|| format!("{}, which is not a regular file", quote(name)))
}

fn load_whisker(
    root: &Section<'_>,
    folder: &Path,
    files: &Files,
    medium: &str,
    expected: &Expected,
    inputs: &mut Vec<InputFile>,
    warnings: &mut Vec<SessionWarning>,
) -> Result<WhiskerData, SessionError> {
    let mut meta = whisker_meta::read(root, folder, files.rest_shape.as_deref(), warnings)?;
    inputs.append(&mut meta.inputs);
    let length_mm = whisker_checks::length_mm(&meta.whisker.rest_shape);
    let mut read = |name: &str, purpose: Purpose| -> Result<Vec<_>, SessionError> {
        let path = folder.join(name);
        let table =
            whisker::read_rows(&path, name, &mut meta.fbg, &meta.trajectories, ColumnRequirement::Session)?;
        // A factor of 1000 is named as such before it is called out of reach.
        whisker_checks::check_stage(&table.rows, &meta.trajectories, warnings)?;
        whisker_checks::check_reach(&table.rows, length_mm)?;
        inputs.push(InputFile { purpose, ..table.input });
        warnings.extend(table.warnings);
        Ok(table.rows)
    };
    let mut rows = read(&files.points, Purpose::Fit)?;
    let pairs = |name: &Option<String>, rows: &mut [WhiskerRow], purpose: Purpose| match name {
        Some(name) => crate::shapes::read(&folder.join(name), name, expected, rows, purpose).map(Some),
        None => Ok(None),
    };
    let shapes = pairs(&files.shapes, &mut rows, Purpose::Fit)?;
    // A row that is sealed takes its pair with it.
    let mut holdout = seal(&mut rows, |r| r.role);
    let mut sealed_shapes = None;
    if let Some(name) = &files.holdout {
        let mut sealed = read(name, Purpose::Holdout)?;
        // Seen by the same cameras, but no part of what is fitted: they show how far off the contact is.
        sealed_shapes = pairs(&files.holdout_shapes, &mut sealed, Purpose::Holdout)?;
        holdout.extend(sealed);
    }
    for (found, input) in shapes.iter().chain(&sealed_shapes) {
        inputs.push(input.clone());
        if !found.left_out.is_empty() {
            let kind = WarningKind::PairsLeftOut(found.left_out.clone());
            warnings.push(SessionWarning::new(&found.file, kind));
        }
    }
    let shapes = shapes.map(|(found, _)| found);
    // Where nothing was loaded there is nothing to predict but the zero.
    holdout.relabel(|r| r.sealed = r.role != Role::Rest);
    require_unsealed(&files.points, rows.len())?;
    let mut twin = Vec::new();
    if let Some(name) = &files.twin {
        let input;
        (twin, input) = whisker::read_twin(&folder.join(name), name, &rows, warnings)?;
        inputs.push(input);
    }
    let medium = medium.to_owned();
    let whisker_meta::WhiskerMeta { whisker, moments, fbg, trajectories, .. } = meta;
    Ok(WhiskerData { whisker, moments, fbg, medium, trajectories, rows, holdout, twin, shapes })
}

fn load_transducer(
    root: &Section<'_>,
    folder: &Path,
    files: &Files,
    inputs: &mut Vec<InputFile>,
    warnings: &mut Vec<SessionWarning>,
) -> Result<TransducerData, SessionError> {
    let meta = transducer::read_meta(root, warnings)?;
    let table = transducer::read_rows(&folder.join(&files.points), &files.points, &[], warnings)?;
    inputs.push(InputFile { purpose: Purpose::Fit, ..table.input });
    let (mut rows, covariates) = (table.rows, table.covariates);
    let mut holdout = seal(&mut rows, |r| r.role);
    if let Some(name) = &files.holdout {
        let sealed = transducer::read_rows(&folder.join(name), name, &rows, warnings)?;
        check_covariates(name, &covariates, &sealed.covariates)?;
        inputs.push(InputFile { purpose: Purpose::Holdout, ..sealed.input });
        holdout.extend(sealed.rows);
    }
    require_unsealed(&files.points, rows.len())?;
    let transducer::TransducerMeta { stimulus_unit, response_unit, model } = meta;
    Ok(TransducerData { stimulus_unit, response_unit, model, covariates, rows, holdout })
}

/// Covariates of a holdout table must be those of the points table, in the same order.
pub(crate) fn check_covariates(name: &str, points: &[String], holdout: &[String]) -> Result<(), InputError> {
    if points == holdout {
        return Ok(());
    }
    let list = |names: &[String]| if names.is_empty() { "none".to_owned() } else { names.join(", ") };
    Err(InputError::new(
        name,
        format!("the covariates of the points table ({})", list(points)),
        list(holdout),
    )
    .at(1))
}

fn load_axis(
    folder: &Path,
    files: &Files,
    inputs: &mut Vec<InputFile>,
    warnings: &mut Vec<SessionWarning>,
) -> Result<AxisData, SessionError> {
    let mut read = |name: &str, points: &[AxisRow], purpose: Purpose| -> Result<Vec<_>, SessionError> {
        let (rows, input) = axis::read_rows(&folder.join(name), name, points, warnings)?;
        inputs.push(InputFile { purpose, ..input });
        Ok(rows)
    };
    let mut rows = read(&files.points, &[], Purpose::Fit)?;
    let mut holdout = seal(&mut rows, |r| r.role);
    if let Some(name) = &files.holdout {
        holdout.extend(read(name, &rows, Purpose::Holdout)?);
    }
    require_unsealed(&files.points, rows.len())?;
    Ok(AxisData { rows, holdout })
}

/// Takes the rows with the role "holdout" out of a points table.
fn seal<R>(rows: &mut Vec<R>, role: impl Fn(&R) -> Role) -> Sealed<R> {
    let (sealed, open) = std::mem::take(rows).into_iter().partition(|row| role(row) == Role::Holdout);
    *rows = open;
    Sealed::new(sealed)
}

fn require_unsealed(file: &str, rows: usize) -> Result<(), InputError> {
    if rows > 0 {
        return Ok(());
    }
    Err(InputError::new(file, "at least one row that is not holdout", "holdout rows only").field("role"))
}
