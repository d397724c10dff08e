//! A safe interface to the AprilTag C library (3.4.5, bundled by apriltag-sys). The only module of
//! this crate with `unsafe` code.
#![allow(unsafe_code)]

use crate::error::VisionError;
use crate::picture::Picture;
use apriltag_sys as sys;
use nalgebra::{Matrix2, Vector2};
use std::cell::RefCell;
use std::collections::HashMap;
use std::collections::hash_map::Entry;
use wcal_core::rig_devices::TAG_FAMILIES;

/// A tag in one picture.
#[derive(Debug, Clone, PartialEq)]
pub struct Tag {
    /// Family, e.g. `tag36h11`.
    pub family: String,
    /// Number.
    pub id: u32,
    /// Contrast of the decision, DN; larger is safer.
    pub decision_margin: f64,
    /// Corners, px, in the tag's frame (x right, y down): (-,+), (+,+), (+,-), (-,-).
    pub corners_px: [Vector2<f64>; 4],
    /// Covariances of the corners, px^2.
    pub covariances_px2: [Matrix2<f64>; 4],
    /// Whether the edges could be fitted; otherwise the library's corners stand, with a wide
    /// covariance.
    pub refined: bool,
}

impl Tag {
    /// Mean of the corners, px.
    pub(crate) fn middle_px(&self) -> Vector2<f64> {
        self.corners_px.iter().sum::<Vector2<f64>>() / 4.0
    }
}

type Create = unsafe extern "C" fn() -> *mut sys::apriltag_family_t;
type Destroy = unsafe extern "C" fn(*mut sys::apriltag_family_t);

/// Ends the name of a family whose black border is two cells wide.
pub(crate) const WIDE_BORDER: &str = "-border2";

fn family(name: &str) -> Option<(Create, Destroy)> {
    Some(match name.strip_suffix(WIDE_BORDER).unwrap_or(name) {
        "tag36h11" => (sys::tag36h11_create, sys::tag36h11_destroy),
        "tag25h9" => (sys::tag25h9_create, sys::tag25h9_destroy),
        "tag16h5" => (sys::tag16h5_create, sys::tag16h5_destroy),
        "tagStandard41h12" => (sys::tagStandard41h12_create, sys::tagStandard41h12_destroy),
        "tagStandard52h13" => (sys::tagStandard52h13_create, sys::tagStandard52h13_destroy),
        "tagCircle21h7" => (sys::tagCircle21h7_create, sys::tagCircle21h7_destroy),
        _ => return None,
    })
}

/// Creates a family, with the border that its name says; null where the library has no memory.
///
/// # Safety
/// `create` is the library's function of a family.
unsafe fn created(name: &str, create: Create) -> *mut sys::apriltag_family_t {
    // SAFETY: the family is not null where it is changed, and the places of its bits are arrays of `nbits`.
    unsafe {
        let family = create();
        if !family.is_null() && name.ends_with(WIDE_BORDER) {
            // The bits lie one cell further in, counted from the border's outer corner.
            (*family).width_at_border += 2;
            (*family).total_width += 2;
            for bit in 0..(*family).nbits as usize {
                *(*family).bit_x.add(bit) += 1;
                *(*family).bit_y.add(bit) += 1;
            }
        }
        family
    }
}

/// AprilTag's origin is the corner of the first pixel; here it is the pixel's centre.
const CENTRE_OFFSET: f64 = 0.5;

struct Handles {
    detector: *mut sys::apriltag_detector_t,
    family: *mut sys::apriltag_family_t,
    destroy_family: Destroy,
}

impl Drop for Handles {
    fn drop(&mut self) {
        // SAFETY: both come from their `_create` functions, are not null and are destroyed once; the detector goes first,
        // since it frees the quick-decode table that it hung on the family.
        unsafe {
            sys::apriltag_detector_destroy(self.detector);
            (self.destroy_family)(self.family);
        }
    }
}

thread_local! {
    /// A family's table of codes with up to two wrong bits takes longer to make than a picture to
    /// search: each thread keeps its own.
    static DETECTORS: RefCell<HashMap<&'static str, Handles>> = RefCell::default();
}

impl Handles {
    fn new(name: &str, create: Create, destroy_family: Destroy) -> Option<Self> {
        // SAFETY: both are checked before use; `add_family_bits` takes a detector and a family that outlive it in `Handles`.
        unsafe {
            let (family, detector) = (created(name, create), sys::apriltag_detector_create());
            if family.is_null() || detector.is_null() {
                return None;
            }
            (*detector).nthreads = 1;
            sys::apriltag_detector_add_family_bits(detector, family, 2);
            Some(Self {
                detector,
                family,
                destroy_family,
            })
        }
    }
}

/// A part of a picture: the first column and row in it and the first beyond, px; and how coarsely
/// it is searched.
#[derive(Clone, Copy)]
pub(crate) struct Region {
    /// First column and row.
    pub low: [usize; 2],
    /// Column and row after the last.
    pub high: [usize; 2],
    /// Quads are sought in a picture smaller by this factor, 1 or more (above 1 their edges are
    /// fitted at full size).
    pub decimate: f32,
}

impl Region {
    /// The smallest region that holds both, searched as the finer one.
    pub fn joined(&self, other: &Self) -> Self {
        Self {
            low: [0, 1].map(|k| self.low[k].min(other.low[k])),
            high: [0, 1].map(|k| self.high[k].max(other.high[k])),
            decimate: self.decimate.min(other.decimate),
        }
    }

    /// Columns and rows.
    pub fn size(&self) -> [usize; 2] {
        [0, 1].map(|k| self.high[k] - self.low[k])
    }
}

/// Contrast of a border below which the library ignores a candidate, DN: its own value.
pub(crate) const MIN_CONTRAST: u8 = 5;

/// Detects the tags of one family in regions of a picture, with borders of at least this contrast
/// (DN). The corners are those of the quad. A tag in two regions is listed twice.
///
/// # Errors
/// Where the family is unknown or the library gives no detector.
pub(crate) fn detect(
    picture: &Picture,
    family_name: &str,
    regions: &[Region],
    min_contrast: u8,
) -> Result<Vec<Tag>, VisionError> {
    let known = TAG_FAMILIES
        .into_iter()
        .find(|f| *f == family_name)
        .and_then(|f| Some((f, family(f)?)));
    let (name, (create, destroy_family)) = known.ok_or_else(|| {
        VisionError::result(
            "detect tags",
            format!("one of the families {}", TAG_FAMILIES.join(", ")),
            family_name,
        )
    })?;
    // Rows are copied to a stride of a multiple of 96: the library reads past the row otherwise for
    // some widths.
    let stride = picture.width.div_ceil(96) * 96;
    // A row more, since a region's last row may begin anywhere in its own.
    let mut buffer = vec![0u8; stride * (picture.height + 1)];
    for (row, source) in buffer
        .chunks_exact_mut(stride)
        .zip(picture.data.chunks_exact(picture.width))
    {
        row[..picture.width].copy_from_slice(source);
    }
    DETECTORS.with_borrow_mut(|all| {
        let handles = match all.entry(name) {
            Entry::Occupied(kept) => kept.into_mut(),
            Entry::Vacant(place) => {
                place.insert(Handles::new(name, create, destroy_family).ok_or_else(|| {
                    VisionError::result("detect tags", "a detector", "none (out of memory?)")
                })?)
            }
        };
        let found = regions.iter().flat_map(|region| {
            let [width, height] = region.size();
            let mut image = sys::image_u8_t {
                width: width as i32,
                height: height as i32,
                stride: stride as i32,
                buf: buffer[region.low[1] * stride + region.low[0]..].as_mut_ptr(),
            };
            handles.detect(name, &mut image, region, min_contrast)
        });
        Ok(found.collect())
    })
}

impl Handles {
    /// Tags of a region whose header points to its first pixel in a buffer of at least
    /// `stride * height` bytes from there.
    fn detect(
        &mut self,
        family: &str,
        image: &mut sys::image_u8_t,
        region: &Region,
        min_contrast: u8,
    ) -> Vec<Tag> {
        // SAFETY: the detector lives as long as `self`; the picture's buffer outlives the call, which keeps no pointer to it;
        // every detection is read before the array is destroyed.
        unsafe {
            (*self.detector).quad_decimate = region.decimate;
            // At full size this loses small tags, and `tags` fits the edges better.
            (*self.detector).refine_edges = region.decimate > 1.0;
            (*self.detector).qtp.min_white_black_diff = i32::from(min_contrast);
            // The library makes no quad of fewer points, but sorts them first.
            (*self.detector).qtp.min_cluster_pixels = 24;
            let found = sys::apriltag_detector_detect(self.detector, image);
            if found.is_null() {
                return Vec::new();
            }
            let corner = Vector2::from(region.low.map(|k| k as f64 - CENTRE_OFFSET));
            let mut tags = Vec::with_capacity((*found).size.max(0) as usize);
            for k in 0..(*found).size {
                let element = (*found)
                    .data
                    .add(k as usize * (*found).el_sz)
                    .cast::<*mut sys::apriltag_detection_t>();
                let detection = &**element;
                tags.push(Tag {
                    family: family.to_owned(),
                    id: detection.id.max(0) as u32,
                    decision_margin: f64::from(detection.decision_margin),
                    corners_px: detection.p.map(|p| corner + Vector2::from(p)),
                    // Unrefined corners are good to a few tenths of a pixel.
                    covariances_px2: [Matrix2::identity() * 0.04; 4],
                    refined: false,
                });
            }
            sys::apriltag_detections_destroy(found);
            tags
        }
    }
}

/// The picture of a tag, one pixel a cell, its white margin included.
///
/// # Errors
/// Where the family or the number is unknown.
pub fn draw_tag(family_name: &str, id: u32) -> Result<Picture, VisionError> {
    let unknown = || {
        VisionError::result(
            "draw a tag",
            "a tag of a known family",
            format!("{family_name} {id}"),
        )
    };
    let (create, destroy) = family(family_name).ok_or_else(unknown)?;
    // SAFETY: the family is created and destroyed here once; the image is read within its own width, height and stride
    // before it is destroyed; `id` is checked against the number of codes, which the library does
    // not do.
    unsafe {
        let family = created(family_name, create);
        if family.is_null() {
            return Err(unknown());
        }
        if id >= (*family).ncodes {
            destroy(family);
            return Err(unknown());
        }
        let image = sys::apriltag_to_image(family, id);
        let (width, height, stride) = (
            (*image).width as usize,
            (*image).height as usize,
            (*image).stride as usize,
        );
        let mut data = Vec::with_capacity(width * height);
        for y in 0..height {
            for x in 0..width {
                data.push(*(*image).buf.add(y * stride + x));
            }
        }
        sys::image_u8_destroy(image);
        destroy(family);
        Picture::new(width, height, data)
    }
}
