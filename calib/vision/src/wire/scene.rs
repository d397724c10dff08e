//! Evidence of both pictures for the wire at a place in space, and the region that a wire already
//! found covers.

use crate::rig::RigWhisker;
use crate::stereo::StereoCameras;
use crate::wire::ridge::{Evidence, HIDDEN, RidgeMap};
use nalgebra::{Isometry3, Rotation3, Vector2, Vector3};
use wcal_core::order_statistics::median;

/// Side of the cells in which a found wire is covered up, px.
const COVER_PX: f64 = 4.0;

/// The pictures' evidence for one polarity.
pub struct Scene<'a> {
    stereo: &'a StereoCameras,
    /// Rotation and translation from the base to each camera.
    camera_from_base: [(Rotation3<f64>, Vector3<f64>); 2],
    maps: &'a [RidgeMap<'a>; 2],
    evidence: [Evidence; 2],
    /// Cells of each picture, row by row, that are covered up; empty where none is.
    covered: [Vec<bool>; 2],
}

impl<'a> Scene<'a> {
    /// Cameras, base, maps and scores of both pictures.
    pub fn new(
        stereo: &'a StereoCameras,
        left_from_base: &Isometry3<f64>,
        maps: &'a [RidgeMap<'a>; 2],
        evidence: [Evidence; 2],
    ) -> Self {
        let camera_from_base = [0, 1].map(|camera| {
            let pose = stereo.in_camera(camera, left_from_base);
            (pose.rotation.to_rotation_matrix(), pose.translation.vector)
        });
        Self {
            stereo,
            camera_from_base,
            maps,
            evidence,
            covered: Default::default(),
        }
    }

    /// The same scene with a wire covered up: within this distance of its image nothing counts for
    /// or against a wire.
    pub fn without(mut self, path: &[Vector3<f64>], distance_px: f64) -> Self {
        let reach = (distance_px / COVER_PX).ceil() as i64;
        for camera in 0..2 {
            let [columns, rows] = self.cells(camera);
            let mut covered = vec![false; columns * rows];
            for w in path.windows(2) {
                let [a, b] = [w[0], w[1]].map(|p| self.image(camera, &p, &Vector3::x()));
                let (Some((a, _)), Some((b, _))) = (a, b) else {
                    continue;
                };
                let steps = ((b - a).norm() / COVER_PX).ceil().max(1.0) as i64;
                for k in 0..=steps {
                    let [x, y] = cell(&(a + (b - a) * (k as f64 / steps as f64)));
                    for j in (y - reach).max(0)..=(y + reach).min(rows as i64 - 1) {
                        for i in (x - reach).max(0)..=(x + reach).min(columns as i64 - 1) {
                            covered[j as usize * columns + i as usize] = true;
                        }
                    }
                }
            }
            self.covered[camera] = covered;
        }
        self
    }

    /// Cells of a picture, across and down.
    fn cells(&self, camera: usize) -> [usize; 2] {
        self.stereo.cameras[camera]
            .image_size_px
            .map(|n| (n as f64 / COVER_PX).ceil() as usize)
    }

    /// Pixel and unit normal of the wire's image in one camera.
    fn image(
        &self,
        camera: usize,
        p: &Vector3<f64>,
        t: &Vector3<f64>,
    ) -> Option<(Vector2<f64>, Vector2<f64>)> {
        let (turn, shift) = &self.camera_from_base[camera];
        let (x, d) = (turn * p + shift, turn * t);
        if x.z <= 0.0 {
            return None;
        }
        let c = &self.stereo.cameras[camera];
        let n = Vector2::new(x.x / x.z, x.y / x.z);
        let (q, by_n) = c.distort(&n);
        // Derivative of the image along the wire.
        let run = by_n * Vector2::new(d.x - n.x * d.z, d.y - n.y * d.z);
        let along =
            Vector2::new(c.focal_px[0] * run.x, c.focal_px[1] * run.y).try_normalize(1e-9)?;
        Some((c.pixel(&q), Vector2::new(-along.y, along.x)))
    }

    /// Where one camera sees a place, in mm at its depth, and the direction of the image's normal
    /// there, rad.
    pub(crate) fn seen_from(
        &self,
        camera: usize,
        p: &Vector3<f64>,
        t: &Vector3<f64>,
    ) -> Option<(Vector2<f64>, f64)> {
        let (px, normal) = self.image(camera, p, t)?;
        let (turn, shift) = &self.camera_from_base[camera];
        let mm_per_px = (turn * p + shift).z / self.stereo.cameras[camera].focal_px[0];
        Some((px * mm_per_px, normal.y.atan2(normal.x)))
    }

    /// How strongly a place answers, where it is likelier a wire than not.
    pub(crate) fn wire_response(
        &self,
        camera: usize,
        p: &Vector3<f64>,
        t: &Vector3<f64>,
    ) -> Option<f64> {
        let (px, normal) = self.image(camera, p, t)?;
        let response = self.maps[camera].across(&px, &normal)?;
        (self.evidence[camera].score(Some(response)) > 0.0).then_some(response.abs())
    }

    /// Score of a place of the wire and whether either picture shows it.
    pub(crate) fn score(&self, p: &Vector3<f64>, t: &Vector3<f64>) -> (f64, bool) {
        let (mut sum, mut seen) = (0.0, false);
        for camera in 0..2 {
            sum += match self.image(camera, p, t) {
                Some((px, normal)) if !self.covers(camera, &px) => {
                    seen = true;
                    self.evidence[camera].score(self.maps[camera].across(&px, &normal))
                }
                _ => HIDDEN,
            };
        }
        (sum, seen)
    }

    fn covers(&self, camera: usize, px: &Vector2<f64>) -> bool {
        if self.covered[camera].is_empty() {
            return false;
        }
        let ([x, y], [columns, _]) = (cell(px), self.cells(camera));
        let inside = (0..columns as i64).contains(&x) && y >= 0;
        inside && self.covered[camera].get(y as usize * columns + x as usize) == Some(&true)
    }
}

fn cell(px: &Vector2<f64>) -> [i64; 2] {
    [
        (px.x / COVER_PX).floor() as i64,
        (px.y / COVER_PX).floor() as i64,
    ]
}

/// Response that a wire shows near the root, per camera: the median over places of the strongest
/// response across the expected line, within the distance that a root `aside_mm` off and the
/// curvature at the root allow.
pub(crate) fn expected_strength(
    stereo: &StereoCameras,
    left_from_base: &Isometry3<f64>,
    maps: &[RidgeMap<'_>; 2],
    whisker: &RigWhisker,
    polarity: f64,
    aside_mm: f64,
) -> [f64; 2] {
    let none = [0, 1].map(|_| Evidence::new(&[], 1.0, polarity));
    let scene = Scene::new(stereo, left_from_base, maps, none);
    let end = whisker
        .straight_mm
        .min(0.3 * whisker.length_mm)
        .clamp(4.0, 8.0);
    let px_per_mm = stereo.cameras[0].focal_px[0] / left_from_base.translation.z;
    [0, 1].map(|camera| {
        let strongest: Vec<f64> = (0..40)
            .filter_map(|k| {
                let s = 1.5 + (end - 1.5) * f64::from(k) / 39.0;
                let (px, normal) =
                    scene.image(camera, &Vector3::new(s, 0.0, 0.0), &Vector3::x())?;
                // Distance that half of the largest starting curvature gives.
                let reach = 3.0 + (aside_mm + 0.012 * s * s) * px_per_mm;
                let count = (2.0 * reach) as i64;
                (-count..=count)
                    .filter_map(|i| maps[camera].across(&(px + normal * (0.5 * i as f64)), &normal))
                    .map(|r| polarity * r)
                    .max_by(f64::total_cmp)
            })
            .collect();
        median(strongest).unwrap_or(0.0).max(1e-6)
    })
}
