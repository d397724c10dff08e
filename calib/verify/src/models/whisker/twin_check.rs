//! Twin check: labels of an outside twin against the rod at the same poses, point by point.
//!
//! A cable twin may differ from the rod smoothly (discretisation, diameter); a label that leaves
//! the smooth relation is on another branch. The relation is fitted robustly, so the faulty labels
//! do not pull it.
//!
//! Labels and rod are two measurements of one moment: the linear part between them is one, or the
//! labels are of another unit, sign or axes. In complex numbers, with m a moment and l its label
//! (least squares over good labels, Kabsch 1976),
//!
//! ```text
//! l = c m,  arg c = arg sum conj(m) l         turned, by half a turn where the sign is the reaction's
//! l = c conj(m),  arg c = arg sum m l         mirrored; arg c = 90 deg: axes exchanged, 0 or 180 deg: one axis reversed
//! ```

use crate::error::VerifyError;
use crate::whisker::WhiskerSystem;
use crate::whisker::path::WhiskerPath;
use crate::whisker::rod_tables::RodTables;
use nalgebra::{Complex, DMatrix, DVector};
use wcal_core::observation::{Role, WhiskerData, WhiskerRow};
use wcal_core::order_statistics::{mad_sd, median};
use wcal_core::verify_document::TwinFault;

/// The rod and the label at one pose.
#[derive(Debug, Clone, PartialEq)]
pub struct LabelCheck {
    /// Point number.
    pub point: i64,
    /// Trajectory.
    pub trajectory: u32,
    /// Stage position, mm.
    pub stage_mm: f64,
    /// Outside label, N mm.
    pub label_nmm: [f64; 2],
    /// Rod, N mm; none where the rod has no equilibrium either.
    pub rod_nmm: Option<[f64; 2]>,
    /// Label less smooth relation, in robust standard deviations.
    pub deviation: f64,
    /// Kind of fault.
    pub fault: Option<&'static str>,
}

/// Result of the twin check.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct LabelReport {
    /// Every labelled pose.
    pub checks: Vec<LabelCheck>,
    /// Faults by kind.
    pub faults: Vec<TwinFault>,
}

/// A label this many robust standard deviations off is another equilibrium.
const BRANCH_DEVIATION: f64 = 8.0;
/// The smooth difference may be this share of the moment before it counts as a discretisation
/// fault.
const SMOOTH_SHARE: f64 = 0.03;
/// Factors between common units (N m, N mm, mN m, kgf mm) would show as such a ratio.
const UNIT_RATIO: f64 = 5.0;
/// A wire is not clamped worse than this about its own axis: labels that are turned further have
/// other axes, deg.
const TURNED_DEG: f64 = 10.0;
/// Share of the least-squares agreement by which mirrored axes must beat turned ones; moments along
/// one direction do not distinguish the two.
const MIRRORED: f64 = 1.02;

/// Checks every label of the session.
pub fn check_labels(data: &WhiskerData, path: &WhiskerPath, rod_tables: &RodTables) -> LabelReport {
    let Some(tables) = rod_tables.tables(&crate::whisker::rod_parameters::RodParameters::default())
    else {
        return LabelReport::default();
    };
    let mut checks: Vec<LabelCheck> = Vec::new();
    for (reading, &row) in path.readings.iter().zip(&path.rows) {
        let Some(source) = data.rows.get(row) else {
            continue;
        };
        let Some(label) = data.twin.iter().find(|t| t.point == source.point) else {
            continue;
        };
        let rod = match reading.line {
            Some(l) if !reading.rest => tables[l].moment(reading.x_mm),
            _ => Some([0.0; 2]),
        };
        checks.push(LabelCheck {
            point: source.point,
            trajectory: reading.group,
            stage_mm: reading.x_mm,
            label_nmm: label.moment_nmm,
            rod_nmm: rod,
            deviation: 0.0,
            fault: None,
        });
    }
    let loaded: Vec<usize> = (0..checks.len())
        .filter(|&i| checks[i].rod_nmm.is_some_and(|m| m[0].hypot(m[1]) > 1e-6))
        .collect();
    if loaded.len() < 8 {
        return LabelReport {
            checks,
            faults: Vec::new(),
        };
    }
    deviations(&mut checks, &loaded);
    // Over good labels; 1 where both agree.
    let ratios = loaded
        .iter()
        .filter(|&&i| checks[i].deviation < BRANCH_DEVIATION)
        .filter_map(|&i| {
            checks[i]
                .rod_nmm
                .map(|m| size(checks[i].label_nmm) / size(m))
        });
    let median_ratio = median(ratios).unwrap_or(1.0);
    let unit = !(1.0 / UNIT_RATIO..UNIT_RATIO).contains(&median_ratio);
    let axes = other_axes(&checks, &loaded);
    for &i in &loaded {
        let Some(rod) = checks[i].rod_nmm else {
            continue;
        };
        let label = checks[i].label_nmm;
        checks[i].fault = if checks[i].deviation > BRANCH_DEVIATION {
            // A wire that left the groove carries almost nothing; one on another branch carries a
            // moment of another direction.
            Some(if size(label) < 0.1 * size(rod) {
                "contact-lost"
            } else {
                "branch"
            })
        } else if let Some((kind, _)) = &axes {
            Some(*kind)
        } else if unit {
            Some("unit")
        } else if (size(label) / size(rod) - 1.0).abs() > SMOOTH_SHARE {
            Some("discretisation")
        } else {
            None
        };
    }
    for c in checks.iter_mut().filter(|c| c.rod_nmm.is_none()) {
        c.fault = Some("branch");
    }
    let faults = collect(
        &checks,
        median_ratio,
        axes.as_ref().map_or("", |(_, detail)| detail),
    );
    LabelReport { checks, faults }
}

/// Fault and detail where the labels are the rod's moments about other axes.
fn other_axes(checks: &[LabelCheck], loaded: &[usize]) -> Option<(&'static str, String)> {
    let good = loaded
        .iter()
        .filter(|&&i| checks[i].deviation < BRANCH_DEVIATION);
    let (mut turned, mut mirrored) = (Complex::<f64>::ZERO, Complex::<f64>::ZERO);
    for &i in good {
        let complex = |m: [f64; 2]| Complex::new(m[0], m[1]);
        let (rod, label) = (complex(checks[i].rod_nmm?), complex(checks[i].label_nmm));
        turned += rod.conj() * label;
        mirrored += rod * label;
    }
    if mirrored.norm() > MIRRORED * turned.norm() {
        let angle = mirrored.arg().to_degrees();
        let what = match angle {
            a if (a - 90.0).abs() < TURNED_DEG => "with the two axes exchanged".to_owned(),
            a if a.abs() < TURNED_DEG => "with the second axis reversed".to_owned(),
            a if a.abs() > 180.0 - TURNED_DEG => "with the first axis reversed".to_owned(),
            a => format!("mirrored and turned by {a:.0} deg"),
        };
        return Some((
            "axes",
            format!("the labels are the rod's moments {what}: [moments] axes"),
        ));
    }
    let angle = turned.arg().to_degrees();
    match angle.abs() {
        a if a > 180.0 - TURNED_DEG => Some((
            "sign",
            "the labels are -1 times the rod's moments (the reaction on the base): [moments] sign"
                .to_owned(),
        )),
        a if a > TURNED_DEG => Some((
            "axes",
            format!(
                "the labels are the rod's moments turned by {angle:.0} deg: [moments] axes, or the wire's roll"
            ),
        )),
        _ => None,
    }
}

fn size(m: [f64; 2]) -> f64 {
    m[0].hypot(m[1])
}

/// Robust (iteratively reweighted) regression of each label component on the rod's moments and
/// their size.
fn deviations(checks: &mut [LabelCheck], loaded: &[usize]) {
    let rows = loaded.len();
    let design = DMatrix::from_fn(rows, 4, |r, j| {
        let m = checks[loaded[r]].rod_nmm.unwrap_or([0.0; 2]);
        match j {
            0 => m[0],
            1 => m[1],
            2 => m[0] * size(m),
            _ => m[1] * size(m),
        }
    });
    let mut squared = vec![0.0; rows];
    for c in 0..2 {
        let y = DVector::from_fn(rows, |r, _| checks[loaded[r]].label_nmm[c]);
        let mut weights = DVector::from_element(rows, 1.0);
        let mut residual = y.clone();
        let mut scale = 1.0;
        for _ in 0..60 {
            let weighted = DMatrix::from_fn(rows, 4, |r, j| design[(r, j)] * weights[r]);
            let target = y.component_mul(&weights);
            let Ok(b) = weighted.svd(true, true).solve(&target, 1e-9) else {
                return;
            };
            residual = &y - &design * b;
            // Labels are printed to 1e-6 N mm, so the floor keeps perfect agreement finite.
            scale = mad_sd(residual.iter().copied(), 0.0)
                .unwrap_or(0.0)
                .max(2e-3);
            for r in 0..rows {
                // Cauchy weights (square roots): far labels lose all pull.
                weights[r] = (1.0 / (1.0 + (residual[r] / (2.0 * scale)).powi(2))).sqrt();
            }
        }
        for r in 0..rows {
            squared[r] += (residual[r] / scale).powi(2);
        }
    }
    for (r, &i) in loaded.iter().enumerate() {
        checks[i].deviation = squared[r].sqrt();
    }
}

fn collect(checks: &[LabelCheck], ratio: f64, axes: &str) -> Vec<TwinFault> {
    ["branch", "contact-lost", "sign", "axes", "unit", "discretisation"]
        .into_iter()
        .filter_map(|kind| {
            let points: Vec<i64> =
                checks.iter().filter(|c| c.fault == Some(kind)).map(|c| c.point).collect();
            let detail = match kind {
                "branch" => "the label leaves the branch that starts at first touch: on the way to this pose the twin's wire snapped to another equilibrium".to_owned(),
                "contact-lost" => "the label is near zero where the rod is held: the twin's wire left the groove".to_owned(),
                "sign" | "axes" => axes.to_owned(),
                "unit" => format!("the labels are {ratio:.3} times the rod's moments: a unit or a stiffness is wrong"),
                _ => "the label differs smoothly from the rod by more than 3 %, most where the contact is near the root: too few links at the clamp, or another diameter".to_owned(),
            };
            (!points.is_empty()).then(|| TwinFault { points, kind: kind.to_owned(), detail })
        })
        .collect()
}

/// What is wrong with the labels of a session's outside twin, by the rod at the same poses; nothing
/// without one.
///
/// # Errors
/// Where the session has no rod.
pub fn label_faults(data: &WhiskerData) -> Result<Vec<TwinFault>, VerifyError> {
    if data.twin.is_empty() {
        return Ok(Vec::new());
    }
    let system = WhiskerSystem::new(data, &data.rows.iter().collect::<Vec<_>>())?;
    Ok(check_labels(data, &system.path, &system.rod_tables).faults)
}

/// The outside twin's label of a reading, N mm; zero at rest where it has none, for nothing bends
/// the wire there.
pub fn label_nmm(data: &WhiskerData, row: &WhiskerRow) -> Option<[f64; 2]> {
    let label = data
        .twin
        .iter()
        .find(|t| t.point == row.point)
        .map(|t| t.moment_nmm);
    label.or((row.role == Role::Rest).then_some([0.0; 2]))
}

/// Moments at the readings of `path` with the outside labels as they are: none where a reading has
/// no label.
pub(crate) fn labelled_moments(data: &WhiskerData, path: &WhiskerPath) -> Option<Vec<[f64; 2]>> {
    path.rows
        .iter()
        .map(|&row| {
            let point = data.rows.get(row)?.point;
            data.twin
                .iter()
                .find(|t| t.point == point)
                .map(|t| t.moment_nmm)
        })
        .collect()
}
