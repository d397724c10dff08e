//! A wire for the bench of these tests: first-order compliance of the curved wire with a cubic
//! term, quasi-static, frictionless.
//!
//! ```text
//! m = arm F,   F = d / C (1 + CUBIC (d / reach)^2),   C = integral of |m_b|^2 / E I + m_t^2 / G J along s under a unit force
//! ```
//!
//! Source of the compliance: Castigliano's second theorem (S. P. Timoshenko, J. M. Gere, "Mechanics
//! of Materials").

use nalgebra::Vector3;
use wcal_drivers::bench::plant::{Plant, rest_arclength_mm};
use wcal_drivers::bench::scenario::Scenario;
use wcal_drivers::bench::scenario::rest_point;

/// Pieces of the wire in the compliance integral.
const PIECES: usize = 600;

#[derive(Debug, Clone)]
pub(crate) struct Cantilever {
    paths: Vec<(u32, Path)>,
}

#[derive(Debug, Clone, Copy)]
struct Path {
    /// Base moment per unit force, mm.
    arm_mm: [f64; 2],
    /// Deflection along the path per unit force, mm/N.
    compliance_mm_per_n: f64,
    /// Length that makes the cubic term, mm.
    reach_mm: f64,
}

/// Stiffening of a cantilever that is pressed sideways, per (depth / reach)^2.
const CUBIC: f64 = 0.6;

impl Cantilever {
    /// The wire and paths of a scenario, to be plugged into its bench.
    pub(crate) fn of(scenario: &Scenario) -> Box<dyn Plant> {
        Box::new(Self::new(scenario))
    }

    pub(crate) fn new(scenario: &Scenario) -> Self {
        let w = &scenario.whisker;
        // Second moments of a round wire, mm^4; E in N/mm^2.
        let i = std::f64::consts::PI * w.diameter_mm.powi(4) / 64.0;
        let (bending, torsion) = (w.youngs_gpa * 1e3 * i, w.shear_gpa * 1e3 * 2.0 * i);
        let trajectories = scenario.trajectories();
        let paths = trajectories.iter().map(|t| {
            let origin = Vector3::from(t.origin_mm);
            let push = Vector3::from(t.direction).normalize();
            let contact = rest_arclength_mm(w, t.origin_mm);
            let ds = contact / PIECES as f64;
            let compliance = (0..PIECES)
                .map(|k| {
                    let (point, tangent) = rest_point(w, (k as f64 + 0.5) * ds);
                    let m = (origin - Vector3::from(point)).cross(&push);
                    let twist = m.dot(&Vector3::from(tangent));
                    ((m.norm_squared() - twist * twist) / bending + twist * twist / torsion) * ds
                })
                .sum();
            let arm = origin.cross(&push);
            let path = Path {
                arm_mm: [arm.y, arm.z],
                compliance_mm_per_n: compliance,
                reach_mm: origin.norm(),
            };
            (t.id, path)
        });
        Self {
            paths: paths.collect(),
        }
    }
}

impl Plant for Cantilever {
    fn moment_nmm(&mut self, id: u32, depth_mm: f64) -> [f64; 2] {
        let Some((_, path)) = self
            .paths
            .iter()
            .find(|(p, _)| *p == id)
            .filter(|_| depth_mm > 0.0)
        else {
            return [0.0; 2];
        };
        let stretch = depth_mm / path.reach_mm;
        let force_n = depth_mm / path.compliance_mm_per_n * (1.0 + CUBIC * stretch * stretch);
        path.arm_mm.map(|a| a * force_n)
    }
}

#[test]
fn a_straight_wire_has_the_textbook_stiffness() {
    let s = Scenario::parse("format = \"wcal-scenario/1\"").unwrap();
    let mut plant = Cantilever::new(&s);
    // m = 3 E I d / L^2 at 18 mm; E I = 29.82 N mm^2.
    let ei = 75e3 * std::f64::consts::PI * 0.3_f64.powi(4) / 64.0;
    let m = plant.moment_nmm(1, 0.01);
    assert!((m[0] + 3.0 * ei * 0.01 / 324.0).abs() < 1e-5, "{m:?}");
    assert_eq!(plant.moment_nmm(1, -0.1), [0.0; 2]);
    assert_eq!(plant.moment_nmm(99, 1.0), [0.0; 2]);
}
