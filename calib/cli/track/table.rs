//! Tracks of a table or of a session, whatever locates the contacts.

use super::arguments::{ACCURACY, TrackArgs};
use super::object::{off_object, passed_object, said_of_object};
use super::output;
use super::recorded_motion::logged_motion;
use crate::progress::Progress;
use crate::simulated::is_simulated;
use anyhow::{Context, Result, anyhow, bail};
use std::path::Path;
use std::process::ExitCode;
use std::str::FromStr;
use wcal_core::{SessionData, WhiskerData, WireFrame};
use wcal_session::motion_table::{LoggedMotion, has_motion, read};
use wcal_session::sweep_session::SweepSession;
use wcal_track::TrackError;
use wcal_track::calibrated_wire::CalibratedWire;
use wcal_track::estimator::Estimator;
use wcal_track::known_groove::KnownGroove;
use wcal_track::reading::Reading;
use wcal_track::regimes::{ANY_OBJECT, SWEPT_OBJECT};
use wcal_track::session_groove::{SessionGroove, without_groove};
use wcal_track::sliding::FrictionPrior;
use wcal_track::table_source::TableSource;
use wcal_track::track::Input;
use wcal_track::track_document::{
    AXIS_OF_WIRE, LogDocument, TRACK_FORMAT, TableDocument, TrackDocument, TrackSource,
};
use wcal_track::tracker::ContactTracker;
use wcal_track::trust::WhiskerModel;
use wcal_track::whisker_track::{Outcome, WhiskerTrack};
use wcal_track::zero::{FreeStart, beginning};
use wcal_verify::whisker::WhiskerSystem;

/// Readings and what locates their contacts.
pub(crate) struct Prepared<'a> {
    readings: Vec<Reading>,
    frame: WireFrame,
    estimator: Box<dyn Estimator + 'a>,
    /// Contacts have intervals: each reading knows of those before it.
    followed: bool,
    /// Time at the beginning whose mean moments are the zero, s.
    tare_s: f64,
    groove: Option<KnownGroove>,
    log: Option<LogDocument>,
    simulated: bool,
}

/// A whisker session that is tracked along the known way of its groove.
pub(crate) struct TrackedFolder {
    data: WhiskerData,
    simulated: bool,
    /// Its whisker.
    pub whisker: wcal_core::WhiskerSpec,
}

/// Loads a session.
///
/// # Errors
/// Where it is none of a whisker, or the zero would be taken off twice.
pub(crate) fn load_session(args: &TrackArgs, folder: &Path) -> Result<TrackedFolder> {
    // Each mounting has the zero that its rest readings and the calibration give.
    if args.tare_s.is_some_and(|s| s != 0.0) {
        bail!(
            "--tare-s: expected a table or a stream, found the session folder {}: its zero is that of its rest readings",
            folder.display()
        );
    }
    let session = wcal_session::load(folder)?;
    let kind = session.data.kind();
    let SessionData::Whisker(data) = session.data else {
        bail!(
            "{}: expected a session of kind whisker, found {kind}; wcal predict applies its calibration",
            folder.display()
        );
    };
    let whisker = data.whisker.clone();
    Ok(TrackedFolder {
        data,
        simulated: session.simulated,
        whisker,
    })
}

/// The readings of a session; the groove's place is looked at after every answer.
///
/// # Errors
/// Where the session does not say how the groove moves, or the calibration gives no moments for it.
pub(crate) fn of_session<'a>(
    session: &TrackedFolder,
    loaded: &'a WhiskerModel<'a>,
) -> Result<Prepared<'a>> {
    // From here on nobody knows where the groove is.
    let blind = without_groove(&session.data)?;
    let system = WhiskerSystem::new(&blind, &[])?;
    let motion = loaded
        .calibration()?
        .groove_motion(&system)
        .ok_or_else(|| {
            anyhow!(
                "{}: the calibration gives no moments for this session",
                loaded.place.display()
            )
        })?;
    let known = |reading: usize| session.data.rows[system.path.rows[reading]].groove_mm;
    let (readings, estimator) = SessionGroove::new(&system, motion, known)?;
    Ok(Prepared {
        readings,
        frame: estimator.frame.clone(),
        estimator: Box::new(estimator),
        followed: false,
        tare_s: 0.0,
        groove: None,
        log: None,
        simulated: session.simulated,
    })
}

/// The readings of a table: by the network where there is one, else along the motion of `--motion`
/// or of the table's own columns, else by the moments alone.
///
/// # Errors
/// Where table, motion or calibration cannot be used.
pub(crate) fn of_table<'a>(
    args: &TrackArgs,
    path: &Path,
    loaded: &'a WhiskerModel<'a>,
) -> Result<Prepared<'a>> {
    let (frame, whisker) = (loaded.frame()?, loaded.whisker()?);
    let noise = loaded.file.noise.unwrap_or_default();
    let zero_known = loaded.calibration()?.knows_zero();
    let source = TableSource::read(path, (loaded.calibration()?, noise), &whisker)
        .with_context(|| loaded.place.display().to_string())?;
    for warning in &source.warnings {
        eprintln!("warning: {warning}");
    }
    let groove = KnownGroove::new(source.places.clone(), &whisker);
    let simulated = is_simulated(path);
    let base_from_wire = frame.rotation().inverse();
    let prepared =
        move |readings, estimator: Box<dyn Estimator + 'a>, (followed, tare_s), log| Prepared {
            readings,
            frame,
            estimator,
            followed,
            tare_s,
            groove,
            log,
            simulated,
        };
    if let Some(network) = loaded.estimator(args.sweep)? {
        let poses = has_motion(path)?.then(|| read(path)).transpose()?;
        return Ok(prepared(
            source.past_object(poses.as_ref(), args.base_mm_s),
            Box::new(network),
            (true, args.tare_s.unwrap_or(0.0)),
            None,
        ));
    }
    // A sweep passes an object: the contact slides over it.
    let passed = path.parent().map(SweepSession::of).transpose()?.flatten();
    let of_object = passed.as_ref().and_then(|sweep| sweep.friction.as_deref());
    let of_object = of_object.map(FrictionPrior::from_str).transpose();
    let of_object =
        of_object.map_err(|why| anyhow!("{}: object.friction: {why}", path.display()))?;
    let wire = CalibratedWire::new(&source.wire, &source.changed, whisker.diameter_mm)
        .with_tolerance(args.diameter_sd)
        .with_friction(args.friction.or(of_object).unwrap_or_default());
    // Without any motion, the moments alone must locate the contact.
    if args.motion.is_none() && !has_motion(path)? {
        let mut readings = source.alone();
        let tare_s = zero_span_s(args, path, &mut readings, zero_known)?;
        return Ok(prepared(
            readings,
            Box::new(ContactTracker::of_stream(wire, ACCURACY, ANY_OBJECT)),
            (false, tare_s),
            None,
        ));
    }
    let file = args.motion.as_deref().unwrap_or(path);
    let logged = logged_motion(file, || Ok(source.span_s()))?;
    let mut readings = source.along(&logged, &(base_from_wire * wire.middle_mm()));
    let tare_s = zero_span_s(args, path, &mut readings, zero_known)?;
    let touched = if passed.is_some() {
        SWEPT_OBJECT
    } else {
        ANY_OBJECT
    };
    let estimator = ContactTracker::of_record(wire, ACCURACY, touched);
    Ok(prepared(
        readings,
        Box::new(estimator),
        (false, tare_s),
        Some(log_document(file, &logged)),
    ))
}

/// A zero that nobody knows.
pub(crate) const NO_ZERO: &str = "expected free readings at the beginning, or their time by --tare-s: the calibration does not know the zero of the \
     free wire (fit-gpr left out its readings at rest); found neither";

/// Time whose mean moments are the zero of a table, s: the one that is stated, else its free
/// beginning, which says what the readings' own noise is, too; what the poses of the calibration
/// scatter by beyond it is an error that they share.
///
/// # Errors
/// Where there is none, and the calibration does not know the zero of the free wire.
fn zero_span_s(
    args: &TrackArgs,
    path: &Path,
    readings: &mut [Reading],
    zero_known: bool,
) -> Result<f64> {
    let begins = beginning(readings, zero_known);
    if let FreeStart::Free {
        noise_nmm2,
        inefficiency,
        ..
    } = begins
    {
        for m in readings.iter_mut().filter_map(|r| r.moments.as_mut()) {
            (m.own_nmm2, m.inefficiency) = (Some(noise_nmm2), inefficiency);
        }
    }
    if let Some(span_s) = args.tare_s {
        return Ok(span_s);
    }
    Ok(match begins {
        FreeStart::Free {
            span_s,
            readings: free,
            ..
        } => {
            eprintln!(
                "{}: zero: the mean of the {free} free readings at its beginning",
                path.display()
            );
            span_s
        }
        FreeStart::Loaded(nmm) => {
            eprintln!(
                "warning: {}: it begins at {nmm:.3} N mm, which no free wire has by this calibration: in contact, or another zero (--tare-s)",
                path.display()
            );
            0.0
        }
        FreeStart::Unknown if !zero_known => bail!("{}: {NO_ZERO}", path.display()),
        FreeStart::Unknown => 0.0,
    })
}

fn log_document(file: &Path, logged: &LoggedMotion) -> LogDocument {
    LogDocument {
        file: file.to_owned(),
        span_s: logged.log.span_s(),
        lost_rows: Default::default(),
        jump_lines: logged.log.jumps().collect(),
    }
}

/// Tracks readings: rows as they settle, then the summary.
///
/// # Errors
/// Where a reading cannot be used, or the disk takes no more.
pub(crate) fn track(
    args: &TrackArgs,
    place: &Path,
    of: Prepared<'_>,
    loaded: &WhiskerModel<'_>,
) -> Result<ExitCode> {
    // A place of the wire's axis lies its radius from the surface.
    let on_axis = of.estimator.findings().document.place == Some(AXIS_OF_WIRE);
    let radius_mm = if on_axis {
        0.5 * loaded.whisker().map_or(0.0, |w| w.diameter_mm)
    } else {
        0.0
    };
    let mut track = WhiskerTrack::new(
        loaded.into(),
        (of.frame, of.estimator),
        of.tare_s,
        of.followed,
    );
    track.groove = of.groove;
    track.object = passed_object(place, radius_mm)?;
    crate::predict::record_if_sealed(place, &args.out)?;
    let mut files = output::create(&args.out)?;
    let mut unusable = of.readings.iter().filter(|r| r.moments.is_none()).count() as u64;
    let source = of
        .readings
        .into_iter()
        .map(|r| Ok::<_, TrackError>(Input::Reading(0, Box::new(r))));
    let progress = Progress::new("track");
    progress.stage("contacts");
    wcal_track::track::track(source, std::slice::from_mut(&mut track), &mut files)?;
    drop(progress);

    let found = track.findings();
    let (mut whisker, mut log) = (found.document, of.log);
    if let (Some(log), Some(lost)) = (&mut log, whisker.estimator.lost_rows.take()) {
        unusable += lost.values().sum::<u64>();
        log.lost_rows = lost;
    }
    let on_object = track.object_score();
    let document = TrackDocument {
        format: TRACK_FORMAT,
        source: TrackSource::File(place.to_owned()),
        simulated: of.simulated || loaded.file.provenance.simulated,
        out: args.out.clone(),
        table: Some(TableDocument {
            lag_s: 0.0,
            tare_s: found.groove.is_none().then_some(of.tare_s),
            unusable_rows: unusable,
            motion: log,
            object: on_object.clone(),
            groove_tracking: found.groove,
            whisker,
        }),
        stream: None,
    };
    let mut said = said_of_object(on_object.as_ref());
    said.extend(found.messages);
    let against = off_object(on_object.as_ref());
    let outcome = Outcome {
        lost: unusable > 0,
        doubt: against.is_some(),
        ..Outcome::default()
    };
    said.extend(against.map(|said| format!("warning: {said}")));
    super::arguments::conclude(args, files, &document, (said, found.outcome.and(outcome)))
}
