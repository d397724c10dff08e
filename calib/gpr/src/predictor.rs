//! Evaluation of a stored map, one reading at a time and without allocation.
//!
//! With C = K + nu I = L L^T, G = L^-1 H, G^T G = A A^T (Cholesky), k_i = k(|z_i - z|), h the
//! trend's basis at z: mean = h . b + k . a, variance = s2 [k(0) - |v|^2 + |A^-1 (h - G^T v)|^2],
//! v = L^-1 k (universal kriging). Source: C. Rasmussen & C. Williams, "Gaussian Processes for
//! Machine Learning" (2006), sec. 2.7. Fit and symbols: [`crate::Process`].

use crate::artefact::{MapArtefact, OutputMap};
use crate::error::MapError;
use crate::geometry::distance;
use crate::kernel::Kernel;
use crate::process::{Factor, ProcessModel};
use crate::region::ValidRegion;
use crate::student::half95;
use crate::trend::{MAX_TERMS, Trend};
use nalgebra::Matrix2;
use wcal_core::stream::{MomentSpread, MomentStream, StreamMoments};

/// Moments of one reading.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct MapPrediction {
    /// Moments, N mm.
    pub moment_nmm: [f64; 2],
    /// Standard deviation of the map itself, noise excluded, N mm.
    pub sd_map_nmm: [f64; 2],
    /// Standard deviation of a new label at this reading, noise included, N mm.
    pub sd_nmm: [f64; 2],
    /// Half width of the central 95 % interval, noise included, N mm.
    pub half95_nmm: [f64; 2],
    /// How far the reading lies outside the valid region, pm; 0 inside.
    pub outside_by_pm: f64,
}

impl MapPrediction {
    /// Whether the reading lies in the valid region.
    pub fn is_valid(&self) -> bool {
        self.outside_by_pm <= 0.0
    }

    /// What the spread is made of: the map's uncertainty is taken as common to all readings, one
    /// unknown for each moment.
    pub fn spread(&self) -> MomentSpread {
        const MIN_NMM2: f64 = 1e-12;
        let map = self.sd_map_nmm;
        // What the stated variance has beyond the map's is the reading's own.
        let [a, b] = [0, 1].map(|c| (self.sd_nmm[c].powi(2) - map[c].powi(2)).max(MIN_NMM2));
        MomentSpread {
            noise_nmm2: Matrix2::new(a, 0.0, 0.0, b),
            shared_nmm: vec![[map[0], 0.0], [0.0, map[1]]],
        }
    }
}

/// A map ready for use: factors rebuilt once, buffers held.
#[derive(Debug, Clone)]
pub struct MapPredictor {
    centre_pm: [f64; 2],
    scale_pm: f64,
    inputs: Box<[[f64; 2]]>,
    region: ValidRegion,
    outputs: [Output; 2],
    correlation: Box<[f64]>,
    whitened: Box<[f64]>,
    last: MapPrediction,
}

#[derive(Debug, Clone)]
struct Output {
    kernel: Kernel,
    trend: Trend,
    offset_nmm: f64,
    beta: [f64; MAX_TERMS],
    alpha: Box<[f64]>,
    /// Rows of the lower factor of C, packed; diagonal entries inverted.
    lower: Box<[f64]>,
    /// Rows of L^-1 H.
    g: Box<[[f64; MAX_TERMS]]>,
    /// Rows of the lower factor of H'C^-1 H; diagonal entries inverted.
    lower_a: [[f64; MAX_TERMS]; MAX_TERMS],
    prior: f64,
    variance_nmm2: f64,
    noise_nmm2: f64,
    half95: f64,
}

impl MapPredictor {
    /// Checks the artefact and rebuilds its factors.
    ///
    /// # Errors
    /// As [`MapArtefact::check`], and [`MapError::NotPositiveDefinite`] where the covariance cannot
    /// be factorised.
    pub fn new(artefact: &MapArtefact) -> Result<Self, MapError> {
        artefact.check()?;
        let scale =
            |s: &[f64; 2]| [0, 1].map(|c| (s[c] - artefact.centre_pm[c]) / artefact.scale_pm);
        let inputs: Box<[[f64; 2]]> = artefact.training_pm.iter().map(scale).collect();
        let [first, second] = &artefact.outputs;
        Ok(Self {
            centre_pm: artefact.centre_pm,
            scale_pm: artefact.scale_pm,
            region: artefact.valid_region.clone(),
            outputs: [Output::new(first, &inputs)?, Output::new(second, &inputs)?],
            correlation: vec![0.0; inputs.len()].into(),
            whitened: vec![0.0; inputs.len()].into(),
            inputs,
            last: MapPrediction::default(),
        })
    }

    /// Moments (N mm) of one temperature-compensated reading (pm), with deviations and the distance
    /// from the valid region.
    pub fn predict(&mut self, shift_pm: [f64; 2]) -> MapPrediction {
        let z = [0, 1].map(|c| (shift_pm[c] - self.centre_pm[c]) / self.scale_pm);
        let mut out = MapPrediction {
            outside_by_pm: self.region.outside_by_pm(shift_pm),
            ..MapPrediction::default()
        };
        for m in 0..2 {
            let output = &self.outputs[m];
            // Moments that share a kernel share its correlations.
            if output.kernel != Kernel::None && (m == 0 || output.kernel != self.outputs[0].kernel)
            {
                for (k, x) in self.correlation.iter_mut().zip(&self.inputs) {
                    *k = output.kernel.at(distance(*x, z));
                }
            }
            let (mean, spread) = output.evaluate(z, &self.correlation, &mut self.whitened);
            out.moment_nmm[m] = mean;
            out.sd_map_nmm[m] = spread.sqrt();
            out.sd_nmm[m] = (spread + output.noise_nmm2).sqrt();
            out.half95_nmm[m] = output.half95 * out.sd_nmm[m];
        }
        out
    }

    /// Moments alone, N mm: the mean without its deviation costs one pass over the readings.
    pub fn mean_nmm(&self, shift_pm: [f64; 2]) -> [f64; 2] {
        let z = [0, 1].map(|c| (shift_pm[c] - self.centre_pm[c]) / self.scale_pm);
        self.outputs.each_ref().map(|output| {
            let weighted = |(x, a): (&[f64; 2], &f64)| a * output.kernel.at(distance(*x, z));
            output.trend_mean(z)
                + self
                    .inputs
                    .iter()
                    .zip(&output.alpha)
                    .map(weighted)
                    .sum::<f64>()
        })
    }
}

impl MomentStream for MapPredictor {
    fn quick_nmm(&mut self, _t_s: f64, shift_pm: [f64; 2], _rise_degc: f64) -> [f64; 2] {
        self.mean_nmm(shift_pm)
    }

    fn moments(&mut self, _t_s: f64, shift_pm: [f64; 2], _rise_degc: f64) -> StreamMoments {
        let p = self.predict(shift_pm);
        self.last = p;
        StreamMoments {
            moment_nmm: p.moment_nmm,
            sd_nmm: p.sd_nmm,
            valid: p.is_valid(),
        }
    }

    fn spread(&self) -> MomentSpread {
        self.last.spread()
    }
}

impl Output {
    fn new(stored: &OutputMap, inputs: &[[f64; 2]]) -> Result<Self, MapError> {
        let model = ProcessModel {
            trend: stored.trend,
            kernel: stored.kernel,
            nugget: stored.nugget,
            fixed_variance: Some(stored.variance_nmm2),
        };
        let factor = Factor::new(&model, inputs)?;
        let terms = stored.trend.terms();
        // Diagonals inverted here: forward substitution then only multiplies.
        let mut lower = Vec::new();
        if stored.kernel != Kernel::None {
            for i in 0..inputs.len() {
                lower.extend((0..i).map(|j| factor.l[(i, j)]));
                lower.push(1.0 / factor.l[(i, i)]);
            }
        }
        let mut g = vec![[0.0; MAX_TERMS]; inputs.len()];
        for (i, row) in g.iter_mut().enumerate() {
            (0..terms).for_each(|j| row[j] = factor.g[(i, j)]);
        }
        let mut lower_a = [[0.0; MAX_TERMS]; MAX_TERMS];
        if let Some(a) = &factor.a {
            let l = a.l_dirty();
            for i in 0..terms {
                (0..i).for_each(|j| lower_a[i][j] = l[(i, j)]);
                lower_a[i][i] = 1.0 / l[(i, i)];
            }
        }
        let mut beta = [0.0; MAX_TERMS];
        beta[..terms].copy_from_slice(&stored.beta);
        // The factor is on standard deviations.
        let wider = stored.inflation.powi(2);
        Ok(Self {
            kernel: stored.kernel,
            trend: stored.trend,
            offset_nmm: stored.offset_nmm,
            beta,
            alpha: stored.alpha.clone().into(),
            lower: lower.into(),
            g: g.into(),
            lower_a,
            prior: stored.kernel.at_zero(),
            variance_nmm2: wider * stored.variance_nmm2,
            noise_nmm2: wider * stored.variance_nmm2 * stored.nugget,
            half95: half95(stored.dof),
        })
    }

    #[inline]
    fn trend_mean(&self, z: [f64; 2]) -> f64 {
        let h = self.trend.basis(z);
        self.offset_nmm
            + (0..self.trend.terms())
                .map(|j| h[j] * self.beta[j])
                .sum::<f64>()
    }

    /// Mean (N mm) and variance of the mean ((N mm)^2, noise excluded).
    fn evaluate(&self, z: [f64; 2], correlation: &[f64], whitened: &mut [f64]) -> (f64, f64) {
        let terms = self.trend.terms();
        let mut mean = self.trend_mean(z);
        let mut u = self.trend.basis(z);
        let mut spread = self.prior;
        if self.kernel != Kernel::None {
            mean += correlation
                .iter()
                .zip(&self.alpha)
                .map(|(k, a)| k * a)
                .sum::<f64>();
            // v = L^-1 k row by row; the variance loses v'v.
            let mut row = 0;
            for i in 0..correlation.len() {
                let known: f64 = self.lower[row..row + i]
                    .iter()
                    .zip(&whitened[..i])
                    .map(|(l, v)| l * v)
                    .sum();
                let v = (correlation[i] - known) * self.lower[row + i];
                whitened[i] = v;
                spread -= v * v;
                for (u, g) in u[..terms].iter_mut().zip(&self.g[i]) {
                    *u -= g * v;
                }
                row += i + 1;
            }
        }
        // What is not known of the trend comes on top.
        for i in 0..terms {
            let known: f64 = (0..i).map(|j| self.lower_a[i][j] * u[j]).sum();
            u[i] = (u[i] - known) * self.lower_a[i][i];
            spread += u[i] * u[i];
        }
        (mean, self.variance_nmm2 * spread.max(0.0))
    }
}
