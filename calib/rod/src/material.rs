//! Section stiffness: bending, torsion, taper along the wire, and softening past a yield curvature.
//!
//! du = (m1 / GJ, m2 / EI, m3 / EI) / c(s), c(s) = (1 + (e - 1) s/L)^4 with e^4 = 1 + taper (a
//! diameter that changes linearly). Past the onset kappa_y (change of curvature) the bending part
//! is scaled: |M| = EI kappa_y y(x), x = |du| / kappa_y, with y(x) the [`Softening`]. The circular
//! section's y is the integral of its stress: elastic inside |z| < q radius, flat beyond.

use crate::dual::{Scalar, V3};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::f64::consts::PI;

/// How the moment-curvature relation bends over past the onset.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(tag = "law", rename_all = "kebab-case")]
pub enum Softening {
    /// Two straight lines: stiffness falls to `ratio` EI past the onset.
    Bilinear {
        /// Onset curvature (change from rest), 1/m.
        onset_per_m: f64,
        /// Tangent stiffness past the onset over EI, 0..1.
        ratio: f64,
    },
    /// Circular section whose stress is flat past the transformation strain, plus a hardening
    /// share: M/M_y = 2/(3 pi) [ (5 - 2 q^2) sqrt(1 - q^2) + 3 asin(q)/q ], q = onset/curvature; it
    /// tends to 16/(3 pi) = 1.698.
    Section {
        /// Onset curvature (change from rest), 1/m.
        onset_per_m: f64,
        /// Share of EI that stays linear, 0..1.
        hardening: f64,
    },
}

impl Softening {
    /// Change of curvature past which the wire softens, 1/mm.
    pub fn onset_per_mm(self) -> f64 {
        match self {
            Self::Bilinear { onset_per_m, .. } | Self::Section { onset_per_m, .. } => {
                onset_per_m * 1e-3
            }
        }
    }

    /// Moment over EI times onset, and its slope, at `x` = curvature / onset >= 0.
    pub fn relative_moment(self, x: f64) -> (f64, f64) {
        if x <= 1.0 {
            return (x, 1.0);
        }
        match self {
            Self::Bilinear { ratio, .. } => (1.0 + ratio * (x - 1.0), ratio),
            Self::Section { hardening, .. } => {
                let q = 1.0 / x;
                let root = (1.0 - q * q).sqrt();
                let value = 2.0 / (3.0 * PI) * ((5.0 - 2.0 * q * q) * root + 3.0 * q.asin() * x);
                // Only the elastic core carries more: share of the second moment of area inside |y|
                // < q.
                let slope = 2.0 / PI * (q.asin() - q * (1.0 - 2.0 * q * q) * root);
                (
                    (1.0 - hardening) * value + hardening * x,
                    (1.0 - hardening) * slope + hardening,
                )
            }
        }
    }

    /// Integral of the relative moment up to `x`.
    pub fn relative_energy(self, x: f64) -> f64 {
        if x <= 1.0 {
            return 0.5 * x * x;
        }
        match self {
            Self::Bilinear { ratio, .. } => 0.5 + (x - 1.0) + 0.5 * ratio * (x - 1.0).powi(2),
            Self::Section { hardening, .. } => {
                let q = 1.0 / x;
                let root = (x * x - 1.0).sqrt();
                // Integral of the plateau's law from x = 1 on, where the elastic energy is 1/2.
                let flat = 2.0 / (3.0 * PI)
                    * (1.5 * x * x * q.asin() + (6.5 + q * q) * root - 6.0 * q.acos());
                (1.0 - hardening) * flat + hardening * 0.5 * x * x
            }
        }
    }

    /// Curvature over onset, and its slope, at relative moment `y` >= 0.
    pub(crate) fn relative_curvature(self, y: f64) -> (f64, f64) {
        if y <= 1.0 {
            return (y, 1.0);
        }
        // Newton from below on a concave law: its tangent lies above, so that no step goes too far.
        let mut x = y;
        for _ in 0..60 {
            let (value, slope) = self.relative_moment(x);
            let step = (y - value) / slope.max(1e-4);
            // Past the plateau no curvature carries the moment; the cap keeps Newton finite and the
            // outer solve fails cleanly.
            let next = (x + step).clamp(1.0, 60.0);
            if (next - x).abs() < 1e-13 * x {
                x = next;
                break;
            }
            x = next;
        }
        (x, 1.0 / self.relative_moment(x).1.max(1e-4))
    }
}

/// Section of the wire.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Section {
    /// Bending stiffness at the root, N mm^2.
    pub ei_nmm2: f64,
    /// Torsional stiffness at the root, N mm^2.
    pub gj_nmm2: f64,
    /// Relative change of EI from root to tip; the diameter changes linearly and EI with its fourth
    /// power.
    pub taper: f64,
    /// Softening past a yield curvature.
    pub softening: Option<Softening>,
}

impl Section {
    /// Round wire: `EI = E pi d^4 / 64`, `GJ = G pi d^4 / 32`.
    pub fn round(diameter_mm: f64, youngs_gpa: f64, shear_gpa: f64) -> Self {
        let d4 = diameter_mm.powi(4);
        Self {
            ei_nmm2: youngs_gpa * 1e3 * PI * d4 / 64.0,
            gj_nmm2: shear_gpa * 1e3 * PI * d4 / 32.0,
            taper: 0.0,
            softening: None,
        }
    }

    /// EI(s)/EI(0) at `fraction` = s/L.
    pub(crate) fn taper_factor(&self, fraction: f64) -> f64 {
        if self.taper == 0.0 {
            return 1.0;
        }
        // Diameter of the tip over that of the root, from the ratio of the stiffnesses.
        let end = (1.0 + self.taper).max(1e-3).powf(0.25);
        (1.0 + (end - 1.0) * fraction).powi(4)
    }

    /// Change of body curvature (1/mm) under the body moment `m` (N mm) where the stiffness is
    /// `factor` times the root's.
    #[inline(always)]
    pub(crate) fn curvature_change<T: Scalar>(&self, m: &V3<T>, factor: f64) -> V3<T> {
        let twist = m[0].scale(1.0 / (self.gj_nmm2 * factor));
        let ei = self.ei_nmm2 * factor;
        let linear = [twist, m[1].scale(1.0 / ei), m[2].scale(1.0 / ei)];
        let Some(softening) = self.softening else {
            return linear;
        };
        let onset = softening.onset_per_mm();
        let squared = linear[1] * linear[1] + linear[2] * linear[2];
        let y = squared.value().sqrt() / onset;
        if y <= 1.0 {
            return linear;
        }
        let (x, slope) = softening.relative_curvature(y);
        // gain = x/y as a function of squared = (y onset)^2
        let gain = x / y;
        let d_gain_d_squared = (slope - gain) / (2.0 * y * y * onset * onset);
        let gain = squared.chain(gain, d_gain_d_squared);
        [twist, linear[1] * gain, linear[2] * gain]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dual::Dual3;

    #[test]
    fn section_law_is_continuous_and_tends_to_the_plastic_moment() {
        let law = Softening::Section {
            onset_per_m: 40.0,
            hardening: 0.0,
        };
        assert!((law.relative_moment(1.0 + 1e-9).0 - 1.0).abs() < 1e-8);
        assert!((law.relative_moment(1e6).0 - 16.0 / (3.0 * PI)).abs() < 1e-6);
        for x in [1.1, 1.7, 3.0] {
            let d = (law.relative_moment(x + 1e-6).0 - law.relative_moment(x - 1e-6).0) / 2e-6;
            assert!((d - law.relative_moment(x).1).abs() < 1e-8, "slope at {x}");
            let work = (law.relative_energy(x + 1e-6) - law.relative_energy(x - 1e-6)) / 2e-6;
            assert!(
                (work - law.relative_moment(x).0).abs() < 1e-8,
                "energy at {x}"
            );
            let (back, _) = law.relative_curvature(law.relative_moment(x).0);
            assert!((back - x).abs() < 1e-9);
        }
    }

    #[test]
    fn curvature_derivative_matches_finite_differences() {
        for softening in [
            Softening::Bilinear {
                onset_per_m: 30.0,
                ratio: 0.4,
            },
            Softening::Section {
                onset_per_m: 30.0,
                hardening: 0.1,
            },
        ] {
            let mut section = Section::round(0.3, 75.0, 28.0);
            section.softening = Some(softening);
            let m = [0.3, 1.1, -0.4];
            let dual = section.curvature_change(&[0, 1, 2].map(|i| Dual3::variable(m[i], i)), 0.9);
            for j in 0..3 {
                let (mut hi, mut lo) = (m, m);
                hi[j] += 1e-6;
                lo[j] -= 1e-6;
                let (hi, lo) = (
                    section.curvature_change(&hi, 0.9),
                    section.curvature_change(&lo, 0.9),
                );
                for i in 0..3 {
                    let fd = (hi[i] - lo[i]) / 2e-6;
                    assert!(
                        (fd - dual[i].partial(j)).abs() < 1e-7,
                        "{softening:?} {i} {j}"
                    );
                }
            }
        }
    }
}
