//! What is ordered of a session, its truth, and the session as files in the form of the practice
//! sessions.

use std::fmt::Write as _;
use std::path::Path;

use serde::Serialize;
use serde_json::{Map, Value};

use crate::PlantError;
use crate::bench::Bench;
use crate::effects::{Effect, Kind};
use crate::layout::{Design, PlannedRow};
use crate::noise::Law;
use crate::shapes::{Cameras, Fault, WireAtPose, shapes_json};

/// One kind of tampering.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Tampering {
    /// Replicate 2 is a copy of replicate 1, values and all.
    FakeReplicates,
    /// Two readings of one trajectory have changed places.
    SwappedPoses,
    /// Channel 1 has its sign turned (about the nominal) over a block of rows.
    SignError,
    /// Groove coordinates in metres.
    GrooveInMetres,
    /// Stage positions in micrometres.
    StageInMicrometres,
    /// The clock of a block of rows is late by minutes.
    ClockShift,
    /// The clock runs backwards.
    ClockBackwards,
    /// Holdout rows are copies of points.
    CopiedHoldout,
    /// Temperature and reference columns never change.
    FrozenReference,
}

impl Tampering {
    /// Every trick.
    pub const ALL: [Self; 9] = [
        Self::FakeReplicates,
        Self::SwappedPoses,
        Self::SignError,
        Self::GrooveInMetres,
        Self::StageInMicrometres,
        Self::ClockShift,
        Self::ClockBackwards,
        Self::CopiedHoldout,
        Self::FrozenReference,
    ];

    /// Name in truth.json.
    pub fn name(self) -> &'static str {
        match self {
            Self::FakeReplicates => "fake-replicates",
            Self::SwappedPoses => "swapped-poses",
            Self::SignError => "sign-error",
            Self::GrooveInMetres => "groove-in-metres",
            Self::StageInMicrometres => "stage-in-micrometres",
            Self::ClockShift => "clock-shift",
            Self::ClockBackwards => "clock-backwards",
            Self::CopiedHoldout => "copied-holdout",
            Self::FrozenReference => "frozen-reference",
        }
    }

    /// Verdicts that are no confident wrong name. `effect:NAME` stands for a verdict that names
    /// just that.
    pub fn expected(self) -> &'static [&'static str] {
        match self {
            Self::FakeReplicates => &["refused", "adequate"],
            // Two readings out of place are outliers.
            Self::SwappedPoses => &["refused", "unknown-effect", "effect:slip-outliers"],
            Self::SignError => &["refused", "unknown-effect", "effect:slip-outliers"],
            Self::GrooveInMetres => &["refused"],
            // The groove columns are right; only effects of the stage lose their footing.
            Self::StageInMicrometres => &["refused", "adequate"],
            Self::ClockShift | Self::ClockBackwards => &["refused", "adequate"],
            Self::CopiedHoldout => &["refused"],
            // What is left is the temperature itself: a mismatch by the full 10 pm/degC drives it.
            Self::FrozenReference => &["refused", "unknown-effect"],
        }
    }
}

/// The effect of the catalogue that comes nearest to a session's readings.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Rival {
    /// Identifier.
    pub id: String,
    /// What it leaves unexplained, in noises (linearised, every parameter free).
    pub sigma: f64,
    /// Effects of the catalogue, this one among them, that leave less than three noises: the data
    /// cannot tell them from the truth.
    pub within_three: usize,
}

/// What a session shall contain.
#[derive(Debug, Clone, PartialEq)]
pub enum CaseKind {
    /// No effect.
    Null,
    /// These effects, each (alone) of the target size.
    Effects(Vec<Kind>),
    /// No effect, but tampered with.
    Adversarial(Tampering),
}

/// Make of the wire.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Make {
    /// 0.3 mm, 60 mm, as in the practice sessions.
    #[default]
    Usual,
    /// 0.2 mm, 40 mm.
    Thin,
}

/// What a paper-like session is beside its effects: whether cameras look on, and what is wrong with
/// them and with the declared wire.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PictureSetup {
    /// The session has pictures; else the same session without.
    pub pictures: bool,
    /// Fault of the cameras' setup.
    pub fault: Fault,
    /// Straight part of the real wire less the declared one, mm.
    pub straight_off_mm: f64,
}

/// One order to the plant.
#[derive(Debug, Clone, PartialEq)]
pub struct Request {
    /// Seed of everything random.
    pub seed: u64,
    /// Rows and their order.
    pub design: Design,
    /// Content.
    pub want: CaseKind,
    /// Wanted size of each effect in noises.
    pub target_sigma: f64,
    /// Whether to look for the nearest rival of a single effect (a second or two more).
    pub rivals: bool,
}

/// A reading by its file and number.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Serialize)]
pub struct Flag {
    /// `points.csv` or `holdout.csv`.
    pub source: String,
    /// Number within its file.
    pub point: usize,
}

/// One row as written.
#[derive(Debug, Clone, PartialEq)]
pub struct Reading {
    /// Number within its file.
    pub point: usize,
    /// Plan.
    pub planned: PlannedRow,
    /// Number of the trajectory.
    pub trajectory_id: usize,
    /// Groove centre, mm.
    pub groove_mm: [f64; 3],
    /// Temperature sensor, degC.
    pub temperature_degc: f64,
    /// Reference grating, nm.
    pub reference_nm: f64,
    /// Sensing gratings, nm.
    pub fbg_nm: [f64; 2],
    /// Spread of single samples, pm.
    pub sd_pm: [f64; 2],
    /// Samples averaged.
    pub samples: usize,
}

/// The entry of truth.json; the first keys are those of the practice file.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Truth {
    /// Effects with their own parameters.
    pub effects: Map<String, Value>,
    /// `paper`, `rich`, `repeats`, `shuffled` or `staircase`.
    pub design: Design,
    /// Point-to-point noise of a rest reading in pm.
    pub noise_pm: f64,
    /// How the noise is made.
    pub noise: Law,
    /// Noise of a loaded reading at a pose not visited before, compensated for temperature, over
    /// the rows of holdout.csv, pm.
    pub new_pose_noise_pm: f64,
    /// Noise of repeated readings at rest, pm.
    pub repeat_noise_pm: f64,
    /// Readings that are grossly off.
    pub flagged: Vec<Flag>,
    /// Make of the wire.
    pub wire: Make,
    /// Sensitivity in pm per N mm.
    #[serde(rename = "K")]
    pub k: [[f64; 2]; 2],
    /// Zero in pm.
    pub zero: [f64; 2],
    /// `null`, the effect's name, `pair`, `unknown` or `adversarial`.
    pub label: String,
    /// Names of the effects.
    pub names: Vec<String>,
    /// Step of the target size: 1 (8 sigma) to 4 (40 sigma).
    pub size: usize,
    /// Size after K and the zero have absorbed what they can.
    pub projected_size_in_noises: f64,
    /// True moments for the rows of holdout.csv.
    pub holdout_moments_nmm: Vec<[f64; 2]>,
    /// Law of every effect.
    pub laws: Map<String, Value>,
    /// Size of every effect alone.
    pub sizes_each: Map<String, Value>,
    /// Size asked for.
    pub target_sigma: f64,
    /// False where the physical range ended before the target.
    pub target_reached: bool,
    /// Each effect has 8 noises in the wavelengths or 5 in the contacts that cameras see; none
    /// where nobody looks.
    pub clear: Option<bool>,
    /// Covariates any of which is the right driver (outside the catalogue).
    pub driver: Vec<String>,
    /// Shape outside the catalogue.
    pub shape: Option<String>,
    /// Verdicts that are right for a tampered session.
    pub expected: Vec<String>,
    /// Held-out moment error of an oracle that knows the effect and fits K and the zero, N mm.
    pub oracle_after_nmm: f64,
    /// Nearest other effect of the catalogue, for a single effect.
    pub nearest_rival: Option<Rival>,
    /// Seed.
    pub seed: u64,
}

/// A drawn session.
#[derive(Debug, Clone, PartialEq)]
pub struct Case {
    /// Bench.
    pub bench: Bench,
    /// Rows of points.csv and holdout.csv in order.
    pub readings: Vec<Reading>,
    /// Answer.
    pub truth: Truth,
    /// What acts.
    pub effects: Vec<Effect>,
    /// Bench as the session declares it.
    pub declared: Bench,
    /// How cameras look on; none where nobody asked.
    pub looked: Option<PictureSetup>,
    /// What they see: settled poses, each with its point of points.csv.
    pub shown: Vec<(usize, WireAtPose)>,
}

const HEADER: &str = "point,role,trajectory,replicate,t_s,stage_mm,direction,speed_mm_s,dwell_s,groove_x_mm,groove_y_mm,groove_z_mm,temperature_degc,fbg_ref_nm,fbg_1_nm,fbg_2_nm,fbg_1_sd_pm,fbg_2_sd_pm,samples\n";

/// Writes a file.
pub(crate) fn put(path: &Path, text: &str) -> Result<(), PlantError> {
    std::fs::write(path, text).map_err(|source| PlantError::Write {
        path: path.display().to_string(),
        source,
    })
}

impl Case {
    /// Writes `session.toml`, `points.csv` and `holdout.csv` into `folder` (made if missing); its
    /// name is the id.
    ///
    /// # Errors
    /// [`PlantError::Write`] with the file that could not be written.
    pub fn write(&self, folder: &Path) -> Result<(), PlantError> {
        std::fs::create_dir_all(folder).map_err(|source| PlantError::Write {
            path: folder.display().to_string(),
            source,
        })?;
        let id = folder
            .file_name()
            .map_or_else(|| "case".into(), |n| n.to_string_lossy().into_owned());
        put(&folder.join("session.toml"), &self.session_toml(&id))?;
        put(&folder.join("points.csv"), &self.table(false))?;
        if let Some(looked) = self.looked.filter(|l| l.pictures) {
            let cameras = Cameras::of_session(self.truth.seed);
            let shapes = shapes_json(&id, &self.shown, &cameras, looked.fault, self.truth.seed);
            put(&folder.join("shapes.json"), &shapes.to_string())?;
        }
        if !self.has_holdout() {
            return Ok(());
        }
        put(&folder.join("holdout.csv"), &self.table(true))
    }

    fn has_holdout(&self) -> bool {
        self.readings.iter().any(|r| r.planned.holdout)
    }

    fn table(&self, holdout: bool) -> String {
        let mut out = String::from(HEADER);
        let decimals = self.truth.noise.decimals();
        for r in self
            .readings
            .iter()
            .filter(|r| r.planned.holdout == holdout)
        {
            let p = &r.planned;
            let [x, y, z] = r.groove_mm.map(|v| v + 0.0);
            let _ = writeln!(
                out,
                "{},{},{},{},{:.3},{:.6},{},{:.3},{:.3},{x:.5},{y:.5},{z:.5},{:.3},{:.decimals$},{:.decimals$},{:.decimals$},{:.4},{:.4},{}",
                r.point,
                p.role,
                r.trajectory_id,
                p.replicate,
                p.t_s,
                p.stage_mm,
                p.direction,
                p.speed_mm_s,
                p.dwell_s,
                r.temperature_degc,
                r.reference_nm,
                r.fbg_nm[0],
                r.fbg_nm[1],
                r.sd_pm[0],
                r.sd_pm[1],
                r.samples
            );
        }
        out
    }

    fn session_toml(&self, id: &str) -> String {
        let b = &self.declared;
        let pictures = self.looked.is_some_and(|l| l.pictures);
        let mut out = format!(
            "format = \"wcal-session/1\"\nid = \"{id}\"\nkind = \"whisker\"\nmedium = \"air\"\ncreated = \"2026-11-20T09:00:00Z\"\n\n\
             [files]\npoints = \"points.csv\"\n{}{}\n\
             [provenance]\nsimulated = true\nsimulated_by = \"the examiner's plant\"\n\n\
             [whisker]\ndiameter_mm = {}\nlength_mm = {:.1}\nstraight_mm = {:.1}\narc_radius_mm = {:.1}\n\
             youngs_gpa = {:.1}\nshear_gpa = {:.4}\ndensity_kg_m3 = 6450.0\n\n\
             [fbg]\nnominal_nm = [{:.3}, {:.3}]\nreference_nominal_nm = {:.3}\n\
             temperature_pm_per_degc = [10.0, 10.0]\nreference_temperature_pm_per_degc = 10.0\n\n",
            if self.has_holdout() {
                "holdout = \"holdout.csv\"\n"
            } else {
                ""
            },
            if pictures {
                "shapes = \"shapes.json\"\n"
            } else {
                ""
            },
            b.diameter_mm,
            b.length_mm,
            b.straight_mm,
            b.arc_radius_mm,
            b.youngs_gpa,
            b.shear_gpa,
            b.nominal_nm[0],
            b.nominal_nm[1],
            b.reference_nominal_nm
        );
        for t in b.trajectories() {
            let (o, d) = (
                t.path.origin_mm.map(|v| v + 0.0),
                t.path.direction.map(|v| v + 0.0),
            );
            let _ = write!(
                out,
                "[[trajectory]]\nid = {}\nnominal_arclength_mm = {:.1}\norigin_mm = [{:.6}, {:.6}, {:.6}]\n\
                 direction = [{:.8}, {:.8}, {:.8}]\n\n",
                t.id, t.path.arclength_mm, o.x, o.y, o.z, d.x, d.y, d.z
            );
        }
        out
    }
}
