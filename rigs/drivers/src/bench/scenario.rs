//! The scenario file: the truth of a virtual bench. Only the bench reads it, never the program
//! under test.

mod cameras;

pub use cameras::CameraScenario;

use super::faults::ScheduledFault;
use super::unit::UnitSpec;
use nalgebra::Vector3;
use serde::Deserialize;
use wcal_core::document::from_toml;
use wcal_core::observation::WHISKER_RANGES;
use wcal_core::ranges::Range;

/// `format` of the scenario file.
const FORMAT: &str = "wcal-scenario/1";

/// Numbers that a scenario may state, where a wrong one would stop or drown the bench.
const RANGES: &[Range] = &[
    Range::whole("seed", 0.0, 1.9e19),
    Range::real("speed", 1e-3, 1e6),
    Range::whole("baud", 300.0, 1e7),
    Range::real("microstep_um", 1e-6, 1e3),
    Range::whole("limit_steps", 1.0, 1e12),
    Range::real("max_speed_mm_s", 1e-3, 1e4),
    Range::real("acceleration_mm_s2", 1e-2, 1e6),
    Range::real("start_mm", -1e5, 1e5),
    Range::real("zero_mm", -1e5, 1e5),
    Range::whole("steps_per_trajectory", -1e9, 1e9),
    Range::real("interrogator.rate_hz", 0.1, 1e5),
    Range::real("noise_pm", 0.0, 1e6),
    Range::whole("split_bytes", 0.0, 1e9),
    Range::whole("buffer", 1.0, 1e8),
    Range::real("nominal_nm", 400.0, 2500.0),
    Range::real("reference_nominal_nm", 400.0, 2500.0),
    Range::real("trajectory.origin_mm", -1e4, 1e4),
    Range::real("trajectory.direction", -1e3, 1e3),
    Range::whole("trajectory.id", 0.0, 4e9),
    Range::real("backlash_um", 0.0, 1e6),
    Range::real("start_degc", -273.0, 1e3),
    Range::real("swing_period_s", 1e-3, 1e9),
    Range::real("creep_s", 0.0, 1e9),
    Range::real("lag_ms", 0.0, 1e5),
    Range::real("groove_offset_mm", -10.0, 10.0),
    Range::real("root_turn_rad_per_nmm", -1.0, 1.0),
    Range::whole("cameras.count", 0.0, 2.0),
    Range::real("cameras.rate_hz", 1e-2, 1e3),
    Range::whole("size_px", 16.0, 4096.0),
    Range::real("skew_ms", -1e5, 1e5),
    Range::whole("moving_binning", 1.0, 4096.0),
    Range::real("exposure", 1e-6, 1e6),
    Range::real("blur_px", 0.0, 100.0),
    Range::real("noise_dn", 0.0, 1e3),
    Range::real("uneven_light", -1.0, 1.0),
    Range::whole("board_views", 0.0, 1000.0),
    Range::whole("board_corners", 2.0, 200.0),
    Range::real("board_square_mm", 1e-2, 1e4),
    Range::real("board_scale", 1e-3, 1e3),
    Range::real("fault.at_s", 0.0, 1e9),
    Range::real("fault.seconds", 0.0, 1e9),
    Range::whole("fault.count", 0.0, 1e12),
];
/// Sizes of effects and faults.
const REST: &[Range] = &[Range::real("", -1e9, 1e9)];

/// A whole scenario; every part has defaults.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Scenario {
    /// `wcal-scenario/1`.
    pub format: String,
    /// Seed of every random draw.
    #[serde(default)]
    pub seed: u64,
    /// Bench seconds per wall second.
    #[serde(default = "one")]
    pub speed: f64,
    /// The linear stage.
    #[serde(default)]
    pub stage: StageScenario,
    /// The motorised mount that turns the whisker to a trajectory.
    #[serde(default)]
    pub mount: MountScenario,
    /// Interrogators: scan rate, noise, framing.
    #[serde(default)]
    pub interrogator: InterrogatorScenario,
    /// Gratings.
    #[serde(default)]
    pub fbg: FbgScenario,
    /// Wire.
    #[serde(default)]
    pub whisker: WhiskerScenario,
    /// Paths of the groove; empty: the nine of the default rig.
    #[serde(default)]
    pub trajectory: Vec<TrajectoryScenario>,
    /// Temperature of the room.
    #[serde(default)]
    pub temperature: TemperatureScenario,
    /// Effects outside the declared model.
    #[serde(default)]
    pub effects: EffectsScenario,
    /// Cameras.
    #[serde(default)]
    pub cameras: CameraScenario,
    /// Faults and their times.
    #[serde(default)]
    pub fault: Vec<ScheduledFault>,
}

fn one() -> f64 {
    1.0
}

impl Scenario {
    /// Parses a scenario and checks its ranges.
    ///
    /// # Errors
    /// Field, what was expected and what was found.
    pub fn parse(text: &str) -> Result<Self, String> {
        let scenario: Self =
            from_toml(text, FORMAT, &[RANGES, WHISKER_RANGES, REST]).map_err(|e| e.to_string())?;
        let camera_sizes = scenario.cameras.size_px;
        let binning = scenario.cameras.moving_binning;
        // Blocks of pixels have to cover a picture exactly.
        if binning == 0 || camera_sizes.iter().any(|s| s % binning != 0) {
            return Err(format!(
                "cameras.moving_binning: expected a divisor of {camera_sizes:?}, found {binning}"
            ));
        }
        if ![0, 2].contains(&scenario.cameras.count) {
            return Err(format!(
                "cameras.count: expected 0 or 2, found {}",
                scenario.cameras.count
            ));
        }
        let w = &scenario.whisker;
        // E = 2 G (1 + nu): no metal has a shear modulus above Young's.
        if w.straight_mm > w.length_mm || w.shear_gpa >= w.youngs_gpa {
            return Err(format!(
                "whisker: expected straight_mm within length_mm and G below E, found {w:?}"
            ));
        }
        let flat = |t: &&TrajectoryScenario| Vector3::from(t.direction).norm() < 1e-6;
        if let Some(t) = scenario.trajectory.iter().find(flat) {
            return Err(format!(
                "trajectory {}: expected a direction, found a zero vector",
                t.id
            ));
        }
        Ok(scenario)
    }

    /// Trajectories, the default nine where none are given.
    pub fn trajectories(&self) -> Vec<TrajectoryScenario> {
        if self.trajectory.is_empty() {
            default_trajectories(&self.whisker)
        } else {
            self.trajectory.clone()
        }
    }
}

/// Protocol of the stage.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum StageProtocol {
    /// X-series.
    #[default]
    Ascii,
    /// T-series.
    Binary,
}

/// The stage and its links.
#[derive(Debug, Clone, PartialEq, Default, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct StageScenario {
    /// Protocol.
    pub protocol: StageProtocol,
    /// Line speed on the pseudo-terminal; a client at another speed is not understood. Absent: any.
    pub baud: Option<u32>,
    /// The unit.
    pub unit: UnitSpec,
    /// Stage position at which the groove touches the wire, mm.
    pub zero_mm: Option<f64>,
}

impl StageScenario {
    /// Stage position at first contact, mm.
    pub fn contact_mm(&self) -> f64 {
        self.zero_mm.unwrap_or(20.0)
    }
}

/// A second unit on the chain: position `steps_per_trajectory * id` presents trajectory `id`.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct MountScenario {
    /// Whether the chain has it.
    pub present: bool,
    /// Microsteps between two trajectories.
    pub steps_per_trajectory: i64,
}

impl Default for MountScenario {
    fn default() -> Self {
        Self {
            present: true,
            steps_per_trajectory: 10_000,
        }
    }
}

/// Where the frame token counts.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum TokenPlace {
    /// In the stated length.
    #[default]
    Inside,
    /// After it.
    Outside,
}

/// Interrogators.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct InterrogatorScenario {
    /// Scan rate, Hz.
    pub rate_hz: f64,
    /// Noise of a single scan, pm.
    pub noise_pm: f64,
    /// Framing of the stream.
    pub token: TokenPlace,
    /// Cut what is sent into pieces of this many bytes; 0: as it comes.
    pub split_bytes: usize,
    /// Scans kept for a slow client before they are lost.
    pub buffer: usize,
    /// Offset of the unit's clock from the host's, s.
    pub clock_offset_s: f64,
    /// Drift of the unit's clock, parts per million.
    pub clock_drift_ppm: f64,
}

impl Default for InterrogatorScenario {
    fn default() -> Self {
        Self {
            rate_hz: 2000.0,
            noise_pm: 1.0,
            token: TokenPlace::Inside,
            split_bytes: 0,
            buffer: 60_000,
            clock_offset_s: 0.0,
            clock_drift_ppm: 0.0,
        }
    }
}

/// Gratings and their sensitivities.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct FbgScenario {
    /// Sensing gratings, nm.
    pub nominal_nm: [f64; 2],
    /// Strain-isolated grating, nm.
    pub reference_nominal_nm: f64,
    /// Shift per moment, pm/(N mm): one row a grating.
    pub k_pm_per_nmm: [[f64; 2]; 2],
    /// Temperature coefficients of the sensing gratings, pm/K.
    pub temperature_pm_per_degc: [f64; 2],
    /// Temperature coefficient of the reference, pm/K.
    pub reference_temperature_pm_per_degc: f64,
    /// Unloaded shift from nominal, pm.
    pub zero_pm: [f64; 2],
}

impl Default for FbgScenario {
    fn default() -> Self {
        Self {
            nominal_nm: [1541.2, 1535.8],
            reference_nominal_nm: 1537.3,
            k_pm_per_nmm: [[72.0, 9.0], [-6.0, 78.0]],
            temperature_pm_per_degc: [10.0, 10.0],
            reference_temperature_pm_per_degc: 10.0,
            zero_pm: [3.0, -2.0],
        }
    }
}

/// Wire, straight and then bent toward -z.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct WhiskerScenario {
    /// Diameter, mm.
    pub diameter_mm: f64,
    /// Length, mm.
    pub length_mm: f64,
    /// Straight part, mm.
    pub straight_mm: f64,
    /// Arc radius, mm.
    pub arc_radius_mm: f64,
    /// Young's modulus, GPa.
    pub youngs_gpa: f64,
    /// Shear modulus, GPa.
    pub shear_gpa: f64,
}

impl Default for WhiskerScenario {
    fn default() -> Self {
        Self {
            diameter_mm: 0.3,
            length_mm: 60.0,
            straight_mm: 30.0,
            arc_radius_mm: 20.0,
            youngs_gpa: 75.0,
            shear_gpa: 28.2,
        }
    }
}

/// A straight path of the groove.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TrajectoryScenario {
    /// Identifier.
    pub id: u32,
    /// Groove centre at first contact, mm, base frame.
    pub origin_mm: [f64; 3],
    /// Direction of travel.
    pub direction: [f64; 3],
}

/// Three contact arc lengths, three directions each (docs/src/system.md: 9 linear trajectories).
fn default_trajectories(whisker: &WhiskerScenario) -> Vec<TrajectoryScenario> {
    let mut list = Vec::new();
    // On the straight part, just past its end, and on the arc of the default wire.
    for arclength_mm in [18.0, 31.0, 45.0] {
        let (origin_mm, tangent) = rest_point(whisker, arclength_mm);
        let normal = [-tangent[2], 0.0, tangent[0]];
        for turn_deg in [0.0_f64, -60.0, 60.0] {
            // Turned about the tangent: a groove pushes across the wire.
            let (sin, cos) = turn_deg.to_radians().sin_cos();
            let direction = [normal[0] * cos, sin, normal[2] * cos];
            list.push(TrajectoryScenario {
                id: list.len() as u32 + 1,
                origin_mm,
                direction,
            });
        }
    }
    list
}

/// Temperature of the room.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TemperatureScenario {
    /// At the start, deg C; the gratings' nominal wavelengths are those at 21.
    pub start_degc: f64,
    /// Linear drift, K/h.
    pub drift_degc_per_h: f64,
    /// Amplitude of a slow oscillation, K.
    pub swing_degc: f64,
    /// Its period, s.
    pub swing_period_s: f64,
}

impl Default for TemperatureScenario {
    fn default() -> Self {
        Self {
            start_degc: 21.0,
            drift_degc_per_h: 0.3,
            swing_degc: 0.05,
            swing_period_s: 600.0,
        }
    }
}

/// Physical effects; zero is none.
#[derive(Debug, Clone, PartialEq, Default, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct EffectsScenario {
    /// Play after a reversal, um.
    pub backlash_um: f64,
    /// Scale error of the screw.
    pub stage_scale: f64,
    /// Periodic error of the screw, um.
    pub periodic_um: f64,
    /// Delay of the signal behind the stage, ms.
    pub lag_ms: f64,
    /// Drift of both zeros, pm/min.
    pub zero_drift_pm_per_min: f64,
    /// Relaxed share of the moment that creeps.
    pub creep_fraction: f64,
    /// Time constant of creep, s.
    pub creep_s: f64,
    /// Quadratic share of the response at 1 N mm along the grating's axis.
    pub quadratic_fraction: f64,
    /// Shift of the groove from its stated paths, base frame, mm.
    pub groove_offset_mm: [f64; 3],
    /// Turn of the wire's root per base moment, rad/(N mm).
    pub root_turn_rad_per_nmm: f64,
}

/// Centre line at an arc length (mm): point and unit tangent.
pub fn rest_point(whisker: &WhiskerScenario, s_mm: f64) -> ([f64; 3], [f64; 3]) {
    let turn = ((s_mm - whisker.straight_mm) / whisker.arc_radius_mm).max(0.0);
    let (sin, cos) = turn.sin_cos();
    let x = s_mm.min(whisker.straight_mm) + whisker.arc_radius_mm * sin;
    (
        [x, 0.0, -whisker.arc_radius_mm * (1.0 - cos)],
        [cos, 0.0, -sin],
    )
}

#[cfg(test)]
mod tests {
    use super::Scenario;

    #[test]
    fn the_shortest_scenario_has_nine_trajectories() {
        let scenario = Scenario::parse("format = \"wcal-scenario/1\"").unwrap();
        assert_eq!(scenario.trajectories().len(), 9);
    }

    #[test]
    fn unknown_keys_wrong_formats_and_absurd_numbers_are_refused() {
        for bad in [
            "",
            "format = \"wcal-scenario/9\"",
            "format = \"wcal-scenario/1\"\nsped = 2",
            "format = \"wcal-scenario/1\"\nspeed = 0",
            "format = \"wcal-scenario/1\"\n[[trajectory]]\nid = 1\norigin_mm = [1, 0, 0]\ndirection = [0, 0, 0]",
            "format = \"wcal-scenario/1\"\n[cameras]\nsize_px = [9000, 480]",
            "format = \"wcal-scenario/1\"\n[cameras]\nmoving_binning = 0",
            "format = \"wcal-scenario/1\"\n[cameras]\nmoving_binning = 7",
            "format = \"wcal-scenario/1\"\n[cameras]\ncount = 3",
            "format = \"wcal-scenario/1\"\n[cameras.errors]\nboard_scale = 0",
            "format = \"wcal-scenario/1\"\n[[fault]]\nat_s = 1\nkind = \"earthquake\"",
        ] {
            assert!(Scenario::parse(bad).is_err(), "{bad}");
        }
    }
}
