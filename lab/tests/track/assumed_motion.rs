//! Contacts in motions that no sweep has, without any record of the motion: never `ok`, and their
//! regions have the stated coverage (SIMULATED).

use nalgebra::{Matrix2, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;
use std::path::Path;
use wcal_core::observation::{MomentAxes, WhiskerSpec};
use wcal_core::stream::Flags;
use wcal_lab::SweepSeries;
use wcal_lab::generate_sweeps::{SweepRequest, generate_sweeps};
use wcal_lab_sweeps::physics::PhysicsPlan;
use wcal_lab_sweeps::{SweepPlan, objects};
use wcal_network::Tracker;
use wcal_network::model_file::{Card, load};
use wcal_rod::Rod;
use wcal_track::arc_posterior::Region;
use wcal_track::estimator::Estimator;
use wcal_track::known_motion::{Friction, MomentField};
use wcal_track::network::NetworkEstimator;
use wcal_track::reading::{Moments, Reading};

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
    /// A groove that presses the wire, holds it, retracts partly and leaves it, as in a
    /// calibration.
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
        let steps = ((to[0] - from[0]).hypot(to[1] - from[1]) / step_mm)
            .ceil()
            .max(1.0) as usize;
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
        Row {
            moment_nmm,
            touched: held.map(|h| (place - force * radius_mm, h.arclength_mm)),
        }
    };
    ways(press, 0.18 * arclength_mm, step_mm)
        .into_iter()
        .map(row)
        .collect()
}

fn swept(series: &SweepSeries) -> Vec<Row> {
    let row = |s: &wcal_lab::SweepSample| Row {
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
    /// Rows that state a contact and read `ok`.
    ok: Share,
    /// Truth within the 90 % ellipsoid and the 95 % regions along the wire.
    ellipsoid: Share,
    regions: Share,
    squares_mm2: f64,
}

impl Score {
    fn line(&self, name: &str) -> String {
        let percent = |s: &Share| format!("{:5.1} %", 100.0 * s.share());
        let rmse_mm = (self.squares_mm2 / self.regions.all as f64).sqrt();
        format!(
            "{name:42} {:3} streams, {:5} rows: ok {}, 90 % ellipsoid {}, 95 % regions {}, {rmse_mm:5.2} mm RMS",
            self.streams,
            self.ok.all,
            percent(&self.ok),
            percent(&self.ellipsoid),
            percent(&self.regions)
        )
    }
}

/// Moments with white noise.
fn noisy(moment_nmm: [f64; 2]) -> Moments {
    let noise_nmm2 = Matrix2::identity() * NOISE_NMM.powi(2);
    Moments {
        moment_nmm,
        sd_nmm: [NOISE_NMM; 2],
        valid: true,
        pose_nmm2: noise_nmm2,
        own_nmm2: Some(noise_nmm2),
        ..Moments::default()
    }
}

/// Tracks a stream of whose motion nothing is known but `velocity_mm_s`.
fn track(
    (tracker, card): (&Tracker, &Card),
    rows: &[Row],
    (vouched, velocity_mm_s): (bool, Option<Vector3<f64>>),
    score: &mut Score,
) {
    let mut estimator = NetworkEstimator::new((tracker, card), tracker.filters, vouched, None);
    for (k, row) in rows.iter().enumerate() {
        let alone = Reading::alone(k as i64, k as f64 / RATE_HZ, Some(noisy(row.moment_nmm)));
        let contacts = estimator
            .push(&Reading {
                velocity_mm_s,
                ..alone
            })
            .unwrap();
        let Some((touched_mm, arclength_mm)) = row.touched else {
            continue;
        };
        let (contact, estimate) = (&contacts[0], contacts[0].estimate.as_ref().unwrap());
        let inside = |r: &Region| (r.from_mm - 1e-9..=r.to_mm + 1e-9).contains(&arclength_mm);
        let off = estimate.place_mm - touched_mm;
        score
            .ok
            .add(contact.flags == Flags::default() && estimate.probability >= 0.5);
        score.ellipsoid.add(
            estimate
                .covariance_mm2
                .cholesky()
                .is_some_and(|c| off.dot(&c.solve(&off)) < 6.25),
        );
        score.regions.add(contact.regions.iter().any(inside));
        score.squares_mm2 += off.norm_squared();
    }
    score.streams += 1;
}

/// `cargo test --workspace --test track assumed_motion:: -- --nocapture` prints the table of the
/// tracking page.
#[test]
fn contacts_of_which_no_motion_is_known_are_covered_and_never_ok() {
    let model = Path::new(env!("CARGO_MANIFEST_DIR")).join("../fixtures/tracker");
    let (tracker, card) = load(&model).unwrap();
    let model = (&tracker, &card);
    let whisker = WhiskerSpec::nominal();
    let rod = Rod::new(&whisker, 4.0).unwrap();
    let field = MomentField::new(&rod, &MomentAxes::default(), Friction::NONE);
    let mut all = Share::default();
    for (press, streams) in [
        (Press::HoldAndBack, 16),
        (Press::StepsAndReversal, 12),
        (Press::Aside, 12),
    ] {
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let (mut vouched, mut stated) = (Score::default(), Score::default());
        for _ in 0..streams {
            let rows = pressed(&field, press, &mut rng);
            track(model, &rows, (true, None), &mut vouched);
            track(model, &rows, (false, None), &mut stated);
        }
        println!("{}", vouched.line(&format!("{press:?}, taken for sweeps")));
        println!("{}", stated.line(&format!("{press:?}")));
        assert!(stated.ok.held == 0, "{press:?}: {stated:?}");
        assert!(stated.ellipsoid.share() > 0.92, "{press:?}: {stated:?}");
        all.held += stated.regions.held;
        all.all += stated.regions.all;
        // Control: the network's own regions do not hold them.
        assert!(
            vouched.regions.share() < 0.8 && vouched.ok.share() > 0.2,
            "{press:?}: {vouched:?}"
        );
    }
    // Of forty streams, whose rows share one place each: at least 95 % less 2 sd of the binomial.
    assert!(all.share() > 0.88, "{all:?}");

    let friction = PhysicsPlan {
        friction: [0.0, 0.3],
        ..Default::default()
    };
    let plan = SweepPlan {
        physics: friction,
        rate_hz: RATE_HZ,
        ..SweepPlan::default()
    };
    let [low, high] = card.training.speed_mm_s();
    let along = |mm_s: f64| Some(Vector3::z() * mm_s);
    let (mut vouched, mut stated, mut trained) =
        (Score::default(), Score::default(), Score::default());
    let mut others = Score::default();
    for name in objects::NAMES {
        let order = SweepRequest {
            whisker: &whisker,
            plan: &plan,
            seed: 7,
            sweeps: 2,
        };
        for series in generate_sweeps(&objects::built_in(name).unwrap(), &order).unwrap() {
            let rows = swept(&series);
            track(model, &rows, (true, None), &mut vouched);
            track(model, &rows, (false, None), &mut stated);
            track(
                model,
                &rows,
                (false, along(0.5 * (low + high))),
                &mut trained,
            );
            // Standing, back, across, and faster than in training: nobody can vouch for what is
            // known to be another motion.
            for other in [
                along(0.0),
                along(-5.0),
                Some(Vector3::new(4.0, 0.0, 4.0)),
                along(1.01 * high),
            ] {
                track(model, &rows, (true, other), &mut others);
            }
        }
    }
    println!("{}", vouched.line("Sweeps that somebody vouches for"));
    println!("{}", stated.line("Sweeps"));
    assert!(
        vouched.ok.share() > 0.98 && trained.ok.held == vouched.ok.held,
        "{vouched:?} {trained:?}"
    );
    // No place is another than the network's, and no contact is ok.
    assert!(
        stated.ok.held == 0 && vouched.squares_mm2 == stated.squares_mm2,
        "{stated:?}"
    );
    assert!(
        others.ok.held == 0 && others.streams == 4 * 2 * objects::NAMES.len(),
        "{others:?}"
    );
    assert!(
        stated.regions.share() > 0.95 && stated.ellipsoid.share() > 0.95,
        "{stated:?}"
    );
}
