//! The parts one by one; here rather than beside them so that the library is compiled once.

mod camera;
mod chain;
mod exchange;
mod groove;
mod pairs;
mod picture;
mod profile;
mod rig;
mod rigid;
mod rod;
mod wire;
