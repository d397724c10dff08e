//! Screening by all subsets: which sets of terms explain most in the projected linear model, from
//! the Gram matrix of their signatures.

use super::linear::transposed_product;
use super::signature::Signature;
use crate::effect::{Catalogue, EffectTerm, TermKey, keys};
use nalgebra::{DMatrix, DVector};

/// A set of signatures and what its linear model leaves.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Subset {
    /// Indices of the signatures.
    pub signatures: Vec<usize>,
    /// Fall of the sum of squares in units of the variance, less twice the parameters (Akaike);
    /// larger is better.
    pub merit: f64,
}

/// Signatures (laws, points of the shape grids) tried for everything that a term can stand for.
const OF_A_KEY: usize = 2;

/// The sets of `size` terms with the largest merit, best first, at most `keep`. One-sided
/// amplitudes of the wrong sign are left out.
pub(crate) fn best_subsets(
    catalogue: &Catalogue,
    signatures: &[Signature],
    residual: &DVector<f64>,
    size: usize,
    variance: f64,
    keep: usize,
) -> Vec<Subset> {
    // Each key keeps its best few: sets of all points of all grids would be too many.
    let chosen = sure_screening(catalogue, signatures, residual);
    let columns: Vec<&DVector<f64>> = chosen
        .iter()
        .flat_map(|&i| &signatures[i].directions)
        .collect();
    let starts: Vec<usize> = chosen
        .iter()
        .scan(0, |at, &i| {
            let here = *at;
            *at += signatures[i].dimension();
            Some(here)
        })
        .collect();
    let mut matrix = DMatrix::zeros(residual.len(), columns.len());
    for (mut to, from) in matrix.column_iter_mut().zip(&columns) {
        to.copy_from(from);
    }
    // Everything that a subset needs stands in one Gram matrix: no subset is fitted on the
    // readings.
    let (gram, along) = (
        transposed_product(&matrix, &matrix),
        matrix.tr_mul(residual),
    );
    let mut found: Vec<Subset> = Vec::new();
    let mut members = Vec::new();
    combine(
        &mut members,
        0,
        size,
        &|members: &[usize]| {
            let new = members[members.len() - 1];
            let term = |m: usize| &signatures[chosen[m]].term;
            members[..members.len() - 1]
                .iter()
                .all(|&m| term(m).beside(term(new), catalogue))
        },
        chosen.len(),
        &mut |members: &[usize]| {
            let own: Vec<usize> = members
                .iter()
                .flat_map(|&m| starts[m]..starts[m] + signatures[chosen[m]].dimension())
                .collect();
            // Least squares of the subset alone, from its block of the Gram matrix.
            let small = DMatrix::from_fn(own.len(), own.len(), |i, j| gram[(own[i], own[j])]);
            let right = DVector::from_iterator(own.len(), own.iter().map(|&k| along[k]));
            let Some(solution) = small.cholesky().map(|c| c.solve(&right)) else {
                return;
            };
            let mut at = 0;
            let mut price = 0.0;
            // A one-sided amplitude below zero is no explanation; each parameter has Akaike's
            // price.
            for &m in members {
                let signature = &signatures[chosen[m]];
                if signature.one_sided && solution[at] <= 0.0 {
                    return;
                }
                at += signature.dimension();
                price += 2.0
                    * (signature.dimension() + signature.term.values.len()
                        - signature.amplitudes.len()) as f64;
            }
            // b'G b = r'b is what the normal equations take off the squares.
            let merit = right.dot(&solution) / variance - price;
            found.push(Subset {
                signatures: members.iter().map(|&m| chosen[m]).collect(),
                merit,
            });
        },
    );
    found.sort_by(|a, b| b.merit.total_cmp(&a.merit));
    let mut seen: Vec<Vec<TermKey>> = Vec::new();
    found.retain(|s| {
        let key = s.key(catalogue, signatures);
        let new = !seen.contains(&key);
        seen.push(key);
        new
    });
    found.truncate(keep);
    found
}

impl Subset {
    /// What its terms stand for.
    pub(crate) fn key(&self, catalogue: &Catalogue, signatures: &[Signature]) -> Vec<TermKey> {
        let terms: Vec<EffectTerm> = self
            .signatures
            .iter()
            .map(|&i| signatures[i].term.clone())
            .collect();
        keys(&terms, catalogue)
    }
}

/// The best few signatures of everything that a term can stand for; neighbours on a grid of shapes
/// are one.
fn sure_screening(
    catalogue: &Catalogue,
    signatures: &[Signature],
    residual: &DVector<f64>,
) -> Vec<usize> {
    let gains: Vec<f64> = signatures.iter().map(|a| a.gain(residual)).collect();
    let mut order: Vec<usize> = (0..signatures.len()).collect();
    order.sort_by(|&a, &b| gains[b].total_cmp(&gains[a]));
    let mut kept: Vec<usize> = Vec::new();
    for i in order {
        let term = &signatures[i].term;
        let own: Vec<usize> = kept
            .iter()
            .copied()
            .filter(|&k| signatures[k].term.key(catalogue) == term.key(catalogue))
            .collect();
        let several = catalogue[term.effect].superposes;
        let apart = || {
            own.iter()
                .all(|&k| signatures[k].term.beside(term, catalogue))
        };
        if own.len() < OF_A_KEY && (!several || apart()) {
            kept.push(i);
        }
    }
    kept
}

fn combine(
    members: &mut Vec<usize>,
    from: usize,
    size: usize,
    fits: &dyn Fn(&[usize]) -> bool,
    count: usize,
    visit: &mut dyn FnMut(&[usize]),
) {
    if members.len() == size {
        visit(members);
        return;
    }
    for next in from..count {
        members.push(next);
        if fits(members) {
            combine(members, next + 1, size, fits, count, visit);
        }
        members.pop();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effect::{Effect, law};
    use crate::method::linear::Basis;
    use crate::method::signature::build;

    /// Effects with a place; the last of four can act more than once.
    fn catalogue() -> Vec<Effect> {
        let place = law("only").shape("place", "1", [0.0, 9.0], &[1.0, 2.0, 3.0, 4.0, 5.0, 6.0]);
        let placed = |k| Effect {
            superposes: k == 3,
            ..Effect::new("placed", "", vec![place.clone()])
        };
        (0..4).map(placed).collect()
    }

    fn signature(effect: usize, v: &DVector<f64>, one_sided: bool) -> Signature {
        let term = EffectTerm {
            effect,
            law: 0,
            values: vec![1.0],
        };
        build(
            term,
            vec![(0, 1.0)],
            one_sided,
            std::slice::from_ref(v),
            &Basis::default(),
        )
        .unwrap()
    }

    #[test]
    fn a_pair_that_no_single_shows_is_found() {
        let wave = |k: f64| DVector::from_fn(50, |i, _| (0.2 * k * i as f64).sin());
        // The sum of 0 and 1 looks most like 2; the pair leaves nothing.
        let (a, b) = (wave(1.0), wave(1.7));
        let both = &a + &b;
        let decoy = &both + wave(4.0) * 0.6;
        let signatures = [
            signature(0, &a, false),
            signature(1, &b, false),
            signature(2, &decoy, false),
            signature(3, &wave(6.0), false),
        ];
        let single = best_subsets(&catalogue(), &signatures, &both, 1, 0.01, 1);
        assert_eq!(single[0].signatures, [2]);
        let pair = best_subsets(&catalogue(), &signatures, &both, 2, 0.01, 1);
        let mut found = pair[0].signatures.clone();
        found.sort_unstable();
        assert_eq!(found, [0, 1]);
    }

    #[test]
    fn a_wrong_sign_is_no_explanation() {
        let a = DVector::from_fn(20, |i, _| (0.3 * i as f64).sin());
        let b = DVector::from_fn(20, |i, _| (0.9 * i as f64).cos());
        let signatures = [signature(0, &a, true), signature(1, &b, false)];
        assert_eq!(
            best_subsets(&catalogue(), &signatures, &(&b - &a), 2, 0.01, 3),
            []
        );
        assert_eq!(
            best_subsets(&catalogue(), &signatures, &(&b + &a), 2, 0.01, 3).len(),
            1
        );
    }
    #[test]
    fn an_effect_that_acts_severally_stands_beside_itself_where_shapes_differ() {
        let wave = |k: f64| DVector::from_fn(60, |i, _| (0.2 * k * i as f64).sin());
        let at = |effect: usize, place: f64| {
            let term = EffectTerm {
                effect,
                law: 0,
                values: vec![place],
            };
            build(term, Vec::new(), false, &[wave(place)], &Basis::default()).unwrap()
        };
        let both = wave(1.0) + wave(5.0);
        let pair = |effect: usize, second: f64| {
            let signatures = [at(effect, 1.0), at(effect, second), at(0, 3.3)];
            let found = best_subsets(&catalogue(), &signatures, &both, 2, 0.01, 1);
            let key = found.first().map(|s| s.key(&catalogue(), &signatures));
            key.map(|k| {
                k.iter()
                    .filter(|k| k.effect == effect)
                    .map(|k| k.instance)
                    .collect::<Vec<_>>()
            })
        };
        assert_eq!(pair(3, 5.0), Some(vec![0, 1]));
        // Controls: an effect whose laws are rivals, and two places that are one.
        assert_eq!(pair(2, 5.0), Some(vec![0]));
        assert_eq!(pair(3, 1.5), Some(vec![0]));
    }
}
