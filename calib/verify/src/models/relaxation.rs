//! First-order relaxation, by time or by the way of a load.

/// Exact solution of r' = (m - r) over `x` time constants in which m goes linearly from `before` to
/// `now`.
pub(super) fn relax(r: f64, [before, now]: [f64; 2], x: f64) -> f64 {
    if x <= 0.0 {
        return r;
    }
    let decay = (-x).exp();
    // Mean of the decay over the step: its own weight is lost to rounding where the step is short.
    let mean = if x > 1e-9 {
        (1.0 - decay) / x
    } else {
        1.0 - 0.5 * x
    };
    // The weights add up to 1: a load that stays is where the state tends to.
    decay * r + (mean - decay) * before + (1.0 - mean) * now
}

/// dz/dx = target - z over the distance `x`: the state tends to the side that the load moves to.
pub(super) fn approach(z: f64, target: f64, x: f64) -> f64 {
    target + (z - target) * (-x).exp()
}

#[cfg(test)]
mod tests {
    use super::relax;

    #[test]
    fn many_small_steps_give_the_same_as_one() {
        let one = relax(0.3, [1.0, 2.0], 7.0 / 5.0);
        let mut r = 0.3;
        for k in 0..1000 {
            let (a, b) = (1.0 + f64::from(k) / 1000.0, 1.0 + f64::from(k + 1) / 1000.0);
            r = relax(r, [a, b], 7.0 / 5000.0);
        }
        assert!((one - r).abs() < 1e-12, "{one} {r}");
        let mut euler = 0.3;
        for k in 0..100_000 {
            let m = 1.0 + f64::from(k) / 1e5;
            euler += (m - euler) / 5.0 * 7.0 / 1e5;
        }
        assert!((one - euler).abs() < 1e-4);
    }
}
