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
    /// Rough distance of two wires, 1 where a step from one to the other is worth trying.
    pub(crate) fn distance(&self, other: &Self) -> f64 {
        let softening = |m: &Self| match m.softening {
            None => (0.0, 1.0, 0.0_f64),
            Some(Softening::Bilinear { onset_per_m, ratio }) => (1.0 - ratio, onset_per_m, 1.0),
            Some(Softening::Section {
                onset_per_m,
                hardening,
            }) => (1.0 - hardening, onset_per_m, 2.0),
        };
        let ((a, a_onset, a_law), (b, b_onset, b_law)) = (softening(self), softening(other));
        // Each change in the size from which a continuation from the other wire begins to fail.
        let mut sum: f64 = ((a - b) / 0.2).powi(2) + ((self.taper - other.taper) / 0.2).powi(2);
        if a > 0.0 && b > 0.0 {
            sum += ((a_onset - b_onset) / 10.0).powi(2) + (a_law - b_law).powi(2);
        }
        for k in 0..3 {
            sum += ((self.offset_mm[k] - other.offset_mm[k]) / 0.5).powi(2);
        }
        sum += (self.straight_change_mm - other.straight_change_mm).powi(2);
        sum += (self.arc_radius_change_mm - other.arc_radius_change_mm).powi(2);
        for k in 0..2 {
            sum +=
                ((self.compliance_rad_per_nmm[k] - other.compliance_rad_per_nmm[k]) / 5e-3).powi(2);
        }
        sum.sqrt()
            + if self.weight == other.weight {
                0.0
            } else {
                f64::INFINITY
            }
    }

    pub(crate) fn key(&self) -> Vec<u64> {
        let mut key: Vec<u64> = self.offset_mm.iter().map(|v| v.to_bits()).collect();
        key.extend(self.compliance_rad_per_nmm.iter().map(|v| v.to_bits()));
        match self.softening {
            None => key.push(0),
            Some(Softening::Bilinear { onset_per_m, ratio }) => {
                key.extend([1, onset_per_m.to_bits(), ratio.to_bits()]);
            }
            Some(Softening::Section {
                onset_per_m,
                hardening,
            }) => {
                key.extend([2, onset_per_m.to_bits(), hardening.to_bits()]);
            }
        }
        let further = [
            self.taper,
            self.weight,
            self.straight_change_mm,
            self.arc_radius_change_mm,
        ];
        key.extend(further.map(f64::to_bits));
        key
    }
}
