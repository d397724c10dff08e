//! Pictures with what was found drawn on them, for the report: the reprojected curve, the measured pieces, tags, groove.

use crate::error::OpenCvContext;
use crate::error::VisionError;
use crate::picture::Picture;
use crate::shape::pair_fit::PairFit;
use crate::stereo::StereoCameras;
use image::codecs::png::PngEncoder;
use image::{ExtendedColorType, ImageEncoder};
use nalgebra::{Point3, Vector2, Vector3};
use opencv::core::{Mat, Point, Scalar, Vec3b};
use opencv::imgproc;
use wcal_core::shapes_document::PairDocument;

/// Red, green, blue.
type Colour = [u8; 3];
const CURVE: Colour = [60, 200, 60];
const SEEN: Colour = [0, 120, 255];
const UNSEEN: Colour = [255, 0, 0];
const TAG: Colour = [255, 0, 255];
const GROOVE: Colour = [255, 200, 0];

/// A colour picture of twice the size, which resolves half pixels.
struct Canvas {
    width: usize,
    height: usize,
    data: Vec<Colour>,
}

const SCALE: f64 = 2.0;

impl Canvas {
    fn new(picture: &Picture) -> Self {
        let (width, height) = (picture.width * 2, picture.height * 2);
        let data = (0..width * height)
            .map(|k| {
                let v =
                    picture.sample(((k % width) as f64 - 0.5) / SCALE, ((k / width) as f64 - 0.5) / SCALE);
                [v as u8; 3]
            })
            .collect();
        Self { width, height, data }
    }

    fn dot(&mut self, p: &Vector2<f64>, reach: i64, colour: Colour) {
        // Pixel centres lie at integers: (0, 0) is the middle of the first 2x2 block.
        let (x, y) = ((p.x * SCALE + 0.5).round() as i64, (p.y * SCALE + 0.5).round() as i64);
        for (i, j) in (-reach..=reach).flat_map(|i| (-reach..=reach).map(move |j| (x + i, y + j))) {
            if i >= 0 && j >= 0 && (i as usize) < self.width && (j as usize) < self.height {
                self.data[j as usize * self.width + i as usize] = colour;
            }
        }
    }

    /// A word in the upper left corner.
    fn stamp(&mut self, word: &str) -> Result<(), VisionError> {
        let (rows, columns) = (self.height as i32, self.width as i32);
        let mut pixels: Vec<Vec3b> = self.data.iter().map(|c| Vec3b::from(*c)).collect();
        let mut mat =
            Mat::new_rows_cols_with_data_mut(rows, columns, &mut pixels).doing("mark an overlay")?;
        let height = (rows / 30).max(20);
        let [r, g, b] = UNSEEN.map(f64::from);
        let (at, size) = (Point::new(height / 2, height + height / 2), f64::from(height) / 21.0);
        imgproc::put_text(
            &mut mat,
            word,
            at,
            imgproc::FONT_HERSHEY_SIMPLEX,
            size,
            Scalar::new(r, g, b, 0.0),
            (height / 8).max(2),
            imgproc::LINE_AA,
            false,
        )
        .doing("mark an overlay")?;
        drop(mat);
        self.data = pixels.into_iter().map(|p| p.0).collect();
        Ok(())
    }

    fn line(&mut self, a: &Vector2<f64>, b: &Vector2<f64>, colour: Colour) {
        let steps = ((b - a).norm() * SCALE).ceil().max(1.0) as usize;
        for k in 0..=steps {
            self.dot(&(a + (b - a) * (k as f64 / steps as f64)), 0, colour);
        }
    }
}

/// PNG of one picture (0 left, 1 right) with the pair's result drawn on it, and SIMULATED where it was rendered.
///
/// # Errors
/// Where the picture cannot be encoded.
pub fn overlay_png(
    picture: &Picture,
    camera: usize,
    stereo: &StereoCameras,
    fit: &PairFit,
    pair: &PairDocument,
    simulated: bool,
) -> Result<Vec<u8>, VisionError> {
    let mut canvas = Canvas::new(picture);
    let project = |p: &Vector3<f64>| {
        let mut x = fit.left_from_base * Point3::from(*p);
        if camera == 1 {
            x = stereo.right_from_left * x;
        }
        stereo.cameras[camera].project(&x.coords)
    };
    let curve: Vec<_> = pair.centreline_mm.iter().filter_map(|p| project(&Vector3::from(*p))).collect();
    for w in curve.windows(2) {
        canvas.line(&w[0], &w[1], CURVE);
    }
    let (pieces, seen) = &fit.pieces[camera];
    for (piece, seen) in pieces.iter().zip(seen) {
        let at = piece.station.position_px + piece.station.normal() * piece.offset_px;
        canvas.dot(&at, 0, if *seen { SEEN } else { UNSEEN });
    }
    let side = if camera == 0 { "left" } else { "right" };
    for tag in pair.tags.iter().filter(|t| t.camera == side) {
        let c = tag.corners_px.map(|c| Vector2::new(c[0], c[1]));
        for k in 0..4 {
            canvas.line(&c[k], &c[(k + 1) % 4], TAG);
        }
    }
    if let Some(p) = pair.groove.as_ref().and_then(|g| project(&Vector3::from(g.position_mm))) {
        canvas.dot(&p, 4, GROOVE);
    }
    if simulated {
        canvas.stamp("SIMULATED")?;
    }
    let (width, height) = (canvas.width as u32, canvas.height as u32);
    let mut png = Vec::new();
    PngEncoder::new(&mut png)
        .write_image(canvas.data.as_flattened(), width, height, ExtendedColorType::Rgb8)
        .map_err(VisionError::encoding("an overlay"))?;
    Ok(png)
}
