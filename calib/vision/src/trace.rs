//! Finds the wire: a beam search in space that grows a curve of bounded bending from the root and scores it in both pictures.
//! Working in space rather than in each picture keeps it on the wire through crossings and where one picture hides it.

use crate::document::StereoCameras;
use crate::ridge::{Evidence, HIDDEN, RidgeMap};
use crate::rig::RigWhisker;
use crate::rigid::hat;
use nalgebra::{Isometry3, Matrix3, Vector2, Vector3};
use std::collections::HashSet;

/// Length of a step of the search, mm.
const STEP_MM: f64 = 1.0;
/// Places scored a step.
const PLACES: usize = 3;
/// Curves kept.
pub const BEAM: usize = 160;
/// Side of the cells in which a found wire is covered up, px.
const COVER_PX: f64 = 4.0;
/// Change of curvature a step, 1/mm: a force of 0.2 N bends a 0.3 mm NiTi wire by 0.0067 a mm, few times more than a groove's.
const CURVATURE_STEP: f64 = 0.0015;

/// What the search found.
#[derive(Debug, Clone)]
pub struct Trace {
    /// Curvature deviations from nominal, one a millimetre.
    pub curvatures: Vec<[f64; 2]>,
    /// Arc length of the last place with evidence, mm.
    pub length_mm: f64,
    /// Summed log likelihood ratio up to there.
    pub score: f64,
    /// Typical response along the wire, left and right.
    pub strength: [f64; 2],
    /// Places along it, base frame, one a step.
    pub path: Vec<Vector3<f64>>,
}

#[derive(Clone)]
struct Candidate {
    position: Vector3<f64>,
    frame: Matrix3<f64>,
    bend: [f64; 2],
    score: f64,
    best: f64,
    best_step: usize,
    parent: usize,
}

/// The pictures' evidence for one polarity.
pub struct Scene<'a> {
    stereo: &'a StereoCameras,
    /// Rotation and translation from the base to each camera.
    camera_from_base: [(Matrix3<f64>, Vector3<f64>); 2],
    maps: &'a [RidgeMap<'a>; 2],
    evidence: [Evidence; 2],
    /// Cells of each picture that are covered up.
    covered: [HashSet<[i32; 2]>; 2],
}

impl<'a> Scene<'a> {
    /// Cameras, base, maps and scores of both pictures.
    #[must_use]
    pub fn new(
        stereo: &'a StereoCameras,
        left_from_base: &Isometry3<f64>,
        maps: &'a [RidgeMap<'a>; 2],
        evidence: [Evidence; 2],
    ) -> Self {
        let parts =
            |pose: Isometry3<f64>| (*pose.rotation.to_rotation_matrix().matrix(), pose.translation.vector);
        let camera_from_base = [parts(*left_from_base), parts(stereo.right_from_left * left_from_base)];
        Self { stereo, camera_from_base, maps, evidence, covered: Default::default() }
    }

    /// The same scene with a wire covered up: within this distance of its image nothing counts for or against a wire.
    #[must_use]
    pub fn without(mut self, path: &[Vector3<f64>], distance_px: f64) -> Self {
        let reach = (distance_px / COVER_PX).ceil() as i32;
        for camera in 0..2 {
            for w in path.windows(2) {
                let (Some((a, _)), Some((b, _))) =
                    (self.image(camera, &w[0], &Vector3::x()), self.image(camera, &w[1], &Vector3::x()))
                else {
                    continue;
                };
                let steps = ((b - a).norm() / COVER_PX).ceil().max(1.0) as i32;
                for k in 0..=steps {
                    let [x, y] = cell(&(a + (b - a) * (f64::from(k) / f64::from(steps))));
                    let square = (-reach..=reach).flat_map(|i| (-reach..=reach).map(move |j| [x + i, y + j]));
                    self.covered[camera].extend(square);
                }
            }
        }
        self
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
        let run = by_n * Vector2::new(d.x - n.x * d.z, d.y - n.y * d.z);
        let along = Vector2::new(c.focal_px[0] * run.x, c.focal_px[1] * run.y).try_normalize(1e-9)?;
        let px = Vector2::new(c.focal_px[0] * q.x + c.centre_px[0], c.focal_px[1] * q.y + c.centre_px[1]);
        Some((px, Vector2::new(-along.y, along.x)))
    }

    fn response(&self, camera: usize, p: &Vector3<f64>, t: &Vector3<f64>) -> Option<f64> {
        let (px, normal) = self.image(camera, p, t)?;
        self.maps[camera].across(&px, &normal)
    }

    fn score(&self, p: &Vector3<f64>, t: &Vector3<f64>) -> f64 {
        (0..2)
            .map(|camera| match self.image(camera, p, t) {
                Some((px, normal)) if !self.covers(camera, &px) => {
                    self.evidence[camera].score(self.maps[camera].across(&px, &normal))
                }
                _ => HIDDEN,
            })
            .sum()
    }

    fn covers(&self, camera: usize, px: &Vector2<f64>) -> bool {
        !self.covered[camera].is_empty() && self.covered[camera].contains(&cell(px))
    }
}

fn cell(px: &Vector2<f64>) -> [i32; 2] {
    [(px.x / COVER_PX).floor() as i32, (px.y / COVER_PX).floor() as i32]
}

/// Response that a wire shows near the root, per camera: the median over places of the strongest response across the expected line.
#[must_use]
pub fn expected_strength(
    stereo: &StereoCameras,
    left_from_base: &Isometry3<f64>,
    maps: &[RidgeMap<'_>; 2],
    whisker: &RigWhisker,
    polarity: f64,
) -> [f64; 2] {
    let none = [0, 1].map(|_| Evidence::new(&[], 1.0, polarity));
    let scene = Scene::new(stereo, left_from_base, maps, none);
    let end = whisker.straight_mm.min(0.3 * whisker.length_mm).max(4.0);
    [0, 1].map(|camera| {
        let mut strongest: Vec<f64> = (0..40)
            .filter_map(|k| {
                let s = 2.0 + (end - 2.0) * f64::from(k) / 39.0;
                let (px, normal) = scene.image(camera, &Vector3::new(s, 0.0, 0.0), &Vector3::x())?;
                let reach = 3.0 + 6.0 * s / end;
                let count = (4.0 * reach) as i64;
                (-count..=count)
                    .filter_map(|i| maps[camera].across(&(px + normal * (0.5 * i as f64)), &normal))
                    .map(|r| polarity * r)
                    .max_by(f64::total_cmp)
            })
            .collect();
        strongest.sort_by(f64::total_cmp);
        strongest.get(strongest.len() / 2).copied().unwrap_or(0.0).max(1e-6)
    })
}

/// Grows curves from the root, keeping the best `beam` of them, and returns the best; none where no curve has any evidence.
#[must_use]
pub fn trace(scene: &Scene<'_>, whisker: &RigWhisker, beam: usize) -> Option<Trace> {
    let steps = (1.12 * whisker.length_mm / STEP_MM) as usize;
    let mut history: Vec<Vec<Candidate>> = Vec::with_capacity(steps + 1);
    // The bending moment at the root is unknown: every curvature up to 0.03 / mm is started.
    let mut now: Vec<Candidate> = (-8..=8)
        .flat_map(|a| (-8..=8).map(move |b| [f64::from(a) * 0.00375, f64::from(b) * 0.00375]))
        .map(|bend| Candidate {
            position: Vector3::zeros(),
            frame: Matrix3::identity(),
            bend,
            score: 0.0,
            best: 0.0,
            best_step: 0,
            parent: 0,
        })
        .collect();
    for step in 0..steps {
        let mut next: Vec<Candidate> = Vec::new();
        // While the started curves still lie side by side there is nothing to branch.
        let branch = step >= 5;
        for (index, c) in now.iter().enumerate() {
            for (a, b) in (-1..=1).flat_map(|a| (-1..=1).map(move |b| (a, b))) {
                if !branch && (a != 0 || b != 0) {
                    continue;
                }
                let bend =
                    [c.bend[0] + f64::from(a) * CURVATURE_STEP, c.bend[1] + f64::from(b) * CURVATURE_STEP];
                let mut child = Candidate { bend, parent: index, ..c.clone() };
                child.score -= 0.5 * f64::from(a * a + b * b);
                advance(scene, whisker, &mut child, step);
                if child.score > child.best {
                    child.best = child.score;
                    child.best_step = step + 1;
                }
                next.push(child);
            }
        }
        history.push(std::mem::take(&mut now));
        now = if branch { prune(next, beam) } else { next };
    }
    history.push(now);
    let last = history.last()?;
    let (mut index, best) = last.iter().enumerate().max_by(|a, b| a.1.best.total_cmp(&b.1.best))?;
    if best.best_step == 0 {
        return None;
    }
    let (score, best_step) = (best.best, best.best_step);
    let mut curvatures = Vec::with_capacity(steps);
    let mut path = Vec::with_capacity(steps);
    let mut responses: [Vec<f64>; 2] = [Vec::new(), Vec::new()];
    for level in history.iter().rev() {
        let c = &level[index];
        curvatures.push(c.bend);
        path.push(c.position);
        for (k, list) in responses.iter_mut().enumerate() {
            let r = scene.response(k, &c.position, &c.frame.column(0).into_owned());
            if let Some(r) = r.filter(|&r| scene.evidence[k].score(Some(r)) > 0.0) {
                list.push(r.abs());
            }
        }
        index = c.parent;
    }
    curvatures.reverse();
    path.reverse();
    path.truncate(best_step + 1);
    let end = curvatures[best_step.min(curvatures.len() - 1)];
    // Beyond the end the curve goes on as it was.
    for c in curvatures.iter_mut().skip(best_step) {
        *c = end;
    }
    Some(Trace {
        curvatures: curvatures.into_iter().skip(1).collect(),
        length_mm: best_step as f64 * STEP_MM,
        score,
        strength: responses.map(|r| crate::initial::median(&r)),
        path,
    })
}

fn advance(scene: &Scene<'_>, whisker: &RigWhisker, c: &mut Candidate, step: usize) {
    let h = STEP_MM / PLACES as f64;
    for place in 0..PLACES {
        let s = step as f64 * STEP_MM + (place as f64 + 0.5) * h;
        let nominal = if s > whisker.straight_mm { whisker.arc_curvature_per_mm } else { 0.0 };
        let half = small_turn(&(Vector3::new(0.0, -(c.bend[1] - nominal), c.bend[0]) * (0.5 * h)));
        let middle = c.frame * half;
        let tangent = middle.column(0).into_owned();
        let score = scene.score(&(c.position + tangent * (0.5 * h)), &tangent);
        c.position += tangent * h;
        c.frame = middle * half;
        c.score += score;
    }
}

/// Rodrigues' formula to the fourth power of the angle: turns here are hundredths of a radian.
fn small_turn(w: &Vector3<f64>) -> Matrix3<f64> {
    let (k, square) = (hat(w), w.norm_squared());
    Matrix3::identity() + k * (1.0 - square / 6.0) + k * k * (0.5 - square / 24.0)
}

/// Keeps the best curves, one a place and direction, so that the beam does not fill with copies of one.
fn prune(all: Vec<Candidate>, beam: usize) -> Vec<Candidate> {
    let mut order: Vec<usize> = (0..all.len()).collect();
    order.sort_by(|&a, &b| all[b].score.total_cmp(&all[a].score));
    // Nothing recovers from being this much worse than the best.
    let floor = order.first().map_or(0.0, |&k| all[k].score) - 80.0 + 4.0 * HIDDEN;
    let mut seen: HashSet<[i64; 6]> = HashSet::new();
    let mut kept = Vec::with_capacity(beam);
    for c in order.into_iter().map(|k| &all[k]) {
        if kept.len() >= beam || c.score < floor {
            break;
        }
        let t = c.frame.column(0);
        let cell = |v: f64, size: f64| (v / size).round() as i64;
        let key = [
            cell(c.position.x, 0.06),
            cell(c.position.y, 0.06),
            cell(c.position.z, 0.06),
            cell(t.y, 0.01),
            cell(t.z, 0.01),
            cell(c.bend[0], 0.003) * 1000 + cell(c.bend[1], 0.003),
        ];
        if seen.insert(key) {
            kept.push(c.clone());
        }
    }
    kept
}
