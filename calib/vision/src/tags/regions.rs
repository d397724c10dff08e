//! Candidate regions of tags: dark components, about as high as wide, with contrast to their
//! surroundings like a tag's black border. AprilTag spends most of its time on the rest of a
//! picture.

use crate::error::{OpenCvContext, VisionError};
use crate::picture::Picture;
use crate::tags::apriltag_ffi::{MIN_CONTRAST, Region};
use opencv::core::Mat;
use opencv::imgproc::connected_components_with_stats_def;
use opencv::prelude::*;

/// Side of the tiles whose darkest and brightest pixels give the local threshold, px; AprilTag's
/// own.
const TILE: usize = 4;
/// Smallest contrast, as a share of the picture's range.
const CONTRAST: f64 = 0.35;
/// Least side of a tag's border, px: AprilTag reads no cell of less than a pixel.
const MIN_SIDE: usize = 8;
/// A tag seen under 75 degrees is four times as long as wide.
const SLANT: usize = 4;
/// Least share of its box that a border fills: a ring one cell of eight wide, turned by 45 degrees
/// and drawn thin by the light. Of a large tag only the rim is examined, at most one tile deep.
const FILL: f64 = 0.12;
/// Sides from which a tag is found at half and at a quarter of the size as well, px: its cells are
/// 4 px wide there and more.
const COARSE_SIDES: [usize; 2] = [64, 128];
/// Grown by this share of its side and by px beyond: the library reads half a cell of the white
/// margin, and a dark piece may be only part of a border.
const MARGIN: (f64, usize) = (0.15, 6);

/// Darkest and brightest pixel of every tile, rows of tiles from the top; the last tiles of a row
/// and the last rows are smaller.
fn tiles(picture: &Picture) -> (usize, Vec<[u8; 2]>) {
    let columns = picture.width.div_ceil(TILE);
    let mut tiles = Vec::with_capacity(columns * picture.height.div_ceil(TILE));
    for rows in picture.data.chunks(TILE * picture.width) {
        let mut ranges = vec![[255, 0]; columns];
        for row in rows.chunks_exact(picture.width) {
            for (range, pixels) in ranges.iter_mut().zip(row.chunks(TILE)) {
                *range = pixels.iter().fold(*range, |r, &p| widest(r, [p, p]));
            }
        }
        tiles.extend(ranges);
    }
    (columns, tiles)
}

fn widest(a: [u8; 2], b: [u8; 2]) -> [u8; 2] {
    [a[0].min(b[0]), a[1].max(b[1])]
}

/// Thresholds of the tiles, the middle of the range of the 3x3 tiles about each; 0 where they
/// differ by less than `contrast`.
fn thresholds(columns: usize, tiles: &[[u8; 2]], contrast: u8) -> Vec<u8> {
    let mut across = tiles.to_vec();
    for (out, row) in across
        .chunks_exact_mut(columns)
        .zip(tiles.chunks_exact(columns))
    {
        for k in 0..columns {
            out[k] = row[k.saturating_sub(1)..(k + 2).min(columns)]
                .iter()
                .copied()
                .fold(row[k], widest);
        }
    }
    (0..tiles.len())
        .map(|k| {
            let neighbours = [k.checked_sub(columns), Some(k), Some(k + columns)];
            let [low, high] = neighbours
                .into_iter()
                .flatten()
                .filter_map(|i| across.get(i))
                .copied()
                .fold(across[k], widest);
            if high - low < contrast {
                0
            } else {
                low + (high - low) / 2
            }
        })
        .collect()
}

/// Range of the tiles from the 1 % to the 99 % quantile, DN, from one tile in seven.
fn span(tiles: &[[u8; 2]]) -> f64 {
    // Quantiles, so that single glints and dead pixels do not set the range.
    let hundredth = |mut values: Vec<u8>, brightest: bool| {
        let k = if brightest {
            values.len() - 1 - values.len() / 100
        } else {
            values.len() / 100
        };
        *values.select_nth_unstable(k).1
    };
    let side = |k: usize| tiles.iter().step_by(7).map(|t| t[k]).collect();
    f64::from(hundredth(side(1), true).saturating_sub(hundredth(side(0), false)))
}

/// Boxes (first column and row, columns and rows) of connected dark pieces (8 neighbours) below the
/// thresholds of the tiles, and their pixels.
fn dark_pieces(
    picture: &Picture,
    columns: usize,
    thresholds: &[u8],
) -> Result<Vec<[usize; 5]>, VisionError> {
    let doing = "search for tags";
    let mut dark = Vec::with_capacity(picture.data.len());
    for (y, row) in picture.data.chunks_exact(picture.width).enumerate() {
        let limits = &thresholds[y / TILE * columns..];
        for (pixels, limit) in row.chunks(TILE).zip(limits) {
            dark.extend(pixels.iter().map(|p| u8::from(p < limit)));
        }
    }
    let dark = Picture::new(picture.width, picture.height, dark)?.to_mat()?;
    let (mut labels, mut stats, mut centres) = (Mat::default(), Mat::default(), Mat::default());
    connected_components_with_stats_def(&dark, &mut labels, &mut stats, &mut centres)
        .doing(doing)?;
    let (pieces, _) = stats.data_typed::<i32>().doing(doing)?.as_chunks::<5>();
    // The first is all that is not dark.
    Ok(pieces[1..].iter().map(|p| p.map(|n| n as usize)).collect())
}

/// Regions of strong contrast that may hold a tag, grown by its white margin; those that overlap
/// much are one.
pub(crate) fn tag_regions(picture: &Picture) -> Result<(Vec<Region>, u8), VisionError> {
    let (columns, tiles) = tiles(picture);
    // Relative to the picture: exposure changes all contrasts alike.
    let contrast = (CONTRAST * span(&tiles)).max(f64::from(MIN_CONTRAST)) as u8;
    let thresholds = thresholds(columns, &tiles, contrast);
    let like_a_tag = |[_, _, width, height, pixels]: &[usize; 5]| {
        *width.min(height) >= MIN_SIDE
            && *width <= SLANT * height
            && *height <= SLANT * width
            && *pixels as f64
                >= (FILL * (width * height) as f64).min((TILE * (width + height)) as f64)
    };
    let size = [picture.width, picture.height];
    let grown = |[x, y, width, height, _]: [usize; 5]| {
        let margin = (MARGIN.0 * width.max(height) as f64) as usize + MARGIN.1;
        let low = [x, y].map(|v| v.saturating_sub(margin) / TILE * TILE);
        let beyond = [x + width, y + height];
        // A small component within a large one is a candidate by itself.
        let decimate = COARSE_SIDES
            .iter()
            .filter(|&&s| width.min(height) >= s)
            .fold(1.0, |d, _| 2.0 * d);
        Region {
            low,
            high: [0, 1].map(|k| (beyond[k] + margin).min(size[k])),
            decimate,
        }
    };
    let mut regions: Vec<Region> = dark_pieces(picture, columns, &thresholds)?
        .into_iter()
        .filter(like_a_tag)
        .map(grown)
        .collect();
    // From the left: only neighbours can overlap.
    regions.sort_by_key(|r| r.low[0]);
    let mut kept: Vec<Region> = Vec::with_capacity(regions.len());
    let area = |r: &Region| r.size().iter().product::<usize>();
    for mut region in regions {
        let alike = |a: &Region, b: &Region| {
            a.decimate == b.decimate && area(&a.joined(b)) <= area(a) + area(b)
        };
        while let Some(k) = kept.iter().position(|other| alike(&region, other)) {
            region = region.joined(&kept.swap_remove(k));
        }
        kept.push(region);
    }
    Ok((kept, contrast))
}
