//! How often a sweep refutes what is true, and what is not: sweeps of the independent plant whose
//! clock, object and friction are off within what is stated (SIMULATED, physics that shares no code
//! with wire, table and fitter).

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::print_stdout,
    reason = "a test that fails should say where, and one that measures says what it found"
)]

use nalgebra::{UnitQuaternion, Vector3};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use std::fmt::Write as _;
use std::path::Path;
use wcal_calibration::WhiskerCalibration;
use wcal_core::SessionData;
use wcal_core::verify_document::WitnessTest;
use wcal_plant::sweep::SweepCase;
use wcal_session::sweep_session::SweepSession;
use wcal_track::sweep_witness::SweepWitness;
use wcal_verify::verify::VerifyRequest;
use wcal_verify::whisker::physical::AcceptedEffect;
use wcal_verify::whisker::{PhysicalModel, Verified, verify_whisker};

/// The dead zone of the measured whisker over its largest moment: 0.6 of 1.7 N mm.
const DEAD_ZONE: f64 = 0.35;

/// What is off in a sweep.
#[derive(Clone, Copy, Default)]
struct Fault {
    /// Way of the object across the motion, mm.
    across_mm: f64,
    /// A dead zone acts, as a share of the sweep's largest moment.
    dead_zone: f64,
}

/// A drawn sweep with the calibration of its 27 poses.
struct Drawn {
    case: SweepCase,
    model: PhysicalModel,
    whisker: wcal_core::observation::WhiskerData,
    largest_nmm: f64,
}

impl Drawn {
    fn new(seed: u64) -> Self {
        let case = SweepCase::draw(seed).unwrap();
        let folder = tempfile::tempdir().unwrap();
        case.session().unwrap().write(folder.path()).unwrap();
        let session = wcal_session::load(folder.path()).unwrap();
        let SessionData::Whisker(whisker) = session.data else {
            panic!("kind")
        };
        let (request, sealed) = (VerifyRequest::default(), session.sealed.whisker());
        let done =
            verify_whisker("sweep", &whisker, sealed, &session.inputs, &[], &request).unwrap();
        let Verified::Done(done) = done else {
            panic!("refused")
        };
        let largest_nmm = case
            .readings
            .iter()
            .map(|r| r.moment_nmm[0].hypot(r.moment_nmm[1]))
            .fold(0.0, f64::max);
        Self {
            model: done.decision.declared_calibration(),
            whisker,
            largest_nmm,
            case,
        }
    }

    /// The calibration with a dead zone that it has not.
    fn with_dead_zone(&self) -> PhysicalModel {
        let mut model = self.model.clone();
        model.effects.push(AcceptedEffect {
            id: "dead-zone".to_owned(),
            law: "radial".to_owned(),
            values: vec![DEAD_ZONE * self.largest_nmm],
            parameters: Vec::new(),
        });
        model.covariance.iter_mut().for_each(|row| row.push(0.0));
        let size = model.covariance.len() + 1;
        model.covariance.push(vec![0.0; size]);
        model
    }

    /// What the sweep says of a model; none where it cannot judge.
    fn judge(&self, model: &PhysicalModel, fault: Fault) -> Option<WitnessTest> {
        let folder = tempfile::tempdir().unwrap();
        let session = self.write(folder.path(), fault);
        let (spec, axes) = (&self.whisker.whisker, &self.whisker.moments);
        let witness = SweepWitness::new(session, (spec, axes), 27).unwrap();
        let other = !model.effects.is_empty();
        let declared = other.then_some(&self.model as &dyn WhiskerCalibration);
        witness
            .consistency_test(model, spec, declared)
            .ok()
            .flatten()
    }

    /// The sweep as a session, its clock and its object off by draws of what a session takes them
    /// for.
    fn write(&self, folder: &Path, fault: Fault) -> SweepSession {
        let mut rng = ChaCha8Rng::seed_from_u64(7000 + self.case.seed);
        let mut normal =
            |sd: f64| -> f64 { sd * Distribution::<f64>::sample(&StandardNormal, &mut rng) };
        let (clock_s, size) = (normal(1.0), 1.0 + normal(0.01));
        let turn =
            UnitQuaternion::from_scaled_axis(Vector3::from_fn(|_, _| normal(1_f64.to_radians())));
        let moved = Vector3::from_fn(|_, _| normal(0.5));
        let bench = &self.case.scene.bench;
        let reference = bench.reference_nominal_nm;
        let wire = Vector3::x();
        let across =
            (wire - self.case.scene.direction * wire.dot(&self.case.scene.direction)).normalize();
        let mut points =
            "point,t_s,fbg_ref_nm,temperature_degc,fbg_1_nm,fbg_2_nm,base_x_mm,base_y_mm,base_z_mm\n"
                .to_owned();
        for (k, r) in self.case.readings.iter().enumerate() {
            let [y, z] = r.moment_nmm;
            let load = y.hypot(z);
            let felt = (1.0 - fault.dead_zone * self.largest_nmm / load.max(1e-9)).max(0.0);
            let lost = bench.shift_pm(if fault.dead_zone > 0.0 {
                [y * (1.0 - felt), z * (1.0 - felt)]
            } else {
                [0.0; 2]
            });
            let read = [0, 1].map(|c| r.fbg_nm[c] - 1e-3 * lost[c]);
            let base =
                r.base_mm + self.case.scene.direction * (self.case.scene.speed_mm_s * clock_s);
            let _ = writeln!(
                points,
                "{k},{:.6},{reference:.6},{:.3},{:.7},{:.7},{:.5},{:.5},{:.5}",
                r.t_s,
                wcal_plant::bench::REFERENCE_DEGC,
                read[0],
                read[1],
                base.x,
                base.y,
                base.z
            );
        }
        std::fs::write(folder.join("points.csv"), points).unwrap();
        let facets = self.case.scene.body.facets();
        let corner = |line: &str| -> Option<Vector3<f64>> {
            let mut numbers = line
                .trim()
                .strip_prefix("vertex")?
                .split_whitespace()
                .map(|w| w.parse::<f64>().unwrap());
            Some(Vector3::new(
                numbers.next()?,
                numbers.next()?,
                numbers.next()?,
            ))
        };
        let corners: Vec<Vector3<f64>> = facets.lines().filter_map(corner).collect();
        let middle = corners.iter().sum::<Vector3<f64>>() / corners.len() as f64;
        let mut stl = "solid body\n".to_owned();
        for line in facets.lines() {
            let _ = match corner(line) {
                None => writeln!(stl, "{line}"),
                Some(q) => {
                    let p = middle + turn * (q - middle) * size + moved + across * fault.across_mm;
                    writeln!(stl, "vertex {:.6} {:.6} {:.6}", p.x, p.y, p.z)
                }
            };
        }
        std::fs::write(folder.join("object.stl"), stl + "endsolid body\n").unwrap();
        let toml = "kind = \"sweep\"\nid = \"drawn\"\n[files]\npoints = \"points.csv\"\nobject = \"object.stl\"\n[object]\nworld_from_object = [0, 0, 0, 1, 0, 0, 0]\n";
        std::fs::write(folder.join("session.toml"), toml).unwrap();
        SweepSession::of(folder).unwrap().unwrap()
    }
}

/// Rates over drawn sweeps, printed and held:
/// `WCAL_FIRST=930 WCAL_DRAWS=20 cargo test --test sweep_witness -- --nocapture`.
#[test]
fn the_truth_stands_and_what_is_wrong_is_refuted() {
    let draws: u64 = std::env::var("WCAL_DRAWS")
        .ok()
        .and_then(|d| d.parse().ok())
        .unwrap_or(3);
    let (mut refuted, mut judged) = ([0; 4], 0);
    let first: u64 = std::env::var("WCAL_FIRST")
        .ok()
        .and_then(|d| d.parse().ok())
        .unwrap_or(900);
    for seed in first..first + draws {
        let drawn = Drawn::new(seed);
        let dead = drawn.with_dead_zone();
        let acts = Fault {
            dead_zone: DEAD_ZONE,
            ..Fault::default()
        };
        let moved = Fault {
            across_mm: 4.0,
            ..Fault::default()
        };
        let tests = [
            drawn.judge(&drawn.model, Fault::default()),
            drawn.judge(&dead, acts),
            drawn.judge(&dead, Fault::default()),
            drawn.judge(&drawn.model, moved),
        ];
        judged += usize::from(tests.iter().all(Option::is_some));
        refuted
            .iter_mut()
            .zip(&tests)
            .for_each(|(n, t)| *n += usize::from(t.as_ref().is_some_and(|t| t.refuted)));
        let each: Vec<String> = tests
            .iter()
            .flatten()
            .map(|t| {
                format!(
                    "{:.1}/{} p {:.1e} {:.2} mm",
                    t.statistic, t.dof, t.p, t.magnitude
                )
            })
            .collect();
        println!(
            "{seed} largest {:.2} N mm, {} readings: {}",
            drawn.largest_nmm,
            drawn.case.readings.len(),
            each.join("; ")
        );
    }
    let [truth, true_dead_zone, wrong_dead_zone, elsewhere] = refuted;
    println!(
        "refuted of {draws} ({judged} of which judge): the true model {truth}, a true dead zone {true_dead_zone}, a wrong one {wrong_dead_zone}, an object 4 mm off {elsewhere} (SIMULATED)"
    );
    assert!(truth + true_dead_zone <= 1, "{refuted:?}");
    // Control: what is wrong.
    assert!(
        2 * wrong_dead_zone >= judged && 2 * elsewhere >= judged && 2 * judged > draws as usize,
        "{refuted:?}"
    );
}
