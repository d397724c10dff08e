//! Sessions that lie: what a careless operator or a broken script does to the tables.

use rand::{Rng, RngExt};

use crate::case::{Case, Tampering};

/// Applies a trick to a drawn (effect-free) session.
pub fn tamper(case: &mut Case, trick: Tampering, rng: &mut impl Rng) {
    case.truth
        .effects
        .insert("adversarial".into(), serde_json::json!(trick.name()));
    let points: Vec<usize> = (0..case.readings.len())
        .filter(|&i| !case.readings[i].planned.holdout)
        .collect();
    let n = points.len();
    let rows = &mut case.readings;
    match trick {
        Tampering::FakeReplicates => {
            // The second pass of 11 settled rows follows the first after one rest.
            for i in 0..n {
                let p = &rows[i].planned;
                if p.replicate == 1 && p.dwell_s > 0.0 && p.role != "rest" && i + 12 < n {
                    let source = rows[i].clone();
                    let copy = &mut rows[i + 12];
                    if copy.planned.replicate == 2 && copy.planned.role != "rest" {
                        (copy.fbg_nm, copy.sd_pm) = (source.fbg_nm, source.sd_pm);
                        (copy.groove_mm, copy.reference_nm) =
                            (source.groove_mm, source.reference_nm);
                        copy.temperature_degc = source.temperature_degc;
                        copy.planned.stage_mm = source.planned.stage_mm;
                        copy.planned.commanded_mm = source.planned.commanded_mm;
                    }
                }
            }
        }
        Tampering::SwappedPoses => {
            let loaded: Vec<usize> = points
                .into_iter()
                .filter(|&i| rows[i].planned.role != "rest")
                .collect();
            let a = loaded[rng.random_range(0..loaded.len())];
            let b = *loaded
                .iter()
                .filter(|&&b| rows[b].trajectory_id == rows[a].trajectory_id)
                .max_by(|&&b, &&c| {
                    let far =
                        |i: usize| (rows[i].planned.stage_mm - rows[a].planned.stage_mm).abs();
                    far(b).total_cmp(&far(c))
                })
                .unwrap_or(&a);
            let (first, second) = (rows[a].fbg_nm, rows[b].fbg_nm);
            (rows[a].fbg_nm, rows[b].fbg_nm) = (second, first);
        }
        Tampering::SignError => {
            let from = rng.random_range(0..n / 2);
            let nominal = case.bench.nominal_nm[0];
            for r in &mut rows[from..from + n / 5] {
                r.fbg_nm[0] = 2.0 * nominal - r.fbg_nm[0];
            }
        }
        Tampering::GrooveInMetres => rows
            .iter_mut()
            .for_each(|r| r.groove_mm = r.groove_mm.map(|v| v * 1e-3)),
        Tampering::StageInMicrometres => rows.iter_mut().for_each(|r| r.planned.stage_mm *= 1e3),
        Tampering::ClockShift => {
            let from = rng.random_range(n / 5..n / 2);
            for r in &mut rows[from..from + n / 5] {
                r.planned.t_s -= 400.0;
            }
        }
        Tampering::ClockBackwards => {
            let end = rows[n - 1].planned.t_s;
            for r in &mut rows[..n] {
                r.planned.t_s = end - r.planned.t_s;
            }
        }
        Tampering::CopiedHoldout => {
            let sources: Vec<_> = rows[..n]
                .iter()
                .filter(|r| r.planned.role != "rest")
                .cloned()
                .collect();
            let moments = &mut case.truth.holdout_moments_nmm;
            for (k, r) in rows[n..]
                .iter_mut()
                .enumerate()
                .filter(|(_, r)| r.planned.role != "rest")
            {
                let (point, source) = (r.point, &sources[(k * 5) % sources.len()]);
                *r = source.clone();
                r.point = point;
                r.planned.holdout = true;
                r.planned.role = "holdout";
                moments[k] = [f64::NAN; 2];
            }
        }
        Tampering::FrozenReference => {
            let (first, warm) = (rows[0].reference_nm, rows[0].temperature_degc);
            for r in rows.iter_mut() {
                (r.reference_nm, r.temperature_degc) = (first, warm);
            }
        }
    }
}
