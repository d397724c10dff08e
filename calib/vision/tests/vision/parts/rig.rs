//! Rig files.

use crate::common::bench::RIG;
use wcal_vision::rig::Rig;

/// The drawn bench's rig with a groove.
fn good() -> String {
    format!("{RIG}[groove]\ntag = 0\nposition_in_tag_mm = [1.0, 2.0, 3.0]\n")
}

#[test]
fn a_good_file_is_read() {
    let rig = Rig::parse("rig.toml", &good()).unwrap();
    assert!((rig.whisker.arc_curvature_per_mm - 0.05).abs() < 1e-12);
    assert_eq!(rig.groove.unwrap().half_angle_deg, 45.0);
}

#[test]
fn faults_are_named() {
    for (from, to, word) in [
        (
            "diameter_mm = 0.3",
            "diameter_mm = -1.0",
            "whisker.diameter_mm",
        ),
        ("length_mm = 60.0", "", "length_mm"),
        ("[1, 0, 0, -6]", "[2, 0, 0, -6]", "rigid"),
        ("tag = 0", "tag = 9", "groove.tag"),
        (
            "tag = 0",
            "half_angle_deg = 120.0\ntag = 0",
            "half_angle_deg",
        ),
        (
            "tag = 0",
            "width_along_wire_mm = -1.0\ntag = 0",
            "width_along_wire_mm",
        ),
        ("base_from_tag", "other", "base_from_tag"),
    ] {
        let error = Rig::parse("rig.toml", &good().replace(from, to))
            .unwrap_err()
            .to_string();
        assert!(error.contains(word), "{error}");
    }
}
