//! Candidates of one sample, and how they change from node to node.

use super::cell::Cell;
use crate::Candidate;
use nalgebra::Vector3;

/// Candidates of a sample, and how point and force change from node to node.
pub(super) struct Side<'a> {
    pub all: &'a [Candidate],
    pub pitches: Vec<Vector3<f64>>,
    pub turns: Vec<Vector3<f64>>,
    /// Direction about which a force at the node cannot turn without moments that turn: across the curve and the force.
    pub asides: Vec<Option<Vector3<f64>>>,
}

/// A contact at one place between nodes.
pub(super) struct Place<'c> {
    pub point_mm: Vector3<f64>,
    pub normal: Vector3<f64>,
    pub pitch: Vector3<f64>,
    pub turn: Vector3<f64>,
    pub cell: &'c Cell,
    pub node: usize,
    pub give_mm_per_nmm: f64,
    pub turn_per_nmm: f64,
}

/// Half the difference between a node's neighbours; not over the end of the wire, where the curve bends.
fn pitch(all: &[Candidate], k: usize, first_tip: usize, of: fn(&Candidate) -> Vector3<f64>) -> Vector3<f64> {
    let (mut low, mut high) = (k.saturating_sub(1), (k + 1).min(all.len() - 1));
    if k + 1 == first_tip {
        high = k;
    } else if k == first_tip {
        low = k;
    }
    (of(&all[high]) - of(&all[low])) / (high - low).max(1) as f64
}

impl<'a> Side<'a> {
    pub fn new(all: &'a [Candidate], first_tip: usize) -> Self {
        let by = |of: fn(&Candidate) -> Vector3<f64>| -> Vec<Vector3<f64>> {
            (0..all.len()).map(|k| pitch(all, k, first_tip, of)).collect()
        };
        let (pitches, turns) = (by(|c| c.point_mm), by(|c| c.normal));
        let aside = |(k, c): (usize, &Candidate)| {
            let along = if k < first_tip { &pitches[k] } else { &c.point_mm };
            along.cross(&c.normal).try_normalize(1e-12)
        };
        let asides = all.iter().enumerate().map(aside).collect();
        Self { all, pitches, turns, asides }
    }

    pub fn place<'c>(&self, k: usize, cell: &'c Cell) -> Place<'c> {
        let c = &self.all[k];
        Place {
            point_mm: c.point_mm + self.pitches[k] * cell.at,
            normal: c.normal + self.turns[k] * cell.at,
            pitch: self.pitches[k],
            turn: self.turns[k],
            cell,
            node: k,
            give_mm_per_nmm: c.give_mm_per_nmm,
            turn_per_nmm: c.turn_per_nmm,
        }
    }
}
