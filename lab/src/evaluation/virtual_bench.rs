//! A virtual bench for the tracker: another wire, another physics, and gratings with effects that
//! nobody declared. All of it is SIMULATED.
//!
//! The wire differs a little from the one that the tracker was trained on, the groove of its
//! calibration sat elsewhere than declared, and the gratings answer with squares of the moments.
//! The bench is calibrated as a real one would be, on a session of its own.

use crate::LabError;
use crate::evaluation::request::{BenchCalibration, Calibrate};
use crate::sweep_series::SweepSeries;
use crate::tare::Tare;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use std::fmt::Write as _;
use std::path::Path;
use wcal_calibration::CalibrationModel;
use wcal_core::observation::{RestShape, WhiskerSpec};
use wcal_lab_sweeps::SweepPlan;
use wcal_lab_sweeps::physics::{Medium, PhysicsPlan};
use wcal_plant::bench::{Bench, PM_PER_DEGC};
use wcal_plant::effects::FBG_PM;
use wcal_plant::session::draw_on;
use wcal_plant::{CaseKind, Design, Kind, Request};

/// The bench.
#[derive(Debug)]
pub(crate) struct VirtualBench {
    bench: Bench,
    /// Squares of the moments in the shifts, pm/(N mm)^2.
    squares: [f64; 3],
    /// The wire as it is.
    pub whisker: WhiskerSpec,
    /// Its calibration, as a user makes it.
    pub calibration: BenchCalibration,
    /// Effects that act.
    pub acting: Vec<String>,
}

/// By how much the wire is not the one of the twin: straight part and radius, mm, Young's modulus,
/// share.
const STRAIGHT_MM: f64 = -0.1;
const RADIUS_MM: f64 = 0.15;
const YOUNGS: f64 = -0.015;
/// Size of each undeclared effect in the calibration session, in noises.
const SIZE_SIGMA: f64 = 20.0;
/// Samples of a 2 kHz stream in one reading at 10 Hz.
const AVERAGED: f64 = 200.0;
/// Time in which the slow part of the noise (the session's point-to-point noise) loses most of its
/// memory, s.
const SLOW_S: f64 = 60.0;
/// Time at the start of a series that sets its zero, without contact (`wcal track --tare-s`), s.
const TARE_S: f64 = 0.5;

impl VirtualBench {
    /// Draws the bench around the wire of the twin, records its calibration session, and calibrates
    /// it twice.
    ///
    /// # Errors
    /// Where the wire has no arc, or the session cannot be drawn or calibrated.
    pub(crate) fn new(
        twin: &WhiskerSpec,
        seed: u64,
        folder: &Path,
        calibrate: &Calibrate<'_>,
    ) -> Result<Self, LabError> {
        let RestShape::StraightArc {
            straight_mm,
            arc_radius_mm,
            ..
        } = twin.rest_shape
        else {
            return Err(LabError::value(
                "virtual bench, wire",
                "a straight part and an arc",
                "another rest shape",
            ));
        };
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut bench = Bench::draw(&mut rng);
        (bench.straight_mm, bench.arc_radius_mm) =
            (straight_mm + STRAIGHT_MM, arc_radius_mm + RADIUS_MM);
        (bench.youngs_gpa, bench.shear_gpa) = (
            twin.youngs_gpa * (1.0 + YOUNGS),
            twin.shear_gpa * (1.0 + YOUNGS),
        );
        let request = Request {
            seed,
            design: Design::Rich,
            want: CaseKind::Effects(vec![Kind::FbgThree, Kind::OffsetGroove]),
            target_sigma: SIZE_SIGMA,
            rivals: false,
        };
        let mut case = draw_on(&request, bench.clone())?;
        // What the session declares is the twin's wire.
        (case.bench.straight_mm, case.bench.arc_radius_mm) = (straight_mm, arc_radius_mm);
        (case.bench.youngs_gpa, case.bench.shear_gpa) = (twin.youngs_gpa, twin.shear_gpa);
        let squares = case
            .effects
            .iter()
            .find(|e| e.kind == Kind::FbgThree)
            .map_or([0.0; 3], |e| {
                std::array::from_fn(|k| e.amplitude * FBG_PM * e.shape[k])
            });
        let session_folder = folder.join("session");
        case.write(&session_folder)?;
        let calibration = calibrate(&session_folder).map_err(LabError::Calibrate)?;
        let whisker = WhiskerSpec {
            youngs_gpa: bench.youngs_gpa,
            shear_gpa: bench.shear_gpa,
            rest_shape: RestShape::StraightArc {
                straight_mm: bench.straight_mm,
                arc_radius_mm: bench.arc_radius_mm,
                length_mm: wcal_plant::bench::LENGTH_MM,
            },
            ..twin.clone()
        };
        Ok(Self {
            bench,
            squares,
            whisker,
            calibration,
            acting: case.truth.names.clone(),
        })
    }

    /// Sweeps on this bench: friction, weight, and the medium's drag.
    pub(crate) fn plan() -> SweepPlan {
        let physics = PhysicsPlan {
            friction: [0.05, 0.25],
            medium: Medium::Air,
            weight: true,
            ..PhysicsPlan::default()
        };
        SweepPlan {
            rate_hz: 10.0,
            physics,
            ..SweepPlan::default()
        }
    }

    /// The series as the calibration sees it: true moments become wavelengths, and those the
    /// moments that a user would get, the zero taken at the start.
    ///
    /// # Errors
    /// Where the calibration is no whisker's, or the readings cannot be written or put through it.
    pub(crate) fn through(
        &self,
        series: &SweepSeries,
        by: &CalibrationModel,
        seed: u64,
        folder: &Path,
    ) -> Result<SweepSeries, LabError> {
        let path = folder.join(format!("{}-{}.csv", series.object, series.sweep));
        std::fs::write(&path, self.readings(series, seed))
            .map_err(LabError::file("writing", &path))?;
        let by = by.whisker().ok_or_else(|| {
            LabError::value("virtual bench, calibration", "a whisker's", "another kind")
        })?;
        let rows = by.sensed(&path)?.rows;
        let mut tare = Tare::new(TARE_S);
        let mut seen = series.clone();
        for (instant, row) in seen.samples.iter_mut().zip(&rows) {
            instant.moment_nmm = tare.zeroed(instant.t_s, row.moments.moment_nmm);
        }
        Ok(seen)
    }

    /// Table of readings with noise: white over the samples, and slow as that from point to point
    /// in the session.
    fn readings(&self, series: &SweepSeries, seed: u64) -> String {
        let b = &self.bench;
        let mut rng = ChaCha8Rng::seed_from_u64(seed ^ series.sweep.wrapping_mul(0x9e37_79b9));
        let mut normal = || -> f64 { StandardNormal.sample(&mut rng) };
        let mut slow = [0, 1].map(|_| b.noise_pm * normal());
        let mut out = String::from("point,t_s,fbg_ref_nm,fbg_1_nm,fbg_2_nm,temperature_degc\n");
        let mut last_s = 0.0;
        for (point, i) in series.samples.iter().enumerate() {
            let kept = (-(i.t_s - last_s) / SLOW_S).exp();
            last_s = i.t_s;
            let warm = b.thermal.at(i.t_s);
            let [y, z] = i.moment_nmm;
            let [p, q, r] = self.squares;
            let square = [p * y * y + q * y * z, r * z * z];
            let shift = b.shift_pm(i.moment_nmm);
            let white = b.sample_sd_pm / AVERAGED.sqrt();
            let nm: [f64; 2] = std::array::from_fn(|c| {
                slow[c] = kept * slow[c] + (1.0 - kept * kept).sqrt() * b.noise_pm * normal();
                let own = white * normal();
                let pm = b.zero_pm[c] + shift[c] + square[c] + PM_PER_DEGC * warm + slow[c] + own;
                b.nominal_nm[c] + 1e-3 * pm
            });
            let reference = b.reference_nominal_nm + 1e-3 * (PM_PER_DEGC * warm + white * normal());
            let _ = writeln!(
                out,
                "{point},{},{reference:.7},{:.7},{:.7},{:.3}",
                i.t_s,
                nm[0],
                nm[1],
                22.0 + warm
            );
        }
        out
    }
}
