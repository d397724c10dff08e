//! Does a name rest on one level (one stimulus, one cycle, one trajectory) alone? With a set L of
//! readings deleted a least squares fit leaves
//!
//! ```text
//! S_(-L) = S - e_L' (I - H_LL)^-1 e_L,     H = Q Q',    (I - Q_L Q_L')^-1 = I + Q_L (I - Q_L' Q_L)^-1 Q_L'
//! ```
//!
//! with e the residual and Q an orthonormal basis of the model's tangent space (Cook & Weisberg,
//! "Residuals and Influence in Regression" (1982), 2.2). Directions that L alone determines
//! (eigenvalue 1 of Q_L' Q_L) go with it. A name survives where the F test of its term on what
//! remains still speaks for it.

use super::fit::Fit;
use super::min_p::f_test;
use super::signature::nuisance_basis;
use crate::levels::DELETION;
use nalgebra::DVector;

/// An eigenvalue this near to one belongs to a direction that the deleted readings alone determine.
const OWN_DIRECTION: f64 = 1e-9;

/// What a model leaves of the readings outside a set, and its rank there.
struct DeletedFit {
    ssr: f64,
    rank: f64,
}

/// A fit whose readings can be deleted in sets.
struct DeletionDiagnostics {
    residual: DVector<f64>,
    basis: super::linear::Basis,
    readings: usize,
    channels: usize,
}

impl DeletionDiagnostics {
    fn of(fit: &Fit) -> Self {
        let (readings, channels) = fit.residual.shape();
        Self {
            residual: fit.stacked(),
            basis: nuisance_basis(fit),
            readings,
            channels,
        }
    }

    fn without(&self, set: &[usize]) -> DeletedFit {
        let own: Vec<usize> = (0..self.channels)
            .flat_map(|c| set.iter().map(move |i| c * self.readings + i))
            .collect();
        let q = nalgebra::DMatrix::from_fn(own.len(), self.basis.rank(), |k, j| {
            self.basis.vectors()[j][own[k]]
        });
        let e = DVector::from_iterator(own.len(), own.iter().map(|&k| self.residual[k]));
        // In the eigenbasis of Q_L' Q_L the inverse of the module's head is diagonal, and its
        // singular directions show.
        let eigen = (q.transpose() * &q).symmetric_eigen();
        let along = eigen.eigenvectors.transpose() * (q.transpose() * &e);
        let (mut fall, mut rank) = (e.norm_squared(), 0.0);
        for (value, part) in eigen.eigenvalues.iter().zip(along.iter()) {
            if 1.0 - value > OWN_DIRECTION {
                fall += part * part / (1.0 - value);
                rank += 1.0;
            }
        }
        DeletedFit {
            ssr: (self.residual.norm_squared() - fall).max(0.0),
            rank,
        }
    }
}

/// The first of `sets` without which a term is no longer supported: `with` it and `without` it
/// fitted on all readings.
pub(crate) fn influential_set(with: &Fit, without: &Fit, sets: &[Vec<usize>]) -> Option<usize> {
    let (rich, plain) = (
        DeletionDiagnostics::of(with),
        DeletionDiagnostics::of(without),
    );
    let values = with.dof + rich.basis.rank() as f64;
    sets.iter().position(|set| {
        let (a, b) = (rich.without(set), plain.without(set));
        // Where the deletion takes the term's only direction, the term rests on the set alone.
        let extra = a.rank - b.rank;
        let dof = values - (set.len() * rich.channels) as f64 - b.rank;
        let p = f_test(b.ssr - a.ssr, b.ssr, dof, extra.round() as usize);
        extra < 0.5 || p.is_none_or(|p| p >= DELETION)
    })
}
