//! The second witness: what pairs of pictures show of the poses, beside the wavelengths.
//!
//! A pair shows `z_i` = (groove position, contact arc length, centre line across at some stations); the rod predicts it as `g_i`:
//!
//! ```text
//! z_i - g_i(terms) = e_i + S_i q,      cov(e_i) = N_i = O_i O_i' + floor^2 I,     cov(q) = C          (errors of shapes.json)
//! u_i = L_i^-1 (z_i - g_i),   A_i = L_i^-1 S_i C^(1/2),   L_i L_i' = N_i
//! w = (I + A A')^(-1/2) u = u + A M A' u,     M = V ((1 + s^2)^(-1/2) - 1) / s^2 V',     A' A = V s^2 V'
//! ```
//!
//! so that `w` is white once the errors `q` that all pairs share (cameras, tags, light) are integrated out. Pairs whose readings do not
//! count are zero in `w` and have no part in `M`. Source: JCGM 102:2011, 6.2; the symmetric root keeps one value a row.
//!
//! Where the pairs scatter less than they state, their own errors are smaller: `N_i` becomes `f^2 N_i` with f from the residuals. What all
//! pairs share does not scatter and stays as it is stated.
//!
//! A pair without `errors` shows the contact alone. Nobody says which part of its stated covariance all pairs share, so all of it may be:
//! it counts once as the pair's own and once more as one shift of every such pair.

use super::path::WhiskerPath;
use nalgebra::{DMatrix, DVector, Matrix3, Vector3};
use std::collections::HashMap;
use std::sync::{Arc, Mutex};
use wcal_core::observation::{PairLeftOut, SessionShapes, WhiskerRow};
use wcal_core::shapes_document::{ErrorColumn, GrooveDocument, PairDocument, PairErrors};

/// Stations of the centre line that count at most, spread evenly from root to tip: past the contact the wire is free, and its tail shows
/// the slope there with the longest lever.
const MAX_STATIONS: usize = 12;
/// Nearer to the root than this the wire is in its seat and tells nothing, mm.
const MIN_STATION_MM: f64 = 4.0;
/// Part of the stated error below which nothing is believed, mm: rounding of the file and of the rod.
const FLOOR_MM: f64 = 1e-3;
/// No board is known better, as a share of its size: 0.01 mm in 100 mm of an etched or printed one.
const BOARD_TOLERANCE: f64 = 1e-4;
/// No tag is glued better, mm each axis.
const TAG_TOLERANCE_MM: f64 = 0.01;
/// Masks whose `M` is kept.
const KEPT_MASKS: usize = 32;
/// Shared shifts of the pairs that do not say what they share: one an axis.
const COMMON: usize = 3;

/// What a pair shows, or would show, base frame, mm.
#[derive(Debug, Clone, PartialEq)]
pub struct Seen {
    /// The wire's centre in the groove.
    pub groove_mm: Vector3<f64>,
    /// Arc length of the contact.
    pub arclength_mm: f64,
    /// Unit tangent of the wire there.
    pub tangent: Vector3<f64>,
    /// The centre line at the stations.
    pub stations_mm: Vec<Vector3<f64>>,
    /// Place among the pairs in order of time, 0 to 1.
    pub place: f64,
    /// How stereo-shape says that a wrong board and a tag glued askew move it; empty where it does not say.
    pub derivatives: Arc<Derivatives>,
}

/// Derivatives of what a pair shows by faults of the cameras' setup, as stated in shapes.json.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Derivatives {
    /// By the relative scale of the calibration board.
    pub board_scale: Option<Moved>,
    /// By the rig tag's position in its body, mm along x, y, z.
    pub rig_tag: Option<[Moved; 3]>,
}

/// A change of what a pair shows.
#[derive(Debug, Clone, PartialEq)]
pub struct Moved {
    /// Of the groove, mm.
    pub groove_mm: Vector3<f64>,
    /// Of the contact's arc length, mm.
    pub arclength_mm: f64,
    /// Of the stations, mm.
    pub stations_mm: Vec<Vector3<f64>>,
}

impl Seen {
    /// Adds `size` times a change.
    pub fn add(&mut self, moved: &Moved, size: f64) {
        self.groove_mm += moved.groove_mm * size;
        self.arclength_mm += moved.arclength_mm * size;
        for (station, by) in self.stations_mm.iter_mut().zip(&moved.stations_mm) {
            *station += by * size;
        }
    }
}

/// One pair with its reading.
#[derive(Clone)]
struct Pair {
    /// Reading on the path.
    reading: usize,
    /// Its node.
    node: usize,
    seen: Seen,
    /// Arc lengths of its stations, mm.
    stations_mm: Vec<f64>,
    /// From (groove, arc length, stations) to the observed values: the line is seen across only.
    normals: Vec<[Vector3<f64>; 2]>,
    /// Inverse Cholesky factor of its own errors.
    whitening: DMatrix<f64>,
    /// Variance of the groove's position, its own errors and shared ones, summed over the axes, mm^2.
    groove_mm2: f64,
    /// First of its values among all.
    first: usize,
}

/// Every pair that counts beside the wavelengths.
pub struct Pictures {
    pairs: Vec<Pair>,
    readings: Arc<Vec<usize>>,
    /// Whitened derivatives by the independent shared errors, values x errors.
    shared: DMatrix<f64>,
    /// Share of the stated own errors that counts.
    own_share: f64,
    /// `M` by the readings that count.
    roots: Mutex<HashMap<Vec<bool>, Arc<DMatrix<f64>>>>,
    /// Pairs that have a row and no place here, and why.
    left_out: Vec<PairLeftOut>,
}

impl Pictures {
    /// Pairs of the rows of `path`; none where there are none.
    #[must_use]
    pub fn new(rows: &[WhiskerRow], path: &WhiskerPath, shapes: Option<&SessionShapes>) -> Option<Self> {
        let shapes = shapes?;
        let of_node: HashMap<usize, usize> =
            path.nodes.iter().enumerate().filter_map(|(k, n)| Some((n.reading?, k))).collect();
        let factor = root_of(&with_tolerances(shapes));
        let (mut pairs, mut readings, mut shared) = (Vec::new(), Vec::new(), Vec::new());
        let mut left_out = Vec::new();
        for (reading, &row) in path.rows.iter().enumerate() {
            let r = &path.readings[reading];
            let Some(document) = &rows[row].pair else { continue };
            let loaded = of_node.get(&reading).filter(|_| r.line.is_some() && !r.rest);
            let found = loaded.zip(document.groove.as_ref()).and_then(|(&node, groove)| {
                observed(document, groove, reading, node, readings.len(), shapes)
            });
            let Some((mut pair, columns)) = found else {
                let why = "its errors or its reading say nothing of a contact".to_owned();
                left_out.push(PairLeftOut { name: document.name.clone(), why });
                continue;
            };
            readings.extend(std::iter::repeat_n(reading, columns.nrows()));
            let columns = columns * &factor;
            pair.groove_mm2 += columns.rows(0, 3).norm_squared();
            shared.push(&pair.whitening * columns);
            pairs.push(pair);
        }
        let count = pairs.len();
        for (k, pair) in pairs.iter_mut().enumerate() {
            pair.seen.place = if count > 1 { k as f64 / (count - 1) as f64 } else { 0.0 };
        }
        let mut all = DMatrix::zeros(readings.len(), factor.ncols());
        for (pair, own) in pairs.iter().zip(&shared) {
            all.rows_mut(pair.first, own.nrows()).copy_from(own);
        }
        (count > 0).then(|| Self {
            pairs,
            readings: Arc::new(readings),
            shared: all,
            own_share: 1.0,
            roots: Mutex::default(),
            left_out,
        })
    }

    /// The same pairs with `share` of the own errors that they state.
    #[must_use]
    pub fn with_own_share(&self, share: f64) -> Self {
        let stretch = self.own_share / share;
        let smaller = |p: &Pair| Pair { whitening: &p.whitening * stretch, ..p.clone() };
        Self {
            pairs: self.pairs.iter().map(smaller).collect(),
            readings: self.readings.clone(),
            shared: &self.shared * stretch,
            own_share: share,
            roots: Mutex::default(),
            left_out: self.left_out.clone(),
        }
    }

    /// Share of the stated own errors that counts.
    #[must_use]
    pub fn own_share(&self) -> f64 {
        self.own_share
    }

    /// Pairs that have a row and no place here, and why.
    #[must_use]
    pub fn left_out(&self) -> &[PairLeftOut] {
        &self.left_out
    }

    /// Pairs.
    #[must_use]
    pub fn len(&self) -> usize {
        self.pairs.len()
    }

    /// No pair.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.pairs.is_empty()
    }

    /// Distance of the contact from where it is seen that the stated covariances give, root mean square, mm.
    #[must_use]
    pub fn contact_floor_mm(&self) -> f64 {
        (self.pairs.iter().map(|p| p.groove_mm2).sum::<f64>() / self.pairs.len().max(1) as f64).sqrt()
    }

    /// Reading of each value.
    #[must_use]
    pub fn readings(&self) -> Arc<Vec<usize>> {
        self.readings.clone()
    }

    /// Node on the path of each pair.
    #[must_use]
    pub fn nodes(&self) -> Vec<usize> {
        self.pairs.iter().map(|p| p.node).collect()
    }

    /// Reading, arc lengths of the stations and what the pair shows.
    pub fn each(&self) -> impl Iterator<Item = (usize, &[f64], &Seen)> {
        self.pairs.iter().map(|p| (p.reading, p.stations_mm.as_slice(), &p.seen))
    }

    /// Measured less predicted, white with unit variance; zero where the reading does not count.
    #[must_use]
    pub fn whitened(&self, predicted: &[Seen], counts: impl Fn(usize) -> bool) -> DVector<f64> {
        let mut u = DVector::zeros(self.readings.len());
        for (pair, g) in self.pairs.iter().zip(predicted) {
            if counts(pair.reading) {
                let off = pair.difference(g);
                u.rows_mut(pair.first, off.len()).copy_from(&(&pair.whitening * off));
            }
        }
        let mask: Vec<bool> = self.pairs.iter().map(|p| counts(p.reading)).collect();
        let along = self.shared.tr_mul(&u);
        let mut taken = &self.shared * (&*self.root(&mask) * along);
        for (value, reading) in taken.iter_mut().zip(self.readings.iter()) {
            if !counts(*reading) {
                *value = 0.0;
            }
        }
        u + taken
    }

    /// `M` over the pairs of `mask`.
    fn root(&self, mask: &[bool]) -> Arc<DMatrix<f64>> {
        if let Ok(kept) = self.roots.lock()
            && let Some(found) = kept.get(mask)
        {
            return found.clone();
        }
        let mut counted = self.shared.clone();
        for (pair, counts) in self.pairs.iter().zip(mask) {
            if !counts {
                counted.rows_mut(pair.first, pair.whitening.nrows()).fill(0.0);
            }
        }
        let parts = counted.tr_mul(&counted).symmetric_eigen();
        // ((1 + s^2)^(-1/2) - 1) / s^2 tends to -1/2 where an error moves nothing.
        let shrink = |s2: f64| if s2 < 1e-9 { -0.5 } else { ((1.0 + s2).sqrt().recip() - 1.0) / s2 };
        let middle = DMatrix::from_diagonal(&parts.eigenvalues.map(|v| shrink(v.max(0.0))));
        let root = Arc::new(&parts.eigenvectors * middle * parts.eigenvectors.transpose());
        if let Ok(mut kept) = self.roots.lock() {
            if kept.len() >= KEPT_MASKS {
                kept.clear();
            }
            kept.insert(mask.to_vec(), root.clone());
        }
        root
    }
}

impl Pair {
    /// Measured less predicted in the observed values.
    fn difference(&self, predicted: &Seen) -> DVector<f64> {
        let groove = self.seen.groove_mm - predicted.groove_mm;
        let stations = self.seen.stations_mm.iter().zip(&predicted.stations_mm).map(|(a, b)| a - b);
        let change = Moved {
            groove_mm: groove,
            arclength_mm: self.seen.arclength_mm - predicted.arclength_mm,
            stations_mm: stations.collect(),
        };
        values(&change, &self.normals)
    }
}

/// The observed values of a change: groove, arc length, and the line across itself.
fn values(change: &Moved, normals: &[[Vector3<f64>; 2]]) -> DVector<f64> {
    let head = change.groove_mm.iter().copied().chain([change.arclength_mm]);
    let line = change.stations_mm.iter().zip(normals).flat_map(|(by, n)| [by.dot(&n[0]), by.dot(&n[1])]);
    DVector::from_vec(head.chain(line).collect())
}

/// A column of shapes.json at the stations `kept`.
fn moved(column: &ErrorColumn, kept: &[usize]) -> Moved {
    let station = |k: &usize| column.centreline_mm.get(*k).map_or_else(Vector3::zeros, |v| Vector3::from(*v));
    Moved {
        groove_mm: Vector3::from(column.groove_mm),
        arclength_mm: column.contact_arclength_mm,
        stations_mm: kept.iter().map(station).collect(),
    }
}

/// A pair's observations with their own errors, and the derivatives by the shared parameters, values x parameters.
fn observed(
    document: &PairDocument,
    groove: &GrooveDocument,
    reading: usize,
    node: usize,
    first: usize,
    shapes: &SessionShapes,
) -> Option<(Pair, DMatrix<f64>)> {
    let line = &document.centreline_mm;
    let kept = document.errors.as_ref().map_or_else(Vec::new, |e| stations(e, line));
    let of_errors = |k: &usize| document.errors.as_ref().map(|e| (e.stations[*k], e.stations_mm[*k]));
    let places: Vec<(usize, f64)> = kept.iter().filter_map(of_errors).collect();
    let stations_mm: Vec<Vector3<f64>> = places.iter().map(|(at, _)| Vector3::from(line[*at])).collect();
    let normals = places.iter().map(|(at, _)| across(line, *at)).collect::<Option<Vec<_>>>()?;
    let tangent = tangent_at(document, groove);
    let count = 4 + 2 * kept.len();
    let mut columns = DMatrix::zeros(count, shapes.parameters.len() + COMMON);
    let own = match &document.errors {
        Some(errors) => {
            let floor = errors.floor_mm.max(FLOOR_MM).powi(2);
            let mut own = DMatrix::identity(count, count) * floor;
            for column in &errors.own {
                let v = values(&moved(column, &kept), &normals);
                own += &v * v.transpose();
            }
            // Sealed pairs were fitted apart from the others; where their list is another they are looked at, never weighed.
            for (j, column) in errors.shared.iter().take(shapes.parameters.len()).enumerate() {
                columns.set_column(j, &values(&moved(column, &kept), &normals));
            }
            own
        }
        None => {
            let position = position_covariance(groove, &tangent);
            // The foot point on the wire moves with the groove along it.
            let root = position.symmetric_eigen();
            let root = root.eigenvectors
                * Matrix3::from_diagonal(&root.eigenvalues.map(|v| v.max(0.0).sqrt()))
                * root.eigenvectors.transpose();
            let first = shapes.parameters.len();
            columns.view_mut((0, first), (3, COMMON)).copy_from(&root);
            columns.view_mut((3, first), (1, COMMON)).copy_from(&(tangent.transpose() * root));
            stated(groove, &position, &tangent)
        }
    };
    let derivatives = document.errors.as_ref().map_or_else(Derivatives::default, |e| setup(e, &kept, shapes));
    let groove_mm2 = own.view((0, 0), (3, 3)).trace();
    let whitening = own.cholesky()?.l().try_inverse()?;
    let seen = Seen {
        groove_mm: Vector3::from(groove.position_mm),
        arclength_mm: groove.contact_arclength_mm,
        tangent,
        stations_mm,
        place: 0.0,
        derivatives: Arc::new(derivatives),
    };
    let arcs = places.iter().map(|(_, s)| *s).collect();
    let pair = Pair { reading, node, seen, stations_mm: arcs, normals, whitening, groove_mm2, first };
    Some((pair, columns))
}

/// What shapes.json says of a wrong board and a tag glued askew.
fn setup(errors: &PairErrors, kept: &[usize], shapes: &SessionShapes) -> Derivatives {
    let column = |named: &dyn Fn(&str, &str) -> bool| {
        let k = shapes.parameters.iter().position(|p| named(&p.cause, &p.name))?;
        Some(moved(errors.shared.get(k)?, kept))
    };
    let tag = |axis: &str| column(&|cause, name| cause == "rig-tag" && name == format!("rig-tag {axis}"));
    Derivatives {
        board_scale: column(&|cause, _| cause == "board-scale"),
        rig_tag: tag("x").zip(tag("y")).zip(tag("z")).map(|((x, y), z)| [x, y, z]),
    }
}

/// Covariance of the groove's position: as stated, else from the standard deviations: along the wire it is the tag's, across the wire's.
fn position_covariance(groove: &GrooveDocument, tangent: &Vector3<f64>) -> Matrix3<f64> {
    let floor = FLOOR_MM * FLOOR_MM;
    if let Some(covariance) = groove.covariance_mm2 {
        return Matrix3::from(covariance) + Matrix3::identity() * floor;
    }
    let along = groove.contact_arclength_sd_mm.max(FLOOR_MM).powi(2);
    let total: f64 = groove.sd_mm.iter().map(|s| s * s).sum();
    let across = (0.5 * (total - along)).max(0.04 * along).max(floor);
    let projector = tangent * tangent.transpose();
    (Matrix3::identity() - projector) * across + projector * along
}

/// Covariance of (groove, arc length) of a pair without `errors`: the foot point on the wire is as good as the groove along the wire and,
/// apart from it, as the wire across.
fn stated(groove: &GrooveDocument, position: &Matrix3<f64>, tangent: &Vector3<f64>) -> DMatrix<f64> {
    let with_foot = position * tangent;
    let along = tangent.dot(&with_foot);
    let across = 0.5 * (position.trace() - along);
    let mut own = DMatrix::zeros(4, 4);
    own.view_mut((0, 0), (3, 3)).copy_from(position);
    own.view_mut((0, 3), (3, 1)).copy_from(&with_foot);
    own.view_mut((3, 0), (1, 3)).copy_from(&with_foot.transpose());
    own[(3, 3)] = (along + across).max(groove.contact_arclength_sd_mm.powi(2));
    own
}

/// Stations that count: evenly spread past the seat.
fn stations(errors: &PairErrors, line: &[[f64; 3]]) -> Vec<usize> {
    let usable: Vec<usize> = (0..errors.stations_mm.len())
        .filter(|&k| errors.stations_mm[k] >= MIN_STATION_MM)
        .filter(|&k| across(line, errors.stations[k]).is_some())
        .collect();
    let count = usable.len().min(MAX_STATIONS);
    let mut kept: Vec<usize> = (0..count).map(|k| usable[(2 * k + 1) * usable.len() / (2 * count)]).collect();
    kept.dedup();
    kept
}

/// Two unit vectors across the measured line at point `k`.
fn across(line: &[[f64; 3]], k: usize) -> Option<[Vector3<f64>; 2]> {
    let (a, b) = (k.saturating_sub(1), (k + 1).min(line.len().checked_sub(1)?));
    let tangent = (Vector3::from(*line.get(b)?) - Vector3::from(*line.get(a)?)).try_normalize(1e-9)?;
    // Away from the axis that is nearest to the tangent.
    let far = if tangent.y.abs() < 0.7 { Vector3::y() } else { Vector3::z() };
    let first = tangent.cross(&far).try_normalize(1e-9)?;
    Some([first, tangent.cross(&first)])
}

/// The wire's direction in the groove: as stated, else by the nearest points of the line.
fn tangent_at(document: &PairDocument, groove: &GrooveDocument) -> Vector3<f64> {
    if let Some(axis) = Vector3::from(groove.axis).try_normalize(1e-6) {
        return axis;
    }
    let at = Vector3::from(groove.position_mm);
    let line: Vec<Vector3<f64>> = document.centreline_mm.iter().map(|p| Vector3::from(*p)).collect();
    let nearest = (0..line.len()).min_by(|&a, &b| (line[a] - at).norm().total_cmp(&(line[b] - at).norm()));
    let along = nearest.and_then(|k| {
        let (a, b) = (k.saturating_sub(1), (k + 1).min(line.len() - 1));
        (line[b] - line[a]).try_normalize(1e-9)
    });
    along.unwrap_or_else(Vector3::x)
}

/// The shared covariance; a board and a rig tag that stereo-shape takes as known are known to their tolerances.
fn with_tolerances(shapes: &SessionShapes) -> Vec<Vec<f64>> {
    let mut covariance = shapes.covariance.clone();
    for (k, parameter) in shapes.parameters.iter().enumerate() {
        let tolerance = match (parameter.cause.as_str(), parameter.unit.as_str()) {
            ("board-scale", _) => BOARD_TOLERANCE,
            ("rig-tag", "mm") => TAG_TOLERANCE_MM,
            _ => continue,
        };
        if let Some(variance) = covariance.get_mut(k).and_then(|row| row.get_mut(k)) {
            *variance = variance.max(tolerance * tolerance);
        }
    }
    covariance
}

/// `C^(1/2)`: columns are independent errors of one standard deviation; parameters of no variance are taken as known. The common shifts
/// stand behind the parameters.
fn root_of(covariance: &[Vec<f64>]) -> DMatrix<f64> {
    let n = covariance.len();
    if n == 0 {
        return DMatrix::identity(COMMON, COMMON);
    }
    // In units of the standard deviations: pixels and radians differ by orders of magnitude.
    let sd: Vec<f64> = (0..n).map(|i| covariance[i][i].max(0.0).sqrt()).collect();
    let correlation = DMatrix::from_fn(n, n, |i, j| {
        let scale = sd[i] * sd[j];
        if scale > 0.0 { 0.5 * (covariance[i][j] + covariance[j][i]) / scale } else { 0.0 }
    });
    let parts = correlation.symmetric_eigen();
    let kept: Vec<usize> = (0..n).filter(|&k| parts.eigenvalues[k] > 1e-9).collect();
    DMatrix::from_fn(n + COMMON, kept.len() + COMMON, |i, k| match (i < n, kept.get(k)) {
        (true, Some(&part)) => sd[i] * parts.eigenvectors[(i, part)] * parts.eigenvalues[part].sqrt(),
        (false, None) if i - n == k - kept.len() => 1.0,
        _ => 0.0,
    })
}
