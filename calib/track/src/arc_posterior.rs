//! A posterior over the wire: its density by arc length, and the regions where it is highest.
//!
//! The density is constant in each of its cells. A region holds cells in the order of their density
//! until it has 95 % of the mass; neighbours are one piece (G. E. P. Box, G. C. Tiao, "Bayesian
//! Inference in Statistical Analysis", 1973, 2.8).

use nalgebra::{Matrix3, Vector3};

/// Mass of the stated regions.
pub(crate) const REGION: f64 = 0.95;
/// Cells between two nodes whose density is known: fewest, most, and their width between, mm; least
/// width of any cell, mm.
const PARTS: [f64; 2] = [8.0, 32.0];
const PART_MM: f64 = 0.02;
const MIN_MM: f64 = 1e-3;
/// Cells of normal distributions: in a standard deviation, their largest width, mm, and most of
/// them; standard deviations that are looked at.
const CELLS_A_SD: f64 = 4.0;
const CELL_MM: f64 = 0.1;
const MAX_CELLS: f64 = 400.0;
const SDS: f64 = 4.5;
/// Rounding: of the ends of cells, mm, and of masses and densities as a share of them.
const ROUNDING: f64 = 1e-6;

/// A piece of the 95 % region along the wire.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, schemars::JsonSchema)]
pub struct Region {
    /// Arc length from and to, mm.
    pub from_mm: f64,
    /// To, mm.
    pub to_mm: f64,
    /// Probability of the piece.
    pub probability: f64,
}

impl Region {
    fn new(from_mm: f64, to_mm: f64, probability: f64) -> Self {
        Self {
            from_mm,
            to_mm,
            probability,
        }
    }

    fn density(&self) -> f64 {
        self.probability / (self.to_mm - self.from_mm).max(MIN_MM)
    }
}

/// Density over the wire: cells in order of arc length, whose masses sum to 1; empty where nothing
/// is known.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ArcDensity(Vec<Region>);

impl ArcDensity {
    fn normalised(mut cells: Vec<Region>) -> Self {
        let total: f64 = cells.iter().map(|c| c.probability).sum();
        cells.iter_mut().for_each(|c| c.probability /= total);
        Self(if total > 0.0 { cells } else { Vec::new() })
    }

    /// Of masses at places (mm) in order; each stands for the wire half way to its neighbours.
    pub(crate) fn of_masses(places_mm: &[f64], masses: &[f64]) -> Self {
        let last = places_mm.len().saturating_sub(1);
        let half_way = |a: usize, b: usize| 0.5 * (places_mm[a] + places_mm[b.min(last)]);
        let cell = |(k, mass): (usize, &f64)| {
            Region::new(half_way(k.saturating_sub(1), k), half_way(k, k + 1), *mass)
        };
        Self::normalised(masses.iter().enumerate().map(cell).collect())
    }

    /// Of the logarithm of the density at places (mm) in order, linear between them.
    pub(crate) fn of_logarithms(places_mm: &[f64], ln: &[f64]) -> Self {
        let best = ln.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        if let [place] = places_mm {
            let [from_mm, to_mm] = [-0.5, 0.5].map(|share| place + share * MIN_MM);
            return Self(vec![Region::new(from_mm, to_mm, 1.0)]);
        }
        let between = |k: usize| {
            let (from_mm, to_mm) = (places_mm[k], places_mm[k + 1]);
            let width_mm = to_mm - from_mm;
            let parts = (width_mm / PART_MM).ceil().clamp(PARTS[0], PARTS[1]);
            let share = 1.0 / parts;
            let at = move |p: f64| {
                if p == parts {
                    to_mm
                } else {
                    from_mm + width_mm * share * p
                }
            };
            (0..parts as usize).map(move |p| {
                let p = p as f64;
                // ln p is near linear between nodes that differ by little: a cell is the midpoint
                // rule of the exponential.
                let ln = ln[k] + (ln[k + 1] - ln[k]) * share * (p + 0.5);
                let mass = (ln - best).exp() * width_mm * share;
                Region::new(at(p), at(p + 1.0), mass)
            })
        };
        let last = places_mm.len().saturating_sub(1);
        Self::normalised((0..last).flat_map(between).collect())
    }

    /// The mixture of normal distributions (weight, mean and standard deviation, mm) along a wire;
    /// what lies past its tip is at the tip.
    pub(crate) fn of_normals(parts: &[(f64, f64, f64)], length_mm: f64) -> Self {
        let least = parts.iter().map(|p| p.2).fold(f64::INFINITY, f64::min);
        let end =
            |sign: f64| move |p: &(f64, f64, f64)| (p.1 + sign * SDS * p.2).clamp(0.0, length_mm);
        let from = parts.iter().map(end(-1.0)).fold(length_mm, f64::min);
        let to = parts.iter().map(end(1.0)).fold(0.0, f64::max);
        let width_mm = (least / CELLS_A_SD)
            .clamp(MIN_MM, CELL_MM)
            .max((to - from) / MAX_CELLS);
        let count = ((to - from) / width_mm).ceil().max(1.0) as usize;
        // Cells count back from the upper end, so that the last one ends at the tip exactly.
        let at = |k: usize| to - width_mm * (count - k) as f64;
        let empty = |k: usize| Region::new(at(k), at(k + 1), 0.0);
        let mut cells: Vec<Region> = (0..count).map(empty).collect();
        for (weight, mean, sd) in parts {
            // Mass of a cell: difference of the normal distribution function at its ends.
            let is_tip = |c: &Region| c.to_mm >= length_mm - ROUNDING;
            let near = |c: &&mut Region| {
                is_tip(c) || (c.from_mm - SDS * sd..=c.to_mm + SDS * sd).contains(mean)
            };
            for cell in cells.iter_mut().filter(near) {
                let [low, high] =
                    [cell.from_mm, cell.to_mm].map(|end| normal_share((end - mean) / sd));
                let high = if is_tip(cell) { 1.0 } else { high };
                cell.probability += weight * (high - low);
            }
        }
        Self::normalised(cells)
    }

    /// The same density over a whole wire.
    pub fn uniform(length_mm: f64) -> Self {
        Self(vec![Region::new(0.0, length_mm, 1.0)])
    }

    /// Of several with their weights.
    pub fn mixture<'a>(parts: impl IntoIterator<Item = (f64, &'a Self)>) -> Self {
        let parts: Vec<(f64, &Self)> = parts.into_iter().collect();
        let cells = parts.iter().flat_map(|p| &p.1.0);
        // Between the edges of all parts together every density is constant.
        let mut edges: Vec<f64> = cells.flat_map(|c| [c.from_mm, c.to_mm]).collect();
        edges.sort_by(f64::total_cmp);
        edges.dedup_by(|b, a| *b - *a < ROUNDING);
        let empty = |e: &[f64]| Region::new(e[0], e[1], 0.0);
        let mut cells: Vec<Region> = edges.windows(2).map(empty).collect();
        for (weight, part) in parts {
            for cell in &part.0 {
                let first = edges.partition_point(|e| *e < cell.from_mm - ROUNDING);
                let end_mm = cell.to_mm + ROUNDING;
                let within = cells[first..].iter_mut();
                let within = within.take_while(|c| c.to_mm <= end_mm);
                // Density is constant in a cell: its parts have mass in proportion to their length.
                let share =
                    weight * cell.probability / (cell.to_mm - cell.from_mm).max(f64::MIN_POSITIVE);
                within.for_each(|c| c.probability += share * (c.to_mm - c.from_mm));
            }
        }
        Self::normalised(cells)
    }

    /// 95 % regions of highest density.
    pub fn regions(&self) -> Vec<Region> {
        let mut order: Vec<usize> = (0..self.0.len()).collect();
        order.sort_by(|a, b| self.0[*b].density().total_cmp(&self.0[*a].density()));
        // Highest density first: of all sets with this mass it is the shortest.
        let mut sum = 0.0;
        let least = order.into_iter().map(|k| &self.0[k]).find(|cell| {
            sum += cell.probability;
            sum >= REGION - ROUNDING
        });
        // All of the same density are in or out.
        let least = least.map_or(0.0, |cell| cell.density() * (1.0 - ROUNDING));
        let mut pieces: Vec<Region> = Vec::new();
        for cell in self.0.iter().filter(|c| c.density() >= least) {
            match pieces
                .last_mut()
                .filter(|piece| cell.from_mm <= piece.to_mm + ROUNDING)
            {
                Some(piece) => {
                    piece.to_mm = cell.to_mm;
                    piece.probability += cell.probability;
                }
                None => pieces.push(*cell),
            }
        }
        pieces
    }
}

/// Logarithm of the sum of what has these logarithms.
pub(crate) fn ln_sum(ln: &[f64]) -> f64 {
    // The largest is taken off: the exponentials neither overflow nor all underflow.
    let best = ln.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    if best.is_finite() {
        best + ln.iter().map(|l| (l - best).exp()).sum::<f64>().ln()
    } else {
        f64::NEG_INFINITY
    }
}

/// Mean and covariance (mm) of several with their weights.
pub(crate) fn mixed_place(
    parts: impl Iterator<Item = (f64, Vector3<f64>, Matrix3<f64>)> + Clone,
) -> Option<(Vector3<f64>, Matrix3<f64>)> {
    // Law of total covariance.
    let total: f64 = parts.clone().map(|p| p.0).sum();
    let mean: Vector3<f64> = parts.clone().map(|(w, at, _)| at * (w / total)).sum();
    let about = |(w, at, covariance): (f64, Vector3<f64>, Matrix3<f64>)| {
        (covariance + (at - mean) * (at - mean).transpose()) * (w / total)
    };
    (total > 0.0).then(|| (mean, parts.map(about).sum()))
}

/// Standard normal distribution function.
pub(crate) fn normal_share(z: f64) -> f64 {
    // By erfc: 1 + erf would lose the lower tail to cancellation.
    0.5 * statrs::function::erf::erfc(-z / std::f64::consts::SQRT_2)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ends(regions: &[Region]) -> Vec<[f64; 2]> {
        regions.iter().map(|r| [r.from_mm, r.to_mm]).collect()
    }

    #[test]
    fn two_peaks_are_two_pieces_and_a_wide_one_needs_more_of_the_wire() {
        let places: Vec<f64> = (0..=20).map(f64::from).collect();
        let mut masses = vec![0.0; 21];
        (masses[5], masses[6], masses[20]) = (0.3, 0.3, 0.4);
        let two = ArcDensity::of_masses(&places, &masses);
        assert_eq!(ends(&two.regions()), [[4.5, 6.5], [19.5, 20.0]]);
        assert!((two.regions()[0].probability - 0.6).abs() < 1e-12);
        assert!(ArcDensity::default().regions().is_empty());
        let all = ArcDensity::uniform(20.0);
        assert_eq!(ends(&all.regions()), [[0.0, 20.0]]);
        // A tenth of it anywhere: the peaks are not enough.
        let mixed = |lost: f64| ArcDensity::mixture([(1.0 - lost, &two), (lost, &all)]);
        assert_eq!(ends(&mixed(0.1).regions()), [[0.0, 20.0]]);
        assert_eq!(ends(&mixed(0.04).regions()), ends(&two.regions()));
    }

    #[test]
    fn a_normal_density_has_two_standard_deviations_on_each_side() {
        let places: Vec<f64> = (0..=24)
            .map(|k| 30.0 + 0.1 * (f64::from(k) - 12.0) / 3.0)
            .collect();
        let ln: Vec<f64> = places
            .iter()
            .map(|s| -0.5 * ((s - 30.0) / 0.1_f64).powi(2))
            .collect();
        let [piece] = ArcDensity::of_logarithms(&places, &ln).regions()[..] else {
            panic!()
        };
        assert!(
            (piece.from_mm - 29.804).abs() < 0.006 && (piece.to_mm - 30.196).abs() < 0.006,
            "{piece:?}"
        );
        // Two of the same a millimetre apart: their middle lies between them, and the spread is
        // theirs.
        let at = |x: f64| (0.5, Vector3::new(x, 0.0, 0.0), Matrix3::identity() * 0.01);
        let (mean, covariance) = mixed_place([at(30.0), at(31.0)].into_iter()).unwrap();
        assert!((mean.x - 30.5).abs() < 1e-12 && (covariance[(0, 0)] - 0.26).abs() < 1e-12);
    }
}
