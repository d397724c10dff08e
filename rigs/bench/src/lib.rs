//! What the virtual bench simulates: the wire in the groove and what cameras see of it. All of it
//! is SIMULATED.
//!
//! Nothing here is shared with the fitter: the wire is a discrete-energy rod ([`rod`]), tabulated
//! along a trajectory ([`table`]), and rendered with the board and the tags of the rig
//! ([`cameras`]).

pub mod cameras;
pub mod rod;
pub mod table;

/// What can go wrong while bending the wire.
#[derive(Debug, thiserror::Error)]
pub enum WireError {
    /// Newton's iteration on the wire did not settle.
    #[error("solving the wire's equilibrium: residual {residual:.2e} left, expected below 1e-8")]
    NoEquilibrium {
        /// Residual of the last iterate.
        residual: f64,
    },
}
