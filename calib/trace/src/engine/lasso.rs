//! Cross-check of the screening: group lasso over all candidates at once, as a second-order cone programme.
//!
//! Yuan & Lin, J. R. Stat. Soc. B 68 (2006) 49: min 1/2 |r - sum Q_g b_g|^2 + sd sum w_g |b_g|, one signature a candidate. The weights
//! w_g are chi quantiles shared over the candidates, so that pure noise lets a candidate in with a chance of about 5 % in all.
//! Candidates whose sign is fixed by physics keep it. Solved by clarabel (interior point), whose answer needs no tuning.

use super::atoms::Atom;
use super::cone::minimise;
use super::null::atom_p;
use clarabel::solver::SupportedConeT;
use nalgebra::{DMatrix, DVector};
use statrs::distribution::{ChiSquared, ContinuousCDF};

/// Chance that pure noise lets any candidate in.
const LEVEL: f64 = 0.05;
/// A group below this many noise standard deviations is zero up to the solver's accuracy.
const ZERO_SD: f64 = 1e-3;

/// A candidate that the lasso keeps.
#[derive(Debug, Clone, PartialEq)]
pub struct Kept {
    /// Index in the catalogue.
    pub effect: usize,
    /// Size of its (shrunken) signature, noise standard deviations.
    pub size_sd: f64,
}

/// The most significant signature of each candidate.
fn best_of_each<'a>(atoms: &'a [Atom], residual: &DVector<f64>, ssr: f64, dof: f64) -> Vec<&'a Atom> {
    let p = |a: &Atom| atom_p(a, a.gain(residual), ssr, dof);
    let mut best: Vec<&Atom> = Vec::new();
    for atom in atoms {
        match best.iter_mut().find(|b| b.term.effect == atom.term.effect) {
            Some(kept) if p(kept) <= p(atom) => {}
            Some(kept) => *kept = atom,
            None => best.push(atom),
        }
    }
    best
}

/// Candidates kept on `residual` (noise `sd`), largest first; none where the solver gives up.
#[must_use]
pub fn group_lasso(atoms: &[Atom], residual: &DVector<f64>, dof: f64, sd: f64) -> Option<Vec<Kept>> {
    let groups = best_of_each(atoms, residual, residual.norm_squared(), dof);
    if groups.is_empty() || !(sd > 0.0) {
        return Some(Vec::new());
    }
    let directions: Vec<&DVector<f64>> = groups.iter().flat_map(|g| &g.directions).collect();
    let (n, g) = (directions.len(), groups.len());
    // Unknowns in noise units: coefficients of all directions, then one bound a group.
    let mut quadratic = DMatrix::zeros(n + g, n + g);
    let mut linear = vec![0.0; n + g];
    for i in 0..n {
        for j in i..n {
            quadratic[(i, j)] = directions[i].dot(directions[j]);
        }
        linear[i] = -directions[i].dot(residual) / sd;
    }
    let mut rows: Vec<Vec<(usize, f64)>> = Vec::new();
    let mut cones = Vec::new();
    let mut first = 0;
    for (k, group) in groups.iter().enumerate() {
        let d = group.dimension();
        let quantile = ChiSquared::new(d as f64).ok()?.inverse_cdf(1.0 - LEVEL / g as f64);
        linear[n + k] = quantile.sqrt();
        rows.push(vec![(n + k, -1.0)]);
        rows.extend((first..first + d).map(|i| vec![(i, -1.0)]));
        cones.push(SupportedConeT::SecondOrderConeT(d + 1));
        if group.one_sided {
            // Along its own signature the amplitude is positive.
            rows.push(vec![(first, -group.directions[0].dot(&group.projected[0]).signum())]);
            cones.push(SupportedConeT::NonnegativeConeT(1));
        }
        first += d;
    }
    let solution = minimise(&quadratic, &linear, &rows, &vec![0.0; rows.len()], &cones)?;
    let mut kept = Vec::new();
    let mut first = 0;
    for group in &groups {
        let part = &solution[first..first + group.dimension()];
        first += group.dimension();
        let size_sd = part.iter().map(|b| b * b).sum::<f64>().sqrt();
        if size_sd > ZERO_SD {
            kept.push(Kept { effect: group.term.effect, size_sd });
        }
    }
    kept.sort_by(|a, b| b.size_sd.total_cmp(&a.size_sd));
    Some(kept)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::candidate::Term;
    use crate::engine::atoms::build;
    use crate::engine::linear::Basis;

    fn atom(effect: usize, raw: &[DVector<f64>], one_sided: bool) -> Atom {
        let term = Term { effect, law: 0, values: vec![0.0] };
        build(term, vec![(0, 1.0)], one_sided, raw, &Basis::default()).unwrap()
    }

    fn wave(frequency: f64) -> DVector<f64> {
        DVector::from_fn(200, |i, _| (frequency * i as f64 / 200.0 * std::f64::consts::TAU).sin())
    }

    #[test]
    fn only_the_acting_group_is_kept_and_its_sign_counts() {
        let atoms = [
            atom(0, &[wave(1.0), wave(2.0)], false),
            atom(1, &[wave(3.0)], true),
            atom(2, &[wave(4.0), wave(5.0), wave(6.0)], false),
        ];
        let kept = |r: &DVector<f64>| -> Vec<usize> {
            group_lasso(&atoms, r, 190.0, 1.0).unwrap().iter().map(|k| k.effect).collect()
        };
        assert_eq!(kept(&(wave(3.0) * 0.8)), [1]);
        assert_eq!(kept(&(wave(3.0) * -0.8)), [0usize; 0], "a negative amplitude is no explanation");
        assert_eq!(kept(&(wave(5.0) * 0.9 + wave(1.0) * 1.8)), [0, 2]);
        assert_eq!(kept(&(wave(5.0) * 0.05)), [0usize; 0], "below the noise");
    }

    #[test]
    fn shrinkage_is_the_closed_form_of_one_group() {
        // One orthonormal direction: size = |q.r| - w sd.
        let only = [atom(0, &[wave(3.0)], false)];
        let kept = group_lasso(&only, &(wave(3.0) * 0.8), 190.0, 1.0).unwrap();
        let w = ChiSquared::new(1.0).unwrap().inverse_cdf(1.0 - LEVEL).sqrt();
        assert!((kept[0].size_sd - (8.0 - w)).abs() < 1e-5, "{kept:?}");
    }
}
