//! Signatures: how the data would change if an effect acted, less what the nuisance parameters take
//! up.
//!
//! ```text
//! s = P (X(theta + probe) - X(theta)) b,     P = I - N (N' N)^-1 N'        N: design and tangents of what is fitted already
//! gain = |Q' r|^2,   Q: orthonormal in the span of s                        fall of the sum of squares by it
//! ```

use super::fit::{Fit, Weights};
use super::linear::{Basis, stack_with};
use crate::effect::{EffectModel, EffectTerm, Role};
use crate::measurement_model::MeasurementModel;
use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;
use std::ops::Range;

/// Signature of one law at one point of its shape grid.
#[derive(Debug, Clone)]
pub struct Signature {
    /// Effect and law with probe values; the start of a refit.
    pub term: EffectTerm,
    /// Amplitude slots of the law, one a column of `signature` where it is nonlinear.
    pub amplitudes: Vec<(usize, f64)>,
    /// Only positive amplitudes are physical (single-amplitude laws).
    pub one_sided: bool,
    /// Orthonormal directions that it adds to the nuisance space.
    pub directions: Vec<DVector<f64>>,
    /// Raw signature of the first amplitude at its probe, projected (one-sided laws test its sign).
    pub projected: Vec<DVector<f64>>,
    /// Share of the signature left after projection.
    pub share_left: f64,
}

/// The nuisance space of a fit: its design in each channel and its tangents.
pub fn nuisance_basis(fit: &Fit) -> Basis {
    nuisance_basis_without(fit, &(0..0))
}

/// The same without the columns `left_out` of the design.
pub(crate) fn nuisance_basis_without(fit: &Fit, left_out: &Range<usize>) -> Basis {
    let columns = (0..fit.design.ncols()).filter(|j| !left_out.contains(j));
    Basis::of(
        columns
            .flat_map(|j| fit.column_directions(j))
            .chain(fit.tangents.iter().cloned()),
    )
}

/// All points of a law's shape grids, amplitudes at zero.
fn grid(law: &EffectModel) -> Vec<Vec<f64>> {
    let mut points = vec![Vec::new()];
    for p in &law.parameters {
        let choices: &[f64] = match p.role {
            Role::Amplitude { .. } => &[0.0],
            Role::Shape { grid } => grid,
        };
        points = points
            .iter()
            .flat_map(|head| {
                choices.iter().map(move |v| {
                    let mut point = head.clone();
                    point.push(*v);
                    point
                })
            })
            .collect();
    }
    points
}

fn whitened_design(
    system: &dyn MeasurementModel,
    weights: &Weights,
    terms: &[EffectTerm],
) -> Option<DMatrix<f64>> {
    Some(weights.apply(&system.design(terms)?))
}

/// Signatures of effect `effect` on top of `fit`, projected off `nuisance`.
pub fn signatures_of_effect(
    system: &dyn MeasurementModel,
    effect: usize,
    fit: &Fit,
    weights: &Weights,
    nuisance: &Basis,
) -> Vec<Signature> {
    let candidate = &system.catalogue()[effect];
    let channels = fit.residual.ncols();
    let base = fit.design.ncols();
    let mut signatures = Vec::new();
    for (index, law) in candidate.laws.iter().enumerate() {
        for point in grid(law) {
            let mut raw: Vec<DVector<f64>> = Vec::new();
            let mut amplitudes = Vec::new();
            // Score direction of an amplitude: a difference from zero, the coefficients as they
            // are.
            for (slot, p) in law.parameters.iter().enumerate() {
                let Role::Amplitude { probe } = p.role else {
                    continue;
                };
                let mut values = point.clone();
                values[slot] = probe;
                let mut terms = fit.terms.clone();
                terms.push(EffectTerm {
                    effect,
                    law: index,
                    values,
                });
                let Some(d) = whitened_design(system, weights, &terms) else {
                    continue;
                };
                let Some(auxiliary_residual) = system.auxiliary_residual(&terms, weights) else {
                    continue;
                };
                let change = (d.columns(0, base) - &fit.design) * &fit.coefficients;
                raw.push(stack_with(
                    &change,
                    &(&fit.auxiliary_residual - auxiliary_residual),
                ));
                amplitudes.push((slot, probe));
            }
            // A law with its own columns is linear in them: each is a direction as it stands.
            if !law.linear.is_empty() {
                let mut terms = fit.terms.clone();
                terms.push(EffectTerm {
                    effect,
                    law: index,
                    values: point.clone(),
                });
                if let Some(d) = whitened_design(system, weights, &terms) {
                    for j in base..d.ncols() {
                        for c in 0..channels {
                            raw.push(fit.in_channel(d.column(j).clone_owned().as_slice(), c));
                        }
                    }
                }
            }
            // Null on the boundary: only one sign of the amplitude is admissible (Chernoff 1954).
            let one_sided = law.linear.is_empty()
                && amplitudes.len() == 1
                && law.parameters[amplitudes[0].0].range[0] >= 0.0;
            let term = EffectTerm {
                effect,
                law: index,
                values: point,
            };
            if let Some(signature) = build(term, amplitudes, one_sided, &raw, nuisance) {
                signatures.push(signature);
            }
        }
    }
    signatures
}

/// Below this share of itself a signature counts as absorbed by the nuisance parameters.
const ABSORBED_SHARE: f64 = 2e-3;

/// Projects raw signatures; none where nothing of them remains.
pub fn build(
    term: EffectTerm,
    amplitudes: Vec<(usize, f64)>,
    one_sided: bool,
    raw: &[DVector<f64>],
    nuisance: &Basis,
) -> Option<Signature> {
    let projected: Vec<DVector<f64>> = raw.iter().map(|v| nuisance.project_off(v)).collect();
    let mut share_left: f64 = 0.0;
    // What is nearly all taken up by the nuisances would be a direction of rounding.
    let mut own = Basis::default();
    for (v, p) in raw.iter().zip(&projected) {
        let size = v.norm();
        if size > 0.0 && p.norm() > ABSORBED_SHARE * size {
            share_left = share_left.max(p.norm() / size);
            own.push(p);
        }
    }
    (own.rank() > 0).then(|| Signature {
        term,
        amplitudes,
        one_sided,
        directions: own.vectors().to_vec(),
        projected,
        share_left,
    })
}

impl Signature {
    /// Degrees of freedom.
    pub(crate) fn dimension(&self) -> usize {
        self.directions.len()
    }

    /// Fall of the sum of squares if the signature is added to a residual; 0 where the sign is
    /// unphysical.
    pub fn gain(&self, residual: &DVector<f64>) -> f64 {
        if self.one_sided && self.projected[0].dot(residual) <= 0.0 {
            return 0.0;
        }
        self.directions
            .iter()
            .map(|q| q.dot(residual).powi(2))
            .sum()
    }

    /// Start values for a refit: amplitudes by least squares on the projected signatures.
    pub fn start(&self, residual: &DVector<f64>, law: &EffectModel) -> EffectTerm {
        let mut term = self.term.clone();
        let m = self.amplitudes.len();
        if m == 0 {
            return term;
        }
        // Normal equations of the projected signatures; amplitudes that look alike share by the
        // ridge.
        let a = DMatrix::from_fn(m, m, |i, j| self.projected[i].dot(&self.projected[j]));
        let ridge = 1e-9 * a.trace().max(1e-300);
        let b = DVector::from_fn(m, |i, _| self.projected[i].dot(residual));
        let Some(x) = (a + DMatrix::identity(m, m) * ridge)
            .cholesky()
            .map(|c| c.solve(&b))
        else {
            return term;
        };
        for (i, (slot, probe)) in self.amplitudes.iter().enumerate() {
            let [lo, hi] = law.parameters[*slot].range;
            // Start inside the range, not on its edge, where one-sided derivatives mislead.
            let inset = 0.02 * probe.abs();
            let lo = if lo == 0.0 { inset } else { 0.8 * lo };
            term.values[*slot] = (x[i] * probe).clamp(lo, 0.8 * hi);
        }
        term
    }
}

/// Signatures of every observable effect that is not yet in the fit, or can act once more beside
/// itself.
pub(crate) fn signatures_of_catalogue(
    system: &dyn MeasurementModel,
    fit: &Fit,
    weights: &Weights,
    nuisance: &Basis,
) -> Vec<Signature> {
    (0..system.catalogue().len())
        .into_par_iter()
        .filter(|&e| system.not_observable(e).is_none())
        .filter(|&e| system.catalogue()[e].superposes || fit.terms.iter().all(|t| t.effect != e))
        .flat_map(|e| signatures_of_effect(system, e, fit, weights, nuisance))
        .filter(|s| {
            fit.terms
                .iter()
                .all(|t| t.beside(&s.term, system.catalogue()))
        })
        .collect()
}
