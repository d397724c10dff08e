//! Places where the wire is nearest to the surface: local minima of d(r(s)) along the wire, where n
//! . t changes from negative to positive.
//!
//! Source of the root search: regula falsi with halving (Illinois), M. Dowell & P. Jarratt, BIT 11
//! (1971).

use super::centre_line::CurvePoint;
use super::configuration::Configuration;
use super::rod::ContactRod;
use super::surface::Surface;
use nalgebra::Vector3;
use wcal_mesh::ClosestPoint;

/// Sine of the angle below which a wire runs along the surface.
const ALONG_SINE: f64 = 0.1;
/// Contacts nearer to each other than this, in links, are one.
const MERGE_LINKS: f64 = 0.01;
/// Distances (links) at which the gap is evaluated around a place that touches: edges may lie close
/// together.
const PROBE_OFFSETS_LINKS: [f64; 4] = [0.02, 0.06, 0.15, 0.3];
/// A wire that lies along the surface within this over a link touches at the links' middles only,
/// mm.
const FLAT_MM: f64 = 1e-3;
/// Most evaluations of the surface for one lowest place.
const MAX_EVALUATIONS: usize = 40;

/// A place where the wire may touch.
#[derive(Debug, Clone)]
pub(super) struct ContactCandidate {
    pub place: CurvePoint,
    pub closest: ClosestPoint,
    /// Its place in space, mm.
    pub centre_mm: Vector3<f64>,
    pub gap_mm: f64,
    pub force_n: f64,
    /// Whether it is the lowest of the places around it: it then moves along the wire as the wire
    /// moves.
    pub slides: bool,
    /// Whether it is a plane: one that a refused step ran into, or a facet that is touched and not
    /// the nearest.
    pub plane_constraint: bool,
}

impl ContactRod {
    /// Where the wire may touch `surface`: minima of the gap, the tip, and places along flat
    /// surfaces; `before` touched before.
    pub(super) fn candidates<S: Surface>(
        &self,
        surface: &S,
        links: &Configuration,
        before: &[ContactCandidate],
    ) -> Vec<ContactCandidate> {
        let n = self.links();
        let within_mm = 2.5 * self.link_mm + self.radius_mm;
        let at = |place: &CurvePoint, within_mm: f64| {
            surface.closest_point(&place.point_mm(links), within_mm)
        };
        // Middles of the links, the tip, and closely around what is known to touch.
        let around: Vec<CurvePoint> = before
            .iter()
            .filter(|c| c.force_n > 0.0 || c.plane_constraint)
            .flat_map(|c| {
                PROBE_OFFSETS_LINKS
                    .iter()
                    .flat_map(|d| [c.place.at - d, c.place.at + d])
            })
            .filter(|x| (0.5..n as f64).contains(x))
            .map(|x| CurvePoint::new(x, n))
            .collect();
        let fixed = self.middles.iter().map(|place| (place, true));
        let mut places: Vec<(&CurvePoint, bool)> = fixed
            .chain(around.iter().map(|place| (place, false)))
            .collect();
        places.sort_by(|a, b| a.0.at.total_cmp(&b.0.at));
        let closest: Vec<Option<ClosestPoint>> = places
            .iter()
            .map(|(place, _)| at(place, within_mm))
            .collect();
        let slopes: Vec<Option<f64>> = places
            .iter()
            .zip(&closest)
            .map(|((place, _), closest)| closest.map(|x| x.normal.dot(&place.tangent(links))))
            .collect();
        // A bracket whose slope goes from falling to rising holds a minimum; a wire along a flat
        // surface touches at the links' middles.
        let mut found: Vec<(CurvePoint, ClosestPoint, bool)> = Vec::new();
        for (k, &(place, middle)) in places.iter().enumerate() {
            let (Some(here), Some(slope)) = (closest[k], slopes[k]) else {
                continue;
            };
            let along =
                middle && slope.abs() < ALONG_SINE && here.distance_mm < 1.5 * self.radius_mm;
            if along || (k + 1 == places.len() && slope <= 0.0) {
                found.push((*place, here, false));
            }
            if let Some(Some(beyond)) = slopes.get(k + 1)
                && slope < 0.0
                && *beyond > 0.0
                && !(middle && places[k + 1].1 && (beyond - slope) * self.link_mm < 8.0 * FLAT_MM)
            {
                let bracket = [place.at, places[k + 1].0.at];
                let lowest = self
                    .local_minimum(links, bracket, [slope, *beyond], |s| at(s, 2.0 * within_mm));
                found.extend(lowest.map(|(place, closest)| (place, closest, true)));
            }
        }
        self.merge_close(links, found)
    }

    /// The lowest gap between two places, in links, by regula falsi and halving on its slope.
    fn local_minimum(
        &self,
        links: &Configuration,
        [mut a, mut b]: [f64; 2],
        [mut fa, mut fb]: [f64; 2],
        at: impl Fn(&CurvePoint) -> Option<ClosestPoint>,
    ) -> Option<(CurvePoint, ClosestPoint)> {
        let mut best = None;
        for k in 0..MAX_EVALUATIONS {
            // The normal turns within hundredths of a millimetre at an edge: every third evaluation
            // halves the bracket.
            let x = if k % 3 == 2 {
                (a + b) / 2.0
            } else {
                (fb * a - fa * b) / (fb - fa)
            };
            let place = CurvePoint::new(x, self.links());
            let closest = at(&place)?;
            let slope = closest.normal.dot(&place.tangent(links));
            best = Some((place, closest));
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
    fn merge_close(
        &self,
        links: &Configuration,
        mut found: Vec<(CurvePoint, ClosestPoint, bool)>,
    ) -> Vec<ContactCandidate> {
        found.sort_by(|a, b| a.0.at.total_cmp(&b.0.at));
        let mut all: Vec<ContactCandidate> = Vec::new();
        for (place, closest, slides) in found {
            let gap_mm = closest.distance_mm - self.radius_mm;
            let candidate = ContactCandidate {
                place,
                closest,
                centre_mm: place.point_mm(links),
                gap_mm,
                force_n: 0.0,
                slides,
                plane_constraint: false,
            };
            match all.last_mut() {
                Some(last) if place.at - last.place.at < MERGE_LINKS => {
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
