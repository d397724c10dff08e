//! Comparison of a calibration with an earlier one, or another tool's, of the same cameras: errors that its own pictures cannot reveal.

use crate::calibrate::document::{CameraDocument, StereoDocument};
use nalgebra::Vector3;

/// Tolerance for a principal point offset by half a pixel in both coordinates, the sign of another convention for pixel centres, px.
const HALF_PIXEL_MARGIN: f64 = 0.15;
/// Standard deviations beyond which a difference is stated.
const LIMIT_SD: f64 = 4.0;
/// Differences below this share come from the method (number of coefficients, board warp).
const MIN_SHARE: f64 = 0.005;

/// What differs from a reference, as sentences: picture size, swapped cameras, scale, pixel centres, focal lengths.
#[must_use]
pub fn differences(new: &StereoDocument, reference: &StereoDocument) -> Vec<String> {
    if new.image_size_px != reference.image_size_px {
        let [[a, b], [c, d]] = [new.image_size_px, reference.image_size_px];
        return vec![format!("the reference is of pictures of {c}x{d}, these are {a}x{b}")];
    }
    let (Ok(own), Ok(other)) = (new.stereo_cameras(), reference.stereo_cameras()) else {
        return vec!["the reference's cameras are not physical".into()];
    };
    let (own, other) = (own.right_from_left, other.right_from_left);
    let direction = |t: Vector3<f64>| t.normalize();
    let near = |p: &nalgebra::Isometry3<f64>| {
        direction(p.translation.vector).dot(&direction(own.translation.vector))
            - p.rotation.angle_to(&own.rotation)
    };
    if near(&other.inverse()) > near(&other) + 0.5 {
        return vec!["left and right are swapped against the reference".into()];
    }
    let mut found = Vec::new();
    let [length, expected] = [own, other].map(|p| p.translation.vector.norm());
    let sd = new.right_from_left_sd.iter().skip(3).map(|s| s * s).sum::<f64>().sqrt();
    if (length - expected).abs() > (LIMIT_SD * sd).max(MIN_SHARE * expected) {
        found.push(format!(
            "the baseline is {length:.2} mm, {expected:.2} mm in the reference: a factor of {:.4} (another size of the squares?)",
            length / expected
        ));
    }
    for (a, b) in new.cameras.iter().zip(&reference.cameras) {
        found.extend(half_pixel(a, b));
        for k in 0..2 {
            let (f, g) = (a.k[k][k], b.k[k][k]);
            let name = ["fx", "fy"][k];
            let sd = a.sd.get(name).copied().unwrap_or(0.0);
            if (f - g).abs() > (LIMIT_SD * sd).max(MIN_SHARE * g) {
                found.push(format!(
                    "{} camera: {name} is {f:.1} px (sd {sd:.1}), {g:.1} px in the reference",
                    a.name
                ));
            }
        }
    }
    found
}

/// The sentence for a principal point half a pixel off to the lower right or the upper left.
fn half_pixel(own: &CameraDocument, reference: &CameraDocument) -> Option<String> {
    let [dx, dy] = [0, 1].map(|k| reference.k[k][2] - own.k[k][2]);
    let towards = [0.5, -0.5].into_iter().find(|h| (dx - h).hypot(dy - h) < HALF_PIXEL_MARGIN)?;
    let sd = ["cx", "cy"].map(|n| own.sd.get(n).copied().unwrap_or(0.0)).into_iter().fold(0.0, f64::max);
    Some(format!(
        "{} camera: the reference's principal point lies ({dx:+.2}, {dy:+.2}) px from this one: pixel centres at {} there? (known to {sd:.2} px here)",
        own.name,
        if towards > 0.0 { "+0.5" } else { "-0.5" }
    ))
}
