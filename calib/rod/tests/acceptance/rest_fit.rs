//! Rest geometry from centre lines (SIMULATED by the rod, with noise of the size that the cameras
//! have).

use super::spec;
use nalgebra::{Rotation3, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use wcal_core::observation::{RestShape, WhiskerSpec};
use wcal_rod::{Guess, MeasuredShape, RestChoice, RestModel, Rod, Shape, Tangential, fit_rest};

const TRUE_MM: [f64; 3] = [29.3, 21.1, 59.6];

fn arc([straight_mm, arc_radius_mm, length_mm]: [f64; 3]) -> RestShape {
    RestShape::StraightArc {
        straight_mm,
        arc_radius_mm,
        length_mm,
    }
}

const ARC: RestChoice = RestChoice::StraightArc;

fn nominal() -> WhiskerSpec {
    spec(arc([30.0, 20.0, 60.0]))
}

fn turn() -> Rotation3<f64> {
    Rotation3::new(Vector3::new(0.004, -0.003, 0.002))
}

const OFFSET_MM: Vector3<f64> = Vector3::new(0.0, 0.02, -0.03);

fn shapes(noise_mm: f64, rng: &mut ChaCha8Rng) -> Vec<MeasuredShape> {
    shapes_of(&Rod::new(&spec(arc(TRUE_MM)), 0.5).unwrap(), noise_mm, rng)
}

/// A free wire and eight held ones; errors go with the whole line (a bow and a tilt) and with each
/// point.
fn shapes_of(rod: &Rod, noise_mm: f64, rng: &mut ChaCha8Rng) -> Vec<MeasuredShape> {
    let mut made = Vec::new();
    for k in 0..9 {
        let s = 18.0 + 2.5 * f64::from(k);
        let from = rod.shape.rest_point(s);
        let push = Vector3::new(
            0.0,
            if k % 2 == 0 { 2.5 } else { -2.0 },
            if k % 3 == 0 { 3.0 } else { -1.5 },
        );
        let mut guess = Guess {
            force_n: Vector3::zeros(),
            arclength_mm: s,
        };
        let mut held = None;
        for leg in 1..=10 {
            let found = rod
                .solve(
                    &(from + push * (f64::from(leg) / 10.0)),
                    &guess,
                    Tangential::Frictionless,
                )
                .unwrap();
            guess = Guess::from(&found);
            held = Some(found);
        }
        let held = held.unwrap();
        let nodes = if k == 0 {
            rod.shape.nodes_mm.clone()
        } else {
            rod.loaded_shape(&held).into_iter().map(|n| n.1).collect()
        };
        let mut normal = || rng.sample::<f64, _>(rand_distr::StandardNormal) * noise_mm;
        let (tilt, bow) = ([normal(), normal()], [normal(), normal()]);
        let count = nodes.len() as f64;
        let points: Vec<Vector3<f64>> = nodes
            .iter()
            .enumerate()
            .map(|(i, p)| {
                let x = i as f64 / count;
                let smooth = |c: usize| tilt[c] * x + bow[c] * 4.0 * x * (1.0 - x);
                turn() * p
                    + OFFSET_MM
                    + Vector3::new(0.0, smooth(0) + 0.3 * normal(), smooth(1) + 0.3 * normal())
            })
            .collect();
        made.push(MeasuredShape {
            name: format!("t{k}"),
            sd_mm: vec![noise_mm.max(1e-6); points.len()],
            centreline_mm: points,
            length_mm: [rod.shape.length_mm + normal(), noise_mm.max(1e-6)],
            groove: (k > 0).then(|| (turn() * held.point_mm + OFFSET_MM, held.arclength_mm)),
        });
    }
    made
}

/// Truth in the order of the fit's unknowns.
fn truth() -> [f64; 8] {
    let [a, b, c] = TRUE_MM;
    let w = turn().scaled_axis();
    [a, b, c, w.x, w.y, w.z, OFFSET_MM.y, OFFSET_MM.z]
}

#[test]
fn exact_lines_give_the_geometry_back() {
    let made = shapes(0.0, &mut ChaCha8Rng::seed_from_u64(1));
    let fit = fit_rest(&nominal(), &made, ARC).unwrap();
    let names = fit.model.names();
    for (k, t) in truth().into_iter().enumerate() {
        // Polyline lengths between mesh nodes and the fit's coarser mesh: micrometres.
        assert!(
            (fit.values[k] - t).abs() < 2e-3 * t.abs().max(0.1),
            "{}: {} for {t}",
            names[k],
            fit.values[k]
        );
    }
    assert!(
        fit.rms_mm < 1e-3 && fit.excluded.is_empty(),
        "{}",
        fit.rms_mm
    );
}

#[test]
fn stated_sds_cover_the_truth() {
    let mut rng = ChaCha8Rng::seed_from_u64(7);
    let (mut inside, mut all) = (0, 0);
    for _ in 0..12 {
        let fit = fit_rest(&nominal(), &shapes(0.01, &mut rng), ARC).unwrap();
        assert!(
            (fit.values[1] - TRUE_MM[1]).abs() < 0.1 && (fit.values[2] - TRUE_MM[2]).abs() < 0.2
        );
        for (k, t) in truth().into_iter().enumerate() {
            // Student's t with eight degrees of freedom: 95 %.
            inside += usize::from((fit.values[k] - t).abs() < 2.306 * fit.sd(k).unwrap());
            all += 1;
        }
    }
    // 96 draws, not independent within a fit: 85 to 100 % is what twelve fits can tell.
    assert!(inside * 100 >= 85 * all, "{inside} of {all}");
}

#[test]
fn a_wrong_groove_and_a_wrong_model_show_in_the_residual() {
    let mut made = shapes(0.003, &mut ChaCha8Rng::seed_from_u64(3));
    let good = fit_rest(&nominal(), &made, ARC).unwrap();
    // A rod laid through the measured lines cannot follow a groove that was 0.3 mm elsewhere.
    for shape in &mut made {
        if let Some((point, _)) = &mut shape.groove {
            point.z += 0.3;
        }
    }
    let bad = fit_rest(&nominal(), &made, ARC).unwrap();
    assert!(
        bad.rms_over_sd > 5.0 * good.rms_over_sd,
        "{} against {}",
        bad.rms_over_sd,
        good.rms_over_sd
    );
    let none = fit_rest(&nominal(), &[], ARC).unwrap_err();
    assert!(
        none.to_string().contains("at least one usable shape"),
        "{none}"
    );
}

/// A scale error of all shapes is not in the jackknife; as a common error it is, and the lengths'
/// share is their own size times it.
#[test]
fn an_error_common_to_all_shapes_enters_by_its_own_way() {
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let measured = shapes(0.003, &mut rng);
    let scale = 1e-3;
    let scaled = |by: f64| -> Vec<MeasuredShape> {
        let of = |s: &MeasuredShape| MeasuredShape {
            centreline_mm: s.centreline_mm.iter().map(|p| p * by).collect(),
            length_mm: [s.length_mm[0] * by, s.length_mm[1]],
            groove: s.groove.map(|(p, at)| (p * by, at)),
            ..s.clone()
        };
        measured.iter().map(of).collect()
    };
    // What was measured is a thousandth too large.
    let mut fit = fit_rest(&nominal(), &scaled(1.0 + scale), ARC).unwrap();
    let alone: Vec<f64> = (0..3).map(|k| fit.sd(k).unwrap()).collect();
    fit.add_common_errors(&nominal(), &[scaled(1.0 + 2.0 * scale)])
        .unwrap();
    let (common, names) = (fit.common.clone().unwrap(), fit.model.names());
    for k in 0..3 {
        let (off, sd) = (fit.values[k] - TRUE_MM[k], fit.sd(k).unwrap());
        let share = common[(k, k)].sqrt() / TRUE_MM[k];
        assert!((share - scale).abs() < 0.1 * scale, "{}: {share}", names[k]);
        assert!(off.abs() < 3.0 * sd, "{}: {off} of {sd}", names[k]);
    }
    // Negative control: the jackknife alone would be many standard deviations off.
    let worst = (0..3)
        .map(|k| (fit.values[k] - TRUE_MM[k]).abs() / alone[k])
        .fold(0.0, f64::max);
    assert!(worst > 6.0, "{worst}");
}

/// Curvatures of a wire that no straight part with an arc describes, 1/mm, at a share of its
/// length.
fn bends(x: f64) -> [f64; 2] {
    [
        0.01 + 0.045 * x * x,
        0.006 * (std::f64::consts::PI * x).sin(),
    ]
}

/// A wire that bends all the way and out of its plane: BIC asks for a free curvature, which is the
/// true one; of an arc it asks for none.
#[test]
fn a_free_curvature_is_found_where_there_is_one() {
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let true_bends: Vec<[f64; 2]> = (0..5).map(|k| bends(f64::from(k) / 4.0)).collect();
    let mut rod = Rod::new(&spec(arc(TRUE_MM)), 0.5).unwrap();
    rod.shape = Shape::from_curvature(59.6, &true_bends, 0.5).unwrap();
    let made = shapes_of(&rod, 0.003, &mut rng);
    let fit = fit_rest(&nominal(), &made, RestChoice::Best).unwrap();
    let n = 5;
    assert_eq!(
        fit.model,
        RestModel::FreeCurvature(n),
        "{:?}",
        fit.candidates
    );
    assert!(
        fit.excluded.is_empty() && fit.rms_over_sd < 1.5,
        "{:?} {}",
        fit.candidates,
        fit.rms_over_sd
    );
    // The clamp of the true wire is turned about the wire too: the curvatures carry that.
    let roll = turn().scaled_axis().x;
    let (mut inside, mut all) = (0, 0);
    for k in 0..n {
        let [y, z] = bends(k as f64 / (n - 1) as f64);
        let truth = [
            y * roll.cos() - z * roll.sin(),
            y * roll.sin() + z * roll.cos(),
        ];
        for (axis, truth) in truth.into_iter().enumerate() {
            let (value, sd) = (fit.values[axis * n + k], fit.sd(axis * n + k).unwrap());
            assert!(
                (value - truth).abs() < 4.0 * sd + 1e-5,
                "place {k}: {value} for {truth}, sd {sd}"
            );
            // Student's t with eight degrees of freedom: 95 %.
            inside += usize::from((value - truth).abs() < 2.306 * sd + 1e-5);
            all += 1;
        }
    }
    assert!(inside * 10 >= all * 7, "{inside} of {all}");
    let length = fit.values[2 * n];
    assert!((length - 59.6).abs() < 0.02, "{length}");
    // The polyline that other commands read is the same wire.
    let again = Shape::new(&fit.model.rest_shape(&fit.values).unwrap(), 0.25).unwrap();
    for s in [10.0, 30.0, 50.0, 59.0] {
        let off = (fit.model.root(&fit.values).0 * again.rest_point(s) + OFFSET_MM
            - (turn() * rod.shape.rest_point(s) + OFFSET_MM))
            .norm();
        assert!(off < 0.02, "{s} mm: {off}");
    }
    let forced = fit_rest(&nominal(), &made, ARC).unwrap();
    assert!(
        forced.rms_over_sd > 5.0 * fit.rms_over_sd,
        "{} {}",
        forced.rms_over_sd,
        fit.rms_over_sd
    );
    // Negative control: lines of an arc.
    let arcs = fit_rest(&nominal(), &shapes(0.003, &mut rng), RestChoice::Best).unwrap();
    assert_eq!(arcs.model, RestModel::StraightArc, "{:?}", arcs.candidates);
}
