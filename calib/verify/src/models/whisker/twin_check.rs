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

use super::path::{Reading, WhiskerPath};
use super::rod_parameters::RodParameters;
use super::rod_tables::RodTables;
use super::system::WhiskerSystem;
use crate::VerifyError;
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
    let Some(tables) = rod_tables.tables(&RodParameters::default()) else {
        return LabelReport::default();
    };
    let check = |(reading, &row): (&Reading, &usize)| {
        let point = data.rows.get(row)?.point;
        Some(LabelCheck {
            point,
            trajectory: reading.group,
            stage_mm: reading.x_mm,
            label_nmm: label(data, point)?,
            rod_nmm: match reading.line {
                Some(l) if !reading.rest => tables[l].moment(reading.x_mm),
                _ => Some([0.0; 2]),
            },
            deviation: 0.0,
            fault: None,
        })
    };
    let all = path.readings.iter().zip(&path.rows);
    let mut checks: Vec<LabelCheck> = all.filter_map(check).collect();
    let is_loaded = |c: &LabelCheck| c.rod_nmm.is_some_and(|m| size(m) > 1e-6);
    let loaded = (0..checks.len()).filter(|&i| is_loaded(&checks[i]));
    let loaded: Vec<usize> = loaded.collect();
    // The relation has four coefficients a component: fewer labels leave nothing to judge by.
    if loaded.len() < 8 {
        return LabelReport {
            checks,
            faults: Vec::new(),
        };
    }
    deviations(&mut checks, &loaded);
    // Rod and label of the good labels.
    let good = loaded.iter().map(|&i| &checks[i]);
    let good = good.filter(|c| c.deviation < BRANCH_DEVIATION);
    let good: Vec<_> = good
        .filter_map(|c| Some((c.rod_nmm?, c.label_nmm)))
        .collect();
    let ratios = good.iter().map(|(rod, label)| size(*label) / size(*rod));
    let ratio = median(ratios).unwrap_or(1.0);
    let unit = !(1.0 / UNIT_RATIO..UNIT_RATIO).contains(&ratio);
    let axes = other_axes(&good);
    for c in &mut checks {
        let share = c.rod_nmm.map(|rod| size(c.label_nmm) / size(rod));
        c.fault = match share {
            None => Some("branch"),
            Some(_) if !is_loaded(c) => None,
            // A wire that left the groove carries almost nothing; one on another branch carries a
            // moment of another direction.
            Some(share) if c.deviation > BRANCH_DEVIATION && share < 0.1 => Some("contact-lost"),
            _ if c.deviation > BRANCH_DEVIATION => Some("branch"),
            _ if axes.is_some() => axes.as_ref().map(|(kind, _)| *kind),
            _ if unit => Some("unit"),
            Some(share) => ((share - 1.0).abs() > SMOOTH_SHARE).then_some("discretisation"),
        };
    }
    let axes = axes.map_or(String::new(), |(_, detail)| detail);
    let faults = collect(&checks, ratio, &axes);
    LabelReport { checks, faults }
}

/// Fault and detail where the labels are the rod's moments about other axes.
fn other_axes(good: &[([f64; 2], [f64; 2])]) -> Option<(&'static str, String)> {
    let (mut turned, mut mirrored) = (Complex::<f64>::ZERO, Complex::<f64>::ZERO);
    for &(rod, label) in good {
        let [rod, label] = [rod, label].map(|m| Complex::new(m[0], m[1]));
        turned += rod.conj() * label;
        mirrored += rod * label;
    }
    if mirrored.norm() > MIRRORED * turned.norm() {
        let angle = mirrored.arg().to_degrees();
        let turned = format!("mirrored and turned by {angle:.0} deg");
        let what = match angle {
            a if (a - 90.0).abs() < TURNED_DEG => "with the two axes exchanged",
            a if a.abs() < TURNED_DEG => "with the second axis reversed",
            a if a.abs() > 180.0 - TURNED_DEG => "with the first axis reversed",
            _ => turned.as_str(),
        };
        let detail = format!("the labels are the rod's moments {what}: [moments] axes");
        return Some(("axes", detail));
    }
    // Half a turn is the reaction's sign; less is another axis.
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
        let m = checks[loaded[r]].rod_nmm.unwrap_or_default();
        // m and m |m|: odd in the moment, so that the relation reverses with the load.
        m[j % 2] * if j < 2 { 1.0 } else { size(m) }
    });
    let mut squared = DVector::<f64>::zeros(rows);
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
            let spread = mad_sd(residual.iter().copied(), 0.0);
            scale = spread.unwrap_or_default().max(2e-3);
            // Cauchy weights (square roots): far labels lose all pull.
            weights = residual.map(|r| (1.0 + (r / (2.0 * scale)).powi(2)).sqrt().recip());
        }
        squared += (residual / scale).map(|r| r * r);
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
    let system = WhiskerSystem::new(data, &[])?;
    Ok(check_labels(data, &system.path, &system.rod_tables).faults)
}

/// The outside twin's label of a reading, N mm; zero at rest where it has none, for nothing bends
/// the wire there.
pub fn label_nmm(data: &WhiskerData, row: &WhiskerRow) -> Option<[f64; 2]> {
    label(data, row.point).or((row.role == Role::Rest).then_some([0.0; 2]))
}

fn label(data: &WhiskerData, point: i64) -> Option<[f64; 2]> {
    let label = data.twin.iter().find(|t| t.point == point)?;
    Some(label.moment_nmm)
}

/// Moments at the readings of `path` with the outside labels as they are: none where a reading has
/// no label.
pub(super) fn labelled_moments(data: &WhiskerData, path: &WhiskerPath) -> Option<Vec<[f64; 2]>> {
    let of = |&row: &usize| label(data, data.rows.get(row)?.point);
    path.rows.iter().map(of).collect()
}
