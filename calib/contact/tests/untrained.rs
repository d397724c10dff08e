//! Contacts in motions that no sweep has, without any record of the motion: the moments reveal them, and their regions have the stated
//! coverage (SIMULATED).
#![allow(clippy::unwrap_used, reason = "a test that fails should say where")]

use burn::tensor::Device;
use nalgebra::{Matrix3, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;
use std::path::Path;
use wcal_contact::known_motion::{Friction, MomentField, Region};
use wcal_contact::motion_judge::{JudgedRow, MotionJudge, UnjudgedRow};
use wcal_core::observation::{MomentAxes, WhiskerSpec};
use wcal_core::stream::{Flags, StreamMoments};
use wcal_rod::Rod;
use wcal_sim::physics::PhysicsPlan;
use wcal_sim::{SweepPlan, objects};
use wcal_track::generate_sweeps::{SweepRequest, generate_sweeps};
use wcal_track::model_file::{Card, load};
use wcal_track::network::Prediction;
use wcal_track::{Sample, SweepSeries, Tracker};

const RATE_HZ: f64 = 10.0;
const NOISE_NMM: f64 = 1e-3;

/// A row of a stream: moments, and where the object is touched (place and arc length).
struct Row {
    moment_nmm: [f64; 2],
    touched: Option<(Vector3<f64>, f64)>,
}

/// Motions that no sweep has.
#[derive(Debug, Clone, Copy)]
enum Press {
    /// A groove that presses the wire, holds it, retracts partly and leaves it, as in a calibration.
    HoldAndBack,
    /// In steps of a millimetre with pauses of a second, and back by half of the depth in between.
    StepsAndReversal,
    /// Presses, then carries the wire aside.
    Aside,
}

/// Ways of the groove along its push and across it, mm, row by row.
fn ways(press: Press, reach_mm: f64, step_mm: f64) -> Vec<[f64; 2]> {
    let mut all = vec![[-1.0, 0.0]];
    let mut go = |to: [f64; 2], pause: usize| {
        let from = all[all.len() - 1];
        let steps = ((to[0] - from[0]).hypot(to[1] - from[1]) / step_mm).ceil().max(1.0) as usize;
        all.extend((1..=steps).map(|k| {
            let u = k as f64 / steps as f64;
            [0, 1].map(|i| from[i] + (to[i] - from[i]) * u)
        }));
        all.extend(std::iter::repeat_n(to, pause));
    };
    match press {
        Press::HoldAndBack => go([reach_mm, 0.0], 40),
        Press::StepsAndReversal => {
            let steps = reach_mm.floor() as usize;
            (1..=steps).for_each(|k| go([k as f64, 0.0], 10));
            go([0.5 * reach_mm, 0.0], 10);
            go([reach_mm, 0.0], 10);
        }
        Press::Aside => {
            go([0.6 * reach_mm, 0.0], 0);
            go([0.6 * reach_mm, 0.6 * reach_mm], 0);
        }
    }
    go([-1.0, 0.0], 0);
    all
}

/// Readings of a groove at a random place, in a random direction and at a random pace.
fn pressed(field: &MomentField, press: Press, rng: &mut ChaCha8Rng) -> Vec<Row> {
    let radius_mm = WhiskerSpec::nominal().diameter_mm / 2.0;
    let arclength_mm = rng.random_range(6.0..59.0);
    let (touch, tangent) = field.free(arclength_mm);
    let turn: f64 = rng.random_range(0.0..std::f64::consts::TAU);
    let normal = Vector3::new(-tangent.z, 0.0, tangent.x).normalize();
    let push = normal * turn.cos() + normal.cross(&tangent) * turn.sin();
    let across = push.cross(&tangent);
    let step_mm = rng.random_range(0.5..4.0) / RATE_HZ;
    let row = |[along, aside]: [f64; 2]| {
        let place = touch + push * along + across * aside;
        let held = field.held(&place, 0.0).filter(|_| along > 0.0);
        let m = held.map_or([0.0; 2], |h| h.moment_nmm);
        let moment_nmm = m.map(|m| m + NOISE_NMM * rng.sample::<f64, _>(StandardNormal));
        // The wire's axis lies in the groove: the touched point is a radius off, against the force.
        let force = (push * along + across * aside).normalize();
        Row { moment_nmm, touched: held.map(|h| (place - force * radius_mm, h.arclength_mm)) }
    };
    ways(press, 0.18 * arclength_mm, step_mm).into_iter().map(row).collect()
}

fn swept(series: &SweepSeries) -> Vec<Row> {
    let row = |s: &wcal_track::SweepSample| Row {
        moment_nmm: s.moment_nmm,
        touched: s.contact.map(|c| (c.point_mm, c.arclength_mm)),
    };
    series.samples.iter().map(row).collect()
}

#[derive(Debug, Default)]
struct Share {
    held: usize,
    all: usize,
}

impl Share {
    fn add(&mut self, held: bool) {
        (self.held, self.all) = (self.held + usize::from(held), self.all + 1);
    }

    fn share(&self) -> f64 {
        self.held as f64 / self.all as f64
    }
}

/// Rows in contact of one kind of stream.
#[derive(Debug, Default)]
struct Score {
    streams: usize,
    noticed: usize,
    /// Rows that state a contact and read `ok`.
    ok: Share,
    /// Truth within the 90 % ellipsoid and the 95 % regions along the wire.
    ellipsoid: Share,
    regions: Share,
    squares_mm2: f64,
    /// Least mean of the filters' predictive densities over eight rows, stream by stream.
    lowest: Vec<f64>,
}

impl Score {
    fn line(&self, name: &str) -> String {
        let percent = |s: &Share| format!("{:5.1} %", 100.0 * s.share());
        let rmse_mm = (self.squares_mm2 / self.regions.all as f64).sqrt();
        format!(
            "{name:42} {:3} streams, {:3} noticed, {:5} rows: ok {}, 90 % ellipsoid {}, 95 % regions {}, {rmse_mm:5.2} mm RMS",
            self.streams,
            self.noticed,
            self.ok.all,
            percent(&self.ok),
            percent(&self.ellipsoid),
            percent(&self.regions)
        )
    }
}

/// Whether the touched point lies in the stated 90 % ellipsoid.
fn within90(answer: &Prediction, touched_mm: &Vector3<f64>) -> bool {
    let off = Vector3::from(answer.point_mm.map(f64::from)) - touched_mm;
    let covariance = Matrix3::from_fn(|i, j| f64::from(answer.covariance_mm2[i][j]));
    covariance.cholesky().is_some_and(|c| off.dot(&c.solve(&off)) < 6.25)
}

/// Tracks a stream of whose motion nothing is known.
fn track((tracker, card): (&Tracker, &Card), rows: &[Row], vouched: bool, score: &mut Score) {
    let (mut stream, mut judge) = (tracker.stream(), MotionJudge::new(&card.training, vouched));
    let mut evidence = Vec::new();
    for (k, row) in rows.iter().enumerate() {
        let (t_s, moment_nmm) = (k as f64 / RATE_HZ, row.moment_nmm);
        let answer = stream.push(&Sample { t_s, moment_nmm, base_mm_s: None });
        let moments = StreamMoments { moment_nmm, sd_nmm: [NOISE_NMM; 2], valid: true };
        let log_evidence = stream.log_evidence();
        evidence.extend(log_evidence);
        let unjudged = UnjudgedRow { t_s, moments, answer, log_evidence, velocity_mm_s: None };
        let JudgedRow { flags, answer, regions } = judge.judge(unjudged, &tracker.inverse);
        let Some((touched_mm, arclength_mm)) = row.touched else { continue };
        let inside = |r: &Region| (r.from_mm - 1e-9..=r.to_mm + 1e-9).contains(&arclength_mm);
        score.ok.add(flags == Flags::default() && answer.contact >= 0.6);
        score.ellipsoid.add(within90(&answer, &touched_mm));
        score.regions.add(regions.iter().any(inside));
        score.squares_mm2 += (Vector3::from(answer.point_mm.map(f64::from)) - touched_mm).norm_squared();
    }
    score.streams += 1;
    score.noticed += usize::from(judge.document().rows > 0);
    let mean = |w: &[f64]| w.iter().map(|v| v.max(-20.0)).sum::<f64>() / w.len() as f64;
    score.lowest.push(evidence.windows(8).map(mean).fold(f64::INFINITY, f64::min));
}

/// `cargo test --test untrained -- --nocapture` prints the table of the tracking page.
#[test]
fn contacts_of_which_no_motion_is_known_are_covered_and_never_ok() {
    let model = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fixtures/tracker");
    let (tracker, card) = load(&model, &Device::flex()).unwrap();
    let model = (&tracker, &card);
    let whisker = WhiskerSpec::nominal();
    let rod = Rod::new(&whisker, 4.0).unwrap();
    let field = MomentField::new(&rod, &MomentAxes::default(), Friction::NONE);
    let mut all = Share::default();
    for (press, streams) in [(Press::HoldAndBack, 40), (Press::StepsAndReversal, 20), (Press::Aside, 20)] {
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let (mut vouched, mut stated) = (Score::default(), Score::default());
        for _ in 0..streams {
            let rows = pressed(&field, press, &mut rng);
            track(model, &rows, true, &mut vouched);
            track(model, &rows, false, &mut stated);
        }
        println!("{}", vouched.line(&format!("{press:?}, taken for sweeps")));
        println!("{}", stated.line(&format!("{press:?}")));
        assert!(stated.ok.held == 0, "{press:?}: {stated:?}");
        assert!(stated.ellipsoid.share() > 0.92, "{press:?}: {stated:?}");
        all.held += stated.regions.held;
        all.all += stated.regions.all;
        // Control: the network's own regions do not hold them.
        assert!(vouched.regions.share() < 0.8 && vouched.ok.share() > 0.2, "{press:?}: {vouched:?}");
        // Two moments look like those of a sweep most of the time: less than that is not noticed, more cannot be.
        assert!(stated.noticed * 4 > stated.streams, "{press:?}: {stated:?}");
    }
    // Of eighty streams, whose rows share one place each: 95 % within 2 sd of the binomial.
    assert!((all.share() - 0.95).abs() < 0.05, "{all:?}");

    let friction = PhysicsPlan { friction: [0.0, 0.3], ..Default::default() };
    let plan = SweepPlan { physics: friction, rate_hz: RATE_HZ, ..SweepPlan::default() };
    let (mut vouched, mut stated) = (Score::default(), Score::default());
    for name in objects::NAMES {
        let order = SweepRequest { whisker: &whisker, plan: &plan, seed: 7, sweeps: 3 };
        for series in generate_sweeps(&objects::built_in(name).unwrap(), &order).unwrap() {
            track(model, &swept(&series), true, &mut vouched);
            track(model, &swept(&series), false, &mut stated);
        }
    }
    println!("{}", vouched.line("Sweeps that somebody vouches for"));
    println!("{}", stated.line("Sweeps"));
    // No sweep is doubted, none comes near the limit of the predictive check (0), and no place is another than the network's.
    assert!(vouched.noticed == 0 && stated.noticed == 0 && vouched.streams == 36, "{vouched:?}");
    assert!(vouched.lowest.iter().all(|e| *e > 0.5), "{vouched:?}");
    assert!(
        vouched.ok.share() > 0.98 && stated.ok.held == 0 && vouched.squares_mm2 == stated.squares_mm2,
        "{stated:?}"
    );
    assert!(stated.regions.share() > 0.95 && stated.ellipsoid.share() > 0.95, "{stated:?}");
}
