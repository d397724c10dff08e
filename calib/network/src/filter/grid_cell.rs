//! Offset and velocity of a contact within one node of the grid: nodes are coarser than what the
//! moments resolve.
//!
//! A transition is two linear measurements of the offset x before (variance P about its mean) and y
//! now, with independent noise r_1, r_2:
//!
//! ```text
//! e_i + a_i x + b_i y + noise_i = 0,   i = 1 (constraint), 2 (path along the curve less the predicted one)
//! S = P a a^T + diag(r)                                     covariance without y
//! y ~ N(y0, 1/L),   L = b^T S^-1 b,   y0 = -b^T S^-1 e / L   posterior of y under a flat prior
//! density = exp(-(e^T S^-1 e - L y0^2) / 2) / sqrt(2 pi L det S)  Phi(-1/2 < y < 1/2)
//! x | y:  mean -P a^T S^-1 (e + b y),   variance P - P^2 a^T S^-1 a
//! ```
//!
//! y is cut to the node, [-1/2, 1/2] (moments of the truncated normal: N. L. Johnson, S. Kotz, N.
//! Balakrishnan, "Continuous Univariate Distributions" 1, 13.10), and all that arrives in a node is
//! merged to one Gaussian of the same first two moments.

use super::exp::exp;
use std::f64::consts::TAU;

/// Weight of a node, mean and variance of the offset within it, from -1/2 to 1/2 nodes, and of the
/// velocity: the path along the curve (mm on the wire, rad of the force at the tip) by the base's
/// travel.
#[derive(Debug, Clone, Copy)]
pub(super) struct GridCell {
    pub weight: f64,
    pub offset: f64,
    pub variance: f64,
    pub velocity: f64,
    pub velocity_variance: f64,
}

/// Variance of an offset that is uniform within a node.
const UNIFORM_VARIANCE: f64 = 1.0 / 12.0;
/// Variance of a velocity that is not known.
const UNKNOWN_VELOCITY: f64 = 1.0;

impl Default for GridCell {
    fn default() -> Self {
        Self::uniform(0.0)
    }
}

impl GridCell {
    pub(crate) fn uniform(weight: f64) -> Self {
        Self {
            weight,
            offset: 0.0,
            variance: UNIFORM_VARIANCE,
            velocity: 0.0,
            velocity_variance: UNKNOWN_VELOCITY,
        }
    }

    /// One cell with the first two moments of several, each with a factor on its weight.
    pub(crate) fn merged(parts: &[(&Self, f64)]) -> Self {
        // Moments of a mixture add: several Gaussians become one of the same mean and variance.
        let mut all = MomentSums::default();
        for (cell, factor) in parts {
            all.add(&MomentSums::of(cell), *factor);
        }
        all.cell()
    }
}

/// Sums over what arrives in a node: weight, and weight times offset and velocity and their
/// squares.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct MomentSums {
    pub weight: f64,
    offset: [f64; 2],
    velocity: [f64; 2],
}

/// Two linear measurements of the offsets before and now, `residual + by_before x + by_now y = 0`
/// with the variance of each; x, the offset before about its mean, has the variance `variance`.
#[derive(Debug, Clone, Copy)]
pub(super) struct LinearGaussianPair {
    pub residual: [f64; 2],
    pub by_before: [f64; 2],
    pub by_now: [f64; 2],
    pub noise: [f64; 2],
    pub variance: f64,
}

impl MomentSums {
    fn of(cell: &GridCell) -> Self {
        let moments =
            |mean: f64, variance: f64| [cell.weight * mean, cell.weight * (mean * mean + variance)];
        Self {
            weight: cell.weight,
            offset: moments(cell.offset, cell.variance),
            velocity: moments(cell.velocity, cell.velocity_variance),
        }
    }

    /// Uniform within the node and of unknown velocity.
    pub(crate) fn uniform(weight: f64) -> Self {
        Self::of(&GridCell::uniform(weight))
    }

    /// Density of two measurements over the offsets of a node; the second one is that of the path
    /// along the curve less the predicted one, `predicted`, over the base's travel.
    pub(crate) fn of_pair(l: &LinearGaussianPair, predicted: f64, travel_mm: f64) -> Self {
        // S: joint covariance of both without the offset now.
        let [a, b] = l.by_before;
        let (s11, s22) = (
            l.variance * a * a + l.noise[0],
            l.variance * b * b + l.noise[1],
        );
        let s12 = l.variance * a * b;
        let det = s11 * s22 - s12 * s12;
        if !(det > 0.0) {
            return Self::default();
        }
        let solve = |v: [f64; 2]| {
            [
                (s22 * v[0] - s12 * v[1]) / det,
                (s11 * v[1] - s12 * v[0]) / det,
            ]
        };
        let dot = |u: [f64; 2], v: [f64; 2]| u[0] * v[0] + u[1] * v[1];
        // Posterior of y under a flat prior, and what of the residual no y can explain.
        let gain = solve(l.by_now);
        let precision = dot(l.by_now, gain).max(1e-9);
        let mean = -dot(gain, l.residual) / precision;
        let unexplained = dot(l.residual, solve(l.residual)) - precision * mean * mean;
        if unexplained > MAX_MAHALANOBIS2 {
            return Self::default();
        }
        let Some((inside, offset, variance)) = truncated_normal(mean, 1.0 / precision.sqrt())
        else {
            return Self::default();
        };
        let weight = exp(-0.5 * unexplained) * inside / (TAU * precision * det).sqrt();
        // Posterior of x given y: their joint moments give the path's mean and variance, and so the
        // velocity's.
        let before_gain = solve(l.by_before);
        let slope = -l.variance * dot(before_gain, l.by_now);
        let before = -l.variance * dot(before_gain, l.residual) + slope * offset;
        let rest = (l.variance - l.variance * l.variance * dot(l.by_before, before_gain)).max(0.0);
        let path = predicted + l.residual[1] + b * before + l.by_now[1] * offset;
        let path_variance = (b * slope + l.by_now[1]).powi(2) * variance + b * b * rest;
        let (velocity, velocity_variance) =
            (path / travel_mm, path_variance / (travel_mm * travel_mm));
        Self::of(&GridCell {
            weight,
            offset,
            variance,
            velocity,
            velocity_variance,
        })
    }

    /// Density of the first measurement alone; the velocity is not known.
    pub(crate) fn of_first(l: &LinearGaussianPair) -> Self {
        let sd = (l.noise[0] + l.variance * l.by_before[0].powi(2)).sqrt();
        let by = if l.by_now[0].abs() < 1e-12 {
            1e-12
        } else {
            l.by_now[0]
        };
        // A measurement that hardly depends on y leaves it uniform.
        if by.abs() < 0.1 * sd {
            return Self::uniform(exp(-0.5 * (l.residual[0] / sd).powi(2)) / (TAU.sqrt() * sd));
        }
        // From e + b y + noise = 0: y has the mean -e / b and the standard deviation sd / |b|.
        truncated_normal(-l.residual[0] / by, sd / by.abs()).map_or_else(
            Self::default,
            |(inside, offset, variance)| {
                Self::of(&GridCell {
                    offset,
                    variance,
                    ..GridCell::uniform(inside / by.abs())
                })
            },
        )
    }

    #[inline]
    pub(crate) fn add(&mut self, other: &Self, factor: f64) {
        self.weight += factor * other.weight;
        for k in 0..2 {
            self.offset[k] += factor * other.offset[k];
            self.velocity[k] += factor * other.velocity[k];
        }
    }

    /// The cell that has these moments.
    pub(crate) fn cell(&self) -> GridCell {
        if !(self.weight > 0.0) {
            return GridCell::default();
        }
        let of = |sums: [f64; 2]| {
            let mean = sums[0] / self.weight;
            (mean, (sums[1] / self.weight - mean * mean).max(0.0))
        };
        let ((offset, variance), (velocity, velocity_variance)) =
            (of(self.offset), of(self.velocity));
        // Nothing within [-1/2, 1/2] has a variance above 1/4.
        GridCell {
            weight: self.weight,
            offset,
            variance: variance.min(0.25),
            velocity,
            velocity_variance: velocity_variance.min(UNKNOWN_VELOCITY),
        }
    }
}

/// Squared distance in standard deviations beyond which a density counts as zero.
pub(super) const MAX_MAHALANOBIS2: f64 = 36.0;

/// A node farther than this from a density's mean holds nothing of it, and the normal density there
/// is taken for zero, standard deviations.
pub(super) const MAX_TRUNCATED_SDS: f64 = 7.0;

/// Share of a normal distribution within [-1/2, 1/2], with its mean and variance there; none where
/// there is as good as nothing.
fn truncated_normal(mean: f64, sd: f64) -> Option<(f64, f64, f64)> {
    let (a, b) = ((-0.5 - mean) / sd, (0.5 - mean) / sd);
    if a > MAX_TRUNCATED_SDS || b < -MAX_TRUNCATED_SDS {
        return None;
    }
    // A density much wider than the node is constant in it.
    if b - a < 0.2 {
        let middle = 0.5 * (a + b);
        return Some((
            (b - a) * exp(-0.5 * middle * middle) / TAU.sqrt(),
            0.0,
            UNIFORM_VARIANCE,
        ));
    }
    // Density at both ends, and the tails beyond them: the side on which no digits cancel.
    let density = |x: f64| {
        if x.abs() > MAX_TRUNCATED_SDS {
            0.0
        } else {
            exp(-0.5 * x * x) / TAU.sqrt()
        }
    };
    let (at_a, at_b) = (density(a), density(b));
    let tail = |x: f64, density: f64| {
        if density > 0.0 {
            density * mills_ratio(x.abs())
        } else {
            0.0
        }
    };
    let inside = match (a > 0.0, b > 0.0) {
        (true, _) => tail(a, at_a) - tail(b, at_b),
        (_, false) => tail(b, at_b) - tail(a, at_a),
        _ => 1.0 - tail(a, at_a) - tail(b, at_b),
    };
    if inside < 1e-12 {
        return None;
    }
    // E[z] = (phi(a) - phi(b)) / Z, Var[z] = 1 + (a phi(a) - b phi(b)) / Z - E[z]^2.
    let slope = (at_a - at_b) / inside;
    let curve = (a * at_a - b * at_b) / inside;
    let offset = (mean + sd * slope).clamp(-0.5, 0.5);
    Some((
        inside,
        offset,
        (sd * sd * (1.0 + curve - slope * slope)).clamp(0.0, 0.25),
    ))
}

/// Mills' ratio (1 - Phi(x)) / phi(x), to 1e-7 of itself for x from 0 to 7.5.
///
/// A polynomial in 1 / (1 + 0.29 x) times that, fitted to the complementary error function: no
/// exponential is needed for it.
fn mills_ratio(x: f64) -> f64 {
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
    let pairs = [
        C[6] + t * C[7],
        C[4] + t * C[5],
        C[2] + t * C[3],
        C[0] + t * C[1],
    ];
    let t2 = t * t;
    (pairs[3] + t2 * (pairs[2] + t2 * (pairs[1] + t2 * pairs[0]))) * t
}

#[cfg(test)]
mod tests {
    use super::*;
    use statrs::distribution::{ContinuousCDF, Normal};

    #[test]
    fn mills_ratio_is_that_of_the_normal_distribution() {
        let normal = Normal::new(0.0, 1.0).unwrap();
        for k in 0..=1000 {
            let x = 7.5 * f64::from(k) / 1000.0;
            let density = (-0.5 * x * x).exp() / TAU.sqrt();
            assert!(
                (mills_ratio(x) * density / normal.sf(x) - 1.0).abs() < 1e-7,
                "{x}"
            );
        }
    }

    #[test]
    fn a_normal_distribution_is_truncated_to_a_node() {
        for (mean, sd) in [
            (0.0, 1.0),
            (0.3, 0.1),
            (-0.7, 0.2),
            (2.0, 0.5),
            (0.49, 0.01),
            (5.0, 30.0),
        ] {
            let normal = Normal::new(mean, sd).unwrap();
            let (n, width) = (200_000, 1.0 / 200_000.0);
            let integral = |of: &dyn Fn(f64) -> f64| {
                let place = |k: i32| -0.5 + (f64::from(k) + 0.5) * width;
                (0..n)
                    .map(|k| of(place(k)) * (-0.5 * ((place(k) - mean) / sd).powi(2)).exp())
                    .sum::<f64>()
            };
            let all = integral(&|_| 1.0);
            let offset = integral(&|x| x) / all;
            let variance = integral(&|x| (x - offset).powi(2)) / all;
            let (inside, found_offset, found) = truncated_normal(mean, sd).unwrap();
            let exact = normal.cdf(0.5) - normal.cdf(-0.5);
            assert!(
                (inside / exact - 1.0).abs() < 0.01,
                "{mean} {sd}: {inside} {exact}"
            );
            assert!(
                (found_offset - offset).abs() < 0.01 && (found - variance).abs() < 0.01,
                "{mean} {sd}: {found_offset} {offset}"
            );
        }
        assert!(truncated_normal(9.0, 0.5).is_none());
    }
}
