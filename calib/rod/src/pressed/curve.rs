//! The smooth centre line of the links: it runs through their middles along them (uniform quadratic B-spline of the nodes).

use crate::chain::{Chain, Links};
use nalgebra::Vector3;

/// A place on the centre line.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Spot {
    /// From the root in links, 0 to their number.
    pub at: f64,
    /// Last link that moves it, and the shares of the two last ones in its place and in its tangent.
    last: usize,
    place: [f64; 2],
    tangent: [f64; 2],
}

impl Spot {
    pub(super) fn new(at: f64, links: usize) -> Self {
        let at = at.clamp(0.0, links as f64);
        if at <= 0.5 || at >= links as f64 - 0.5 {
            let last = if at <= 0.5 { 0 } else { links - 1 };
            return Self { at, last, place: [1.0, at - last as f64], tangent: [0.0, 1.0] };
        }
        let last = (at + 0.5) as usize;
        let u = at + 0.5 - last as f64;
        Self { at, last, place: [0.5 + u - u * u / 2.0, u * u / 2.0], tangent: [1.0 - u, u] }
    }

    /// Links that move it, with their shares.
    pub(super) fn places(&self) -> impl Iterator<Item = (usize, f64)> + '_ {
        let share = move |j: usize| match self.last - j {
            0 => self.place[1],
            1 => self.place[0],
            _ => 1.0,
        };
        (0..=self.last).map(move |j| (j, share(j)))
    }

    /// Links that turn its tangent, with their shares.
    pub(super) fn tangents(&self) -> impl Iterator<Item = (usize, f64)> + '_ {
        let before = self.last.checked_sub(1).map(|j| (j, self.tangent[0]));
        before.into_iter().chain([(self.last, self.tangent[1])])
    }

    pub(super) fn point_mm(&self, chain: &Chain, links: &Links) -> Vector3<f64> {
        let h = chain.link_mm;
        let tail = links.frames[self.last].column(0) * (h * self.place[1]);
        match self.last {
            0 => links.nodes_mm[0] + tail,
            last => links.nodes_mm[last - 1] + links.frames[last - 1].column(0) * (h * self.place[0]) + tail,
        }
    }

    /// Tangent; of unit length at the links' middles, shorter by second order between them.
    pub(super) fn tangent(&self, links: &Links) -> Vector3<f64> {
        self.tangents().map(|(j, share)| links.frames[j].column(0) * share).sum()
    }

    /// Change of the tangent along the wire, 1/mm.
    pub(super) fn bend_per_mm(&self, chain: &Chain, links: &Links) -> Vector3<f64> {
        if self.at <= 0.5 || self.at >= chain.links() as f64 - 0.5 {
            return Vector3::zeros();
        }
        (links.frames[self.last].column(0) - links.frames[self.last - 1].column(0)) / chain.link_mm
    }
}
