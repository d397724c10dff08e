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
/// Curves kept besides as long as they lie hidden from the root on: they cost no look, and nothing tells them apart yet.
const HIDDEN_BEAM: usize = 1000;
/// Side of the cells in which a found wire is covered up, px.
const COVER_PX: f64 = 4.0;
/// Steps from one branching to the next: before that the branches lie within a tenth of a pixel of one another, so that one look
/// serves them all.
const BRANCH_STEPS: usize = 3;
/// Change of curvature a branching, 1/mm: 0.002 a mm, as a force of 0.06 N bends a 0.3 mm NiTi wire.
const CURVATURE_STEP: f64 = 0.006;
/// Log likelihood that a change costs.
const CHANGE_COST: f64 = 1.0;
/// Blocks between branchings that are not branched, from the root.
const UNBRANCHED: usize = 1;
/// Cells of place (mm) and direction (rad) of which one curve is kept, of those that are seen and of those that lie hidden.
const SEEN_CELL: (f64, f64) = (0.06, 0.01);
const HIDDEN_CELL: (f64, f64) = (0.15, 0.03);

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
    /// No place has shown anything so far: all of them lay covered up.
    hidden: bool,
}

impl Candidate {
    /// The same curve, had its curvature changed by this at the last branching: so little that the places looked at were the same.
    fn bent(&self, parent: usize, by: [f64; 2]) -> Self {
        let long = BRANCH_STEPS as f64 * STEP_MM;
        let aside = Vector3::new(0.0, by[0], by[1]) * (0.5 * long * long);
        let turn = small_turn(&(Vector3::new(0.0, -by[1], by[0]) * long));
        Self {
            position: self.position + self.frame * aside,
            frame: self.frame * turn,
            bend: [self.bend[0] + by[0], self.bend[1] + by[1]],
            parent,
            ..self.clone()
        }
    }
}

/// The pictures' evidence for one polarity.
pub struct Scene<'a> {
    stereo: &'a StereoCameras,
    /// Rotation and translation from the base to each camera.
    camera_from_base: [(Matrix3<f64>, Vector3<f64>); 2],
    maps: &'a [RidgeMap<'a>; 2],
    evidence: [Evidence; 2],
    /// Cells of each picture, row by row, that are covered up; empty where none is.
    covered: [Vec<bool>; 2],
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
        let reach = (distance_px / COVER_PX).ceil() as i64;
        for camera in 0..2 {
            let [columns, rows] = self.cells(camera);
            let mut covered = vec![false; columns * rows];
            for w in path.windows(2) {
                let (Some((a, _)), Some((b, _))) =
                    (self.image(camera, &w[0], &Vector3::x()), self.image(camera, &w[1], &Vector3::x()))
                else {
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
        self.stereo.cameras[camera].image_size_px.map(|n| (n as f64 / COVER_PX).ceil() as usize)
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

    /// Score of a place of the wire and whether either picture shows it.
    fn score(&self, p: &Vector3<f64>, t: &Vector3<f64>) -> (f64, bool) {
        let mut seen = false;
        let mut sum = 0.0;
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
    [(px.x / COVER_PX).floor() as i64, (px.y / COVER_PX).floor() as i64]
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
    let end = whisker.straight_mm.min(0.3 * whisker.length_mm).clamp(4.0, 8.0);
    let px_per_mm = stereo.cameras[0].focal_px[0] / left_from_base.translation.z;
    [0, 1].map(|camera| {
        let mut strongest: Vec<f64> = (0..40)
            .filter_map(|k| {
                let s = 1.5 + (end - 1.5) * f64::from(k) / 39.0;
                let (px, normal) = scene.image(camera, &Vector3::new(s, 0.0, 0.0), &Vector3::x())?;
                // As far aside as half of the greatest curvature that is started takes it.
                let reach = 3.0 + 0.012 * s * s * px_per_mm;
                let count = (2.0 * reach) as i64;
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
    let blocks = (1.12 * whisker.length_mm / STEP_MM) as usize / BRANCH_STEPS;
    // Parent and curvature of every curve kept at the end of every block.
    let mut history: Vec<Vec<(usize, [f64; 2])>> = Vec::with_capacity(blocks);
    // The bending moment at the root is unknown: every curvature up to 0.048 / mm is started.
    let mut now: Vec<Candidate> = (-8..=8)
        .flat_map(|a| (-8..=8).map(move |b| [f64::from(a) * CURVATURE_STEP, f64::from(b) * CURVATURE_STEP]))
        .enumerate()
        .map(|(parent, bend)| Candidate {
            position: Vector3::zeros(),
            frame: Matrix3::identity(),
            bend,
            score: 0.0,
            best: 0.0,
            best_step: 0,
            parent,
            hidden: true,
        })
        .collect();
    for block in 0..blocks {
        let first = block * BRANCH_STEPS;
        for c in &mut now {
            for step in first..first + BRANCH_STEPS {
                advance(whisker, c, step, &mut |c, p, t| {
                    let (score, seen) = scene.score(p, t);
                    c.score += score;
                    c.hidden &= !seen;
                });
                if c.score > c.best {
                    (c.best, c.best_step) = (c.score, step + 1);
                }
            }
        }
        // While the started curves still lie side by side there is nothing to branch.
        if block >= UNBRANCHED {
            now = branched(&now, beam, first);
        }
        history.push(now.iter().map(|c| (c.parent, c.bend)).collect());
    }
    let (mut index, best) = now.iter().enumerate().max_by(|a, b| a.1.best.total_cmp(&b.1.best))?;
    if best.best_step == 0 {
        return None;
    }
    let (score, best_step) = (best.best, best.best_step);
    let mut curvatures = Vec::with_capacity(blocks * BRANCH_STEPS);
    for level in history.iter().rev() {
        let (parent, bend) = level[index];
        curvatures.extend([bend; BRANCH_STEPS]);
        index = parent;
    }
    curvatures.reverse();
    // Beyond the end the curve goes on as it was.
    let end = curvatures[best_step - 1];
    curvatures[best_step..].fill(end);
    let (path, strength) = walked(scene, whisker, &curvatures[..best_step]);
    Some(Trace { curvatures, length_mm: best_step as f64 * STEP_MM, score, strength, path })
}

/// Places one a step along a curve, and the typical response of those that show a wire, left and right.
fn walked(scene: &Scene<'_>, whisker: &RigWhisker, curvatures: &[[f64; 2]]) -> (Vec<Vector3<f64>>, [f64; 2]) {
    let mut c = Candidate {
        position: Vector3::zeros(),
        frame: Matrix3::identity(),
        bend: [0.0; 2],
        score: 0.0,
        best: 0.0,
        best_step: 0,
        parent: 0,
        hidden: true,
    };
    let mut path = vec![c.position];
    let mut responses: [Vec<f64>; 2] = [Vec::new(), Vec::new()];
    for (step, bend) in curvatures.iter().enumerate() {
        c.bend = *bend;
        advance(whisker, &mut c, step, &mut |_, _, _| {});
        path.push(c.position);
        for (k, list) in responses.iter_mut().enumerate() {
            let r = scene.response(k, &c.position, &c.frame.column(0).into_owned());
            if let Some(r) = r.filter(|&r| scene.evidence[k].score(Some(r)) > 0.0) {
                list.push(r.abs());
            }
        }
    }
    (path, responses.map(|r| crate::initial::median(&r)))
}

/// Moves a curve on by a step; `look` is told every place scored and the tangent there.
fn advance(
    whisker: &RigWhisker,
    c: &mut Candidate,
    step: usize,
    look: &mut impl FnMut(&mut Candidate, &Vector3<f64>, &Vector3<f64>),
) {
    let h = STEP_MM / PLACES as f64;
    for place in 0..PLACES {
        let s = step as f64 * STEP_MM + (place as f64 + 0.5) * h;
        let nominal = if s > whisker.straight_mm { whisker.arc_curvature_per_mm } else { 0.0 };
        let half = small_turn(&(Vector3::new(0.0, -(c.bend[1] - nominal), c.bend[0]) * (0.5 * h)));
        let middle = c.frame * half;
        let tangent = middle.column(0).into_owned();
        let centre = c.position + tangent * (0.5 * h);
        look(c, &centre, &tangent);
        c.position += tangent * h;
        c.frame = middle * half;
    }
}

/// Rodrigues' formula to the fourth power of the angle: turns here are hundredths of a radian.
fn small_turn(w: &Vector3<f64>) -> Matrix3<f64> {
    let (k, square) = (hat(w), w.norm_squared());
    Matrix3::identity() + k * (1.0 - square / 6.0) + k * k * (0.5 - square / 24.0)
}

/// A branch of a curve: score, curve, changes of both curvatures in steps.
type Branch = (f64, usize, i32, i32);

/// The best branches of all curves, one a place and direction, so that the beam does not fill with copies of one. `first`: the step
/// at which the block began.
fn branched(now: &[Candidate], beam: usize, first: usize) -> Vec<Candidate> {
    let changes = (-1..=1).flat_map(|a| (-1..=1).map(move |b| (a, b)));
    let all = now.iter().enumerate().flat_map(|(k, c)| {
        changes.clone().map(move |(a, b)| (c.score - CHANGE_COST * f64::from(a * a + b * b), k, a, b))
    });
    let (mut hidden, mut order): (Vec<Branch>, Vec<Branch>) = all.partition(|b| now[b.1].hidden);
    let best_first = |x: &Branch, y: &Branch| y.0.total_cmp(&x.0).then((x.1, x.2, x.3).cmp(&(y.1, y.2, y.3)));
    // Far fewer are kept than there are: the rest need no order.
    let enough = 6 * beam;
    if order.len() > enough {
        order.select_nth_unstable_by(enough, best_first);
        order.truncate(enough);
    }
    order.sort_unstable_by(best_first);
    // Nothing recovers from being this much worse than the best.
    let floor = order.first().map_or(0.0, |o| o.0) - 80.0 + 4.0 * HIDDEN;
    let mut cells: HashSet<[i32; 7]> = HashSet::new();
    let mut kept = Vec::with_capacity(beam + HIDDEN_BEAM);
    for branch in order {
        if kept.len() >= beam || branch.0 < floor {
            break;
        }
        let child = grown(now, branch, first);
        if cells.insert(cell_of(&child, SEEN_CELL, CURVATURE_STEP)) {
            kept.push(child);
        }
    }
    cells.clear();
    hidden.sort_unstable_by(best_first);
    let children = hidden.into_iter().map(|b| grown(now, b, first));
    let hidden: Vec<_> =
        children.filter(|c| cells.insert(cell_of(c, HIDDEN_CELL, 2.0 * CURVATURE_STEP))).collect();
    // Spread evenly over what lies hidden: the first of them would all bend to one side.
    let every = hidden.len().div_ceil(HIDDEN_BEAM).max(1);
    kept.extend(hidden.into_iter().step_by(every));
    kept
}

fn grown(now: &[Candidate], (score, k, a, b): Branch, first: usize) -> Candidate {
    let mut child = now[k].bent(k, [f64::from(a) * CURVATURE_STEP, f64::from(b) * CURVATURE_STEP]);
    if child.best_step > first {
        child.best += score - child.score;
    }
    child.score = score;
    child
}

/// Cell of a curve's end: place (mm), direction (rad) and curvature (1/mm) in steps of these sizes.
fn cell_of(c: &Candidate, (place, turn): (f64, f64), bend: f64) -> [i32; 7] {
    let cell = |v: f64, size: f64| (v / size).round() as i32;
    let (p, t) = (&c.position, c.frame.column(0));
    [
        cell(p.x, place),
        cell(p.y, place),
        cell(p.z, place),
        cell(t.y, turn),
        cell(t.z, turn),
        cell(c.bend[0], bend),
        cell(c.bend[1], bend),
    ]
}
