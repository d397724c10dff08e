//! All equilibria of a wire in the groove at one place: Newton's method from many forces and contact places.
//!
//! Starts: s_c between the straight distance |P| and the length, F = f EI / L^2 (sqrt(1 - z^2) cos a, sqrt(1 - z^2) sin a, z); equations of
//! `super::solve`. Found ones that agree in s_c and M are one; the smallest eigenvalue of the second variation (`super::stability`) says
//! which are stable. No proof that all are found: a start may lie in no basin.
//!
//! Which of several stable ones a wire takes is decided by its way there, friction and inertia: a simulator's moment at such a place is
//! that of its own history.

use crate::kirchhoff::solve::{Equilibrium, Guess, Rod, Tangential};
use nalgebra::Vector3;

/// An equilibrium with the smallest eigenvalue of its second variation, N: above 0 it is stable.
pub type StableEquilibrium = (Equilibrium, f64);

/// Places of the contact that are tried, directions of the force about each of two angles, and sizes of the force over EI / length^2.
const PLACES: usize = 10;
const TURNS: usize = 8;
const TILTS: [f64; 3] = [-0.9, 0.0, 0.9];
const SIZES: [f64; 2] = [2.0, 8.0];
/// Contacts nearer than this (mm) with moments as close as this share are one equilibrium.
const SAME_MM: f64 = 1e-3;
const SAME_SHARE: f64 = 1e-4;

impl Rod {
    /// The equilibria in a frictionless groove at `point_mm`, by the contact's arc length.
    pub fn equilibria(&self, point_mm: &Vector3<f64>) -> Vec<StableEquilibrium> {
        let length_mm = self.shape.length_mm;
        // The wire reaches the place at the earliest by a straight line.
        let nearest_mm = point_mm.norm();
        // Forces of some EI / L^2 bend the wire by about a radian.
        let unit_n = self.section.ei_nmm2 / length_mm.powi(2);
        let mut found: Vec<StableEquilibrium> = Vec::new();
        for place in 0..PLACES {
            let arclength_mm =
                nearest_mm + (length_mm - nearest_mm) * (place as f64 + 0.5) / PLACES as f64;
            for turn in 0..TURNS {
                let (sin, cos) = (std::f64::consts::TAU * turn as f64 / TURNS as f64).sin_cos();
                for tilt in TILTS {
                    let across = f64::sqrt(1.0 - tilt * tilt);
                    let direction = Vector3::new(across * cos, across * sin, tilt);
                    for size in SIZES {
                        let guess = Guess {
                            force_n: direction * (size * unit_n),
                            arclength_mm,
                        };
                        let Ok(e) = self.solve(point_mm, &guess, Tangential::Frictionless) else {
                            continue;
                        };
                        let same = |(k, _): &StableEquilibrium| {
                            (k.arclength_mm - e.arclength_mm).abs() < SAME_MM
                                && (k.moment_nmm - e.moment_nmm).norm()
                                    < SAME_SHARE * (1e-3 + e.moment_nmm.norm())
                        };
                        if !found.iter().any(same) {
                            found.push((e, self.smallest_eigenvalue(&e)));
                        }
                    }
                }
            }
        }
        found.sort_by(|a, b| a.0.arclength_mm.total_cmp(&b.0.arclength_mm));
        found
    }
}
