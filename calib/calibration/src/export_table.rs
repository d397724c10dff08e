//! A function of one number as a table of cubic pieces, made from its values alone.
//!
//! A piece goes through four equally spaced values of the function within it (Newton's forward
//! differences), so that a knee or a step of the function is the end of a piece. Pieces are halved
//! until they fit.

use crate::error::CalibrationError;

/// Most points of a piecewise linear function.
const MAX_POINTS: usize = 64;
/// No piece is narrower, as a share of the input's range: only a step is left there.
const NARROWEST: f64 = 1e-12;
/// Places over the whole range at which the pieces are compared with the function.
const CHECKS: f64 = 256.0;

/// Value and half width of the 95 % interval over the share of the input's range.
pub(crate) struct Table {
    /// Lowest and highest input, and how far beyond each the reading is still valid, with the value
    /// of that end.
    pub(crate) ends: [f64; 4],
    /// Pieces: the share from which on it holds, four coefficients of the value and four of the
    /// half width by powers of the share less that one.
    pub(crate) pieces: Vec<[f64; 9]>,
}

impl Table {
    /// The table of `law`, which gives value and half width at shares of the input's range, to
    /// `tolerance` of each.
    ///
    /// # Errors
    /// Those of `law`, and where more than `most` pieces are needed.
    pub(crate) fn of(
        ends: [f64; 4],
        tolerance: [f64; 2],
        most: usize,
        law: impl Fn(&[f64]) -> Result<Vec<[f64; 2]>, CalibrationError>,
    ) -> Result<Self, CalibrationError> {
        let (mut pieces, mut open) = (Vec::new(), vec![[0.0, 1.0]]);
        while !open.is_empty() {
            let places: Vec<Vec<f64>> = open.iter().map(|piece| places(*piece)).collect();
            let answers = law(&places.concat())?;
            let (mut at, mut next) = (0, Vec::new());
            for ([from, to], places) in open.into_iter().zip(&places) {
                let answers = &answers[at..at + places.len()];
                at += places.len();
                let piece = cubic(from, to - from, answers);
                let fits = |(share, answer): (&f64, &[f64; 2])| {
                    let found = value(&piece, *share);
                    (0..2).all(|c| (found[c] - answer[c]).abs() <= tolerance[c])
                };
                if to - from < NARROWEST || places.iter().zip(answers).all(fits) {
                    pieces.push(piece);
                } else {
                    let middle = 0.5 * (from + to);
                    next.extend([[from, middle], [middle, to]]);
                }
            }
            if pieces.len() + next.len() > most {
                let why = "expected at most 4096 cubic pieces, found more";
                return Err(CalibrationError::NotExported(why.to_owned()));
            }
            open = next;
        }
        pieces.sort_by(|a, b| a[0].total_cmp(&b[0]));
        Ok(Self { ends, pieces })
    }

    /// Value and half width at a share of the input's range.
    pub(crate) fn at(&self, share: f64) -> [f64; 2] {
        let after = self.pieces.partition_point(|piece| piece[0] <= share);
        value(&self.pieces[after.saturating_sub(1)], share)
    }

    /// Points of a piecewise linear function over the valid inputs, rising, and by how much it
    /// misses the table; no more of them than hold `tolerance`.
    pub(crate) fn points(&self, tolerance: f64) -> (Vec<[f64; 2]>, f64) {
        let value = |share: f64| self.at(share)[0];
        // Largest miss of a chord at places within it.
        let missed = |pair: &[f64]| -> f64 {
            let [a, b] = [pair[0], pair[1]].map(value);
            let miss = |k: u32| {
                let t = f64::from(k) / 33.0;
                (value(pair[0] + t * (pair[1] - pair[0])) - a - t * (b - a)).abs()
            };
            (1..33).map(miss).fold(0.0, f64::max)
        };
        let mut shares = vec![0.0, 1.0];
        let most = loop {
            let missed = shares.windows(2).map(missed).enumerate();
            let worst = missed.max_by(|a, b| a.1.total_cmp(&b.1));
            let (at, most) = worst.unwrap_or_default();
            // Two points are the outer ends, between which and the table the value stays.
            if most <= tolerance || shares.len() + 2 >= MAX_POINTS {
                break most;
            }
            shares.insert(at + 1, 0.5 * (shares[at] + shares[at + 1]));
        };
        let [low, high, below, above] = self.ends;
        let inner = shares.iter().map(|s| [low + s * (high - low), value(*s)]);
        let (first, last) = ([low - below, value(0.0)], [high + above, value(1.0)]);
        let mut points: Vec<[f64; 2]> = std::iter::once(first).chain(inner).chain([last]).collect();
        // Single precision reads them: two points at one place would divide by zero.
        points.dedup_by(|next, before| next[0] as f32 == before[0] as f32);
        (points, most)
    }
}

/// Shares at which a piece is made (four) and compared.
fn places([from, to]: [f64; 2]) -> Vec<f64> {
    let checks = (CHECKS * (to - from)).ceil().max(3.0);
    let thirds = (0..4).map(|k| f64::from(k) / 3.0);
    // Off the lattice of the thirds, on which a fast wave can look slow.
    let between = (0..checks as u32).map(|k| (f64::from(k) + 0.381_966) / checks);
    thirds
        .chain(between)
        .map(|t| from + t * (to - from))
        .collect()
}

/// The piece through the first four answers.
fn cubic(from: f64, width: f64, answers: &[[f64; 2]]) -> [f64; 9] {
    let mut out = [from; 9];
    for c in 0..2 {
        let y = |k: usize| answers[k][c];
        let d1 = y(1) - y(0);
        let d2 = y(2) - 2.0 * y(1) + y(0);
        let d3 = y(3) - 3.0 * y(2) + 3.0 * y(1) - y(0);
        // Newton: y0 + s d1 + s (s - 1) / 2 d2 + s (s - 1) (s - 2) / 6 d3, s in thirds of the width.
        let step = width / 3.0;
        let powers = [
            y(0),
            (d1 - d2 / 2.0 + d3 / 3.0) / step,
            (d2 - d3) / 2.0 / step.powi(2),
            d3 / 6.0 / step.powi(3),
        ];
        out[1 + 4 * c..5 + 4 * c].copy_from_slice(&powers);
    }
    out
}

/// Value and half width of a piece.
fn value(piece: &[f64; 9], share: f64) -> [f64; 2] {
    let d = share - piece[0];
    [1, 5].map(|k| piece[k] + d * (piece[k + 1] + d * (piece[k + 2] + d * piece[k + 3])))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_table_follows_waves_knees_and_steps_and_refuses_noise() {
        let of = |f: fn(f64) -> f64| {
            let law = |shares: &[f64]| Ok(shares.iter().map(|s| [f(*s), 1.0]).collect());
            Table::of([0.0, 1.0, 0.0, 0.0], [1e-7; 2], 4096, law)
        };
        let laws: [fn(f64) -> f64; 3] = [
            |s| (60.0 * s).sin(),
            |s| (s - 0.3).max(0.0),
            |s| f64::from(u8::from(s >= 0.7001)),
        ];
        for f in laws {
            let table = of(f).unwrap();
            for k in 0..1000 {
                let share = (f64::from(k) * 0.618_033_988_7).fract();
                assert!((table.at(share)[0] - f(share)).abs() < 2e-7, "{share}");
            }
        }
        // A cubic is one piece.
        assert_eq!(of(|s| s * s * s - s).unwrap().pieces.len(), 1);
        // Negative control: no table is made of what has no shape.
        assert!(of(|s| (s * 1e9).sin()).is_err());
    }
}
