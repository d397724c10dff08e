//! From a stream of readings to what the tracker takes: filter with a stated lag, noise of the
//! no-contact prefix.
//!
//! Nothing here touches the network; readings come in order of time, and a gap is reported, never
//! interpolated.

pub mod base_pose;
pub(crate) mod low_pass;
pub mod noise;
pub(crate) mod signal_chain;

pub use base_pose::{BaseMotion, BasePose};
pub use low_pass::LowPass;

pub use signal_chain::{Row, SignalChain, SignalChainSettings};
