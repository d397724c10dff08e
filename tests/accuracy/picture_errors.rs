//! Do the standard deviations of `shapes.json` hold? Pictures of the plant's cameras, which share
//! no code with the program, and cameras that are known only as well as a calibration from noisy
//! corners knows them (SIMULATED).
//!
//! ```text
//! Sigma = blockdiag(own_i own_i' + floor_i^2 I) + S C S'        chi2 = e' Sigma^-1 e        e: all pairs' errors against the truth
//! ```
//! over groove position and contact arc length of all pairs of a folder together: errors that pairs
//! share and those of their own both count.

use crate::support::fixture;
use nalgebra::{DMatrix, DVector, Isometry3, Point3, UnitQuaternion, Vector2, Vector3};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use rand_distr::{Distribution, Normal};
use wcal_bench::cameras::default_pair;
use wcal_core::shapes_document::{ErrorColumn, PairDocument, ShapesDocument};
use wcal_exam::stereo_statements::{PICTURE_PX as SIZE, PushedWire, write_pairs};
use wcal_vision::calibrate::board::board_points;
use wcal_vision::calibrate::bundle::{BoardView, BundleState, Free, solve};
use wcal_vision::camera::Camera;
use wcal_vision::camera::OPENCV5;
use wcal_vision::pairs::{list_pictures, pair_files};
use wcal_vision::rig::Rig;
use wcal_vision::shape::folder::shapes_of_pairs;
use wcal_vision::stereo::StereoCameras;

type V3 = Vector3<f64>;

/// The plant's cameras as a calibration from 12 board views with 0.05 px of noise a corner finds
/// them.
fn calibrated(seed: u64) -> StereoCameras {
    let lenses = default_pair(SIZE);
    let camera = |k: usize| Camera {
        image_size_px: SIZE,
        focal_px: lenses[k].focal_px,
        centre_px: lenses[k].centre_px,
        lens: OPENCV5,
        distortion: lenses[k].distortion,
    };
    let turn = |x: f64, y: f64, z: f64| UnitQuaternion::from_scaled_axis(V3::new(x, y, z));
    let right_from_left = lenses[1].camera_from_base * lenses[0].camera_from_base.inverse();
    let truth = BundleState {
        cameras: [camera(0), camera(1)],
        right_from_left,
        warp: [0.0; 2],
        left_from_board: (0..12)
            .map(|k| {
                let t = f64::from(k);
                let place = V3::new(
                    8.0 * (1.3 * t).sin(),
                    6.0 * (2.1 * t).cos(),
                    292.0 + 8.0 * (0.7 * t).sin(),
                );
                let tilt = turn(
                    0.45 * (1.9 * t).sin(),
                    0.45 * (1.1 * t + 1.0).cos(),
                    0.2 * (t - 6.0).sin(),
                );
                Isometry3::from_parts(place.into(), tilt)
                    * Isometry3::translation(-24.0, -15.0, 0.0)
            })
            .collect(),
    };
    let points = board_points(9, 6, 6.0);
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let normal = Normal::new(0.0, 0.05).unwrap();
    let mut see = |camera: usize, pose: Isometry3<f64>| -> Vec<Option<Vector2<f64>>> {
        let mut see = |p: &V3| {
            let px = truth.cameras[camera].project(&(pose * Point3::from(*p)).coords)?;
            Some(px + Vector2::new(normal.sample(&mut rng), normal.sample(&mut rng)))
        };
        points.iter().map(&mut see).collect()
    };
    let views: Vec<BoardView> = truth
        .left_from_board
        .iter()
        .map(|pose| BoardView {
            name: String::new(),
            corners: [see(0, *pose), see(1, truth.right_from_left * pose)],
        })
        .collect();
    let found = solve(&points, &views, truth.clone(), Free::All(false));
    let count = 2 * truth.cameras[0].intrinsics() + 6;
    StereoCameras {
        cameras: found.state.cameras.clone(),
        right_from_left: found.state.right_from_left,
        covariance: Some(
            found
                .shared_covariance
                .view((0, 0), (count, count))
                .into_owned(),
        ),
    }
}

/// Draws `count` pushes at random places, directions and depths, and finds their shapes. A pair
/// that is rejected says why and is left out.
fn folder(seed: u64, count: usize) -> (ShapesDocument, Vec<PushedWire>) {
    let place = tempfile::tempdir().unwrap();
    let mut rng = ChaCha8Rng::seed_from_u64(1000 + seed);
    let mut wires: Vec<PushedWire> = (0..count)
        .map(|_| PushedWire::draw(&mut rng).unwrap())
        .collect();
    let views: Vec<_> = wires.iter().map(PushedWire::scene).collect();
    write_pairs(place.path(), &views, 100 * seed).unwrap();
    let [left, right] = ["left", "right"]
        .map(|side| list_pictures(&place.path().join(side).display().to_string()).unwrap());
    let rig = Rig::read(&fixture("stereo_bench/rig.toml")).unwrap();
    let files = pair_files(&left, &right).unwrap();
    let mut document = shapes_of_pairs(&calibrated(seed), &rig, &files, &|_| {}).document;
    let good: Vec<bool> = document.pairs.iter().map(|p| p.status == "ok").collect();
    for pair in document.pairs.iter().filter(|p| p.status != "ok") {
        println!("folder {seed}: {} rejected: {}", pair.name, pair.why);
    }
    let mut kept = good.iter();
    document.pairs.retain(|_| *kept.next().unwrap());
    let mut kept = good.iter();
    wires.retain(|_| *kept.next().unwrap());
    (document, wires)
}

fn four(c: &ErrorColumn) -> [f64; 4] {
    [
        c.groove_mm[0],
        c.groove_mm[1],
        c.groove_mm[2],
        c.contact_arclength_mm,
    ]
}

/// Errors of all pairs against the truth (groove, arc length), own covariance, and derivatives by
/// the shared parameters.
fn stacked(
    document: &ShapesDocument,
    truths: &[PushedWire],
) -> (DVector<f64>, DMatrix<f64>, DMatrix<f64>) {
    let n = 4 * truths.len();
    let mut errors = DVector::zeros(n);
    let mut own = DMatrix::zeros(n, n);
    let mut shared = DMatrix::zeros(n, document.shared_parameters.len());
    for (k, (pair, truth)) in document.pairs.iter().zip(truths).enumerate() {
        let (groove, stated) = (pair.groove.as_ref().unwrap(), pair.errors.as_ref().unwrap());
        let off = V3::from(groove.position_mm) - truth.groove_mm;
        errors.rows_mut(4 * k, 3).copy_from(&off);
        errors[4 * k + 3] = groove.contact_arclength_mm - truth.arclength_mm;
        for column in &stated.own {
            let v = DVector::from_row_slice(&four(column));
            let mut block = own.view_mut((4 * k, 4 * k), (4, 4));
            block += &v * v.transpose();
        }
        for i in 0..4 {
            own[(4 * k + i, 4 * k + i)] += stated.floor_mm.powi(2);
        }
        for (p, column) in stated.shared.iter().enumerate() {
            shared
                .view_mut((4 * k, p), (4, 1))
                .copy_from_slice(&four(column));
        }
    }
    (errors, own, shared)
}

fn covariance(document: &ShapesDocument) -> DMatrix<f64> {
    let c = &document.shared_covariance;
    DMatrix::from_fn(c.len(), c.len(), |i, j| c[i][j])
}

/// Along the wire in the groove position and the arc length are nearly one error: a floor of half a
/// micrometre keeps the matrix regular.
fn chi2(errors: &DVector<f64>, mut sigma: DMatrix<f64>) -> f64 {
    for k in 0..sigma.nrows() {
        sigma[(k, k)] += 5e-4_f64.powi(2);
    }
    errors.dot(&sigma.cholesky().unwrap().solve(errors))
}

/// Mean over folders, whose calibrations are independent, and its standard error.
#[derive(Debug, Default, Clone, Copy)]
struct Mean {
    value: f64,
    error: f64,
}

impl Mean {
    fn of(values: &[f64]) -> Self {
        let n = values.len() as f64;
        let value = values.iter().sum::<f64>() / n;
        let squares: f64 = values.iter().map(|v| (v - value).powi(2)).sum();
        Self {
            value,
            error: (squares / (n * (n - 1.0))).sqrt(),
        }
    }
}

/// What a survey found, a mean over folders each.
#[derive(Debug)]
struct Survey {
    /// chi2 a value as stated, and with the shared errors left out.
    chi2: [Mean; 2],
    /// Square of error over standard deviation: groove x, y, z, arc length.
    squares: [Mean; 4],
    /// Share of centre line points inside their 95 % circle, and inside a third of it.
    inside: [Mean; 2],
    /// RMS error of groove x, y, z, arc length, mm.
    rms_mm: [f64; 4],
    /// Share of pairs that were not rejected.
    used: f64,
}

/// One folder: chi2 a value (2), squares (4), inside (2), squared errors (4), pairs used.
fn judged(seed: u64, count: usize) -> [f64; 13] {
    let (document, truths) = folder(seed, count);
    let (errors, own, shared) = stacked(&document, &truths);
    let together = &own + &shared * covariance(&document) * shared.transpose();
    let pairs = truths.len() as f64;
    let mut found = [0.0; 13];
    found[0] = chi2(&errors, together.clone()) / (4.0 * pairs);
    found[1] = chi2(&errors, own) / (4.0 * pairs);
    for (k, e) in errors.iter().enumerate() {
        found[2 + k % 4] += e * e / together[(k, k)] / pairs;
        found[8 + k % 4] += e * e / pairs;
    }
    let mut points = 0.0;
    for (pair, truth) in document.pairs.iter().zip(&truths) {
        same_as_stated(pair, &document);
        for (p, sd) in pair.centreline_mm.iter().zip(&pair.centreline_sd_mm) {
            let d = truth.distance_mm(&V3::from(*p));
            points += 1.0;
            found[6] += f64::from(u8::from(d <= 2.4477 * sd));
            found[7] += f64::from(u8::from(d <= 2.4477 * sd / 3.0));
        }
    }
    found[6] /= points;
    found[7] /= points;
    found[12] = pairs / count as f64;
    println!(
        "folder {seed}: chi2 a value {:.2}, without what pairs share {:.1}",
        found[0], found[1]
    );
    found
}

fn survey(seeds: std::ops::Range<u64>, count: usize) -> Survey {
    let folders: Vec<[f64; 13]> = seeds.map(|seed| judged(seed, count)).collect();
    let mean = |k: usize| Mean::of(&folders.iter().map(|f| f[k]).collect::<Vec<_>>());
    let s = Survey {
        chi2: [0, 1].map(mean),
        squares: [2, 3, 4, 5].map(mean),
        inside: [6, 7].map(mean),
        rms_mm: [8, 9, 10, 11].map(|k| mean(k).value.sqrt()),
        used: mean(12).value,
    };
    println!("{s:.4?}");
    s
}

/// The document's standard deviations are what its own and shared errors add up to.
fn same_as_stated(pair: &PairDocument, document: &ShapesDocument) {
    let (stated, groove) = (pair.errors.as_ref().unwrap(), pair.groove.as_ref().unwrap());
    let c = covariance(document);
    let total = |of: &dyn Fn(&ErrorColumn) -> f64| -> f64 {
        let shared = DVector::from_iterator(c.nrows(), stated.shared.iter().map(of));
        let own: f64 = stated.own.iter().map(|e| of(e).powi(2)).sum();
        (own + shared.dot(&(&c * &shared)) + stated.floor_mm.powi(2)).sqrt()
    };
    for axis in 0..3 {
        let sd = total(&|e| e.groove_mm[axis]);
        assert!(
            (sd - groove.sd_mm[axis]).abs() < 0.02 * sd + 3e-4,
            "{} {sd} {:?}",
            pair.name,
            groove.sd_mm
        );
    }
    let sd = total(&|e| e.contact_arclength_mm);
    assert!(
        (sd - groove.contact_arclength_sd_mm).abs() < 0.02 * sd + 3e-4,
        "{} {sd}",
        pair.name
    );
    let sd = total(&|e| e.length_mm);
    assert!(
        sd > 0.9 * pair.length_sd_mm,
        "{} {sd} {}",
        pair.name,
        pair.length_sd_mm
    );
    // Across the line; uneven light is taken as a shift in depth there, and as one in any direction
    // in the circle.
    for (k, station) in stated.stations.iter().enumerate().skip(1) {
        let along: f64 = (0..3)
            .map(|d| total(&|e| e.centreline_mm[k][d]).powi(2))
            .sum::<f64>()
            .sqrt();
        let circle = pair.centreline_sd_mm[*station];
        assert!(
            along > 0.7 * circle && along < 2.5 * circle,
            "{} station {k}: {along} {circle}",
            pair.name
        );
    }
}

/// RMS errors over these three folders that a hundredth of a millimetre as stated allows: twice
/// what they are (0.008, 0.026, 0.002 and 0.007 mm), for another machine's rounding and another
/// build of OpenCV.
const RMS_LIMITS_MM: [f64; 4] = [0.016, 0.052, 0.005, 0.015];

fn within(rms_mm: &[f64; 4]) -> bool {
    rms_mm
        .iter()
        .zip(RMS_LIMITS_MM)
        .all(|(r, limit)| *r < limit)
}

#[test]
fn stated_errors_hold_on_the_plants_pictures() {
    let s = survey(0..3, 4);
    assert!(
        s.chi2[0].value < 1.5 && s.used == 1.0 && within(&s.rms_mm),
        "{s:?}"
    );
    assert!(s.squares.iter().all(|m| m.value < 2.0), "{s:?}");
    assert!(s.inside[0].value > 0.95, "{s:?}");
    // Negative control: a twentieth of a millimetre more in any one of them.
    for k in 0..4 {
        let mut off = s.rms_mm;
        off[k] = off[k].hypot(0.05);
        assert!(!within(&off), "{k}: {off:?}");
    }
    // Negative controls: the pairs' own errors alone do not explain what was found, nor does a
    // third of the line's.
    assert!(s.chi2[1].value > 5.0 * s.chi2[0].value, "{s:?}");
    assert!(s.inside[1].value < s.inside[0].value - 0.1, "{s:?}");
}

#[test]
#[ignore = "draws and searches some 500 pictures: minutes; run with --ignored --nocapture"]
fn survey_of_stated_errors() {
    let s = survey(100..130, 8);
    // Not understated, as far as 30 calibrations tell, and not overstated beyond use.
    let sound = |m: &Mean, scale: f64| scale * (m.value - 2.0 * m.error) <= 1.0 && m.value > 0.25;
    assert!(sound(&s.chi2[0], 1.0) && s.used > 0.97, "{s:?}");
    assert!(s.squares.iter().all(|m| sound(m, 1.0)), "{s:?}");
    assert!(s.inside[0].value + 2.0 * s.inside[0].error >= 0.95, "{s:?}");
    // Negative controls: standard deviations of half the size, the pairs' own errors alone, a third
    // of the circle.
    assert!(
        !sound(&s.chi2[0], 4.0) && !s.squares.iter().all(|m| sound(m, 4.0)),
        "{s:?}"
    );
    assert!(!sound(&s.chi2[1], 1.0), "{s:?}");
    assert!(s.inside[1].value + 2.0 * s.inside[1].error < 0.95, "{s:?}");
}
