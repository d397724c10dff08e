//! Cameras: V4L2, folders of pictures, and the network stream of the virtual bench.
//!
//! What is assumed of each: firmware-notes/cameras.md.

pub mod folder;
pub mod net;
pub mod v4l2;

pub(crate) use folder::FolderCamera;
pub use net::NetCamera;
pub use v4l2::{V4l2Camera, V4l2Settings};
