//! Cameras that see the plant's bench: two distorted pinholes, the true wire, V-groove, AprilTags
//! and a chessboard.
//!
//! Radiance `L(x, y)` of a picture point is the shade of the nearest surface on its ray times the
//! uneven light there. A pixel is `E = t (B * mean of L over the pixel)` with exposure `t` and the
//! lens blur `B` (Gaussian), then noise of variance `r^2 + g E` (read and shot noise; EMVA 1288,
//! release 4.0, section 2.2) and 8 bits that saturate. The mean over a pixel is taken exactly for
//! the wire, whose image is a strip about the projected centre line, and over the 34 points of a
//! Fibonacci lattice for the edges of flat surfaces.
//!
//! Nothing here is shared with the program's own picture code; lengths in mm, the base frame, pixel
//! centres at integers. All pictures made here are simulated.

mod faces;
mod lens;
mod picture;
mod rig;
mod scene;
mod tags;

pub use lens::Lens;

pub use picture::{Appearance, clean, exposed};
pub use rig::{Board, CameraFaults, RigGeometry, default_pair};
pub use scene::{Groove, View};

pub use tags::tag_cells;
