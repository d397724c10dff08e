//! Base moment along one trajectory, tabulated in stage position and in the drag (tangential over
//! normal force).
//!
//! Chebyshev series in the stage position, Lagrange interpolation over the drags. Where the contact
//! crosses from the straight part to the arc the moment has a kink, so the table is cut there (a
//! different cut for every drag).

use nalgebra::{Matrix4, Vector3};

use crate::WireError;
use crate::rod::{Equilibrium, Wire};

type V3 = Vector3<f64>;

/// Values held per node: moment about y and z in N mm, contact arc length in mm.
type Node = [f64; 3];

/// Groove path in the base frame: centre = origin + stage * direction.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Path {
    /// Where the stage's zero lies, mm.
    pub origin_mm: V3,
    /// Unit vector.
    pub direction: V3,
    /// Arc length of the wire at the origin, mm.
    pub arclength_mm: f64,
    /// Shift of the groove that the session does not declare, mm.
    pub offset_mm: V3,
}

impl Path {
    /// The groove's centre at a stage position, mm.
    pub fn at(&self, stage_mm: f64) -> V3 {
        self.origin_mm + self.offset_mm + self.direction * stage_mm
    }
}

/// The table of one trajectory.
#[derive(Debug, Clone)]
pub struct Table {
    touch_mm: f64,
    drags: Vec<f64>,
    /// Chebyshev coefficients, `[drag][piece]`.
    pieces: Vec<Vec<Vec<Node>>>,
    /// Ends of the pieces, `[drag][0..=pieces]`.
    ends: Vec<Vec<f64>>,
}

/// Follows the equilibrium along the path, from any start, remembering the last solution.
struct Follower<'a> {
    wire: &'a Wire,
    path: &'a Path,
    drag: f64,
    last: Equilibrium,
    before: Option<(f64, Equilibrium)>,
    slope: Option<Matrix4<f64>>,
    stage_mm: f64,
    step_mm: f64,
}

/// Frictionless equilibrium with the groove at `stage_mm` of a path that reaches to `stage_max_mm`.
///
/// # Errors
/// [`WireError::NoEquilibrium`] when the rod does not settle on the way there.
pub fn equilibrium(
    wire: &Wire,
    path: &Path,
    stage_max_mm: f64,
    stage_mm: f64,
) -> Result<Equilibrium, WireError> {
    dragged_equilibrium(wire, path, 0.0, stage_max_mm, stage_mm)
}

/// The same with `drag`, the tangential part of the contact force over the normal one.
///
/// # Errors
/// As [`equilibrium`].
pub fn dragged_equilibrium(
    wire: &Wire,
    path: &Path,
    drag: f64,
    stage_max_mm: f64,
    stage_mm: f64,
) -> Result<Equilibrium, WireError> {
    Follower::start(wire, path, drag, stage_max_mm)?.to(stage_mm)
}

impl<'a> Follower<'a> {
    /// A little after first touch.
    fn start(
        wire: &'a Wire,
        path: &'a Path,
        drag: f64,
        stage_max_mm: f64,
    ) -> Result<Self, WireError> {
        let stage_mm = 0.08 * stage_max_mm;
        // Well past touch: at touch itself the force vanishes and its direction with it.
        let push = path.offset_mm + path.direction * stage_mm;
        let mut last = wire.touch(path.arclength_mm, &push);
        // The drag is brought in gently: force and arc length change with it.
        let count = (drag.abs() / 0.08).ceil() as usize;
        let mut slope = None;
        last = wire.solve(&path.at(stage_mm), 0.0, &last, &mut slope)?;
        for i in 1..=count {
            last = wire.solve(
                &path.at(stage_mm),
                drag * i as f64 / count as f64,
                &last,
                &mut slope,
            )?;
        }
        let step_mm = 0.12 * stage_max_mm;
        Ok(Self {
            wire,
            path,
            drag,
            last,
            before: None,
            slope,
            stage_mm,
            step_mm,
        })
    }

    fn to(&mut self, stage_mm: f64) -> Result<Equilibrium, WireError> {
        let mut halvings = 0;
        while self.stage_mm != stage_mm {
            let step = self.step_mm * 0.5f64.powi(halvings);
            let next = self.stage_mm + (stage_mm - self.stage_mm).clamp(-step, step);
            let guess = self.guess(next);
            match self
                .wire
                .solve(&self.path.at(next), self.drag, &guess, &mut self.slope)
            {
                Ok(found) => {
                    self.before = Some((self.stage_mm, self.last));
                    (self.last, self.stage_mm) = (found, next);
                }
                // A stale Jacobian is the first suspect, a long step the second.
                Err(_) if self.slope.take().is_some() => {}
                Err(_) if halvings < 6 => halvings += 1,
                Err(error) => return Err(error),
            }
        }
        Ok(self.last)
    }

    /// Straight on from the last two solutions.
    fn guess(&self, stage_mm: f64) -> Equilibrium {
        let mut guess = self.last;
        match self.before {
            Some((x, e)) if (self.stage_mm - x).abs() > 1e-6 => {
                // Force and arc length are smooth in the stage: a secant is a good start.
                let share = ((stage_mm - self.stage_mm) / (self.stage_mm - x)).clamp(-2.0, 2.0);
                guess.force_n += (self.last.force_n - e.force_n) * share;
                guess.arclength_mm += (self.last.arclength_mm - e.arclength_mm) * share;
            }
            _ if self.path.offset_mm == V3::zeros() && self.stage_mm > 0.0 => {
                guess.force_n *= stage_mm / self.stage_mm;
            }
            _ => {}
        }
        guess
    }
}

impl Table {
    /// Tabulates from first touch to `stage_max_mm`, with `nodes` Chebyshev points a piece.
    ///
    /// # Errors
    /// [`WireError::NoEquilibrium`] when the rod does not settle somewhere on the path.
    pub fn build(
        wire: &Wire,
        path: &Path,
        stage_max_mm: f64,
        drags: &[f64],
        nodes: usize,
    ) -> Result<Self, WireError> {
        let start = |drag: f64| Follower::start(wire, path, drag, stage_max_mm);
        let touch_mm = if path.offset_mm == V3::zeros() {
            0.0
        } else {
            touch(start(0.0)?, path)?
        };
        let reach = stage_max_mm - touch_mm;
        // Where the contact passes the end of the straight part, for every drag.
        let mut cuts = Vec::new();
        for &drag in drags {
            cuts.push(crossing(
                start(drag)?,
                wire.straight_mm,
                touch_mm,
                touch_mm + 1.4 * reach,
            )?);
        }
        let found: Vec<f64> = cuts.iter().flatten().copied().collect();
        let split = found.len() == drags.len() && found.iter().any(|&c| c < stage_max_mm);
        let first_cut = found.iter().copied().fold(f64::INFINITY, f64::min);
        let (mut pieces, mut ends) = (Vec::new(), Vec::new());
        for (&drag, cut) in drags.iter().zip(&cuts) {
            let end = match cut {
                Some(cut) if split => {
                    vec![touch_mm, *cut, cut + (stage_max_mm - first_cut).max(0.05)]
                }
                _ => vec![touch_mm, stage_max_mm],
            };
            let mut series = Vec::new();
            for w in end.windows(2) {
                let mut follower = start(drag)?;
                series.push(chebyshev(w[0], w[1], nodes, |x| {
                    let e = follower.to(x)?;
                    Ok([e.moment_nmm.y, e.moment_nmm.z, e.arclength_mm])
                })?);
            }
            pieces.push(series);
            ends.push(end);
        }
        Ok(Self {
            touch_mm,
            drags: drags.to_vec(),
            pieces,
            ends,
        })
    }

    /// Stage position of first touch in mm.
    pub fn touch_mm(&self) -> f64 {
        self.touch_mm
    }

    /// Moment about base y and z (N mm) and contact arc length (mm); zero moment before touch.
    pub fn at(&self, stage_mm: f64, drag: f64) -> Node {
        let stage = stage_mm.max(self.touch_mm);
        let weights = lagrange(&self.drags, drag);
        // Pieces end elsewhere for every drag: their ends are interpolated like the values.
        let ends: Vec<f64> = (0..self.ends[0].len())
            .map(|k| self.ends.iter().zip(&weights).map(|(e, w)| e[k] * w).sum())
            .collect();
        let piece = (1..ends.len() - 1).filter(|&k| stage > ends[k]).count();
        let (low, high) = (ends[piece], ends[piece + 1]);
        // A little past its end the series still holds; farther on it would run away.
        let xi = (2.0 * (stage - low) / (high - low) - 1.0).min(1.02);
        let mut out = [0.0; 3];
        for (series, w) in self.pieces.iter().zip(&weights) {
            for (o, v) in out.iter_mut().zip(clenshaw(&series[piece], xi)) {
                *o += w * v;
            }
        }
        if stage_mm <= self.touch_mm {
            out[0] = 0.0;
            out[1] = 0.0;
        }
        out
    }
}

/// Stage position where the groove begins to push (force along the direction vanishes).
fn touch(mut follower: Follower<'_>, path: &Path) -> Result<f64, WireError> {
    follower.step_mm *= 0.3;
    let push = |e: &Equilibrium| e.force_n.dot(&path.direction);
    let (mut low, mut high) = (follower.stage_mm, follower.stage_mm);
    let here = push(&follower.last);
    let step = 0.05 * if here > 0.0 { -1.0 } else { 1.0 };
    let mut value = here;
    let mut count = 0;
    while value * here > 0.0 && count < 200 {
        let next = follower.stage_mm + step;
        value = push(&follower.to(next)?);
        if here > 0.0 {
            (high, low) = (low, next)
        } else {
            (low, high) = (high, next)
        }
        count += 1;
    }
    if low > high {
        std::mem::swap(&mut low, &mut high);
    }
    // Bisection: the push has one sign on either side of touch.
    for _ in 0..40 {
        let mid = 0.5 * (low + high);
        if push(&follower.to(mid)?) > 0.0 {
            high = mid
        } else {
            low = mid
        }
    }
    Ok(0.5 * (low + high))
}

/// Stage position in `(from, to)` where the contact's arc length equals `target_mm`.
fn crossing(
    mut follower: Follower<'_>,
    target_mm: f64,
    from: f64,
    to: f64,
) -> Result<Option<f64>, WireError> {
    let first = follower.path.arclength_mm - target_mm;
    // The contact slides by a few millimetres at most.
    if first.abs() > 6.0 {
        return Ok(None);
    }
    let count = 12;
    let mut before = (from, first);
    for i in 1..=count {
        let x = from + (to - from) * i as f64 / count as f64;
        // Beyond the declared reach the branch may end; that is no fault of the table.
        let Ok(e) = follower.to(x) else {
            return Ok(None);
        };
        let gap = e.arclength_mm - target_mm;
        if gap * before.1 < 0.0 {
            let (mut low, mut high) = (before, (x, gap));
            for _ in 0..60 {
                let secant = low.0 - low.1 * (high.0 - low.0) / (high.1 - low.1);
                let gap = follower.to(secant)?.arclength_mm - target_mm;
                if gap.abs() < 1e-9 || (high.0 - low.0) < 1e-10 {
                    return Ok(Some(secant));
                }
                if gap * low.1 < 0.0 {
                    high = (secant, gap);
                    // Illinois: an end that stays counts half, or the secant would creep.
                    low.1 *= 0.5;
                } else {
                    low = (secant, gap);
                    high.1 *= 0.5;
                }
            }
            return Ok(Some(0.5 * (low.0 + high.0)));
        }
        before = (x, gap);
    }
    Ok(None)
}

/// Chebyshev coefficients of `f` on `(low, high)`, sampled in ascending order at `n` first-kind
/// points.
fn chebyshev(
    low: f64,
    high: f64,
    n: usize,
    mut f: impl FnMut(f64) -> Result<Node, WireError>,
) -> Result<Vec<Node>, WireError> {
    // Nodes that crowd at the ends keep the error even over the piece.
    let angle = |i: usize| std::f64::consts::PI * (i as f64 + 0.5) / n as f64;
    let mut values = vec![[0.0; 3]; n];
    for i in (0..n).rev() {
        values[i] = f(0.5 * (low + high) + 0.5 * (high - low) * angle(i).cos())?;
    }
    Ok((0..n)
        .map(|k| {
            let mut c = [0.0; 3];
            for (i, v) in values.iter().enumerate() {
                let w = (k as f64 * angle(i)).cos() * if k == 0 { 1.0 } else { 2.0 } / n as f64;
                for (c, v) in c.iter_mut().zip(v) {
                    *c += w * v;
                }
            }
            c
        })
        .collect())
}

fn clenshaw(c: &[Node], x: f64) -> Node {
    let mut out = [0.0; 3];
    for (k, o) in out.iter_mut().enumerate() {
        let (mut b1, mut b2) = (0.0, 0.0);
        for c in c.iter().skip(1).rev() {
            // Clenshaw: T_(n+1) = 2 x T_n - T_(n-1), summed from the highest term down.
            (b1, b2) = (2.0 * x * b1 - b2 + c[k], b1);
        }
        *o = x * b1 - b2 + c[0][k];
    }
    out
}

fn lagrange(nodes: &[f64], x: f64) -> Vec<f64> {
    (0..nodes.len())
        .map(|i| {
            (0..nodes.len())
                .filter(|&j| j != i)
                .map(|j| (x - nodes[j]) / (nodes[i] - nodes[j]))
                .product()
        })
        .collect()
}
