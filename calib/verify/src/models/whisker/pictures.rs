//! The second witness: what pairs of pictures show of the poses, beside the wavelengths.
//!
//! A pair shows `z_i` = (groove position, contact arc length, centre line across at some stations);
//! the rod predicts it as `g_i`:
//!
//! ```text
//! z_i - g_i(terms) = e_i + S_i q,      cov(e_i) = N_i = O_i O_i' + floor^2 I,     cov(q) = C          (errors of shapes.json)
//! u_i = L_i^-1 (z_i - g_i),   A_i = L_i^-1 S_i C^(1/2),   L_i L_i' = N_i
//! w = (I + A A')^(-1/2) u = u + A M A' u,     M = V ((1 + s^2)^(-1/2) - 1) / s^2 V',     A' A = V s^2 V'
//! ```
//!
//! so that `w` is white once the errors `q` that all pairs share (cameras, tags, light) are
//! integrated out. Pairs whose readings do not count are zero in `w` and have no part in `M`.
//! Source: JCGM 102:2011, 6.2; the symmetric root keeps one value a row.
//!
//! Where the pairs scatter less than they state, their own errors are smaller: `N_i` becomes
//! `f^2 N_i` with f from the residuals. What all pairs share does not scatter and stays as it is
//! stated.
//!
//! A pair without `errors` shows the contact alone. Nobody says which part of its stated covariance
//! all pairs share, so all of it may be: it counts once as the pair's own and once more as one
//! shift of every such pair.

use super::kept::Kept;
use super::path::WhiskerPath;
pub use super::picture_observations::Derivatives;
use super::picture_observations::{Pair, observe, root_of, values, with_tolerances};
pub use super::picture_observations::{PairChange, PairObservation};
use nalgebra::{DMatrix, DVector};
use std::sync::Arc;
use wcal_core::observation::{PairLeftOut, SessionShapes, WhiskerRow};

/// Masks whose `M` is kept.
const KEPT_MASKS: usize = 32;

/// Every pair that counts beside the wavelengths.
pub struct Pictures {
    pairs: Vec<Pair>,
    /// Reading of each value.
    pub(super) readings: Arc<Vec<usize>>,
    /// Whitened derivatives by the independent shared errors, values x errors.
    shared: DMatrix<f64>,
    /// Share of the stated own errors that counts.
    pub(super) own_sd_share: f64,
    /// `M` by the readings that count.
    roots: Kept<Vec<bool>, DMatrix<f64>>,
    /// Pairs that have a row and no place here, and why.
    pub left_out: Vec<PairLeftOut>,
}

impl Pictures {
    /// Pairs of the rows of `path`; none where there are none.
    pub fn new(
        rows: &[WhiskerRow],
        path: &WhiskerPath,
        shapes: Option<&SessionShapes>,
    ) -> Option<Self> {
        let shapes = shapes?;
        let factor = root_of(&with_tolerances(shapes));
        let (mut pairs, mut readings, mut shared) = (Vec::new(), Vec::new(), Vec::new());
        let mut left_out = Vec::new();
        for (reading, (&row, node)) in path.rows.iter().zip(path.reading_nodes()).enumerate() {
            let Some(document) = &rows[row].pair else {
                continue;
            };
            let loaded = path.nodes[node].loaded_line().and(document.groove.as_ref());
            let found = loaded.and_then(|groove| {
                observe(document, groove, reading, node, readings.len(), shapes)
            });
            let Some((mut pair, columns)) = found else {
                let why = "its errors or its reading say nothing of a contact".to_owned();
                left_out.push(PairLeftOut {
                    name: document.name.clone(),
                    why,
                });
                continue;
            };
            readings.extend(std::iter::repeat_n(reading, columns.nrows()));
            // S C^(1/2): independent shared errors of one standard deviation each.
            let columns = columns * &factor;
            // Trace of S C S': the shared part of the variance of the groove's position.
            pair.groove_mm2 += columns.rows(0, 3).norm_squared();
            shared.push(&pair.whitening * columns);
            pairs.push(pair);
        }
        let count = pairs.len();
        for (k, pair) in pairs.iter_mut().enumerate() {
            pair.seen.place = k as f64 / (count - 1).max(1) as f64;
        }
        let mut all = DMatrix::zeros(readings.len(), factor.ncols());
        for (pair, own) in pairs.iter().zip(&shared) {
            all.rows_mut(pair.first, own.nrows()).copy_from(own);
        }
        (count > 0).then(|| Self {
            pairs,
            readings: Arc::new(readings),
            shared: all,
            own_sd_share: 1.0,
            roots: Kept::at_most(KEPT_MASKS),
            left_out,
        })
    }

    /// The same pairs with `share` of the own errors that they state.
    pub(crate) fn with_own_share(&self, share: f64) -> Self {
        // Whitening divides by the errors, so fewer errors stretch it; shared ones keep their size
        // and weigh more.
        let stretch = self.own_sd_share / share;
        let smaller = |p: &Pair| Pair {
            whitening: &p.whitening * stretch,
            ..p.clone()
        };
        Self {
            pairs: self.pairs.iter().map(smaller).collect(),
            readings: self.readings.clone(),
            shared: &self.shared * stretch,
            own_sd_share: share,
            roots: Kept::at_most(KEPT_MASKS),
            left_out: self.left_out.clone(),
        }
    }

    /// Pairs.
    pub(super) fn count(&self) -> usize {
        self.pairs.len()
    }

    /// Distance of the contact from where it is seen that the stated covariances give, root mean
    /// square, mm.
    pub fn contact_floor_mm(&self) -> f64 {
        (self.pairs.iter().map(|p| p.groove_mm2).sum::<f64>() / self.pairs.len().max(1) as f64)
            .sqrt()
    }

    /// Node on the path of each pair.
    pub(super) fn nodes(&self) -> Vec<usize> {
        self.pairs.iter().map(|p| p.node).collect()
    }

    /// Reading, arc lengths of the stations and what the pair shows.
    pub fn each(&self) -> impl Iterator<Item = (usize, &[f64], &PairObservation)> {
        self.pairs
            .iter()
            .map(|p| (p.reading, p.stations_mm.as_slice(), &p.seen))
    }

    /// Measured less predicted, white with unit variance; zero where the reading does not count.
    pub fn whitened(
        &self,
        predicted: &[PairObservation],
        counts: impl Fn(usize) -> bool,
    ) -> DVector<f64> {
        let mut u = DVector::zeros(self.readings.len());
        // By its own errors each pair is whitened alone.
        for (pair, g) in self.pairs.iter().zip(predicted) {
            if counts(pair.reading) {
                let off = pair.difference(g);
                u.rows_mut(pair.first, off.len())
                    .copy_from(&(&pair.whitening * off));
            }
        }
        let mask: Vec<bool> = self.pairs.iter().map(|p| counts(p.reading)).collect();
        let Some(root) = self.roots.get(mask.clone(), || Some(self.root(&mask))) else {
            return u;
        };
        // What all pairs share is integrated out: a symmetric root of low rank beside the identity.
        let mut taken = &self.shared * (&*root * self.shared.tr_mul(&u));
        for (value, reading) in taken.iter_mut().zip(self.readings.iter()) {
            if !counts(*reading) {
                *value = 0.0;
            }
        }
        u + taken
    }

    /// `M` over the pairs of `mask`.
    fn root(&self, mask: &[bool]) -> DMatrix<f64> {
        let mut counted = self.shared.clone();
        for (pair, counts) in self.pairs.iter().zip(mask) {
            if !counts {
                counted
                    .rows_mut(pair.first, pair.whitening.nrows())
                    .fill(0.0);
            }
        }
        // A' A is as small as the shared errors are few; A A' has a row for every value.
        let parts = counted.tr_mul(&counted).symmetric_eigen();
        // ((1 + s^2)^(-1/2) - 1) / s^2 tends to -1/2 where an error moves nothing.
        let shrink = |s2: f64| {
            if s2 < 1e-9 {
                -0.5
            } else {
                ((1.0 + s2).sqrt().recip() - 1.0) / s2
            }
        };
        let middle = DMatrix::from_diagonal(&parts.eigenvalues.map(|v| shrink(v.max(0.0))));
        &parts.eigenvectors * middle * parts.eigenvectors.transpose()
    }
}

impl Pair {
    /// Measured less predicted in the observed values.
    fn difference(&self, predicted: &PairObservation) -> DVector<f64> {
        let groove = self.seen.groove_mm - predicted.groove_mm;
        let stations = self
            .seen
            .stations_mm
            .iter()
            .zip(&predicted.stations_mm)
            .map(|(a, b)| a - b);
        let change = PairChange {
            groove_mm: groove,
            arclength_mm: self.seen.arclength_mm - predicted.arclength_mm,
            stations_mm: stations.collect(),
        };
        values(&change, &self.normals)
    }
}
