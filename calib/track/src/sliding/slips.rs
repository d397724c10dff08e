//! Where a contact slips from one place of the object to another at once: there the moments leap,
//! and the path after it has its own start.
//!
//! ```text
//! slip between k - 1 and k:   |m_k - m_(k-1)| > c (median |m_j - m_(j-1)| + sqrt(tr R))      in either moment; median over 6 steps on each side
//! ```
//!
//! c = 6 is tried first; c = 2.5 may be the wire that turns at an edge, and is a slip where no path
//! without it explains the readings.

use crate::known_motion::MotionRow;
use std::ops::Range;
use wcal_core::order_statistics::median;

/// Steps on each side of a slip that it is held against.
const AROUND: usize = 6;
/// Leaps (see the module) that are slips, and that may be.
pub(super) const LEAPS: [f64; 2] = [6.0, 2.5];
/// Among so many first and last loaded readings a leap is first touch or the end.
const FROM_ENDS: usize = 3;

/// The readings between slips; a reading that is caught within a slip is in none.
pub(super) fn parts(rows: &[MotionRow], leap: f64) -> Vec<Range<usize>> {
    let step = |k: usize, c: usize| (rows[k].moment_nmm[c] - rows[k - 1].moment_nmm[c]).abs();
    let leaps = |k: usize| {
        let (from, to) = (
            k.saturating_sub(AROUND).max(1),
            (k + AROUND + 1).min(rows.len()),
        );
        let noise = rows[k].noise_nmm2.trace().sqrt();
        // A slip to the side leaps in one moment alone.
        (0..2).any(|c| {
            // The median of the steps around is no leap, even beside one.
            let around = (from..to).filter(|j| *j != k).map(|j| step(j, c));
            step(k, c) > leap * (median(around).unwrap_or(f64::INFINITY) + noise)
        })
    };
    let inner = FROM_ENDS..rows.len().saturating_sub(FROM_ENDS).max(FROM_ENDS);
    let mut parts = Vec::new();
    let mut from = 0;
    for k in inner.filter(|k| leaps(*k)) {
        parts.push(from..k);
        from = k;
    }
    parts.push(from..rows.len());
    parts.retain(|p| p.len() > 1 || rows.len() == 1);
    parts
}
