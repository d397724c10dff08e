//! A fitted wavelength-to-moment map.

use crate::apply::{
    AppliedTable, Calibration, SensedRow, SensedTable, SessionSystem, WhiskerCalibration, no_wire,
};
use crate::error::CalibrationError;
use std::path::Path;
use wcal_core::stream::MomentStream;
use wcal_core::{CalibrationNoise, FbgSpec, WhiskerSpec};
use wcal_gpr::{MapArtefact, MapPredictor, OutputMap};
use wcal_session::load_table;
use wcal_verify::verify::HeldOut;
use wcal_verify::whisker::groove_motion::{self, AcceptedWire, GrooveMotion};
use wcal_verify::whisker::{WhiskerSystem, judgement};

const HEADER: &str = "point,fbg_1_pm,fbg_2_pm,moment_1_nmm,moment_2_nmm,moment_1_sd_nmm,moment_2_sd_nmm,\
     moment_1_half95_nmm,moment_2_half95_nmm,fbg_1_fitted_pm,fbg_2_fitted_pm,outside_valid_region,outside_by_pm\n";

impl Calibration for MapArtefact {
    fn name(&self) -> &str {
        &self.name
    }

    fn session_kind(&self) -> &str {
        "whisker"
    }

    fn check(&self) -> Result<(), CalibrationError> {
        Ok(MapArtefact::check(self)?)
    }

    fn apply(&self, table: &Path) -> Result<AppliedTable, CalibrationError> {
        let predictor = MapPredictor::new(self)?;
        let table = load_table(table, &self.fbg)?;
        let mut csv = String::from(HEADER);
        let (mut outside, mut first) = (0_usize, None);
        for row in &table.rows {
            let shift_pm = row.compensated_pm(&self.fbg);
            let p = predictor.predict(shift_pm);
            if !p.is_valid() {
                outside += 1;
                first.get_or_insert((row.line, p.outside_by_pm));
            }
            let fitted = self.law.shift_pm(p.moment_nmm);
            csv += &format!("{},{:.4},{:.4}", row.point, shift_pm[0], shift_pm[1]);
            for pair in [p.moment_nmm, p.sd_nmm, p.half95_nmm] {
                csv += &format!(",{:.6},{:.6}", pair[0], pair[1]);
            }
            let mark = u8::from(!p.is_valid());
            csv += &format!(
                ",{:.4},{:.4},{mark},{:.3}\n",
                fitted[0], fitted[1], p.outside_by_pm
            );
        }
        let rows = table.rows.len();
        let outside = first.map(|(line, by_pm)| {
            format!(
                "{outside} of {rows} readings lie outside the valid region, first in line {line} by {by_pm:.1} pm"
            )
        });
        Ok(AppliedTable {
            csv,
            rows,
            outside,
            warnings: table.warnings,
            remarks: Vec::new(),
        })
    }

    fn judged_readings(
        &self,
        session: SessionSystem<'_>,
        only_sealed: bool,
    ) -> Result<Option<Vec<HeldOut>>, CalibrationError> {
        Ok(judgement::of_map(session.as_whisker()?, self, only_sealed))
    }

    fn whisker(&self) -> Option<&dyn WhiskerCalibration> {
        Some(self)
    }
}

impl WhiskerCalibration for MapArtefact {
    fn fbg(&self) -> &FbgSpec {
        &self.fbg
    }

    /// The larger one of its two moments.
    fn noise_sd_nmm(&self) -> f64 {
        self.outputs
            .iter()
            .map(OutputMap::noise_sd_nmm)
            .fold(0.0, f64::max)
    }

    fn noise(&self) -> CalibrationNoise {
        // The map's noise holds that of a reading: its variance comes off.
        let misfit = |o: &OutputMap, reading: f64| {
            (o.inflation.powi(2) * o.noise_sd_nmm().powi(2) - reading.powi(2))
                .max(0.0)
                .sqrt()
        };
        let reading = self.reading_sd_nmm;
        let [a, b] = [0, 1].map(|k| misfit(&self.outputs[k], reading.map_or(0.0, |sd| sd[k])));
        // Without repeats or samples nobody knows what of the rest is noise.
        let misfit_sd_nmm = reading.map(|_| [a, b]);
        CalibrationNoise {
            reading_sd_nmm: reading,
            drift_sd_nmm: None,
            misfit_sd_nmm,
        }
    }

    fn knows_zero(&self) -> bool {
        !self.rest.as_ref().is_some_and(|r| r.left_out)
    }

    fn poses(&self) -> Option<usize> {
        Some(self.training_pm.len())
    }

    fn sensed(&self, table: &Path) -> Result<SensedTable, CalibrationError> {
        let mut predictor = MapPredictor::new(self)?;
        let table = load_table(table, &self.fbg)?;
        let rows = table.rows.iter().map(|row| {
            // Shifts are compensated and a map has no memory: time and temperature do not matter.
            let shift_pm = row.compensated_pm(&self.fbg);
            let moments = predictor.moments(0.0, shift_pm, 0.0);
            SensedRow::new(row, (moments, predictor.spread()))
        });
        Ok(SensedTable {
            rows: rows.collect(),
            warnings: table.warnings,
        })
    }

    fn wire(
        &self,
        whisker: &WhiskerSpec,
    ) -> Result<(AcceptedWire, Vec<AcceptedWire>), CalibrationError> {
        // A map says nothing of the mechanics: its wire is the nominal one.
        let nominal = AcceptedWire::nominal(whisker).ok_or_else(no_wire)?;
        Ok((nominal, Vec::new()))
    }

    fn groove_motion(&self, system: &WhiskerSystem) -> Option<GrooveMotion> {
        groove_motion::of_map(system, self)
    }

    fn stream(&self) -> Result<Box<dyn MomentStream>, CalibrationError> {
        Ok(Box::new(MapPredictor::new(self)?))
    }
}
