//! Contacts of a stream, one after the other: when an episode begins and ends, with the recursive posterior of the one at hand.
//!
//! ```text
//! loaded      |m_k| > 4 sqrt(tr R_k + tr B + sum_j |h_kj|^2)        R_k: the reading's noise, B: the pose's, h_kj: common unknowns
//! begins      at a loaded reading, once the motion has a direction u: the trajectory's, or that of the last displacement before it that
//!             exceeds 0.3 mm and 3 s_d, or of the first after it
//! ends        after 4 readings in a row that are not loaded and at which the object is more than 0.3 mm past its position at the first
//!             load, d_k . u > 0.3 mm: it moves on without the wire; where the motion jumps or is not known
//! dropped     fewer than 3 of its readings were loaded
//! ```
//!
//! An object that retracts past first touch and returns touches the wire at the same point again, as in a table
//! ([`super::episodes`]).

use super::episodes::{BACK_MM, DIPS, MIN_LOADED};
use super::{EpisodeContact, Innovations, MomentField, MotionRow, RecursivePosterior, Settings, check_row};
use crate::ContactError;
use crate::arc_posterior::{ArcDensity, Region};
use nalgebra::Vector3;
use std::collections::VecDeque;
use std::sync::Arc;

/// Free readings before a contact that belong to it, and their smallest distance, mm: readings of one pose say the same, so that fewer than a table's
/// do.
const LEAD: usize = 12;
const LEAD_STEP_MM: f64 = 0.25;
/// Readings of a long hold before any motion that are kept.
const WAITING: usize = 48;

/// What is known after a reading.
#[derive(Debug, Clone, Default)]
pub struct StreamedContact {
    /// Where the wire is held, and the density over the arc length of first touch, by settings; none outside of an episode.
    pub places: Vec<(EpisodeContact, ArcDensity)>,
    /// Number of the episode, and unit vector of its push.
    pub episode: Option<(u64, Vector3<f64>)>,
    /// Moments and motion do not belong together so far under the last of the settings.
    pub disagrees: bool,
    /// The wire is loaded.
    pub loaded: bool,
}

/// An episode that has ended.
#[derive(Debug, Clone)]
pub struct FinishedEpisode {
    /// Number.
    pub number: u64,
    /// First and last reading, s.
    pub span_s: [f64; 2],
    /// Readings.
    pub readings: usize,
    /// Innovations.
    pub innovations: Innovations,
    /// 95 % regions at its end.
    pub regions: Vec<Region>,
}

/// The episode at hand.
#[derive(Debug, Clone)]
struct Running {
    number: u64,
    posteriors: Vec<RecursivePosterior>,
    from_s: f64,
    last_s: f64,
    loaded: usize,
    /// Readings in a row that were not loaded, and those of them past the first load.
    free: usize,
    past: usize,
    regions: Vec<Region>,
}

impl Running {
    /// Under the last of the settings, which allow the most.
    fn last(&self) -> &RecursivePosterior {
        &self.posteriors[self.posteriors.len() - 1]
    }
}

/// Locates contacts reading by reading.
pub struct ContactStream {
    field: Arc<MomentField>,
    settings: Vec<Settings>,
    lead: VecDeque<MotionRow>,
    /// Loaded readings whose motion has no direction yet.
    waiting: Vec<MotionRow>,
    running: Option<Running>,
    piece: u32,
    episodes: u64,
    last_s: f64,
    shared: Option<usize>,
    finished: Vec<FinishedEpisode>,
}

impl ContactStream {
    /// Past a wire, under each of the settings, which differ in what is assumed of the point alone. Where readings must not wait for the rod, its
    /// table is filled before ([`MomentField::fill`]).
    pub fn new(field: Arc<MomentField>, settings: Vec<Settings>) -> Self {
        Self {
            field,
            settings,
            lead: VecDeque::with_capacity(LEAD + 1),
            waiting: Vec::new(),
            running: None,
            piece: 0,
            episodes: 0,
            last_s: f64::NEG_INFINITY,
            shared: None,
            finished: Vec::new(),
        }
    }

    /// Takes a reading. `piece` counts up where the motion before says nothing about the one after; `push`: direction of the push where it
    /// is known.
    ///
    /// # Errors
    /// For a reading that cannot be used: its time is not later, or a number is not finite.
    pub fn push(
        &mut self,
        row: &MotionRow,
        piece: u32,
        push: Option<Vector3<f64>>,
    ) -> Result<StreamedContact, ContactError> {
        let shared = *self.shared.get_or_insert(row.shared_nmm.len());
        check_row(row, self.last_s, shared, "reading of a stream")?;
        self.last_s = row.t_s;
        if piece != self.piece {
            self.interrupt();
            self.piece = piece;
        }
        let is_loaded = self.settings.iter().any(|s| s.is_loaded(row));
        if self.running.is_none() {
            self.begin(row, is_loaded, push);
        } else {
            self.follow(row, is_loaded);
        }
        let Some(running) = &mut self.running else {
            return Ok(StreamedContact { loaded: is_loaded, ..StreamedContact::default() });
        };
        let place = |posterior: &RecursivePosterior| {
            let (place, posterior) = posterior.place(&self.field, row);
            (place, posterior.arc())
        };
        let places: Vec<_> = running.posteriors.iter().map(place).collect();
        running.regions = places.last().map(|p| p.1.regions()).unwrap_or_default();
        Ok(StreamedContact {
            places,
            episode: Some((running.number, running.last().push_direction())),
            disagrees: !running.last().innovations().consistent(),
            loaded: is_loaded,
        })
    }

    /// The motion is not known from here on: the episode ends, and what was before says nothing about what comes.
    pub fn interrupt(&mut self) {
        self.end();
        self.lead.clear();
        self.waiting.clear();
    }

    /// Episodes that have ended; the one at hand ends here.
    pub fn finish(&mut self) -> &[FinishedEpisode] {
        self.end();
        &self.finished
    }

    /// Outside of an episode: the reading is one of the lead, or begins an episode.
    fn begin(&mut self, row: &MotionRow, is_loaded: bool, push: Option<Vector3<f64>>) {
        if !is_loaded {
            self.waiting.clear();
            self.lead_in(row);
            return;
        }
        self.waiting.push(row.clone());
        let Some(direction) = push.or_else(|| self.direction()) else {
            // A long hold before any motion: its last readings say as much.
            if self.waiting.len() > WAITING {
                self.waiting.remove(1);
            }
            return;
        };
        let waiting = std::mem::take(&mut self.waiting);
        let lead: Vec<MotionRow> = self.lead.drain(..).collect();
        let start = |s: &Settings| RecursivePosterior::start(&self.field, *s, direction, &lead, &waiting[0]);
        let started: Option<Vec<_>> = self.settings.iter().map(start).collect();
        let Some(posteriors) = started.filter(|all| !all.is_empty()) else { return };
        self.running = Some(Running {
            number: self.episodes,
            posteriors,
            from_s: waiting[0].t_s,
            last_s: row.t_s,
            loaded: 1,
            free: 0,
            past: 0,
            regions: Vec::new(),
        });
        self.episodes += 1;
        for row in &waiting[1..] {
            self.follow(row, true);
        }
    }

    /// Within an episode.
    fn follow(&mut self, row: &MotionRow, is_loaded: bool) {
        let Some(running) = &mut self.running else { return };
        if is_loaded {
            (running.free, running.past) = (0, 0);
            running.loaded += 1;
        } else {
            let retracted = running.last().along_mm(&self.field, row) <= BACK_MM;
            running.free += 1;
            running.past = if retracted { 0 } else { running.past + 1 };
            let too_few = running.loaded < MIN_LOADED && running.free > DIPS;
            if running.past > DIPS || too_few {
                self.end();
                self.lead_in(row);
                return;
            }
        }
        running.posteriors.iter_mut().for_each(|p| p.push(&self.field, row));
        running.last_s = row.t_s;
    }

    fn lead_in(&mut self, row: &MotionRow) {
        // The newest reading stands for those of its pose.
        let near = |before: &MotionRow| (before.moved_mm - row.moved_mm).norm() < LEAD_STEP_MM;
        let n = self.lead.len();
        if n >= 2 && near(&self.lead[n - 2]) {
            self.lead.pop_back();
        }
        self.lead.push_back(row.clone());
        if self.lead.len() > LEAD {
            self.lead.pop_front();
        }
    }

    /// Direction of the motion at the first waiting reading; under rotation that of the wire's middle.
    fn direction(&self) -> Option<Vector3<f64>> {
        let first = self.waiting.first()?;
        let middle = self.field.free(0.5 * self.field.length_mm()).0;
        let displacement = |row: &MotionRow| {
            let turn = row.turn * first.turn.inverse();
            turn * (middle - first.moved_mm) + row.moved_mm - middle
        };
        let enough = |w: &Vector3<f64>| w.norm() > BACK_MM.max(3.0 * first.moved_sd_mm);
        let before = self.lead.iter().rev().map(|row| -displacement(row)).find(enough);
        before.or_else(|| self.waiting.iter().map(displacement).find(enough))
    }

    fn end(&mut self) {
        let Some(running) = self.running.take() else { return };
        if running.loaded < MIN_LOADED {
            return;
        }
        let innovations = running.last().innovations();
        self.finished.push(FinishedEpisode {
            number: running.number,
            span_s: [running.from_s, running.last_s],
            readings: innovations.rows,
            innovations,
            regions: running.regions,
        });
    }
}
