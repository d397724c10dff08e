//! Delay of the signal behind the stage, from a move in and out of contact.
//!
//! ```text
//! y_g(t) = a_g + b_g max(x(t - tau), 0) + noise,   tau = argmin sum_g min over a_g, b_g of RSS_g(tau)
//! ```
//!
//! y_g: wavelength of grating g, x: depth of the groove. The misfit is computed on a grid of tau
//! and refined by a parabola through its minimum (profile least squares: G. A. F. Seber, C. J.
//! Wild, "Nonlinear Regression", 1989, 2.1).

/// Largest delay searched for, s, and the step of the search.
const RANGE_S: f64 = 0.25;
const STEP_S: f64 = 0.002;

/// Delay (s) that best explains `signal` (device time, two wavelengths in nm) by the depth of the
/// groove (mm). Positive: the signal comes after the stage. `None` where the signal hardly moves or
/// the minimum is at the border.
pub(crate) fn estimate_s(
    signal: &[(f64, f64, f64)],
    depth_mm: impl Fn(f64) -> Option<f64>,
) -> Option<f64> {
    let thinned: Vec<&(f64, f64, f64)> = signal
        .iter()
        .step_by((signal.len() / 1500).max(1))
        .collect();
    if thinned.len() < 50 {
        return None;
    }
    let count = (RANGE_S / STEP_S) as i32;
    let misfit = |lag_s: f64| -> Option<f64> {
        // signal = a + b * depth in contact, fitted for both gratings.
        let mut sums = [[0.0; 5]; 2];
        let mut n = 0.0;
        let (a0, b0) = (thinned[0].1, thinned[0].2);
        for (t, a, b) in thinned.iter().copied() {
            let Some(depth) = depth_mm(t - lag_s) else {
                continue;
            };
            // Without contact the wire does not follow the groove.
            let x = depth.max(0.0);
            n += 1.0;
            for (sum, y) in sums.iter_mut().zip([a - a0, b - b0]) {
                for (s, v) in sum.iter_mut().zip([x, y, x * x, x * y, y * y]) {
                    *s += v;
                }
            }
        }
        if n < 50.0 {
            return None;
        }
        let rss = sums.map(|[x, y, xx, xy, yy]| {
            let (sxx, sxy, syy) = (xx - x * x / n, xy - x * y / n, yy - y * y / n);
            // RSS of the line y = a + b x from its sums.
            if sxx > 0.0 {
                syy - sxy * sxy / sxx
            } else {
                syy
            }
        });
        Some((rss[0] + rss[1]) / n)
    };
    let grid: Vec<f64> = (-count..=count)
        .map(|k| misfit(f64::from(k) * STEP_S))
        .collect::<Option<_>>()?;
    let best = (0..grid.len()).min_by(|a, b| grid[*a].total_cmp(&grid[*b]))?;
    let worst = grid.iter().copied().fold(0.0, f64::max);
    if best == 0 || best + 1 == grid.len() || grid[best] > 0.5 * worst {
        return None;
    }
    // Parabola through the minimum and its neighbours.
    let (l, m, r) = (grid[best - 1], grid[best], grid[best + 1]);
    let shift = 0.5 * (l - r) / (l - 2.0 * m + r);
    Some((best as f64 - f64::from(count) + shift) * STEP_S)
}

#[cfg(test)]
mod tests {
    use super::estimate_s;

    fn depth(t: f64) -> Option<f64> {
        Some((1.0 - (t - 1.0).abs() * 2.0).max(-0.5))
    }

    #[test]
    fn a_known_delay_is_found_and_silence_has_none() {
        for lag in [-0.03, 0.0, 0.047] {
            let signal: Vec<_> = (0..4000)
                .map(|k| {
                    let t = f64::from(k) * 5e-4;
                    let noise = 1e-3 * (f64::from(k * 31 % 17) / 17.0 - 0.5);
                    let x = depth(t - lag).unwrap().max(0.0);
                    (t, 1541.2 + 0.03 * x + noise, 1535.8 - 0.01 * x)
                })
                .collect();
            assert!(
                (estimate_s(&signal, depth).unwrap() - lag).abs() < 1e-3,
                "{lag}"
            );
        }
        let flat: Vec<_> = (0..4000)
            .map(|k| (f64::from(k) * 5e-4, 1541.2, 1535.8))
            .collect();
        assert_eq!(estimate_s(&flat, depth), None);
    }
}
