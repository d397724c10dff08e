//! The smooth centre line of the links: the integral of a quadratic B-spline through their
//! directions, of third order in their length.
//!
//! t(x) = sum_j c_j N_2(x - j), x in links, N_2 the quadratic B-spline; inside c_j = 5/4 d_j -
//! (d_(j-1) + d_(j+1)) / 8 of the links' directions d_j; r(x) = h int_0^x t. Place, tangent and
//! curvature are therefore fixed linear combinations of the directions.
//!
//! A link's direction is the wire's at the link's middle. Links laid end to end leave a bent wire
//! by a twelfth of bend times length squared: little, but a wire that is barely touched is bent by
//! no more. Weights of the spline on the directions: C. de Boor, A Practical Guide to Splines
//! (2001), ch. XII (quasi-interpolant); the clamp's direction bounds it at the root.

use super::configuration::Configuration;
use nalgebra::Vector3;

/// Most links near a place that weigh in it otherwise than wholly.
const WINDOW: usize = 9;
/// Shares of the clamp and of the first links in all places beyond the window.
const CLAMP: f64 = 1.0 / 9.0;
const FIRST: [f64; 2] = [0.875, 1.0 + 1.0 / 72.0];

/// Shares of the clamp's direction and of the links' from `first` on.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Shares {
    clamp: f64,
    links: [f64; WINDOW],
}

/// A place on the centre line.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct CurvePoint {
    /// From the root in links, 0 to their number.
    pub at: f64,
    /// First link of the window, and how many are in it.
    first: usize,
    count: usize,
    /// Shares in its place and in its tangent.
    place: Shares,
    tangent: Shares,
    /// Links of the wire.
    links: usize,
}

/// The spline's coefficients from the one before cell `cell` on, three of them, as shares of the
/// links' directions.
fn shares(cell: usize, first: usize, links: usize, before: &[f64], local: [f64; 3]) -> Shares {
    let mut found = Shares {
        clamp: 0.0,
        links: [0.0; WINDOW],
    };
    if first > 0 && cell + 2 < links {
        // Far from both ends, where most places are: the general rule below, written out.
        let [a, b] = [0, 1].map(|k| before.get(k).copied().unwrap_or(0.0));
        let [c, d, e] = local;
        let eighths = |own: f64, neighbours: f64| 1.25 * own - neighbours / 8.0;
        let near = [
            eighths(b, a + c),
            eighths(c, b + d),
            eighths(d, c + e),
            eighths(e, d),
            -e / 8.0,
        ];
        found.links[..5].copy_from_slice(&near);
        return found;
    }
    // Coefficients of links, by number; those beyond the ends follow from the ends.
    let mut weights = [0.0; WINDOW + 2];
    let low = first.saturating_sub(1);
    for (k, weight) in before.iter().enumerate() {
        weights[k] += weight;
    }
    for (k, weight) in local.into_iter().enumerate() {
        match (cell + k).checked_sub(1) {
            // The tangent at the root is the clamp's.
            None => {
                found.clamp += 2.0 * weight;
                weights[0] -= weight;
            }
            // Straight on beyond the tip.
            Some(link) if link == links => {
                weights[link - 1 - low] += 2.0 * weight;
                weights[link - 2 - low] -= weight;
            }
            Some(link) => weights[link - low] += weight,
        }
    }
    let mut add = |link: usize, share: f64| {
        if let Some(at) = link.checked_sub(first).filter(|at| *at < WINDOW) {
            found.links[at] += share;
        }
    };
    for (k, weight) in weights.into_iter().enumerate().filter(|w| w.1 != 0.0) {
        let link = low + k;
        if link == 0 {
            add(0, 1.5 * weight);
            add(1, -weight / 6.0);
            found.clamp -= weight / 3.0;
        } else if link + 1 < links {
            add(link - 1, -weight / 8.0);
            add(link, 1.25 * weight);
            add(link + 1, -weight / 8.0);
        } else {
            add(link, 0.875 * weight);
            add(link - 1, 0.25 * weight);
            if link > 1 {
                add(link - 2, -weight / 8.0);
            } else {
                found.clamp -= weight / 8.0;
            }
        }
    }
    found
}

/// The links' middles, and the tip.
pub(crate) fn middles(links: usize) -> Vec<CurvePoint> {
    (0..links)
        .map(|j| j as f64 + 0.5)
        .chain([links as f64])
        .map(|at| CurvePoint::new(at, links))
        .collect()
}

impl CurvePoint {
    pub(crate) fn new(at: f64, links: usize) -> Self {
        let at = at.clamp(0.0, links as f64);
        let cell = (at as usize).min(links - 1);
        let v = at - cell as f64;
        // From the root on where the clamp weighs in, else the five links around.
        let first = if cell < 6 { 0 } else { cell - 2 };
        let count = (cell + 3).min(links) - first;
        let left = 1.0 - v;
        let mut local = [
            (1.0 - left.powi(3)) / 6.0,
            v / 2.0 + v * v / 2.0 - v.powi(3) / 3.0,
            v.powi(3) / 6.0,
        ];
        let mut whole = [1.0; WINDOW + 2];
        let low = first.saturating_sub(1);
        // Whole cells before this one: a sixth of the coefficient before each, four of its own, one
        // of the next.
        if cell > 0 {
            local[0] += 5.0 / 6.0;
            local[1] += 1.0 / 6.0;
        }
        let mut clamp = 0.0;
        let before = &mut whole[..(cell.saturating_sub(1)).saturating_sub(low)];
        if first == 0 && cell > 0 {
            // Nothing lies before the first cell: a sixth of the coefficient there is the clamp's.
            clamp = 1.0 / 3.0;
            match before.first_mut() {
                Some(weight) => *weight -= 1.0 / 3.0,
                None => local[0] -= 1.0 / 3.0,
            }
        }
        let mut place = shares(cell, first, links, before, local);
        place.clamp += if first == 0 { clamp } else { CLAMP };
        let tangent = shares(
            cell,
            first,
            links,
            &[],
            [left * left / 2.0, 0.5 + v - v * v, v * v / 2.0],
        );
        Self {
            at,
            first,
            count,
            place,
            tangent,
            links,
        }
    }

    /// Links that move it, with their shares.
    pub(crate) fn places(&self) -> impl Iterator<Item = (usize, f64)> + '_ {
        let share = |j: usize| match j.checked_sub(self.first) {
            Some(k) => self.place.links[k],
            None => FIRST.get(j).copied().unwrap_or(1.0),
        };
        (0..self.first + self.count).map(move |j| (j, share(j)))
    }

    /// Share of the clamp's direction in its place, in links.
    pub(crate) fn clamp_share(&self) -> f64 {
        self.place.clamp
    }

    /// Links that turn its tangent, with their shares.
    pub(crate) fn tangents(&self) -> impl Iterator<Item = (usize, f64)> + '_ {
        self.near(&self.tangent)
    }

    fn near<'a>(&'a self, shares: &'a Shares) -> impl Iterator<Item = (usize, f64)> + 'a {
        shares.links[..self.count]
            .iter()
            .enumerate()
            .map(|(k, share)| (self.first + k, *share))
    }

    /// Sum of directions with their shares.
    fn sum(&self, links: &Configuration, shares: &Shares) -> Vector3<f64> {
        let near: Vector3<f64> = self
            .near(shares)
            .map(|(j, share)| links.frames[j].column(0) * share)
            .sum();
        near + links.clamp.column(0) * shares.clamp
    }

    pub(crate) fn point_mm(&self, links: &Configuration) -> Vector3<f64> {
        let mut point = links.nodes_mm[self.first] + self.sum(links, &self.place) * links.link_mm;
        if self.first > 0 {
            for (share, frame) in FIRST.iter().zip(&links.frames) {
                point += frame.column(0) * ((share - 1.0) * links.link_mm);
            }
        }
        point
    }

    /// Tangent, of unit length to third order.
    pub(crate) fn tangent(&self, links: &Configuration) -> Vector3<f64> {
        self.sum(links, &self.tangent)
    }

    /// Change of the tangent along the wire, 1/mm.
    pub(crate) fn bend_per_mm(&self, links: &Configuration) -> Vector3<f64> {
        let cell = (self.at as usize).min(self.links - 1);
        let v = self.at - cell as f64;
        let bend = shares(
            cell,
            self.first,
            self.links,
            &[],
            [v - 1.0, 1.0 - 2.0 * v, v],
        );
        self.sum(links, &bend) / links.link_mm
    }
}

#[cfg(test)]
mod tests {
    use super::super::rod::ContactRod;
    use super::*;
    use wcal_core::observation::RestShape;
    use wcal_rod::{Section, Shape};

    fn rod(links: usize, straight_mm: f64) -> (ContactRod, Shape) {
        let rest = RestShape::StraightArc {
            straight_mm,
            arc_radius_mm: 20.0,
            length_mm: 60.0,
        };
        let shape = Shape::new(&rest, 0.05).unwrap();
        (
            ContactRod::new(&Section::round(0.3, 75.0, 28.2), &shape, 0.3, links).unwrap(),
            shape,
        )
    }

    /// Farthest that the curve of the wire at rest is from the wire, mm.
    fn off_mm(links: usize, straight_mm: f64) -> f64 {
        let (rod, shape) = rod(links, straight_mm);
        let rest = rod.at_rest();
        let off = |k: u32| {
            let at = f64::from(k) / 400.0 * links as f64;
            (CurvePoint::new(at, links).point_mm(&rest) - shape.rest_point(at * rod.link_mm)).norm()
        };
        (0..=400).map(off).fold(0.0, f64::max)
    }

    #[test]
    fn the_curve_of_an_arc_is_of_third_order() {
        let [coarse, middle, fine] = [10, 20, 40].map(|links| off_mm(links, 0.0));
        let order = [coarse / middle, middle / fine].map(f64::log2);
        assert!(
            order.iter().all(|o| *o > 2.7) && fine < 2e-3,
            "{coarse} {middle} {fine}"
        );
        // Links laid end to end leave the arc by more than four times that.
        let (rod, shape) = rod(40, 0.0);
        let rest = rod.at_rest();
        let middle = (rest.nodes_mm[20] + rest.nodes_mm[21]) / 2.0;
        let plain = (middle - shape.rest_point(20.5 * rod.link_mm)).norm();
        assert!(plain > 4.0 * fine, "{plain} {fine}");
        // Where the bend begins at once, second order remains near there; links end to end are
        // farther off.
        assert!(
            off_mm(40, 30.0) < 0.75 * plain,
            "{} {fine} {plain}",
            off_mm(40, 30.0)
        );
    }

    #[test]
    fn tangent_and_bend_are_the_places_derivatives() {
        let links = 12;
        let (rod, _) = rod(links, 10.0);
        let rest = rod.at_rest();
        for k in 1..240 {
            let at = f64::from(k) * 0.05 - 0.02;
            let step = 1e-5;
            let spot = |x: f64| CurvePoint::new(x, links);
            let point = |x: f64| spot(x).point_mm(&rest) / rod.link_mm;
            let slope = (point(at + step) - point(at - step)) / (2.0 * step);
            assert!((slope - spot(at).tangent(&rest)).norm() < 1e-8, "{at}");
            let tangent = |x: f64| spot(x).tangent(&rest);
            let bend = (tangent(at + step) - tangent(at - step)) / (2.0 * step * rod.link_mm);
            assert!((bend - spot(at).bend_per_mm(&rest)).norm() < 1e-5, "{at}");
            let sum = spot(at).places().map(|p| p.1).sum::<f64>() + spot(at).clamp_share();
            assert!(
                (sum - at).abs() < 1e-12,
                "a straight wire is as long as it is: {at} {sum}"
            );
        }
        // Negative control: half a link on, the tangent is another.
        let turned =
            CurvePoint::new(8.0, links).tangent(&rest) - CurvePoint::new(8.5, links).tangent(&rest);
        assert!(turned.norm() > 1e-2);
    }
}
