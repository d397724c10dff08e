//! Which readings are of one contact, reading by reading: the one definition of tables, recordings
//! and streams. A session says it itself.
//!
//! ```text
//! loaded      |m_k| > 4 sqrt(tr R_k + sum_j |h_kj|^2)               R_k: noise, h_kj: shared deviations of the calibration
//! begins      at a loaded reading, known once the motion has a direction u: the trajectory's, or that of the last displacement before it
//!             that exceeds 0.3 mm and 3 s_d, or of the first after it
//! ends        after 4 readings in a row that are not loaded and at which the object is more than 0.3 mm past its position at the first load,
//!             d_k . u > 0.3 mm: it moves on without the wire; where the motion jumps or is not known
//! visit       a part of it without 4 readings in a row that are not loaded
//! dropped     fewer than 3 of its readings were loaded
//! ```
//!
//! An object that retracts past first touch and returns along its known motion touches the wire at
//! the same point again.

use super::{MomentField, MotionRow};
use nalgebra::Vector3;
use std::collections::VecDeque;

/// Readings within a contact that may appear free: the moment passes through zero.
const DIPS: usize = 3;
/// Fewer loaded readings are no contact.
const MIN_LOADED: usize = 3;
/// An object is retracted where it is at most this far past its position at the first load, mm; a
/// longer displacement has a direction.
const BACK_MM: f64 = 0.3;
/// Free readings before a contact that are kept, and their smallest distance, mm: readings of one
/// pose say the same.
const LEAD: usize = 12;
const LEAD_STEP_MM: f64 = 0.25;
/// Readings of a long hold before any motion that are kept.
const WAITING: usize = 48;

/// A contact that has ended: numbers of its first and last loaded reading.
pub type Segment = [usize; 2];

/// A contact whose direction has become known.
#[derive(Debug, Clone, PartialEq)]
pub struct Beginning {
    /// Unit vector of the push.
    pub push: Vector3<f64>,
    /// Free readings before it.
    pub lead: Vec<MotionRow>,
    /// Its readings so far, from the first loaded one on.
    pub rows: Vec<MotionRow>,
}

/// What a reading is of.
#[derive(Debug, Clone, PartialEq)]
pub enum Step {
    /// No contact, or one whose direction is not known yet.
    Outside,
    /// One that has become known by it.
    Begins(Beginning),
    /// The one that has begun.
    Within,
}

/// The contact at hand.
#[derive(Debug, Clone)]
struct Running {
    segment: Segment,
    loaded: usize,
    /// Readings in a row that were not loaded, and those of them at which the object was past its
    /// position at the first load.
    free: usize,
    past: usize,
    /// The first loaded reading, and the direction of the push where it is known; until then the
    /// readings wait.
    first: MotionRow,
    push: Option<Vector3<f64>>,
    waiting: Option<Vec<MotionRow>>,
}

/// Divides readings into contacts.
#[derive(Debug, Clone)]
pub struct Segmenter {
    /// The middle of the free wire, which stands for the object under rotation, mm.
    middle_mm: Vector3<f64>,
    lead: VecDeque<MotionRow>,
    running: Option<Running>,
    ended: Option<Segment>,
    piece: u32,
    readings: usize,
    visit: u32,
}

impl Segmenter {
    /// Past a wire.
    pub fn new(field: &MomentField) -> Self {
        Self {
            middle_mm: field.middle_mm(),
            lead: VecDeque::with_capacity(LEAD + 1),
            running: None,
            ended: None,
            piece: 0,
            readings: 0,
            visit: 0,
        }
    }

    /// Takes a reading, whose visit is written to it. `piece` changes where the motion before says
    /// nothing about the one after; `push`: direction of the push where it is known.
    pub fn push(
        &mut self,
        row: &mut MotionRow,
        piece: u32,
        push: Option<Vector3<f64>>,
        is_loaded: bool,
    ) -> Step {
        if piece != self.piece {
            self.interrupt();
            self.piece = piece;
        }
        let number = self.readings;
        self.readings += 1;
        if is_loaded {
            let running = self.running.get_or_insert_with(|| Running {
                segment: [number; 2],
                loaded: 0,
                free: 0,
                past: 0,
                first: row.clone(),
                push: push.and_then(|push| push.try_normalize(1e-9)),
                waiting: Some(Vec::new()),
            });
            (running.free, running.past) = (0, 0);
            running.loaded += 1;
            running.segment[1] = number;
        } else if let Some(running) = &mut self.running {
            let moved = |push| {
                row.displacement_mm(&running.first, &self.middle_mm)
                    .dot(&push)
            };
            // Without a direction nothing says that the object went back: it counts as past.
            let past = running
                .push
                .map(moved)
                .is_none_or(|along_mm| along_mm > BACK_MM);
            running.past = if past { running.past + 1 } else { 0 };
            running.free += 1;
            self.visit += u32::from(running.free == DIPS + 1);
            // A few loaded readings are noise, wherever the object is.
            let too_few = running.loaded < MIN_LOADED && running.free > DIPS;
            if running.past > DIPS || too_few {
                self.end();
            }
        }
        row.contact_segment = self.visit;
        self.step(row)
    }

    /// The motion is not known from here on: what was before says nothing about what comes.
    pub fn interrupt(&mut self) {
        // Over an unknown motion friction remembers nothing: what comes is another visit.
        self.visit += u32::from(self.running.is_some());
        self.end();
        self.lead.clear();
    }

    /// The contact that ended since this was asked last.
    pub fn take_ended(&mut self) -> Option<Segment> {
        self.ended.take()
    }

    fn end(&mut self) {
        let long_enough = |r: &Running| r.loaded >= MIN_LOADED;
        self.ended = self
            .running
            .take()
            .filter(long_enough)
            .map(|r| r.segment)
            .or(self.ended);
    }

    /// What a reading is of that was counted.
    fn step(&mut self, row: &MotionRow) -> Step {
        let Some(running) = &mut self.running else {
            // The newest reading stands for those of its pose.
            let near = |before: &MotionRow| (before.moved_mm - row.moved_mm).norm() < LEAD_STEP_MM;
            if self.lead.len() >= 2 && near(&self.lead[self.lead.len() - 2]) {
                self.lead.pop_back();
            }
            self.lead.push_back(row.clone());
            if self.lead.len() > LEAD {
                self.lead.pop_front();
            }
            return Step::Outside;
        };
        let Running {
            first,
            waiting: Some(waiting),
            ..
        } = running
        else {
            return Step::Within;
        };
        waiting.push(row.clone());
        let displacement = |to: &MotionRow| to.displacement_mm(first, &self.middle_mm);
        let enough = |w: &Vector3<f64>| w.norm() > BACK_MM.max(3.0 * first.moved_sd_mm);
        // A displacement before the first load points back to where the object came from.
        let before = || {
            self.lead
                .iter()
                .rev()
                .map(|row| -displacement(row))
                .find(enough)
        };
        let after = || waiting.iter().map(displacement).find(enough);
        let found = before().or_else(after).map(|push| push.normalize());
        let Some(push) = running.push.or(found) else {
            // A long hold before any motion: its last readings say as much.
            if waiting.len() > WAITING {
                waiting.remove(1);
            }
            return Step::Outside;
        };
        running.push = Some(push);
        let rows = running.waiting.take().unwrap_or_default();
        Step::Begins(Beginning {
            push,
            lead: self.lead.drain(..).collect(),
            rows,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::super::{Friction, contact_path::loaded};
    use super::*;
    use nalgebra::{Matrix2, Rotation3};
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

    /// First and last loaded readings of the contacts.
    fn segments(rows: &mut [MotionRow], pieces: &[u32]) -> Vec<Segment> {
        let rod = Rod::new(&WhiskerSpec::nominal(), 4.0).unwrap();
        let field = MomentField::new(&rod, &MomentAxes::default(), Friction::NONE);
        let mut segmenter = Segmenter::new(&field);
        let mut all = Vec::new();
        for (row, piece) in rows.iter_mut().zip(pieces) {
            let is_loaded = loaded(row);
            segmenter.push(row, *piece, None, is_loaded);
            all.extend(segmenter.take_ended());
        }
        segmenter.interrupt();
        all.extend(segmenter.take_ended());
        all
    }

    #[test]
    fn a_contact_that_comes_again_is_one_and_others_are_two() {
        let (up, down): (Vec<f64>, Vec<f64>) = (
            (0..8).map(f64::from).collect(),
            (0..7).rev().map(f64::from).collect(),
        );
        let twice = [&up[..], &down, &up].concat();
        let mut all = rows(&twice);
        assert_eq!(
            segments(&mut all, &vec![0; twice.len()]),
            vec![[3, twice.len() - 1]]
        );
        assert!(all[7].contact_segment == 0 && all[twice.len() - 1].contact_segment == 1);
        // The motion jumped in between: the first contact says nothing about the second.
        let pieces: Vec<u32> = (0..twice.len()).map(|k| u32::from(k >= 15)).collect();
        assert_eq!(
            segments(&mut rows(&twice), &pieces),
            vec![[3, 11], [18, twice.len() - 1]]
        );
        // Released while the object moves on: the next touch is at another point.
        let mut on = rows(&(0..20).map(f64::from).collect::<Vec<_>>());
        on[8..14].iter_mut().for_each(|r| r.moment_nmm = [0.0; 2]);
        assert_eq!(segments(&mut on, &[0; 20]), vec![[3, 7], [14, 19]]);
        // Three readings that appear free are a moment that passes through zero.
        let mut dips = rows(&(0..20).map(f64::from).collect::<Vec<_>>());
        dips[8..11].iter_mut().for_each(|r| r.moment_nmm = [0.0; 2]);
        assert_eq!(segments(&mut dips, &[0; 20]), vec![[3, 19]]);
        assert!(segments(&mut rows(&[0.0, 1.0, 2.0]), &[0; 3]).is_empty());
    }

    #[test]
    fn a_contact_begins_once_its_motion_has_a_direction() {
        let rod = Rod::new(&WhiskerSpec::nominal(), 4.0).unwrap();
        let field = MomentField::new(&rod, &MomentAxes::default(), Friction::NONE);
        let mut segmenter = Segmenter::new(&field);
        // In contact from the beginning, held, then pressed on.
        let mut all = rows(&[&[3.0; 60][..], &[3.2, 3.5, 4.0]].concat());
        let steps: Vec<Step> = all
            .iter_mut()
            .map(|row| segmenter.push(row, 0, None, true))
            .collect();
        assert!(steps[..61].iter().all(|s| *s == Step::Outside));
        let Step::Begins(b) = &steps[61] else {
            unreachable!("{:?}", steps[61])
        };
        assert!(
            (b.push - Vector3::z()).norm() < 1e-9
                && b.lead.is_empty()
                && b.rows.len() == WAITING + 1
        );
        assert_eq!((b.rows[0].t_s, steps[62].clone()), (0.0, Step::Within));
    }
}
