//! Built-in objects: primitives and look-alikes of everyday things, closed and oriented
//! ([`crate::solids`]).

use crate::solids::{half_circle, polygon, prism, revolved, ring, rock, smooth};
use std::path::Path;
use wcal_mesh::{Mesh, MeshError};

pub use crate::test_objects::TEST_NAMES;

/// Names of the built-in objects, without those set aside for tests.
pub const NAMES: [&str; 12] = [
    "ball",
    "block",
    "bottle",
    "bowl-foot",
    "can",
    "cone",
    "hexagon-bar",
    "ring",
    "rock",
    "star-bar",
    "vase",
    "wedge",
];

/// An object by its name: built in, or from `NAME.stl` in the folder of meshes.
///
/// # Errors
/// Where there is neither, or the mesh cannot be used.
pub fn named(name: &str, meshes: Option<&Path>) -> Result<Mesh, MeshError> {
    match (built_in(name), meshes) {
        (Err(_), Some(folder)) => Mesh::read(&folder.join(format!("{name}.stl"))),
        (found, _) => found,
    }
}

/// A built-in object by its name.
///
/// # Errors
/// Where there is none of that name.
pub fn built_in(name: &str) -> Result<Mesh, MeshError> {
    let (points, triangles) = match name {
        "ball" => revolved(&half_circle(30.0, 48)),
        "block" => prism(
            &[[-25.0, -35.0], [25.0, -35.0], [25.0, 35.0], [-25.0, 35.0]],
            45.0,
        ),
        "bottle" => revolved(&smooth(&[
            [30.0, -80.0],
            [32.0, -70.0],
            [32.0, 10.0],
            [28.0, 30.0],
            [13.0, 55.0],
            [12.0, 75.0],
            [14.0, 80.0],
        ])),
        "bowl-foot" => revolved(&smooth(&[
            [28.0, -25.0],
            [30.0, -15.0],
            [38.0, 0.0],
            [60.0, 20.0],
            [70.0, 30.0],
        ])),
        "can" => revolved(&[[0.0, -50.0], [33.0, -50.0], [33.0, 50.0], [0.0, 50.0]]),
        "cone" => revolved(&[[0.0, -40.0], [35.0, -40.0], [0.0, 50.0]]),
        "hexagon-bar" => prism(&polygon(6, |_| 30.0), 80.0),
        "ring" => ring(35.0, 12.0),
        "rock" => rock(),
        "star-bar" => prism(&polygon(10, |k| if k % 2 == 0 { 36.0 } else { 20.0 }), 70.0),
        "vase" => revolved(&smooth(&[
            [25.0, -70.0],
            [38.0, -40.0],
            [42.0, -15.0],
            [30.0, 20.0],
            [18.0, 45.0],
            [22.0, 62.0],
            [28.0, 70.0],
        ])),
        "wedge" => prism(&[[-30.0, -20.0], [40.0, -20.0], [-30.0, 30.0]], 60.0),
        _ => crate::test_objects::parts(name).ok_or_else(|| MeshError::Value {
            what: "built-in object".to_owned(),
            expected: format!(
                "one of {}, or of the test objects {}",
                NAMES.join(", "),
                TEST_NAMES.join(", ")
            ),
            found: name.to_owned(),
        })?,
    };
    Mesh::new(name, &points, &triangles)
}
