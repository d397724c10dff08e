//! The plant's cameras against what they draw: geometry, areas, noise, faults.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::print_stdout,
    reason = "a test that fails should say where, and one that measures says what it found"
)]

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use wcal_bench::cameras::{
    Appearance, CameraFaults, Groove, Lens, RigGeometry, View, clean, default_pair, exposed,
    tag_cells,
};
use wcal_bench::rod::Wire;
use wcal_bench::table::{Path, equilibrium};

type V3 = Vector3<f64>;

const SIZE: [usize; 2] = [640, 480];

fn wire() -> Wire {
    Wire::new(0.3, 60.0, 30.0, 20.0, 75.0, 28.2)
}

fn path(arclength_mm: f64, direction: V3) -> Path {
    let (origin_mm, _) = wire().rest(arclength_mm);
    Path {
        origin_mm,
        direction,
        arclength_mm,
        offset_mm: V3::zeros(),
    }
}

/// The bench at a depth of a path.
fn bench(rig: &RigGeometry, path: &Path, depth_mm: f64) -> (View, V3) {
    let (wire, at) = (wire(), path.at(depth_mm));
    let found = equilibrium(&wire, path, 0.4 * path.arclength_mm, depth_mm).unwrap();
    let line = wire.centre_line(Some((&at, &found)), 0.25);
    let groove = Groove {
        position_mm: at,
        axis: found.tangent,
        push: path.direction,
    };
    (rig.scene(line, Some(&groove)), at)
}

/// Writes pictures for a look, where WCAL_PICTURES names a folder.
fn keep(name: &str, picture: &[u8]) {
    if let Ok(folder) = std::env::var("WCAL_PICTURES") {
        let bytes = [
            format!("P5 {} {} 255\n", SIZE[0], SIZE[1]).as_bytes(),
            picture,
        ]
        .concat();
        std::fs::write(
            std::path::Path::new(&folder).join(format!("{name}.pgm")),
            bytes,
        )
        .unwrap();
    }
}

#[test]
fn a_loaded_centre_line_passes_the_groove_and_keeps_its_length() {
    for (s, direction, depth_mm) in [(18.0, V3::z(), 4.0), (45.0, V3::new(0.0, 0.8, 0.6), 8.0)] {
        let path = path(s, direction);
        let found = equilibrium(&wire(), &path, 0.4 * s, depth_mm).unwrap();
        let at = path.at(depth_mm);
        let line = wire().centre_line(Some((&at, &found)), 0.25);
        let length: f64 = line.windows(2).map(|w| (w[1] - w[0]).norm()).sum();
        assert!((length - 60.0).abs() < 1e-3, "{length}");
        let near = line
            .iter()
            .map(|p| (p - at).norm())
            .fold(f64::INFINITY, f64::min);
        // A point of the line lies at the contact: pieces end there.
        assert!(near < 2e-3, "{near} mm");
        // Another force, another line.
        let unloaded = wire().centre_line(None, 0.25);
        assert!((unloaded.last().unwrap() - line.last().unwrap()).norm() > 0.5 * depth_mm);
        let (tip, _) = wire().rest(60.0);
        assert!((unloaded.last().unwrap() - tip).norm() < 1e-9);
    }
}

#[test]
fn a_lens_inverts_its_distortion_and_a_straight_line_bends() {
    let [left, _] = default_pair(SIZE);
    for (u, v) in [(0.0, 0.0), (320.0, 240.0), (639.0, 13.0)] {
        let ray = left.undistorted(u, v);
        let base = left
            .camera_from_base
            .inverse_transform_point(&nalgebra::Point3::new(250.0 * ray.x, 250.0 * ray.y, 250.0));
        let (again, depth) = left.project(&base.coords).unwrap();
        assert!(
            (again.x - u).abs() < 1e-9 && (again.y - v).abs() < 1e-9,
            "{again}"
        );
        assert!((depth - 250.0).abs() < 1e-9);
    }
    let pinhole = Lens::new(
        left.size_px,
        left.focal_px,
        left.centre_px,
        [0.0; 5],
        left.camera_from_base,
    );
    let off =
        (pinhole.project(&V3::zeros()).unwrap().0 - left.project(&V3::zeros()).unwrap().0).norm();
    assert!(off > 0.1, "control: {off} px");
    assert!(
        left.project(&V3::new(0.0, -400.0, 0.0)).is_none(),
        "behind the camera"
    );
}

/// What the wire takes from an even ground is its width times its length in the picture, wherever
/// it lies between the pixels.
#[test]
fn a_wire_takes_its_area_and_lies_on_its_centre_line() {
    let look = Appearance {
        uneven: [0.0; 2],
        highlight: 0.0,
        blur_px: 0.6,
        ..Appearance::default()
    };
    for lens in default_pair(SIZE) {
        for (a, b) in [
            (V3::new(10.0, 0.0, -20.0), V3::new(50.0, 0.0, 5.0)),
            (V3::new(30.3, 0.0, -30.0), V3::new(31.0, 0.0, 5.0)),
        ] {
            let line: Vec<V3> = (0..=160)
                .map(|k| a + (b - a) * (f64::from(k) / 160.0))
                .collect();
            let view = View {
                faces: Vec::new(),
                wire: line.clone(),
                diameter_mm: 0.3,
            };
            let picture = clean(&lens, &view, &look);
            let ground = (look.exposure_dn * look.background) as f32;
            let taken: f64 = picture.iter().map(|v| f64::from(ground - v)).sum::<f64>()
                / (look.exposure_dn * (look.background - look.wire));
            let seen: Vec<_> = line.iter().map(|p| lens.project(p).unwrap()).collect();
            let focal = 0.5 * (lens.focal_px[0] + lens.focal_px[1]);
            let area: f64 = seen
                .windows(2)
                .map(|w| (w[1].0 - w[0].0).norm() * 0.3 * focal / (0.5 * (w[0].1 + w[1].1)))
                .sum();
            assert!((taken / area - 1.0).abs() < 2e-3, "{taken} of {area} px");
            // Centre of darkness in the row through the middle of the line, against the projected
            // line there.
            let middle = seen[80].0;
            let row = middle.y.round();
            let dark = |x: usize| f64::from(ground - picture[row as usize * SIZE[0] + x]);
            let near = (middle.x as usize - 12)..(middle.x as usize + 13);
            let sum: f64 = near.clone().map(dark).sum();
            let found = near.map(|x| x as f64 * dark(x)).sum::<f64>() / sum;
            let slope = (seen[81].0 - seen[79].0).x / (seen[81].0 - seen[79].0).y;
            let expected = middle.x + slope * (row - middle.y);
            if slope.abs() < 1.5 {
                // The shade falls by a fifth across: the centre of darkness lies a little off the
                // geometric one.
                assert!((found - expected).abs() < 0.06, "{found} {expected}");
            }
        }
    }
}

#[test]
fn edges_of_a_tag_lie_where_they_project_to() {
    let rig = RigGeometry::default();
    let look = Appearance {
        uneven: [0.0; 2],
        blur_px: 0.0,
        ..Appearance::default()
    };
    let groove = Groove {
        position_mm: V3::new(25.0, 0.0, 0.0),
        axis: V3::x(),
        push: V3::z(),
    };
    let mut view = rig.scene(Vec::new(), Some(&groove));
    // The base's tag alone: what is dark is its black cells' area.
    view.faces = vec![view.faces[6].clone()];
    let cells = tag_cells(0).unwrap();
    let white = cells.iter().flatten().filter(|c| **c).count() as f64;
    for lens in default_pair(SIZE) {
        let corner = |x: f64, y: f64| {
            let p = rig.base_from_tag * nalgebra::Point3::new(x, y, 0.0);
            lens.project(&p.coords).unwrap().0
        };
        let ring = [
            corner(-6.25, -6.25),
            corner(6.25, -6.25),
            corner(6.25, 6.25),
            corner(-6.25, 6.25),
        ];
        let area = 0.5
            * (0..4)
                .map(|k| ring[k].perp(&ring[(k + 1) % 4]))
                .sum::<f64>()
                .abs();
        let unit = look.exposure_dn;
        let sum: f64 = clean(&lens, &view, &look)
            .iter()
            .map(|v| f64::from(*v) / unit - look.background)
            .sum();
        let expected = area / 100.0 * (white * (0.80 - 0.72) + (100.0 - white) * (0.19 - 0.72));
        assert!((sum / expected - 1.0).abs() < 5e-3, "{sum} {expected}");
    }
    assert!(tag_cells(0) != tag_cells(1) && tag_cells(10_000).is_none());
}

#[test]
fn noise_has_its_stated_variance_and_bright_pictures_saturate() {
    let look = Appearance {
        uneven: [0.0; 2],
        ..Appearance::default()
    };
    let even = vec![100.0_f32; 640 * 480];
    let grey = exposed(&even, &look, 1);
    let mean = grey.iter().map(|v| f64::from(*v)).sum::<f64>() / grey.len() as f64;
    let variance = grey
        .iter()
        .map(|v| (f64::from(*v) - mean).powi(2))
        .sum::<f64>()
        / grey.len() as f64;
    // Rounding adds a twelfth.
    let expected = 0.8 * 0.8 + 0.006 * 100.0 + 1.0 / 12.0;
    assert!(
        (mean - 100.0).abs() < 0.01 && (variance / expected - 1.0).abs() < 0.01,
        "{mean} {variance}"
    );
    assert_eq!(grey, exposed(&even, &look, 1));
    assert_ne!(grey, exposed(&even, &look, 2));
    assert!(exposed(&[900.0; 16], &look, 3).iter().all(|v| *v == 255));
}

#[test]
fn pictures_hold_the_board_and_show_faults() {
    let rig = RigGeometry::default();
    let look = Appearance::default();
    let cameras = default_pair(SIZE);
    for (k, (s, direction, depth)) in [
        (18.0, V3::z(), 4.0),
        (45.0, V3::new(0.34, -0.866, 0.366), 9.0),
        (31.0, V3::new(0.025, 0.866, 0.5), 8.0),
    ]
    .into_iter()
    .enumerate()
    {
        let path = path(s, direction.normalize());
        let (view, _) = bench(&rig, &path, depth);
        for (side, lens) in ["left", "right"].iter().zip(&cameras) {
            keep(
                &format!("{side}-{k}"),
                &exposed(&clean(lens, &view, &look), &look, 7),
            );
        }
    }
    for k in 0..12 {
        for (side, lens) in ["left", "right"].iter().zip(&cameras) {
            let view = rig.board_view(k);
            let picture = exposed(&clean(lens, &view, &look), &look, k as u64);
            // The whole board is in the picture.
            let face = &view.faces[0];
            for c in &face.corners {
                let p = face.base_from_plane * nalgebra::Point3::new(c[0], c[1], 0.0);
                let at = lens.project(&p.coords).unwrap().0;
                assert!(
                    at.x > 0.0 && at.y > 0.0 && at.x < 639.0 && at.y < 479.0,
                    "{side} {k}: {at}"
                );
            }
            keep(&format!("{side}-board-{k}"), &picture);
        }
    }
    // Faults are seen: a moved camera and a tag glued askew change the picture, nothing does not.
    let path = path(31.0, V3::z());
    let still = clean(&cameras[1], &bench(&rig, &path, 3.0).0, &look);
    let changed = |rig: &RigGeometry, lens: &Lens| {
        let other = clean(lens, &bench(rig, &path, 3.0).0, &look);
        other
            .iter()
            .zip(&still)
            .map(|(a, b)| (a - b).abs())
            .fold(0.0_f32, f32::max)
    };
    assert_eq!(changed(&rig, &cameras[1]), 0.0);
    let moved = Isometry3::from_parts(Translation3::new(0.1, 0.0, 0.0), UnitQuaternion::identity());
    assert!(changed(&rig, &cameras[1].moved(&moved)) > 20.0);
    let askew = CameraFaults {
        rig_tag_moved: moved,
        ..CameraFaults::default()
    };
    assert!(
        changed(
            &RigGeometry {
                faults: askew,
                ..rig
            },
            &cameras[1]
        ) > 20.0
    );
}
