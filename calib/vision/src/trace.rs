//! Finds the wire: a beam search in space that grows a curve of bounded bending from the root and scores it in both pictures.
//! Working in space rather than in each picture keeps it on the wire through crossings and where one picture hides it.

use crate::document::StereoCameras;
use crate::ridge::{Evidence, HIDDEN, RidgeMap};
use crate::rig::RigWhisker;
use nalgebra::{Isometry3, Matrix3, Point3, Rotation3, Vector2, Vector3};
use std::collections::HashMap;

/// Length of a step of the search, mm.
const STEP_MM: f64 = 1.0;
/// Places scored a step.
const PLACES: usize = 3;
/// Curves kept.
const BEAM: usize = 160;
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
    /// Cameras.
    pub stereo: &'a StereoCameras,
    /// Pose of the base.
    pub left_from_base: Isometry3<f64>,
    /// Maps of both pictures.
    pub maps: [&'a RidgeMap; 2],
    /// Scores of both pictures.
    pub evidence: [Evidence; 2],
}

impl Scene<'_> {
    /// Pixel and unit normal of the wire's image in one camera.
    fn image(
        &self,
        camera: usize,
        p: &Vector3<f64>,
        t: &Vector3<f64>,
    ) -> Option<(Vector2<f64>, Vector2<f64>)> {
        let mut x = self.left_from_base * Point3::from(*p);
        let mut d = self.left_from_base.rotation * t;
        if camera == 1 {
            x = self.stereo.right_from_left * x;
            d = self.stereo.right_from_left.rotation * d;
        }
        let c = &self.stereo.cameras[camera];
        let (a, b) = (c.project(&x.coords)?, c.project(&(x.coords + d * 0.1))?);
        let along = (b - a).try_normalize(1e-9)?;
        Some((a, Vector2::new(-along.y, along.x)))
    }

    fn response(&self, camera: usize, p: &Vector3<f64>, t: &Vector3<f64>) -> Option<f64> {
        let (px, normal) = self.image(camera, p, t)?;
        self.maps[camera].across(&px, &normal)
    }

    fn score(&self, p: &Vector3<f64>, t: &Vector3<f64>) -> f64 {
        (0..2).map(|c| self.evidence[c].score(self.response(c, p, t))).sum()
    }
}

/// Response that a wire shows near the root, per camera: the median over places of the strongest response across the expected line.
#[must_use]
pub fn expected_strength(
    stereo: &StereoCameras,
    left_from_base: &Isometry3<f64>,
    maps: [&RidgeMap; 2],
    whisker: &RigWhisker,
    polarity: f64,
) -> [f64; 2] {
    let scene = Scene {
        stereo,
        left_from_base: *left_from_base,
        maps,
        evidence: [0, 1].map(|_| Evidence::new(&[], 1.0, polarity)),
    };
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

/// Grows curves from the root and returns the best; none where no curve has any evidence.
#[must_use]
pub fn trace(scene: &Scene<'_>, whisker: &RigWhisker) -> Option<Trace> {
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
        now = if branch { prune(scene, next) } else { next };
    }
    history.push(now);
    let last = history.last()?;
    let (mut index, best) = last.iter().enumerate().max_by(|a, b| a.1.best.total_cmp(&b.1.best))?;
    if best.best_step == 0 {
        return None;
    }
    let (score, best_step) = (best.best, best.best_step);
    let mut curvatures = Vec::with_capacity(steps);
    let mut responses: [Vec<f64>; 2] = [Vec::new(), Vec::new()];
    for level in history.iter().rev() {
        let c = &level[index];
        curvatures.push(c.bend);
        for (k, list) in responses.iter_mut().enumerate() {
            let r = scene.response(k, &c.position, &c.frame.column(0).into_owned());
            if let Some(r) = r.filter(|&r| scene.evidence[k].score(Some(r)) > 0.0) {
                list.push(r.abs());
            }
        }
        index = c.parent;
    }
    curvatures.reverse();
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
    })
}

fn advance(scene: &Scene<'_>, whisker: &RigWhisker, c: &mut Candidate, step: usize) {
    let h = STEP_MM / PLACES as f64;
    for place in 0..PLACES {
        let s = step as f64 * STEP_MM + (place as f64 + 0.5) * h;
        let nominal = if s > whisker.straight_mm { whisker.arc_curvature_per_mm } else { 0.0 };
        let turn = Vector3::new(0.0, -(c.bend[1] - nominal), c.bend[0]) * (0.5 * h);
        let half = Rotation3::from_scaled_axis(turn);
        let middle = c.frame * half.matrix();
        let tangent = middle.column(0).into_owned();
        let score = scene.score(&(c.position + tangent * (0.5 * h)), &tangent);
        c.position += tangent * h;
        c.frame = middle * half.matrix();
        c.score += score;
    }
}

/// Keeps the best curves, one a place and direction, so that the beam does not fill with copies of one.
fn prune(scene: &Scene<'_>, mut all: Vec<Candidate>) -> Vec<Candidate> {
    all.sort_by(|a, b| b.score.total_cmp(&a.score));
    // Nothing recovers from being this much worse than the best.
    let floor = all.first().map_or(0.0, |c| c.score) - 80.0 + 4.0 * HIDDEN;
    let mut seen: HashMap<[i64; 6], usize> = HashMap::new();
    let mut kept = Vec::with_capacity(BEAM);
    for c in all {
        if kept.len() >= BEAM || c.score < floor {
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
        let count = seen.entry(key).or_insert(0);
        if *count < 1 {
            *count += 1;
            kept.push(c);
        }
    }
    let _ = scene;
    kept
}
