//! Exchange with OpenCV (YAML), Kalibr (camchain YAML) and ROS (camera_info YAML).

use crate::document::StereoDocument;
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
        let _ = writeln!(kalibr, "  distortion_coeffs: [{}] # k3 = {:e} has no place in radtan", numbers(d[..4].iter().copied()), d[4]);
        let _ = writeln!(kalibr, "  k3: {:e}", d[4]);
        let _ = writeln!(kalibr, "  intrinsics: [{}]", numbers([camera.k[0][0], camera.k[1][1], camera.k[0][2], camera.k[1][2]]));
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
