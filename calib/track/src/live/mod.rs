//! From a stream of readings to what the tracker takes and to events: filter with a stated lag, noise of the no-contact prefix, events.
//!
//! Nothing here touches the network; readings come in order of time, and a gap is told, never bridged.

pub mod base;
pub mod chain;
pub mod event;
pub mod events;
pub mod filter;
pub mod locate;
pub mod noise;
pub mod wire;

pub use base::{BaseMotion, BasePose};
pub use chain::{Chain, ChainSettings, Row};
pub use event::{ContactEvent, EventKind, EventSettings};
pub use events::EventDetector;
pub use filter::LowPass;
pub use noise::{Noise, Thresholds};
pub use wire::first_mode_hz;
