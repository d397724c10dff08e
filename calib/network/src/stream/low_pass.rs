//! Causal low-pass with linear phase: its lag is one number, so an answer carries its effective
//! time.
//!
//! ```text
//! y(t - lag) = sum_k h_k x(t - k / f),   h_k ~ sinc(f_out / f (k - n)) (1 + cos(pi (k - n) / (n + 1))) / 2,   sum h = 1,   lag = n / f
//! gain(nu) = |sum_k h_k cos(2 pi nu (k - n) / f)|,   white noise: sd_y = sd_x sqrt(sum h^2)
//! ```
//!
//! Source: A. V. Oppenheim, R. W. Schafer, "Discrete-Time Signal Processing", window method (Hann).

use std::collections::VecDeque;
use std::sync::Arc;

/// Windowed sinc (Hann), unit gain at rest, evaluated only where an answer is wanted.
///
/// Source: Oppenheim and Schafer, "Discrete-Time Signal Processing", window method. 2 n + 1
/// symmetric taps delay everything by n samples.
#[derive(Debug, Clone)]
pub struct LowPass<const N: usize> {
    taps: Arc<[f64]>,
    rate_hz: f64,
    kept: VecDeque<(f64, [f64; N])>,
}

impl<const N: usize> LowPass<N> {
    /// For samples at `rate_hz`, answers at `out_hz` and a lag of `lag_s`; `None` where the lag is
    /// shorter than a sample or the rates are not above 0.
    pub fn new(rate_hz: f64, out_hz: f64, lag_s: f64) -> Option<Self> {
        let half = (lag_s * rate_hz).round();
        if !((1.0..=1e6).contains(&half) && out_hz > 0.0 && out_hz <= rate_hz) {
            return None;
        }
        let half = half as usize;
        // The sinc cuts off at f_out / 2, the Nyquist limit of the rows.
        let cut = out_hz / rate_hz;
        let tap = |k: usize| {
            let n = k as f64 - half as f64;
            let x = std::f64::consts::PI * cut * n;
            let sinc = if n == 0.0 { 1.0 } else { x.sin() / x };
            // Hann's window: side lobes below -31 dB for a little width.
            let window = 0.5 + 0.5 * (std::f64::consts::PI * n / (half as f64 + 1.0)).cos();
            sinc * window
        };
        let raw: Vec<f64> = (0..=2 * half).map(tap).collect();
        let sum: f64 = raw.iter().sum();
        let taps = raw.into_iter().map(|t| t / sum).collect();
        Some(Self {
            taps,
            rate_hz,
            kept: VecDeque::with_capacity(2 * half + 1),
        })
    }

    /// Lag, s: an answer given with the newest sample is true of this much earlier.
    pub fn lag_s(&self) -> f64 {
        (self.taps.len() / 2) as f64 / self.rate_hz
    }

    /// Gain at a frequency.
    pub fn gain(&self, hz: f64) -> f64 {
        let half = (self.taps.len() / 2) as f64;
        // The taps are symmetric: the sines cancel, and what remains is real.
        let turn = std::f64::consts::TAU * hz / self.rate_hz;
        self.taps
            .iter()
            .enumerate()
            .map(|(k, t)| t * (turn * (k as f64 - half)).cos())
            .sum::<f64>()
            .abs()
    }

    /// Standard deviation of the answer per standard deviation of white noise.
    pub fn noise_gain(&self) -> f64 {
        self.taps.iter().map(|t| t * t).sum::<f64>().sqrt()
    }

    /// The filter as times before (-) and after (+) what its answer is true of, s, and their
    /// weights: what a motion is averaged by so that it belongs to moments that went through the
    /// filter. At most `count` times; they stand for equal numbers of taps.
    pub fn kernel(&self, count: usize) -> Vec<(f64, f64)> {
        let half = (self.taps.len() / 2) as f64;
        let size = self.taps.len().div_ceil(count.max(1));
        let group = |(g, taps): (usize, &[f64])| {
            let weight: f64 = taps.iter().sum();
            let middle = (g * size) as f64 + 0.5 * (taps.len() as f64 - 1.0);
            ((middle - half) / self.rate_hz, weight)
        };
        self.taps.chunks(size).enumerate().map(group).collect()
    }

    /// Takes a sample.
    pub fn push(&mut self, t_s: f64, value: [f64; N]) {
        if self.kept.len() == self.taps.len() {
            self.kept.pop_front();
        }
        self.kept.push_back((t_s, value));
    }

    /// Forgets everything: after a gap the filter starts anew.
    pub fn restart(&mut self) {
        self.kept.clear();
    }

    /// The answer and its effective time; `None` until the filter is full.
    pub fn answer(&self) -> Option<(f64, [f64; N])> {
        if self.kept.len() < self.taps.len() {
            return None;
        }
        let mut sum = [0.0; N];
        for (tap, (_, value)) in self.taps.iter().zip(&self.kept) {
            for (s, v) in sum.iter_mut().zip(value) {
                *s += tap * v;
            }
        }
        Some((self.kept[self.taps.len() / 2].0, sum))
    }
}

#[cfg(test)]
mod tests {
    use super::LowPass;

    #[test]
    fn the_kernel_is_the_filter_in_few_times() {
        let filter = LowPass::<1>::new(2000.0, 10.0, 0.1).unwrap();
        let kernel = filter.kernel(21);
        let moment = |p: i32| kernel.iter().map(|(t, w)| w * t.powi(p)).sum::<f64>();
        assert!(kernel.len() <= 21 && (moment(0) - 1.0).abs() < 1e-12 && moment(1).abs() < 1e-3);
        // A sine of 2 Hz passes as through the filter itself; control: two times are too few.
        let gain = |kernel: &[(f64, f64)]| {
            kernel
                .iter()
                .map(|(t, w)| w * (std::f64::consts::TAU * 2.0 * t).cos())
                .sum::<f64>()
        };
        assert!(
            (gain(&kernel) - filter.gain(2.0)).abs() < 2e-3,
            "{}",
            gain(&kernel)
        );
        assert!((gain(&filter.kernel(2)) - filter.gain(2.0)).abs() > 2e-2);
    }

    fn filtered(signal: impl Fn(f64) -> f64, lag_s: f64) -> Vec<(f64, f64)> {
        let mut filter = LowPass::<2>::new(2000.0, 10.0, lag_s).unwrap();
        let mut out = Vec::new();
        for k in 0..4000 {
            let t_s = f64::from(k) / 2000.0;
            filter.push(t_s, [signal(t_s), 0.0]);
            out.extend(filter.answer().map(|(at_s, v)| (at_s, v[0])));
        }
        out
    }

    #[test]
    fn an_answer_is_true_of_the_time_that_it_states() {
        let filter = LowPass::<2>::new(2000.0, 10.0, 0.1).unwrap();
        assert!((filter.lag_s() - 0.1).abs() < 1e-12);
        let ramp = filtered(|t| 3.0 * t, 0.1);
        assert_eq!(ramp.len(), 4000 - 400);
        for (at_s, v) in &ramp {
            assert!((v - 3.0 * at_s).abs() < 1e-9, "{at_s}: {v}");
            // Control: with the time of the newest sample the same answer is wrong by the lag.
            assert!((v - 3.0 * (at_s + 0.1)).abs() > 0.29);
        }
    }

    #[test]
    fn the_first_mode_is_taken_out_and_what_the_tracker_needs_stays() {
        let filter = LowPass::<2>::new(2000.0, 10.0, 0.1).unwrap();
        assert!((filter.gain(0.0) - 1.0).abs() < 1e-12);
        assert!(filter.gain(1.0) > 0.95, "{}", filter.gain(1.0));
        assert!(filter.gain(34.0) < 1e-3, "{}", filter.gain(34.0));
        // The stated gain is that of the filter as it runs.
        let wave = filtered(|t| (std::f64::consts::TAU * 4.0 * t).sin(), 0.1);
        let largest = wave.iter().map(|w| w.1.abs()).fold(0.0, f64::max);
        assert!(
            (largest - filter.gain(4.0)).abs() < 1e-3,
            "{largest} {}",
            filter.gain(4.0)
        );
        assert!(filter.noise_gain() < 0.1);
    }

    #[test]
    fn after_a_gap_there_is_no_answer_until_the_filter_is_full_again() {
        let mut filter = LowPass::<2>::new(2000.0, 10.0, 0.01).unwrap();
        let feed = |filter: &mut LowPass<2>, from: u32, count: u32| {
            (from..from + count).for_each(|k| filter.push(f64::from(k), [1.0; 2]));
        };
        feed(&mut filter, 0, 40);
        assert!(filter.answer().is_none());
        feed(&mut filter, 40, 1);
        assert_eq!(filter.answer().unwrap().0, 20.0);
        filter.restart();
        feed(&mut filter, 50, 40);
        assert!(filter.answer().is_none());
        assert!(
            LowPass::<2>::new(2000.0, 10.0, 1e-5).is_none()
                && LowPass::<2>::new(0.0, 10.0, 0.1).is_none()
        );
    }
}
