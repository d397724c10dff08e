//! Tracks of a session whose groove moves in a known way: no network.

use super::output::{FORMAT, TrackFiles, TrackRow};
use super::say_contact_uncertainty;
use super::{Outcome, TrackArgs, exit_code};
use anyhow::{Result, anyhow, bail};
use nalgebra::Vector3;
use serde_json::json;
use std::path::Path;
use std::process::ExitCode;
use wcal_calibration::{TrustIssue, of_whisker};
use wcal_contact::motion_row_tracker::answer;
use wcal_contact::session_groove::{
    groove_sentence, groove_tracking, misstated, track as locate, without_groove,
};
use wcal_contact::trust::{TrustIssues, calibration_issues};
use wcal_core::stream::{Flags, StreamMoments};
use wcal_core::{SessionData, WhiskerRow};
use wcal_trace::whisker::WhiskerSystem;

/// Tracks the readings of a session's points table.
///
/// # Errors
/// Where session or calibration cannot be used, or the session does not say how the groove moves.
pub fn track(args: &TrackArgs, folder: &Path) -> Result<ExitCode> {
    // Each mounting has the zero that its rest readings and the calibration give.
    if args.tare_s != 0.0 {
        bail!(
            "--tare-s: expected a table or a stream, found the session folder {}: its zero is that of its rest readings",
            folder.display()
        );
    }
    let session = wcal_session::load(folder)?;
    let SessionData::Whisker(data) = &session.data else {
        bail!("{}: expected a whisker session, found another kind", folder.display());
    };
    let [place] = &args.calibration[..] else {
        bail!("--calibration: expected one for a session, found {}", args.calibration.len());
    };
    let place = Path::new(place);
    let (file, mut issues) = calibration_issues(place)?;
    let differs = file.whisker.as_ref().and_then(|w| w.difference(&data.whisker));
    issues.extend(differs.map(TrustIssue::OtherSession));
    let issues = TrustIssues::of(issues);
    for issue in issues.messages() {
        eprintln!("{}: {issue}", if args.force { "warning" } else { "refused" });
    }
    if !issues.none() && !args.force {
        return Ok(ExitCode::from(4));
    }
    say_contact_uncertainty("", &file);
    // From here on nobody knows where the groove is.
    let blind = without_groove(data)?;
    let rows: Vec<&WhiskerRow> = blind.rows.iter().collect();
    let system = WhiskerSystem::new(&blind, &rows)?;
    let motion = of_whisker(place, &file)?
        .groove_motion(&system)
        .ok_or_else(|| anyhow!("{}: the calibration gives no moments for this session", place.display()))?;
    let readings = motion.readings.clone();
    let tracked = locate(&system, motion, |_| true)?;
    let places = tracked.places();
    let regions = tracked.regions();
    let codes = issues.codes();
    let mut files = TrackFiles::create(&args.out, false)?;
    let (mut outside, mut flagged) = (0_u64, 0_u64);
    for r in &readings {
        let row = system.row(r.reading);
        let (found, disagreement) = places[&r.reading].clone();
        let flags = disagreement.map_or_else(Flags::default, |_| Flags::MOTION_DISAGREES);
        outside += u64::from(!r.valid);
        flagged += u64::from(!flags.none());
        let sd = |c: usize| {
            let shared: f64 = r.shared_nmm.iter().map(|h| h[c] * h[c]).sum();
            (r.noise_nmm2[(c, c)] + shared).sqrt()
        };
        files.row(&TrackRow {
            point: row.point,
            t_s: r.t_s,
            whisker: "",
            flags,
            doubts: &codes,
            moments: Some(StreamMoments { moment_nmm: r.moment_nmm, sd_nmm: [sd(0), sd(1)], valid: r.valid }),
            answer: answer(&found).as_ref(),
            base_mm_s: None,
            base: None,
            touching: None,
            segment: None,
            regions: regions.get(&r.line).map_or(&[], Vec::as_slice),
            several: None,
        })?;
    }
    // The groove's place enters here, after every answer.
    let known = |reading: usize| -> Option<Vector3<f64>> { data.rows[system.path.rows[reading]].groove_mm };
    let groove = groove_tracking(&tracked.compared(&system, known)?, "fit");
    let simulated = session.simulated || file.provenance.simulated;
    if simulated {
        eprintln!("track: SIMULATED: the readings or the calibration are not measured");
    }
    let summary = json!({
        "format": FORMAT, "source": folder, "simulated": simulated, "out": args.out, "rows": readings.len(), "flagged_rows": flagged,
        "unusable_rows": 0, "outside_valid_region": outside, "doubts": issues.messages(), "method": "known-motion",
        "calibration_sha256": file.content_sha256, "place": "axis of the wire at the contact, base frame",
        "trajectories": tracked.summary(), "groove_tracking": groove,
    });
    files.finish(&summary, args.json)?;
    if outside > 0 {
        eprintln!(
            "{outside} of {} readings lie outside the valid region; marked in outside_valid_region",
            readings.len()
        );
    }
    let disagreements = tracked.disagreements();
    for said in &disagreements {
        eprintln!("{said}; marked motion-disagrees in status");
    }
    if let Some(groove) = &groove {
        eprintln!("{}", groove_sentence(groove));
    }
    let misstated = groove.as_ref().is_some_and(misstated);
    Ok(exit_code(
        args,
        Outcome { outside: outside > 0, misstated, lost: false, untrained: !disagreements.is_empty() },
    ))
}
