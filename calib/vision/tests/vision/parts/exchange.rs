//! Exports come back; malformed files are refused.

use nalgebra::Vector2;
use wcal_vision::calibrate::document::StereoDocument;
use wcal_vision::calibrate::export::{exports, kalibr_distance_px};
use wcal_vision::calibrate::import::{
    import_kalibr, import_opencv, import_ros, imported, read_cameras,
};
use wcal_vision::camera::{Camera, FISHEYE, Lens, OPENCV5, lenses};

fn document_with(lens: &'static dyn Lens) -> StereoDocument {
    let pose = [
        [0.96, 0.0, -0.28, -118.0],
        [0.0, 1.0, 0.0, 2.0],
        [0.28, 0.0, 0.96, 25.0],
        [0.0, 0.0, 0.0, 1.0],
    ];
    let all = if lens == OPENCV5 {
        [-0.14, 0.2, 1e-4, -2e-4, 0.03]
    } else {
        [-0.03, 4e-3, -2e-3, 5e-4, 0.0]
    };
    let camera = Camera {
        image_size_px: [1280, 960],
        focal_px: [3450.0, 3452.0],
        centre_px: [650.5, 470.25],
        lens,
        distortion: all,
    };
    imported("here", [camera.clone(), camera], pose).unwrap()
}

fn document() -> StereoDocument {
    document_with(OPENCV5)
}

fn same(a: &StereoDocument, b: &StereoDocument) -> bool {
    let near = |x: f64, y: f64| (x - y).abs() <= 1e-9 * y.abs().max(1.0);
    a.image_size_px == b.image_size_px
        && a.right_from_left
            .iter()
            .flatten()
            .zip(b.right_from_left.iter().flatten())
            .all(|(x, y)| near(*x, *y))
        && a.cameras.iter().zip(&b.cameras).all(|(x, y)| {
            x.k.iter()
                .flatten()
                .zip(y.k.iter().flatten())
                .all(|(p, q)| near(*p, *q))
                && x.distortion.model == y.distortion.model
                && x.distortion.coefficients.len() == y.distortion.coefficients.len()
                && x.distortion
                    .coefficients
                    .iter()
                    .zip(&y.distortion.coefficients)
                    .all(|(p, q)| near(*p, *q))
        })
}

/// Kalibr's cameras are the document's, but for k3: four coefficients fitted to the five show each
/// direction within a tenth of a pixel.
fn assert_as_kalibr_has_it(found: &StereoDocument, document: &StereoDocument) {
    let [cameras, kalibr] = [document, found].map(|d| d.stereo_cameras().unwrap().cameras);
    let mut farthest = 0.0f64;
    for (camera, kalibr) in cameras.iter().zip(&kalibr) {
        for k in 0..81 {
            let px = Vector2::new(
                f64::from(k % 9) * 160.0 - 0.5,
                f64::from(k / 9) * 120.0 - 0.5,
            );
            farthest =
                farthest.max((kalibr.project(&camera.ray(&px).unwrap()).unwrap() - px).norm());
        }
        assert!(kalibr.distortion[4] == 0.0);
    }
    let stated = kalibr_distance_px(document).unwrap();
    assert!(
        farthest <= stated + 1e-9 && stated < 0.1,
        "{farthest} px, stated {stated} px"
    );
    // Negative control: the first four of five are another lens.
    let cut = |camera: &Camera| Camera {
        distortion: {
            let [a, b, c, d, _] = camera.distortion;
            [a, b, c, d, 0.0]
        },
        ..camera.clone()
    };
    let corner = cameras[0].ray(&Vector2::new(0.0, 0.0)).unwrap();
    let apart = (cut(&cameras[0]).project(&corner).unwrap() - Vector2::new(0.0, 0.0)).norm();
    assert!(
        cameras[0].lens == FISHEYE || apart > 2.0 * stated,
        "{apart}"
    );
}

#[test]
fn what_is_exported_is_imported_again() {
    for lens in lenses() {
        let document = document_with(lens);
        let files = exports(&document).unwrap();
        assert!(
            same(
                &import_opencv("opencv.yml", &files[0].1).unwrap(),
                &document
            ),
            "{}",
            lens.model()
        );
        assert_as_kalibr_has_it(
            &import_kalibr("camchain.yaml", &files[1].1).unwrap(),
            &document,
        );
        assert!(
            same(
                &import_ros("ros", [&files[2].1, &files[3].1]).unwrap(),
                &document
            ),
            "{}",
            lens.model()
        );
    }
    // Negative control: the models are not taken for each other.
    assert!(!same(&document_with(FISHEYE), &document()));
    let files = exports(&document()).unwrap();
    // The stereo sample of OpenCV writes two files and calls the cameras M.
    let (first, second) = files[0].1.split_once("R: ").unwrap();
    let text = format!(
        "{}R: {second}",
        first.replace("K1", "M1").replace("K2", "M2")
    );
    assert!(same(&import_opencv("sample", &text).unwrap(), &document()));
}

#[test]
fn the_kind_of_a_file_is_seen_in_it() {
    let place = tempfile::tempdir().unwrap();
    let files = exports(&document()).unwrap();
    let write = |name: &str, text: &str| {
        let path = place.path().join(name);
        std::fs::write(&path, text).unwrap();
        path
    };
    let json = write("stereo.json", &serde_json::to_string(&document()).unwrap());
    let [opencv, kalibr, left, right] =
        [0, 1, 2, 3].map(|k: usize| write(&files[k].0, &files[k].1));
    assert_as_kalibr_has_it(&read_cameras(&[kalibr]).unwrap(), &document());
    for paths in [
        vec![json],
        vec![opencv.clone()],
        vec![left.clone(), right.clone()],
    ] {
        assert!(
            same(&read_cameras(&paths).unwrap(), &document()),
            "{paths:?}"
        );
    }
    let text = write("notes.txt", "cameras of Tuesday");
    for paths in [
        vec![text.clone()],
        vec![left.clone()],
        vec![opencv, left.clone()],
        vec![],
    ] {
        assert!(
            read_cameras(&paths)
                .unwrap_err()
                .to_string()
                .contains("none of these"),
            "{paths:?}"
        );
    }
    // Left twice: no baseline.
    let error = read_cameras(&[left.clone(), left]).unwrap_err().to_string();
    assert!(error.contains("baseline"), "{error}");
    assert!(
        read_cameras(&[place.path().join("no.json")])
            .unwrap_err()
            .to_string()
            .contains("no.json")
    );
}

#[test]
fn malformed_files_are_refused_with_the_key() {
    let files = exports(&document()).unwrap();
    for (from, to, word) in [
        ("K2:", "X2:", "K2"),
        ("e3, ", "e3; ", "K1"),
        ("image_width", "w", "image_width"),
    ] {
        let error = import_opencv("o.yml", &files[0].1.replace(from, to))
            .unwrap_err()
            .to_string();
        assert!(error.contains(word), "{error}");
    }
    for (from, to, word) in [
        ("plumb_bob", "rational_polynomial", "plumb_bob"),
        (
            "plumb_bob",
            "equidistant",
            "distortion_coefficients with 4 numbers",
        ),
        ("projection_matrix", "p", "projection_matrix"),
        ("image_height: 960", "image_height: 480", "one size"),
    ] {
        let error = import_ros("r", [&files[2].1, &files[3].1.replace(from, to)])
            .unwrap_err()
            .to_string();
        assert!(error.contains(word), "{error}");
    }
    for (from, to, word) in [
        ("radtan", "equi", "distortion_model"),
        ("cam1:", "cam9:", "cam1"),
        ("T_cn_cnm1", "T", "T_cn_cnm1"),
    ] {
        let error = import_kalibr("k.yaml", &files[1].1.replace(from, to))
            .unwrap_err()
            .to_string();
        assert!(error.contains(word), "{error}");
    }
}

#[test]
fn an_unknown_lens_in_stereo_json_is_refused_by_name() {
    let mut value = serde_json::to_value(document()).unwrap();
    let parse = |v: &serde_json::Value| StereoDocument::parse("stereo.json", &v.to_string());
    assert!(parse(&value).is_ok());
    value["cameras"][1]["distortion"]["model"] = "double-sphere".into();
    let error = parse(&value).unwrap_err().to_string();
    for word in [
        "stereo.json",
        "camera right",
        "double-sphere",
        "opencv5, fisheye",
    ] {
        assert!(error.contains(word), "{word}: {error}");
    }
    // Five coefficients are no fisheye's, and the two cameras' lenses are of one model.
    value["cameras"][1]["distortion"]["model"] = "fisheye".into();
    assert!(
        parse(&value)
            .unwrap_err()
            .to_string()
            .contains("4 coefficients expected, 5 found")
    );
    value["cameras"][1]["distortion"]["coefficients"] = serde_json::json!([0.0, 0.0, 0.0, 0.0]);
    assert!(
        parse(&value)
            .unwrap_err()
            .to_string()
            .contains("lenses of one model")
    );
}

/// A variance below zero made the stated uncertainty of every shape smaller.
#[test]
fn a_negative_variance_in_stereo_json_is_refused() {
    let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../../fixtures/pictured/stereo.json");
    let good: serde_json::Value =
        serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap();
    let parse = |v: &serde_json::Value| StereoDocument::parse("stereo.json", &v.to_string());
    assert!(parse(&good).is_ok(), "negative control");
    let changed = |way: &str, value: serde_json::Value| {
        let mut changed = good.clone();
        *changed.pointer_mut(way).unwrap() = value;
        changed
    };
    let row = good["covariance"][0].clone();
    for (way, value, says) in [
        (
            "/covariance/3/3",
            (-1e-9).into(),
            "covariance: variances of 0 or more",
        ),
        (
            "/covariance/0/1",
            1e6.into(),
            "covariance: a symmetric matrix",
        ),
        (
            "/covariance",
            serde_json::json!([row]),
            "covariance: 24 rows",
        ),
        ("/cameras/0/sd/fx", (-0.1).into(), "sd of fx"),
        ("/right_from_left_sd/0", (-0.1).into(), "right_from_left_sd"),
    ] {
        let error = parse(&changed(way, value)).unwrap_err().to_string();
        assert!(
            error.contains("stereo.json") && error.contains(says),
            "{way}: {error}"
        );
    }
}
