//! What a medium at rest or in flow does to a wire: weight less buoyancy, and drag, per length.
//!
//! Drag across the wire -1/2 rho C D |v| v, v the velocity past the medium less its part along the
//! wire, C = 1 + 10 Re^(-2/3), Re = |v| D / nu (cylinder, 1 < Re < 2e5: F. M. White, "Viscous Fluid
//! Flow", 1991). Added mass, and drag along the wire, are left out.

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

/// What a medium does to a wire.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FluidLoads {
    /// Diameter of the wire, m.
    pub diameter_m: f64,
    /// Density of the medium, kg/m^3, and its kinematic viscosity, m^2/s.
    pub density_kg_m3: f64,
    /// See `density_kg_m3`.
    pub viscosity_m2_s: f64,
    /// Weight less buoyancy, N/mm.
    pub weight_n_per_mm: Vector3<f64>,
    /// Velocity of the medium, mm/s.
    pub current_mm_s: Vector3<f64>,
}

impl FluidLoads {
    /// Drag across a wire along `tangent` that moves at `velocity_mm_s`, N/mm. That along the wire
    /// and the added mass are left out.
    ///
    /// Drag coefficient `1 + 10 Re^(-2/3)` of a cylinder across the flow (F. M. White, Viscous
    /// Fluid Flow, 1991).
    fn drag_n_per_mm(&self, tangent: &Vector3<f64>, velocity_mm_s: &Vector3<f64>) -> Vector3<f64> {
        // Slender body: only the flow across the wire drags it.
        let past = (velocity_mm_s - self.current_mm_s) * 1e-3;
        let across = past - tangent * tangent.dot(&past);
        let speed = across.norm();
        if speed < 1e-9 {
            return Vector3::zeros();
        }
        // C |v| v goes to zero with v, as |v|^(4/3).
        let reynolds = speed * self.diameter_m / self.viscosity_m2_s;
        let coefficient = 1.0 + 10.0 * reynolds.powf(-2.0 / 3.0);
        -across * (0.5 * self.density_kg_m3 * coefficient * self.diameter_m * speed * 1e-3)
    }

    /// Weight and drag along a wire, N/mm.
    pub fn load_n_per_mm(
        &self,
        tangent: &Vector3<f64>,
        velocity_mm_s: &Vector3<f64>,
    ) -> Vector3<f64> {
        self.weight_n_per_mm + self.drag_n_per_mm(tangent, velocity_mm_s)
    }
}
