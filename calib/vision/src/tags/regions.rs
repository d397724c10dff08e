//! Candidate regions of tags: dark components, about as high as wide, with contrast to their
//! surroundings like a tag's black border. AprilTag spends most of its time on the rest of a
//! picture.

use crate::picture::Picture;
use crate::tags::apriltag_ffi::{MIN_CONTRAST, Region};

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

/// A run of dark pixels in a row.
struct Run {
    from: usize,
    to: usize,
    piece: usize,
}

/// A connected piece: box and pixels.
#[derive(Clone, Copy)]
struct Piece {
    low: [usize; 2],
    high: [usize; 2],
    pixels: usize,
}

impl Piece {
    fn join(&mut self, other: &Self) {
        for k in 0..2 {
            self.low[k] = self.low[k].min(other.low[k]);
            self.high[k] = self.high[k].max(other.high[k]);
        }
        self.pixels += other.pixels;
    }

    fn sides(&self) -> [usize; 2] {
        [0, 1].map(|k| self.high[k] - self.low[k] + 1)
    }
}

/// Darkest and brightest pixel of every tile, rows of tiles from the top; the last tiles of a row
/// and the last rows are smaller.
fn tiles(picture: &Picture) -> (usize, Vec<[u8; 2]>) {
    let (width, columns) = (picture.width, picture.width.div_ceil(TILE));
    let mut tiles = Vec::with_capacity(columns * picture.height.div_ceil(TILE));
    let (mut low, mut high) = (vec![0u8; width], vec![0u8; width]);
    for rows in picture.data.chunks(TILE * width) {
        // Down the columns first: whole rows at a time.
        low.copy_from_slice(&rows[..width]);
        high.copy_from_slice(&rows[..width]);
        for row in rows[width..].chunks_exact(width) {
            for ((l, h), &p) in low.iter_mut().zip(&mut high).zip(row) {
                (*l, *h) = ((*l).min(p), (*h).max(p));
            }
        }
        let ((lows, low_rest), (highs, high_rest)) =
            (low.as_chunks::<TILE>(), high.as_chunks::<TILE>());
        let both = |l: &[u8], h: &[u8]| {
            [
                l.iter().fold(255, |a, &p| a.min(p)),
                h.iter().fold(0, |a, &p| a.max(p)),
            ]
        };
        tiles.extend(lows.iter().zip(highs).map(|(l, h)| both(l, h)));
        if !low_rest.is_empty() {
            tiles.push(both(low_rest, high_rest));
        }
    }
    (columns, tiles)
}

/// Thresholds of the tiles, the middle of the range of the 3x3 tiles about each; 0 where they
/// differ by less than `contrast`.
fn thresholds(columns: usize, tiles: &[[u8; 2]], contrast: u8) -> Vec<u8> {
    let widest = |a: [u8; 2], b: [u8; 2]| [a[0].min(b[0]), a[1].max(b[1])];
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

fn root(parents: &mut [usize], mut k: usize) -> usize {
    while parents[k] != k {
        parents[k] = parents[parents[k]];
        k = parents[k];
    }
    k
}

/// Where the next 0 or 1 of a row of them lies, or its end; eight at a time.
fn next(row: &[u8], mut from: usize, wanted: u8) -> usize {
    let other = u64::from_le_bytes([1 - wanted; 8]);
    while let Some((eight, _)) = row[from..].split_first_chunk::<8>() {
        let differs = u64::from_le_bytes(*eight) ^ other;
        if differs != 0 {
            return from + differs.trailing_zeros() as usize / 8;
        }
        from += 8;
    }
    row[from..]
        .iter()
        .position(|&v| v == wanted)
        .map_or(row.len(), |k| from + k)
}

/// Connected dark pieces (8 neighbours), from runs of pixels below the thresholds of the tiles.
fn dark_pieces(picture: &Picture, columns: usize, thresholds: &[u8]) -> Vec<Piece> {
    let (mut parents, mut pieces): (Vec<usize>, Vec<Piece>) = (Vec::new(), Vec::new());
    let (mut above, mut here): (Vec<Run>, Vec<Run>) = (Vec::new(), Vec::new());
    let mut limits = vec![0u8; picture.width];
    let mut dark = vec![0u8; picture.width];
    for (y, row) in picture.data.chunks_exact(picture.width).enumerate() {
        if y % TILE == 0 {
            let tiles = &thresholds[y / TILE * columns..(y / TILE + 1) * columns];
            limits
                .chunks_mut(TILE)
                .zip(tiles)
                .for_each(|(pixels, &limit)| pixels.fill(limit));
        }
        for ((d, &p), &limit) in dark.iter_mut().zip(row).zip(&limits) {
            *d = u8::from(p < limit);
        }
        let mut from = next(&dark, 0, 1);
        while from < dark.len() {
            let to = next(&dark, from, 0);
            here.push(Run {
                from,
                to,
                piece: usize::MAX,
            });
            from = next(&dark, to, 1);
        }
        let mut first = 0;
        for run in &mut here {
            while first < above.len() && above[first].to < run.from {
                first += 1;
            }
            let own = Piece {
                low: [run.from, y],
                high: [run.to - 1, y],
                pixels: run.to - run.from,
            };
            for touching in above[first..].iter().take_while(|a| a.from <= run.to) {
                let other = root(&mut parents, touching.piece);
                if run.piece == usize::MAX {
                    run.piece = other;
                    pieces[other].join(&own);
                    continue;
                }
                let mine = root(&mut parents, run.piece);
                if mine != other {
                    parents[other] = mine;
                    let joined = pieces[other];
                    pieces[mine].join(&joined);
                }
            }
            if run.piece == usize::MAX {
                run.piece = pieces.len();
                parents.push(run.piece);
                pieces.push(own);
            }
        }
        std::mem::swap(&mut above, &mut here);
        here.clear();
    }
    (0..pieces.len())
        .filter(|&k| parents[k] == k)
        .map(|k| pieces[k])
        .collect()
}

/// Regions of strong contrast that may hold a tag, grown by its white margin; those that overlap
/// much are one.
pub(crate) fn tag_regions(picture: &Picture) -> (Vec<Region>, u8) {
    let (columns, tiles) = tiles(picture);
    let contrast = (CONTRAST * span(&tiles)).max(f64::from(MIN_CONTRAST)) as u8;
    let thresholds = thresholds(columns, &tiles, contrast);
    let like_a_tag = |p: &Piece| {
        let [width, height] = p.sides();
        width.min(height) >= MIN_SIDE
            && width <= SLANT * height
            && height <= SLANT * width
            && p.pixels as f64
                >= (FILL * (width * height) as f64).min((TILE * (width + height)) as f64)
    };
    let size = [picture.width, picture.height];
    let grown = |p: Piece| {
        let [width, height] = p.sides();
        let margin = (MARGIN.0 * width.max(height) as f64) as usize + MARGIN.1;
        let low = p.low.map(|v| v.saturating_sub(margin) / TILE * TILE);
        // A small component within a large one is a candidate by itself.
        let decimate = COARSE_SIDES
            .iter()
            .filter(|&&s| width.min(height) >= s)
            .fold(1.0, |d, _| 2.0 * d);
        Region {
            low,
            high: [0, 1].map(|k| (p.high[k] + margin + 1).min(size[k])),
            decimate,
        }
    };
    let mut regions: Vec<Region> = dark_pieces(picture, columns, &thresholds)
        .into_iter()
        .filter(like_a_tag)
        .map(grown)
        .collect();
    // From the left: only neighbours can overlap.
    regions.sort_by_key(|r| r.low[0]);
    let mut kept: Vec<Region> = Vec::with_capacity(regions.len());
    for mut region in regions {
        let alike = |a: &Region, b: &Region| {
            a.decimate == b.decimate && a.joined(b).area() <= a.area() + b.area()
        };
        while let Some(k) = kept.iter().position(|other| alike(&region, other)) {
            region = region.joined(&kept.swap_remove(k));
        }
        kept.push(region);
    }
    (kept, contrast)
}
