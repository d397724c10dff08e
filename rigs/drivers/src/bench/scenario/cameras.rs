//! `[cameras]` of a scenario: optics and faults.

use serde::Deserialize;

/// Cameras.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct CameraScenario {
    /// How many: 0 or 2.
    pub count: usize,
    /// Pictures per second.
    pub rate_hz: f64,
    /// Width and height, px.
    pub size_px: [u32; 2],
    /// Delay of the second camera, ms.
    pub skew_ms: f64,
    /// Side of the blocks of pixels that are read as one while stage or mount move; 1: none.
    pub moving_binning: u32,
    /// Exposure relative to the right one; 3 saturates the white of the tags.
    pub exposure: f64,
    /// Blur of the lenses (standard deviation), px.
    pub blur_px: f64,
    /// Read noise, grey values; shot noise comes with the light.
    pub noise_dn: f64,
    /// Relative fall of the light from one side of a picture to the other, and toward its corners.
    pub uneven_light: [f64; 2],
    /// Attitudes of the chessboard: `board K` shows K from 0 to this less one.
    pub board_views: usize,
    /// Inner corners of the board.
    pub board_corners: [usize; 2],
    /// Stated side of its squares, mm.
    pub board_square_mm: f64,
    /// What is wrong with the cameras and not declared.
    pub errors: CameraErrors,
}

impl Default for CameraScenario {
    fn default() -> Self {
        Self {
            count: 2,
            rate_hz: 5.0,
            size_px: [640, 480],
            skew_ms: 0.0,
            moving_binning: 4,
            exposure: 1.0,
            blur_px: 0.6,
            noise_dn: 0.8,
            uneven_light: [0.12, 0.10],
            board_views: 12,
            board_corners: [9, 6],
            board_square_mm: 6.0,
            errors: CameraErrors::default(),
        }
    }
}

/// Errors of cameras and tags.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct CameraErrors {
    /// Shift of the second camera in its own frame after the board was shown, mm.
    pub moved_mm: [f64; 3],
    /// Its rotation vector, degrees.
    pub moved_deg: [f64; 3],
    /// True over stated side of the board's squares.
    pub board_scale: f64,
    /// Shift of the rig tag in its own frame from where the rig file puts it, mm.
    pub rig_tag_mm: [f64; 3],
    /// Its rotation vector, degrees.
    pub rig_tag_deg: [f64; 3],
}

impl Default for CameraErrors {
    fn default() -> Self {
        let none = [0.0; 3];
        Self {
            moved_mm: none,
            moved_deg: none,
            board_scale: 1.0,
            rig_tag_mm: none,
            rig_tag_deg: none,
        }
    }
}
