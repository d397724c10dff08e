//! The information that transverse moments alone have about a contact: a posterior along an arc.
//!
//! Every node k of the inverse explains the moments m by a place p_k with the normal n_k
//! (`StaticInverse`); nothing but a prior weighs them:
//!
//! `w_k ~ l_k` on the wire (l_k the length that the node stands for), `TIP` in all at the tip's
//! tilts; 0 where m cannot come from; `p = sum w_k p_k`,
//! `C = sum w_k ((p_k - p)(p_k - p)' + c_k^2 s^2 n_k n_k') + s_min^2 1`, `c = |dp.n/dm|`, `s` the
//! moments' standard deviation.

use crate::TrackError;
use crate::arc_posterior::ArcDensity;
use crate::calibrated_wire::CalibratedWire;
use crate::estimator::{Contact, ContactEstimate};
use crate::known_motion::contact_path::LOADED_SDS;
use crate::reading::{Moments, squares};
use nalgebra::{Matrix3, Vector3};
use wcal_core::stream::Flags;
use wcal_network::inverse::{InverseGrid, InverseSolution, Node, StaticInverse};
use wcal_network::network::Prediction;

/// Probability that a contact of which nothing is known is one of the tip. An assumption.
const TIP: f64 = 0.15;
/// Standard deviation added for model errors, mm: friction tilts the force, and a wire differs from
/// its model.
const MIN_SD_MM: f64 = 0.5;

impl From<&Prediction> for ContactEstimate {
    fn from(p: &Prediction) -> Self {
        let vector = |v: [f32; 3]| Vector3::from(v.map(f64::from));
        Self {
            probability: f64::from(p.contact),
            place_mm: vector(p.point_mm),
            covariance_mm2: Matrix3::from_fn(|i, j| f64::from(p.covariance_mm2[i][j])),
            normal: vector(p.normal),
        }
    }
}

/// Length that each node stands for, mm; further tilts of the tip stand for none.
fn lengths(nodes: &[Node]) -> Vec<f64> {
    let at = |k: usize| nodes[k].arclength_mm;
    let last = nodes.len() - 1;
    // Half of the distance between the neighbours: the trapezoid rule.
    let on_wire = |k: usize| 0.5 * (at((k + 1).min(last)) - at(k.saturating_sub(1)));
    (0..nodes.len())
        .map(|k| if nodes[k].tilt > 0.0 { 0.0 } else { on_wire(k) })
        .collect()
}

/// The answer to moments (N mm) of which nothing else is known; probabilities and number of
/// contacts are those of `answer`.
fn static_arc(
    inverse: &StaticInverse,
    moment_nmm: [f64; 2],
    sd_nmm: [f64; 2],
    answer: &Prediction,
) -> Prediction {
    let mut solutions = Vec::new();
    inverse.solutions(moment_nmm, &mut solutions);
    let (nodes, lengths) = (&inverse.nodes, lengths(&inverse.nodes));
    // A contact anywhere on the wire is as probable by length; the tip has its own mass, shared by
    // its tilts.
    let tilts = nodes.iter().filter(|n| n.tilt > 0.0).count().max(1) as f64;
    let whole: f64 = lengths.iter().sum();
    let prior = |k: usize| {
        if nodes[k].tilt > 0.0 {
            TIP / tilts
        } else {
            (1.0 - TIP) * lengths[k] / whole
        }
    };
    // Nodes from which no force gives these moments have no weight; without any reachable node the
    // prior remains.
    let any = solutions.iter().any(|s| s.reachable);
    let weight =
        |(k, s): (usize, &InverseSolution)| if s.reachable || !any { prior(k) } else { 0.0 };
    let mut weights: Vec<f64> = solutions.iter().enumerate().map(weight).collect();
    let total: f64 = weights.iter().sum();
    weights.iter_mut().for_each(|w| *w /= total);
    let each = || weights.iter().zip(&solutions);
    let mean: Vector3<f64> = each().map(|(w, s)| s.point_mm * *w).sum();
    let normal: Vector3<f64> = each().map(|(w, s)| s.normal * *w).sum();
    // Law of total covariance: spread of the places, and each one's own error.
    let noise_nmm = sd_nmm[0].hypot(sd_nmm[1]);
    let mut covariance = Matrix3::identity() * MIN_SD_MM * MIN_SD_MM;
    for (w, s) in each() {
        let off = s.point_mm - mean;
        // Noise of the moments moves the point along the force by the compliance |dp.n/dm|.
        let by_noise = s.normal * s.compliance_mm_per_nmm * noise_nmm;
        covariance += (off * off.transpose() + by_noise * by_noise.transpose()) * *w;
    }
    let normal = normal.try_normalize(1e-6).unwrap_or_else(Vector3::zeros);
    Prediction {
        point_mm: mean.map(|x| x as f32).into(),
        covariance_mm2: covariance.map(|x| x as f32).into(),
        weights: weights.iter().map(|w| *w as f32).collect(),
        normal: normal.map(|x| x as f32).into(),
        ..answer.clone()
    }
}

/// What moments alone allow.
pub(crate) struct StaticArc {
    wire: CalibratedWire,
    /// Places that moments allow; made at the first loaded reading.
    inverse: Option<StaticInverse>,
}

impl StaticArc {
    /// Of a wire.
    pub(crate) fn new(wire: CalibratedWire) -> Self {
        Self {
            wire,
            inverse: None,
        }
    }

    /// What the moments of a loaded reading allow, with standard deviations of these sizes, N mm.
    ///
    /// # Errors
    /// Where the wire cannot be bent.
    pub(crate) fn allowed(
        &mut self,
        moment_nmm: [f64; 2],
        sd_nmm: [f64; 2],
    ) -> Result<(ContactEstimate, ArcDensity), TrackError> {
        let inverse = match &mut self.inverse {
            Some(inverse) => inverse,
            none => {
                let CalibratedWire {
                    rod, diameter_mm, ..
                } = &self.wire;
                let grid = InverseGrid::coarse();
                none.insert(StaticInverse::of_rod(rod, *diameter_mm, grid)?)
            }
        };
        let answer = static_arc(inverse, moment_nmm, sd_nmm, &Prediction::unknown());
        Ok((
            ContactEstimate::from(&answer),
            arc_density(&inverse.nodes, &answer.weights),
        ))
    }

    /// The arc of a reading that is loaded beyond its noise.
    ///
    /// # Errors
    /// Where the wire cannot be bent.
    pub(crate) fn estimate_contact(&mut self, m: &Moments) -> Result<Contact, TrackError> {
        // A reading's own noise may be larger than that from pose to pose, which is one of
        // averages.
        let own = m.own_nmm2.map_or(0.0, |n| n.trace());
        let sd_nmm = (squares(&[m.sd_nmm]) + own).sqrt();
        if squares(&[m.moment_nmm]).sqrt() <= LOADED_SDS * sd_nmm {
            return Ok(Contact::default());
        }
        let (estimate, arc) = self.allowed(m.moment_nmm, m.sd_nmm)?;
        let (estimate, regions) = (Some(estimate), arc.regions());
        Ok(Contact {
            estimate,
            flags: Flags::MOTION_LOST,
            regions,
            ..Contact::default()
        })
    }
}

/// Probability that a motion of which nothing is known is one as in training. An assumption.
const AS_TRAINED: f32 = 0.5;

/// What is stated of a network's answer (point p, covariance C_n, weights u_k) where the motion is
/// not known: with probability a it is as in training, else nothing but the moments counts (mean q,
/// C_a, v_k; [`static_arc`]). The point stays p; `w_k = a u_k + (1 - a) v_k`, and
/// `C = a C_n + (1 - a) (C_a + (q - p)(q - p)')`, the mixture's second moment about p.
pub(crate) fn any_motion(
    inverse: &StaticInverse,
    moment_nmm: [f64; 2],
    sd_nmm: [f64; 2],
    network: Prediction,
) -> Prediction {
    let alone = static_arc(inverse, moment_nmm, sd_nmm, &network);
    // Second moment of a mixture of two about the stated point.
    let mixed = |trained: f32, other: f32| AS_TRAINED * trained + (1.0 - AS_TRAINED) * other;
    let off = [0, 1, 2].map(|i| alone.point_mm[i] - network.point_mm[i]);
    let (n, a) = (network.covariance_mm2, alone.covariance_mm2);
    let covariance_mm2 =
        [0, 1, 2].map(|i| [0, 1, 2].map(|j| mixed(n[i][j], a[i][j] + off[i] * off[j])));
    let mut weights = alone.weights;
    // A network without the curve states no place on it.
    if network.weights.len() == weights.len() {
        let both = weights.iter_mut().zip(&network.weights);
        both.for_each(|(w, trained)| *w = mixed(*trained, *w));
    }
    Prediction {
        covariance_mm2,
        weights,
        ..network
    }
}

/// Density over the arc length of weights on the inverse's nodes; empty without weights.
pub(crate) fn arc_density(nodes: &[Node], weights: &[f32]) -> ArcDensity {
    if weights.len() != nodes.len() || nodes.len() < 2 {
        return ArcDensity::default();
    }
    // The tip's tilts are one place: the last node of the wire.
    let on_wire = nodes
        .iter()
        .position(|n| n.tilt > 0.0)
        .unwrap_or(nodes.len());
    let mut masses: Vec<f64> = weights.iter().map(|w| f64::from(*w)).collect();
    let at_tip: f64 = masses.drain(on_wire..).sum();
    masses
        .iter_mut()
        .last()
        .into_iter()
        .for_each(|tip| *tip += at_tip);
    let places: Vec<f64> = nodes[..on_wire].iter().map(|n| n.arclength_mm).collect();
    ArcDensity::of_masses(&places, &masses)
}

#[cfg(test)]
mod tests {
    use super::*;
    use wcal_core::observation::WhiskerSpec;
    use wcal_network::InverseGrid;

    fn nodes() -> Vec<Node> {
        let wire = (0..=20).map(|k| Node {
            arclength_mm: f64::from(k),
            tilt: 0.0,
        });
        wire.chain([Node {
            arclength_mm: 20.0,
            tilt: 0.5,
        }])
        .collect()
    }

    #[test]
    fn two_peaks_are_two_pieces_and_the_tilts_are_the_tip() {
        let mut weights = vec![0.0_f32; 22];
        (weights[5], weights[6], weights[21], weights[20]) = (0.3, 0.3, 0.3, 0.1);
        let pieces = arc_density(&nodes(), &weights).regions();
        assert_eq!(pieces.len(), 2, "{pieces:?}");
        assert!((pieces[0].probability - 0.6).abs() < 1e-6 && (pieces[0].to_mm - 6.5).abs() < 1e-9);
        assert!(
            (pieces[1].probability - 0.4).abs() < 1e-6 && (pieces[1].to_mm - 20.0).abs() < 1e-9
        );
        assert!(arc_density(&nodes(), &[]).regions().is_empty());
        let even = vec![1.0 / 22.0; 22];
        let all: f64 = arc_density(&nodes(), &even)
            .regions()
            .iter()
            .map(|p| p.probability)
            .sum();
        assert!((0.95..=1.0).contains(&all), "{all}");
    }

    #[test]
    fn every_place_that_explains_the_moments_is_in_the_region() {
        let inverse = StaticInverse::new(&WhiskerSpec::nominal(), InverseGrid::default()).unwrap();
        let unknown = Prediction {
            contact: 0.9,
            several: 0.0,
            point_mm: [0.0; 3],
            covariance_mm2: [[0.0; 3]; 3],
            weights: Vec::new(),
            normal: [0.0; 3],
        };
        let (mut held, mut all) = (0.0, 0.0);
        for moment in [[0.3, 0.1], [-0.5, 0.2], [0.05, -0.2]] {
            let answer = static_arc(&inverse, moment, [1e-3; 2], &unknown);
            let covariance = Matrix3::from_fn(|i, j| f64::from(answer.covariance_mm2[i][j]));
            let mean = Vector3::from(answer.point_mm.map(f64::from));
            let factor = covariance.cholesky().unwrap();
            let mut solutions = Vec::new();
            inverse.solutions(moment, &mut solutions);
            for (s, w) in solutions.iter().zip(&answer.weights) {
                let off = s.point_mm - mean;
                all += f64::from(*w);
                // 90 % of a Gaussian in space.
                held += if off.dot(&factor.solve(&off)) < 6.25 {
                    f64::from(*w)
                } else {
                    0.0
                };
            }
            assert_eq!(answer.contact, 0.9);
        }
        assert!(held / all > 0.88, "{}", held / all);
    }

    #[test]
    fn a_coarse_table_is_near_the_fine_one_and_smaller() {
        let made = |grid: InverseGrid| StaticInverse::new(&WhiskerSpec::nominal(), grid).unwrap();
        let (fine, coarse) = (made(InverseGrid::default()), made(InverseGrid::coarse()));
        let (mut a, mut b, mut off) = (Vec::new(), Vec::new(), Vec::new());
        for k in 0..60 {
            let (size, angle) = (0.03 + 0.02 * f64::from(k), 2.4 * f64::from(k));
            let moment = [size * angle.cos(), size * angle.sin()];
            fine.solutions(moment, &mut a);
            coarse.solutions(moment, &mut b);
            for (n, s) in coarse
                .nodes
                .iter()
                .zip(&b)
                .filter(|(n, s)| n.tilt == 0.0 && s.reachable)
            {
                let same =
                    |m: &Node| m.tilt == 0.0 && (m.arclength_mm - n.arclength_mm).abs() < 1e-9;
                let Some(at) = fine
                    .nodes
                    .iter()
                    .position(same)
                    .filter(|at| a[*at].reachable)
                else {
                    continue;
                };
                off.push((a[at].point_mm - s.point_mm).norm());
            }
        }
        off.sort_by(f64::total_cmp);
        let (median_mm, p95_mm) = (off[off.len() / 2], off[off.len() * 19 / 20]);
        println!(
            "{} places: {median_mm:.4} mm median, {p95_mm:.4} mm 95 %",
            off.len()
        );
        assert!(
            off.len() > 500 && median_mm < 0.01 && p95_mm < 0.15,
            "{median_mm} {p95_mm}"
        );
        // Building solves a family of rods for each place, tilt and direction.
        let families = |g: InverseGrid| (g.tilts * g.directions) as f64 / g.step_mm;
        assert!(4.0 * families(InverseGrid::coarse()) <= families(InverseGrid::default()));
    }
}
