//! Pictures of a recording: how frames are stored, and the pairs of the settled poses as files of
//! the session.
//!
//! Of every frame the recording has a [`FrameInfo`]; of those that show a settled pose the picture
//! itself, lossless (PNG); of the others now and then a small one for people (JPEG).

use crate::clocks::ClockFit;
use crate::error::AcquisitionError;
use crate::message::FrameInfo;
use crate::replay::{Message, read};
use image::codecs::jpeg::JpegEncoder;
use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{ExtendedColorType, ImageEncoder};
use std::collections::{BTreeMap, HashMap, HashSet};
use std::path::{Path, PathBuf};
use wcal_core::device::CameraFrame;
use wcal_core::files::{FileError, write_atomic};
use wcal_core::provenance::sha256_hex;

/// Folder of the session.
pub(crate) const PICTURES: &str = "pictures";
/// Least time between two previews of a camera, s.
pub(crate) const PREVIEW_PERIOD_S: f64 = 1.0;
/// Width of a preview at most, px.
const PREVIEW_WIDTH: u32 = 320;
/// Quality of a preview, percent.
const PREVIEW_QUALITY: u8 = 60;

/// The frame without loss, as PNG.
///
/// # Errors
/// When the grey values are not those of the size.
pub fn lossless(frame: &CameraFrame) -> Result<Vec<u8>, AcquisitionError> {
    check_whole(frame)?;
    let mut bytes = Vec::new();
    let encoder =
        PngEncoder::new_with_quality(&mut bytes, CompressionType::Default, FilterType::Adaptive);
    encoder
        .write_image(
            &frame.grey,
            frame.width_px,
            frame.height_px,
            ExtendedColorType::L8,
        )
        .map_err(|e| AcquisitionError::Recorder(format!("picture of a pose: {e}")))?;
    Ok(bytes)
}

/// Exposure as the camera reports it, or as it was asked for, s.
pub(crate) fn exposure_s(frame: &CameraFrame) -> Option<f64> {
    let exposure_ms = frame.measured_exposure_ms.or(frame.commanded_exposure_ms);
    exposure_ms.map(|ms| ms * 1e-3)
}

/// The encoders panic on a frame that was cut short; a camera may send one.
fn check_whole(frame: &CameraFrame) -> Result<(), AcquisitionError> {
    let expected = u64::from(frame.width_px) * u64::from(frame.height_px);
    if frame.grey.len() as u64 == expected {
        return Ok(());
    }
    Err(AcquisitionError::Recorder(format!(
        "a frame of {} x {} px has {} grey values, expected {expected}",
        frame.width_px,
        frame.height_px,
        frame.grey.len()
    )))
}

/// The frame for people: means over blocks of pixels, as JPEG.
///
/// # Errors
/// When the grey values are not those of the size.
pub fn preview(frame: &CameraFrame) -> Result<Vec<u8>, AcquisitionError> {
    check_whole(frame)?;
    let block = frame.width_px.div_ceil(PREVIEW_WIDTH).max(1);
    let (width, height) = (frame.width_px / block, frame.height_px / block);
    let at = |x: u32, y: u32| {
        frame
            .grey
            .get((y * frame.width_px + x) as usize)
            .copied()
            .unwrap_or(0)
    };
    let mean = |x: u32, y: u32| {
        let rows = (y * block..(y + 1) * block)
            .flat_map(|y| (x * block..(x + 1) * block).map(move |x| (x, y)));
        (rows.map(|(x, y)| u32::from(at(x, y))).sum::<u32>() / (block * block)) as u8
    };
    let small: Vec<u8> = (0..height)
        .flat_map(|y| (0..width).map(move |x| (x, y)))
        .map(|(x, y)| mean(x, y))
        .collect();
    let mut bytes = Vec::new();
    JpegEncoder::new_with_quality(&mut bytes, PREVIEW_QUALITY)
        .write_image(&small, width, height, ExtendedColorType::L8)
        .map_err(|e| AcquisitionError::Recorder(format!("preview: {e}")))?;
    Ok(bytes)
}

/// A row of the session that has pictures: recording, step, and the row's place.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct PicturedRow {
    /// Which recording, from 0.
    pub part: usize,
    /// Step of the plan.
    pub step: u32,
    /// Its number in points.csv, or in holdout.csv.
    pub point: usize,
    /// Of holdout.csv.
    pub sealed: bool,
}

/// Clocks of one recording: the interrogator's, the cameras' by name, and device time of the
/// session's first scan, s.
#[derive(Debug, Clone, Default)]
pub(crate) struct PartClocks {
    /// Interrogator.
    pub interrogator: Option<ClockFit>,
    /// Cameras by name.
    pub cameras: BTreeMap<String, ClockFit>,
    /// Device time of the first scan, s.
    pub origin_s: f64,
}

impl PartClocks {
    /// Start of exposure on the session's time axis, s: from the camera's clock to the host's and
    /// on to the interrogator's.
    fn session_s(&self, frame: &FrameInfo) -> Option<f64> {
        let host_s = self.cameras.get(&frame.camera)?.host_s(frame.device_s?);
        Some(self.interrogator.as_ref()?.device_s(host_s) - self.origin_s)
    }
}

/// Writes the pictures of the settled poses, bit for bit as they were recorded:
/// `pictures/CAMERA/PPPPP.png` for the rows of points.csv with `pictures/pictures.csv` (with the
/// identifier of the `session`), the same under `pictures/holdout/` for those of holdout.csv.
/// Returns how many were written.
///
/// # Errors
/// When a recording cannot be read or a file not be written.
pub(crate) fn write_pictures(
    folder: &Path,
    session: &str,
    cameras: &[&str],
    parts: &[PathBuf],
    clocks: &[PartClocks],
    rows: &[PicturedRow],
) -> Result<usize, AcquisitionError> {
    let mut tables: [Vec<(usize, String)>; 2] = Default::default();
    // A rig's name is anybody's choice.
    let session = format!("\"{}\"", session.replace('"', "\"\""));
    let mut written: HashSet<PathBuf> = HashSet::new();
    for (part, (path, clocks)) in parts.iter().zip(clocks).enumerate() {
        let by_step: HashMap<u32, &PicturedRow> = rows
            .iter()
            .filter(|r| r.part == part)
            .map(|r| (r.step, r))
            .collect();
        // A frame and its picture are recorded at the same host time, in whole nanoseconds.
        let mut expected: HashMap<(String, u64), FrameInfo> = HashMap::new();
        let mut failed = None;
        read(path, |message| match message {
            Message::Frame(info) if info.step.is_some() => {
                expected.insert(
                    (
                        info.camera.clone(),
                        crate::message::nanoseconds(info.host_s),
                    ),
                    info,
                );
            }
            Message::PosePicture(camera, log_ns, png) => {
                let Some(info) = expected.remove(&(camera.clone(), log_ns)) else {
                    return;
                };
                // A name comes from a file: only the rig's become folders.
                if !cameras.contains(&camera.as_str()) {
                    return;
                }
                let mut put = |place: &Path| {
                    let made = place.parent().map_or(Ok(()), std::fs::create_dir_all);
                    let done = made.map_err(FileError::of("creating", place));
                    match done.and_then(|()| write_atomic(place, &png)) {
                        Ok(()) => true,
                        Err(e) => {
                            failed.get_or_insert(e);
                            false
                        }
                    }
                };
                // A step that was made again in a later recording has its picture there.
                let Some(row) = info.step.and_then(|step| by_step.get(&step)) else {
                    return;
                };
                let file = format!("{camera}/{:05}.png", row.point);
                let of = if row.sealed {
                    format!("{PICTURES}/holdout")
                } else {
                    PICTURES.to_owned()
                };
                let place = folder.join(of).join(&file);
                if put(&place) {
                    written.insert(place);
                }
                let text = |v: Option<f64>| v.map_or_else(String::new, |v| format!("{v:.6}"));
                let line = format!(
                    "{},{camera},{file},{},{:.6},{},{session},{}\n",
                    row.point,
                    text(clocks.session_s(&info)),
                    info.host_s,
                    text(info.exposure_s),
                    sha256_hex(&png)
                );
                tables[usize::from(row.sealed)].push((row.point, line));
            }
            _ => {}
        })?;
        if let Some(error) = failed {
            return Err(error.into());
        }
    }
    for (table, of) in tables
        .iter_mut()
        .zip([PICTURES.to_owned(), format!("{PICTURES}/holdout")])
    {
        if table.is_empty() {
            continue;
        }
        table.sort_by(|a, b| (a.0, &a.1).cmp(&(b.0, &b.1)));
        let mut csv = String::from("point,camera,file,t_s,host_t_s,exposure_s,session,sha256\n");
        csv.extend(table.iter().map(|(_, line)| line.as_str()));
        write_atomic(&folder.join(of).join("pictures.csv"), csv.as_bytes())?;
    }
    Ok(written.len())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frame() -> CameraFrame {
        let grey = (0..640 * 480_u32).map(|k| (k * 7919 % 251) as u8).collect();
        CameraFrame {
            width_px: 640,
            height_px: 480,
            grey,
            ..CameraFrame::default()
        }
    }

    #[test]
    fn a_pose_is_stored_without_loss_and_a_preview_is_small() {
        let frame = frame();
        let again = image::load_from_memory(&lossless(&frame).unwrap())
            .unwrap()
            .into_luma8();
        assert_eq!(
            (again.dimensions(), again.as_raw()),
            ((640, 480), &frame.grey)
        );
        let small = image::load_from_memory(&preview(&frame).unwrap()).unwrap();
        assert_eq!((small.width(), small.height()), (320, 240));
        let torn = CameraFrame {
            grey: vec![0; 7],
            ..frame
        };
        assert!(
            lossless(&torn)
                .unwrap_err()
                .to_string()
                .contains("has 7 grey values, expected 307200")
        );
        assert!(preview(&torn).is_err());
    }
}
