//! Sessions taken together: a holdout that is given separately, or a later session of the same
//! sensor that is fitted too.

use crate::error::{InputError, SessionError};
use crate::foreign::as_imported;
use crate::session::{LoadedSession, check_covariates, load};
use crate::table::read_readings;
use crate::warning::SessionWarning;
use crate::whisker::{self, ColumnRequirement, WHISKER_COLUMNS};
use crate::{axis, transducer, whisker_checks};
use std::path::Path;
use wcal_core::files::folder_of;
use wcal_core::observation::{PairLeftOut, Role, SessionShapes};
use wcal_core::{
    AxisRow, InputFile, Labelled, Purpose, Sealed, SealedRows, SessionData, TransducerRow,
    WhiskerData, WhiskerRow,
};

const PM_PER_NM: f64 = 1000.0;
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
        session.holdout_folders.push(other.folder.clone());
        attach_session(session, other, Purpose::Holdout)?;
    } else {
        let folder = folder_of(path);
        if folder.join("session.toml").is_file() && folder != session.folder {
            session.holdout_folders.push(folder.to_owned());
        }
        attach_table(session, path)?;
    }
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

fn place_after((data, sealed): (&WhiskerData, &Sealed<WhiskerRow>), added: &mut Added) {
    let of = |d: &WhiskerData, sealed: &Sealed<WhiskerRow>| -> Vec<(Option<f64>, u32)> {
        let labels = d.rows.iter().map(Labelled::label).chain(sealed.labels());
        labels.map(|l| (l.t_s, l.seating)).collect()
    };
    let (all, own) = (of(data, sealed), of(&added.data, &added.sealed));
    let end_s = all.iter().filter_map(|r| r.0).fold(0.0, f64::max);
    let seating = 1 + all.iter().map(|r| r.1).max().unwrap_or(0);
    let shift_s = end_s + PAUSE_S
        - own
            .iter()
            .filter_map(|r| r.0)
            .fold(f64::INFINITY, f64::min)
            .min(0.0);
    added.every_row(&(seating, shift_s), |row, (seating, shift_s)| {
        row.seating = *seating;
        row.t_s = row.t_s.map(|t| t + shift_s);
    });
}

/// Time and series of a row.
type Series<R> = fn(&mut R) -> (&mut Option<f64>, &mut Option<u32>);

/// Rows of a later session are series of their own, since a mounting has its own zero, and lie
/// after the last reading by as long as the session before took: how long nothing was read is not
/// known.
fn place_series<R: Labelled>(
    own: (&mut [R], &mut Sealed<R>),
    added: (&mut [R], &mut Sealed<R>),
    of: Series<R>,
) {
    fn first<R>(row: &mut R, of: &Series<R>) {
        of(row).1.get_or_insert(1);
    }
    fn later<R>(row: &mut R, (of, shift_s, highest): &(Series<R>, f64, u32)) {
        let (t_s, series) = of(row);
        *t_s = t_s.map(|t| t + shift_s);
        *series = Some(highest.saturating_add(series.unwrap_or(1)));
    }
    own.0.iter_mut().for_each(|row| first(row, &of));
    own.1.relabel(&of, first);
    let labels = own.0.iter().map(Labelled::label).chain(own.1.labels());
    let highest = labels.filter_map(|label| label.series).max().unwrap_or(1);
    let range = |rows: &[R], sealed: &Sealed<R>| {
        let times = rows
            .iter()
            .map(Labelled::label)
            .chain(sealed.labels())
            .filter_map(|l| l.t_s);
        times.fold([f64::INFINITY, f64::NEG_INFINITY], |[a, b], t| {
            [a.min(t), b.max(t)]
        })
    };
    let ([begin_s, end_s], [theirs_s, _]) = (range(own.0, own.1), range(added.0, added.1));
    let shift_s = if end_s > begin_s && theirs_s.is_finite() {
        2.0 * end_s - begin_s - theirs_s
    } else {
        0.0
    };
    let with = (of, shift_s, highest);
    added.0.iter_mut().for_each(|row| later(row, &with));
    added.1.relabel(&with, later);
}

/// Another whisker session that is taken over.
struct Added {
    data: WhiskerData,
    sealed: Sealed<WhiskerRow>,
}

impl Added {
    /// Relabels every row, the sealed ones behind their seal.
    fn every_row<C>(&mut self, with: &C, change: fn(&mut WhiskerRow, &C)) {
        self.data.rows.iter_mut().for_each(|row| change(row, with));
        self.sealed.relabel(with, change);
    }

    /// Who the rows are.
    fn labels(&self) -> impl Iterator<Item = wcal_core::RowLabel> {
        self.data
            .rows
            .iter()
            .map(Labelled::label)
            .chain(self.sealed.labels())
    }
}

/// The same bytes cannot be fitted and held out, nor fitted twice.
fn refuse_reuse(session: &LoadedSession, before: usize) -> Result<(), SessionError> {
    let (known, added) = session.inputs.split_at(before);
    let mut fitted = known.iter().filter(|input| input.purpose == Purpose::Fit);
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
    let (purpose, warnings) = (Purpose::Holdout, &mut session.warnings);
    let mut known: Vec<String> = SCALAR_COLUMNS
        .iter()
        .chain(&WHISKER_COLUMNS)
        .map(|c| (*c).to_owned())
        .collect();
    let mut units = Vec::new();
    if let SessionData::Transducer(data) = &session.data {
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
    let input = match (&mut session.data, &mut session.sealed) {
        (
            SessionData::Whisker(WhiskerData {
                whisker,
                fbg,
                trajectories,
                ..
            }),
            SealedRows::Whisker(holdout),
        ) => {
            let table = whisker::read_rows(&table, fbg, trajectories, ColumnRequirement::Session)?;
            whisker_checks::check_stage(&table.rows, trajectories, warnings)?;
            whisker_checks::check_reach(
                &table.rows,
                whisker_checks::length_mm(&whisker.rest_shape),
            )?;
            warnings.extend(table.warnings);
            holdout.extend(table.rows.into_iter().map(|r| WhiskerRow {
                sealed: r.role != Role::Rest,
                ..r
            }));
            InputFile {
                purpose,
                ..table.input
            }
        }
        (SessionData::Transducer(data), SealedRows::Transducer(holdout)) => {
            let table = transducer::read_rows(&table, purpose, warnings)?;
            check_covariates(&name, &data.covariates, &table.covariates)?;
            holdout.extend(table.rows);
            table.input
        }
        (SessionData::Axis(_), SealedRows::Axis(holdout)) => {
            let (rows, input) = axis::read_rows(&table, purpose, warnings)?;
            holdout.extend(rows);
            input
        }
        _ => return Err(other_kind(&name).into()),
    };
    session.inputs.push(input);
    Ok(())
}

/// Pairs of another session count where the same cameras made them: then both share the same
/// errors.
fn merge_shapes(data: &mut WhiskerData, added: &mut Added, folder: &str) {
    let Some(theirs) = added.data.shapes.take() else {
        return;
    };
    let alike = |own: &SessionShapes| {
        own.parameters == theirs.parameters && own.covariance == theirs.covariance
    };
    if data.shapes.as_ref().is_some_and(alike) {
        return;
    }
    let dropped = added.labels().filter(|row| row.pictured).count();
    added.every_row(&(), |row, ()| row.pair = None);
    if let Some(own) = data.shapes.as_mut().filter(|_| dropped > 0) {
        let why =
            format!("{dropped} pairs of that session were made with other cameras than this one's");
        own.left_out.push(PairLeftOut {
            name: folder.to_owned(),
            why,
        });
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
            SealedRows::Whisker(sealed),
        ) => {
            if data.whisker.rest_shape != theirs.whisker.rest_shape
                || data.whisker.diameter_mm != theirs.whisker.diameter_mm
            {
                return Err(differs("wire").field("whisker").into());
            }
            if data.moments != theirs.moments {
                return Err(differs("moment axes and sign").field("moments").into());
            }
            let mut added = Added {
                data: theirs,
                sealed,
            };
            merge_trajectories(
                data,
                &mut added,
                &renamed("session.toml"),
                &mut session.warnings,
            )?;
            merge_nominals(data, &mut added);
            merge_shapes(data, &mut added, &folder);
            if purpose == Purpose::Fit {
                if !added.data.twin.is_empty() {
                    let text = "labels of its twin are not used";
                    session.warnings.push(SessionWarning::other(&folder, text));
                }
                place_after((data, own), &mut added);
            }
            // Of a session that is held out every row counts, whatever its role says.
            if purpose == Purpose::Holdout {
                added.every_row(&(), |r, ()| r.sealed = true);
            }
            let theirs = (added.data.rows, added.sealed);
            take_over((&mut data.rows, own), theirs, purpose, &folder, |row| {
                &mut row.source
            });
        }
        (
            SessionData::Transducer(data),
            SealedRows::Transducer(own),
            SessionData::Transducer(mut added),
            SealedRows::Transducer(mut sealed),
        ) => {
            if (&data.stimulus_unit, &data.response_unit)
                != (&added.stimulus_unit, &added.response_unit)
            {
                return Err(differs("units").field("transducer").into());
            }
            check_covariates(
                &renamed(&other.points_file),
                &data.covariates,
                &added.covariates,
            )?;
            if purpose == Purpose::Fit {
                let of: Series<TransducerRow> = |row| (&mut row.t_s, &mut row.replicate);
                place_series((&mut data.rows, own), (&mut added.rows, &mut sealed), of);
            }
            take_over(
                (&mut data.rows, own),
                (added.rows, sealed),
                purpose,
                &folder,
                |row| &mut row.source,
            );
        }
        (
            SessionData::Axis(data),
            SealedRows::Axis(own),
            SessionData::Axis(mut added),
            SealedRows::Axis(mut sealed),
        ) => {
            if purpose == Purpose::Fit {
                let of: Series<AxisRow> = |row| (&mut row.t_s, &mut row.cycle);
                place_series((&mut data.rows, own), (&mut added.rows, &mut sealed), of);
            }
            take_over(
                (&mut data.rows, own),
                (added.rows, sealed),
                purpose,
                &folder,
                |row| &mut row.source,
            );
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

/// Rows of another session in `folder`: to the fit, or behind the seal; what was sealed there stays
/// sealed.
fn take_over<R>(
    own: (&mut Vec<R>, &mut Sealed<R>),
    (mut rows, mut sealed): (Vec<R>, Sealed<R>),
    purpose: Purpose,
    folder: &str,
    source: fn(&mut R) -> &mut String,
) {
    fn rename<R>(row: &mut R, (folder, source): &(&str, fn(&mut R) -> &mut String)) {
        let name = source(row);
        *name = format!("{folder}/{name}");
    }
    let with = (folder, source);
    rows.iter_mut().for_each(|row| rename(row, &with));
    sealed.relabel(&with, rename);
    match purpose {
        Purpose::Fit => own.0.extend(rows),
        _ => own.1.extend(rows),
    }
    own.1.join(sealed);
}

/// Takes over the other session's trajectories; an id that means something else here is replaced by
/// a free one.
fn merge_trajectories(
    data: &mut WhiskerData,
    added: &mut Added,
    file: &str,
    warnings: &mut Vec<SessionWarning>,
) -> Result<(), InputError> {
    const SAME: f64 = 1e-6;
    for mut trajectory in std::mem::take(&mut added.data.trajectories) {
        let same = |t: &wcal_core::Trajectory| {
            (t.origin_mm - trajectory.origin_mm).norm() < SAME
                && (t.direction - trajectory.direction).norm() < SAME
        };
        match data.trajectory(trajectory.id) {
            Some(known) if same(known) => {}
            None => data.trajectories.push(trajectory),
            Some(_) => {
                let highest = data.trajectories.iter().map(|t| t.id).max().unwrap_or(0);
                // Ids of rows that are still to be renamed must not be hit either.
                let floor = added
                    .labels()
                    .filter_map(|l| l.trajectory)
                    .max()
                    .unwrap_or(0);
                let new = highest.max(floor).checked_add(1);
                let new = new.ok_or_else(|| {
                    InputError::new(file, "a free trajectory id", "none").field("trajectory.id")
                })?;
                let old = trajectory.id;
                let text = format!("trajectory {old} is another path here and is called {new}");
                warnings.push(SessionWarning::other(file, text));
                added.every_row(&(old, new), |row, (old, new)| {
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
fn merge_nominals(data: &WhiskerData, added: &mut Added) {
    let theirs = &added.data.fbg;
    let sensing = match (data.fbg.nominal_nm, theirs.nominal_nm) {
        (Some(here), Some(there)) => [there[0] - here[0], there[1] - here[1]],
        _ => [0.0; 2],
    };
    let reference = match (data.fbg.reference_nominal_nm, theirs.reference_nominal_nm) {
        (Some(here), Some(there)) => there - here,
        _ => 0.0,
    };
    added.every_row(&(sensing, reference), |row, (sensing, reference)| {
        row.shift_pm[0] += PM_PER_NM * sensing[0];
        row.shift_pm[1] += PM_PER_NM * sensing[1];
        row.reference_shift_pm = row.reference_shift_pm.map(|pm| pm + PM_PER_NM * reference);
    });
}
