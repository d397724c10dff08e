//! Cameras: V4L2, folders of pictures, the network stream of the virtual bench, and pairs with their skew.
//!
//! What is assumed of each: firmware-notes/cameras.md.

pub mod folder;
pub mod net;
pub mod pair;
pub mod v4l2;
pub mod watch;

pub use folder::FolderCamera;
pub use net::NetCamera;
pub use pair::{CameraPair, FramePair};
pub use v4l2::{V4l2Camera, V4l2Settings};
