//! The traced whisker model: sensitivity and accepted effects. Memory effects run over a table's
//! own history.

use crate::apply::{
    AppliedTable, Calibration, SensedRow, SensedTable, SessionSystem, WhiskerCalibration, no_wire,
};
use crate::error::CalibrationError;
use std::path::Path;
use wcal_core::stream::MomentStream;
use wcal_core::{CalibrationNoise, FbgSpec, WhiskerRow, WhiskerSpec};
use wcal_session::{SessionWarning, load_table};
use wcal_verify::verify::HeldOut;
use wcal_verify::whisker::groove_motion::{self, AcceptedWire, GrooveMotion};
use wcal_verify::whisker::path::WhiskerPath;
use wcal_verify::whisker::{PhysicalModel, PhysicalStream, WhiskerSystem, judgement};

const HEADER: &str = "point,fbg_1_pm,fbg_2_pm,moment_1_nmm,moment_2_nmm,moment_1_sd_nmm,moment_2_sd_nmm,outside_valid_region\n";

impl Calibration for PhysicalModel {
    fn name(&self) -> &str {
        "physical"
    }

    fn session_kind(&self) -> &str {
        "whisker"
    }

    fn check(&self) -> Result<(), CalibrationError> {
        Ok(PhysicalModel::check(self)?)
    }

    fn apply(&self, table: &Path) -> Result<AppliedTable, CalibrationError> {
        let History {
            rows,
            path,
            warnings,
        } = history(self, table)?;
        let inferred = self.infer(&path, None);
        let mut csv = String::from(HEADER);
        // Memory runs in order of time; the table keeps its own order.
        for i in in_order(&path) {
            let (point, m) = (rows[path.rows[i]].point, &inferred[i]);
            let ([a, b], outside) = (path.readings[i].shift_pm, u8::from(!m.valid));
            let ([m1, m2], [sd1, sd2]) = (m.moment_nmm, m.sd_nmm);
            csv += &format!("{point},{a:.4},{b:.4},{m1:.6},{m2:.6},{sd1:.6},{sd2:.6},{outside}\n");
        }
        let (outside, rows) = (inferred.iter().filter(|m| !m.valid).count(), rows.len());
        let outside = (outside > 0).then(|| {
            format!("{outside} of {rows} readings ask for moments beyond those that were fitted")
        });
        Ok(AppliedTable {
            csv,
            rows,
            outside,
            warnings,
            remarks: Vec::new(),
        })
    }

    fn judged_readings(
        &self,
        session: SessionSystem<'_>,
        only_sealed: bool,
    ) -> Result<Option<Vec<HeldOut>>, CalibrationError> {
        Ok(judgement::of_model(
            session.as_whisker()?,
            self,
            only_sealed,
        ))
    }

    fn whisker(&self) -> Option<&dyn WhiskerCalibration> {
        Some(self)
    }
}

impl WhiskerCalibration for PhysicalModel {
    fn fbg(&self) -> &FbgSpec {
        &self.fbg
    }

    /// Through the direction that the gratings see least.
    fn noise_sd_nmm(&self) -> f64 {
        self.noise_sd_pm / self.sensitivity().singular_values().min().max(1e-9)
    }

    /// K^-1 s, s the noise of the shifts; what is correlated in time is the drift.
    fn noise(&self) -> CalibrationNoise {
        let inverse = self.sensitivity().try_inverse();
        let through = |sd_pm: f64| {
            let nmm2 = inverse.map(|k| k * k.transpose() * sd_pm.powi(2))?;
            Some([0, 1].map(|c| nmm2[(c, c)].max(0.0).sqrt()))
        };
        CalibrationNoise {
            reading_sd_nmm: through(
                self.correlated_noise
                    .map_or(self.noise_sd_pm, |c| c.own_sd_pm),
            ),
            drift_sd_nmm: self.correlated_noise.and_then(|c| through(c.sd_pm)),
            misfit_sd_nmm: None,
        }
    }

    fn sensed(&self, table: &Path) -> Result<SensedTable, CalibrationError> {
        let History {
            rows,
            path,
            warnings,
        } = history(self, table)?;
        let readings = self.calibrated(&path).ok_or_else(singular)?;
        let one = |i: usize| SensedRow::new(&rows[path.rows[i]], readings[i].clone());
        Ok(SensedTable {
            rows: in_order(&path).into_iter().map(one).collect(),
            warnings,
        })
    }

    fn wire(
        &self,
        whisker: &WhiskerSpec,
    ) -> Result<(AcceptedWire, Vec<AcceptedWire>), CalibrationError> {
        AcceptedWire::accepted(whisker, self).ok_or_else(no_wire)
    }

    fn groove_motion(&self, system: &WhiskerSystem) -> Option<GrooveMotion> {
        groove_motion::of_model(system, self)
    }

    fn stream(&self) -> Result<Box<dyn MomentStream>, CalibrationError> {
        Ok(Box::new(
            PhysicalStream::new(self.clone()).ok_or_else(singular)?,
        ))
    }
}

fn singular() -> CalibrationError {
    let detail = "expected a sensitivity that can be inverted";
    CalibrationError::content(Path::new("calibration"), detail)
}

/// A table's readings in order of time.
struct History {
    rows: Vec<WhiskerRow>,
    path: WhiskerPath,
    warnings: Vec<SessionWarning>,
}

fn history(model: &PhysicalModel, place: &Path) -> Result<History, CalibrationError> {
    let table = load_table(place, &model.fbg)?;
    // New readings belong to the last seating that the calibration saw.
    let seating = model.seatings.saturating_sub(1);
    let rows: Vec<WhiskerRow> = table
        .rows
        .into_iter()
        .map(|r| WhiskerRow { seating, ..r })
        .collect();
    let path = WhiskerPath::new(&rows, &[], &model.fbg, None);
    if let Some((id, column)) = model.missing_column(&path) {
        let detail =
            format!("the calibration carries {id}: expected {column} in every row, found none");
        return Err(CalibrationError::content(place, detail));
    }
    Ok(History {
        rows,
        path,
        warnings: table.warnings,
    })
}

/// Indices of a path's readings in the table's order.
fn in_order(path: &WhiskerPath) -> Vec<usize> {
    let mut order: Vec<usize> = (0..path.rows.len()).collect();
    order.sort_by_key(|&i| path.rows[i]);
    order
}
