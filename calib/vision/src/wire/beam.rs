//! Finds the wire: a beam search in space that grows a curve of bounded bending from the root and
//! scores it in both pictures. Working in space rather than in each picture keeps it on the wire
//! through crossings and where one picture hides it.
//!
//! ```text
//! score(curve) = sum over places and cameras of log p(response | wire) / p(response | background)
//!              - sum over branchings of the changes (in steps of curvature) squared - sum over blocks |k - k_rest|^2 / (2 sd^2)
//! ```
//! that is, the log posterior of a hidden Markov chain of curvatures; of the curves that end in one
//! cell (place and direction in both pictures) the best is kept, and of all cells the best `beam`.
//! Source: Lowerre, "The HARPY Speech Recognition System", 1976 (beam search).

use crate::median::median;
use crate::rig::RigWhisker;
use crate::wire::ridge::HIDDEN;
use crate::wire::scene::Scene;
use nalgebra::{Matrix3, Vector3};
use std::collections::HashSet;

/// Length of a step of the search, mm.
const STEP_MM: f64 = 1.0;
/// Places scored a step.
const PLACES: usize = 3;
/// Curves kept.
pub(crate) const BEAM: usize = 160;
/// Curves kept in addition while they are hidden from the root on: they cost no evaluation, and no
/// evidence separates them yet.
const HIDDEN_BEAM: usize = 600;
/// Curves kept where the first search found too little.
pub(crate) const WIDE_BEAM: usize = 4 * BEAM;
/// Factor of the curves that a wide search keeps while the likeliest crosses a gap, and for how
/// many blocks after it: by then the evidence of both pictures has separated them.
const GAP_BEAM: usize = 4;
const GAP_AFTER: usize = 2;
/// Evidence that the likeliest curve gains a block, below which it is in a gap: a fifth of the gain
/// along a visible wire.
const GAP_GAIN: f64 = 15.0;
/// Share of the length beyond which no hidden curve is kept: one that follows the first wire
/// farther is no second wire.
const HIDDEN_SHARE: f64 = 0.4;
/// Spacing of the roots tried around the stated one, mm.
const ASIDE_STEP_MM: f64 = 0.25;
/// Steps from one branching to the next: up to there the branches lie within a tenth of a pixel of
/// one another, so that one evaluation serves them all.
const BRANCH_STEPS: usize = 3;
/// Change of curvature a branching, 1/mm: 0.002 a mm, as a force of 0.06 N bends a 0.3 mm NiTi
/// wire.
const CURVATURE_STEP: f64 = 0.006;
/// Log prior of one change.
const CHANGE_COST: f64 = 1.0;
/// Blocks between branchings that are not branched, from the root.
const UNBRANCHED: usize = 1;
/// Deviation from the nominal curvature that costs half a unit a block, 1/mm: where a wire runs
/// along the epipolar lines all curves in depth have the same image, and the one with the smallest
/// strain energy is the likeliest.
const BEND_SD: f64 = 0.01;
/// Cells of place (mm) and direction (rad) in both pictures of which one curve is kept: of those
/// that are seen, of those that cross a gap, and of those that lie hidden from the root on.
const SEEN_CELL: (f64, f64) = (0.06, 0.01);
const GAP_CELL: (f64, f64) = (0.2, 0.04);
const HIDDEN_CELL: (f64, f64) = (0.1, 0.02);

/// What the search found.
pub(crate) struct BeamResult {
    /// Curvature deviations from nominal, one a millimetre.
    pub curvatures: Vec<[f64; 2]>,
    /// Arc length of the last place with evidence, mm.
    pub length_mm: f64,
    /// Summed log likelihood ratio up to there.
    pub score: f64,
    /// Typical response along the wire, left and right.
    pub strength: [f64; 2],
    /// Where it starts: y and z of the root, mm.
    pub root_mm: [f64; 2],
    /// Places along it, base frame, one a step.
    pub path: Vec<Vector3<f64>>,
}

#[derive(Clone)]
struct BeamState {
    position: Vector3<f64>,
    frame: Matrix3<f64>,
    bend: [f64; 2],
    score: f64,
    best: f64,
    best_step: usize,
    parent: usize,
    /// All places so far are covered and have no evidence.
    hidden: bool,
}

impl BeamState {
    /// The same curve with its curvature changed at the last branching, by so little that the
    /// places evaluated since are the same.
    fn with_curvature_change(&self, parent: usize, by: [f64; 2]) -> Self {
        // A change k of the curvature moves the end of a length L by k L^2 / 2 and turns it by k L.
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

/// The curves that are started. The bending moment at the root is unknown: every curvature up to
/// 0.048 / mm is started; from roots up to `aside_mm` from the stated one only a few are.
fn starts(aside_mm: f64) -> Vec<BeamState> {
    let grid =
        |n: i32| (-n..=n).flat_map(move |a| (-n..=n).map(move |b| [f64::from(a), f64::from(b)]));
    let (bends, bend_step) = if aside_mm > 0.0 {
        (1, 3.0 * CURVATURE_STEP)
    } else {
        (8, CURVATURE_STEP)
    };
    grid((aside_mm / ASIDE_STEP_MM) as i32)
        .flat_map(|root| grid(bends).map(move |bend| (root, bend)))
        .enumerate()
        .map(|(parent, (root, bend))| BeamState {
            position: Vector3::new(0.0, root[0] * ASIDE_STEP_MM, root[1] * ASIDE_STEP_MM),
            frame: Matrix3::identity(),
            bend: bend.map(|b| b * bend_step),
            score: 0.0,
            best: 0.0,
            best_step: 0,
            parent,
            hidden: true,
        })
        .collect()
}

/// Grows curves from roots up to `aside_mm` from the stated one, keeping the best `beam` of them, and
/// returns the best; none where no curve has any evidence. `any_bend`: any curvature is allowed, as a
/// second wire need not be near this one's rest shape.
pub(crate) fn beam_search(
    scene: &Scene<'_>,
    whisker: &RigWhisker,
    beam: usize,
    aside_mm: f64,
    any_bend: bool,
) -> Option<BeamResult> {
    let blocks = (1.12 * whisker.length_mm / STEP_MM) as usize / BRANCH_STEPS;
    // Parent and curvature of every curve kept at the end of every block.
    let mut history: Vec<Vec<(usize, [f64; 2])>> = Vec::with_capacity(blocks);
    let started = starts(aside_mm);
    let mut now = started.clone();
    let (mut leading, mut since_gap) = (0.0, usize::MAX / 2);
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
            if !any_bend {
                let strain = 0.5 * (c.bend[0].powi(2) + c.bend[1].powi(2)) / BEND_SD.powi(2);
                c.score -= strain;
                // The best place lies in this block: the block's prior counts for it as well.
                if c.best_step > first {
                    c.best -= strain;
                }
            }
        }
        // The starting curves cover all curvatures at first: branching begins where they diverge.
        if block >= UNBRANCHED {
            let leader = now.iter().max_by(|a, b| a.score.total_cmp(&b.score));
            let (score, hidden) = leader.map_or((0.0, true), |c| (c.score, c.hidden));
            since_gap = if !hidden && score - leading < GAP_GAIN {
                0
            } else {
                since_gap + 1
            };
            leading = score;
            // No evidence separates curves in a gap: more of them, with a wider spacing, cross it.
            let seen = if beam >= WIDE_BEAM && since_gap <= GAP_AFTER {
                (GAP_BEAM * beam, GAP_CELL)
            } else {
                (beam, SEEN_CELL)
            };
            let keep_hidden = (first as f64) * STEP_MM < HIDDEN_SHARE * whisker.length_mm;
            let hidden = if keep_hidden { HIDDEN_BEAM } else { 0 };
            now = branched(scene, &now, first, seen, hidden);
        }
        history.push(now.iter().map(|c| (c.parent, c.bend)).collect());
    }
    let (mut index, best) = now
        .iter()
        .enumerate()
        .max_by(|a, b| a.1.best.total_cmp(&b.1.best))?;
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
    // Beyond the end the curvature is constant.
    let end = curvatures[best_step - 1];
    curvatures[best_step..].fill(end);
    let start = &started[index];
    let (path, strength) = traced(scene, whisker, start, &curvatures[..best_step]);
    let root_mm = [start.position.y, start.position.z];
    Some(BeamResult {
        curvatures,
        length_mm: best_step as f64 * STEP_MM,
        score,
        strength,
        root_mm,
        path,
    })
}

/// Places one a step along a curve, and the typical response of those that show a wire, left and
/// right.
fn traced(
    scene: &Scene<'_>,
    whisker: &RigWhisker,
    start: &BeamState,
    curvatures: &[[f64; 2]],
) -> (Vec<Vector3<f64>>, [f64; 2]) {
    let mut c = start.clone();
    let mut path = vec![c.position];
    let mut responses: [Vec<f64>; 2] = [Vec::new(), Vec::new()];
    for (step, bend) in curvatures.iter().enumerate() {
        c.bend = *bend;
        advance(whisker, &mut c, step, &mut |_, _, _| {});
        path.push(c.position);
        for (k, list) in responses.iter_mut().enumerate() {
            list.extend(scene.wire_response(k, &c.position, &c.frame.column(0).into_owned()));
        }
    }
    (path, responses.map(median))
}

/// Extends a curve by a step; `visit` is called with every place scored and the tangent there.
fn advance(
    whisker: &RigWhisker,
    c: &mut BeamState,
    step: usize,
    visit: &mut impl FnMut(&mut BeamState, &Vector3<f64>, &Vector3<f64>),
) {
    let h = STEP_MM / PLACES as f64;
    for place in 0..PLACES {
        let s = step as f64 * STEP_MM + (place as f64 + 0.5) * h;
        let nominal = if s > whisker.straight_mm {
            whisker.arc_curvature_per_mm
        } else {
            0.0
        };
        // u = (0, -k2, k1) in the wire's frame; the rest shape bends toward -z.
        let half = small_turn(&(Vector3::new(0.0, -(c.bend[1] - nominal), c.bend[0]) * (0.5 * h)));
        let middle = c.frame * half;
        let tangent = middle.column(0).into_owned();
        let centre = c.position + tangent * (0.5 * h);
        visit(c, &centre, &tangent);
        c.position += tangent * h;
        c.frame = middle * half;
    }
}

/// Rodrigues' formula to the fourth power of the angle: turns here are hundredths of a radian.
fn small_turn(w: &Vector3<f64>) -> Matrix3<f64> {
    let (k, square) = (w.cross_matrix(), w.norm_squared());
    Matrix3::identity() + k * (1.0 - square / 6.0) + k * k * (0.5 - square / 24.0)
}

/// A branch of a curve: score, curve, changes of both curvatures in steps.
type Branch = (f64, usize, i32, i32);

/// The best branches of all curves, one a place and direction, so that the beam does not fill with
/// copies of one. `first`: the step at which the block began; `beam`, `cell`: curves kept of those
/// that are seen and the cells of one; `hidden_beam`: curves kept besides that lie hidden.
fn branched(
    scene: &Scene<'_>,
    now: &[BeamState],
    first: usize,
    (beam, cell): (usize, (f64, f64)),
    hidden_beam: usize,
) -> Vec<BeamState> {
    let changes = (-1..=1).flat_map(|a| (-1..=1).map(move |b| (a, b)));
    let all = now.iter().enumerate().flat_map(|(k, c)| {
        changes
            .clone()
            .map(move |(a, b)| (c.score - CHANGE_COST * f64::from(a * a + b * b), k, a, b))
    });
    let (mut hidden, mut order): (Vec<Branch>, Vec<Branch>) = all.partition(|b| now[b.1].hidden);
    let best_first = |x: &Branch, y: &Branch| {
        y.0.total_cmp(&x.0)
            .then((x.1, x.2, x.3).cmp(&(y.1, y.2, y.3)))
    };
    // Far fewer are kept than there are: the rest need no order.
    let enough = 6 * beam;
    if order.len() > enough {
        order.select_nth_unstable_by(enough, best_first);
        order.truncate(enough);
    }
    order.sort_unstable_by(best_first);
    // Nothing recovers from being this much worse than the best.
    let floor = order.first().map_or(0.0, |o| o.0) - 80.0 + 4.0 * HIDDEN;
    let mut cells: HashSet<[i32; 6]> = HashSet::new();
    let mut kept = Vec::with_capacity(beam + hidden_beam);
    for branch in order {
        if kept.len() >= beam || branch.0 < floor {
            break;
        }
        let child = extended(now, branch, first);
        if cells.insert(cell_of(scene, &child, cell)) {
            kept.push(child);
        }
    }
    if hidden_beam == 0 {
        return kept;
    }
    cells.clear();
    hidden.sort_unstable_by(best_first);
    let children = hidden.into_iter().map(|b| extended(now, b, first));
    let hidden: Vec<_> = children
        .filter(|c| cells.insert(cell_of(scene, c, HIDDEN_CELL)))
        .collect();
    // Every n-th of the hidden curves: the first ones would all bend to one side.
    let every = hidden.len().div_ceil(hidden_beam).max(1);
    kept.extend(hidden.into_iter().step_by(every));
    kept
}

fn extended(now: &[BeamState], (score, k, a, b): Branch, first: usize) -> BeamState {
    let mut child = now[k].with_curvature_change(
        k,
        [f64::from(a) * CURVATURE_STEP, f64::from(b) * CURVATURE_STEP],
    );
    if child.best_step > first {
        child.best += score - child.score;
    }
    child.score = score;
    child
}

/// Cell of a curve's end in both pictures, place (mm) and direction (rad) in steps of these sizes:
/// curves with the same images need to be kept once, and depth is resolved as coarsely as the
/// pictures resolve it.
fn cell_of(scene: &Scene<'_>, c: &BeamState, (place, turn): (f64, f64)) -> [i32; 6] {
    let mut cell = [0; 6];
    let step = |v: f64, size: f64| (v / size).round() as i32;
    for (camera, three) in cell.chunks_exact_mut(3).enumerate() {
        if let Some((at_mm, angle)) =
            scene.seen_from(camera, &c.position, &c.frame.column(0).into_owned())
        {
            three.copy_from_slice(&[
                step(at_mm.x, place),
                step(at_mm.y, place),
                step(angle, turn),
            ]);
        }
    }
    cell
}
