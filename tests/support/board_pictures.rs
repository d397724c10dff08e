//! The virtual bench's chessboard before its cameras, as files (SIMULATED): what a person does with
//! a board and a camera's own program.

use std::io::{Read, Result, Write};
use std::net::TcpStream;
use std::path::Path;
use wcal_acquisition::pictures::lossless;
use wcal_core::device::CameraFrame;

/// Bytes before the grey values of a frame (firmware-notes/cameras.md).
const HEADER: usize = 40;

/// The frame after `skip` others.
fn frame(link: &mut TcpStream, skip: usize) -> Result<CameraFrame> {
    let mut found = CameraFrame::default();
    for _ in 0..=skip {
        let mut header = [0; HEADER];
        link.read_exact(&mut header)?;
        let [width_px, height_px] = [4, 8]
            .map(|at| [0, 1, 2, 3].map(|k| header[at + k]))
            .map(u32::from_le_bytes);
        let mut grey = vec![0; width_px as usize * height_px as usize];
        link.read_exact(&mut grey)?;
        found = CameraFrame {
            width_px,
            height_px,
            grey,
            ..CameraFrame::default()
        };
    }
    Ok(found)
}

/// Frames in which the bench must have heard a command: those that were drawn before it are on
/// their way.
const MAX_LATE: usize = 400;
/// Mean difference of grey values beyond the noise.
const OTHER: f64 = 3.0;

/// The second frame that shows something else than `before`.
fn next_view(link: &mut TcpStream, before: &CameraFrame) -> Result<CameraFrame> {
    let difference = |a: &CameraFrame| {
        let sum: f64 = a
            .grey
            .iter()
            .zip(&before.grey)
            .map(|(a, b)| f64::from(a.abs_diff(*b)))
            .sum();
        sum / a.grey.len() as f64
    };
    for _ in 0..MAX_LATE {
        if difference(&frame(link, 0)?) > OTHER {
            return frame(link, 0);
        }
    }
    Err(std::io::Error::other("the bench shows no other picture"))
}

/// Pictures of the board in so many attitudes: `FOLDER/left/VV.png` and `FOLDER/right/VV.png`.
/// `cameras`: addresses of both.
pub(crate) fn board_pictures(cameras: [&str; 2], folder: &Path, views: u32) -> Result<()> {
    let mut first = TcpStream::connect(cameras[0])?;
    let mut left = frame(&mut first, 0)?;
    for view in 0..views {
        first.write_all(format!("board {view}\n").as_bytes())?;
        left = next_view(&mut first, &left)?;
        // Its frames begin after the bench heard of the board.
        let right = frame(&mut TcpStream::connect(cameras[1])?, 1)?;
        for (side, picture) in [("left", &left), ("right", &right)] {
            std::fs::create_dir_all(folder.join(side))?;
            let png = lossless(picture).map_err(std::io::Error::other)?;
            std::fs::write(folder.join(format!("{side}/{view:02}.png")), png)?;
        }
    }
    first.write_all(b"board off\n")?;
    next_view(&mut first, &left).map(drop)
}
