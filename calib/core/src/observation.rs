//! What a session holds once it has been read and checked: plain data, no files.

use crate::ranges::{self, OutOfRange, Range};
use crate::shapes_document::{PairDocument, SharedParameter};
use nalgebra::Vector3;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// The three kinds of session (docs/src/formats.md).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum SessionKind {
    /// Whisker pressed by a V-groove; wavelengths against base moments.
    Whisker,
    /// One stimulus, one response.
    Transducer,
    /// Commanded against measured position.
    Axis,
}

impl std::fmt::Display for SessionKind {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Whisker => "whisker",
            Self::Transducer => "transducer",
            Self::Axis => "axis",
        })
    }
}

/// What a reading may be used for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Role {
    /// No load.
    Rest,
    /// One of the calibration poses; the map is fitted to these and to rest.
    Calibration,
    /// Extra readings for diagnosis; `verify` may fit them.
    Verification,
    /// Never used in any fit.
    Holdout,
}

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
            Err(OutOfRange { key: key.to_owned(), expected, found: found.to_string() })
        };
        ranges::check_value(self, &[WHISKER_RANGES])?;
        // E = 2 (1 + nu) G, and nu is above -1/2 for every known wire: G is below E.
        if !(self.shear_gpa < self.youngs_gpa) {
            let expected = format!("less than youngs_gpa = {} (are the two exchanged?)", self.youngs_gpa);
            return of("shear_gpa", expected, self.shear_gpa);
        }
        match &self.rest_shape {
            RestShape::StraightArc { straight_mm, length_mm, .. } if straight_mm > length_mm => {
                of("straight_mm", format!("at most length_mm = {length_mm}"), *straight_mm)
            }
            RestShape::Polyline(points) => {
                let length_mm: f64 = points.windows(2).map(|w| (w[1] - w[0]).norm()).sum();
                let ranges = [Range::real("length_mm", 1.0, 2000.0)];
                ranges::check(&serde_json::json!({"rest_shape": {"length_mm": length_mm}}), &[&ranges])
            }
            RestShape::StraightArc { .. } => Ok(()),
        }
    }

    /// Density, kg/m^3: the stated one, or NiTi's.
    pub fn density_or_niti_kg_m3(&self) -> f64 {
        self.density_kg_m3.unwrap_or(NITI_KG_M3)
    }

    /// The paper's wire as it is nominally: NiTi, 0.3 mm thick, 30 mm straight and 30 mm on an arc of 20 mm (docs/src/system.md).
    pub fn nominal() -> Self {
        Self {
            diameter_mm: 0.3,
            youngs_gpa: 75.0,
            shear_gpa: 28.2,
            density_kg_m3: None,
            rest_shape: RestShape::StraightArc { straight_mm: 30.0, arc_radius_mm: 20.0, length_mm: 60.0 },
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
    /// As points that are at most `step_mm` apart where it is given by lengths; a polyline as it is.
    pub fn points(&self, step_mm: f64) -> Vec<Vector3<f64>> {
        let (straight_mm, radius_mm, length_mm) = match self {
            Self::Polyline(points) => return points.clone(),
            Self::StraightArc { straight_mm, arc_radius_mm, length_mm } => {
                (*straight_mm, *arc_radius_mm, *length_mm)
            }
        };
        let count = (length_mm / step_mm).ceil().max(2.0) as usize;
        let at = |s: f64| {
            let (sine, cosine) = ((s - straight_mm).max(0.0) / radius_mm).sin_cos();
            Vector3::new(s.min(straight_mm) + radius_mm * sine, 0.0, -radius_mm * (1.0 - cosine))
        };
        (0..=count).map(|k| at(length_mm * k as f64 / count as f64)).collect()
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
    arclengths(a).iter().zip(a).map(|(s, p)| ((p - a[0]) - (at(*s) - b[0])).norm()).fold(0.0, f64::max)
}

/// The two base-moment components that the calibration predicts.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct MomentAxes {
    /// Unit vectors in the base frame.
    pub axes: [Vector3<f64>; 2],
    /// +1: moment = r x F acting on the base; -1: its reaction.
    pub sign: f64,
}

impl Default for MomentAxes {
    fn default() -> Self {
        Self { axes: [Vector3::y(), Vector3::z()], sign: 1.0 }
    }
}

impl MomentAxes {
    /// Components (N mm) of a base moment vector r x F (N mm, base frame).
    pub fn components_nmm(&self, moment_nmm: &Vector3<f64>) -> [f64; 2] {
        [self.sign * self.axes[0].dot(moment_nmm), self.sign * self.axes[1].dot(moment_nmm)]
    }
}

/// Gratings: nominal wavelengths and temperature coefficients.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
pub struct FbgSpec {
    /// Nominal wavelengths of the two sensing gratings, nm; absent when the table holds shifts.
    pub nominal_nm: Option<[f64; 2]>,
    /// Nominal wavelength of the strain-isolated grating, nm.
    pub reference_nominal_nm: Option<f64>,
    /// Temperature coefficients of the sensing gratings, pm per degree.
    pub temperature_pm_per_degc: Option<[f64; 2]>,
    /// Temperature coefficient of the reference grating, pm per degree.
    pub reference_temperature_pm_per_degc: Option<f64>,
    /// The readings are already compensated.
    #[serde(default)]
    pub temperature_compensated: bool,
}

impl FbgSpec {
    /// Whether readings must be compensated with the strain-isolated grating.
    pub fn needs_reference(&self) -> bool {
        !self.temperature_compensated
            && self.temperature_pm_per_degc.is_some()
            && self.reference_temperature_pm_per_degc.is_some_and(|k| k != 0.0)
    }

    /// Temperature over that of the reference grating's nominal wavelength, K, from its shift (pm), where its coefficient is known.
    pub fn rise_degc(&self, reference_shift_pm: f64) -> Option<f64> {
        self.reference_temperature_pm_per_degc.filter(|k| *k != 0.0).map(|k| reference_shift_pm / k)
    }

    /// Temperature-compensated shifts, pm, from raw shifts and the reference grating's: see [`WhiskerRow::compensated_pm`].
    pub fn compensated_pm(&self, shift_pm: [f64; 2], reference_shift_pm: Option<f64>) -> [f64; 2] {
        if self.temperature_compensated {
            return shift_pm;
        }
        match (reference_shift_pm.and_then(|s| self.rise_degc(s)), self.temperature_pm_per_degc) {
            (Some(rise_degc), Some(k)) => [shift_pm[0] - k[0] * rise_degc, shift_pm[1] - k[1] * rise_degc],
            _ => shift_pm,
        }
    }
}

impl WhiskerSpec {
    /// The first property in which another whisker differs by more than a share of 1 % (shape: 1 mm), named with both values; the
    /// density does not bend a wire at rest and is not compared.
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
                RestShape::StraightArc { straight_mm: s, arc_radius_mm: r, length_mm: l },
                RestShape::StraightArc { straight_mm, arc_radius_mm, length_mm },
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

/// One straight path of the groove.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Trajectory {
    /// Identifier used by the rows.
    pub id: u32,
    /// Groove centre at stage position 0, mm, base frame.
    pub origin_mm: Vector3<f64>,
    /// Unit vector of travel; the groove pushes along it.
    pub direction: Vector3<f64>,
    /// Arc length of the nominal first contact, mm.
    pub nominal_arclength_mm: Option<f64>,
}

/// One reading of a whisker session: a settled window or an on-the-fly sample.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct WhiskerRow {
    /// File the row came from (as named in the session).
    pub source: String,
    /// Line in that file, header = 1.
    pub line: usize,
    /// Point number, unique in its file.
    pub point: i64,
    /// Use of the reading.
    pub role: Role,
    /// Trajectory identifier; absent at rest.
    pub trajectory: Option<u32>,
    /// Repetition of the same pose.
    pub replicate: Option<u32>,
    /// End of the averaging window (centre while moving), s.
    pub t_s: Option<f64>,
    /// Stage position along the trajectory, mm.
    pub stage_mm: Option<f64>,
    /// +1 loading, -1 unloading.
    pub direction: Option<f64>,
    /// Speed, mm/s; 0 when settled.
    pub speed_mm_s: Option<f64>,
    /// Time since arrival, s.
    pub dwell_s: Option<f64>,
    /// Length of the averaging window of a settled reading, s: `t_s` and `dwell_s` are those of its middle.
    pub average_s: Option<f64>,
    /// Centre of the wire when it sits in the vertex, mm, base frame.
    pub groove_mm: Option<Vector3<f64>>,
    /// Temperature from its own sensor, deg C.
    pub temperature_degc: Option<f64>,
    /// Raw shifts of the two sensing gratings from nominal, pm; not temperature compensated.
    pub shift_pm: [f64; 2],
    /// Shift of the strain-isolated grating from nominal, pm.
    pub reference_shift_pm: Option<f64>,
    /// Standard deviation of single samples, pm.
    pub shift_sd_pm: Option<[f64; 2]>,
    /// Samples averaged.
    pub samples: Option<u32>,
    /// 0 for the session itself; added sessions count up. The whisker was seated anew, so the gratings' zero may differ.
    pub seating: u32,
    /// Counts among the held-out readings, whatever its role says.
    #[serde(default)]
    pub sealed: bool,
    /// What the pair of pictures of this pose shows: sealed with its row where that is sealed.
    #[serde(skip)]
    pub pair: Option<Arc<PairDocument>>,
}

impl WhiskerRow {
    /// Temperature-compensated shifts, pm: `shift - k_T (T - T0)` with `T - T0` from the strain-isolated grating.
    /// Uncompensated where the session has no reference grating or says that it is compensated already.
    pub fn compensated_pm(&self, fbg: &FbgSpec) -> [f64; 2] {
        fbg.compensated_pm(self.shift_pm, self.reference_shift_pm)
    }
}

/// Base moments from an outside simulator, N mm.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct TwinLabel {
    /// Point number in the points table.
    pub point: i64,
    /// The two moment components, N mm.
    pub moment_nmm: [f64; 2],
}

/// A whisker session in memory.
#[derive(Debug, Clone, PartialEq)]
pub struct WhiskerData {
    /// Wire.
    pub whisker: WhiskerSpec,
    /// Moment components.
    pub moments: MomentAxes,
    /// Gratings.
    pub fbg: FbgSpec,
    /// Surrounding medium, e.g. "air" or "water".
    pub medium: String,
    /// Paths of the groove.
    pub trajectories: Vec<Trajectory>,
    /// Rows of the points table, in file order.
    pub rows: Vec<WhiskerRow>,
    /// Labels of an outside twin; empty when there are none.
    pub twin: Vec<TwinLabel>,
    /// What the shapes of all pairs share, and which pairs stand aside; none where the session names no shapes.
    pub shapes: Option<SessionShapes>,
}

/// Shapes of a session: what its pairs share. The pairs themselves stand with their rows ([`WhiskerRow::pair`]).
#[derive(Debug, Clone, PartialEq, Default)]
pub struct SessionShapes {
    /// File that the session names.
    pub file: String,
    /// Parameters whose errors all pairs share.
    pub parameters: Vec<SharedParameter>,
    /// Their covariance, in the order and units of the list.
    pub covariance: Vec<Vec<f64>>,
    /// Pairs that belong to no row or cannot be used, and why.
    pub left_out: Vec<PairLeftOut>,
}

/// A pair of pictures that is not used.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct PairLeftOut {
    /// Name of the pair.
    pub name: String,
    /// Why.
    pub why: String,
}

impl WhiskerData {
    /// The trajectory with this identifier.
    pub fn trajectory(&self, id: u32) -> Option<&Trajectory> {
        self.trajectories.iter().find(|t| t.id == id)
    }
}

/// Declared model of a transducer session.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum TransducerModel {
    /// response = b0
    Constant,
    /// response = b0 + b1 stimulus
    Linear,
    /// response = b0 + b1 stimulus + b2 stimulus^2
    Quadratic,
}

/// One reading of a transducer session.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct TransducerRow {
    /// File the row came from.
    pub source: String,
    /// Line in that file, header = 1.
    pub line: usize,
    /// Point number, unique in its file.
    pub point: i64,
    /// Use of the reading.
    pub role: Role,
    /// Stimulus in `stimulus_unit`.
    pub stimulus: f64,
    /// Standard uncertainty of the stimulus, where it is stated.
    pub stimulus_sd: Option<f64>,
    /// Response in `response_unit`.
    pub response: f64,
    /// Time, s.
    pub t_s: Option<f64>,
    /// Temperature, deg C.
    pub temperature_degc: Option<f64>,
    /// +1 increasing, -1 decreasing.
    pub direction: Option<f64>,
    /// Repetition.
    pub replicate: Option<u32>,
    /// Further covariates, in the order of `TransducerData::covariates`.
    pub covariates: Vec<f64>,
}

/// A transducer session in memory.
#[derive(Debug, Clone, PartialEq)]
pub struct TransducerData {
    /// Unit of the stimulus.
    pub stimulus_unit: String,
    /// Unit of the response.
    pub response_unit: String,
    /// Declared model.
    pub model: TransducerModel,
    /// The response is a deviation, correction or error of the stimulus: it needs no slope.
    pub deviation: bool,
    /// Names of further covariate columns.
    pub covariates: Vec<String>,
    /// Rows in file order.
    pub rows: Vec<TransducerRow>,
}

/// One reading of an axis session.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct AxisRow {
    /// File the row came from.
    pub source: String,
    /// Line in that file, header = 1.
    pub line: usize,
    /// Point number, unique in its file.
    pub point: i64,
    /// Use of the reading.
    pub role: Role,
    /// Commanded position, mm.
    pub commanded_mm: f64,
    /// Measured position, mm.
    pub measured_mm: f64,
    /// Time, s.
    pub t_s: Option<f64>,
    /// +1 or -1.
    pub direction: Option<f64>,
    /// Stroke or cycle number.
    pub cycle: Option<u32>,
    /// Temperature, deg C.
    pub temperature_degc: Option<f64>,
}

/// An axis session in memory; the declared model is measured = commanded + constant.
#[derive(Debug, Clone, PartialEq)]
pub struct AxisData {
    /// Rows in file order.
    pub rows: Vec<AxisRow>,
}

/// Data of any kind of session.
#[derive(Debug, Clone, PartialEq)]
// One session at a time is in memory; the size of the variants does not matter.
#[allow(clippy::large_enum_variant)]
pub enum SessionData {
    /// Whisker session.
    Whisker(WhiskerData),
    /// Transducer session.
    Transducer(TransducerData),
    /// Axis session.
    Axis(AxisData),
}

impl SessionData {
    /// Kind of the session.
    pub fn kind(&self) -> SessionKind {
        match self {
            Self::Whisker(_) => SessionKind::Whisker,
            Self::Transducer(_) => SessionKind::Transducer,
            Self::Axis(_) => SessionKind::Axis,
        }
    }
}
