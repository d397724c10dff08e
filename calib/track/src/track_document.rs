//! `track.json`: what a track is made of and what was found, as a program reads it.

use crate::arc_posterior::Region;
use crate::known_motion::Innovations;
use crate::mesh_score::MeshScore;
use schemars::JsonSchema;
use serde::Serialize;
use std::collections::BTreeMap;
use std::path::PathBuf;
use wcal_core::verify_document::GrooveTracking;
use wcal_network::segments::Segment;

/// Version of `track.csv` and `track.json`.
pub const TRACK_FORMAT: &str = "wcal-track/2";
/// What a place is along a known motion, and by the moments alone.
pub const AXIS_OF_WIRE: &str = "axis of the wire at the contact, base frame";
/// See [`AXIS_OF_WIRE`].
pub(crate) const POINT_OF_OBJECT: &str = "point of the object, base frame";

/// Where readings come from.
#[derive(Debug, Clone, Serialize, JsonSchema)]
#[serde(untagged)]
pub enum TrackSource {
    /// A table or a session folder.
    File(PathBuf),
    /// Recordings.
    Recordings(Vec<PathBuf>),
    /// An interrogator.
    Device(String),
}

/// How the contacts were found where no model did.
#[derive(Debug, Clone, Copy, Serialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Method {
    /// Along a known motion.
    KnownMotion,
    /// By the moments alone.
    #[serde(rename = "moments-alone")]
    StaticArc,
}

/// Summary of track.csv: a table and a session by known motion have their counts at the top, a
/// stream has them for each whisker.
#[derive(Debug, Clone, Serialize, JsonSchema)]
pub struct TrackDocument {
    /// Format and version.
    #[schemars(extend("const" = TRACK_FORMAT))]
    pub format: &'static str,
    /// Where the readings come from.
    pub source: TrackSource,
    /// The readings or the calibration are not measured.
    pub simulated: bool,
    /// The table.
    pub out: PathBuf,
    /// Of a table or a session; none of a stream.
    #[serde(flatten)]
    pub table: Option<TableDocument>,
    /// Of a stream.
    #[serde(flatten)]
    pub stream: Option<StreamDocument>,
}

impl TrackDocument {
    /// The rows of each whisker.
    pub fn whiskers(&self) -> impl Iterator<Item = &WhiskerDocument> {
        let streamed = self
            .stream
            .iter()
            .flat_map(|s| s.whiskers.iter().map(|w| &w.rows));
        self.table.iter().map(|t| &t.whisker).chain(streamed)
    }
}

/// Of a table or a session.
#[derive(Debug, Clone, Serialize, JsonSchema)]
pub struct TableDocument {
    /// Lag of the rows, s.
    pub lag_s: f64,
    /// Time whose mean moments are the zero, s; none for a session, whose rest readings are.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub tare_s: Option<f64>,
    /// Readings that could not be used.
    pub unusable_rows: u64,
    /// Log of a motion.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub motion: Option<LogDocument>,
    /// Distance of the contacts from the mesh of the object that is passed.
    pub object: Option<MeshScore>,
    /// Groove of a session against the answers.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub groove_tracking: Option<Option<GrooveTracking>>,
    /// Its whisker.
    #[serde(flatten)]
    pub whisker: WhiskerDocument,
}

/// Rows of one whisker.
#[derive(Debug, Clone, Serialize, JsonSchema)]
pub struct WhiskerDocument {
    /// Rows.
    pub rows: u64,
    /// Rows with a status other than ok.
    pub flagged_rows: u64,
    /// Rows outside the calibration's region.
    pub outside_valid_region: u64,
    /// What speaks against trusting it.
    pub doubts: Vec<String>,
    /// Hash of the calibration's content.
    #[schemars(regex(pattern = "^[0-9a-f]{64}$"))]
    pub calibration_sha256: String,
    /// Contact intervals, where contacts were followed by their places.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub segments: Option<Vec<Segment>>,
    /// Answers compared with a known groove.
    pub known_groove: Option<GrooveScore>,
    /// RMS error on the known groove at the last reading of each contact, mm.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub end_rmse_mm: Option<Option<f64>>,
    /// What the estimator found.
    #[serde(flatten)]
    pub estimator: EstimatorDocument,
}

/// What an estimator found; what it does not know is absent.
#[derive(Debug, Clone, Default, Serialize, JsonSchema)]
pub struct EstimatorDocument {
    /// How.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub method: Option<Method>,
    /// What a place is.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub place: Option<&'static str>,
    /// Hash of the weights.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(regex(pattern = "^[0-9a-f]{64}$"))]
    pub model_sha256: Option<String>,
    /// Always true.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub trained_on_simulation: Option<bool>,
    /// Rows in contact in a motion that is not known to be one of training.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub motion_assumed_rows: Option<u64>,
    /// Rows with several contacts.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub several_contacts: Option<SeveralContacts>,
    /// Rows without a motion, by why.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub lost_rows: Option<BTreeMap<&'static str, u64>>,
    /// Rows at which moments and motion do not belong together.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub disagreeing_rows: Option<u64>,
    /// Contacts in order of time.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub contacts: Option<Vec<ContactDocument>>,
    /// Trajectories of a session.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub trajectories: Option<Vec<ContactDocument>>,
}

/// A contact of a known motion, or a trajectory of a session.
#[derive(Debug, Clone, Default, Serialize, JsonSchema)]
pub struct ContactDocument {
    /// Identifier of a session's trajectory.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub trajectory: Option<u32>,
    /// Regions of first touch along the wire; null where nothing was found, or where they change
    /// from reading to reading.
    pub regions: Option<Vec<Region>>,
    /// Sum of squares of the innovations.
    pub chi2: f64,
    /// The same with the outliers' own noise.
    pub chi2_robust: f64,
    /// Degrees of freedom.
    pub dof: f64,
    /// Outliers.
    #[serde(rename = "gross")]
    pub outlier: usize,
    /// Why moments and motion do not belong together.
    pub disagreement: Option<&'static str>,
    /// Readings.
    pub readings: usize,
    /// First reading, s.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub from_s: Option<f64>,
    /// Last reading, s.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub to_s: Option<f64>,
    /// How the contact moves on the object, where one way is more probable than all others
    /// together.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(extend("enum" = ["fixed", "creeping", "sliding", "misstated", "anywhere", "undecided"]))]
    pub contact: Option<&'static str>,
    /// Probability of each way.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub weights: Option<BTreeMap<&'static str, f64>>,
    /// How well the motion predicts a sliding contact.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sliding: Option<Option<SlidingDocument>>,
    /// How far the contact moves where the calibration's moments are too large by 1 %, which they
    /// do not show themselves, mm.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub mm_by_gain_percent: Option<f64>,
}

impl ContactDocument {
    /// By its innovations.
    pub(crate) fn new(i: &Innovations, readings: usize) -> Self {
        Self {
            chi2: i.plain,
            chi2_robust: i.robust,
            dof: i.dof,
            outlier: i.outlier,
            disagreement: (!i.consistent()).then_some("motion-disagrees"),
            readings,
            ..Self::default()
        }
    }
}

/// How well a motion predicts a sliding contact.
#[derive(Debug, Clone, Copy, Serialize, JsonSchema)]
pub struct SlidingDocument {
    /// Marginal log likelihood of the readings along the motion, natural units of 1/(N mm)^2 a
    /// block.
    pub log_evidence: f64,
    /// The same of the reversed motion.
    pub reversed_log_evidence: f64,
    /// Readings that were predicted.
    pub predicted: usize,
}

/// Rows with several contacts.
#[derive(Debug, Clone, Copy, Serialize, JsonSchema)]
pub struct SeveralContacts {
    /// Rows with a probability of several contacts.
    pub rows: u64,
    /// Rows at which it is above 0.5.
    pub probable_rows: u64,
}

/// Answers compared with a known groove.
#[derive(Debug, Clone, Copy, Serialize, JsonSchema)]
pub struct GrooveScore {
    /// Readings with a known groove.
    pub readings: usize,
    /// Of them compared.
    pub compared: usize,
    /// Readings at which no contact was seen.
    pub without_contact: usize,
    /// RMS distance, mm.
    pub rmse_mm: f64,
    /// Median, mm.
    pub median_mm: f64,
    /// 95 % quantile, mm.
    pub p95_mm: f64,
    /// Largest, mm.
    pub largest_mm: f64,
    /// Share in the stated 95 % regions.
    pub coverage95: Option<f64>,
}

/// The log of a table's motion.
#[derive(Debug, Clone, Serialize, JsonSchema)]
pub struct LogDocument {
    /// File.
    pub file: PathBuf,
    /// First and last time, s.
    pub span_s: [f64; 2],
    /// Readings without a motion, by why.
    pub lost_rows: BTreeMap<&'static str, u64>,
    /// Lines at which it jumps.
    pub jump_lines: Vec<usize>,
}

/// Of a stream.
#[derive(Debug, Clone, Serialize, JsonSchema)]
pub struct StreamDocument {
    /// Rows a second.
    pub rate_hz: f64,
    /// Beginning without contact, s.
    pub prefix_s: f64,
    /// Recordings that were cut off.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub cut_off: Option<Vec<String>>,
    /// Scans that the tracker dropped.
    pub dropped_scans: u64,
    /// Scans, gaps and scans lost.
    pub scans: u64,
    /// Gaps (stream).
    pub gaps: u64,
    /// Scans lost (stream).
    pub lost_scans: u64,
    /// Scans a second.
    pub scan_rate_hz: f64,
    /// Lag of the filter, s.
    pub lag_s: Option<f64>,
    /// Time whose mean moments are the zero, s.
    pub tare_s: f64,
    /// The low-pass.
    pub filter: Option<FilterDocument>,
    /// First scan by the interrogator's clock, s.
    pub origin_device_s: Option<f64>,
    /// Time spent.
    pub time: TimeDocument,
    /// By whisker.
    pub whiskers: Vec<StreamedWhisker>,
    /// Where the motion comes from; none with a model.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub stream_motion: Option<StreamMotionDocument>,
}

/// A low-pass.
#[derive(Debug, Clone, Copy, Serialize, JsonSchema)]
pub struct FilterDocument {
    /// What it is.
    pub kind: &'static str,
    /// Gains at 1, 5, 10 and 34 Hz.
    pub gain_1_hz: f64,
    /// Gain at 5 Hz.
    pub gain_5_hz: f64,
    /// Gain at 10 Hz.
    pub gain_10_hz: f64,
    /// Gain at 34 Hz.
    pub gain_34_hz: f64,
    /// Gain of white noise.
    pub noise_gain: f64,
}

/// Time that a stream took.
#[derive(Debug, Clone, Copy, Serialize, JsonSchema)]
pub struct TimeDocument {
    /// Of the stream, s.
    pub stream_s: f64,
    /// Of the clock, s.
    pub wall_s: Option<f64>,
    /// Their ratio.
    pub times_real_time: Option<f64>,
    /// Before the network, us a scan.
    pub chain_us_per_scan: f64,
    /// In the network, s.
    pub network_s: f64,
}

/// A whisker of a stream.
#[derive(Debug, Clone, Serialize, JsonSchema)]
pub struct StreamedWhisker {
    /// Name; empty where there is one.
    pub whisker: String,
    /// Scans without usable peaks.
    pub unusable_scans: u64,
    /// Noise of means over 2 ms in the prefix without contact, N mm.
    pub noise_sd_nmm: Option<[f64; 2]>,
    /// Its rows.
    #[serde(flatten)]
    pub rows: WhiskerDocument,
}

/// Where the motion of a stream comes from.
#[derive(Debug, Clone, Serialize, JsonSchema)]
pub struct StreamMotionDocument {
    /// What says how base and object move.
    pub source: &'static str,
    /// First and last time of the log, s.
    pub span_s: Option<[f64; 2]>,
    /// Lines at which the log jumps.
    pub jump_lines: Option<Vec<usize>>,
}
