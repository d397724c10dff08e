//! How often what `stereo-shape` states of pairs of pictures holds. SIMULATED.
//!
//! Cameras of the simulated bench look at a chessboard, which `stereo-calibrate` calibrates them by,
//! and then at a wire that the groove pushes. The pictures' noise is read and shot noise. What is
//! stated allows for a clamp with play and for a board that is not quite its size: both are drawn.
//!
//! ```text
//! in space     d' C^-1 d <= 7.815    d: stated less true place, C: stated covariance, errors that pairs share included
//! across       the true line passes within 2.4477 stated sd
//! one number   the truth lies within 1.96 stated sd
//! ```
//!
//! Pairs of a folder share their cameras, and stations of a line nearly all of their error: the
//! interval of a share, which counts statements, is too narrow.

use crate::statements::{Auditor, Counted, Labelled, StatementRow, in_ellipsoid, tallied};
use anyhow::Context;
use nalgebra::{DMatrix, Isometry3, Matrix3, Vector3};
use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use serde::{Deserialize, Serialize};
use std::path::Path;
use wcal_plant::cameras::{Appearance, Groove, RigGeometry, View, clean, default_pair, exposed};
use wcal_plant::rod::Wire;
use wcal_plant::section::centre_line_arcs;
use wcal_plant::{WireError, table};

type V3 = Vector3<f64>;

/// Size of the pictures, px.
pub const PICTURE_PX: [usize; 2] = [640, 480];
/// Pairs of pictures of a folder.
pub const PAIRS: usize = 8;
/// Attitudes of the board that calibrate the cameras.
const BOARD_VIEWS: usize = 12;
/// The rig of [`RigGeometry::default`] as its file.
const RIG: &str = include_str!("../../../fixtures/stereo_bench/rig.toml");
/// Radius of a circle that holds 95 % of a plane Gaussian, and half width of an interval that holds
/// 95 % of a normal number, in standard deviations.
const CIRCLE_95: f64 = 2.4477;
const NORMAL_95: f64 = 1.96;
/// Standard deviations that docs/src/guide/pictures.md states: sides of the board's squares, and
/// the wire's root in its clamp (mm, rad).
const SQUARE_SD: f64 = 1e-4;
const CLAMP_SD: [f64; 2] = [0.003, 1e-4];
/// Step along the drawn wire, mm: the pictures cut its end square where a step is longer than the
/// wire's half width.
const STEP_MM: f64 = 0.2;

/// The rig's wire in the groove.
#[derive(Debug, Clone, Serialize)]
pub struct PushedWire {
    /// The wire's centre in the vertex, mm.
    pub groove_mm: V3,
    /// Its tangent there.
    pub axis: V3,
    /// Direction of the push.
    pub push: V3,
    /// Arc length of the contact, mm.
    pub arclength_mm: f64,
    /// Centre line from root to tip, mm.
    pub line_mm: Vec<V3>,
    /// Arc length of each of its points, mm.
    pub arcs_mm: Vec<f64>,
}

impl PushedWire {
    /// Draws place, direction and depth of a push.
    ///
    /// # Errors
    /// Where the rod does not settle.
    pub fn draw(rng: &mut impl Rng) -> Result<Self, WireError> {
        let wire = Wire::new(0.3, 60.0, 30.0, 20.0, 75.0, 28.2);
        let mut one_of = |three: [f64; 3]| three[(3.0 * rng.random::<f64>()) as usize];
        let nominal_mm = one_of([18.0, 31.0, 45.0]);
        let angle = one_of([0.0, -60.0, 60.0]).to_radians();
        let (origin_mm, tangent) = wire.rest(nominal_mm);
        // Across the wire, turned about it from "up".
        let up = -V3::y().cross(&tangent).normalize();
        let direction = up * angle.cos() + V3::y() * angle.sin();
        let depth_mm = 1.7 + 3.3 * rng.random::<f64>();
        let path = table::Path {
            origin_mm,
            direction,
            arclength_mm: nominal_mm,
            offset_mm: V3::zeros(),
        };
        let found = table::equilibrium(&wire, &path, 0.4 * nominal_mm, depth_mm)?;
        let groove_mm = path.at(depth_mm);
        Ok(Self {
            groove_mm,
            axis: found.tangent,
            push: direction,
            arclength_mm: found.arclength_mm,
            line_mm: wire.centre_line(Some((&groove_mm, &found)), STEP_MM),
            arcs_mm: centre_line_arcs(&wire, found.arclength_mm, STEP_MM),
        })
    }

    /// The same with its root displaced and turned in the clamp.
    fn moved(mut self, by: &Isometry3<f64>) -> Self {
        let place = |p: V3| (by * nalgebra::Point3::from(p)).coords;
        self.groove_mm = place(self.groove_mm);
        (self.axis, self.push) = (by * self.axis, by * self.push);
        self.line_mm.iter_mut().for_each(|p| *p = place(*p));
        self
    }

    /// The rig with the wire in the groove.
    pub fn scene(&self) -> View {
        let groove = Groove {
            position_mm: self.groove_mm,
            axis: self.axis,
            push: self.push,
        };
        RigGeometry::default().scene(self.line_mm.clone(), Some(&groove))
    }

    /// Distance of a point from the centre line, mm.
    pub fn distance_mm(&self, p: &V3) -> f64 {
        let to = |w: &[V3]| {
            let run = w[1] - w[0];
            let share = ((p - w[0]).dot(&run) / run.norm_squared()).clamp(0.0, 1.0);
            (p - w[0] - run * share).norm()
        };
        self.line_mm
            .windows(2)
            .map(to)
            .fold(f64::INFINITY, f64::min)
    }

    /// The centre line at an arc length, mm.
    fn at(&self, arc_mm: f64) -> V3 {
        let last = self.arcs_mm.len() - 2;
        let k = self
            .arcs_mm
            .partition_point(|a| *a <= arc_mm)
            .clamp(1, last + 1)
            - 1;
        let share = (arc_mm - self.arcs_mm[k]) / (self.arcs_mm[k + 1] - self.arcs_mm[k]);
        self.line_mm[k] + (self.line_mm[k + 1] - self.line_mm[k]) * share
    }
}

/// Writes what both cameras see of each view, `left/KK.pgm` and `right/KK.pgm`.
///
/// # Errors
/// Where a file cannot be written.
pub fn write_pairs(folder: &Path, views: &[View], seed: u64) -> std::io::Result<()> {
    let look = Appearance::default();
    for ((side, lens), camera) in ["left", "right"]
        .iter()
        .zip(default_pair(PICTURE_PX))
        .zip(0..)
    {
        std::fs::create_dir_all(folder.join(side))?;
        for (k, view) in views.iter().enumerate() {
            let noise = seed + 2 * k as u64 + camera;
            let grey = exposed(&clean(&lens, view, &look), &look, noise);
            let head = format!("P5 {} {} 255\n", PICTURE_PX[0], PICTURE_PX[1]);
            let file = folder.join(format!("{side}/{k:02}.pgm"));
            std::fs::write(file, [head.as_bytes(), &grey].concat())?;
        }
    }
    Ok(())
}

/// The parts of `shapes.json` that are counted.
#[derive(Deserialize)]
struct Shapes {
    pairs: Vec<Pair>,
    shared_covariance: Vec<Vec<f64>>,
}

#[derive(Deserialize)]
struct Pair {
    status: String,
    centreline_mm: Vec<V3>,
    centreline_sd_mm: Vec<f64>,
    length_mm: f64,
    length_sd_mm: f64,
    errors: Option<Errors>,
    groove: Option<StatedGroove>,
}

#[derive(Deserialize)]
struct StatedGroove {
    position_mm: V3,
    covariance_mm2: [V3; 3],
    contact_arclength_mm: f64,
    contact_arclength_sd_mm: f64,
}

#[derive(Deserialize)]
struct Errors {
    stations: Vec<usize>,
    stations_mm: Vec<f64>,
    own: Vec<Column>,
    floor_mm: f64,
    shared: Vec<Column>,
}

#[derive(Deserialize)]
struct Column {
    centreline_mm: Vec<V3>,
}

impl Errors {
    /// Covariance of a station by the pair's own errors and by those that pairs share.
    fn covariance(&self, station: usize, shared: &DMatrix<f64>) -> Matrix3<f64> {
        let columns = |of: &[Column]| {
            let each: Vec<V3> = of.iter().map(|c| c.centreline_mm[station]).collect();
            DMatrix::from_fn(3, each.len(), |row, column| each[column][row])
        };
        let (own, by) = (columns(&self.own), columns(&self.shared));
        let sum = &own * own.transpose() + &by * shared * by.transpose();
        Matrix3::from_fn(|i, j| sum[(i, j)]) + Matrix3::identity() * self.floor_mm.powi(2)
    }
}

impl Auditor {
    /// Draws so many folders of pictures of a board and of so many pushed wires, calibrates the
    /// cameras of each, and counts what is stated of each wire.
    ///
    /// # Errors
    /// Where a picture cannot be written or the program cannot be started.
    pub fn audit_stereo(
        &self,
        folders: usize,
        pairs: usize,
        seed: u64,
    ) -> anyhow::Result<Vec<StatementRow>> {
        let seeds: Vec<u64> = (0..folders as u64)
            .map(|k| seed.wrapping_mul(1_000_003).wrapping_add(k))
            .collect();
        let label = |c| (c, "white", [folders, 0]);
        let counted = self.each(&seeds, |seed| -> anyhow::Result<Vec<Labelled>> {
            Ok(self
                .pictured(*seed, pairs)?
                .into_iter()
                .map(label)
                .collect())
        })?;
        Ok(tallied(counted))
    }

    fn pictured(&self, seed: u64, pairs: usize) -> anyhow::Result<Vec<Counted>> {
        let folder = self.folder.join(format!("pictures-{seed}"));
        let (board, scene, rig) = (
            folder.join("board"),
            folder.join("scene"),
            RigGeometry::default(),
        );
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let first = rng.random_range(0..1000_usize);
        let boards: Vec<View> = (0..BOARD_VIEWS)
            .map(|k| rig.board_view(first + k))
            .collect();
        write_pairs(&board, &boards, rng.next_u64() >> 8)?;
        let normal = |sd: f64, rng: &mut ChaCha8Rng| -> V3 {
            V3::from_fn(|_, _| sd * Distribution::<f64>::sample(&StandardNormal, rng))
        };
        // One mounting a folder: across the wire alone, since its root is where it leaves the clamp.
        let mut across = |sd: f64| V3::new(0.0, 1.0, 1.0).component_mul(&normal(sd, &mut rng));
        let clamp = Isometry3::new(across(CLAMP_SD[0]), across(CLAMP_SD[1]));
        let square_mm = 6.0 * (1.0 + normal(SQUARE_SD, &mut rng).x);
        let wires: Vec<PushedWire> = (0..pairs)
            .map(|_| Ok(PushedWire::draw(&mut rng)?.moved(&clamp)))
            .collect::<Result<_, WireError>>()?;
        let scenes: Vec<View> = wires.iter().map(PushedWire::scene).collect();
        write_pairs(&scene, &scenes, rng.next_u64() >> 8)?;
        std::fs::write(folder.join("truth.json"), serde_json::to_string(&wires)?)?;
        std::fs::write(folder.join("rig.toml"), RIG)?;
        let [cameras, shapes] = ["cameras", "shapes"].map(|name| folder.join(name));
        let square_mm = square_mm.to_string();
        let stated = [["--square-mm", &square_mm], ["--board", "9x6"]].concat();
        self.run_on_pairs("stereo-calibrate", &board, &cameras, &stated)?;
        let [file, rig] =
            ["cameras/stereo.json", "rig.toml"].map(|name| folder.join(name).display().to_string());
        let stated = ["--cameras", &file, "--rig", &rig];
        self.run_on_pairs("stereo-shape", &scene, &shapes, &stated)?;
        let text = std::fs::read_to_string(shapes.join("shapes.json"))
            .with_context(|| format!("reading the shapes of {}", scene.display()))?;
        let shapes: Shapes = serde_json::from_str(&text)?;
        let c = &shapes.shared_covariance;
        let shared = DMatrix::from_fn(c.len(), c.len(), |i, j| c[i][j]);
        let each = shapes.pairs.iter().zip(&wires);
        Ok(each
            .flat_map(|(p, w)| self.of_pair(p, w, &shared))
            .collect())
    }

    fn run_on_pairs(
        &self,
        command: &str,
        pictures: &Path,
        out: &Path,
        more: &[&str],
    ) -> anyhow::Result<()> {
        let [left, right] = ["left", "right"].map(|side| pictures.join(side));
        let mut arguments: Vec<&std::ffi::OsStr> = vec![command.as_ref()];
        arguments.extend([
            left.as_os_str(),
            right.as_os_str(),
            "--out".as_ref(),
            out.as_ref(),
        ]);
        arguments.extend(more.iter().map(|a| std::ffi::OsStr::new(*a)));
        self.run(&arguments)
    }

    /// What is stated of one pair; that it is used at all is said of none.
    fn of_pair(&self, pair: &Pair, wire: &PushedWire, shared: &DMatrix<f64>) -> Vec<Counted> {
        let of = |statement: &str, held| Counted::new(format!("stereo, {statement}"), 0.95, held);
        let within = |off: f64, sd: f64| off.abs() <= NORMAL_95 * sd * self.widened;
        let wider = self.widened.powi(2);
        let mut out = vec![of("a pair is used", pair.status == "ok").unsaid()];
        let (Some(errors), "ok") = (&pair.errors, pair.status.as_str()) else {
            return out;
        };
        let true_length_mm = wire.arcs_mm.last().copied().unwrap_or_default();
        let length = within(pair.length_mm - true_length_mm, pair.length_sd_mm);
        out.push(of("length inside 1.96 sd", length));
        // The root is the frame's origin.
        for (k, (place, arc_mm)) in errors
            .stations
            .iter()
            .zip(&errors.stations_mm)
            .enumerate()
            .skip(1)
        {
            let p = pair.centreline_mm[*place];
            let radius_mm = CIRCLE_95 * pair.centreline_sd_mm[*place] * self.widened;
            out.push(of("line in its circle", wire.distance_mm(&p) <= radius_mm));
            let covariance = errors.covariance(k, shared) * wider;
            let held = in_ellipsoid(&(p - wire.at(*arc_mm)), covariance);
            out.push(of("point of the line in its ellipsoid", held));
        }
        if let Some(groove) = &pair.groove {
            let covariance = Matrix3::from_columns(&groove.covariance_mm2) * wider;
            let off = groove.position_mm - wire.groove_mm;
            out.push(of(
                "contact in its ellipsoid",
                in_ellipsoid(&off, covariance),
            ));
            let off = groove.contact_arclength_mm - wire.arclength_mm;
            let held = within(off, groove.contact_arclength_sd_mm);
            out.push(of("contact's arc length inside 1.96 sd", held));
        }
        out
    }
}
