//! The scene of the virtual bench's cameras; the bench has no own pictures.

/// The bench before the cameras at one moment.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SceneState {
    /// Trajectory that the mount presents.
    pub trajectory: u32,
    /// Depth of the groove past first contact as declared, mm: screw errors and play are in it, the
    /// sensor's delay is not.
    pub depth_mm: f64,
    /// Attitude of the chessboard that is held up; `None`: the bench is seen.
    pub board: Option<usize>,
    /// Exposure relative to the right one.
    pub exposure: f64,
    /// Motion of the second camera in its own frame since the board was shown: mm, and a rotation
    /// vector in degrees.
    pub moved: ([f64; 3], [f64; 3]),
}

/// Makes the pictures; `wcal virtual-bench` brings one that shows the plant's true wire.
pub trait Scene: Send + Sync {
    /// Grey values, row by row, of what camera `camera` (0, 1) sees; `seed` draws the noise.
    fn picture(&self, camera: usize, state: &SceneState, size_px: [u32; 2], seed: u64) -> Vec<u8>;
}
