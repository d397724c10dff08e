//! Do the gratings respond to the load at all? Dead, stuck and alike gratings are named before
//! anything is fitted to them.
//!
//! ```text
//! rho_k: canonical correlations of the shifts Y (readings x 2) and the moments M (readings x 2), both less a course in time
//! -(n - 1 - (p + q + 1)/2) ln(1 - rho_2^2) ~ chi^2(1)   where the gratings show one direction of the load only
//! ```
//!
//! M. S. Bartlett, J. R. Stat. Soc. Suppl. 9 (1947) 176: test of the smallest canonical
//! correlation.

use super::system::WhiskerSystem;
use super::twin_check::label_nmm;
use crate::VerifyError;
use crate::levels::NEGLIGIBLE;
use crate::method::{Basis, chi_squared_tail};
use nalgebra::{DMatrix, DVector};
use wcal_core::observation::{Role, WhiskerData};
use wcal_core::order_statistics::{mad_sd, median};

/// Fewest loaded readings that carry K, the zero and a residual.
pub(super) const MIN_LOADED: usize = 9;
/// A value farther than this many robust deviations from the median is clipped: a gross reading is
/// no reason to miss a response.
const CLIP: f64 = 8.0;
/// Smallest share of a direction that is there at all: poses in one plane load one direction.
const SAME_DIRECTION: f64 = 1e-3;

/// Why the session's gratings cannot carry a calibration; none where they respond to the load in
/// two directions.
///
/// # Errors
/// Where the wire's description cannot be used.
pub fn lost_sensitivity(data: &WhiskerData) -> Result<Option<String>, VerifyError> {
    let loaded = data.rows.iter().filter(|r| r.role != Role::Rest).count();
    if loaded < MIN_LOADED {
        return Ok(None);
    }
    Ok(of_system(&WhiskerSystem::new(data, &[])?))
}

/// The same of a session whose model is there.
pub(super) fn of_system(system: &WhiskerSystem) -> Option<String> {
    let rod = system.moments(&[])?.0;
    let lost = |moments: &Vec<[f64; 2]>| response_fault(system, moments);
    // A response to either twin is one.
    let of_either = || {
        let by_rod = lost(&rod)?;
        labels(system).map_or(Some(by_rod), |outside| lost(&outside))
    };
    constant(system).or_else(of_either)
}

/// Moments of an outside twin at every reading, 0 at rest, N mm; none where it does not label all
/// of them.
fn labels(system: &WhiskerSystem) -> Option<Vec<[f64; 2]>> {
    (0..system.path.readings.len())
        .map(|i| label_nmm(&system.data, system.row(i)))
        .collect()
}

/// The gratings that are such.
fn names(such: impl Fn(usize) -> bool) -> Vec<String> {
    let such = (0..2).filter(|&g| such(g));
    such.map(|g| format!("fbg_{}", g + 1)).collect()
}

/// Gratings that read the same at every load.
fn constant(system: &WhiskerSystem) -> Option<String> {
    let readings = &system.path.readings;
    let loaded = (0..readings.len()).filter(|&i| !readings[i].rest);
    // Shifts as they were read, pm.
    let loaded: Vec<[f64; 2]> = loaded.map(|i| system.row(i).shift_pm).collect();
    let first = *loaded.first()?;
    let named = names(|g| loaded.iter().all(|shift_pm| shift_pm[g] == first[g]));
    if named.is_empty() || loaded.len() < MIN_LOADED {
        return None;
    }
    let verb = if named.len() == 1 { "reads" } else { "read" };
    Some(format!(
        "No sensitivity: {} {verb} the same at all {} loaded readings, to the last digit: dead, stuck or not connected.",
        named.join(" and "),
        loaded.len()
    ))
}

/// Gratings whose readings do not follow the load, or follow one direction of it only.
fn response_fault(system: &WhiskerSystem, moments: &[[f64; 2]]) -> Option<String> {
    let n = moments.len();
    // A zero that drifts, one a seating, and the temperature (a dead grating that is compensated
    // follows it) are no response.
    let mut course = Basis::default();
    for power in 0..3 {
        course.push(&DVector::from_fn(n, |i, _| {
            (i as f64 / n as f64).powi(power)
        }));
    }
    for column in system.path.seating_columns(system.seatings) {
        course.push(&DVector::from_vec(column));
    }
    if system.path.columns.temperature {
        let degc = system.path.readings.iter().map(|r| r.rise_degc);
        course.push(&DVector::from_iterator(n, degc));
    }
    let off = |values: Vec<f64>| course.project_off(&DVector::from_vec(values));
    let readings = &system.path.readings;
    let y = [0, 1].map(|g| off(clip(readings.iter().map(|r| r.shift_pm[g]).collect())));
    let load = [0, 1].map(|k| off(moments.iter().map(|m| m[k]).collect()));
    let load = directions(&load);
    if load.is_empty() {
        return None;
    }
    // What is projected off costs its degrees of freedom.
    let dof = n as f64 - course.rank() as f64;
    let none = |p: Option<f64>| p.is_some_and(|p| p > NEGLIGIBLE);
    let dead = names(|g| none(response_p(&y[g..=g], &load, 0, dof)));
    if !dead.is_empty() {
        let names = dead.join(" and ");
        return Some(format!(
            "No sensitivity: {names} does not follow the load at any pose: dead, or not on the wire."
        ));
    }
    (load.len() == 2 && none(response_p(&y, &load, 1, dof))).then(|| {
        "The gratings have rank 1: both follow the same direction of the load, so they cannot determine two moments.".to_owned()
    })
}

/// p-value of the canonical correlations from number `from` on; none where it cannot be determined.
fn response_p(y: &[DVector<f64>], load: &[DVector<f64>], from: usize, dof: f64) -> Option<f64> {
    let y = directions(y);
    if y.len() <= from {
        return Some(1.0);
    }
    // Of orthonormal bases, canonical correlations are the singular values of Q_y' Q_m (Bjorck &
    // Golub 1973).
    let cross = DMatrix::from_fn(y.len(), load.len(), |a, b| y[a].dot(&load[b]));
    let rho = cross.singular_values();
    let (p, q) = (y.len() as f64, load.len() as f64);
    // Wilks' Lambda of the remaining correlations; Bartlett's factor brings it near chi-squared in
    // small samples.
    let left: f64 = rho
        .iter()
        .skip(from)
        .map(|r| (1.0 - r * r).max(1e-300).ln())
        .sum();
    let statistic = -(dof - (p + q + 1.0) / 2.0) * left;
    let free = (p - from as f64) * (q - from as f64);
    chi_squared_tail(statistic, free)
}

/// Orthonormal directions that `columns` span, those that are hardly there left out.
fn directions(columns: &[DVector<f64>]) -> Vec<DVector<f64>> {
    let mut basis = Basis::default();
    for c in columns {
        if basis.project_off(c).norm()
            > SAME_DIRECTION * c.norm() * f64::from(u8::from(basis.rank() > 0))
        {
            basis.push(c);
        }
    }
    basis.vectors().to_vec()
}

fn clip(values: Vec<f64>) -> Vec<f64> {
    let centre = median(values.iter().copied()).unwrap_or_default();
    let reach = CLIP * mad_sd(values.iter().copied(), centre).unwrap_or_default();
    if !(reach > 0.0) {
        return values;
    }
    let clipped = |v: f64| v.clamp(centre - reach, centre + reach);
    values.into_iter().map(clipped).collect()
}
