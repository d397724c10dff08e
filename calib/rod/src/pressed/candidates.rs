//! Places where the wire is nearest to the surface.

use super::curve::Spot;
use super::{Near, Surface};
use crate::chain::{Chain, Links};
use nalgebra::Vector3;

/// Sine of the angle below which a wire runs along the surface.
const ALONG: f64 = 0.1;
/// Contacts nearer to each other than this, in links, are one.
const APART: f64 = 0.01;
/// Distances (links) at which the wire is looked at around a place that touches: edges may lie close together.
const AROUND: [f64; 4] = [0.02, 0.06, 0.15, 0.3];
/// A wire that lies along the surface within this over a link touches at the links' middles only, mm.
const FLAT_MM: f64 = 1e-3;
/// Most looks at the surface for one lowest place.
const MOST_LOOKS: usize = 40;

/// A place where the wire may touch.
#[derive(Debug, Clone)]
pub(super) struct Candidate {
    pub spot: Spot,
    pub near: Near,
    /// Its place in space, mm.
    pub centre_mm: Vector3<f64>,
    pub gap_mm: f64,
    pub force_n: f64,
    /// Whether it is the lowest of the places around it: it then moves along the wire as the wire moves.
    pub slides: bool,
    /// Whether it is a plane: one that a refused step ran into, or a facet that is touched and not the nearest.
    pub met: bool,
}

impl Chain {
    pub(super) fn candidates<S: Surface>(
        &self,
        surface: &S,
        links: &Links,
        before: &[Candidate],
    ) -> Vec<Candidate> {
        let n = self.links();
        let within_mm = 2.5 * self.link_mm + self.radius_mm;
        let at = |spot: &Spot, within_mm: f64| surface.near(&spot.point_mm(self, links), within_mm);
        // Middles of the links, the tip, and closely around what is known to touch.
        let around: Vec<Spot> = before
            .iter()
            .filter(|c| c.force_n > 0.0 || c.met)
            .flat_map(|c| AROUND.iter().flat_map(|d| [c.spot.at - d, c.spot.at + d]))
            .filter(|x| (0.5..n as f64).contains(x))
            .map(|x| Spot::new(x, n))
            .collect();
        let fixed = self.middles.iter().map(|spot| (spot, true));
        let mut spots: Vec<(&Spot, bool)> = fixed.chain(around.iter().map(|spot| (spot, false))).collect();
        spots.sort_by(|a, b| a.0.at.total_cmp(&b.0.at));
        let near: Vec<Option<Near>> = spots.iter().map(|(spot, _)| at(spot, within_mm)).collect();
        let slopes: Vec<Option<f64>> = spots
            .iter()
            .zip(&near)
            .map(|((spot, _), near)| near.map(|x| x.normal.dot(&spot.tangent(self, links))))
            .collect();
        let mut found: Vec<(Spot, Near, bool)> = Vec::new();
        for (k, &(spot, middle)) in spots.iter().enumerate() {
            let (Some(here), Some(slope)) = (near[k], slopes[k]) else { continue };
            let along = middle && slope.abs() < ALONG && here.distance_mm < 1.5 * self.radius_mm;
            if along || (k + 1 == spots.len() && slope <= 0.0) {
                found.push((*spot, here, false));
            }
            if let Some(Some(beyond)) = slopes.get(k + 1)
                && slope < 0.0
                && *beyond > 0.0
                && !(middle && spots[k + 1].1 && (beyond - slope) * self.link_mm < 8.0 * FLAT_MM)
            {
                let bracket = [spot.at, spots[k + 1].0.at];
                let lowest = self.lowest(links, bracket, [slope, *beyond], |s| at(s, 2.0 * within_mm));
                found.extend(lowest.map(|(spot, near)| (spot, near, true)));
            }
        }
        self.apart(links, found)
    }

    /// The lowest gap between two places, in links, by regula falsi and halving on its slope.
    fn lowest(
        &self,
        links: &Links,
        [mut a, mut b]: [f64; 2],
        [mut fa, mut fb]: [f64; 2],
        at: impl Fn(&Spot) -> Option<Near>,
    ) -> Option<(Spot, Near)> {
        let mut best = None;
        for k in 0..MOST_LOOKS {
            // The normal turns within hundredths of a millimetre at an edge: every third look halves the bracket.
            let x = if k % 3 == 2 { (a + b) / 2.0 } else { (fb * a - fa * b) / (fb - fa) };
            let spot = Spot::new(x, self.links());
            let near = at(&spot)?;
            let slope = near.normal.dot(&spot.tangent(self, links));
            best = Some((spot, near));
            if slope.abs() < 1e-7 || b - a < 1e-8 {
                break;
            }
            if slope < 0.0 {
                (a, fa, fb) = (x, slope, fb / 2.0);
            } else {
                (b, fb, fa) = (x, slope, fa / 2.0);
            }
        }
        best
    }

    /// Of places that are close to each other, the nearer to the surface.
    fn apart(&self, links: &Links, mut found: Vec<(Spot, Near, bool)>) -> Vec<Candidate> {
        found.sort_by(|a, b| a.0.at.total_cmp(&b.0.at));
        let mut all: Vec<Candidate> = Vec::new();
        for (spot, near, slides) in found {
            let gap_mm = near.distance_mm - self.radius_mm;
            let candidate = Candidate {
                spot,
                near,
                centre_mm: spot.point_mm(self, links),
                gap_mm,
                force_n: 0.0,
                slides,
                met: false,
            };
            match all.last_mut() {
                Some(last) if spot.at - last.spot.at < APART => {
                    if candidate.gap_mm < last.gap_mm {
                        *last = candidate;
                    }
                }
                _ => all.push(candidate),
            }
        }
        all
    }
}
