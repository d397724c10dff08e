//! From a stream of readings to what the tracker takes and to events: filter with a stated lag, noise of the no-contact prefix, events.
//!
//! Nothing here touches the network; readings come in order of time, and a gap is reported, never interpolated.

pub mod base_pose;
pub mod change_point;
pub mod event;
pub mod events;
pub mod first_mode;
pub mod low_pass;
pub mod noise;
pub mod signal_chain;

pub use base_pose::{BaseMotion, BasePose};
pub use event::{ContactEvent, EventKind, EventSettings};
pub use events::EventDetector;
pub use first_mode::first_mode_hz;
pub use low_pass::LowPass;
pub use noise::{Noise, Thresholds};
pub use signal_chain::{Row, SignalChain, SignalChainSettings};
