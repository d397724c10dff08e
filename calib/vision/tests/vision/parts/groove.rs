//! Kinds of contact.

use nalgebra::{Matrix3, Vector3};
use wcal_vision::rig::RigGroove;
use wcal_vision::shape::groove::GroovePosition;

fn contact(away: Vector3<f64>, push: Option<Vector3<f64>>, turn: Vector3<f64>) -> &'static str {
    let covariance = Matrix3::from_diagonal(&Vector3::new(1.0, 1e-4, 1e-4));
    let groove = RigGroove {
        tag: 1,
        position_in_tag_mm: Vector3::zeros(),
        half_angle_deg: 45.0,
        width_along_wire_mm: 3.0,
    };
    GroovePosition {
        away,
        covariance,
        push,
        turn,
    }
    .contact(&groove, 0.3)
}

#[test]
fn the_four_kinds_of_contact_are_told_apart() {
    let (up, none) = (Vector3::z(), Vector3::zeros());
    assert_eq!(contact(up * 0.02, Some(up), none), "vertex");
    // A bend of 0.05 / mm over 3 mm that arches away from the vertex: 0.056 mm.
    let arched = -up * 0.15;
    assert_eq!(contact(up * 0.056, Some(up), arched), "double");
    assert_eq!(
        contact(up * 0.056, Some(up), -arched),
        "none",
        "bent the other way it touches in the middle"
    );
    assert_eq!(contact(up * 0.4, Some(up), arched), "none");
    let flank = Vector3::new(0.0, 1.0, 1.0).normalize();
    assert_eq!(contact(flank * 0.4, Some(up), none), "out-of-vertex");
    assert_eq!(
        contact(-up * 0.2, Some(up), none),
        "out-of-vertex",
        "inside the block: the rig's geometry is off"
    );
    assert_eq!(contact(up * 0.2, None, none), "out-of-vertex");
    assert_eq!(contact(up * 0.5, None, none), "none");
}
