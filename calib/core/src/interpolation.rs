//! Cubic interpolation between four nodes at equal steps.
//!
//! f(u) = sum_k w_k(u) f_k, w_k the Lagrange polynomials of the nodes -1, 0, 1, 2: their sum is 1,
//! and the error falls with the fourth power of the step (M. Abramowitz & I. Stegun, "Handbook of
//! Mathematical Functions", 25.2.13).

/// Weights of the nodes at -1, 0, 1, 2 for a value between 0 and 1 (Lagrange).
pub fn cubic(u: f64) -> [f64; 4] {
    [
        -u * (u - 1.0) * (u - 2.0) / 6.0,
        (u + 1.0) * (u - 1.0) * (u - 2.0) / 2.0,
        -(u + 1.0) * u * (u - 2.0) / 2.0,
        (u + 1.0) * u * (u - 1.0) / 6.0,
    ]
}
