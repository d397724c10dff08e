//! Cameras for other tools: OpenCV (YAML), Kalibr (camchain YAML) and ROS (camera_info YAML).
//! `import` reads them.

use crate::calibrate::document::StereoDocument;
use crate::calibrate::import::KALIBR_COEFFICIENTS;
use crate::camera::{Camera, FISHEYE, OPENCV5};
use crate::error::{OpenCvContext, VisionError};
use crate::stereo::StereoCameras;
use nalgebra::{SMatrix, SVector, Vector2, Vector3};
use opencv::calib3d;
use opencv::core::{Mat, Size};
use opencv::prelude::*;
use std::fmt::Write as _;
use wcal_core::least_squares::{Damping, NormalEquations, minimise};

fn numbers(values: &[f64]) -> String {
    let each: Vec<String> = values.iter().map(|v| format!("{v:e}")).collect();
    each.join(", ")
}

fn matrix(name: &str, columns: usize, values: &[f64]) -> String {
    format!(
        "{name}: !!opencv-matrix\n   rows: {}\n   cols: {columns}\n   dt: d\n   data: [ {} ]\n",
        values.len() / columns,
        numbers(values)
    )
}

fn physical(document: &StereoDocument) -> Result<StereoCameras, VisionError> {
    document
        .stereo_cameras()
        .map_err(|found| VisionError::result("export a calibration", "two physical cameras", found))
}

/// Names and contents of the export files. OpenCV: K1, D1, K2, D2, R, T (mm) as its stereo sample
/// writes them; Kalibr: metres.
///
/// # Errors
/// Where the document is no calibration of two cameras.
pub fn exports(document: &StereoDocument) -> Result<Vec<(String, String)>, VisionError> {
    let stereo = physical(document)?;
    let t = &document.right_from_left;
    let [w, h] = document.image_size_px;
    let mark = if document.provenance.simulated {
        "# SIMULATED: the pictures are rendered, not taken\n"
    } else {
        ""
    };
    let lens = stereo.cameras[0].lens;
    let mut opencv = format!("%YAML:1.0\n---\n{mark}image_width: {w}\nimage_height: {h}\n");
    // OpenCV's own functions take D as five coefficients; those of its module fisheye take four.
    if lens != OPENCV5 {
        let _ = writeln!(opencv, "distortion_model: {}", lens.model());
    }
    for (k, camera) in document.cameras.iter().enumerate() {
        opencv += &matrix(&format!("K{}", k + 1), 3, camera.k.as_flattened());
        let d = &camera.distortion.coefficients;
        opencv += &matrix(&format!("D{}", k + 1), d.len(), d);
    }
    let turn: [[f64; 3]; 3] = [0, 1, 2].map(|k| [t[k][0], t[k][1], t[k][2]]);
    opencv += &matrix("R", 3, turn.as_flattened());
    opencv += &matrix("T", 1, &[0, 1, 2].map(|k| t[k][3]));
    let mut kalibr = mark.to_owned();
    for (k, (camera, full)) in document.cameras.iter().zip(&stereo.cameras).enumerate() {
        let (fitted, farthest_px) = kalibr_camera(full);
        let parameters = fitted.parameters();
        let (pinhole, d) = parameters.split_at(4);
        let _ = writeln!(kalibr, "cam{k}:");
        if k == 1 {
            let _ = writeln!(kalibr, "  T_cn_cnm1:");
            for row in t {
                let [x, y, z, shift] = *row;
                let metres = if row == &t[3] { shift } else { shift * 1e-3 };
                let _ = writeln!(kalibr, "  - [{}]", numbers(&[x, y, z, metres]));
            }
        }
        let _ = writeln!(kalibr, "  camera_model: pinhole");
        let _ = writeln!(kalibr, "  distortion_model: {}", lens.kalibr_model());
        let coefficients = numbers(&d[..KALIBR_COEFFICIENTS]);
        let _ = write!(kalibr, "  distortion_coeffs: [{coefficients}]");
        let _ = match lens == OPENCV5 {
            true => writeln!(
                kalibr,
                " # for the five of stereo.json, fitted over the picture: at most {farthest_px:.3} px apart"
            ),
            false => writeln!(kalibr),
        };
        let _ = writeln!(kalibr, "  intrinsics: [{}]", numbers(pinhole));
        let _ = writeln!(kalibr, "  resolution: [{w}, {h}]");
        let _ = writeln!(kalibr, "  rostopic: /{}/image_raw", camera.name);
    }
    let mut files = vec![
        ("opencv.yml".to_string(), opencv),
        ("kalibr-camchain.yaml".to_string(), kalibr),
    ];
    let rectified = rectify(document, &stereo)?;
    for (camera, (rotation, projection)) in document.cameras.iter().zip(rectified) {
        let ros_matrix = |name: &str, columns: usize, values: &[f64]| {
            format!(
                "{name}:\n  rows: {}\n  cols: {columns}\n  data: [{}]\n",
                values.len() / columns,
                numbers(values)
            )
        };
        let mut text = format!(
            "{mark}image_width: {w}\nimage_height: {h}\ncamera_name: {}\n",
            camera.name
        );
        text += &ros_matrix("camera_matrix", 3, camera.k.as_flattened());
        let d = &camera.distortion.coefficients;
        let _ = writeln!(text, "distortion_model: {}", lens.ros_model());
        text += &ros_matrix("distortion_coefficients", d.len(), d);
        text += &ros_matrix("rectification_matrix", 3, &rotation);
        text += &ros_matrix("projection_matrix", 4, &projection);
        files.push((format!("ros-{}.yaml", camera.name), text));
    }
    Ok(files)
}

/// A camera with the coefficients that Kalibr has, and how far its pixels lie from those of the
/// camera that it stands for at most. Kalibr's radtan has k1, k2, p1, p2. Without k3 the other four
/// are another lens, since k2 and k3 balance each other: these and the pinhole are fitted to the
/// five-coefficient map, by least squares over the picture.
fn kalibr_camera(full: &Camera) -> (Camera, f64) {
    /// Places along a side of the picture.
    const GRID: usize = 21;
    let [w, h] = full.image_size_px.map(|size| size as f64);
    // A grid over all of the picture: also its corners count.
    let place = |k: usize, size: f64| k as f64 * size / (GRID - 1) as f64 - 0.5;
    let seen: Vec<(Vector2<f64>, Vector3<f64>)> = (0..GRID * GRID)
        .map(|k| Vector2::new(place(k % GRID, w), place(k / GRID, h)))
        .filter_map(|px| Some((px, full.ray(&px)?)))
        .collect();
    let mut camera = full.clone();
    if full.lens == OPENCV5 {
        camera.distortion[KALIBR_COEFFICIENTS] = 0.0;
        // The pinhole's four parameters and these coefficients.
        const FREE: usize = 4 + KALIBR_COEFFICIENTS;
        let linearise = |camera: &Camera| {
            let mut cost = 0.0;
            let (mut matrix, mut descent) = (SMatrix::<f64, FREE, FREE>::zeros(), SVector::zeros());
            for (px, ray) in &seen {
                let (at, _, by_camera) = camera.project_with_jacobian(ray)?;
                let (error, j) = (px - at, by_camera.fixed_columns::<FREE>(0));
                cost += error.norm_squared();
                matrix += j.transpose() * j;
                descent += j.transpose() * error;
            }
            Some(NormalEquations {
                cost,
                matrix,
                descent,
            })
        };
        if let Some(first) = linearise(&camera) {
            let moved = |camera: &Camera, _: &_, step: &SVector<f64, FREE>| {
                let p = camera.parameters();
                let p: Vec<f64> = p.iter().zip(step.iter()).map(|(p, s)| p + s).collect();
                camera.with_parameters(&p)
            };
            let ends = |_: &_, [before, after]: [f64; 2]| before - after < 1e-12 * after;
            camera = minimise((camera, first), &Damping::default(), linearise, moved, ends).place;
        }
    }
    let apart = seen
        .iter()
        .filter_map(|(px, ray)| Some((camera.project(ray)? - px).norm()));
    let farthest_px = apart.fold(0.0, f64::max);
    (camera, farthest_px)
}

/// How far the pixels of kalibr-camchain.yaml lie from those of the calibration at most, px.
///
/// # Errors
/// Where the document is no calibration of two cameras.
pub fn kalibr_distance_px(document: &StereoDocument) -> Result<f64, VisionError> {
    let [left, right] = physical(document)?.cameras;
    Ok(kalibr_camera(&left).1.max(kalibr_camera(&right).1))
}

/// Rotation (3x3) and projection (3x4, metres) of a rectified camera, row by row.
type Rectified = (Vec<f64>, Vec<f64>);

/// Both rectified cameras as OpenCV makes them (Bouguet).
fn rectify(
    document: &StereoDocument,
    stereo: &StereoCameras,
) -> Result<[Rectified; 2], VisionError> {
    let right_from_left = &stereo.right_from_left;
    let doing = "rectify the cameras";
    let [k1, k2] = [0, 1].map(|c| Mat::from_slice_2d(&document.cameras[c].k));
    let [d1, d2] = [0, 1].map(|c| Mat::from_slice(&document.cameras[c].distortion.coefficients));
    let (d1, d2) = (d1.doing(doing)?, d2.doing(doing)?);
    let turn = right_from_left.rotation.to_rotation_matrix().into_inner();
    let turn: [[f64; 3]; 3] = turn.transpose().into();
    let r = Mat::from_slice_2d(&turn).doing(doing)?;
    let t: [f64; 3] = (right_from_left.translation.vector * 1e-3).into();
    let t = Mat::from_slice_2d(&t.map(|v| [v])).doing(doing)?;
    let [w, h] = document.image_size_px.map(|n| n as i32);
    let mut out: [Mat; 5] = std::array::from_fn(|_| Mat::default());
    let [r1, r2, p1, p2, q] = &mut out;
    let (k1, k2) = (k1.doing(doing)?, k2.doing(doing)?);
    let size = Size::new(w, h);
    if stereo.cameras[0].lens == FISHEYE {
        calib3d::fisheye_stereo_rectify_def(&k1, &d1, &k2, &d2, size, &r, &t, r1, r2, p1, p2, q, 0)
            .doing(doing)?;
    } else {
        calib3d::stereo_rectify_def(&k1, &d1, &k2, &d2, size, &r, &t, r1, r2, p1, p2, q)
            .doing(doing)?;
    }
    let values = |m: &Mat| -> Result<Vec<f64>, VisionError> {
        Ok(m.data_typed::<f64>().doing(doing)?.to_vec())
    };
    let [r1, r2, p1, p2, _] = &out;
    Ok([(values(r1)?, values(p1)?), (values(r2)?, values(p2)?)])
}
