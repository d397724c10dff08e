//! What a sweep's physics adds to the ideal rod: friction, softening, and the medium's drag, weight
//! and buoyancy.
//!
//! Per length: weight less buoyancy (rho_w - rho) pi/4 D^2 g, and drag
//! ([`wcal_mujoco::engine::fluid`]). Directions are uniform on the sphere: z uniform in [-1, 1] and
//! an angle (Archimedes).

use crate::contact::{Configuration, ContactRod};
use nalgebra::Vector3;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::f64::consts::{PI, TAU};
use wcal_core::observation::WhiskerSpec;
use wcal_mesh::MeshError;
use wcal_mujoco::engine::fluid::FluidLoads;
use wcal_rod::Softening;

const GRAVITY_M_S2: f64 = 9.806_65;

/// What surrounds the wire.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Medium {
    /// Nothing: neither drag nor weight.
    #[default]
    None,
    /// Air at 20 degC.
    Air,
    /// Fresh water at 20 degC.
    Water,
}

impl Medium {
    /// Name in the shards.
    pub fn name(self) -> &'static str {
        match self {
            Self::None => "none",
            Self::Air => "air",
            Self::Water => "water",
        }
    }

    /// Density, kg/m^3, and kinematic viscosity, m^2/s.
    fn fluid(self) -> Option<[f64; 2]> {
        match self {
            Self::None => None,
            Self::Air => Some([1.204, 1.516e-5]),
            Self::Water => Some([998.2, 1.004e-6]),
        }
    }
}

/// How the physics of sweeps is drawn; all off by default.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct PhysicsPlan {
    /// Coefficient of friction between wire and object.
    pub friction: [f64; 2],
    /// Change of curvature past which the wire softens, 1/m; none: it stays linear. Loading and
    /// unloading are the same.
    pub softening_onset_per_m: Option<[f64; 2]>,
    /// Share of the bending stiffness that does not soften.
    pub softening_hardening: f64,
    /// Medium at rest, through which the base moves.
    pub medium: Medium,
    /// Speed of a current of the medium, mm/s; its direction is drawn evenly.
    pub current_mm_s: [f64; 2],
    /// Whether weight less buoyancy bends the wire; the direction is drawn evenly.
    pub weight: bool,
}

impl Default for PhysicsPlan {
    fn default() -> Self {
        Self {
            friction: [0.0; 2],
            softening_onset_per_m: None,
            softening_hardening: 0.1,
            medium: Medium::None,
            current_mm_s: [0.0; 2],
            weight: false,
        }
    }
}

impl PhysicsPlan {
    /// # Errors
    /// Where a value cannot be.
    pub fn check(&self) -> Result<(), MeshError> {
        let within = |what, [low, high]: [f64; 2], least: f64, most: f64| {
            if low >= least && high >= low && high <= most {
                return Ok(());
            }
            let (expected, found) = (
                format!("{least} <= low <= high <= {most}"),
                format!("[{low}, {high}]"),
            );
            Err(MeshError::Value {
                what: String::from(what),
                expected,
                found,
            })
        };
        within("friction", self.friction, 0.0, 2.0)?;
        within("current_mm_s", self.current_mm_s, 0.0, 1000.0)?;
        within(
            "softening_hardening",
            [self.softening_hardening; 2],
            0.01,
            1.0,
        )?;
        if let Some(onset) = self.softening_onset_per_m {
            within("softening_onset_per_m", onset, 1.0, 1000.0)?;
        }
        if self.medium == Medium::None && (self.weight || self.current_mm_s[1] > 0.0) {
            return Err(MeshError::Value {
                what: "medium".to_owned(),
                expected: "\"air\" or \"water\" where weight or current_mm_s is given".to_owned(),
                found: "\"none\"".to_owned(),
            });
        }
        Ok(())
    }
}

/// The physics of one sweep.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Physics {
    /// Coefficient of friction.
    pub friction: f64,
    /// Softening of the wire.
    pub softening: Option<Softening>,
    /// Medium.
    pub medium: Medium,
    /// Velocity of the medium in the base's directions, mm/s.
    pub current_mm_s: Vector3<f64>,
    /// Direction of gravity in the base's directions, where the wire has a weight.
    pub gravity: Option<Vector3<f64>>,
}

impl Physics {
    pub(crate) fn draw(plan: &PhysicsPlan, rng: &mut ChaCha8Rng) -> Self {
        let mut uniform = |[low, high]: [f64; 2]| low + (high - low) * rng.random::<f64>();
        // Every draw is made whatever is off: what is switched on does not change the others.
        let friction = uniform(plan.friction);
        let onset = uniform(plan.softening_onset_per_m.unwrap_or_default());
        let current = uniform(plan.current_mm_s);
        let mut direction = || {
            let (z, turn) = (uniform([-1.0, 1.0]), uniform([0.0, TAU]));
            let side = (1.0 - z * z).sqrt();
            Vector3::new(side * turn.cos(), side * turn.sin(), z)
        };
        let (current_mm_s, gravity) = (direction() * current, direction());
        let hardening = plan.softening_hardening;
        Self {
            friction,
            softening: plan.softening_onset_per_m.map(|_| Softening::Section {
                onset_per_m: onset,
                hardening,
            }),
            medium: plan.medium,
            current_mm_s,
            gravity: plan.weight.then_some(gravity),
        }
    }

    /// Onset of the softening, 1/m.
    pub fn onset_per_m(&self) -> Option<f64> {
        self.softening.map(|law| match law {
            Softening::Section { onset_per_m, .. } | Softening::Bilinear { onset_per_m, .. } => {
                onset_per_m
            }
        })
    }
}

/// What the medium does to a whisker; none where there is none.
pub fn fluid_loads(whisker: &WhiskerSpec, physics: &Physics) -> Option<FluidLoads> {
    let [density_kg_m3, viscosity_m2_s] = physics.medium.fluid()?;
    let diameter_m = whisker.diameter_mm * 1e-3;
    let wire_kg_m3 = whisker.density_or_niti_kg_m3();
    let pull_n_per_mm =
        (wire_kg_m3 - density_kg_m3) * PI / 4.0 * diameter_m.powi(2) * GRAVITY_M_S2 * 1e-3;
    Some(FluidLoads {
        diameter_m,
        density_kg_m3,
        viscosity_m2_s,
        weight_n_per_mm: physics
            .gravity
            .map_or_else(Vector3::zeros, |down| down * pull_n_per_mm),
        current_mm_s: physics.current_mm_s,
    })
}

/// Load along each link, N/mm; `base_mm_s` moves them all, their ends move at `nodes_mm_s` besides.
pub fn loads_n_per_mm(
    fluid: &FluidLoads,
    links: &Configuration,
    base_mm_s: &Vector3<f64>,
    nodes_mm_s: &[Vector3<f64>],
) -> Vec<Vector3<f64>> {
    let of = |(frame, ends): (&nalgebra::Matrix3<f64>, &[Vector3<f64>])| {
        let velocity = base_mm_s + (ends[0] + ends[1]) / 2.0;
        fluid.load_n_per_mm(&frame.column(0).into_owned(), &velocity)
    };
    links
        .frames
        .iter()
        .zip(nodes_mm_s.windows(2))
        .map(of)
        .collect()
}

/// Velocities of the links' ends between two places of the wire, mm/s.
pub(crate) fn node_velocities(
    before: &Configuration,
    after: &Configuration,
    seconds: f64,
) -> Vec<Vector3<f64>> {
    before
        .nodes_mm
        .iter()
        .zip(&after.nodes_mm)
        .map(|(a, b)| (b - a) / seconds)
        .collect()
}

/// The rod with a sweep's softening.
pub(crate) fn with_physics(rod: &ContactRod, physics: &Physics) -> ContactRod {
    let mut rod = rod.clone();
    rod.softening = physics.softening;
    rod
}

#[cfg(test)]
mod tests {
    use super::{Medium, Physics, fluid_loads, loads_n_per_mm};
    use crate::contact::{ContactRod, Surface};
    use nalgebra::Vector3;
    use wcal_core::observation::{RestShape, WhiskerSpec};
    use wcal_mesh::ClosestPoint;
    use wcal_rod::{Section, Shape};

    fn straight() -> WhiskerSpec {
        WhiskerSpec {
            diameter_mm: 0.3,
            youngs_gpa: 75e3,
            shear_gpa: 28.2e3,
            density_kg_m3: Some(6450.0),
            rest_shape: RestShape::StraightArc {
                straight_mm: 60.0,
                arc_radius_mm: 20.0,
                length_mm: 60.0,
            },
            gravity_direction: None,
        }
    }

    /// Moment at the root of a stiff straight wire, N mm.
    fn root_nmm(physics: &Physics, base_mm_s: Vector3<f64>) -> Vector3<f64> {
        struct NoSurface;
        impl Surface for NoSurface {
            fn closest_point(&self, _: &Vector3<f64>, _: f64) -> Option<ClosestPoint> {
                None
            }
        }
        let wire = straight();
        let section = Section::round(wire.diameter_mm, wire.youngs_gpa, wire.shear_gpa);
        let shape = Shape::new(&wire.rest_shape, 0.25).unwrap();
        let mut rod = ContactRod::new(&section, &shape, wire.diameter_mm, 40).unwrap();
        let rest = rod.at_rest();
        let fluid = fluid_loads(&wire, physics).unwrap();
        rod.loads_n_per_mm = loads_n_per_mm(&fluid, &rest, &base_mm_s, &vec![Vector3::zeros(); 41]);
        rod.base_moment_nmm(&rod.solve_contact(&NoSurface, &rest, &[], &Vector3::zeros(), 60))
    }

    /// In closed form: even load q over L gives q L^2 / 2 at the root.
    #[test]
    fn drag_and_weight_of_a_cantilever() {
        let water = Physics {
            medium: Medium::Water,
            ..Physics::default()
        };
        let speed = 0.1;
        let reynolds = speed * 0.3e-3 / 1.004e-6;
        let per_m =
            0.5 * 998.2 * (1.0 + 10.0 * f64::powf(reynolds, -2.0 / 3.0)) * 0.3e-3 * speed * speed;
        let exact = per_m * 1e-3 * 60.0 * 60.0 / 2.0;
        let up = root_nmm(&water, Vector3::z() * (speed * 1e3));
        // Drag is against the way: down at +x, which is a moment about +y.
        assert!(
            (up.y - exact).abs() < 1e-3 * exact && up.x.abs() + up.z.abs() < 1e-9,
            "{up} {exact}"
        );
        // docs/src/system.md: some 0.005 N mm at 0.1 m/s, with a drag coefficient of one; White's
        // is larger at this Reynolds number.
        assert!((0.004..0.012).contains(&exact), "{exact}");
        // A current of the base's own velocity leaves no drag; along the wire there is none either
        // (negative controls).
        let with = Physics {
            current_mm_s: Vector3::z() * 100.0,
            ..water.clone()
        };
        assert!(root_nmm(&with, Vector3::z() * 100.0).norm() < 1e-12);
        assert!(root_nmm(&water, Vector3::x() * 100.0).norm() < 1e-12);
        let weight = |medium| {
            let physics = Physics {
                medium,
                gravity: Some(-Vector3::z()),
                ..Physics::default()
            };
            root_nmm(&physics, Vector3::zeros()).y
        };
        let area = std::f64::consts::PI / 4.0 * 0.3e-3 * 0.3e-3;
        for (medium, fluid) in [(Medium::Air, 1.204), (Medium::Water, 998.2)] {
            let exact = (6450.0 - fluid) * area * 9.80665 * 0.06 * 0.06 / 2.0 * 1e3;
            assert!(
                (weight(medium) - exact).abs() < 1e-3 * exact,
                "{} {exact}",
                weight(medium)
            );
        }
        assert!(
            weight(Medium::Water) < 0.86 * weight(Medium::Air),
            "buoyancy"
        );
    }
}
