//! Where within a node's share of the curve a contact is, and how fast it moves along it: nodes are coarser than what the moments tell.

use std::f64::consts::TAU;

/// Weight of a node, mean and variance of the place within it, from -1/2 to 1/2 nodes, and of its pace: the way along the curve (mm on the
/// wire, rad of the force at the tip) by the base's way.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Cell {
    pub weight: f64,
    pub at: f64,
    pub variance: f64,
    pub pace: f64,
    pub pace_variance: f64,
}

/// Variance of what is anywhere within a node, and of a pace that is not known.
const EVEN: f64 = 1.0 / 12.0;
pub(super) const UNKNOWN: f64 = 1.0;

impl Default for Cell {
    fn default() -> Self {
        Self::evenly(0.0)
    }
}

impl Cell {
    pub fn evenly(weight: f64) -> Self {
        Self { weight, at: 0.0, variance: EVEN, pace: 0.0, pace_variance: UNKNOWN }
    }

    /// One cell that stands for several, each with a factor on its weight.
    pub fn mixed(parts: &[(&Self, f64)]) -> Self {
        let mut all = Within::default();
        for (cell, factor) in parts {
            all.add(&Within::of(cell), *factor);
        }
        all.cell()
    }
}

/// Sums over what comes to a node: weight, and it times place and pace and their squares.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Within {
    pub weight: f64,
    at: [f64; 2],
    pace: [f64; 2],
}

/// Two Gaussian measurements of the place `y` within a node, before and now, `off + by_from x + by_to y = 0` with the variance of each;
/// x, the place before about its mean, has the variance `variance`.
#[derive(Debug, Clone, Copy)]
pub(super) struct Linked {
    pub off: [f64; 2],
    pub by_from: [f64; 2],
    pub by_to: [f64; 2],
    pub noise: [f64; 2],
    pub variance: f64,
}

impl Within {
    fn of(cell: &Cell) -> Self {
        let moments = |mean: f64, variance: f64| [cell.weight * mean, cell.weight * (mean * mean + variance)];
        Self {
            weight: cell.weight,
            at: moments(cell.at, cell.variance),
            pace: moments(cell.pace, cell.pace_variance),
        }
    }

    /// What is anywhere within the node and of unknown pace.
    pub fn anywhere(weight: f64) -> Self {
        Self::of(&Cell::evenly(weight))
    }

    /// Density of two measurements over the places of a node; the second one is that of the way along the curve less a foretold one,
    /// `foretold`, over the base's way.
    pub fn linked(l: &Linked, foretold: f64, way_mm: f64) -> Self {
        // Joint covariance of both without the place now.
        let [a, b] = l.by_from;
        let (s11, s22) = (l.variance * a * a + l.noise[0], l.variance * b * b + l.noise[1]);
        let s12 = l.variance * a * b;
        let det = s11 * s22 - s12 * s12;
        if !(det > 0.0) {
            return Self::default();
        }
        let solve = |v: [f64; 2]| [(s22 * v[0] - s12 * v[1]) / det, (s11 * v[1] - s12 * v[0]) / det];
        let dot = |u: [f64; 2], v: [f64; 2]| u[0] * v[0] + u[1] * v[1];
        let by = solve(l.by_to);
        let precision = dot(l.by_to, by).max(1e-9);
        let mean = -dot(by, l.off) / precision;
        let left = dot(l.off, solve(l.off)) - precision * mean * mean;
        if left > FARTHEST {
            return Self::default();
        }
        let Some((inside, at, variance)) = truncated(mean, 1.0 / precision.sqrt()) else {
            return Self::default();
        };
        let weight = (-0.5 * left).exp() * inside / (TAU * precision * det).sqrt();
        // The place before, given the one now: how both move together says how far the contact went.
        let pull = solve(l.by_from);
        let slope = -l.variance * dot(pull, l.by_to);
        let before = -l.variance * dot(pull, l.off) + slope * at;
        let rest = (l.variance - l.variance * l.variance * dot(l.by_from, pull)).max(0.0);
        let gone = foretold + l.off[1] + b * before + l.by_to[1] * at;
        let spread = (b * slope + l.by_to[1]).powi(2) * variance + b * b * rest;
        let (pace, pace_variance) = (gone / way_mm, spread / (way_mm * way_mm));
        Self::of(&Cell { weight, at, variance, pace, pace_variance })
    }

    /// Density of the first measurement alone; the pace is not known.
    pub fn first(l: &Linked) -> Self {
        let sd = (l.noise[0] + l.variance * l.by_from[0].powi(2)).sqrt();
        let by = if l.by_to[0].abs() < 1e-12 { 1e-12 } else { l.by_to[0] };
        if by.abs() < 0.1 * sd {
            return Self::anywhere((-0.5 * (l.off[0] / sd).powi(2)).exp() / (TAU.sqrt() * sd));
        }
        truncated(-l.off[0] / by, sd / by.abs()).map_or_else(Self::default, |(inside, at, variance)| {
            Self::of(&Cell { at, variance, ..Cell::evenly(inside / by.abs()) })
        })
    }

    pub fn add(&mut self, other: &Self, factor: f64) {
        self.weight += factor * other.weight;
        for k in 0..2 {
            self.at[k] += factor * other.at[k];
            self.pace[k] += factor * other.pace[k];
        }
    }

    /// The cell that has these moments.
    pub fn cell(&self) -> Cell {
        if !(self.weight > 0.0) {
            return Cell::default();
        }
        let of = |sums: [f64; 2]| {
            let mean = sums[0] / self.weight;
            (mean, (sums[1] / self.weight - mean * mean).max(0.0))
        };
        let ((at, variance), (pace, pace_variance)) = (of(self.at), of(self.pace));
        Cell {
            weight: self.weight,
            at,
            variance: variance.min(0.25),
            pace,
            pace_variance: pace_variance.min(UNKNOWN),
        }
    }
}

/// Twice the logarithm below which a density counts as none.
pub(super) const FARTHEST: f64 = 36.0;

/// Standard deviations past which a Gaussian is nothing.
const NOTHING: f64 = 7.5;

/// Share of a Gaussian within -1/2 to 1/2, with its mean and variance there.
fn truncated(mean: f64, sd: f64) -> Option<(f64, f64, f64)> {
    let (a, b) = ((-0.5 - mean) / sd, (0.5 - mean) / sd);
    if a > 7.0 || b < -7.0 {
        return None;
    }
    if b - a < 0.2 {
        let middle = 0.5 * (a + b);
        return Some(((b - a) * (-0.5 * middle * middle).exp() / TAU.sqrt(), 0.0, EVEN));
    }
    // Gauss's density at both ends, and what lies beyond them: the side on which no digits cancel.
    let density = |x: f64| if x.abs() > NOTHING { 0.0 } else { (-0.5 * x * x).exp() / TAU.sqrt() };
    let (at_a, at_b) = (density(a), density(b));
    let beyond = |x: f64, density: f64| if density > 0.0 { density * mills(x.abs()) } else { 0.0 };
    let inside = match (a > 0.0, b > 0.0) {
        (true, _) => beyond(a, at_a) - beyond(b, at_b),
        (_, false) => beyond(b, at_b) - beyond(a, at_a),
        _ => 1.0 - beyond(a, at_a) - beyond(b, at_b),
    };
    if inside < 1e-12 {
        return None;
    }
    let slope = (at_a - at_b) / inside;
    let curve = (a * at_a - b * at_b) / inside;
    let at = (mean + sd * slope).clamp(-0.5, 0.5);
    Some((inside, at, (sd * sd * (1.0 + curve - slope * slope)).clamp(0.0, 0.25)))
}

/// What lies beyond x of a standard Gaussian, over its density there (Mills' ratio); to 1e-7 of itself for x from 0 to `NOTHING`.
///
/// A polynomial in 1 / (1 + 0.29 x) times that, fitted to the complementary error function: no exponential is needed for it.
fn mills(x: f64) -> f64 {
    const C: [f64; 8] = [
        0.289_379_131_4,
        0.299_507_998_1,
        0.203_185_433_1,
        0.445_368_495_3,
        -0.355_423_178_7,
        0.750_606_291_9,
        -0.476_810_338_9,
        0.097_500_307_74,
    ];
    let t = 1.0 / (1.0 + 0.29 * x);
    C.iter().rev().fold(0.0, |sum, c| sum * t + c) * t
}

#[cfg(test)]
mod tests {
    use super::*;
    use statrs::distribution::{ContinuousCDF, Normal};

    #[test]
    fn what_lies_beyond_is_that_of_the_normal_distribution() {
        let normal = Normal::new(0.0, 1.0).unwrap();
        for k in 0..=1000 {
            let x = NOTHING * f64::from(k) / 1000.0;
            let density = (-0.5 * x * x).exp() / TAU.sqrt();
            assert!((mills(x) * density / normal.sf(x) - 1.0).abs() < 1e-7, "{x}");
        }
    }

    #[test]
    fn a_gaussian_is_cut_to_a_node() {
        for (mean, sd) in [(0.0, 1.0), (0.3, 0.1), (-0.7, 0.2), (2.0, 0.5), (0.49, 0.01), (5.0, 30.0)] {
            let normal = Normal::new(mean, sd).unwrap();
            let (n, width) = (200_000, 1.0 / 200_000.0);
            let weigh = |of: &dyn Fn(f64) -> f64| {
                let place = |k: i32| -0.5 + (f64::from(k) + 0.5) * width;
                (0..n).map(|k| of(place(k)) * (-0.5 * ((place(k) - mean) / sd).powi(2)).exp()).sum::<f64>()
            };
            let all = weigh(&|_| 1.0);
            let at = weigh(&|x| x) / all;
            let variance = weigh(&|x| (x - at).powi(2)) / all;
            let (inside, found_at, found) = truncated(mean, sd).unwrap();
            let exact = normal.cdf(0.5) - normal.cdf(-0.5);
            assert!((inside / exact - 1.0).abs() < 0.01, "{mean} {sd}: {inside} {exact}");
            assert!(
                (found_at - at).abs() < 0.01 && (found - variance).abs() < 0.01,
                "{mean} {sd}: {found_at} {at}"
            );
        }
        assert!(truncated(9.0, 0.5).is_none());
    }
}
