//! Sessions taken together: a holdout that is given separately, or a later session of the same
//! sensor that is fitted too.

use crate::error::{InputError, SessionError};
use crate::foreign::as_imported;
use crate::session::{LoadedSession, check_covariates, load};
use crate::table::read_readings;
use crate::warning::SessionWarning;
use crate::whisker::{self, PM_PER_NM, WHISKER_COLUMNS};
use crate::{transducer, whisker_checks};
use std::path::Path;
use wcal_core::files::folder_of;
use wcal_core::observation::{PairLeftOut, Role, SessionShapes};
use wcal_core::order_statistics::extent;
use wcal_core::{
    FbgSpec, InputFile, Labelled, Purpose, RowLabel, Sealed, SealedRows, SessionData, SessionKind,
    Trajectory, TransducerRow, WhiskerData, WhiskerRow,
};

/// Columns of the other kinds.
const SCALAR_COLUMNS: [&str; 6] = [
    "stimulus",
    "stimulus_sd",
    "response",
    "commanded_mm",
    "measured_mm",
    "cycle",
];

/// Adds the rows at `path` (a session folder, or a CSV table with this session's columns) to the
/// session's holdout.
///
/// Of a session every row counts, its own holdout included. Trajectories of a whisker session that
/// clash with ids in use get new ids (a warning says so), and shifts are taken from this session's
/// nominal wavelengths. `source` of the rows is the table's name, or `folder/name` where it came
/// with a session.
///
/// # Errors
/// As [`load`]; also where kind, wire, moment axes or model differ, or where the file is one that
/// the session already uses.
pub fn attach_holdout(session: &mut LoadedSession, path: &Path) -> Result<(), SessionError> {
    let before = session.inputs.len();
    if path.is_dir() || path.file_name().is_some_and(|n| n == "session.toml") {
        let other = load(path)?;
        // That session's own record of looks has to hear of an opening, too.
        session.holdout_folders.push(other.folder.clone());
        attach_session(session, other, Purpose::Holdout)?;
    } else {
        let folder = folder_of(path);
        // A table in another session's folder is sealed by that session, too.
        if folder.join("session.toml").is_file() && folder != session.folder {
            session.holdout_folders.push(folder.to_owned());
        }
        attach_table(session, path)?;
    }
    // At the end, when the hashes of all files are known.
    refuse_reuse(session, before)
}

/// Adds a later session of the same sensor to the fit: its points to the points, its holdout to the
/// holdout.
///
/// The rows get a seating number (other kinds: a series) of their own, since the zero may differ
/// after re-seating, and times after the last reading, of a whisker an hour after it, the wire at
/// rest in between. Labels of its twin, if any, are not taken over (a warning says so).
///
/// # Errors
/// As [`attach_holdout`].
pub fn add_session(session: &mut LoadedSession, folder: &Path) -> Result<(), SessionError> {
    let before = session.inputs.len();
    let other = load(folder)?;
    attach_session(session, other, Purpose::Fit)?;
    refuse_reuse(session, before)
}

/// Pause between sessions, s: creep of the wire has died out.
const PAUSE_S: f64 = 3600.0;

fn place_after(own: &Rows<'_, WhiskerRow>, added: &mut Rows<'_, WhiskerRow>) {
    let (own, theirs) = (own.labels(), added.labels());
    let all = || own.iter().chain(&theirs);
    let end_s = all().filter_map(|l| l.t_s).fold(0.0, f64::max);
    let seating = 1 + all().map(|l| l.seating).max().unwrap_or(0);
    let [begin_s, _] = extent(theirs.iter().filter_map(|l| l.t_s).chain([0.0]));
    let shift_s = end_s + PAUSE_S - begin_s;
    added.each(&(seating, shift_s), |row, (seating, shift_s)| {
        row.seating = *seating;
        row.t_s = row.t_s.map(|t| t + shift_s);
    });
}

/// Rows of a later session are series of their own, since a mounting has its own zero, and lie
/// after the last reading by as long as the session before took: how long nothing was read is not
/// known.
fn place_series(own: &mut Rows<'_, TransducerRow>, added: &mut Rows<'_, TransducerRow>) {
    // Readings without a series are the first one: none that is added joins them.
    own.each(&(), |row, ()| {
        row.replicate.get_or_insert(1);
    });
    let (own, theirs) = (own.labels(), added.labels());
    let highest = own.iter().filter_map(|l| l.series).max().unwrap_or(1);
    let [[begin_s, end_s], [theirs_s, _]] =
        [own, theirs].map(|labels| extent(labels.iter().filter_map(|l| l.t_s)));
    let shift_s = if end_s > begin_s && theirs_s.is_finite() {
        2.0 * end_s - begin_s - theirs_s
    } else {
        0.0
    };
    added.each(&(shift_s, highest), |row, (shift_s, highest)| {
        row.t_s = row.t_s.map(|t| t + shift_s);
        row.replicate = Some(highest.saturating_add(row.replicate.unwrap_or(1)));
    });
}

/// All rows of a session, the sealed ones behind their seal.
struct Rows<'a, R> {
    open: &'a mut Vec<R>,
    sealed: &'a mut Sealed<R>,
}

impl<R: Labelled> Rows<'_, R> {
    /// Relabels every row.
    fn each<C>(&mut self, with: &C, change: fn(&mut R, &C)) {
        self.open.iter_mut().for_each(|row| change(row, with));
        self.sealed.relabel(with, change);
    }

    /// Who the rows are.
    fn labels(&self) -> Vec<RowLabel> {
        let open = self.open.iter().map(Labelled::label);
        open.chain(self.sealed.labels()).collect()
    }

    /// Takes over those of another session in `folder`: to the fit, or behind the seal; what was
    /// sealed there stays sealed.
    fn take_over(
        self,
        mut added: Self,
        purpose: Purpose,
        folder: &str,
        source: fn(&mut R) -> &mut String,
    ) {
        // Both sessions call their table points.csv: the folder distinguishes them.
        added.each(&(folder, source), |row, (folder, source)| {
            let name = source(row);
            *name = format!("{folder}/{name}");
        });
        let rows = std::mem::take(added.open);
        match purpose {
            Purpose::Fit => self.open.extend(rows),
            _ => self.sealed.extend(rows),
        }
        self.sealed.join(std::mem::take(added.sealed));
    }
}

/// The same bytes cannot be fitted and held out, nor fitted twice.
fn refuse_reuse(session: &LoadedSession, before: usize) -> Result<(), SessionError> {
    let (known, added) = session.inputs.split_at(before);
    let mut fitted = known.iter().filter(|input| input.purpose == Purpose::Fit);
    // Descriptions, such as the wire's shape, may be the same in both.
    let readings = |input: &&InputFile| input.purpose != Purpose::Description;
    let same = fitted.find_map(|f| {
        added
            .iter()
            .filter(readings)
            .find(|a| a.sha256 == f.sha256)
            .map(|a| (f, a))
    });
    match same {
        Some((fitted, input)) => {
            let found = format!("the content of {}, which is fitted", fitted.path);
            Err(InputError::new(&input.path, "readings that no fit has seen", found).into())
        }
        None => Ok(()),
    }
}

fn attach_table(session: &mut LoadedSession, path: &Path) -> Result<(), SessionError> {
    let file = path.file_name().map_or_else(
        || path.display().to_string(),
        |n| n.to_string_lossy().into_owned(),
    );
    let name = if session.inputs.iter().any(|i| i.path == file) {
        path.display().to_string()
    } else {
        file
    };
    let warnings = &mut session.warnings;
    let mut known: Vec<String> = SCALAR_COLUMNS
        .iter()
        .chain(&WHISKER_COLUMNS)
        .map(|c| (*c).to_owned())
        .collect();
    let mut units = Vec::new();
    if let SessionData::Transducer(data) = &session.data
        && session.kind == SessionKind::Transducer
    {
        known.extend(data.covariates.iter().cloned());
        units.extend([
            ("stimulus", data.stimulus_unit.as_str()),
            ("response", &data.response_unit),
        ]);
    }
    let table = match as_imported(path, &name, &session.imported, &known, &units)? {
        Some(table) => {
            let columns = session
                .imported
                .iter()
                .map(|(own, text)| format!("{own} from {text}"));
            let columns = columns.collect::<Vec<_>>().join(", ");
            let read = format!(
                "read as a table of the form that was imported, all rows held out: {columns}"
            );
            let said = [read]
                .into_iter()
                .chain(table.remarks.clone())
                .chain(table.warnings.clone());
            warnings.extend(said.map(|text| SessionWarning::other(&name, text)));
            table
        }
        None => read_readings(path, &name)?,
    };
    match (&mut session.data, &mut session.sealed) {
        (SessionData::Whisker(data), SealedRows::Whisker(holdout)) => {
            let (shape, paths) = (&data.whisker.rest_shape, data.trajectories.as_slice());
            let read = whisker::read_rows(&table, &mut data.fbg, Some(paths))?;
            whisker_checks::check(&read.rows, shape, paths, warnings)?;
            warnings.extend(read.warnings);
            holdout.extend(read.rows.into_iter().map(|r| WhiskerRow {
                sealed: r.role != Role::Rest,
                ..r
            }));
        }
        (SessionData::Transducer(data), SealedRows::Transducer(holdout)) => {
            let (rows, covariates) = transducer::read_rows(&table, data.model, warnings)?;
            check_covariates(&name, &data.covariates, &covariates)?;
            holdout.extend(rows);
        }
        _ => return Err(other_kind(&name).into()),
    }
    session.inputs.push(table.input(Purpose::Holdout));
    Ok(())
}

/// Pairs of another session count where the same cameras made them: then both share the same
/// errors.
fn merge_shapes(
    own: Option<&mut SessionShapes>,
    theirs: &SessionShapes,
    added: &mut Rows<'_, WhiskerRow>,
    folder: &str,
    warnings: &mut Vec<SessionWarning>,
) {
    // Other cameras have other errors, of which this shared covariance says nothing.
    let alike = |own: &SessionShapes| {
        own.parameters == theirs.parameters && own.covariance == theirs.covariance
    };
    if own.as_deref().is_some_and(alike) {
        return;
    }
    let dropped = added.labels().iter().filter(|row| row.pictured).count();
    added.each(&(), |row, ()| row.pair = None);
    match own {
        _ if dropped == 0 => {}
        Some(own) => own.left_out.push(PairLeftOut {
            name: folder.to_owned(),
            why: format!(
                "{dropped} pairs of that session were made with other cameras than this one's"
            ),
        }),
        None => warnings.push(SessionWarning::other(
            folder,
            format!("{dropped} pairs of that session do not count: this session has no pictures"),
        )),
    }
}

fn attach_session(
    session: &mut LoadedSession,
    other: LoadedSession,
    purpose: Purpose,
) -> Result<(), SessionError> {
    let folder = other
        .folder
        .file_name()
        .map_or_else(String::new, |n| n.to_string_lossy().into_owned());
    let renamed = |name: &str| format!("{folder}/{name}");
    let differs = |what: &str| {
        InputError::new(
            &renamed("session.toml"),
            format!("the {what} of the session"),
            "another one",
        )
    };
    match (
        &mut session.data,
        &mut session.sealed,
        other.data,
        other.sealed,
    ) {
        (
            SessionData::Whisker(data),
            SealedRows::Whisker(own),
            SessionData::Whisker(theirs),
            SealedRows::Whisker(mut sealed),
        ) => {
            let WhiskerData {
                whisker,
                moments,
                fbg,
                trajectories,
                mut rows,
                twin,
                shapes,
                ..
            } = theirs;
            // Moments follow from the wire: rows of another one would calibrate a mixture.
            if data.whisker.rest_shape != whisker.rest_shape
                || data.whisker.diameter_mm != whisker.diameter_mm
            {
                return Err(differs("wire").field("whisker").into());
            }
            if data.moments != moments {
                return Err(differs("moment axes and sign").field("moments").into());
            }
            let mut added = Rows {
                open: &mut rows,
                sealed: &mut sealed,
            };
            let (file, warnings) = (renamed("session.toml"), &mut session.warnings);
            merge_trajectories(data, trajectories, &mut added, &file, warnings)?;
            merge_nominals(&data.fbg, &fbg, &mut added);
            if let Some(theirs) = shapes {
                merge_shapes(data.shapes.as_mut(), &theirs, &mut added, &folder, warnings);
            }
            let own = Rows {
                open: &mut data.rows,
                sealed: own,
            };
            if purpose == Purpose::Fit {
                if !twin.is_empty() {
                    let text = "labels of its twin are not used";
                    warnings.push(SessionWarning::other(&folder, text));
                }
                place_after(&own, &mut added);
            } else {
                // Of a session that is held out every row counts, whatever its role says.
                added.each(&(), |r, ()| r.sealed = true);
            }
            own.take_over(added, purpose, &folder, |row| &mut row.source);
        }
        (
            SessionData::Transducer(data),
            SealedRows::Transducer(own),
            SessionData::Transducer(mut theirs),
            SealedRows::Transducer(mut sealed),
        ) if session.kind == other.kind => {
            // Numbers in other units would be fitted as if they were the same.
            if (&data.stimulus_unit, &data.response_unit)
                != (&theirs.stimulus_unit, &theirs.response_unit)
            {
                return Err(differs("units").field("transducer").into());
            }
            let file = renamed(&other.points_file);
            check_covariates(&file, &data.covariates, &theirs.covariates)?;
            let [mut own, mut added] = [
                Rows {
                    open: &mut data.rows,
                    sealed: own,
                },
                Rows {
                    open: &mut theirs.rows,
                    sealed: &mut sealed,
                },
            ];
            if purpose == Purpose::Fit {
                place_series(&mut own, &mut added);
            }
            own.take_over(added, purpose, &folder, |row| &mut row.source);
        }
        _ => return Err(other_kind(&renamed("session.toml")).into()),
    }
    // What is partly simulated is not measured.
    if session.simulated != other.simulated {
        let which = if other.simulated {
            &other.id
        } else {
            &session.id
        };
        let text = format!("measured and SIMULATED sessions are joined: {which:?} is simulated");
        session
            .warnings
            .push(SessionWarning::other("session.toml", text));
        session.simulated = true;
    }
    session
        .warnings
        .extend(other.warnings.into_iter().map(|w| SessionWarning {
            file: renamed(&w.file),
            ..w
        }));
    session
        .inputs
        .extend(other.inputs.into_iter().map(|mut input| {
            input.path = renamed(&input.path);
            if purpose == Purpose::Holdout && input.purpose == Purpose::Fit {
                input.purpose = Purpose::Holdout;
            }
            input
        }));
    Ok(())
}

/// The two sessions are of different kinds.
fn other_kind(file: &str) -> InputError {
    InputError::new(file, "the kind of the session", "another one").field("kind")
}

/// Takes over the other session's trajectories; an id that means something else here is replaced by
/// a free one.
fn merge_trajectories(
    data: &mut WhiskerData,
    theirs: Vec<Trajectory>,
    added: &mut Rows<'_, WhiskerRow>,
    file: &str,
    warnings: &mut Vec<SessionWarning>,
) -> Result<(), InputError> {
    const SAME: f64 = 1e-6;
    for mut trajectory in theirs {
        let same = |t: &Trajectory| {
            (t.origin_mm - trajectory.origin_mm).norm() < SAME
                && (t.direction - trajectory.direction).norm() < SAME
        };
        match data.trajectory(trajectory.id) {
            Some(known) if same(known) => {}
            None => data.trajectories.push(trajectory),
            Some(_) => {
                let highest = data.trajectories.iter().map(|t| t.id).max().unwrap_or(0);
                // Ids of rows that are still to be renamed must not be hit either.
                let ids = added.labels().into_iter().filter_map(|l| l.trajectory);
                let new = ids.chain([highest]).max().and_then(|id| id.checked_add(1));
                let new = new.ok_or_else(|| {
                    InputError::new(file, "a free trajectory id", "none").field("trajectory.id")
                })?;
                let old = trajectory.id;
                let text = format!("trajectory {old} is another path here and is called {new}");
                warnings.push(SessionWarning::other(file, text));
                added.each(&(old, new), |row, (old, new)| {
                    if row.trajectory == Some(*old) {
                        row.trajectory = Some(*new);
                    }
                });
                trajectory.id = new;
                data.trajectories.push(trajectory);
            }
        }
    }
    Ok(())
}

/// Shifts count from this session's nominal wavelengths.
fn merge_nominals(own: &FbgSpec, theirs: &FbgSpec, added: &mut Rows<'_, WhiskerRow>) {
    let sensing = match (own.nominal_nm, theirs.nominal_nm) {
        (Some(here), Some(there)) => [there[0] - here[0], there[1] - here[1]],
        _ => [0.0; 2],
    };
    let reference = match (own.reference_nominal_nm, theirs.reference_nominal_nm) {
        (Some(here), Some(there)) => there - here,
        _ => 0.0,
    };
    added.each(&(sensing, reference), |row, (sensing, reference)| {
        row.shift_pm[0] += PM_PER_NM * sensing[0];
        row.shift_pm[1] += PM_PER_NM * sensing[1];
        row.reference_shift_pm = row.reference_shift_pm.map(|pm| pm + PM_PER_NM * reference);
    });
}
