//! A contact of which the readings do not tell whether it stays near its point of the object or slides over it: both explain them.
//!
//! ```text
//! p(P | m) = p(P | m, fixed) / 2 + p(P | m, sliding) / 2
//! mean       (a + b) / 2                                    a, b: means of the two, d = a - b
//! covariance (A + B) / 2 + d d' / 4
//! region     those of both together
//! ```
//!
//! Where the path of the sliding contact has no place yet (its first light readings), d and B are those of the nearest reading that has one.

use crate::estimator::{Contact, ContactEstimate};
use crate::known_motion::{EpisodeContact, Region};
use crate::sliding::SlidingContact;

/// The contact at reading k, whose fixed point is known by `held` and `regions`.
pub fn fixed_or_sliding(
    k: usize,
    held: &[EpisodeContact],
    regions: &[Region],
    sliding: &SlidingContact,
) -> Contact {
    let located = (0..sliding.places.len()).filter(|j| sliding.places[*j].place_mm.is_some());
    let near = located.min_by_key(|j| j.abs_diff(k)).unwrap_or(k);
    let slid = &sliding.places[near];
    let off = held[near].place_mm.zip(slid.place_mm).map(|(a, b)| a - b).unwrap_or_default();
    let place = EpisodeContact {
        place_mm: held[k].place_mm.map(|a| a - off / 2.0),
        covariance_mm2: (held[k].covariance_mm2 + slid.covariance_mm2) / 2.0 + off * off.transpose() / 4.0,
        ..held[k].clone()
    };
    Contact {
        estimate: ContactEstimate::of_place(&place),
        regions: together(regions, &sliding.regions[near]),
        on_object: true,
        ..Contact::default()
    }
}

/// Two lists of regions of equal weight as one; what overlaps is joined.
fn together(a: &[Region], b: &[Region]) -> Vec<Region> {
    let half = |r: &Region| Region { probability: r.probability / 2.0, ..*r };
    let mut all: Vec<Region> = a.iter().chain(b).map(half).collect();
    all.sort_by(|a, b| a.from_mm.total_cmp(&b.from_mm));
    let mut joined: Vec<Region> = Vec::new();
    for piece in all {
        match joined.last_mut().filter(|last| piece.from_mm <= last.to_mm) {
            Some(last) => {
                last.to_mm = last.to_mm.max(piece.to_mm);
                last.probability += piece.probability;
            }
            None => joined.push(piece),
        }
    }
    joined
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Matrix3, Vector3};

    fn place(x: f64, sd_mm: f64) -> EpisodeContact {
        EpisodeContact {
            place_mm: Some(Vector3::new(x, 0.0, 0.0)),
            covariance_mm2: Matrix3::identity() * sd_mm * sd_mm,
            contact: 1.0,
            outlier: false,
        }
    }

    fn region(from_mm: f64, to_mm: f64) -> Region {
        Region { from_mm, to_mm, probability: 0.95 }
    }

    #[test]
    fn what_is_not_told_apart_has_the_uncertainty_of_both() {
        let mut sliding = SlidingContact::nothing(3);
        sliding.places[1] = place(31.0, 0.3);
        sliding.regions[1] = vec![region(30.4, 31.6)];
        let held = [place(30.0, 0.1), place(30.0, 0.1), place(30.5, 0.1)];
        for (k, mean) in [(0, 30.5), (1, 30.5), (2, 31.0)] {
            let found = fixed_or_sliding(k, &held, &[region(29.8, 30.2)], &sliding);
            let at = found.estimate.unwrap();
            // (0.01 + 0.09) / 2 + 1 / 4.
            assert!((at.place_mm.x - mean).abs() < 1e-12 && (at.covariance_mm2[(0, 0)] - 0.3).abs() < 1e-12);
            assert_eq!(found.regions.len(), 2, "{:?}", found.regions);
        }
    }

    #[test]
    fn regions_that_overlap_are_one() {
        let joined = together(&[region(10.0, 12.0)], &[region(11.5, 13.0), region(20.0, 21.0)]);
        let ends: Vec<[f64; 2]> = joined.iter().map(|r| [r.from_mm, r.to_mm]).collect();
        assert_eq!(ends, [[10.0, 13.0], [20.0, 21.0]]);
        assert!((joined[0].probability - 0.95).abs() < 1e-12);
    }
}
