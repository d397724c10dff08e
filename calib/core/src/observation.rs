//! What a session holds once it has been read and checked: plain data, no files.

use crate::shapes_document::{PairDocument, SharedParameter};
pub use crate::whisker_spec::{RestShape, WHISKER_RANGES, WhiskerSpec};
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
        Self {
            axes: [Vector3::y(), Vector3::z()],
            sign: 1.0,
        }
    }
}

impl MomentAxes {
    /// Components (N mm) of a base moment vector r x F (N mm, base frame).
    pub fn components_nmm(&self, moment_nmm: &Vector3<f64>) -> [f64; 2] {
        [
            self.sign * self.axes[0].dot(moment_nmm),
            self.sign * self.axes[1].dot(moment_nmm),
        ]
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
            && self
                .reference_temperature_pm_per_degc
                .is_some_and(|k| k != 0.0)
    }

    /// Temperature over that of the reference grating's nominal wavelength, K, from its shift (pm),
    /// where its coefficient is known.
    pub fn rise_degc(&self, reference_shift_pm: f64) -> Option<f64> {
        self.reference_temperature_pm_per_degc
            .filter(|k| *k != 0.0)
            .map(|k| reference_shift_pm / k)
    }

    /// Temperature-compensated shifts, pm, from raw shifts and the reference grating's: see
    /// [`WhiskerRow::compensated_pm`].
    pub fn compensated_pm(&self, shift_pm: [f64; 2], reference_shift_pm: Option<f64>) -> [f64; 2] {
        if self.temperature_compensated {
            return shift_pm;
        }
        // The reference grating bears no strain: what it shows is the temperature, which comes off.
        match (
            reference_shift_pm.and_then(|s| self.rise_degc(s)),
            self.temperature_pm_per_degc,
        ) {
            (Some(rise_degc), Some(k)) => [
                shift_pm[0] - k[0] * rise_degc,
                shift_pm[1] - k[1] * rise_degc,
            ],
            _ => shift_pm,
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
    /// Length of the averaging window of a settled reading, s: `t_s` and `dwell_s` are those of its
    /// middle.
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
    /// 0 for the session itself; added sessions count up. The whisker was seated anew, so the
    /// gratings' zero may differ.
    pub seating: u32,
    /// Counts among the held-out readings, whatever its role says.
    #[serde(default)]
    pub sealed: bool,
    /// What the pair of pictures of this pose shows: sealed with its row where that is sealed.
    #[serde(skip)]
    pub pair: Option<Arc<PairDocument>>,
}

impl WhiskerRow {
    /// Temperature-compensated shifts, pm: `shift - k_T (T - T0)` with `T - T0` from the
    /// strain-isolated grating. Uncompensated where the session has no reference grating or says
    /// that it is compensated already.
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
    /// What the shapes of all pairs share, and which pairs stand aside; none where the session
    /// names no shapes.
    pub shapes: Option<SessionShapes>,
}

/// Shapes of a session: what its pairs share. The pairs themselves stand with their rows
/// ([`WhiskerRow::pair`]).
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

/// Declared model of a transducer or axis session.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum TransducerModel {
    /// response = b0
    Constant,
    /// response = b0 + b1 stimulus
    Linear,
    /// response = b0 + b1 stimulus + b2 stimulus^2
    Quadratic,
    /// Of an axis: measured = commanded + constant; no session states it.
    #[serde(skip)]
    Axis,
}

impl TransducerModel {
    /// Kind of its sessions.
    pub fn kind(self) -> SessionKind {
        match self {
            Self::Axis => SessionKind::Axis,
            _ => SessionKind::Transducer,
        }
    }

    /// Columns of stimulus and response.
    pub fn columns(self) -> [&'static str; 2] {
        match self {
            Self::Axis => ["commanded_mm", "measured_mm"],
            _ => ["stimulus", "response"],
        }
    }
}

/// One reading of a transducer; of an axis the stimulus is the commanded position and the response
/// the measured one, mm.
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
    /// Repetition, of an axis the cycle.
    pub replicate: Option<u32>,
    /// Further covariates, in the order of `TransducerData::covariates`.
    pub covariates: Vec<f64>,
}

/// A transducer or axis session in memory; `[transducer]` states what it declares.
#[derive(Debug, Clone, PartialEq, Deserialize)]
pub struct TransducerData {
    /// Unit of the stimulus.
    pub stimulus_unit: String,
    /// Unit of the response; of an axis that of its error.
    pub response_unit: String,
    /// Declared model.
    pub model: TransducerModel,
    /// The response is a deviation, correction or error of the stimulus: it needs no slope.
    #[serde(default)]
    pub deviation: bool,
    /// Standard uncertainty of the reference that set every stimulus, in its unit: common to all
    /// readings, so that no reading shows it. 0: not stated.
    #[serde(default)]
    pub reference_sd: f64,
    /// Names of further covariate columns.
    #[serde(skip)]
    pub covariates: Vec<String>,
    /// Rows in file order.
    #[serde(skip)]
    pub rows: Vec<TransducerRow>,
}

impl TransducerData {
    /// Of an axis.
    pub fn axis(rows: Vec<TransducerRow>) -> Self {
        Self {
            stimulus_unit: "mm".to_owned(),
            response_unit: "um".to_owned(),
            model: TransducerModel::Axis,
            deviation: false,
            reference_sd: 0.0,
            covariates: Vec::new(),
            rows,
        }
    }
}

/// Data of any kind of session.
#[derive(Debug, Clone, PartialEq)]
// One session at a time is in memory; the size of the variants does not matter.
#[allow(clippy::large_enum_variant)]
pub enum SessionData {
    /// Whisker session.
    Whisker(WhiskerData),
    /// Transducer or axis session.
    Transducer(TransducerData),
}

impl SessionData {
    /// Kind of the session.
    pub fn kind(&self) -> SessionKind {
        match self {
            Self::Whisker(_) => SessionKind::Whisker,
            Self::Transducer(data) => data.model.kind(),
        }
    }
}
