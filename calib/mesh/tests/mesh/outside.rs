//! The faces of a mesh that something outside can touch.

use nalgebra::Vector3;
use std::path::Path;
use wcal_lab_sweeps::objects::built_in;
use wcal_mesh::Mesh;

/// The bottle of the measured sweep is a shell: points a little within its inner wall are near
/// that, and far from the outer one.
#[test]
fn a_shell_has_its_outer_wall_alone() {
    let bottle =
        Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fixtures/whiskerfbg_bottle/object.stl");
    let both = Mesh::read(&bottle).unwrap();
    let outer = both.clone().outside().unwrap();
    assert!(
        outer
            .notes
            .iter()
            .any(|n| n.contains("that nothing outside can touch")),
        "{:?}",
        outer.notes
    );
    let (low, high) = (both.low_mm, both.high_mm);
    assert!((outer.low_mm - low).norm() < 1e-9 && (outer.high_mm - high).norm() < 1e-9);
    // At the height of the sweep the inner wall is 1.3 mm behind the outer one.
    let inner = Vector3::new(40.0, 8.1, 22.5);
    let distance = |mesh: &Mesh| mesh.closest_point(&inner, 1e3).unwrap().distance_mm;
    let [first, last] = [&both, &outer].map(distance);
    println!(
        "{} of {} faces; {first:.3} and {last:.3} mm",
        outer.triangles().len(),
        both.triangles().len()
    );
    assert!(
        first.abs() < 0.1 && (-1.6..-1.2).contains(&last),
        "{first} {last}"
    );
}

/// Control: a body without a cavity keeps every face, a concave one, too.
#[test]
fn a_solid_body_stays_as_it_is() {
    for name in ["block", "vase", "l-profile", "wedge"] {
        let mesh = built_in(name).unwrap();
        let outside = mesh.clone().outside().unwrap();
        assert_eq!(outside.triangles().len(), mesh.triangles().len(), "{name}");
        assert_eq!(outside.notes, mesh.notes, "{name}");
    }
}
