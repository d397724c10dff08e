//! Tracks of a table without a network: along a known relative motion, or by the moments alone.

use super::object::{object_score, say_object_score};
use super::output::{FORMAT, TrackFiles, TrackRow};
use super::say_contact_uncertainty;
use super::{Outcome, TrackArgs, exit_code, moments_alone};
use crate::import::SweepFolder;
use crate::simulated::is_simulated;
use anyhow::{Context, Result, anyhow, bail};
use nalgebra::{Isometry3, Rotation3, Translation3, UnitQuaternion};
use rayon::prelude::*;
use serde_json::json;
use std::collections::BTreeMap;
use std::path::Path;
use std::process::ExitCode;
use wcal_calibration::{SensedRow, SensedTable, of_whisker};
use wcal_contact::groove_table::known_places;
use wcal_contact::known_groove::KnownGroove;
use wcal_contact::known_motion::{
    Episode, Located, Lost, Motion, MotionRow, Place, Posterior, Region, Settings, episodes, locate,
};
use wcal_contact::motion_row_tracker::answer;
use wcal_contact::motion_table::{LoggedMotion, has_motion, is_motion_column, read};
use wcal_contact::session_groove::{disagreement_sentence, found_summary, moment_field};
use wcal_contact::sliding_episodes::sliding_contacts;
use wcal_contact::trust::{TrustIssues, calibration_issues};
use wcal_core::observation::MomentAxes;
use wcal_core::stream::{Flags, StreamMoments};
use wcal_session::{SessionWarning, WarningKind};
use wcal_track::Tare;
use wcal_track::stream::BasePose;

/// Share of the noise from pose to pose by which the zero may be off in another record. An assumption, as for the filters.
const ZERO: f64 = 0.5;
/// Noise from pose to pose is one draw for poses nearer than this, mm: rows of a dense record are not that many poses. An assumption.
const SAME_POSE_MM: f64 = 1.0;

/// A reading with its motion.
struct MovedRow<'a> {
    row: &'a SensedRow,
    t_s: f64,
    motion: Result<Motion, Lost>,
}

/// What a row is tracked by.
struct TrackedRow<'a> {
    /// Number of the contact.
    contact: usize,
    place: &'a Place,
    regions: &'a [Region],
    /// Whether moments and motion disagree, or a sliding contact was assumed.
    flags: Flags,
}

/// Tracks the readings of a table along the motion of `--motion`, or of its own columns; by the moments alone where there is neither.
///
/// # Errors
/// Where table, motion or calibration cannot be used.
pub fn track(args: &TrackArgs, table: &Path) -> Result<ExitCode> {
    let [place] = &args.calibration[..] else {
        bail!("--calibration: expected one for a table, found {}", args.calibration.len());
    };
    check_accuracy(args)?;
    let place = Path::new(place);
    let (file, issues) = calibration_issues(place)?;
    let issues = TrustIssues::of(issues);
    for issue in issues.messages() {
        eprintln!("{}: {issue}", if args.force { "warning" } else { "refused" });
    }
    if !issues.none() && !args.force {
        return Ok(ExitCode::from(4));
    }
    say_contact_uncertainty("", &file);
    let whisker = file.whisker.as_ref().ok_or_else(|| {
        anyhow!(
            "{}: expected a calibration that says of which whisker it is, found an older one",
            place.display()
        )
    })?;
    let mut sensed =
        of_whisker(place, &file)?.sensed(table, whisker).with_context(|| place.display().to_string())?;
    tare(&mut sensed.rows, args.tare_s);
    let of_motion =
        |w: &SessionWarning| matches!(&w.kind, WarningKind::UnknownColumn(c) if is_motion_column(c));
    for warning in sensed.warnings.iter().filter(|w| !of_motion(w)) {
        eprintln!("warning: {warning}");
    }
    if args.motion.is_none() && !has_motion(table)? {
        return moments_alone::track(args, table, &sensed.rows, (&file, whisker, &issues));
    }
    let motion_file = args.motion.as_deref().unwrap_or(table);
    let LoggedMotion { log, posed } = read(motion_file, args.motion_offset_s)?;
    let SensedTable { rows, wire, changed, .. } = &sensed;
    let field = moment_field(wire, &MomentAxes::default())
        .with_changed(changed.iter().map(|w| moment_field(w, &MomentAxes::default())).collect());

    // Every reading with the motion at its time.
    let middle = field.free(0.5 * field.length_mm()).0;
    let moved = moved_rows(table, rows, |t_s| log.at(t_s, &middle))?;
    if let [Some(first), Some(last)] = [moved.first(), moved.last()] {
        log.check_clock([first.t_s, last.t_s]).with_context(|| motion_file.display().to_string())?;
    }
    for line in log.jumps() {
        eprintln!(
            "{}: line {line}: the motion jumps; contacts before and after are tracked separately",
            motion_file.display()
        );
    }
    let (mut known, pieces, index) = with_motion(&moved, args.motion_sd_mm);

    // Each contact by itself.
    let ranges = episodes(&field, &mut known, &pieces);
    let settings = Settings { clock_sd_s: args.motion_clock_sd_s, ..Settings::default() };
    let found = ranges.par_iter().map(|[from, to]| {
        let episode = Episode { rows: known[*from..*to].to_vec(), push: None };
        Ok(locate(&field, &episode, &settings)?)
    });
    let found = found.collect::<Result<Vec<Located>>>()?;
    let with_range: Vec<([usize; 2], &Located)> = ranges.iter().copied().zip(&found).collect();
    let sliding = sliding_contacts(whisker, rows, &known, &with_range)?;
    let slides = |n: usize| sliding[n].as_ref().filter(|s| s.supported());
    let regions: Vec<Vec<Region>> =
        found.iter().map(|f| f.posterior.as_ref().map_or_else(Vec::new, Posterior::regions)).collect();
    // A sweep over an object slides by its nature; elsewhere a wrong motion or calibration is as likely.
    let over_object = table.parent().and_then(SweepFolder::of).is_some();
    let sliding_flags = match over_object {
        true => Flags::SLIDING_ASSUMED,
        false => Flags::SLIDING_ASSUMED.with(Flags::MOTION_DISAGREES),
    };
    let mut tracked: BTreeMap<usize, TrackedRow<'_>> = BTreeMap::new();
    for (n, ([from, to], located)) in with_range.iter().enumerate() {
        let at = |k: usize| match slides(n) {
            Some(s) => {
                TrackedRow { contact: n, place: &s.places[k], regions: &s.regions[k], flags: sliding_flags }
            }
            None => TrackedRow {
                contact: n,
                place: &located.places[k],
                regions: &regions[n],
                flags: located.disagreement.map_or_else(Flags::default, |_| Flags::MOTION_DISAGREES),
            },
        };
        tracked.extend((0..to - from).map(|k| (index[from + k], at(k))));
    }
    let mut files = TrackFiles::create(&args.out, false)?;
    let mut groove = KnownGroove::new(known_places(table)?, whisker);
    let codes = issues.codes();
    let (mut outside, mut flagged, mut contacts_mm) = (0_u64, 0_u64, Vec::new());
    let mut lost: BTreeMap<&'static str, u64> = BTreeMap::new();
    for (k, m) in moved.iter().enumerate() {
        let (here, mut flags) = (tracked.get(&k), Flags::default());
        if let Err(why) = &m.motion {
            *lost.entry(why.name()).or_default() += 1;
            flags = flags.with(Flags::MOTION_LOST);
        }
        if let Some(row) = here {
            flags = flags.with(row.flags);
        }
        let answer = here.and_then(|row| answer(row.place));
        if let (Some(groove), Some(answer)) = (&mut groove, &answer) {
            groove.push(m.t_s, answer);
        }
        let s = &m.row.sensed;
        outside += u64::from(!s.valid);
        flagged += u64::from(!flags.none());
        let base = m.motion.as_ref().ok().filter(|_| posed).map(base_pose);
        // The wire's axis at the contact, a radius from the object.
        if let (Some(base), Some(at)) =
            (&base, here.filter(|row| row.flags != Flags::MOTION_DISAGREES).and_then(|r| r.place.place_mm))
        {
            contacts_mm.push(base.world_from_base.transform_point(&at.into()).coords);
        }
        files.row(&TrackRow {
            point: m.row.point,
            t_s: m.t_s,
            whisker: "",
            flags,
            doubts: &codes,
            moments: Some(StreamMoments { moment_nmm: s.moment_nmm, sd_nmm: m.row.sd_nmm(), valid: s.valid }),
            answer: answer.as_ref(),
            base_mm_s: m.motion.as_ref().ok().map(|m| -m.velocity_mm_s.z),
            base,
            touching: None,
            segment: here.map(|row| row.contact as u64),
            regions: here.map_or(&[], |row| row.regions),
            several: None,
        })?;
    }
    let simulated = is_simulated(table) || file.provenance.simulated;
    if simulated {
        eprintln!("track: SIMULATED: the readings or the calibration are not measured");
    }
    let disagreements: Vec<String> = found
        .iter()
        .enumerate()
        .filter(|(n, _)| slides(*n).is_none())
        .filter_map(|(n, f)| Some(format!("contact {n}: {}", disagreement_sentence(f)?)))
        .collect();
    let contacts: Vec<_> = with_range
        .iter()
        .enumerate()
        .map(|(n, ([from, to], f))| {
            let mut summary = found_summary(f);
            summary["contact"] = if slides(n).is_some() { "sliding" } else { "fixed" }.into();
            if slides(n).is_some() {
                summary["disagreement"] = serde_json::Value::Null;
                summary["regions"] = serde_json::Value::Null;
            }
            summary["sliding"] = sliding[n].as_ref().map_or(serde_json::Value::Null, |s| {
                json!({"log_evidence": s.evidence, "reversed_log_evidence": s.reversed_evidence, "predicted": s.predicted})
            });
            summary["from_s"] = known[*from].t_s.into();
            summary["to_s"] = known[to - 1].t_s.into();
            summary["readings"] = (to - from).into();
            summary
        })
        .collect();
    let lost_rows: u64 = lost.values().sum();
    let on_object = object_score(table, &contacts_mm)?;
    let summary = json!({
        "format": FORMAT, "source": table, "simulated": simulated, "out": args.out, "rows": rows.len(), "flagged_rows": flagged,
        "unusable_rows": lost_rows, "outside_valid_region": outside, "doubts": issues.messages(), "method": "known-motion", "tare_s": args.tare_s,
        "calibration_sha256": file.content_sha256, "place": "axis of the wire at the contact, base frame",
        "motion": {"file": motion_file, "span_s": log.span_s(), "offset_s": args.motion_offset_s, "lost_rows": lost,
            "jump_lines": log.jumps().collect::<Vec<_>>()},
        "contacts": contacts, "object": on_object, "known_groove": groove.as_ref().and_then(KnownGroove::summary),
    });
    files.finish(&summary, args.json)?;
    if outside > 0 {
        eprintln!(
            "{outside} of {} readings lie outside the valid region; marked in outside_valid_region",
            rows.len()
        );
    }
    if lost_rows > 0 {
        let why: Vec<String> = lost.iter().map(|(name, n)| format!("{name} {n}")).collect();
        eprintln!(
            "the motion of {lost_rows} of {} readings is not known ({}); marked motion-lost in status",
            rows.len(),
            why.join(", ")
        );
    }
    for (n, s) in (0..sliding.len()).filter_map(|n| Some((n, slides(n)?))) {
        eprintln!(
            "contact {n}: no fixed point of the object explains the moments, a contact that slides does (log likelihood ratio {:.0} to the \
             reversed motion), as it does where motion or calibration are wrong; marked sliding-assumed in status",
            s.evidence - s.reversed_evidence
        );
    }
    for said in &disagreements {
        eprintln!("{said}; marked motion-disagrees in status");
    }
    say_object_score(on_object.as_ref());
    if ranges.is_empty() {
        eprintln!("no contact: no reading is loaded beyond its noise where the motion is known");
    }
    if let Some(said) = groove.as_ref().and_then(KnownGroove::message) {
        eprintln!("{said}");
    }
    let misstated = groove.as_ref().is_some_and(KnownGroove::misstated);
    Ok(exit_code(
        args,
        Outcome {
            outside: outside > 0,
            misstated,
            lost: lost_rows > 0,
            untrained: !disagreements.is_empty() || (0..sliding.len()).any(|n| slides(n).is_some()),
        },
    ))
}

/// Takes the zero of `--tare-s` off the moments, in the order of the table.
fn tare(rows: &mut [SensedRow], span_s: f64) {
    let mut tare = Tare::new(span_s);
    for row in rows {
        let Some(t_s) = row.t_s else { continue };
        row.sensed.moment_nmm = tare.zeroed(t_s, row.sensed.moment_nmm);
    }
}

/// Checks what the arguments say of the motion's accuracy, and of the time of the zero.
///
/// # Errors
/// Negative numbers and those that are not finite.
pub fn check_accuracy(args: &TrackArgs) -> Result<()> {
    for (option, value) in [
        ("--motion-sd-mm", args.motion_sd_mm),
        ("--motion-clock-sd-s", args.motion_clock_sd_s),
        ("--tare-s", args.tare_s),
    ] {
        if !(value.is_finite() && value >= 0.0) {
            bail!("{option}: expected 0 or more, found {value}");
        }
    }
    Ok(())
}

/// Readings in order of time with their motion.
fn moved_rows<'a>(
    table: &Path,
    rows: &'a [SensedRow],
    at: impl Fn(f64) -> Result<Motion, Lost>,
) -> Result<Vec<MovedRow<'a>>> {
    let mut last_s = f64::NEG_INFINITY;
    let mut moved = Vec::with_capacity(rows.len());
    for row in rows {
        let place = || format!("{}: line {}: t_s", table.display(), row.line);
        let Some(t_s) = row.t_s else { bail!("{}: expected a time, found none", place()) };
        if !(t_s > last_s) {
            bail!("{}: expected a later time than {last_s}, found {t_s}", place());
        }
        last_s = t_s;
        moved.push(MovedRow { row, t_s, motion: at(t_s) });
    }
    Ok(moved)
}

/// The readings whose motion is known, the piece of the motion that each is in, and its index among all.
fn with_motion(moved: &[MovedRow<'_>], moved_sd_mm: f64) -> (Vec<MotionRow>, Vec<u32>, Vec<usize>) {
    let (mut known, mut pieces, mut index) = (Vec::new(), Vec::new(), Vec::new());
    for (k, m) in moved.iter().enumerate() {
        let Ok(motion) = &m.motion else { continue };
        let s = &m.row.sensed;
        // A zero of its own, by the noise: two more unknowns that all rows share.
        let zero = s.noise_nmm2.cholesky().map_or_else(Default::default, |c| c.l() * ZERO);
        let mut shared_nmm = s.shared_nmm.clone();
        shared_nmm.extend(zero.column_iter().map(|c| [c[0], c[1]]));
        known.push(MotionRow {
            t_s: m.t_s,
            moment_nmm: s.moment_nmm,
            noise_nmm2: s.noise_nmm2,
            shared_way_mm: Vec::new(),
            shared_nmm,
            moved_mm: motion.moved_mm,
            turn: motion.turn,
            velocity_mm_s: motion.velocity_mm_s,
            moved_sd_mm,
            free: false,
            visit: 0,
        });
        pieces.push(motion.piece);
        index.push(k);
    }
    // Rows of one pose have one noise from pose to pose: each counts for its share.
    let poses: Vec<f64> = (0..known.len()).map(|k| same_pose(&known, k)).collect();
    for (row, n) in known.iter_mut().zip(poses) {
        row.noise_nmm2 *= n;
    }
    (known, pieces, index)
}

/// Rows around one that are of its pose.
fn same_pose(rows: &[MotionRow], k: usize) -> f64 {
    let near = |r: &&MotionRow| (r.moved_mm - rows[k].moved_mm).norm() < 0.5 * SAME_POSE_MM;
    let (before, after) = rows.split_at(k);
    (before.iter().rev().take_while(near).count() + after.iter().take_while(near).count()).max(1) as f64
}

/// Pose of the base where the object's frame is the world's.
fn base_pose(motion: &Motion) -> BasePose {
    let back: Rotation3<f64> = motion.turn.inverse();
    let place = Translation3::from(back * -motion.moved_mm);
    let world_from_base = Isometry3::from_parts(place, UnitQuaternion::from_rotation_matrix(&back));
    BasePose { world_from_base, velocity_mm_s: Some(-motion.velocity_mm_s) }
}
