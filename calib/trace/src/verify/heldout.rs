//! Stage 11: held-out errors with trajectory-bootstrap intervals.

use rand::{RngExt, SeedableRng};
use std::collections::BTreeMap;
use wcal_core::verify_document::HeldOutError;

/// Residuals of one held-out reading.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HeldOut {
    /// Group that is resampled whole.
    pub group: u32,
    /// Measured less predicted shifts, pm.
    pub wavelength_pm: [f64; 2],
    /// Moment from the wavelengths less moment from the pose, N mm.
    pub moment_nmm: [f64; 2],
    /// Standard deviation of that difference, N mm.
    pub moment_sd_nmm: [f64; 2],
}

fn rms(values: impl Iterator<Item = f64>) -> f64 {
    let (mut sum, mut count) = (0.0, 0.0);
    for v in values {
        sum += v * v;
        count += 1.0;
    }
    if count > 0.0 { f64::sqrt(sum / count) } else { f64::NAN }
}

fn wavelength(rows: &[&HeldOut]) -> f64 {
    rms(rows.iter().flat_map(|r| r.wavelength_pm))
}

fn moment(rows: &[&HeldOut]) -> f64 {
    rms(rows.iter().flat_map(|r| r.moment_nmm))
}

/// Error of the wavelengths of held-out readings, pm; NaN without any.
#[must_use]
pub fn wavelength_rmse_pm(rows: &[HeldOut]) -> f64 {
    wavelength(&rows.iter().collect::<Vec<_>>())
}

/// Bootstrap draws over whole trajectories.
const DRAWS: usize = 1000;

/// Errors of `rows` with 95 % percentile intervals over resampled groups.
#[must_use]
pub fn summarise(rows: &[HeldOut], split: &str, seed: u64) -> Option<HeldOutError> {
    if rows.is_empty() {
        return None;
    }
    let all: Vec<&HeldOut> = rows.iter().collect();
    let mut groups: BTreeMap<u32, Vec<&HeldOut>> = BTreeMap::new();
    for r in rows {
        groups.entry(r.group).or_default().push(r);
    }
    let groups: Vec<Vec<&HeldOut>> = groups.into_values().collect();
    let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
    let mut draws: [Vec<f64>; 2] = [Vec::with_capacity(DRAWS), Vec::with_capacity(DRAWS)];
    for _ in 0..DRAWS {
        let sample: Vec<&HeldOut> =
            (0..groups.len()).flat_map(|_| groups[rng.random_range(0..groups.len())].clone()).collect();
        draws[0].push(wavelength(&sample));
        draws[1].push(moment(&sample));
    }
    let interval = |d: &mut Vec<f64>| {
        d.sort_by(f64::total_cmp);
        [d[(0.025 * DRAWS as f64) as usize], d[(0.975 * DRAWS as f64) as usize - 1]]
    };
    let names = ["wavelength_rmse_pm", "moment_rmse_nmm"];
    let [mut w, mut m] = draws;
    Some(HeldOutError {
        split: split.to_owned(),
        rmse: BTreeMap::from([(names[0].to_owned(), wavelength(&all)), (names[1].to_owned(), moment(&all))]),
        moment_rmse_nmm_each: Some([0, 1].map(|c| rms(rows.iter().map(|r| r.moment_nmm[c])))),
        interval95: BTreeMap::from([
            (names[0].to_owned(), interval(&mut w)),
            (names[1].to_owned(), interval(&mut m)),
        ]),
        points: rows.len(),
        loo: None,
    })
}

/// Share of moments inside their stated 95 % intervals.
#[must_use]
pub fn coverage95(rows: &[HeldOut]) -> Option<f64> {
    let inside = |r: &HeldOut, c: usize| r.moment_nmm[c].abs() <= 1.96 * r.moment_sd_nmm[c];
    let count = rows.len() * 2;
    let hits: usize = rows.iter().map(|r| (0..2).filter(|&c| inside(r, c)).count()).sum();
    (count > 0).then(|| hits as f64 / count as f64)
}
