//! The zero of a recording: `m0 = mean of m(t), t - t_0 < span`, from its beginning without
//! contact; what follows is `m(t) - m0`.

/// Subtracts the mean moments of the first seconds from all that follow.
#[derive(Debug, Clone, PartialEq)]
pub struct Tare {
    span_s: f64,
    begun_s: Option<f64>,
    sum_nmm: [f64; 2],
    count: f64,
}

impl Tare {
    /// Over a time, s; 0: the moments stay as they are.
    pub fn new(span_s: f64) -> Self {
        Self {
            span_s,
            begun_s: None,
            sum_nmm: [0.0; 2],
            count: 0.0,
        }
    }

    /// Moments (N mm) less the mean of those seen so far in the span.
    pub fn zeroed(&mut self, t_s: f64, moment_nmm: [f64; 2]) -> [f64; 2] {
        let begun_s = *self.begun_s.get_or_insert(t_s);
        if t_s - begun_s < self.span_s {
            self.sum_nmm = [0, 1].map(|k| self.sum_nmm[k] + moment_nmm[k]);
            self.count += 1.0;
        }
        [0, 1].map(|k| moment_nmm[k] - self.sum_nmm[k] / self.count.max(1.0))
    }
}

#[cfg(test)]
mod tests {
    use super::Tare;

    #[test]
    fn the_beginning_sets_the_zero_and_what_follows_does_not() {
        let mut tare = Tare::new(0.5);
        for k in 0..5 {
            let noise = 0.01 * f64::from(k % 2 * 2 - 1);
            tare.zeroed(0.1 * f64::from(k), [0.2 + noise, -0.1]);
        }
        let pressed = tare.zeroed(0.6, [0.7, -0.1]);
        assert!(
            (pressed[0] - 0.5).abs() < 0.003 && pressed[1].abs() < 1e-12,
            "{pressed:?}"
        );
        assert_eq!(tare.zeroed(0.7, [0.7, -0.1]), pressed, "a press is no zero");
        // Negative control: without a span nothing is taken off.
        let mut none = Tare::new(0.0);
        assert_eq!(
            (none.zeroed(0.0, [0.2, 0.1]), none.zeroed(1.0, [0.7, 0.1])),
            ([0.2, 0.1], [0.7, 0.1])
        );
    }
}
