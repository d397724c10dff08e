//! A small renderer for tests (simulated pictures): area sampling by 6x6 points a pixel, Gaussian
//! blur, Gaussian noise.

pub mod bench;

use nalgebra::{Isometry3, Point3, Vector2, Vector3};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use rand_distr::{Distribution, Normal};
use std::path::{Path, PathBuf};
use wcal_vision::camera::Camera;
use wcal_vision::picture::Picture;

/// A folder of the repository's fixtures.
pub fn fixture(name: &str) -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR"))
        .join("../../fixtures")
        .join(name)
}

/// Draws `level(x, y)` (DN at continuous pixel coordinates, pixel centres at integers) with blur
/// and noise.
pub fn draw(
    width: usize,
    height: usize,
    blur_px: f64,
    noise_dn: f64,
    seed: u64,
    level: impl Fn(f64, f64) -> f64,
) -> Picture {
    const SUB: usize = 6;
    let mut sharp = vec![0.0f64; width * height];
    for y in 0..height {
        for x in 0..width {
            let mut sum = 0.0;
            for j in 0..SUB {
                for i in 0..SUB {
                    let at = |k: usize| (k as f64 + 0.5) / SUB as f64 - 0.5;
                    sum += level(x as f64 + at(i), y as f64 + at(j));
                }
            }
            sharp[y * width + x] = sum / (SUB * SUB) as f64;
        }
    }
    let blurred = blurred(&sharp, width, height, blur_px);
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let normal = Normal::new(0.0, noise_dn.max(1e-9)).unwrap();
    let data = blurred
        .iter()
        .map(|v| (v + normal.sample(&mut rng)).round().clamp(0.0, 255.0) as u8)
        .collect();
    Picture::new(width, height, data).unwrap()
}

/// A picture blurred by a Gaussian; the border is continued.
pub fn blurred(sharp: &[f64], width: usize, height: usize, blur_px: f64) -> Vec<f64> {
    let reach = (4.0 * blur_px).ceil() as i64;
    let kernel: Vec<f64> = (-reach..=reach)
        .map(|k| (-0.5 * (k as f64 / blur_px).powi(2)).exp())
        .collect();
    let total: f64 = kernel.iter().sum();
    let pass = |source: &[f64], dx: i64, dy: i64| -> Vec<f64> {
        (0..width * height)
            .map(|p| {
                let (x, y) = ((p % width) as i64, (p / width) as i64);
                (-reach..=reach)
                    .map(|k| {
                        let i = (x + k * dx).clamp(0, width as i64 - 1);
                        let j = (y + k * dy).clamp(0, height as i64 - 1);
                        kernel[(k + reach) as usize] / total
                            * source[j as usize * width + i as usize]
                    })
                    .sum()
            })
            .collect()
    };
    pass(&pass(sharp, 1, 0), 0, 1)
}

/// Where a camera's pixel meets the plane z = 0 of a board.
pub fn on_plane(
    camera: &Camera,
    camera_from_board: &Isometry3<f64>,
    x: f64,
    y: f64,
) -> Option<Vector2<f64>> {
    let n = camera.undistort(&Vector2::new(x, y))?;
    let inverse = camera_from_board.inverse();
    let origin = inverse * Point3::origin();
    let ray: Vector3<f64> = inverse.rotation * Vector3::new(n.x, n.y, 1.0);
    let s = -origin.z / ray.z;
    (s > 0.0).then(|| Vector2::new(origin.x + s * ray.x, origin.y + s * ray.y))
}

/// Writes a picture as binary PGM.
pub fn write_pgm(path: &Path, picture: &Picture) {
    let mut bytes = format!("P5\n{} {}\n255\n", picture.width, picture.height).into_bytes();
    bytes.extend(&picture.data);
    std::fs::write(path, bytes).unwrap();
}

/// Distance of a point from a polyline.
pub fn distance(p: &Vector3<f64>, line: &[Vector3<f64>]) -> f64 {
    line.windows(2)
        .map(|w| {
            let d = w[1] - w[0];
            let u = ((p - w[0]).dot(&d) / d.norm_squared()).clamp(0.0, 1.0);
            (p - w[0] - d * u).norm()
        })
        .fold(f64::INFINITY, f64::min)
}
