//! The JSON documents that this program writes, by their types.

use crate::json_reference::{hold, schema};
use crate::{calibrate, check, import, live_page, predict, reduce, stage_sweep, verify};
use std::path::Path;
use wcal_calibration::CalibrationModel;
use wcal_core::map_document::MapDocument;
use wcal_core::shapes_document::ShapesDocument;
use wcal_core::verify_document::VerifyDocument;
use wcal_vision::calibrate::document::StereoDocument;

#[test]
fn schemas_and_reference_are_made_from_the_types() {
    let own = vec![
        schema::<VerifyDocument>("verify", "verify.json"),
        schema::<wcal_core::CalibrationFile<CalibrationModel>>("calibration", "calibration.json"),
        schema::<MapDocument>("fit-gpr", "fit-gpr.json"),
        schema::<wcal_session::LedgerFile>("unsealed", "unsealed.json"),
        schema::<wcal_acquisition::run_file::RunFile>("run", "run.json"),
        schema::<StereoDocument>("stereo", "stereo.json"),
        schema::<ShapesDocument>("shapes", "shapes.json"),
        schema::<wcal_track::track_document::TrackDocument>("track", "track.json"),
        schema::<wcal_drivers::bench::Addresses>("bench", "wcal virtual-bench"),
        schema::<import::ImportDocument<'_>>("import", "wcal import --json"),
        schema::<verify::dry_run::CheckDocument<'_>>("check", "wcal verify --dry-run --json"),
        schema::<check::CalibrationCheckDocument<'_>>("calibration-check", "wcal check --json"),
        schema::<wcal_calibration::CalibrationHistory>("history", "wcal check --history --json"),
        schema::<calibrate::CalibrateDocument>("calibrate", "calibrate.json"),
        schema::<predict::PredictionDocument<'_>>("predict", "wcal predict --json"),
        schema::<stage_sweep::PathDocument>("path", "wcal stage-sweep --dry-run --json"),
        schema::<stage_sweep::SweepDocument<'_>>("sweep", "wcal stage-sweep --json"),
        schema::<live_page::LiveState>("live", "state.json of --live-page"),
        schema::<reduce::ReductionDocument<'_>>("reduction", "wcal reduce --json"),
    ];
    hold(Path::new(env!("CARGO_MANIFEST_DIR")), own);
}
