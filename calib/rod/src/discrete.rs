//! The wire as rigid links with springs at their joints: rest turns and stiffness.
//!
//! Rest turn w0_j = int u0 over the wire that joint j stands for, stiffness K_j = diag(GJ, EI, EI)
//! / span_j. Joints lie between link centres; the clamp's spring spans half a link, which makes the
//! scheme second order at the root. Source: M. Bergou et al., "Discrete Elastic Rods", ACM TOG 27
//! (2008), with rigid links for the inextensible wire.

use crate::{Rod, RodError, Section, Shape, Softening};
use nalgebra::{Matrix3, Vector3};

/// Links of equal length from a clamp.
#[derive(Debug, Clone, PartialEq)]
pub struct DiscreteRod {
    /// Length of a link, mm.
    pub link_mm: f64,
    /// Radius of the wire, mm.
    pub radius_mm: f64,
    /// Rest turn (rad, frame of the link beyond) and stiffness (N mm/rad) of every joint, the
    /// clamp's first.
    joints: Vec<(Vector3<f64>, Vector3<f64>)>,
    clamp: Matrix3<f64>,
    softening: Option<Softening>,
    /// Turn of the clamp by the moment that it carries, base axes, rad/(N mm).
    pub(crate) compliance: Vector3<f64>,
}

impl DiscreteRod {
    /// `links` rigid links for a wire of `section` and `diameter_mm` (mm) that is at rest in
    /// `shape`.
    ///
    /// # Errors
    /// Without links, or where the wire has no thickness or stiffness.
    pub fn new(
        section: &Section,
        shape: &Shape,
        diameter_mm: f64,
        links: usize,
    ) -> Result<Self, RodError> {
        if links < 2 || !(diameter_mm > 0.0) || !(section.ei_nmm2 > 0.0 && section.gj_nmm2 > 0.0) {
            return Err(RodError::Shape {
                expected: "two links or more, diameter and stiffness above 0",
                found: format!(
                    "{links} links, diameter {diameter_mm} mm, EI {} N mm2",
                    section.ei_nmm2
                ),
            });
        }
        let link_mm = shape.length_mm / links as f64;
        // A joint stands for the wire between the middles of its two links; the first from the
        // clamp to the middle of link 0.
        let joints = (0..links)
            .map(|j| {
                let (from, to) = (
                    (j as f64 - 0.5).max(0.0) * link_mm,
                    (j as f64 + 0.5) * link_mm,
                );
                let span = to - from;
                // D / span, at the diameter of the span's middle.
                let factor = section.taper_factor((from + to) / 2.0 / shape.length_mm) / span;
                // A spring for the bending that the rod spreads over the span.
                let stiffness =
                    Vector3::new(section.gj_nmm2, section.ei_nmm2, section.ei_nmm2) * factor;
                (turn(shape, from, to), stiffness)
            })
            .collect();
        let (radius_mm, clamp) = (diameter_mm / 2.0, shape.root);
        Ok(Self {
            link_mm,
            radius_mm,
            joints,
            clamp,
            softening: section.softening,
            compliance: Vector3::zeros(),
        })
    }

    /// Of a rod with its section's law and its clamp's compliance; without its weight.
    ///
    /// # Errors
    /// As [`Self::new`].
    pub fn of_rod(rod: &Rod, diameter_mm: f64, links: usize) -> Result<Self, RodError> {
        let compliance = rod.compliance_axes * rod.compliance_rad_per_nmm;
        Ok(Self {
            compliance,
            ..Self::new(&rod.section, &rod.shape, diameter_mm, links)?
        })
    }

    /// Turn of a joint from its rest, rad, where a linear one turns by `linear`: past the onset
    /// bending is softer.
    pub(crate) fn softened(&self, joint: usize, linear: Vector3<f64>) -> Vector3<f64> {
        let Some(softening) = self.softening else {
            return linear;
        };
        let span_mm = if joint == 0 {
            self.link_mm / 2.0
        } else {
            self.link_mm
        };
        // The linear turn by the span over the onset's curvature is the relative moment y.
        let bend = linear.y.hypot(linear.z) / (span_mm * softening.onset_per_mm());
        let gain = if bend > 1.0 {
            softening.relative_curvature(bend).0 / bend
        } else {
            1.0
        };
        Vector3::new(linear.x, gain * linear.y, gain * linear.z)
    }

    /// Number of links.
    pub fn links(&self) -> usize {
        self.joints.len()
    }

    /// Rest turn (rad, frame of the link beyond) and stiffness (N mm/rad) of every joint, the
    /// clamp's first.
    pub fn joints(&self) -> &[(Vector3<f64>, Vector3<f64>)] {
        &self.joints
    }

    /// Frame of the clamp.
    pub fn clamp_frame(&self) -> Matrix3<f64> {
        self.clamp
    }
}

/// Rest turn between two arc lengths, rad: integral of the rest curvature.
fn turn(shape: &Shape, from_mm: f64, to_mm: f64) -> Vector3<f64> {
    let mut total = Vector3::zeros();
    for interval in &shape.intervals {
        let a = from_mm.max(interval.start_mm);
        let b = to_mm.min(interval.start_mm + interval.length_mm);
        if b > a {
            // u0 is linear here: its value in the middle times the length is the integral.
            let middle = (a + b) / 2.0 - interval.start_mm;
            let u = Vector3::from(interval.u_start) + Vector3::from(interval.u_slope) * middle;
            total += u * (b - a);
        }
    }
    total
}
