//! Several seatings of one sensor: what differs between them beyond the zero.

use super::system::WhiskerSystem;
use crate::levels::REMARK;
use crate::measurement_model::MeasurementModel;
use crate::method::fit::{Fit, linear};
use crate::method::min_p::f_test;
use nalgebra::DMatrix;
use statrs::distribution::{ChiSquared, ContinuousCDF};
use wcal_core::verify_document::NoisePart;

/// Variation between seatings.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SeatingVariation {
    /// Seatings.
    pub count: u32,
    /// Standard deviation of the zeros, pm, per channel.
    pub zero_sd_pm: [f64; 2],
    /// The same over both channels with its 95 % interval, pm; the zeros' own errors are in it.
    pub session: NoisePart,
    /// p-value of one K for all seatings against one K a seating (F test, every effect of the accepted model kept).
    pub sensitivity_p: f64,
    /// Root mean square of the seatings' changes of K over the norm of K.
    pub sensitivity_change: f64,
}

/// Compares the seatings under `fit`; none with one seating, or where a K a seating cannot be fitted.
pub fn spread_of_zeros(system: &WhiskerSystem, fit: &Fit) -> Option<SeatingVariation> {
    let count = system.seatings();
    let later = count as usize - 1;
    if later == 0 || fit.design.ncols() < 3 + later {
        return None;
    }
    let pm = system.channels_pm();
    let fitted_pm = &fit.coefficients * &pm;
    // Columns: constant, two moments, then the zeros of the later seatings (System::design).
    let zero_sd_pm = [0, 1].map(|c| {
        let zeros: Vec<f64> = (0..=later).map(|k| if k == 0 { 0.0 } else { fitted_pm[(2 + k, c)] }).collect();
        let mean = zeros.iter().sum::<f64>() / zeros.len() as f64;
        (zeros.iter().map(|z| (z - mean).powi(2)).sum::<f64>() / later as f64).sqrt()
    });
    let (n, q) = (fit.design.nrows(), fit.design.ncols());
    let own = 2 * later;
    let extended = DMatrix::from_fn(n, q + own, |i, j| {
        if j < q {
            fit.design[(i, j)]
        } else {
            let (k, m) = (1 + (j - q) / 2, 1 + (j - q) % 2);
            if system.path.readings[i].seating as usize == k { fit.design[(i, m)] } else { 0.0 }
        }
    });
    let fitted = &fit.design * &fit.coefficients;
    let measured = &fit.residual + fitted;
    let (coefficients, residual, full_rank) = linear(&extended, &measured);
    if !full_rank {
        return None;
    }
    let channels = fit.residual.ncols();
    let sensitivity_p = f_test(fit.ssr - residual.norm_squared(), fit.ssr, fit.dof, own * channels);
    let coefficients = coefficients * pm;
    let size = coefficients.rows(1, 2).norm();
    let changes = coefficients.rows(q, own).norm_squared() / later as f64;
    let session = pool(zero_sd_pm, later);
    Some(SeatingVariation {
        count,
        zero_sd_pm,
        session,
        sensitivity_p,
        sensitivity_change: changes.sqrt() / size,
    })
}

/// Both channels' standard deviations from `dof` degrees of freedom each as one, with the interval that chi-squared gives:
/// `s sqrt(nu / chi2_(0.975, nu)) .. s sqrt(nu / chi2_(0.025, nu))`, `nu = 2 dof`. Two sessions say little: the interval shows it.
fn pool(sd: [f64; 2], dof: usize) -> NoisePart {
    let value = (0.5 * (sd[0].powi(2) + sd[1].powi(2))).sqrt();
    let nu = 2.0 * dof as f64;
    let at = |p: f64| ChiSquared::new(nu).map_or(nu, |c| c.inverse_cdf(p));
    NoisePart { value, interval95: [0.975, 0.025].map(|p| value * (nu / at(p)).sqrt()) }
}

impl SeatingVariation {
    /// One line for the notes.
    pub fn note(&self) -> String {
        let [a, b] = self.zero_sd_pm;
        let share = 100.0 * self.sensitivity_change;
        let verdict = if self.sensitivity_p < REMARK {
            format!(
                "their K differ by {share:.2} % (p = {:.1e}): the stated intervals of K hold within a seating only",
                self.sensitivity_p
            )
        } else {
            format!("one K serves all (difference {share:.2} %, p = {:.2})", self.sensitivity_p)
        };
        format!("{} seatings: their zeros vary by {a:.2} and {b:.2} pm (sd); {verdict}.", self.count)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::levels::NORMAL_95;
    use rand::SeedableRng;
    use rand_distr::{Distribution, StandardNormal};

    #[test]
    fn the_interval_of_the_zeros_scatter_covers() {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(3);
        let (draws, sessions, truth) = (2000, 3, 4.0);
        let (mut covered, mut plain) = (0, 0);
        for _ in 0..draws {
            let sd = [0, 1].map(|_| {
                let zeros: Vec<f64> = (0..sessions)
                    .map(|_| -> f64 {
                        let z: f64 = StandardNormal.sample(&mut rng);
                        truth * z
                    })
                    .collect();
                let mean = zeros.iter().sum::<f64>() / sessions as f64;
                (zeros.iter().map(|z| (z - mean).powi(2)).sum::<f64>() / (sessions - 1) as f64).sqrt()
            });
            let e = pool(sd, sessions - 1);
            covered += usize::from((e.interval95[0]..e.interval95[1]).contains(&truth));
            // Control: a Gaussian's interval of the same width of freedom does not cover.
            let half = NORMAL_95 * e.value / (2.0 * 2.0 * (sessions - 1) as f64).sqrt();
            plain += usize::from((e.value - half..e.value + half).contains(&truth));
        }
        // 1,900 +- 10 expected (binomial standard deviation).
        assert!((1860..=1940).contains(&covered), "{covered}");
        assert!(plain < 1860, "{plain}");
    }
}
