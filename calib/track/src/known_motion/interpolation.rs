//! Lagrange's cubic through equally spaced nodes: `f(u) = sum_k w_k(u) f_k`, nodes at -1, 0, 1, 2,
//! u between 0 and 1.

/// Weights of the nodes at -1, 0, 1, 2 for a value between 0 and 1 (Lagrange).
pub(super) fn cubic(u: f64) -> [f64; 4] {
    [
        -u * (u - 1.0) * (u - 2.0) / 6.0,
        (u + 1.0) * (u - 1.0) * (u - 2.0) / 2.0,
        -(u + 1.0) * u * (u - 2.0) / 2.0,
        (u + 1.0) * u * (u - 1.0) / 6.0,
    ]
}

/// Derivatives of [`cubic`] by its argument.
pub(super) fn cubic_rate(u: f64) -> [f64; 4] {
    [
        -(3.0 * u * u - 6.0 * u + 2.0) / 6.0,
        (3.0 * u * u - 4.0 * u - 1.0) / 2.0,
        -(3.0 * u * u - 2.0 * u - 2.0) / 2.0,
        (3.0 * u * u - 1.0) / 6.0,
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cubic_and_its_slope_are_exact() {
        let f = |x: f64| 0.3 * x.powi(3) - x * x + 2.0 * x - 1.0;
        let slope = |x: f64| 0.9 * x * x - 2.0 * x + 2.0;
        let nodes = [-1.0, 0.0, 1.0, 2.0].map(f);
        let sum = |weights: [f64; 4]| weights.iter().zip(nodes).map(|(w, f)| w * f).sum::<f64>();
        for u in [0.0, 0.3, 0.71, 1.0] {
            assert!(
                (sum(cubic(u)) - f(u)).abs() < 1e-12
                    && (sum(cubic_rate(u)) - slope(u)).abs() < 1e-12
            );
        }
        // Control: a quartic is not.
        let nodes = [-1.0, 0.0, 1.0, 2.0_f64].map(|x| x.powi(4));
        let off = cubic(0.3)
            .iter()
            .zip(nodes)
            .map(|(w, f)| w * f)
            .sum::<f64>()
            - 0.3_f64.powi(4);
        assert!(off.abs() > 0.1, "{off}");
    }
}
