//! The devices of a rig as `rig.toml` states them, and who opens them.
//!
//! The whole file is read by wcal-acquisition; a driver needs no more than its own entry.

use crate::clock::HostClock;
use crate::device::{Camera, DeviceError, Interrogator, Mount, Stage};
use crate::ranges::Range;
use crate::rigid::RigidPose;
use serde::de::Error;
use serde::{Deserialize, Deserializer};
use std::collections::BTreeMap;

/// `format` of a rig file.
pub const RIG_FORMAT: &str = "wcal-rig/1";

/// Numbers that a rig may state; those of `[whisker]` are [`crate::observation::WHISKER_RANGES`].
pub const RIG_RANGES: &[Range] = &[
    Range::real("clock_scale", 1e-3, 1e4),
    Range::real("camera_skew_limit_ms", 0.0, 1e4),
    Range::real("microstep_um", 1e-6, 1e3),
    Range::real("travel_mm", 1e-3, 1e5),
    Range::real("soft_limits_mm", 0.0, 1e5),
    Range::real("stage.zero_mm", -1e5, 1e5),
    Range::real("speed_mm_s", 1e-6, 1e4),
    Range::real("approach_mm", 0.0, 1e3),
    Range::real("retract_mm", -1e5, 1e5),
    // 0 is all units, and all axes of a unit: what is meant for one would move every other.
    Range::whole("address", 1.0, 254.0),
    Range::whole("axis", 1.0, 9.0),
    Range::whole("baud", 300.0, 1e7),
    Range::whole("trajectory.id", 0.0, 4e9),
    Range::whole("tags.id", 0.0, 1e6),
    Range::whole("groove.tag", 0.0, 1e6),
    Range::whole("steps_per_trajectory", -1e9, 1e9),
    Range::real("interrogator.rate_hz", 0.1, 1e6),
    Range::whole("channel", 1.0, 1024.0),
    Range::real("nominal_nm", 400.0, 2500.0),
    Range::real("window_nm", 1e-4, 1e3),
    Range::real("camera.rate_hz", 1e-4, 1e5),
    Range::whole("image_size_px", 16.0, 65_536.0),
    Range::real("exposure_ms", 1e-4, 1e6),
    Range::real("gain_db", -100.0, 200.0),
    Range::real("trajectory.origin_mm", -1e4, 1e4),
    Range::real("trajectory.direction", -1e3, 1e3),
    Range::real("nominal_arclength_mm", 0.0, 2000.0),
    Range::real("world_from_base", -1e6, 1e6),
    Range::real("carried_along", -1e3, 1e3),
    Range::real("temperature_pm_per_degc", -1e4, 1e4),
    Range::real("reference_temperature_pm_per_degc", -1e4, 1e4),
    Range::real("moments.axes", -1.001, 1.001),
    Range::real("size_mm", 0.1, 1e4),
    Range::real("base_from_tag", -1e5, 1e5),
    Range::real("half_angle_deg", 0.1, 89.9),
    Range::real("position_in_tag_mm", -1e4, 1e4),
    Range::real("width_along_wire_mm", 0.0, 1e3),
];

/// Opens devices by what a rig says of them: real and virtual ones by wcal-drivers, scripted ones
/// in tests.
pub trait DeviceOpener {
    /// The linear stage; opened anew after its link was lost, on the same line as before, whose old
    /// link is dropped first. Moves nothing.
    ///
    /// # Errors
    /// `Configuration` for a travel that is not the rig's, else what the unit reports.
    fn stage(&mut self, rig: &StageRig, clock: HostClock) -> Result<Box<dyn Stage>, DeviceError>;
    /// A motorised mount, once the stage is open (both may hang on one line); `None` where the
    /// whisker is turned by hand. Moves nothing.
    ///
    /// # Errors
    /// What the unit reports.
    fn mount(
        &mut self,
        rig: &MountRig,
        clock: HostClock,
    ) -> Result<Option<Box<dyn Mount>>, DeviceError>;
    /// The interrogator.
    ///
    /// # Errors
    /// What the unit reports.
    fn interrogator(
        &mut self,
        rig: &InterrogatorRig,
        clock: HostClock,
    ) -> Result<Box<dyn Interrogator + Send>, DeviceError>;
    /// One camera, its exposure and gain set.
    ///
    /// # Errors
    /// What the camera reports.
    fn camera(
        &mut self,
        rig: &CameraRig,
        clock: HostClock,
    ) -> Result<Box<dyn Camera + Send>, DeviceError>;
    /// Questions to the stage that had to be repeated so far.
    fn repeats(&self) -> u64;
}

fn first() -> u8 {
    1
}

fn half() -> f64 {
    0.5
}

/// The linear stage.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StageRig {
    /// Protocol of the unit.
    pub driver: StageDriver,
    /// `tcp://host:port` or the path of a serial port.
    pub port: String,
    /// Line speed; absent: probed.
    pub baud: Option<u32>,
    /// Address on the chain.
    #[serde(default = "first")]
    pub address: u8,
    /// Axis.
    #[serde(default = "first")]
    pub axis: u8,
    /// Microstep size, um.
    pub microstep_um: f64,
    /// Travel, mm; compared with what the unit says.
    pub travel_mm: f64,
    /// Positions the rig allows, mm of the stage's own scale.
    pub soft_limits_mm: [f64; 2],
    /// Stage position at `stage_mm = 0` of the session, mm.
    pub zero_mm: f64,
    /// Highest speed, mm/s.
    pub speed_mm_s: f64,
    /// `one-sided`: arrive from the retracted side always; `direct`.
    #[serde(default)]
    pub approach: Approach,
    /// Overshoot of a one-sided approach, mm.
    #[serde(default = "half")]
    pub approach_mm: f64,
    /// Safe retract, mm relative to the zero (negative: away from the wire).
    pub retract_mm: f64,
}

/// Drivers of a stage.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum StageDriver {
    /// Zaber ASCII.
    ZaberAscii,
    /// Zaber binary, as T-series units speak it.
    ZaberBinary,
}

impl StageDriver {
    /// Highest address of a unit on a line that the stage shares with a motorised mount; none where
    /// the line carries no mount.
    pub fn last_shared_address(self) -> Option<u8> {
        match self {
            Self::ZaberAscii => Some(99),
            Self::ZaberBinary => None,
        }
    }
}

/// How a position is reached.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Approach {
    /// Straight to the target.
    #[default]
    Direct,
    /// Targets that lie behind are passed and approached again in the direction of loading.
    OneSided,
}

/// How the whisker is turned.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(tag = "kind", rename_all = "kebab-case", deny_unknown_fields)]
#[derive(Default)]
pub enum MountRig {
    /// By hand, on request.
    #[default]
    Manual,
    /// A second unit on the stage's chain.
    Zaber {
        /// Address.
        address: u8,
        /// Microsteps of trajectory 1, 2, ...: `id * steps_per_trajectory`.
        steps_per_trajectory: i64,
        /// Microstep size, um.
        microstep_um: f64,
        /// Speed, mm/s.
        speed_mm_s: f64,
        /// Travel, mm; where it is stated, compared with what the unit says.
        travel_mm: Option<f64>,
    },
}

/// The interrogator.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct InterrogatorRig {
    /// Protocol of the unit.
    pub driver: InterrogatorDriver,
    /// `host:port` of the commands.
    pub address: String,
    /// `host:port` of the Hyperion's peaks.
    pub peaks_address: Option<String>,
    /// Scan rate, Hz.
    pub rate_hz: f64,
    /// Gratings: `fbg_ref`, `fbg_1`, `fbg_2`, of each whisker.
    pub grating: Vec<GratingRig>,
}

/// Drivers of an interrogator.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum InterrogatorDriver {
    /// Micron Optics sm130.
    Sm130,
    /// Luna Hyperion.
    Hyperion,
    /// A recording, whose path is the address.
    Replay,
}

impl InterrogatorRig {
    /// Names of the whiskers, in order; one without a name where the gratings name none.
    pub fn whiskers(&self) -> Vec<&str> {
        let mut names: Vec<&str> = Vec::new();
        for grating in &self.grating {
            if !names.contains(&grating.whisker.as_str()) {
                names.push(&grating.whisker);
            }
        }
        names
    }

    /// A grating of a whisker by name.
    pub fn grating_of(&self, whisker: &str, name: &str) -> Option<&GratingRig> {
        self.grating
            .iter()
            .find(|g| g.whisker == whisker && g.name == name)
    }
}

/// A grating.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GratingRig {
    /// `fbg_ref`, `fbg_1` or `fbg_2`.
    pub name: String,
    /// Optical channel, from 1.
    pub channel: usize,
    /// Wavelength at rest, nm.
    pub nominal_nm: f64,
    /// Farthest a peak may be from the nominal wavelength, nm.
    pub window_nm: f64,
    /// Whisker that it belongs to, where the fibres carry several; sessions are recorded of the
    /// first.
    #[serde(default)]
    pub whisker: String,
}

/// Drivers of a camera.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum CameraDriver {
    /// A V4L2 device.
    V4l2,
    /// A camera behind TCP.
    Net,
    /// A folder of numbered pictures.
    Folder,
}

impl CameraDriver {
    /// Whether each camera counts its pictures from its own start, so that numbers say nothing of a
    /// pair.
    pub fn counts_alone(self) -> bool {
        self == Self::V4l2
    }
}

/// A camera.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CameraRig {
    /// Name, e.g. `left`; its pictures are recorded under it.
    pub name: String,
    /// Where pictures come from.
    pub driver: CameraDriver,
    /// `/dev/videoN`, `host:port`, or a folder of numbered pictures.
    pub source: String,
    /// Pictures per second.
    pub rate_hz: Option<f64>,
    /// Width and height, px; a V4L2 camera is set to it.
    pub image_size_px: Option<[u32; 2]>,
    /// Further settings of a V4L2 camera by the driver's names (gain, trigger mode).
    #[serde(default)]
    pub controls: BTreeMap<String, i64>,
    /// Exposure, ms.
    pub exposure_ms: Option<f64>,
    /// Gain, dB.
    pub gain_db: Option<f64>,
    /// Its calibration, `stereo.json`; for people.
    pub calibration_file: Option<String>,
}

/// Names of the families that can be detected. Kalibr prints those with a black border with one of
/// two cells.
pub const TAG_FAMILIES: [&str; 9] = [
    "tag36h11",
    "tag25h9",
    "tag16h5",
    "tagStandard41h12",
    "tagStandard52h13",
    "tagCircle21h7",
    "tag36h11-border2",
    "tag25h9-border2",
    "tag16h5-border2",
];

/// An AprilTag on the bench.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TagRig {
    /// Number.
    pub id: u32,
    /// Family, one of [`TAG_FAMILIES`].
    #[serde(deserialize_with = "known_family")]
    pub family: String,
    /// Side of the black square, mm.
    pub size_mm: f64,
    /// What it is fixed to.
    pub body: TagBody,
    /// Pose in the base frame, for tags on the base.
    pub base_from_tag: Option<RigidPose>,
}

/// What a tag is fixed to.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum TagBody {
    /// The whisker's base.
    Base,
    /// The rig, which carries the groove.
    Rig,
}

fn known_family<'de, D: Deserializer<'de>>(of: D) -> Result<String, D::Error> {
    let family = String::deserialize(of)?;
    let expected = || {
        format!(
            "expected one of the families {}, found {family}",
            TAG_FAMILIES.join(", ")
        )
    };
    if TAG_FAMILIES.contains(&family.as_str()) {
        Ok(family)
    } else {
        Err(D::Error::custom(expected()))
    }
}

/// The V-groove, and the tag that carries it.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GrooveRig {
    /// Number of the tag.
    pub tag: Option<u32>,
    /// Centre of the wire in the vertex, in that tag's frame, mm.
    pub position_in_tag_mm: Option<[f64; 3]>,
    /// Half angle of the V, degrees.
    pub half_angle_deg: Option<f64>,
    /// Extent along the wire, mm.
    pub width_along_wire_mm: Option<f64>,
}
