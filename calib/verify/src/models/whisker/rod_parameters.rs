//! What effects change of wire, root and groove.

use wcal_rod::Softening;

/// Mechanical deviations from the nominal whisker and bench.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RodParameters {
    /// Constant offset of the groove, mm.
    pub offset_mm: [f64; 3],
    /// Root compliance about base y and z, rad/(N mm).
    pub compliance_rad_per_nmm: [f64; 2],
    /// Softening of the wire.
    pub softening: Option<Softening>,
    /// Relative change of EI from root to tip.
    pub taper: f64,
    /// Straight part less the declared one, mm.
    pub straight_change_mm: f64,
    /// Radius of the arc less the declared one, mm.
    pub arc_radius_change_mm: f64,
    /// Share of the wire's weight that acts (0 undeclared, 1 full).
    pub weight: f64,
    /// Friction coefficient along the wire; independent of the tables.
    pub friction: f64,
    /// Friction while the groove moves over friction at rest.
    pub moving_share: f64,
}

impl Default for RodParameters {
    fn default() -> Self {
        Self {
            offset_mm: [0.0; 3],
            compliance_rad_per_nmm: [0.0; 2],
            softening: None,
            taper: 0.0,
            straight_change_mm: 0.0,
            arc_radius_change_mm: 0.0,
            weight: 0.0,
            friction: 0.0,
            moving_share: 1.0,
        }
    }
}

impl RodParameters {
    /// What makes another wire or root, each with the size of a change from which a continuation
    /// from the other wire begins to fail; law and onset of the softening last.
    fn numbers(&self) -> [(f64, f64); 12] {
        let [x, y, z] = self.offset_mm.map(|mm| (mm, 0.5));
        let [about_y, about_z] = self.compliance_rad_per_nmm.map(|c| (c, 5e-3));
        let (share, onset_per_m, law) = match self.softening {
            None => (0.0, 1.0, 0.0),
            Some(Softening::Bilinear { onset_per_m, ratio }) => (1.0 - ratio, onset_per_m, 1.0),
            Some(Softening::Section {
                onset_per_m,
                hardening,
            }) => (1.0 - hardening, onset_per_m, 2.0),
        };
        [
            x,
            y,
            z,
            about_y,
            about_z,
            (share, 0.2),
            (self.taper, 0.2),
            (self.straight_change_mm, 1.0),
            (self.arc_radius_change_mm, 1.0),
            // From a wire of another weight no continuation is tried.
            (self.weight, f64::MIN_POSITIVE),
            (onset_per_m, 10.0),
            (law, 1.0),
        ]
    }

    /// Rough distance of two wires, 1 where a step from one to the other is worth trying.
    pub(super) fn distance(&self, other: &Self) -> f64 {
        // Without softening it has no law.
        let counted = if self.softening.is_some() && other.softening.is_some() {
            12
        } else {
            10
        };
        let both = self.numbers().into_iter().zip(other.numbers());
        let square = |((a, size), (b, _)): ((f64, f64), (f64, f64))| ((a - b) / size).powi(2);
        both.take(counted).map(square).sum::<f64>().sqrt()
    }

    /// Numbers of which equal ones are equal wires; friction acts on their tables.
    pub(super) fn key(&self) -> Vec<u64> {
        self.numbers().map(|(value, _)| value.to_bits()).to_vec()
    }
}
