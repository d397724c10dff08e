//! scaffold
pub mod rod;
pub mod table;
/// Errors.
#[derive(Debug, thiserror::Error)]
pub enum PlantError {
    /// No equilibrium.
    #[error("solving the wire's equilibrium: residual {residual:.2e} mm left, expected below 1e-8")]
    NoEquilibrium {
        /// Residual.
        residual: f64,
    },
}
