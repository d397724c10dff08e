//! Random whisker-bench sessions with effects that the session does not declare: the examiner's own
//! physics.
//!
//! Nothing here is shared with the fitter: the wire is the virtual bench's discrete-energy rod
//! ([`rod`]), the readings follow the session's true sequence and times ([`simulate`]), the noise
//! is as instruments make it ([`noise`]), and several laws stand behind every effect ([`effects`]).
//! All data made here are simulated.

pub mod adversarial;
pub mod bench;
pub mod case;
pub mod contacts;
pub mod effects;
pub mod friction;
pub mod layout;
pub mod memory;
pub mod noise;
pub mod rivals;
pub mod scalar;
pub mod section;
pub mod session;
pub mod shapes;
pub mod simulate;
pub mod sweep;

pub use wcal_bench::{WireError, cameras, rod, table};

pub use case::{Case, CaseKind, Make, Request, Truth};
pub use effects::{Effect, Kind};
pub use layout::Design;
pub use noise::Noise;
pub use scalar::{
    EffectSize, Layout, ScalarCase, ScalarEffect, ScalarNoise, ScalarRequest, StatedLaw,
};
pub use session::{draw, draw_under};

/// What can go wrong while drawing or writing a session.
#[derive(Debug, thiserror::Error)]
pub enum PlantError {
    /// The wire has no equilibrium.
    #[error(transparent)]
    Wire(#[from] WireError),
    /// A file could not be written.
    #[error("writing {path}: {source}")]
    Write {
        /// File.
        path: String,
        /// Cause.
        source: std::io::Error,
    },
}
