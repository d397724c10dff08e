//! Cameras of other tools: OpenCV (YAML), Kalibr (camchain YAML) and ROS (camera_info YAML).
//! `export` writes them.

use crate::calibrate::document::{STEREO_FORMAT, StereoDocument, camera_document};
use crate::camera::{Camera, Lens, OPENCV5, lens_named};
use crate::error::VisionError;
use nalgebra::{Matrix3, Vector3};
use std::num::ParseFloatError;
use std::path::PathBuf;

/// Most coefficients of a model of Kalibr's.
pub(crate) const KALIBR_COEFFICIENTS: usize = 4;

/// Numbers between the brackets that follow `key:` (OpenCV and ROS write matrices so).
fn bracketed(name: &str, text: &str, key: &str, count: usize) -> Result<Vec<f64>, VisionError> {
    let missing = |found: &str| {
        VisionError::content(
            name,
            format!("{key} with {count} numbers in brackets"),
            found,
        )
    };
    let own_line = |(at, _): &(usize, &str)| {
        let line = text[..*at].rfind('\n').map_or(0, |end| end + 1);
        matches!(text[line..*at].trim(), "" | "-")
    };
    let found = text.match_indices(&format!("{key}:")).find(own_line);
    let (start, _) = found.ok_or_else(|| missing("no such key"))?;
    let rest = &text[start..];
    let (_, rest) = rest.split_once('[').ok_or_else(|| missing("no bracket"))?;
    let (numbers, _) = rest
        .split_once(']')
        .ok_or_else(|| missing("no closing bracket"))?;
    let values: Result<Vec<f64>, _> = numbers.split(',').map(|t| t.trim().parse()).collect();
    let values = values.map_err(|e: ParseFloatError| missing(&e.to_string()))?;
    if values.len() != count || values.iter().any(|v| !v.is_finite()) {
        return Err(missing(&format!("{} numbers", values.len())));
    }
    Ok(values)
}

/// The text that follows `key:` on a line.
fn named<'t>(text: &'t str, key: &str) -> Option<&'t str> {
    text.lines()
        .find_map(|l| Some(l.trim().strip_prefix(key)?.strip_prefix(':')?.trim()))
}

fn image_size(name: &str, text: &str) -> Result<[usize; 2], VisionError> {
    let number = |key: &str| {
        named(text, key)
            .and_then(|v| v.parse().ok())
            .ok_or_else(|| VisionError::content(name, format!("{key} as a whole number"), "none"))
    };
    Ok([number("image_width")?, number("image_height")?])
}

/// The model of the lens that a file names under `distortion_model`, by the names of its format.
fn lens_of(
    name: &str,
    text: &str,
    absent: &str,
    by: fn(&'static dyn Lens) -> &'static str,
) -> Result<&'static dyn Lens, VisionError> {
    lens_named(named(text, "distortion_model").unwrap_or(absent), by)
        .map_err(|why| VisionError::content(name, "distortion_model of a known lens", why))
}

/// A camera by its matrix, row by row, and its coefficients.
fn camera_of(size: [usize; 2], lens: &'static dyn Lens, m: &[f64], d: &[f64]) -> Camera {
    Camera::new(size, lens, &[&[m[0], m[4], m[2], m[5]][..], d].concat())
}

/// A document from imported numbers; nothing is known of its errors.
///
/// # Errors
/// Where the pose is not rigid, or the lenses are of two models.
pub fn imported(
    name: &str,
    [left, right]: [Camera; 2],
    right_from_left: [[f64; 4]; 4],
) -> Result<StereoDocument, VisionError> {
    let document = StereoDocument {
        format: STEREO_FORMAT.into(),
        image_size_px: left.image_size_px,
        cameras: vec![
            camera_document("left", &left, &[]),
            camera_document("right", &right, &[]),
        ],
        right_from_left,
        warnings: vec![format!(
            "imported from {name}: no residuals, no uncertainty"
        )],
        ..StereoDocument::default()
    };
    document
        .stereo_cameras()
        .map_err(|found| VisionError::content(name, "two physical cameras", found))?;
    Ok(document)
}

/// Reads calibrated cameras: a stereo.json, an OpenCV file (or its intrinsics and its extrinsics),
/// a Kalibr camchain, or the two camera_info files of ROS, left first.
///
/// # Errors
/// Where a file is missing, is none of these, or its cameras are not physical.
pub fn read_cameras(paths: &[PathBuf]) -> Result<StereoDocument, VisionError> {
    let texts = paths.iter().map(wcal_core::files::read_text);
    let texts = texts.collect::<Result<Vec<String>, _>>()?;
    let names: Vec<String> = paths.iter().map(|p| p.display().to_string()).collect();
    let name = names.join(" and ");
    match texts.as_slice() {
        [text] if text.trim_start().starts_with('{') => StereoDocument::parse(&name, text),
        [text] if text.contains("cam0:") => import_kalibr(&name, text),
        [left, right]
            if [left, right]
                .iter()
                .all(|t| t.contains("rectification_matrix:")) =>
        {
            import_ros(&name, [left, right])
        }
        [_] | [_, _] if texts.iter().all(|t| t.contains("opencv-matrix")) => {
            import_opencv(&name, &texts.join("\n"))
        }
        _ => Err(VisionError::content(
            name,
            "a stereo.json, an OpenCV file (or intrinsics and extrinsics), a Kalibr camchain, or two camera_info files of ROS",
            format!("{} files that are none of these", texts.len()),
        )),
    }
}

/// Reads an OpenCV file with K1, D1, K2, D2 (or M1, M2, as its stereo sample names them), R, T (mm)
/// and the image size.
///
/// # Errors
/// Where a key is missing or malformed, or the cameras are not physical.
pub fn import_opencv(name: &str, text: &str) -> Result<StereoDocument, VisionError> {
    let lens = lens_of(name, text, OPENCV5.model(), Lens::model)?;
    let size = image_size(name, text)?;
    let camera = |k: usize| -> Result<Camera, VisionError> {
        let m = bracketed(name, text, &format!("M{k}"), 9)
            .or_else(|_| bracketed(name, text, &format!("K{k}"), 9))?;
        let d = bracketed(name, text, &format!("D{k}"), lens.coefficient_names().len())?;
        Ok(camera_of(size, lens, &m, &d))
    };
    let (r, t) = (
        bracketed(name, text, "R", 9)?,
        bracketed(name, text, "T", 3)?,
    );
    let pose = pose_rows(&Matrix3::from_row_slice(&r), &Vector3::from_row_slice(&t));
    imported(name, [camera(1)?, camera(2)?], pose)
}

/// The 4x4 rows of a turn, as it was stated, and a shift.
fn pose_rows(r: &Matrix3<f64>, t: &Vector3<f64>) -> [[f64; 4]; 4] {
    let mut m = r.to_homogeneous();
    m.fixed_view_mut::<3, 1>(0, 3).copy_from(t);
    m.transpose().into()
}

/// Reads a Kalibr camchain with two pinhole cameras, both radtan or both equidistant (metres).
///
/// # Errors
/// As [`import_opencv`]; other camera or distortion models are refused by name.
pub fn import_kalibr(name: &str, text: &str) -> Result<StereoDocument, VisionError> {
    let (first, second) = text
        .split_once("cam1:")
        .ok_or_else(|| VisionError::content(name, "cam0 and cam1", "no cam1"))?;
    let size = bracketed(name, first, "resolution", 2)?;
    let size = [size[0] as usize, size[1] as usize];
    let camera = |part: &str| -> Result<Camera, VisionError> {
        let found = named(part, "camera_model").unwrap_or("none");
        if found != "pinhole" {
            return Err(VisionError::content(name, "camera_model: pinhole", found));
        }
        let lens = lens_of(name, part, "none", Lens::kalibr_model)?;
        let pinhole = bracketed(name, part, "intrinsics", 4)?;
        let d = bracketed(name, part, "distortion_coeffs", KALIBR_COEFFICIENTS)?;
        Ok(Camera::new(size, lens, &[pinhole, d].concat()))
    };
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
            VisionError::content(
                name,
                "4 rows of 4 numbers under T_cn_cnm1",
                format!("{} numbers", v.len()),
            )
        })?;
    }
    for row in pose.iter_mut().take(3) {
        row[3] *= 1e3;
    }
    imported(name, [camera(first)?, camera(second)?], pose)
}

/// Reads the two camera_info files of ROS, left and right (metres): the relative pose is in the
/// rectification and the right projection.
///
/// # Errors
/// As [`import_opencv`]; other distortion models are refused by name.
pub fn import_ros(name: &str, texts: [&str; 2]) -> Result<StereoDocument, VisionError> {
    let side = |text: &str| -> Result<(Camera, Matrix3<f64>), VisionError> {
        let lens = lens_of(name, text, "none", Lens::ros_model)?;
        let size = image_size(name, text)?;
        let m = bracketed(name, text, "camera_matrix", 9)?;
        let count = lens.coefficient_names().len();
        let d = bracketed(name, text, "distortion_coefficients", count)?;
        let rectifying = bracketed(name, text, "rectification_matrix", 9)?;
        Ok((
            camera_of(size, lens, &m, &d),
            Matrix3::from_row_slice(&rectifying),
        ))
    };
    let ((left, turn_left), (right, turn_right)) = (side(texts[0])?, side(texts[1])?);
    let sizes = [left.image_size_px, right.image_size_px];
    if sizes[0] != sizes[1] {
        return Err(VisionError::content(
            name,
            "pictures of one size",
            format!("{:?} and {:?}", sizes[0], sizes[1]),
        ));
    }
    let p = bracketed(name, texts[1], "projection_matrix", 12)?;
    let baseline_mm = Vector3::new(p[3] / p[0], p[7] / p[5], 0.0) * 1e3;
    if !(baseline_mm.norm() > 0.0) {
        return Err(VisionError::content(
            name,
            "a right projection_matrix with a baseline",
            "none",
        ));
    }
    let back = turn_right.transpose();
    let pose = pose_rows(&(back * turn_left), &(back * baseline_mm));
    imported(name, [left, right], pose)
}
