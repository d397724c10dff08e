//! Rig files.

use wcal_vision::rig::Rig;

const GOOD: &str = r#"
[whisker]
diameter_mm = 0.3
length_mm = 60.0
straight_mm = 30.0
arc_radius_mm = 20.0
[[tags]]
id = 0
family = "tag36h11"
size_mm = 10.0
body = "base"
base_from_tag = [[-1, 0, 0, -6], [0, 0, 1, -9], [0, 1, 0, -12], [0, 0, 0, 1]]
[groove]
tag = 0
position_in_tag_mm = [1.0, 2.0, 3.0]
"#;

#[test]
fn a_good_file_is_read() {
    let rig = Rig::parse("rig.toml", GOOD).unwrap();
    assert!((rig.whisker.arc_curvature_per_mm - 0.05).abs() < 1e-12);
    assert_eq!(rig.groove.unwrap().half_angle_deg, 45.0);
}

#[test]
fn faults_are_named() {
    for (from, to, word) in [
        ("diameter_mm = 0.3", "diameter_mm = -1.0", "whisker.diameter_mm"),
        ("length_mm = 60.0", "", "length_mm"),
        ("[-1, 0, 0, -6]", "[-2, 0, 0, -6]", "rigid"),
        ("tag = 0", "tag = 9", "groove.tag"),
        ("tag = 0", "half_angle_deg = 120.0\ntag = 0", "half_angle_deg"),
        ("tag = 0", "width_along_wire_mm = -1.0\ntag = 0", "width_along_wire_mm"),
        ("base_from_tag", "other", "base_from_tag"),
    ] {
        let error = Rig::parse("rig.toml", &GOOD.replace(from, to)).unwrap_err().to_string();
        assert!(error.contains(word), "{error}");
    }
}
