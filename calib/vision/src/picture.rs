//! Grey pictures of 8 bits: reading, also of 16 bits, with checks that the decoder does not make,
//! and sub-pixel sampling. Pixel centres lie at integers: (0, 0) is the centre of the first pixel.

use crate::error::{OpenCvContext, VisionError};
use image::codecs::jpeg::JpegEncoder;
use image::{ExtendedColorType, ImageDecoder, ImageReader};
use opencv::core::Mat;
use std::io::Cursor;
use std::path::Path;

/// Quality of a JPEG.
const JPEG_QUALITY: u8 = 80;

/// An 8-bit grey picture, rows from the top.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Picture {
    /// Columns, px.
    pub width: usize,
    /// Rows, px.
    pub height: usize,
    /// `width * height` grey values.
    pub data: Vec<u8>,
}

impl Picture {
    /// A picture from raw rows.
    ///
    /// # Errors
    /// Where `data` does not hold `width * height` values.
    pub fn new(width: usize, height: usize, data: Vec<u8>) -> Result<Self, VisionError> {
        if width * height != data.len() || data.is_empty() {
            return Err(VisionError::result(
                "make a picture",
                format!("{width}x{height} = {} grey values", width * height),
                format!("{} values", data.len()),
            ));
        }
        Ok(Self {
            width,
            height,
            data,
        })
    }

    /// Reads a PNG, JPEG, TIFF, BMP or PNM as it is stored, whatever way up its EXIF orientation
    /// says; colours become grey (0.299 R + 0.587 G + 0.114 B, ITU-R BT.601), and of 16 bits the
    /// upper eight that are in use.
    ///
    /// # Errors
    /// Where the file is missing, empty, cut off, not a picture or of floating-point values.
    pub fn read(path: &Path) -> Result<Self, VisionError> {
        let name = path.display().to_string();
        let bytes = wcal_core::files::read(path)?;
        check_complete(&name, &bytes)?;
        let decoded = image::load_from_memory(&bytes).map_err(|e| {
            VisionError::content(
                name.clone(),
                KINDS,
                format!("bytes that do not decode: {e}"),
            )
        })?;
        let (width, height) = (decoded.width() as usize, decoded.height() as usize);
        let color = decoded.color();
        let data = match color.bytes_per_pixel() / color.channel_count() {
            1 => grey_values(decoded.into_rgb8().as_raw()),
            2 => grey_values(&upper_bits(decoded.into_rgb16().as_raw())),
            _ => {
                return Err(VisionError::content(
                    name,
                    "8 or 16 bits a pixel",
                    "floating-point values",
                ));
            }
        };
        Self::new(width, height, data)
    }

    /// Grey value of a pixel; the border is continued outwards.
    pub fn at(&self, x: i64, y: i64) -> f64 {
        let x = x.clamp(0, self.width as i64 - 1) as usize;
        let y = y.clamp(0, self.height as i64 - 1) as usize;
        f64::from(self.data[y * self.width + x])
    }

    /// Bilinear grey value at a position, px.
    pub fn sample(&self, x: f64, y: f64) -> f64 {
        let (x0, y0) = (x.floor(), y.floor());
        let (u, v) = (x - x0, y - y0);
        let (i, j) = (x0 as i64, y0 as i64);
        (1.0 - v) * ((1.0 - u) * self.at(i, j) + u * self.at(i + 1, j))
            + v * ((1.0 - u) * self.at(i, j + 1) + u * self.at(i + 1, j + 1))
    }

    /// Whether a position lies at least `margin` px inside.
    pub fn contains(&self, x: f64, y: f64, margin: f64) -> bool {
        x >= margin
            && y >= margin
            && x <= self.width as f64 - 1.0 - margin
            && y <= self.height as f64 - 1.0 - margin
    }

    /// Fraction of pixels at 255 and mean grey value.
    pub fn saturation(&self) -> (f64, f64) {
        let n = self.data.len() as f64;
        let (mut full, mut sum) = (0.0, 0.0);
        // Row by row: short sums of whole numbers are fast ones.
        for row in self.data.chunks(self.width) {
            full += f64::from(row.iter().map(|&v| u32::from(v == 255)).sum::<u32>());
            sum += f64::from(row.iter().map(|&v| u32::from(v)).sum::<u32>());
        }
        (full / n, sum / n)
    }

    /// Why nothing can be measured in this picture, if so: all black, all white, without contrast.
    pub fn unusable(&self) -> Option<String> {
        let (full, mean) = self.saturation();
        if full > 0.5 {
            return Some(format!(
                "saturated: {:.0} % of the pixels at 255",
                100.0 * full
            ));
        }
        let (lo, hi) = (self.data.iter().min()?, self.data.iter().max()?);
        if hi - lo < 8 {
            return Some(format!(
                "no contrast: grey values {lo} to {hi}, mean {mean:.0} (black or covered?)"
            ));
        }
        None
    }

    /// The picture with `factor` x `factor` pixels averaged into one.
    pub(crate) fn reduced(&self, factor: usize) -> Self {
        let factor = factor.max(1).min(self.width).min(self.height);
        let (width, height) = (self.width / factor, self.height / factor);
        let mean = |k: usize| {
            let (x, y) = (k % width * factor, k / width * factor);
            let rows = (y..y + factor).map(|y| &self.data[y * self.width + x..][..factor]);
            (rows.flatten().map(|&v| usize::from(v)).sum::<usize>() / (factor * factor)) as u8
        };
        Self {
            width,
            height,
            data: (0..width * height).map(mean).collect(),
        }
    }

    /// The picture as JPEG, for looking at.
    ///
    /// # Errors
    /// Where it cannot be encoded.
    pub fn jpeg(&self) -> Result<Vec<u8>, VisionError> {
        let mut bytes = Vec::new();
        JpegEncoder::new_with_quality(&mut bytes, JPEG_QUALITY)
            .encode(
                &self.data,
                self.width as u32,
                self.height as u32,
                ExtendedColorType::L8,
            )
            .map_err(|e| VisionError::result("encode a picture", "a JPEG", e.to_string()))?;
        Ok(bytes)
    }

    /// The picture as an OpenCV matrix (a copy).
    pub(crate) fn to_mat(&self) -> Result<Mat, VisionError> {
        let rows: Vec<&[u8]> = self.data.chunks_exact(self.width).collect();
        Mat::from_slice_2d(&rows).doing("copy a picture")
    }
}

const KINDS: &str = "a PNG, JPEG, TIFF, BMP or PNM picture";

/// Of values of 16 bits the eight that are in use: cameras of 10, 12 and 14 bits store them at the
/// lower end or at the upper one. 255 is their largest value and no other: saturation is what it
/// was.
fn upper_bits(values: &[u16]) -> Vec<u8> {
    let used = values.iter().fold(0, |all, v| all | v);
    // Stored at the upper end, the lower bits are never set; cameras' depths are even.
    let unused = used.trailing_zeros().min(8) & !1;
    let bits = [8, 10, 12, 14]
        .into_iter()
        .find(|bits| (used >> unused) < 1 << bits)
        .unwrap_or(16);
    let full = (1u32 << bits) - 1;
    values
        .iter()
        .map(|v| (u32::from(v >> unused) * 255 / full) as u8)
        .collect()
}

/// The EXIF orientation of a picture file, 2 to 8 (CIPA DC-008, tag 274), where it asks that the
/// picture be turned or mirrored.
pub fn exif_orientation(path: &Path) -> Option<u8> {
    let bytes = wcal_core::files::read(path).ok()?;
    let reader = ImageReader::new(Cursor::new(&bytes))
        .with_guessed_format()
        .ok()?;
    Some(reader.into_decoder().ok()?.orientation().ok()?.to_exif())
        .filter(|orientation| *orientation != 1)
}

/// Grey values of red, green and blue ones.
fn grey_values(rgb: &[u8]) -> Vec<u8> {
    let pixels = rgb.chunks_exact(3);
    // A grey camera's picture that was stored as colour has equal channels (JPEG may round by one).
    if pixels
        .clone()
        .all(|p| p[0].abs_diff(p[1]) <= 2 && p[1].abs_diff(p[2]) <= 2)
    {
        return pixels.map(|p| p[1]).collect();
    }
    let grey =
        |p: &[u8]| 0.299 * f64::from(p[0]) + 0.587 * f64::from(p[1]) + 0.114 * f64::from(p[2]);
    pixels.map(|p| grey(p).round() as u8).collect()
}

/// Decoders fill the missing part of a truncated file with grey; the end markers reveal it.
fn check_complete(name: &str, bytes: &[u8]) -> Result<(), VisionError> {
    if bytes.is_empty() {
        return Err(VisionError::content(name, KINDS, "a file of zero bytes"));
    }
    let tail = &bytes[bytes.len().saturating_sub(64)..];
    let complete = if bytes.starts_with(b"\x89PNG") {
        tail.windows(4).any(|w| w == b"IEND")
    } else if bytes.starts_with(b"\xff\xd8") {
        tail.windows(2).any(|w| w == b"\xff\xd9")
    } else {
        true
    };
    if complete {
        return Ok(());
    }
    Err(VisionError::content(
        name,
        "a complete picture",
        format!("one cut off after {} bytes", bytes.len()),
    ))
}
