//! Division of a record into episodes of one contact each: from the free wire before it to the last loaded reading.
//!
//! ```text
//! loaded      |m_k| > 4 sqrt(tr R_k + sum_j |h_kj|^2)               R_k: noise, h_kj: shared deviations of the calibration
//! run         loaded readings with at most 3 others between two of them, at least 3, without a jump of the motion
//! one episode two runs with d_k . u <= 0.3 mm at all readings between them       d_k: displacement since the first load, u: push
//! ```
//!
//! An object that retracts past first touch and returns along its known motion touches the wire at the same point again.

use super::contact_path::{ContactPath, loaded};
use super::{Episode, MomentField, MotionRow};

/// Free readings before a contact that belong to it.
pub(super) const LEAD: usize = 25;
/// Readings within a contact that may appear free: the moment passes through zero.
pub(super) const DIPS: usize = 3;
/// Fewer loaded readings are no contact.
pub(super) const MIN_LOADED: usize = 3;
/// An object is retracted where it is at most this far past its position at the first load, mm; a longer displacement has a direction.
pub(super) const BACK_MM: f64 = 0.3;

/// A contact as ranges of readings.
#[derive(Debug, Clone, PartialEq, Eq)]
struct Run {
    first: usize,
    last: usize,
}

/// Runs of loaded readings in one piece of the motion.
fn runs(rows: &[MotionRow], pieces: &[u32]) -> Vec<Run> {
    let mut runs: Vec<Run> = Vec::new();
    for k in (0..rows.len()).filter(|&k| loaded(&rows[k])) {
        match runs.last_mut().filter(|r| k - r.last <= DIPS + 1 && pieces[k] == pieces[r.last]) {
            Some(run) => run.last = k,
            None => runs.push(Run { first: k, last: k }),
        }
    }
    runs.retain(|r| rows[r.first..=r.last].iter().filter(|row| loaded(row)).count() >= MIN_LOADED);
    runs
}

/// Whether the object is retracted at every reading between two runs.
fn returns(field: &MomentField, rows: &[MotionRow], from: usize, run: &Run, next: &Run) -> bool {
    let episode = Episode { rows: rows[from..next.first].to_vec(), push: None };
    let Some(path) = ContactPath::new(field, &episode) else { return false };
    (run.last + 1..next.first).all(|k| path.along(k - from) <= BACK_MM)
}

/// Ranges (first, one past the last) of the readings of each contact; `pieces` is incremented where the motion jumped. `contact_segment` of the rows is
/// set to the contact's run.
pub fn episodes(field: &MomentField, rows: &mut [MotionRow], pieces: &[u32]) -> Vec<[usize; 2]> {
    let runs = runs(rows, pieces);
    for (n, run) in runs.iter().enumerate() {
        rows[run.first..=run.last].iter_mut().for_each(|r| r.contact_segment = n as u32);
    }
    let mut found: Vec<[usize; 2]> = Vec::new();
    for (n, run) in runs.iter().enumerate() {
        let before = n.checked_sub(1).map(|n| &runs[n]);
        if let (Some(before), Some(last)) = (before, found.last_mut())
            && pieces[before.last] == pieces[run.first]
            && returns(field, rows, last[0], before, run)
        {
            last[1] = run.last + 1;
            continue;
        }
        let free = before.map_or(0, |b| b.last + 1).max(run.first.saturating_sub(LEAD));
        let from = (free..run.first).rev().take_while(|&k| pieces[k] == pieces[run.first]).last();
        found.push([from.unwrap_or(run.first), run.last + 1]);
    }
    found
}

#[cfg(test)]
mod tests {
    use super::super::Friction;
    use super::*;
    use nalgebra::{Matrix2, Rotation3, Vector3};
    use wcal_core::observation::{MomentAxes, WhiskerSpec};
    use wcal_rod::Rod;

    /// A push along +z: loaded from 2 mm on.
    fn rows(ways_mm: &[f64]) -> Vec<MotionRow> {
        let row = |(k, z): (usize, &f64)| MotionRow {
            t_s: k as f64,
            moment_nmm: [(z - 2.0).max(0.0) * 0.1, 0.0],
            noise_nmm2: Matrix2::identity() * 1e-6,
            shared_nmm: Vec::new(),
            free_nmm2: None,
            shared_displacement_mm: Vec::new(),
            moved_mm: Vector3::z() * *z,
            turn: Rotation3::identity(),
            velocity_mm_s: Vector3::zeros(),
            moved_sd_mm: 0.0,
            free: false,
            contact_segment: 0,
        };
        ways_mm.iter().enumerate().map(row).collect()
    }

    #[test]
    fn a_contact_that_comes_again_is_one_and_others_are_two() {
        let rod = Rod::new(&WhiskerSpec::nominal(), 4.0).unwrap();
        let field = MomentField::new(&rod, &MomentAxes::default(), Friction::NONE);
        let (up, down): (Vec<f64>, Vec<f64>) =
            ((0..8).map(f64::from).collect(), (0..7).rev().map(f64::from).collect());
        let twice = [&up[..], &down, &up].concat();
        let mut all = rows(&twice);
        assert_eq!(episodes(&field, &mut all, &vec![0; twice.len()]), vec![[0, twice.len()]]);
        assert!(all[7].contact_segment == 0 && all[twice.len() - 1].contact_segment == 1);
        // The motion jumped in between: the first contact says nothing about the second.
        let pieces: Vec<u32> = (0..twice.len()).map(|k| u32::from(k >= 15)).collect();
        assert_eq!(episodes(&field, &mut rows(&twice), &pieces), vec![[0, 12], [15, twice.len()]]);
        // Released while the object moves on: the next touch is at another point.
        let mut on = rows(&(0..20).map(f64::from).collect::<Vec<_>>());
        on[8..14].iter_mut().for_each(|r| r.moment_nmm = [0.0; 2]);
        assert_eq!(episodes(&field, &mut on, &[0; 20]), vec![[0, 8], [8, 20]]);
        assert!(episodes(&field, &mut rows(&[0.0, 1.0, 2.0]), &[0; 3]).is_empty());
    }
}
