//! `rig.toml`: what stands on the bench. Parts that belong to the session are copied into it as
//! they are.

use crate::error::AcquisitionError;
use nalgebra::Vector3;
use serde::Deserialize;
use wcal_core::document::from_toml;
use wcal_core::observation::WHISKER_RANGES;
pub use wcal_core::rig_devices::RIG_FORMAT;
use wcal_core::rig_devices::{
    CameraRig, GratingRig, GrooveRig, InterrogatorRig, MountRig, RIG_RANGES, StageRig, TagRig,
};
use wcal_core::rigid::RigidPose;
use wcal_session::SessionError;

/// A rig.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Rig {
    /// `wcal-rig/1`.
    pub format: String,
    /// Name.
    pub name: String,
    /// Host seconds per wall second; other than 1 only with an accelerated virtual bench.
    #[serde(default = "unity")]
    pub clock_scale: f64,
    /// Linear stage.
    pub stage: StageRig,
    /// How the whisker is turned to a trajectory.
    #[serde(default)]
    pub mount: MountRig,
    /// Interrogator and gratings.
    pub interrogator: InterrogatorRig,
    /// Cameras, in pairs.
    #[serde(default)]
    pub camera: Vec<CameraRig>,
    /// Largest skew within a pair, ms.
    #[serde(default = "default_skew_ms")]
    pub camera_skew_limit_ms: f64,
    /// Paths of the groove.
    pub trajectory: Vec<TrajectoryRig>,
    /// `[whisker]` of the session.
    pub whisker: toml::Table,
    /// `[moments]` of the session.
    #[serde(default)]
    pub moments: Option<toml::Table>,
    /// Temperature coefficients for `[fbg]` of the session.
    #[serde(default)]
    pub fbg: toml::Table,
    /// Where the base is in the world; only `wcal track` reads it.
    #[serde(default)]
    pub base: Option<BaseRig>,
    /// AprilTags on base and rig; only pictures need them.
    #[serde(default)]
    pub tags: Vec<TagRig>,
    /// The V-groove; only pictures need it.
    #[serde(default)]
    pub groove: Option<GrooveRig>,
}

/// Where the whisker's base is in the world, and what carries it.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BaseRig {
    /// Takes base coordinates to the world's, at `stage_mm = 0` where the stage carries the base.
    pub world_from_base: RigidPose,
    /// Direction in which the stage carries the base, base frame; absent: the base stands still.
    pub carried_along: Option<[f64; 3]>,
}

fn unity() -> f64 {
    1.0
}

fn default_skew_ms() -> f64 {
    2.0
}

/// A path of the groove, base frame.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TrajectoryRig {
    /// Identifier.
    pub id: u32,
    /// Groove centre at stage zero, mm.
    pub origin_mm: [f64; 3],
    /// Direction of travel.
    pub direction: [f64; 3],
    /// Arc length of first contact, mm.
    pub nominal_arclength_mm: Option<f64>,
}

impl TrajectoryRig {
    /// Groove centre (mm, base frame) at a depth of `stage_mm`.
    pub fn groove_mm(&self, stage_mm: f64) -> Vector3<f64> {
        Vector3::from(self.origin_mm) + Vector3::from(self.direction).normalize() * stage_mm
    }
}

impl Rig {
    /// Parses and checks a rig.
    ///
    /// # Errors
    /// Field, what was expected and what was found; `place` names the file.
    pub fn parse(place: &str, text: &str) -> Result<Self, AcquisitionError> {
        let rig: Self = from_toml(text, RIG_FORMAT, &[RIG_RANGES, WHISKER_RANGES])
            .map_err(|e| AcquisitionError::document(place, "a rig file", e))?;
        let fail = |field: &str, expected: &str, found: String| {
            Err(AcquisitionError::input(
                format!("{place}: {field}"),
                expected,
                found,
            ))
        };
        // What the session takes over has to be what a session can be read with, before the sweep
        // and not after it.
        wcal_session::check_wire(place, &rig.whisker, rig.moments.as_ref(), &rig.fbg).map_err(
            |e| match e {
                SessionError::Content(e) => {
                    let field = e.field.as_deref().unwrap_or("whisker");
                    AcquisitionError::input(format!("{place}: {field}"), &e.expected, &e.found)
                }
                other => {
                    AcquisitionError::input(place, "the tables of a whisker", other.to_string())
                }
            },
        )?;
        let s = &rig.stage;
        let [low, high] = s.soft_limits_mm;
        if !(low >= 0.0 && low < high && high <= s.travel_mm + 1e-6) {
            return fail(
                "stage.soft_limits_mm",
                "two positions within the travel",
                format!("{low}, {high}"),
            );
        }
        if let Some((field, expected, found)) = addresses_that_clash(s, &rig.mount) {
            return fail(field, &expected, found);
        }
        // Two transverse moments need two sensing gratings.
        for whisker in rig.interrogator.whiskers() {
            for name in ["fbg_1", "fbg_2"] {
                if rig.interrogator.grating_of(whisker, name).is_none() {
                    let of = if whisker.is_empty() {
                        String::new()
                    } else {
                        format!(" of whisker {whisker}")
                    };
                    return fail(
                        "interrogator.grating",
                        "gratings fbg_1 and fbg_2",
                        format!("no {name}{of}"),
                    );
                }
            }
        }
        let gratings = &rig.interrogator.grating;
        for (k, a) in gratings.iter().enumerate() {
            if !GRATINGS.contains(&a.name.as_str()) {
                return fail(
                    "interrogator.grating.name",
                    &GRATINGS.join(" or "),
                    a.name.clone(),
                );
            }
            let again = |b: &GratingRig| a.whisker == b.whisker && a.name == b.name;
            if gratings[..k].iter().any(again) {
                return fail(
                    "interrogator.grating",
                    "each grating of a whisker once",
                    a.name.clone(),
                );
            }
            // Within a whisker a stray peak is seen scan by scan; between whiskers it would be
            // taken for the other's.
            let overlaps =
                |b: &&GratingRig| (a.nominal_nm - b.nominal_nm).abs() <= a.window_nm + b.window_nm;
            let other = |b: &&GratingRig| a.whisker != b.whisker && a.channel == b.channel;
            if let Some(b) = gratings[..k].iter().filter(other).find(overlaps) {
                let found = format!(
                    "{} of {} and {} of {}",
                    b.name, b.whisker, a.name, a.whisker
                );
                return fail(
                    "interrogator.grating",
                    "windows of two whiskers that do not overlap",
                    found,
                );
            }
        }
        // One camera gives no depth: pictures are taken in pairs.
        if !matches!(rig.camera.len(), 0 | 2) {
            return fail("camera", "no camera or two", rig.camera.len().to_string());
        }
        // Names become folders of the session.
        let plain = |c: char| c.is_ascii_alphanumeric() || "-_".contains(c);
        let odd = |name: &str| name.is_empty() || name == "holdout" || !name.chars().all(plain);
        if let Some(camera) = rig.camera.iter().find(|c| odd(&c.name)) {
            return fail(
                "camera.name",
                "letters, digits, - and _, and not \"holdout\"",
                camera.name.clone(),
            );
        }
        let directions = rig
            .trajectory
            .iter()
            .map(|t| ("trajectory.direction", t.direction));
        let carried = rig.base.as_ref().and_then(|b| b.carried_along);
        let directions = directions.chain(carried.map(|along| ("base.carried_along", along)));
        // Directions are normalised where they are used: one without a length would give no place.
        for (field, direction) in directions {
            if !(Vector3::from(direction).norm() > 1e-6) {
                return fail(field, "a direction", format!("{direction:?}"));
            }
        }
        for (k, t) in rig.trajectory.iter().enumerate() {
            if rig.trajectory[..k].iter().any(|other| other.id == t.id) {
                return fail("trajectory.id", "different identifiers", t.id.to_string());
            }
        }
        Ok(rig)
    }

    /// A grating of the first whisker by name.
    pub fn grating(&self, name: &str) -> Option<&GratingRig> {
        self.interrogator
            .grating_of(self.interrogator.whiskers().first()?, name)
    }

    /// A trajectory by identifier.
    pub fn trajectory(&self, id: u32) -> Option<&TrajectoryRig> {
        self.trajectory.iter().find(|t| t.id == id)
    }
}

/// Names of a whisker's gratings: the reference, which carries no strain, and the two that do.
const GRATINGS: [&str; 3] = ["fbg_ref", "fbg_1", "fbg_2"];

/// What is wrong with the addresses of stage and mount: field, expected, found.
fn addresses_that_clash(
    stage: &StageRig,
    mount: &MountRig,
) -> Option<(&'static str, String, String)> {
    let Some(last) = stage.driver.last_shared_address() else {
        let expected = "kind = \"manual\": the stage's driver has no mount on its line";
        let alone = *mount == MountRig::Manual;
        return (!alone).then(|| ("mount.kind", expected.to_owned(), "zaber".to_owned()));
    };
    let of_unit = format!("a whole number between 1 and {last}");
    if stage.address > last {
        return Some(("stage.address", of_unit, stage.address.to_string()));
    }
    let MountRig::Zaber { address, .. } = *mount else {
        return None;
    };
    if address > last {
        return Some(("mount.address", of_unit, address.to_string()));
    }
    // The mount is axis 1 of its unit: its turns would drive the stage.
    (address == stage.address && stage.axis == 1).then(|| {
        let found =
            format!("[stage] address = {address}, axis = 1 and [mount] address = {address}");
        let expected = "another unit or axis than the stage's".to_owned();
        ("mount.address", expected, found)
    })
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::limits::Limits;

    pub(crate) const RIG: &str = r#"
format = "wcal-rig/1"
name = "virtual"
[stage]
driver = "zaber-ascii"
port = "tcp://127.0.0.1:1"
microstep_um = 0.047625
travel_mm = 101.6
soft_limits_mm = [0, 40]
zero_mm = 20
speed_mm_s = 7
retract_mm = -2
[interrogator]
driver = "sm130"
address = "127.0.0.1:2"
rate_hz = 2000
grating = [
  { name = "fbg_ref", channel = 1, nominal_nm = 1537.3, window_nm = 0.7 },
  { name = "fbg_1", channel = 1, nominal_nm = 1541.2, window_nm = 1.5 },
  { name = "fbg_2", channel = 1, nominal_nm = 1535.8, window_nm = 0.7 },
]
[[trajectory]]
id = 1
origin_mm = [18, 0, 0]
direction = [0, 0, 1]
[whisker]
diameter_mm = 0.3
length_mm = 60.0
straight_mm = 30.0
arc_radius_mm = 20.0
youngs_gpa = 75.0
shear_gpa = 28.2
"#;

    #[test]
    fn a_rig_is_read_and_its_limits_hold() {
        let rig = Rig::parse("rig.toml", RIG).unwrap();
        let check = |depth_mm, travel_mm| Limits::new(&rig.stage, travel_mm).check("x", depth_mm);
        assert!(check(20.0, [0.0, 101.6]).is_ok());
        assert!(check(20.1, [0.0, 101.6]).is_err());
        assert!(check(15.0, [0.0, 30.0]).is_err());
        assert_eq!(
            rig.trajectory(1).unwrap().groove_mm(2.0),
            Vector3::new(18.0, 0.0, 2.0)
        );
    }

    #[test]
    fn whiskers_share_a_fibre_where_their_windows_do_not_overlap() {
        let more = |first_nm: f64| {
            let grating = |name: &str, nm: f64| {
                format!(
                    "  {{ name = \"{name}\", channel = 1, nominal_nm = {nm}, window_nm = 0.7, whisker = \"b\" }},\n"
                )
            };
            RIG.replace(
                "]\n[[trajectory]]",
                &format!(
                    "{}{}]\n[[trajectory]]",
                    grating("fbg_1", first_nm),
                    grating("fbg_2", 1555.0)
                ),
            )
        };
        let rig = Rig::parse("rig.toml", &more(1550.0)).unwrap();
        assert_eq!(rig.interrogator.whiskers(), ["", "b"]);
        assert_eq!(
            rig.interrogator
                .grating_of("b", "fbg_1")
                .unwrap()
                .nominal_nm,
            1550.0
        );
        assert_eq!(rig.grating("fbg_1").unwrap().nominal_nm, 1541.2);
        let error = Rig::parse("rig.toml", &more(1542.0))
            .unwrap_err()
            .to_string();
        assert!(
            error.contains("do not overlap") && error.contains("fbg_1 of b"),
            "{error}"
        );
    }

    const MOUNT: &str = "[mount]\nkind = \"zaber\"\naddress = 2\nsteps_per_trajectory = 10000\nmicrostep_um = 0.1\nspeed_mm_s = 20\n[interrogator]";

    /// What is meant for one unit or axis must reach no other.
    #[test]
    fn broadcasts_and_two_entries_of_one_axis_are_refused() {
        let with_mount = RIG.replace("[interrogator]", MOUNT);
        let parse = |from: &str, to: &str| Rig::parse("rig.toml", &with_mount.replace(from, to));
        for (from, to) in [
            ("", ""),
            ("address = 2", "address = 3"),
            ("[stage]", "[stage]\naxis = 2\naddress = 2"),
        ] {
            assert!(parse(from, to).is_ok(), "control: {to}");
        }
        for (from, to, words) in [
            (
                "[stage]",
                "[stage]\naddress = 0",
                "stage.address: expected a whole number between 1 and 254, found 0",
            ),
            (
                "[stage]",
                "[stage]\naxis = 0",
                "stage.axis: expected a whole number between 1 and 9, found 0",
            ),
            (
                "address = 2",
                "address = 0",
                "mount.address: expected a whole number between 1 and 254, found 0",
            ),
            (
                "[stage]",
                "[stage]\naddress = 100",
                "stage.address: expected a whole number between 1 and 99",
            ),
            (
                "address = 2",
                "address = 100",
                "mount.address: expected a whole number between 1 and 99",
            ),
            (
                "address = 2",
                "address = 1",
                "found [stage] address = 1, axis = 1 and [mount] address = 1",
            ),
            (
                "[stage]",
                "[stage]\naddress = 2",
                "[stage] address = 2, axis = 1 and [mount] address = 2",
            ),
            (
                "zaber-ascii",
                "zaber-binary",
                "mount.kind: expected kind = \"manual\"",
            ),
        ] {
            let error = parse(from, to).unwrap_err().to_string();
            assert!(error.contains(words), "{words}: {error}");
        }
    }

    #[test]
    fn rigs_that_make_no_sense_are_refused_by_field() {
        let more = "[[tags]]\nid = 0\nfamily = \"tag36h11\"\nsize_mm = 10\nbody = \"base\"\nbase_from_tag = [[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]\n\
                    [groove]\nhalf_angle_deg = 45\ntag = 0\n[base]\nworld_from_base = [[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]\ncarried_along = [0,0,1]\n\
                    [[camera]]\nname = \"l\"\ndriver = \"net\"\nsource = \"x:1\"\n[[camera]]\nname = \"r\"\ndriver = \"net\"\nsource = \"x:2\"\n";
        let whole = format!("{RIG}{more}");
        Rig::parse("rig.toml", &whole).unwrap();
        for (from, to, field) in [
            (
                "\"fbg_ref\"",
                "\"fbg_reff\"",
                "grating.name: expected fbg_ref or fbg_1 or fbg_2, found fbg_reff",
            ),
            ("\"fbg_ref\"", "\"fbg_1\"", "each grating of a whisker once"),
            ("zaber-ascii", "foo", "`zaber-ascii`"),
            ("\"sm130\"", "\"foo\"", "`hyperion`"),
            ("\"net\"", "\"foo\"", "`v4l2`"),
            (
                "source = \"x:1\"",
                "source = \"x:1\"\nexposure_mss = 2.0",
                "exposure_mss",
            ),
            (
                "half_angle_deg = 45",
                "half_angle_deg = \"x\"",
                "half_angle_deg",
            ),
            ("half_angle_deg = 45", "half_angle = 45", "half_angle"),
            ("[groove]", "[grove]", "grove"),
            ("id = 0", "id = \"a\"", "id"),
            ("tag36h11", "-1", "expected one of the families"),
            ("\"base\"", "\"bsae\"", "`base`"),
            ("base_from_tag = [[1", "base_from_tag = [[2", "rigid"),
            ("world_from_base = [[1", "world_from_base = [[2", "rigid"),
            (
                "carried_along = [0,0,1]",
                "carried_along = [0,0,0]",
                "base.carried_along",
            ),
            ("wcal-rig/1", "wcal-rig/2", "format"),
            ("[0, 40]", "[40, 0]", "soft_limits_mm"),
            ("[0, 40]", "[0, 400]", "soft_limits_mm"),
            ("\"fbg_2\"", "\"fbg_9\"", "grating"),
            (
                "channel = 1, nominal_nm = 1537.3",
                "channel = 0, nominal_nm = 1537.3",
                "grating",
            ),
            (
                "direction = [0, 0, 1]",
                "direction = [0, 0, 0]",
                "direction",
            ),
            ("length_mm = 60.0", "length_mm = \"x\"", "whisker.length_mm"),
            ("length_mm = 60.0", "", "whisker.length_mm"),
            (
                "[whisker]",
                "[moments]\nsign = 3\n[whisker]",
                "moments.sign",
            ),
            (
                "[whisker]",
                "[fbg]\ntemperature_pm_per_degc = \"x\"\n[whisker]",
                "fbg.temperature",
            ),
            ("retract_mm = -2", "retrct_mm = -2", "rig file"),
            (
                "window_nm = 1.5 }",
                "window_nm = 1.5, whisker = \"b\" }",
                "no fbg_1",
            ),
            (
                "[whisker]",
                "[[camera]]\nname = \"left\"\ndriver = \"net\"\nsource = \"x:1\"\n[whisker]",
                "camera",
            ),
        ] {
            let error = Rig::parse("rig.toml", &whole.replace(from, to))
                .unwrap_err()
                .to_string();
            assert!(error.contains(field), "{field}: {error}");
        }
    }
}
