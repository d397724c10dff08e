//! The profile of a blurred edge.

/// The error function and its derivative at `x`; absolute error below 1.5e-7.
/// Abramowitz and Stegun, Handbook of Mathematical Functions, 7.1.26.
#[must_use]
pub fn erf_with_slope(x: f64) -> (f64, f64) {
    let a = x.abs();
    if a > 5.0 {
        return (x.signum(), 0.0);
    }
    let t = 1.0 / (1.0 + 0.327_591_1 * a);
    let poly = t
        * (0.254_829_592
            + t * (-0.284_496_736 + t * (1.421_413_741 + t * (-1.453_152_027 + t * 1.061_405_429))));
    let gauss = (-a * a).exp();
    ((1.0 - poly * gauss).copysign(x), std::f64::consts::FRAC_2_SQRT_PI * gauss)
}

/// A step from 0 to 1 at 0, blurred by a Gaussian of standard deviation `sd`, and its derivative by `x`.
#[must_use]
pub fn blurred_step(x: f64, sd: f64) -> (f64, f64) {
    let scale = 1.0 / (sd * std::f64::consts::SQRT_2);
    let (f, slope) = erf_with_slope(x * scale);
    (0.5 * (1.0 + f), 0.5 * slope * scale)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn erf_agrees_with_statrs() {
        for k in -60..=60 {
            let x = f64::from(k) * 0.1;
            assert!((erf_with_slope(x).0 - statrs::function::erf::erf(x)).abs() < 2e-7);
        }
    }
}
