//! From a pair of shapes.json to what is observed, its own errors and the derivatives by what all
//! pairs share (`pictures`).

use crate::models::root;
use nalgebra::{DMatrix, DVector, Matrix3, Vector3};
use std::sync::Arc;
use wcal_core::observation::SessionShapes;
use wcal_core::shapes_document::{ErrorColumn, GrooveDocument, PairDocument, PairErrors};

/// What a pair shows, or would show, base frame, mm.
#[derive(Debug, Clone, PartialEq)]
pub struct PairObservation {
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
    /// How stereo-shape says that a wrong board and a tag glued askew move it; empty where it does
    /// not say.
    pub derivatives: Arc<Derivatives>,
}

/// Derivatives of what a pair shows by faults of the cameras' setup, as stated in shapes.json.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Derivatives {
    /// By the relative scale of the calibration board.
    pub board_scale: Option<PairChange>,
    /// By the rig tag's position in its body, mm along x, y, z.
    pub rig_tag: Option<[PairChange; 3]>,
}

/// A change of what a pair shows.
#[derive(Debug, Clone, PartialEq)]
pub struct PairChange {
    /// Of the groove, mm.
    pub groove_mm: Vector3<f64>,
    /// Of the contact's arc length, mm.
    pub arclength_mm: f64,
    /// Of the stations, mm.
    pub stations_mm: Vec<Vector3<f64>>,
}

impl PairObservation {
    /// Adds `size` times a change.
    pub fn add(&mut self, moved: &PairChange, size: f64) {
        self.groove_mm += moved.groove_mm * size;
        self.arclength_mm += moved.arclength_mm * size;
        for (station, by) in self.stations_mm.iter_mut().zip(&moved.stations_mm) {
            *station += by * size;
        }
    }
}

/// One pair with its reading.
#[derive(Clone)]
pub(super) struct Pair {
    /// Reading on the path.
    pub(super) reading: usize,
    /// Its node.
    pub(super) node: usize,
    pub(super) seen: PairObservation,
    /// Arc lengths of its stations, mm.
    pub(super) stations_mm: Vec<f64>,
    /// From (groove, arc length, stations) to the observed values: the line is seen across only.
    pub(super) normals: Vec<[Vector3<f64>; 2]>,
    /// Inverse Cholesky factor of the picture's own errors.
    pub(super) whitening: DMatrix<f64>,
    /// Variance of the groove's position, its own errors and shared ones, summed over the axes,
    /// mm^2.
    pub(super) groove_mm2: f64,
    /// First of its values among all.
    pub(super) first: usize,
}

/// Stations of the centre line that count at most, spread evenly from root to tip: past the contact
/// the wire is free, and its tail shows the slope there with the longest lever.
const MAX_STATIONS: usize = 12;
/// Nearer to the root than this the wire is in its seat and tells nothing, mm.
const MIN_STATION_MM: f64 = 4.0;
/// Part of the stated error below which nothing is believed, mm: rounding of the file and of the
/// rod.
const FLOOR_MM: f64 = 1e-3;
/// No board is known better, as a share of its size: 0.01 mm in 100 mm of an etched or printed one.
const BOARD_TOLERANCE: f64 = 1e-4;
/// No tag is glued better, mm each axis.
const TAG_TOLERANCE_MM: f64 = 0.01;
/// Shared shifts of the pairs that do not say what they share: one an axis.
const COMMON: usize = 3;

/// The observed values of a change: groove, arc length, and the line across itself.
pub(super) fn values(change: &PairChange, normals: &[[Vector3<f64>; 2]]) -> DVector<f64> {
    let head = change
        .groove_mm
        .iter()
        .copied()
        .chain([change.arclength_mm]);
    // A point that slides along the line leaves the picture of the line as it is.
    let line = change
        .stations_mm
        .iter()
        .zip(normals)
        .flat_map(|(by, n)| [by.dot(&n[0]), by.dot(&n[1])]);
    DVector::from_vec(head.chain(line).collect())
}

/// A column of shapes.json at the stations `kept`.
fn moved(column: &ErrorColumn, kept: &[usize]) -> PairChange {
    let station = |k: &usize| {
        column
            .centreline_mm
            .get(*k)
            .map_or_else(Vector3::zeros, |v| Vector3::from(*v))
    };
    PairChange {
        groove_mm: Vector3::from(column.groove_mm),
        arclength_mm: column.contact_arclength_mm,
        stations_mm: kept.iter().map(station).collect(),
    }
}

/// A pair's observations with their own errors, and the derivatives by the shared parameters,
/// values x parameters.
pub(super) fn observe(
    document: &PairDocument,
    groove: &GrooveDocument,
    reading: usize,
    node: usize,
    first: usize,
    shapes: &SessionShapes,
) -> Option<(Pair, DMatrix<f64>)> {
    let line = &document.centreline_mm;
    let kept = document
        .errors
        .as_ref()
        .map_or_else(Vec::new, |e| stations(e, line));
    let of_errors = |k: &usize| {
        document
            .errors
            .as_ref()
            .map(|e| (e.stations[*k], e.stations_mm[*k]))
    };
    let places: Vec<(usize, f64)> = kept.iter().filter_map(of_errors).collect();
    let stations_mm: Vec<Vector3<f64>> = places
        .iter()
        .map(|(at, _)| Vector3::from(line[*at]))
        .collect();
    let normals = places
        .iter()
        .map(|(at, _)| across(line, *at))
        .collect::<Option<Vec<_>>>()?;
    let tangent = tangent_at(document, groove);
    let count = 4 + 2 * kept.len();
    let mut columns = DMatrix::zeros(count, shapes.parameters.len() + COMMON);
    let own = match &document.errors {
        Some(errors) => {
            let floor = errors.floor_mm.max(FLOOR_MM).powi(2);
            let mut own = DMatrix::identity(count, count) * floor;
            for column in &errors.own {
                let v = values(&moved(column, &kept), &normals);
                // Independent errors of one standard deviation each: their outer products add.
                own += &v * v.transpose();
            }
            // Sealed pairs were fitted by themselves; where their list is another they are
            // compared, never weighed.
            for (j, column) in errors
                .shared
                .iter()
                .take(shapes.parameters.len())
                .enumerate()
            {
                columns.set_column(j, &values(&moved(column, &kept), &normals));
            }
            own
        }
        None => {
            let position = position_covariance(groove, &tangent);
            // The foot point on the wire moves with the groove along it.
            // Symmetric root of the covariance: a shift of one standard deviation along each axis.
            let root = position.symmetric_eigen();
            let root = root.eigenvectors
                * Matrix3::from_diagonal(&root.eigenvalues.map(|v| v.max(0.0).sqrt()))
                * root.eigenvectors.transpose();
            let first = shapes.parameters.len();
            columns.view_mut((0, first), (3, COMMON)).copy_from(&root);
            columns
                .view_mut((3, first), (1, COMMON))
                .copy_from(&(tangent.transpose() * root));
            stated(groove, &position, &tangent)
        }
    };
    let derivatives = document
        .errors
        .as_ref()
        .map_or_else(Derivatives::default, |e| setup(e, &kept, shapes));
    let groove_mm2 = own.view((0, 0), (3, 3)).trace();
    // L^-1 of N = L L' gives the pair's own errors unit variance.
    let whitening = own.cholesky()?.l().try_inverse()?;
    let seen = PairObservation {
        groove_mm: Vector3::from(groove.position_mm),
        arclength_mm: groove.contact_arclength_mm,
        tangent,
        stations_mm,
        place: 0.0,
        derivatives: Arc::new(derivatives),
    };
    let arcs = places.iter().map(|(_, s)| *s).collect();
    let pair = Pair {
        reading,
        node,
        seen,
        stations_mm: arcs,
        normals,
        whitening,
        groove_mm2,
        first,
    };
    Some((pair, columns))
}

/// What shapes.json says of a wrong board and a tag glued askew.
fn setup(errors: &PairErrors, kept: &[usize], shapes: &SessionShapes) -> Derivatives {
    let column = |named: &dyn Fn(&str, &str) -> bool| {
        let k = shapes
            .parameters
            .iter()
            .position(|p| named(&p.cause, &p.name))?;
        Some(moved(errors.shared.get(k)?, kept))
    };
    let tag =
        |axis: &str| column(&|cause, name| cause == "rig-tag" && name == format!("rig-tag {axis}"));
    Derivatives {
        board_scale: column(&|cause, _| cause == "board-scale"),
        rig_tag: tag("x")
            .zip(tag("y"))
            .zip(tag("z"))
            .map(|((x, y), z)| [x, y, z]),
    }
}

/// Covariance of the groove's position: as stated, else from the standard deviations: along the
/// wire it is the tag's, across the wire's.
fn position_covariance(groove: &GrooveDocument, tangent: &Vector3<f64>) -> Matrix3<f64> {
    let floor = FLOOR_MM * FLOOR_MM;
    if let Some(covariance) = groove.covariance_mm2 {
        return Matrix3::from(covariance) + Matrix3::identity() * floor;
    }
    let along = groove.contact_arclength_sd_mm.max(FLOOR_MM).powi(2);
    let total: f64 = groove.sd_mm.iter().map(|s| s * s).sum();
    // What the three deviations have beyond the one along the wire is shared by two axes.
    let across = (0.5 * (total - along)).max(0.04 * along).max(floor);
    let projector = tangent * tangent.transpose();
    (Matrix3::identity() - projector) * across + projector * along
}

/// Covariance of (groove, arc length) of a pair without `errors`: the foot point on the wire is as
/// good as the groove along the wire and, across it, as the wire across.
fn stated(
    groove: &GrooveDocument,
    position: &Matrix3<f64>,
    tangent: &Vector3<f64>,
) -> DMatrix<f64> {
    let with_foot = position * tangent;
    let along = tangent.dot(&with_foot);
    let across = 0.5 * (position.trace() - along);
    let mut own = DMatrix::zeros(4, 4);
    own.view_mut((0, 0), (3, 3)).copy_from(position);
    own.view_mut((0, 3), (3, 1)).copy_from(&with_foot);
    own.view_mut((3, 0), (1, 3))
        .copy_from(&with_foot.transpose());
    // The foot point moves with the groove along the wire and with the wire across it.
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
    // The middles of equal shares: neither root nor tip weighs more.
    let mut kept: Vec<usize> = (0..count)
        .map(|k| usable[(2 * k + 1) * usable.len() / (2 * count)])
        .collect();
    kept.dedup();
    kept
}

/// Two unit vectors across the measured line at point `k`.
fn across(line: &[[f64; 3]], k: usize) -> Option<[Vector3<f64>; 2]> {
    let (a, b) = (k.saturating_sub(1), (k + 1).min(line.len().checked_sub(1)?));
    let tangent =
        (Vector3::from(*line.get(b)?) - Vector3::from(*line.get(a)?)).try_normalize(1e-9)?;
    // Away from the axis that is nearest to the tangent.
    let far = if tangent.y.abs() < 0.7 {
        Vector3::y()
    } else {
        Vector3::z()
    };
    let first = tangent.cross(&far).try_normalize(1e-9)?;
    Some([first, tangent.cross(&first)])
}

/// The wire's direction in the groove: as stated, else by the nearest points of the line.
fn tangent_at(document: &PairDocument, groove: &GrooveDocument) -> Vector3<f64> {
    if let Some(axis) = Vector3::from(groove.axis).try_normalize(1e-6) {
        return axis;
    }
    let at = Vector3::from(groove.position_mm);
    let line: Vec<Vector3<f64>> = document
        .centreline_mm
        .iter()
        .map(|p| Vector3::from(*p))
        .collect();
    let nearest =
        (0..line.len()).min_by(|&a, &b| (line[a] - at).norm().total_cmp(&(line[b] - at).norm()));
    let along = nearest.and_then(|k| {
        let (a, b) = (k.saturating_sub(1), (k + 1).min(line.len() - 1));
        (line[b] - line[a]).try_normalize(1e-9)
    });
    along.unwrap_or_else(Vector3::x)
}

/// The shared covariance; a board and a rig tag that stereo-shape takes as known are known to their
/// tolerances.
pub(super) fn with_tolerances(shapes: &SessionShapes) -> Vec<Vec<f64>> {
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

/// `C^(1/2)`: columns are independent errors of one standard deviation; parameters of no variance
/// are taken as known. The common shifts stand behind the parameters.
pub(super) fn root_of(covariance: &[Vec<f64>]) -> DMatrix<f64> {
    let n = covariance.len();
    let mut all = DMatrix::identity(n + COMMON, n + COMMON);
    if n > 0 {
        all.view_mut((0, 0), (n, n)).copy_from(&root(covariance));
    }
    all
}
