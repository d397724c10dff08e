//! Tracks of a table of whose motion nothing is known: an arc of the wire for every loaded reading.

use super::output::{FORMAT, TrackFiles, TrackRow};
use super::{Outcome, TrackArgs, exit_code};
use crate::simulated::is_simulated;
use anyhow::{Context, Result};
use serde_json::json;
use std::path::Path;
use std::process::ExitCode;
use wcal_calibration::{CalibrationModel, SensedRow};
use wcal_contact::arc::{arclength_regions, moments_alone};
use wcal_contact::groove_table::known_places;
use wcal_contact::known_groove::KnownGroove;
use wcal_contact::trust::TrustIssues;
use wcal_core::stream::{Flags, StreamMoments};
use wcal_core::{CalibrationFile, WhiskerSpec};
use wcal_track::network::Prediction;
use wcal_track::{InverseGrid, StaticInverse};

/// A wire that is loaded by so many standard deviations touches something.
const LOADED_SDS: f64 = 4.0;

/// Writes what the moments alone tell; every loaded row says that its motion is not known.
///
/// # Errors
/// Where the wire cannot be bent or a file cannot be written.
pub fn track(
    args: &TrackArgs,
    table: &Path,
    rows: &[SensedRow],
    (file, whisker, issues): (&CalibrationFile<CalibrationModel>, &WhiskerSpec, &TrustIssues),
) -> Result<ExitCode> {
    let inverse = StaticInverse::new(whisker, InverseGrid::coarse())?;
    let mut groove = KnownGroove::new(known_places(table)?, whisker);
    let mut files = TrackFiles::create(&args.out, false)?;
    let codes = issues.codes();
    let (mut outside, mut loaded) = (0_u64, 0_u64);
    for row in rows {
        let t_s = row.t_s.with_context(|| {
            format!("{}: line {}: t_s: expected a time, found none", table.display(), row.line)
        })?;
        let (s, sd_nmm) = (&row.sensed, row.sd_nmm());
        let touches = s.moment_nmm[0].hypot(s.moment_nmm[1]) > LOADED_SDS * sd_nmm[0].hypot(sd_nmm[1]);
        let unknown = Prediction::unknown();
        let answer = touches.then(|| moments_alone(&inverse, s.moment_nmm, sd_nmm, &unknown));
        let flags = if touches { Flags::MOTION_LOST } else { Flags::default() };
        if let (Some(groove), Some(answer)) = (&mut groove, &answer) {
            groove.push(t_s, answer);
        }
        outside += u64::from(!s.valid);
        loaded += u64::from(touches);
        let regions =
            answer.as_ref().map_or_else(Vec::new, |a| arclength_regions(&inverse.nodes, &a.weights));
        files.row(&TrackRow {
            point: row.point,
            t_s,
            whisker: "",
            flags,
            doubts: &codes,
            moments: Some(StreamMoments { moment_nmm: s.moment_nmm, sd_nmm, valid: s.valid }),
            answer: answer.as_ref(),
            base_mm_s: None,
            base: None,
            touching: None,
            segment: None,
            regions: &regions,
            several: None,
        })?;
    }
    let simulated = is_simulated(table) || file.provenance.simulated;
    if simulated {
        eprintln!("track: SIMULATED: the readings or the calibration are not measured");
    }
    let summary = json!({
        "format": FORMAT, "source": table, "simulated": simulated, "out": args.out, "rows": rows.len(), "flagged_rows": loaded,
        "unusable_rows": 0, "outside_valid_region": outside, "doubts": issues.messages(), "method": "moments-alone", "tare_s": args.tare_s,
        "calibration_sha256": file.content_sha256, "place": "point of the object, base frame",
        "known_groove": groove.as_ref().and_then(KnownGroove::summary),
    });
    files.finish(&summary, args.json)?;
    eprintln!(
        "{loaded} of {} readings are loaded and no motion is known (--motion, --model): each has the arc that its moments allow, with its \
         regions in arclength_regions95; marked motion-lost in status",
        rows.len()
    );
    if let Some(said) = groove.as_ref().and_then(KnownGroove::message) {
        eprintln!("{said}");
    }
    let misstated = groove.as_ref().is_some_and(KnownGroove::misstated);
    Ok(exit_code(args, Outcome { outside: outside > 0, misstated, lost: loaded > 0, untrained: false }))
}
