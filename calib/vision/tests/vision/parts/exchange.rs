//! Exports come back; malformed files are refused.

use wcal_vision::document::StereoDocument;
use wcal_vision::exchange::{exports, import_kalibr, import_opencv, imported};

fn document() -> StereoDocument {
    let pose =
        [[0.96, 0.0, -0.28, -118.0], [0.0, 1.0, 0.0, 2.0], [0.28, 0.0, 0.96, 25.0], [0.0, 0.0, 0.0, 1.0]];
    let camera = ([3450.0, 3452.0, 650.5, 470.25], [-0.14, 0.2, 1e-4, -2e-4, 0.03]);
    imported("here", [1280, 960], [camera, camera], pose).unwrap()
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
            x.k.iter().flatten().zip(y.k.iter().flatten()).all(|(p, q)| near(*p, *q))
                && x.distortion.coefficients.iter().zip(&y.distortion.coefficients).all(|(p, q)| near(*p, *q))
        })
}

#[test]
fn what_is_exported_is_imported_again() {
    let files = exports(&document()).unwrap();
    assert!(same(&import_opencv("opencv.yml", &files[0].1).unwrap(), &document()));
    assert!(same(&import_kalibr("camchain.yaml", &files[1].1).unwrap(), &document()));
    assert!(files[2].1.contains("plumb_bob"));
}

#[test]
fn malformed_files_are_refused_with_the_key() {
    let files = exports(&document()).unwrap();
    for (from, to, word) in
        [("K2:", "X2:", "K2"), ("e3, ", "e3; ", "K1"), ("image_width", "w", "image_width")]
    {
        let error = import_opencv("o.yml", &files[0].1.replace(from, to)).unwrap_err().to_string();
        assert!(error.contains(word), "{error}");
    }
    for (from, to, word) in
        [("radtan", "equi", "distortion_model"), ("cam1:", "cam9:", "cam1"), ("T_cn_cnm1", "T", "T_cn_cnm1")]
    {
        let error = import_kalibr("k.yaml", &files[1].1.replace(from, to)).unwrap_err().to_string();
        assert!(error.contains(word), "{error}");
    }
}
