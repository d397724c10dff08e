//! Generic signatures: what a residual looks like if something outside the catalogue drives it by a
//! covariate.

use super::fit::{Fit, Weights};
use super::linear::Basis;
use super::settings::settings;
use super::signature::{Signature, build};
use crate::effect::EffectTerm;
use crate::measurement_model::MeasurementModel;
use nalgebra::{DMatrix, DVector};

/// A generic signature: the residual varies with a covariate in a certain shape (`unknown` of
/// verify.json).
#[derive(Debug, Clone)]
pub(crate) struct CovariateSignature {
    /// Covariate.
    pub covariate: String,
    /// Shape.
    pub shape: &'static str,
    /// Period, for a sinusoid, in the covariate's unit.
    pub period: Option<f64>,
    /// Its columns, free in every channel.
    pub columns: Vec<Vec<f64>>,
    /// The signature.
    pub signature: Signature,
}

/// Terms of generic signatures are never refitted; this marks them.
const GENERIC: usize = usize::MAX;

struct CovariateBuilder<'a> {
    channels: usize,
    fit: &'a Fit,
    weights: &'a Weights,
    nuisance: &'a Basis,
    out: Vec<CovariateSignature>,
}

impl CovariateBuilder<'_> {
    /// Shapes over a clock, or over a column of which nothing is known; `unit`: its values from 0
    /// to 1, `span`: their range.
    fn add_clock_shapes(&mut self, name: &str, unit: &[f64], span: f64) {
        let map = |f: &dyn Fn(f64) -> f64| unit.iter().map(|u| f(*u)).collect::<Vec<f64>>();
        // Two parameters at most: a richer shape would fit what noise does.
        self.add(name, "linear", None, &[map(&|u| u)]);
        self.add(name, "quadratic", None, &[map(&|u| u), map(&|u| u * u)]);
        // A step can lie between any two readings: equal numbers of them between the places that
        // are tried.
        for q in quantiles(unit, 24) {
            self.add(name, "step", None, &[map(&|u| f64::from(u8::from(u > q)))]);
        }
        if name == "t_s" || name == "order" {
            // What sets in during the session.
            for q in [0.2, 0.35, 0.5, 0.65, 0.8] {
                self.add(name, "dead-zone", None, &[map(&|u| (u - q).max(0.0))]);
            }
            // What dies out after the start, from a few readings to half of the session.
            for tau in [0.03, 0.08, 0.2, 0.5] {
                self.add(name, "exponential", None, &[map(&|u| (-u / tau).exp())]);
            }
        }
        for cycles in waves(unit) {
            // Sine and cosine: the phase of a wave is linear in both.
            let phase = std::f64::consts::TAU * cycles;
            let wave = [map(&|u| (phase * u).sin()), map(&|u| (phase * u).cos())];
            self.add(name, "sinusoid", Some(span / cycles), &wave);
        }
    }

    /// `columns` free in every channel.
    fn add(
        &mut self,
        covariate: &str,
        shape: &'static str,
        period: Option<f64>,
        columns: &[Vec<f64>],
    ) {
        let mut raw: Vec<DVector<f64>> = Vec::new();
        for column in columns {
            let weighted = self.weights.apply_to(column);
            raw.extend((0..self.channels).map(|c| self.fit.in_channel(&weighted, c)));
        }
        self.add_raw(covariate, shape, period, columns, &raw);
    }

    /// Waves of one period over each wavelength, each in its own alone: an interferometer's error
    /// repeats with what it reads. `to_channels` makes channels of the fit of wavelengths.
    fn add_ripple(
        &mut self,
        wavelengths_pm: &[Vec<f64>],
        period_pm: f64,
        to_channels: &DMatrix<f64>,
    ) {
        let spans: Vec<f64> = wavelengths_pm.iter().map(|v| range(v)[1]).collect();
        let (mut raw, mut of_widest) = (Vec::new(), Vec::new());
        let widest = (0..spans.len())
            .max_by(|&a, &b| spans[a].total_cmp(&spans[b]))
            .unwrap_or(0);
        for (k, wavelength) in wavelengths_pm.iter().enumerate() {
            for wave in [f64::sin as fn(f64) -> f64, f64::cos] {
                let column: Vec<f64> = wavelength
                    .iter()
                    .map(|v| wave(std::f64::consts::TAU * v / period_pm))
                    .collect();
                let weighted = self.weights.apply_to(&column);
                let part = |c: usize| self.fit.in_channel(&weighted, c) * to_channels[(k, c)];
                raw.push((1..self.channels).fold(part(0), |sum, c| sum + part(c)));
                if k == widest {
                    of_widest.push(column);
                }
            }
        }
        self.add_raw(
            &format!("fbg_{}_pm", widest + 1),
            "sinusoid",
            Some(period_pm),
            &of_widest,
            &raw,
        );
    }

    fn add_raw(
        &mut self,
        covariate: &str,
        shape: &'static str,
        period: Option<f64>,
        columns: &[Vec<f64>],
        raw: &[DVector<f64>],
    ) {
        let term = EffectTerm {
            effect: GENERIC,
            law: 0,
            values: Vec::new(),
        };
        if let Some(signature) = build(term, Vec::new(), false, raw, self.nuisance) {
            let columns = columns.to_vec();
            self.out.push(CovariateSignature {
                covariate: covariate.to_owned(),
                shape,
                period,
                columns,
                signature,
            });
        }
    }
}

/// Lowest value and span.
fn range(values: &[f64]) -> [f64; 2] {
    let (low, high) = values
        .iter()
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), v| {
            (a.min(*v), b.max(*v))
        });
    [low, high - low]
}

fn quantiles(values: &[f64], count: usize) -> Vec<f64> {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    sorted.dedup_by(|a, b| (*a - *b).abs() < 1e-9);
    if sorted.len() < 4 {
        return Vec::new();
    }
    let mut out: Vec<f64> = (1..count)
        .map(|k| sorted[k * (sorted.len() - 1) / count] + 1e-9)
        .collect();
    out.dedup();
    out
}

/// Covariates whose plain dependence a clock or a thermometer shows: additive shapes are tried on
/// them.
fn is_clock(name: &str) -> bool {
    matches!(
        name,
        "t_s" | "order" | "temperature_degc" | "stimulus" | "commanded_mm"
    )
}

/// Most half cycles of a ripple over the wider wavelength's range.
const RIPPLE_HALF_CYCLES: u32 = 48;

/// Most cycles over a column's range that are tried.
const MAX_CYCLES: f64 = 30.0;

/// Fewer places than this do not show a wave: amplitude, phase and period are chosen on them.
const MIN_PLACES: usize = 12;

/// Cycles over the range of a column (values from 0 to 1) at which waves are tried: half cycles, so
/// that neighbouring frequencies are still half in step, up to the Nyquist limit of its places. Of
/// uneven places that is the mean limit, (places - 1) / 2 cycles: beyond it a wave is recognised
/// from its aliases by the unevenness alone.
fn waves(unit: &[f64]) -> impl Iterator<Item = f64> {
    let last = settings(unit).into_iter().max().unwrap_or(0);
    let limit = if last + 1 < MIN_PLACES {
        0.0
    } else {
        MAX_CYCLES.min(0.5 * last as f64)
    };
    (3..)
        .map(|half| 0.5 * f64::from(half))
        .take_while(move |cycles| *cycles <= limit)
}

/// Generic signatures of every covariate of `system`, projected off `nuisance`.
pub(crate) fn signatures_of_covariates(
    system: &dyn MeasurementModel,
    fit: &Fit,
    weights: &Weights,
    nuisance: &Basis,
) -> Vec<CovariateSignature> {
    let channels = fit.residual.ncols();
    let mut maker = CovariateBuilder {
        channels,
        fit,
        weights,
        nuisance,
        out: Vec::new(),
    };
    let covariates = system.covariates();
    if let Some(to_channels) = system.channels_pm().try_inverse().filter(|_| channels > 1) {
        // Wavelengths as the model has them: measured ones carry the very noise that is tested.
        let fitted = (system.measured() - &fit.raw_residual) * system.channels_pm();
        let wavelengths: Vec<Vec<f64>> = fitted
            .column_iter()
            .map(|c| c.iter().copied().collect())
            .collect();
        let widest = wavelengths.iter().map(|v| range(v)[1]).fold(0.0, f64::max);
        for half in (3..=RIPPLE_HALF_CYCLES).filter(|_| widest > 0.0) {
            maker.add_ripple(&wavelengths, widest / (0.5 * f64::from(half)), &to_channels);
        }
    }
    // Columns after the constant carry the signal; gains act on them.
    let signal: Vec<Vec<f64>> = (1..fit.design.ncols().min(3))
        .map(|j| fit.raw_design.column(j).iter().copied().collect())
        .collect();
    let has_time = covariates.iter().any(|(n, _)| n == "t_s");
    for (name, values) in &covariates {
        let [lo, span] = range(values);
        if !(span > 0.0) || (name == "order" && has_time) {
            continue;
        }
        let unit: Vec<f64> = values.iter().map(|v| (v - lo) / span).collect();
        let map = |f: &dyn Fn(f64) -> f64| unit.iter().map(|u| f(*u)).collect::<Vec<f64>>();
        // A sensitivity that changes multiplies the signal; a zero that changes adds to it.
        let gain = |g: &[f64]| -> Vec<Vec<f64>> {
            signal
                .iter()
                .map(|s| s.iter().zip(g).map(|(s, g)| s * g).collect())
                .collect()
        };
        match name.as_str() {
            "trajectory" => {
                let mut groups: Vec<f64> = values.clone();
                groups.sort_by(f64::total_cmp);
                groups.dedup();
                let member = |g: f64| {
                    values
                        .iter()
                        .map(|v| f64::from(u8::from(*v == g)))
                        .collect::<Vec<f64>>()
                };
                // One group less than there are: the constant is in the design already.
                let dummies: Vec<Vec<f64>> = groups.iter().skip(1).map(|g| member(*g)).collect();
                maker.add(name, "irregular", None, &dummies);
                let gains: Vec<Vec<f64>> = dummies.iter().flat_map(|d| gain(d)).collect();
                maker.add(name, "irregular", None, &gains);
            }
            "direction" => {
                maker.add(name, "sign", None, std::slice::from_ref(values));
                maker.add(name, "sign", None, &gain(values));
            }
            "speed_mm_s" => {
                maker.add(name, "linear", None, &[map(&|u| u)]);
                maker.add(
                    name,
                    "sign",
                    None,
                    &[values.iter().map(|v| v.abs()).collect()],
                );
            }
            "dwell_s" => {
                maker.add(name, "linear", None, &[map(&|u| u)]);
                maker.add(
                    name,
                    "exponential",
                    None,
                    // Creep over decades of time goes with the logarithm.
                    &[values.iter().map(|v| (1.0 + v).ln()).collect()],
                );
            }
            _ if is_clock(name) || system.further_columns().contains(name) => {
                maker.add_clock_shapes(name, &unit, span);
                maker.add(name, "linear", None, &gain(&map(&|u| u - 0.5)));
            }
            "stage_mm" | "moment_nmm" => {
                let toward = &signal;
                for q in [0.2, 0.35, 0.5, 0.65, 0.8] {
                    let hinge = map(&|u| (u - q).max(0.0));
                    maker.add(name, "dead-zone", None, std::slice::from_ref(&hinge));
                    if !toward.is_empty() {
                        maker.add(name, "dead-zone", None, &gain(&hinge));
                    }
                }
                maker.add(name, "quadratic", None, &[map(&|u| u), map(&|u| u * u)]);
            }
            "largest_moment_nmm" => {
                // What a load leaves behind sets in where an earlier one has not gone yet.
                for q in [0.0, 0.2, 0.35, 0.5, 0.65, 0.8] {
                    maker.add(name, "dead-zone", None, &[map(&|u| (u - q).max(0.0))]);
                }
            }
            "moment_1_nmm" | "moment_2_nmm" => {
                maker.add(
                    name,
                    "sign",
                    None,
                    &[values
                        .iter()
                        .map(|v| v.signum() * f64::from(u8::from(v.abs() > 1e-9)))
                        .collect()],
                );
            }
            "contact_arclength_mm" => maker.add(name, "linear", None, &gain(&map(&|u| u - 0.5))),
            _ => maker.add(name, "linear", None, &[map(&|u| u)]),
        }
    }
    maker.out
}
