//! A whisker's wire as it is declared: material, stress-free shape, what such a wire can be, and in
//! what two differ.

use crate::ranges::{self, OutOfRange, Range};
use nalgebra::Vector3;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Nominal properties of the wire.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct WhiskerSpec {
    /// Wire diameter, mm.
    pub diameter_mm: f64,
    /// Young's modulus, GPa.
    pub youngs_gpa: f64,
    /// Shear modulus, GPa.
    pub shear_gpa: f64,
    /// Density, kg/m^3.
    pub density_kg_m3: Option<f64>,
    /// Stress-free shape: one of the two.
    pub rest_shape: RestShape,
    /// Unit vector of gravity in the base frame, where known.
    #[schemars(with = "Option<[f64; 3]>")]
    pub gravity_direction: Option<Vector3<f64>>,
}

/// What a wire of this kind can be, by the keys of `[whisker]`.
pub const WHISKER_RANGES: &[Range] = &[
    Range::real("diameter_mm", 0.005, 10.0),
    Range::real("youngs_gpa", 0.001, 1500.0),
    Range::real("shear_gpa", 0.0003, 1000.0),
    Range::real("density_kg_m3", 50.0, 25_000.0),
    Range::real("length_mm", 1.0, 2000.0),
    Range::real("straight_mm", 0.0, 2000.0),
    Range::real("arc_radius_mm", 0.5, 1e6),
    Range::real("rest_shape", -2000.0, 2000.0),
    Range::real("rest_shape.polyline", -2000.0, 2000.0),
    Range::real("gravity_direction", -1.001, 1.001),
];

/// Density of NiTi where a whisker states none, kg/m^3 (docs/src/system.md, released).
const NITI_KG_M3: f64 = 6450.0;

impl WhiskerSpec {
    /// Holds every number against what a wire can be, and the numbers against each other.
    ///
    /// # Errors
    /// The first key that cannot be.
    pub fn check(&self) -> Result<(), OutOfRange> {
        let of = |key: &str, expected: String, found: f64| {
            Err(OutOfRange {
                key: key.to_owned(),
                expected,
                found: found.to_string(),
            })
        };
        ranges::check_value(self, &[WHISKER_RANGES])?;
        // E = 2 (1 + nu) G, and nu is above -1/2 for every known wire: G is below E.
        if !(self.shear_gpa < self.youngs_gpa) {
            let expected = format!(
                "less than youngs_gpa = {} (are the two exchanged?)",
                self.youngs_gpa
            );
            return of("shear_gpa", expected, self.shear_gpa);
        }
        match &self.rest_shape {
            RestShape::StraightArc {
                straight_mm,
                length_mm,
                ..
            } if straight_mm > length_mm => of(
                "straight_mm",
                format!("at most length_mm = {length_mm}"),
                *straight_mm,
            ),
            RestShape::Polyline(points) => {
                let length_mm: f64 = points.windows(2).map(|w| (w[1] - w[0]).norm()).sum();
                Range::real("", 1.0, 2000.0).judge("rest_shape.length_mm", length_mm, false)
            }
            RestShape::StraightArc { .. } => Ok(()),
        }
    }

    /// Density, kg/m^3: the stated one, or NiTi's.
    pub fn density_or_niti_kg_m3(&self) -> f64 {
        self.density_kg_m3.unwrap_or(NITI_KG_M3)
    }

    /// The paper's wire as it is nominally: NiTi, 0.3 mm thick, 30 mm straight and 30 mm on an arc
    /// of 20 mm (docs/src/system.md).
    pub fn nominal() -> Self {
        Self {
            diameter_mm: 0.3,
            youngs_gpa: 75.0,
            shear_gpa: 28.2,
            density_kg_m3: None,
            rest_shape: RestShape::StraightArc {
                straight_mm: 30.0,
                arc_radius_mm: 20.0,
                length_mm: 60.0,
            },
            gravity_direction: None,
        }
    }
}

/// Stress-free centre line, root first, base frame.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum RestShape {
    /// Straight along +x, then an arc that bends toward -z.
    StraightArc {
        /// Length of the straight part, mm.
        straight_mm: f64,
        /// Radius of the arc, mm.
        arc_radius_mm: f64,
        /// Total length, mm.
        length_mm: f64,
    },
    /// Polyline of points, mm.
    Polyline(#[schemars(with = "Vec<[f64; 3]>")] Vec<Vector3<f64>>),
}

/// Wires whose shapes are nowhere farther apart are one, mm.
const MAX_APART_MM: f64 = 1.0;

impl RestShape {
    /// As points that are at most `step_mm` apart where it is given by lengths; a polyline as it
    /// is.
    pub fn points(&self, step_mm: f64) -> Vec<Vector3<f64>> {
        let (straight_mm, radius_mm, length_mm) = match self {
            Self::Polyline(points) => return points.clone(),
            Self::StraightArc {
                straight_mm,
                arc_radius_mm,
                length_mm,
            } => (*straight_mm, *arc_radius_mm, *length_mm),
        };
        let count = (length_mm / step_mm).ceil().max(2.0) as usize;
        // Past the straight part the tangent turns toward -z by the way over the radius.
        let at = |s: f64| {
            let (sine, cosine) = ((s - straight_mm).max(0.0) / radius_mm).sin_cos();
            Vector3::new(
                s.min(straight_mm) + radius_mm * sine,
                0.0,
                -radius_mm * (1.0 - cosine),
            )
        };
        (0..=count)
            .map(|k| at(length_mm * k as f64 / count as f64))
            .collect()
    }
}

/// Arc length of each point, mm.
fn arclengths(points: &[Vector3<f64>]) -> Vec<f64> {
    let mut s = 0.0;
    let steps = points.windows(2).map(|w| (w[1] - w[0]).norm());
    std::iter::once(0.0)
        .chain(steps.map(|step| {
            s += step;
            s
        }))
        .collect()
}

/// Largest distance of two polylines at equal arc lengths from their roots, mm.
fn distance_along(a: &[Vector3<f64>], b: &[Vector3<f64>]) -> f64 {
    if a.is_empty() || b.len() < 2 {
        return f64::INFINITY;
    }
    let of_b = arclengths(b);
    let at = |s: f64| {
        let k = of_b.partition_point(|x| *x < s).clamp(1, b.len() - 1);
        let u = ((s - of_b[k - 1]) / (of_b[k] - of_b[k - 1]).max(1e-12)).clamp(0.0, 1.0);
        b[k - 1].lerp(&b[k], u)
    };
    // Both from their roots: where a wire is mounted does not count.
    arclengths(a)
        .iter()
        .zip(a)
        .map(|(s, p)| ((p - a[0]) - (at(*s) - b[0])).norm())
        .fold(0.0, f64::max)
}

impl WhiskerSpec {
    /// The first property in which another whisker differs by more than a share of 1 % (a
    /// shape of points: by 1 mm), named with both values; the density does not bend a wire at rest and is not compared.
    pub fn difference(&self, other: &Self) -> Option<String> {
        let own = [
            ("diameter_mm", self.diameter_mm, other.diameter_mm),
            ("youngs_gpa", self.youngs_gpa, other.youngs_gpa),
            ("shear_gpa", self.shear_gpa, other.shear_gpa),
        ];
        let differs = |a: f64, b: f64| (a - b).abs() > 0.01 * a.abs().max(b.abs());
        let say = |name: &str, a: f64, b: f64| format!("{name}: {a} and {b}");
        if let Some((name, a, b)) = own.into_iter().find(|(_, a, b)| differs(*a, *b)) {
            return Some(say(name, a, b));
        }
        match (&self.rest_shape, &other.rest_shape) {
            (
                RestShape::StraightArc {
                    straight_mm: s,
                    arc_radius_mm: r,
                    length_mm: l,
                },
                RestShape::StraightArc {
                    straight_mm,
                    arc_radius_mm,
                    length_mm,
                },
            ) => [
                ("straight_mm", *s, *straight_mm),
                ("arc_radius_mm", *r, *arc_radius_mm),
                ("length_mm", *l, *length_mm),
            ]
            .into_iter()
            .find(|(_, a, b)| differs(*a, *b))
            .map(|(name, a, b)| say(name, a, b)),
            (a, b) => {
                const STEP_MM: f64 = 0.5;
                let (a, b) = (a.points(STEP_MM), b.points(STEP_MM));
                let [own, other] = [&a, &b].map(|p| arclengths(p).last().copied().unwrap_or(0.0));
                if differs(own, other) {
                    return Some(say("length_mm", own, other));
                }
                let far_mm = distance_along(&a, &b);
                (far_mm > MAX_APART_MM).then(|| format!("rest_shape: up to {far_mm:.1} mm apart"))
            }
        }
    }
}
