//! All tests of wcal-vision, one program: each would link OpenCV and AprilTag anew.
#![allow(clippy::unwrap_used, reason = "a test that fails should say where")]

mod bad_input;
mod bench_pictures;
mod common;
mod drawn_bench;
mod fisheye_board;
mod marker_boards;
mod opencv_pairs;
mod parts;
mod tag_pictures;
mod uncertainty;
mod wire_accuracy;
