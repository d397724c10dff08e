//! A session of kind "sweep": readings along a motion of the base, past an object where it is
//! known.

use crate::error::{InputError, SessionError};
use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion};
use std::path::{Path, PathBuf};
use toml::{Table, Value};

/// Kind in the description.
pub const KIND: &str = "sweep";
/// A mesh that is placed by hand lies within this of where it is said to lie, mm, where the session
/// states nothing.
pub const PLACED_SD_MM: f64 = 0.5;
/// What a session may state of its object in `[object]`, as standard deviations: key, unit, what is
/// taken where nothing is stated, and the range. Clocks of two programs lie within two seconds of
/// each other; what is set down by eye is a degree or two off; a part is within a per cent of its
/// mesh.
const UNKNOWNS: [(&str, &str, f64, [f64; 2]); 4] = [
    ("clock_sd_s", "s", 1.0, [0.0, 60.0]),
    ("sd_mm", "mm", PLACED_SD_MM, [0.0, 100.0]),
    ("turn_sd_deg", "deg", 1.0, [0.0, 90.0]),
    ("size_sd", "(a share of the size)", 0.01, [0.0, 0.5]),
];

/// Files of a sweep.
#[derive(Debug, Clone, PartialEq)]
pub struct SweepSession {
    /// Identifier.
    pub id: String,
    /// Readings with the poses of the base.
    pub points: PathBuf,
    /// Mesh of the object, where it is known.
    pub object: Option<PathBuf>,
    /// Where the mesh lies in the frame of those poses, where it is known.
    pub world_from_object: Option<Isometry3<f64>>,
    /// Standard deviations of the clock between readings and motion (s), and of the object's place
    /// in each coordinate (mm), turn (degrees) and size (relative).
    pub unknown_sd: [f64; 4],
    /// Friction coefficient of the object as it is stated, e.g. `0.1 +- 0.05`.
    pub friction: Option<String>,
}

impl SweepSession {
    /// Of a folder; none where it holds something else.
    ///
    /// # Errors
    /// A description of a sweep that cannot be used, by key.
    pub fn of(folder: &Path) -> Result<Option<Self>, SessionError> {
        let place = folder.join("session.toml");
        // What cannot be read here is no sweep: the reader of sessions says what is wrong with it.
        let Ok(text) = wcal_core::files::read_text(&place) else {
            return Ok(None);
        };
        let Ok(session) = text.parse::<Table>() else {
            return Ok(None);
        };
        if session.get("kind").and_then(Value::as_str) != Some(KIND) {
            return Ok(None);
        }
        let shown = place.display().to_string();
        let error = |key: &str, expected: &str, found: String| {
            InputError::new(&shown, expected, found).field(key)
        };
        let file = |key: &str| Some(folder.join(session.get("files")?.get(key)?.as_str()?));
        let of_object = |key: &str| session.get("object").and_then(|o| o.get(key));
        let world_from_object = match of_object("world_from_object") {
            None => None,
            Some(value) => {
                let numbers: Vec<f64> = value
                    .as_array()
                    .into_iter()
                    .flatten()
                    .filter_map(number)
                    .collect();
                let pose = pose_of(&numbers).ok_or_else(|| {
                    let expected = "x, y, z (mm) and a unit quaternion qw, qx, qy, qz";
                    error("object.world_from_object", expected, value.to_string())
                })?;
                Some(pose)
            }
        };
        let mut unknown_sd = [0.0; 4];
        for (sd, (key, unit, usual, [low, high])) in unknown_sd.iter_mut().zip(UNKNOWNS) {
            *sd = match of_object(key) {
                None => usual,
                Some(value) => number(value)
                    .filter(|sd| (low..=high).contains(sd))
                    .ok_or_else(|| {
                        let expected = format!("{low} to {high} {unit}");
                        error(&format!("object.{key}"), &expected, value.to_string())
                    })?,
            };
        }
        let friction = match of_object("friction") {
            None => None,
            // A text, since it may state a spread: 0.1 +- 0.05.
            Some(Value::String(stated)) => Some(stated.clone()),
            Some(other) => {
                let expected = "a text such as \"0.1 +- 0.05\"";
                return Err(error("object.friction", expected, other.to_string()).into());
            }
        };
        let missing = || error("files.points", "a table of readings", "none".to_owned());
        let id = session
            .get("id")
            .and_then(Value::as_str)
            .unwrap_or_default()
            .to_owned();
        let points = file("points").ok_or_else(missing)?;
        Ok(Some(Self {
            id,
            points,
            object: file("object"),
            world_from_object,
            unknown_sd,
            friction,
        }))
    }
}

fn number(value: &Value) -> Option<f64> {
    value
        .as_float()
        .or_else(|| value.as_integer().map(|v| v as f64))
}

/// A place and a unit quaternion as a pose; none where they are none.
pub fn pose_of(numbers: &[f64]) -> Option<Isometry3<f64>> {
    let [x, y, z, w, i, j, k] = *numbers else {
        return None;
    };
    let turn = Quaternion::new(w, i, j, k);
    let sound = (turn.norm() - 1.0).abs() < 1e-3 && numbers.iter().all(|v| v.is_finite());
    sound.then(|| {
        Isometry3::from_parts(
            Translation3::new(x, y, z),
            UnitQuaternion::new_normalize(turn),
        )
    })
}
