//! Wires that are neither uniform nor linear, and arc lengths along any of them.

use crate::rod::{Section, Wire};

/// Section of a wire by its laws.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct WireSection {
    /// Stiffness along the wire.
    pub taper: Taper,
    /// Moment-curvature law.
    pub law: MomentLaw,
}

impl Section for WireSection {
    fn stiffness(&self, fraction: f64) -> f64 {
        self.taper.factor(fraction)
    }

    fn curvature(&self, linear: f64) -> f64 {
        self.law.curvature(linear)
    }
}

/// How the bending moment answers to the change of curvature.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum MomentLaw {
    /// Linear.
    #[default]
    Linear,
    /// Tangent stiffness falls to `ratio` times its value past the curvature `onset_per_mm` (1/mm).
    Bilinear {
        /// Onset in 1/mm.
        onset_per_mm: f64,
        /// Tangent stiffness past the onset, relative.
        ratio: f64,
    },
    /// Round section whose stress stays on its plateau past the onset: the moment tends to 1.70 x
    /// its onset value.
    Plateau {
        /// Onset in 1/mm.
        onset_per_mm: f64,
    },
}

impl MomentLaw {
    /// Change of curvature (1/mm) that a linear wire's change of curvature `linear` (moment / EI)
    /// becomes.
    fn curvature(self, linear: f64) -> f64 {
        match self {
            Self::Linear => linear,
            Self::Bilinear {
                onset_per_mm,
                ratio,
            } => {
                if linear <= onset_per_mm {
                    linear
                } else {
                    onset_per_mm + (linear - onset_per_mm) / ratio
                }
            }
            Self::Plateau { onset_per_mm } => {
                let want = linear / onset_per_mm;
                if want <= 1.0 {
                    return linear;
                }
                // Newton in curvature / onset; the slope is the share of EI that the elastic core
                // keeps.
                let limit = 16.0 / (3.0 * std::f64::consts::PI);
                let mut bent = ((limit - 1.0) / (limit - want).max(1e-4)).sqrt();
                for _ in 0..40 {
                    let c = 1.0 / bent;
                    let step = (want - plateau_moment(c)) / plateau_slope(c);
                    bent = (bent + step).clamp(0.5 * (1.0 + bent), 3.0 * bent).min(1e3);
                    if step.abs() < 1e-13 * bent {
                        break;
                    }
                }
                onset_per_mm * bent
            }
        }
    }
}

/// Moment over onset moment of a round section with an elastic core of relative half height `c`.
fn plateau_moment(c: f64) -> f64 {
    let root = (1.0 - c * c).max(0.0).sqrt();
    let core = (c.asin() - c * root * (1.0 - 2.0 * c * c)) / (2.0 * c);
    let flange = 4.0 / 3.0 * root.powi(3);
    (core + flange) / (std::f64::consts::PI / 4.0)
}

/// Share of EI that the elastic core of relative half height `c` keeps.
fn plateau_slope(c: f64) -> f64 {
    let root = (1.0 - c * c).max(0.0).sqrt();
    2.0 / std::f64::consts::PI * (c.asin() - c * root * (1.0 - 2.0 * c * c))
}

/// How the stiffness runs along the wire.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum Taper {
    /// Uniform.
    #[default]
    None,
    /// EI(s) = EI (1 + e s / L).
    Linear(f64),
    /// d(s) linear, EI ~ d^4, with EI(L) = EI (1 + e).
    Cone(f64),
}

impl Taper {
    fn factor(self, fraction: f64) -> f64 {
        match self {
            Self::None => 1.0,
            Self::Linear(e) => 1.0 + e * fraction,
            // EI goes with the fourth power of a diameter that is linear along the wire.
            Self::Cone(e) => (1.0 + ((1.0 + e).powf(0.25) - 1.0) * fraction).powi(4),
        }
    }
}

/// Arc lengths of the points of [`Wire::centre_line`], mm.
pub fn centre_line_arcs(wire: &Wire, contact_mm: f64, step_mm: f64) -> Vec<f64> {
    let each = |(w, count): ([f64; 2], usize)| {
        (1..=count).map(move |i| w[0] + (w[1] - w[0]) * i as f64 / count as f64)
    };
    std::iter::once(0.0)
        .chain(wire.pieces(contact_mm, step_mm).into_iter().flat_map(each))
        .collect()
}
