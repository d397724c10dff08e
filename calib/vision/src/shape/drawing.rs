//! What a report draws of a pair: the pictures, and in their pixels the curve, the measured pieces, tags and groove. Plain data; the page
//! itself is wcal-report's.

use crate::error::VisionError;
use crate::picture::Picture;
use crate::shape::pair_fit::PairFit;
use crate::stereo::StereoCameras;
use base64::Engine;
use base64::engine::general_purpose::STANDARD as BASE64;
use image::ExtendedColorType;
use image::codecs::jpeg::JpegEncoder;
use nalgebra::{Point3, Vector3};
use wcal_core::shapes_document::PairDocument;

/// Quality of the pictures' JPEG: they are for looking at.
const JPEG_QUALITY: u8 = 80;

/// A picture and what was found in it, px (pixel centres at integers).
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Drawing {
    /// Width and height of the picture.
    pub size_px: [usize; 2],
    /// The picture, JPEG in base64.
    pub jpeg_base64: String,
    /// Corners of each tag.
    pub tags: Vec<Vec<[f64; 2]>>,
    /// The fitted centre line.
    pub curve: Vec<[f64; 2]>,
    /// Measured centres that show the wire.
    pub seen: Vec<[f64; 2]>,
    /// Measured centres that do not.
    pub unseen: Vec<[f64; 2]>,
    /// The wire's centre in the groove.
    pub groove: Option<[f64; 2]>,
}

/// The drawing of one picture (0 left, 1 right).
///
/// # Errors
/// Where the picture cannot be encoded.
pub fn drawing(
    picture: &Picture,
    camera: usize,
    stereo: &StereoCameras,
    fit: &PairFit,
    pair: &PairDocument,
) -> Result<Drawing, VisionError> {
    let project = |p: &[f64; 3]| {
        let left = fit.left_from_base * Point3::from(Vector3::from(*p));
        let x = if camera == 1 { stereo.right_from_left * left } else { left };
        stereo.cameras[camera].project(&x.coords).map(|p| [p.x, p.y])
    };
    let side = if camera == 0 { "left" } else { "right" };
    let tags = pair.tags.iter().filter(|t| t.camera == side);
    let (pieces, shown) = &fit.pieces[camera];
    let pieces = pieces.iter().zip(shown).map(|(piece, shown)| {
        let at = piece.station.position_px + piece.station.normal() * piece.offset_px;
        ([at.x, at.y], *shown)
    });
    let (seen, unseen): (Vec<_>, Vec<_>) = pieces.partition(|(_, shown)| *shown);
    let places = |list: Vec<([f64; 2], bool)>| list.into_iter().map(|(at, _)| at).collect();
    Ok(Drawing {
        size_px: [picture.width, picture.height],
        jpeg_base64: BASE64.encode(jpeg(picture)?),
        tags: tags.map(|t| t.corners_px.to_vec()).collect(),
        curve: pair.centreline_mm.iter().filter_map(project).collect(),
        seen: places(seen),
        unseen: places(unseen),
        groove: pair.groove.as_ref().and_then(|g| project(&g.position_mm)),
    })
}

/// Distance of every measured piece from the reprojected curve (px) over the arc length (mm), left and right.
pub fn residuals(fit: &PairFit) -> [Vec<[f64; 2]>; 2] {
    [0, 1].map(|camera| {
        let all = fit.observations.iter().zip(&fit.system.residuals_px);
        let own = all.filter(|(sight, r)| sight.camera == camera && r.is_finite());
        own.map(|(sight, r)| [sight.arc_mm, *r]).collect()
    })
}

fn jpeg(picture: &Picture) -> Result<Vec<u8>, VisionError> {
    let mut bytes = Vec::new();
    let (width, height) = (picture.width as u32, picture.height as u32);
    JpegEncoder::new_with_quality(&mut bytes, JPEG_QUALITY)
        .encode(&picture.data, width, height, ExtendedColorType::L8)
        .map_err(VisionError::encoding("a picture for the report"))?;
    Ok(bytes)
}
