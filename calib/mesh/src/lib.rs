//! Objects that a whisker touches: triangle meshes with their signed distance.
//!
//! Lengths in mm, in the object's own frame.

mod error;
mod grid;
pub mod mesh;
pub mod mesh_file;
mod outside;
pub mod stl;

pub use error::MeshError;
pub use mesh::{ClosestPoint, Mesh};
