//! The profile of a blurred edge: `S(x) = (1 + erf(x / (s sqrt 2))) / 2`, the convolution of a step
//! with a Gaussian of sd s; `erf` from a table with Hermite cubics. Source: Abramowitz and Stegun,
//! 7.1 (error function) and 25.2 (interpolation).

use std::sync::LazyLock;

/// Intervals of the table a unit of `x`.
const PER_UNIT: f64 = 32.0;
/// Beyond this erf differs from 1 by less than 2e-12.
const LIMIT: f64 = 5.0;

/// Cubics through erf and its slope at the ends of every interval: value = c0 + t (c1 + t (c2 + t
/// c3)), t from 0 to 1.
static TABLE: LazyLock<Vec<[f64; 4]>> = LazyLock::new(|| {
    let node = |k: usize| {
        let x = k as f64 / PER_UNIT;
        // d erf / d x = 2 / sqrt(pi) exp(-x^2), here by the share of an interval.
        let slope = std::f64::consts::FRAC_2_SQRT_PI * (-x * x).exp() / PER_UNIT;
        (statrs::function::erf::erf(x), slope)
    };
    (0..=(LIMIT * PER_UNIT) as usize)
        .map(|k| {
            let ((a, da), (b, db)) = (node(k), node(k + 1));
            [
                a,
                da,
                3.0 * (b - a) - 2.0 * da - db,
                2.0 * (a - b) + da + db,
            ]
        })
        .collect()
});

/// The error function and its derivative at `x`; absolute errors below 2e-8 and 1e-5. A table with
/// cubics between: this is the innermost loop of every fit to pixels.
#[inline]
pub fn erf_with_slope(x: f64) -> (f64, f64) {
    let a = x.abs();
    // Not `a >= LIMIT`: a position that is no number gives no slope either.
    if !(a < LIMIT) {
        return (x.signum(), 0.0);
    }
    let scaled = a * PER_UNIT;
    let k = scaled as usize;
    let t = scaled - k as f64;
    let [c0, c1, c2, c3] = TABLE[k];
    let value = c0 + t * (c1 + t * (c2 + t * c3));
    let slope = (c1 + t * (2.0 * c2 + 3.0 * t * c3)) * PER_UNIT;
    (value.copysign(x), slope)
}

/// A step from 0 to 1 at 0, blurred by a Gaussian of standard deviation `sd`, and its derivative by
/// `x`.
#[inline]
pub fn blurred_step(x: f64, sd: f64) -> (f64, f64) {
    let scale = 1.0 / (sd * std::f64::consts::SQRT_2);
    let (f, slope) = erf_with_slope(x * scale);
    (0.5 * (1.0 + f), 0.5 * slope * scale)
}
