//! The groove's way between two readings, from their positions and speeds: the stage moves at the
//! speed of one of them and then, or before, at that of the other.
//!
//! ```text
//! x1 - x0 = v0 a + v1 (dt - a),   0 <= a <= dt        (ramps of the stage are far shorter than the time between readings)
//! ```

use super::path::{Node, WhiskerPath};

/// A part of the way at one speed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct MotionSegment {
    /// Position at its begin, mm.
    pub from_mm: f64,
    /// Position at its end, mm.
    pub to_mm: f64,
    /// Duration, s.
    pub dt_s: f64,
}

impl MotionSegment {
    fn new(from_mm: f64, to_mm: f64, dt_s: f64) -> Self {
        Self {
            from_mm,
            to_mm,
            dt_s,
        }
    }
}

/// A way that is longer or shorter by this share than the speeds allow is another one.
const FITS: f64 = 0.1;

/// The way from node `k` to the next at positions `xs_mm`; none where the recorded positions and
/// speeds do not say it.
pub(super) fn motion_between(
    path: &WhiskerPath,
    xs_mm: &[f64],
    k: usize,
) -> Option<Vec<MotionSegment>> {
    let (a, b) = (&path.nodes[k], &path.nodes[k + 1]);
    if !path.columns.time || a.line.is_none() || a.line != b.line {
        return None;
    }
    let (dt_s, way_mm) = (b.t_s - a.t_s, b.x_mm - a.x_mm);
    let (from_mm, to_mm) = (xs_mm[k], xs_mm[k + 1]);
    let straight = |dt_s: f64| vec![MotionSegment::new(from_mm, to_mm, dt_s)];
    if dt_s <= 0.0 {
        return (way_mm == 0.0).then(|| straight(0.0));
    }
    let (v0, v1) = (speed(path, k), speed(path, k + 1));
    if !a.moving && !b.moving {
        // A settled reading without a dwell has stood for a while; an arrival ends its move.
        let settled = b.reading.is_some() && way_mm != 0.0;
        let move_s = if settled { 0.5 * dt_s } else { dt_s };
        let held = MotionSegment::new(to_mm, to_mm, dt_s - move_s);
        return Some(vec![MotionSegment::new(from_mm, to_mm, move_s), held]);
    }
    // Speeds that are nearly alike have no corner between them.
    let change = v1 - v0;
    let at_mean = (way_mm - 0.5 * (v0 + v1) * dt_s).abs() <= FITS * (v0.abs() + v1.abs()) * dt_s;
    if change.abs() * dt_s < FITS * way_mm.abs()
        || (a.moving && b.moving && v0 * v1 > 0.0 && at_mean)
    {
        return at_mean.then(|| straight(dt_s));
    }
    // x1 - x0 = v0 a + v1 (dt - a), solved for a.
    let first_s = (v1 * dt_s - way_mm) / change;
    if !(-FITS * dt_s..=(1.0 + FITS) * dt_s).contains(&first_s) {
        return motion_with_reversal(path, xs_mm, k);
    }
    let first_s = first_s.clamp(0.0, dt_s);
    // An effect that moves the nodes moves the corner with them.
    let share = if way_mm == 0.0 {
        first_s / dt_s
    } else {
        (v0 * first_s / way_mm).clamp(0.0, 1.0)
    };
    let corner_mm = from_mm + (to_mm - from_mm) * share;
    Some(vec![
        MotionSegment::new(from_mm, corner_mm, first_s),
        MotionSegment::new(corner_mm, to_mm, dt_s - first_s),
    ])
}

/// From a settled pose to a stroke that begins on its other side: the stage went there at the
/// stroke's speed and stood until it began.
fn motion_with_reversal(path: &WhiskerPath, xs_mm: &[f64], k: usize) -> Option<Vec<MotionSegment>> {
    let (a, b) = (&path.nodes[k], &path.nodes[k + 1]);
    if a.moving || !b.moving {
        return None;
    }
    // The first reading of a stroke may be on its ramp: the next one has its speed.
    let next = path
        .nodes
        .get(k + 2)
        .filter(|n| n.line == b.line && velocity(path, n) * velocity(path, b) > 0.0)
        .map_or(0.0, |n| velocity(path, n));
    let (from_mm, to_mm, dt_s) = (xs_mm[k], xs_mm[k + 1], b.t_s - a.t_s);
    let move_s = (b.x_mm - a.x_mm).abs() / velocity(path, b).abs().max(next.abs());
    let stood = MotionSegment::new(to_mm, to_mm, dt_s - move_s);
    (stood.dt_s >= 0.0).then(|| vec![MotionSegment::new(from_mm, to_mm, move_s), stood])
}

/// Signed speed of the reading at a node, mm/s.
pub(crate) fn velocity(path: &WhiskerPath, node: &Node) -> f64 {
    node.reading.map_or(0.0, |i| path.readings[i].velocity_mm_s)
}

/// Signed speed at node `k`, mm/s: that of the way to a neighbour in the same motion, whose
/// positions are read better than speeds are.
fn speed(path: &WhiskerPath, k: usize) -> f64 {
    let node = &path.nodes[k];
    let v = velocity(path, node);
    if v == 0.0 {
        return 0.0;
    }
    let neighbours = [k.checked_sub(1), Some(k + 1)]
        .into_iter()
        .flatten()
        .filter_map(|j| path.nodes.get(j));
    let slopes = neighbours
        .filter(|n| n.line == node.line && velocity(path, n) * v > 0.0 && n.t_s != node.t_s)
        .map(|n| (n.x_mm - node.x_mm) / (n.t_s - node.t_s));
    // A reading on a ramp has its own speed: the neighbour's is another.
    slopes
        .filter(|s| (s / v - 1.0).abs() < 2.0 * FITS)
        .min_by(|a, b| (a - v).abs().total_cmp(&(b - v).abs()))
        .unwrap_or(v)
}
