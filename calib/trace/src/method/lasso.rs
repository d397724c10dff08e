//! Cross-check of the screening: group lasso over all effects at once, as a second-order cone programme.
//!
//! Yuan & Lin, J. R. Stat. Soc. B 68 (2006) 49: min 1/2 |r - sum Q_g b_g|^2 + sd sum w_g |b_g|, one signature a effect. The weights
//! w_g are chi quantiles shared over the effects, so that pure noise lets a effect in with a chance of about 5 % in all.
//! Effects whose sign is fixed by physics keep it. Solved by clarabel (interior point), whose answer needs no tuning.

use super::min_p::signature_p;
use super::signature::Signature;
use super::socp::minimise;
use clarabel::solver::SupportedConeT;
use nalgebra::{DMatrix, DVector};
use statrs::distribution::{ChiSquared, ContinuousCDF};

/// Chance that pure noise lets any effect in.
const LEVEL: f64 = 0.05;
/// A group below this many noise standard deviations is zero up to the solver's accuracy.
const ZERO_SD: f64 = 1e-3;

/// A effect that the lasso keeps.
#[derive(Debug, Clone, PartialEq)]
pub struct SelectedEffect {
    /// Index in the catalogue.
    pub effect: usize,
    /// Size of its (shrunken) signature, noise standard deviations.
    pub size_sd: f64,
}

/// The most significant signature of each effect.
fn best_of_each<'a>(
    signatures: &'a [Signature],
    residual: &DVector<f64>,
    ssr: f64,
    dof: f64,
) -> Vec<&'a Signature> {
    let p = |a: &Signature| signature_p(a, a.gain(residual), ssr, dof);
    let mut best: Vec<&Signature> = Vec::new();
    for signature in signatures {
        match best.iter_mut().find(|b| b.term.effect == signature.term.effect) {
            Some(kept) if p(kept) <= p(signature) => {}
            Some(kept) => *kept = signature,
            None => best.push(signature),
        }
    }
    best
}

/// Effects kept on `residual` (noise `sd`), largest first; none where the solver gives up.
#[must_use]
pub fn group_lasso(
    signatures: &[Signature],
    residual: &DVector<f64>,
    dof: f64,
    sd: f64,
) -> Option<Vec<SelectedEffect>> {
    let groups = best_of_each(signatures, residual, residual.norm_squared(), dof);
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
            kept.push(SelectedEffect { effect: group.term.effect, size_sd });
        }
    }
    kept.sort_by(|a, b| b.size_sd.total_cmp(&a.size_sd));
    Some(kept)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effect::EffectTerm;
    use crate::method::linear::Basis;
    use crate::method::signature::build;

    fn signature(effect: usize, raw: &[DVector<f64>], one_sided: bool) -> Signature {
        let term = EffectTerm { effect, law: 0, values: vec![0.0] };
        build(term, vec![(0, 1.0)], one_sided, raw, &Basis::default()).unwrap()
    }

    fn wave(frequency: f64) -> DVector<f64> {
        DVector::from_fn(200, |i, _| (frequency * i as f64 / 200.0 * std::f64::consts::TAU).sin())
    }

    #[test]
    fn only_the_acting_group_is_kept_and_its_sign_counts() {
        let signatures = [
            signature(0, &[wave(1.0), wave(2.0)], false),
            signature(1, &[wave(3.0)], true),
            signature(2, &[wave(4.0), wave(5.0), wave(6.0)], false),
        ];
        let kept = |r: &DVector<f64>| -> Vec<usize> {
            group_lasso(&signatures, r, 190.0, 1.0).unwrap().iter().map(|k| k.effect).collect()
        };
        assert_eq!(kept(&(wave(3.0) * 0.8)), [1]);
        assert_eq!(kept(&(wave(3.0) * -0.8)), [0usize; 0], "a negative amplitude is no explanation");
        assert_eq!(kept(&(wave(5.0) * 0.9 + wave(1.0) * 1.8)), [0, 2]);
        assert_eq!(kept(&(wave(5.0) * 0.05)), [0usize; 0], "below the noise");
    }

    #[test]
    fn shrinkage_is_the_closed_form_of_one_group() {
        // One orthonormal direction: size = |q.r| - w sd.
        let only = [signature(0, &[wave(3.0)], false)];
        let kept = group_lasso(&only, &(wave(3.0) * 0.8), 190.0, 1.0).unwrap();
        let w = ChiSquared::new(1.0).unwrap().inverse_cdf(1.0 - LEVEL).sqrt();
        assert!((kept[0].size_sd - (8.0 - w)).abs() < 1e-5, "{kept:?}");
    }
}
