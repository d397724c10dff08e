//! Exchange with OpenCV (YAML), Kalibr (camchain YAML) and ROS (camera_info YAML).

use crate::document::{
    BoardDocument, CameraDocument, DistortionDocument, HeldOut, STEREO_FORMAT, StereoDocument,
};
use crate::error::VisionError;
use std::fmt::Write as _;

fn numbers(values: impl IntoIterator<Item = f64>) -> String {
    values.into_iter().map(|v| format!("{v:e}")).collect::<Vec<_>>().join(", ")
}

fn matrix(name: &str, rows: usize, columns: usize, values: impl IntoIterator<Item = f64>) -> String {
    format!(
        "{name}: !!opencv-matrix\n   rows: {rows}\n   cols: {columns}\n   dt: d\n   data: [ {} ]\n",
        numbers(values)
    )
}

/// Names and contents of the export files. OpenCV: K1, D1, K2, D2, R, T (mm) as its stereo sample writes them; Kalibr: metres.
///
/// # Errors
/// Where the document is no calibration of two cameras.
pub fn exports(document: &StereoDocument) -> Result<Vec<(String, String)>, VisionError> {
    document
        .stereo_cameras()
        .map_err(|found| VisionError::result("export a calibration", "two physical cameras", found))?;
    let t = &document.right_from_left;
    let [w, h] = document.image_size_px;
    let mut opencv = format!("%YAML:1.0\n---\nimage_width: {w}\nimage_height: {h}\n");
    for (k, camera) in document.cameras.iter().enumerate() {
        opencv += &matrix(&format!("K{}", k + 1), 3, 3, camera.k.iter().flatten().copied());
        opencv += &matrix(&format!("D{}", k + 1), 1, 5, camera.distortion.coefficients.iter().copied());
    }
    opencv += &matrix("R", 3, 3, (0..9).map(|k| t[k / 3][k % 3]));
    opencv += &matrix("T", 3, 1, (0..3).map(|k| t[k][3]));
    let mut kalibr = String::new();
    for (k, camera) in document.cameras.iter().enumerate() {
        let d = &camera.distortion.coefficients;
        let _ = writeln!(kalibr, "cam{k}:");
        if k == 1 {
            let _ = writeln!(kalibr, "  T_cn_cnm1:");
            for row in t {
                let metres = [row[0], row[1], row[2], row[3] * if row == &t[3] { 1.0 } else { 1e-3 }];
                let _ = writeln!(kalibr, "  - [{}]", numbers(metres));
            }
        }
        let _ = writeln!(kalibr, "  camera_model: pinhole");
        let _ = writeln!(kalibr, "  distortion_model: radtan");
        // Kalibr's radtan has no k3: it is written beside, and a reader that ignores it is warned by the comment.
        let _ = writeln!(
            kalibr,
            "  distortion_coeffs: [{}] # k3 = {:e} has no place in radtan",
            numbers(d[..4].iter().copied()),
            d[4]
        );
        let _ = writeln!(kalibr, "  k3: {:e}", d[4]);
        let _ = writeln!(
            kalibr,
            "  intrinsics: [{}]",
            numbers([camera.k[0][0], camera.k[1][1], camera.k[0][2], camera.k[1][2]])
        );
        let _ = writeln!(kalibr, "  resolution: [{w}, {h}]");
        let _ = writeln!(kalibr, "  rostopic: /{}/image_raw", camera.name);
    }
    let mut files = vec![("opencv.yml".to_string(), opencv), ("kalibr-camchain.yaml".to_string(), kalibr)];
    for camera in &document.cameras {
        let k = &camera.k;
        let ros_matrix = |name: &str, rows: usize, columns: usize, values: Vec<f64>| {
            format!("{name}:\n  rows: {rows}\n  cols: {columns}\n  data: [{}]\n", numbers(values))
        };
        let mut text = format!("image_width: {w}\nimage_height: {h}\ncamera_name: {}\n", camera.name);
        text += &ros_matrix("camera_matrix", 3, 3, k.iter().flatten().copied().collect());
        text += "distortion_model: plumb_bob\n";
        text += &ros_matrix("distortion_coefficients", 1, 5, camera.distortion.coefficients.clone());
        text += &ros_matrix("rectification_matrix", 3, 3, vec![1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]);
        let p = vec![k[0][0], 0.0, k[0][2], 0.0, 0.0, k[1][1], k[1][2], 0.0, 0.0, 0.0, 1.0, 0.0];
        text += &ros_matrix("projection_matrix", 3, 4, p);
        files.push((format!("ros-{}.yaml", camera.name), text));
    }
    Ok(files)
}

/// Numbers between the brackets that follow `key:` (OpenCV and ROS write matrices so).
fn bracketed(name: &str, text: &str, key: &str, count: usize) -> Result<Vec<f64>, VisionError> {
    let missing = |found: &str| {
        VisionError::content(name, format!("{key} with {count} numbers in brackets"), found.to_string())
    };
    let start = text
        .lines()
        .scan(0, |at, line| {
            let here = *at;
            *at += line.len() + 1;
            Some((here, line))
        })
        .find(|(_, line)| line.trim_start().trim_start_matches("- ").starts_with(&format!("{key}:")))
        .map(|(at, _)| at)
        .ok_or_else(|| missing("no such key"))?;
    let rest = &text[start..];
    let open = rest.find('[').ok_or_else(|| missing("no bracket"))?;
    let close = rest[open..].find(']').ok_or_else(|| missing("no closing bracket"))? + open;
    let values: Result<Vec<f64>, _> =
        rest[open + 1..close].split(',').map(|t| t.trim().parse::<f64>()).collect();
    let values = values.map_err(|e| missing(&e.to_string()))?;
    if values.len() != count || values.iter().any(|v| !v.is_finite()) {
        return Err(missing(&format!("{} numbers", values.len())));
    }
    Ok(values)
}

fn scalar(name: &str, text: &str, key: &str) -> Result<usize, VisionError> {
    text.lines()
        .find_map(|l| l.trim().strip_prefix(&format!("{key}:")).map(|v| v.trim().to_string()))
        .and_then(|v| v.parse().ok())
        .ok_or_else(|| VisionError::content(name, format!("{key} as a whole number"), "none"))
}

/// A document from imported numbers; nothing is known of its errors.
fn imported(
    name: &str,
    image_size_px: [usize; 2],
    cameras: [([f64; 4], [f64; 5]); 2],
    right_from_left: [[f64; 4]; 4],
) -> Result<StereoDocument, VisionError> {
    let camera = |which: &str, ([fx, fy, cx, cy], distortion): ([f64; 4], [f64; 5])| CameraDocument {
        name: which.into(),
        k: [[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]],
        distortion: DistortionDocument { model: "opencv5".into(), coefficients: distortion.to_vec() },
        sd: std::collections::BTreeMap::new(),
    };
    let [left, right] = cameras;
    let document = StereoDocument {
        format: STEREO_FORMAT.into(),
        image_size_px,
        cameras: vec![camera("left", left), camera("right", right)],
        right_from_left,
        right_from_left_sd: Vec::new(),
        rms_px: 0.0,
        per_view_rms_px: Vec::new(),
        views: Vec::new(),
        rejected_views: Vec::new(),
        held_out: HeldOut::default(),
        board: BoardDocument::default(),
        refinement: std::collections::BTreeMap::new(),
        refinement_chosen: String::new(),
        projection_sd_px: Vec::new(),
        covariance: Vec::new(),
        warnings: vec![format!("imported from {name}: no residuals, no uncertainty")],
        provenance: wcal_core::Provenance::default(),
    };
    document.stereo_cameras().map_err(|found| VisionError::content(name, "two physical cameras", found))?;
    Ok(document)
}

/// Reads an OpenCV file with K1, D1, K2, D2, R, T (mm) and the image size.
///
/// # Errors
/// Where a key is missing or malformed, or the cameras are not physical.
pub fn import_opencv(name: &str, text: &str) -> Result<StereoDocument, VisionError> {
    let camera = |k: usize| -> Result<([f64; 4], [f64; 5]), VisionError> {
        let m = bracketed(name, text, &format!("K{k}"), 9)?;
        let d = bracketed(name, text, &format!("D{k}"), 5)?;
        Ok(([m[0], m[4], m[2], m[5]], std::array::from_fn(|i| d[i])))
    };
    let (r, t) = (bracketed(name, text, "R", 9)?, bracketed(name, text, "T", 3)?);
    let pose = std::array::from_fn(|i| {
        std::array::from_fn(|j| match (i, j) {
            (3, j) => f64::from(u8::from(j == 3)),
            (i, 3) => t[i],
            (i, j) => r[3 * i + j],
        })
    });
    let size = [scalar(name, text, "image_width")?, scalar(name, text, "image_height")?];
    imported(name, size, [camera(1)?, camera(2)?], pose)
}

/// Reads a Kalibr camchain with two pinhole-radtan cameras (metres).
///
/// # Errors
/// As [`import_opencv`]; other camera or distortion models are refused by name.
pub fn import_kalibr(name: &str, text: &str) -> Result<StereoDocument, VisionError> {
    let (first, second) =
        text.split_once("cam1:").ok_or_else(|| VisionError::content(name, "cam0 and cam1", "no cam1"))?;
    let camera = |part: &str| -> Result<([f64; 4], [f64; 5]), VisionError> {
        for (key, wanted) in [("camera_model", "pinhole"), ("distortion_model", "radtan")] {
            let found =
                part.lines().find_map(|l| l.trim().strip_prefix(&format!("{key}:"))).unwrap_or("none");
            if found.trim() != wanted {
                return Err(VisionError::content(name, format!("{key}: {wanted}"), found.trim()));
            }
        }
        let i = bracketed(name, part, "intrinsics", 4)?;
        let d = bracketed(name, part, "distortion_coeffs", 4)?;
        let k3 = part.lines().find_map(|l| l.trim().strip_prefix("k3:")?.trim().parse().ok()).unwrap_or(0.0);
        Ok(([i[0], i[1], i[2], i[3]], [d[0], d[1], d[2], d[3], k3]))
    };
    let size = bracketed(name, first, "resolution", 2)?;
    let after = second
        .split_once("T_cn_cnm1:")
        .ok_or_else(|| VisionError::content(name, "T_cn_cnm1 of cam1", "none"))?
        .1;
    let mut pose = [[0.0; 4]; 4];
    let mut lines = after.lines().filter(|l| l.trim_start().starts_with('-'));
    for row in &mut pose {
        let line = lines.next().unwrap_or_default();
        let values: Vec<f64> = line
            .trim()
            .trim_start_matches("- [")
            .trim_end_matches(']')
            .split(',')
            .filter_map(|v| v.trim().parse().ok())
            .collect();
        *row = values.try_into().map_err(|v: Vec<f64>| {
            VisionError::content(name, "4 rows of 4 numbers under T_cn_cnm1", format!("{} numbers", v.len()))
        })?;
    }
    for row in pose.iter_mut().take(3) {
        row[3] *= 1e3;
    }
    imported(name, [size[0] as usize, size[1] as usize], [camera(first)?, camera(second)?], pose)
}

#[cfg(test)]
mod tests {
    use super::*;

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
                    && x.distortion
                        .coefficients
                        .iter()
                        .zip(&y.distortion.coefficients)
                        .all(|(p, q)| near(*p, *q))
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
        for (from, to, word) in [
            ("radtan", "equi", "distortion_model"),
            ("cam1:", "cam9:", "cam1"),
            ("T_cn_cnm1", "T", "T_cn_cnm1"),
        ] {
            let error = import_kalibr("k.yaml", &files[1].1.replace(from, to)).unwrap_err().to_string();
            assert!(error.contains(word), "{error}");
        }
    }
}
