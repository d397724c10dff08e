//! How often the 95 % intervals of a map (`fit-gpr`) hold the true moment at wavelengths that are
//! read later. SIMULATED.
//!
//! The map is fitted to 27 poses of the simulated bench, labelled by the program's own rod; the
//! moments that are true are of the bench's. The later readings are of other trajectories. Half of
//! the sensors are linear, the wavelengths of the others have squares and products of the moments.
//!
//! ```text
//! between the poses   the reading lies in the convex hull of those that the map is fitted to
//! at their edge       outside the hull, in the map's valid region
//! ```
//!
//! Readings of a session share the error of its map: the interval of a share, which counts
//! readings, is too narrow.

use crate::statements::{Auditor, Counted, Labelled, StatementRow, tallied};
use anyhow::Context;
use std::collections::BTreeMap;
use std::f64::consts::{PI, TAU};
use wcal_plant::case::{Case, CaseKind, Make, Reading, Request};
use wcal_plant::layout::Design;
use wcal_plant::session::draw_under;
use wcal_plant::{Kind, Noise};

/// Size of a sensor's bend over all poses, in noises of a reading.
const BENT_NOISES: f64 = 40.0;

impl Auditor {
    /// Draws so many whiskers, fits a map to each, and counts its moments at the held-out readings.
    ///
    /// # Errors
    /// Where a session cannot be drawn or written, or the program cannot be started.
    pub fn audit_maps(&self, draws: usize, seed: u64) -> anyhow::Result<Vec<StatementRow>> {
        let seeds: Vec<u64> = (0..draws as u64)
            .map(|k| seed.wrapping_mul(1_000_003).wrapping_add(k))
            .collect();
        let label = |c| (c, "white", [draws, 0]);
        let counted = self.each(&seeds, |seed| -> anyhow::Result<Vec<Labelled>> {
            Ok(self.mapped(*seed)?.into_iter().map(label).collect())
        })?;
        Ok(tallied(counted))
    }

    fn mapped(&self, seed: u64) -> anyhow::Result<Vec<Counted>> {
        let folder = self.folder.join(format!("map-{seed}"));
        let (sensor, want) = if seed.is_multiple_of(2) {
            ("linear", CaseKind::Null)
        } else {
            ("bent", CaseKind::Effects(vec![Kind::FbgFull]))
        };
        let request = Request {
            seed,
            design: Design::Paper,
            want,
            target_sigma: BENT_NOISES,
            rivals: false,
        };
        let make = if seed.is_multiple_of(3) {
            Make::Thin
        } else {
            Make::Usual
        };
        let case = draw_under(&request, Noise::Gaussian, make)?;
        case.write(&folder)?;
        let [fitted, later, out] = ["map", "holdout.csv", "predicted.csv"].map(|n| folder.join(n));
        let calibration = fitted.join("calibration.json");
        self.run(&[
            "fit-gpr".as_ref(),
            folder.as_ref(),
            "--out".as_ref(),
            fitted.as_ref(),
        ])?;
        self.run(&[
            "predict".as_ref(),
            later.as_ref(),
            "--calibration".as_ref(),
            calibration.as_ref(),
            "--out".as_ref(),
            out.as_ref(),
            "--force".as_ref(),
        ])?;
        let poses: Vec<[f64; 2]> = case
            .readings
            .iter()
            .filter(|r| ["calibration", "rest"].contains(&r.planned.role))
            .map(|r| shift_pm(&case, r))
            .collect();
        let mut reader = csv::Reader::from_path(&out)
            .with_context(|| format!("reading the moments of {}", folder.display()))?;
        let predicted = reader.deserialize::<BTreeMap<String, f64>>();
        let read = case.readings.iter().filter(|r| r.planned.holdout);
        let mut counted = Vec::new();
        for ((row, reading), truth) in predicted.zip(read).zip(&case.truth.holdout_moments_nmm) {
            let row = row?;
            // At rest there is no moment to find.
            if reading.planned.role == "rest" {
                continue;
            }
            let place = if row["outside_valid_region"] > 0.0 {
                "outside the valid region"
            } else if surrounded(shift_pm(&case, reading), &poses) {
                "between the poses"
            } else {
                "at their edge"
            };
            for (k, truth) in (1..).zip(truth) {
                let off = truth - row[&format!("moment_{k}_nmm")];
                let half = self.widened * row[&format!("moment_{k}_half95_nmm")];
                let statement = format!("map, {sensor} sensor, moment {k} {place}: inside half95");
                let counts = Counted::new(statement, 0.95, off.abs() <= half);
                // Readings outside are marked.
                counted.push(if place.starts_with("outside") {
                    counts.unsaid()
                } else {
                    counts
                });
            }
        }
        Ok(counted)
    }
}

/// Shifts of both gratings with those of the reference taken off, pm.
fn shift_pm(case: &Case, reading: &Reading) -> [f64; 2] {
    let reference_nm = reading.reference_nm - case.declared.reference_nominal_nm;
    [0, 1].map(|c| 1e3 * (reading.fbg_nm[c] - case.declared.nominal_nm[c] - reference_nm))
}

/// Whether a point lies in the convex hull of others: no half plane through it is free of them.
fn surrounded([x, y]: [f64; 2], by: &[[f64; 2]]) -> bool {
    let mut angles: Vec<f64> = by.iter().map(|[a, b]| (b - y).atan2(a - x)).collect();
    angles.sort_by(f64::total_cmp);
    let round = angles.first().map(|a| a + TAU);
    let next = angles.iter().copied().skip(1).chain(round);
    angles.iter().zip(next).all(|(a, b)| b - a < PI)
}
