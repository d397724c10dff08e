//! Known motion on sessions of the plant (SIMULATED, physics that shares no code with the tracker's
//! rod).
#![allow(clippy::unwrap_used, reason = "a test that fails should say where")]

use nalgebra::{Matrix2, Rotation3, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;
use std::collections::BTreeMap;
use wcal_core::observation::{MomentAxes, RestShape, WhiskerSpec};
use wcal_plant::case::{Case, CaseKind, Make, Request};
use wcal_plant::session::draw_under;
use wcal_plant::{Design, Noise};
use wcal_rod::{Line, Outcome, Rod};
use wcal_track::known_motion::contact_path::ContactPath;
use wcal_track::known_motion::{
    CorrelatedNoise, Episode, EpisodeEstimate, Friction, MomentField, MotionRow, Settings, bound,
    estimate_contact,
};

fn drawn(seed: u64, design: Design) -> Case {
    let request = Request {
        seed,
        design,
        want: CaseKind::Null,
        target_sigma: 0.0,
        rivals: false,
    };
    draw_under(&request, Noise::Gaussian, Make::Usual).unwrap()
}

fn field(case: &Case) -> MomentField {
    let b = &case.bench;
    let spec = WhiskerSpec {
        diameter_mm: b.diameter_mm,
        youngs_gpa: b.youngs_gpa,
        shear_gpa: b.shear_gpa,
        density_kg_m3: None,
        rest_shape: RestShape::StraightArc {
            straight_mm: b.straight_mm,
            arc_radius_mm: b.arc_radius_mm,
            length_mm: b.length_mm,
        },
        gravity_direction: None,
    };
    let rod = Rod::new(&spec, 4.0).unwrap();
    MomentField::new(&rod, &MomentAxes::default(), Friction::NONE)
}

/// Episodes by trajectory through the true sensitivity, each with the true place at its first
/// reading.
fn episodes(case: &Case) -> Vec<(Episode, Vector3<f64>)> {
    let b = &case.bench;
    let inverse = Matrix2::new(b.k[0][0], b.k[0][1], b.k[1][0], b.k[1][1])
        .try_inverse()
        .unwrap();
    let noise_pm = case.truth.new_pose_noise_pm;
    let trajectories = b.trajectories();
    let mut all: BTreeMap<usize, (Episode, Vector3<f64>)> = BTreeMap::new();
    for r in &case.readings {
        let t = trajectories
            .iter()
            .find(|t| t.id == r.trajectory_id)
            .unwrap();
        let warm = 1e3 * (r.reference_nm - b.reference_nominal_nm);
        let shift = |c: usize| 1e3 * (r.fbg_nm[c] - b.nominal_nm[c]) - b.zero_pm[c] - warm;
        let m = inverse * nalgebra::Vector2::new(shift(0), shift(1));
        let direction = t.path.direction;
        let (episode, _) = all.entry(r.trajectory_id).or_insert_with(|| {
            (
                Episode {
                    rows: Vec::new(),
                    push: Some(direction),
                },
                Vector3::from(r.groove_mm),
            )
        });
        let p = &r.planned;
        episode.rows.push(MotionRow {
            t_s: p.t_s,
            moment_nmm: [m.x, m.y],
            noise_nmm2: inverse * inverse.transpose() * noise_pm * noise_pm,
            shared_nmm: Vec::new(),
            free_nmm2: None,
            shared_displacement_mm: Vec::new(),
            moved_mm: direction * p.stage_mm,
            velocity_mm_s: direction * (p.speed_mm_s * f64::from(p.direction)),
            moved_sd_mm: 0.0,
            turn: Rotation3::identity(),
            free: p.role == "rest",
            contact_segment: p.replicate as u32,
        });
    }
    all.into_values().collect()
}

#[derive(Default)]
struct Score {
    squared_mm2: f64,
    bound_mm2: f64,
    held: usize,
    ellipse: usize,
    episodes: usize,
    doubted: usize,
}

fn score(
    case: &Case,
    change: impl Fn(&Episode) -> Episode,
    score: &mut Score,
) -> Vec<EpisodeEstimate> {
    let (field, settings) = (field(case), Settings::default());
    let mut out = Vec::new();
    for (episode, place) in episodes(case) {
        let path = ContactPath::new(&field, &episode).unwrap();
        let truth = path.state_of(&place, 0, None).unwrap();
        let bound = bound::bound_mm(&field, &episode, &settings, &truth)
            .unwrap()
            .unwrap();
        let changed = change(&episode);
        let found = estimate_contact(&field, &changed, &settings).unwrap();
        score.episodes += 1;
        score.doubted += usize::from(found.disagrees());
        if let (Some(p), Some(at)) = (&found.posterior, found.places[0].place_mm) {
            let off = at - place;
            score.squared_mm2 += off.norm_squared();
            score.bound_mm2 += bound * bound;
            score.held += usize::from(p.holds(&truth));
            let c = found.places[0]
                .covariance_mm2
                .cholesky()
                .map(|c| off.dot(&c.solve(&off)));
            score.ellipse += usize::from(c.is_some_and(|m| m <= 7.815));
        }
        out.push(found);
    }
    out
}

impl std::fmt::Display for Score {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let n = self.episodes as f64;
        write!(
            f,
            "{} episodes: error {:.3} mm, bound {:.3} mm, region {:.3}, ellipse {:.3}, doubted {}",
            self.episodes,
            (self.squared_mm2 / n).sqrt(),
            (self.bound_mm2 / n).sqrt(),
            self.held as f64 / n,
            self.ellipse as f64 / n,
            self.doubted
        )
    }
}

#[test]
fn contacts_are_found_at_the_bound_and_their_regions_hold() {
    for design in [Design::Rich, Design::Paper] {
        let mut s = Score::default();
        for seed in 0..6 {
            score(&drawn(seed, design), Clone::clone, &mut s);
        }
        let n = s.episodes as f64;
        // The goal's ratio; and nobody is far below a bound.
        let ratio = (s.squared_mm2 / s.bound_mm2).sqrt();
        assert!((0.7..1.3).contains(&ratio), "{design:?}: {s}");
        // Ninety episodes: 95 % within 3 sd of the binomial.
        assert!((s.held as f64 / n - 0.95).abs() < 0.07, "{design:?}: {s}");
        assert!(
            (s.ellipse as f64 / n - 0.95).abs() < 0.07,
            "{design:?}: {s}"
        );
        assert!(s.doubted == 0, "{design:?}: {s}");
    }
}

/// One reading of an episode off by hundreds of standard deviations: it is named and tells nothing.
/// Control: where no reading can be an outlier, the place is off by many times the bound.
#[test]
fn a_gross_reading_is_named_and_draws_nothing() {
    let case = drawn(3, Design::Paper);
    let (field, settings) = (field(&case), Settings::default());
    let mut rng = ChaCha8Rng::seed_from_u64(7);
    let (mut robust, mut plain, mut bound_mm2, mut named, mut episodes_count) =
        (0.0, 0.0, 0.0, 0, 0);
    for (mut episode, place) in episodes(&case) {
        let path = ContactPath::new(&field, &episode).unwrap();
        let truth = path.state_of(&place, 0, None).unwrap();
        bound_mm2 += bound::bound_mm(&field, &episode, &settings, &truth)
            .unwrap()
            .unwrap()
            .powi(2);
        let loaded: Vec<usize> = (0..episode.rows.len())
            .filter(|&k| !episode.rows[k].free)
            .collect();
        // The deepest readings locate the contact.
        let k = loaded[rng.random_range(loaded.len() / 2..loaded.len())];
        episode.rows[k].moment_nmm[rng.random_range(0..2_usize)] += rng.random_range(0.3..3.0);
        let found = estimate_contact(&field, &episode, &settings).unwrap();
        named += usize::from(found.places[k].outlier && !found.disagrees());
        robust += (found.places[0].place_mm.unwrap() - place).norm_squared();
        let without = Settings {
            gross_share: 0.0,
            ..settings
        };
        let found = estimate_contact(&field, &episode, &without).unwrap();
        plain += found.places[0]
            .place_mm
            .map_or(1e3, |at| (at - place).norm_squared());
        episodes_count += 1;
    }
    // With three loaded readings of a pose each, one less doubles the bound at most; the errors
    // scatter about it.
    assert!(
        robust < 9.0 * bound_mm2 && plain > 100.0 * bound_mm2,
        "{robust} {plain} {bound_mm2} mm^2"
    );
    assert!(named >= episodes_count - 1, "{named} of {episodes_count}");
}

/// A push, a hold, a retraction, a lateral motion and a rotation of the base, by the tracker's own
/// rod: what the plant's stage cannot do.
fn wandering(field: &MomentField, seed: u64) -> (Episode, Vector3<f64>) {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let noise_nmm = 4e-3;
    let arclength_mm = rng.random_range(20.0..48.0);
    let (touch, _) = field.free(arclength_mm);
    let push = Vector3::new(0.3, rng.random_range(-0.8..0.8), 0.9).normalize();
    let aside = push.cross(&Vector3::x()).normalize();
    // Way along the push and aside (mm), and the turn about y (rad), reading by reading.
    let mut ways = vec![(-1.5, 0.0, 0.0), (-0.5, 0.0, 0.0)];
    ways.extend((1..=6).map(|k| (f64::from(k), 0.0, 0.0)));
    ways.extend([(6.0, 0.0, 0.0); 3]);
    ways.extend([(5.0, 0.0, 0.0), (4.0, 0.0, 0.0), (3.5, 0.0, 0.0)]);
    ways.extend((1..=4).map(|k| (3.5, 0.5 * f64::from(k), 0.0)));
    ways.extend((1..=4).map(|k| (4.0 + 0.5 * f64::from(k), 2.0, 0.01 * f64::from(k))));
    let row = |(k, (along, across, turn)): (usize, &(f64, f64, f64))| {
        let turn = Rotation3::from_axis_angle(&Vector3::y_axis(), *turn);
        // The point turns about the root with the base's frame and is carried along.
        let moved_mm = push * *along + aside * *across;
        let place = turn * touch + moved_mm;
        let held = (place - touch).dot(&push) > 0.0;
        let m = if held {
            field.held(&place, 0.0).unwrap().moment_nmm
        } else {
            [0.0; 2]
        };
        MotionRow {
            t_s: k as f64,
            moment_nmm: m.map(|m| m + noise_nmm * rng.sample::<f64, _>(StandardNormal)),
            noise_nmm2: Matrix2::identity() * noise_nmm * noise_nmm,
            shared_nmm: Vec::new(),
            free_nmm2: None,
            shared_displacement_mm: Vec::new(),
            moved_mm,
            turn,
            velocity_mm_s: Vector3::zeros(),
            moved_sd_mm: 0.0,
            free: false,
            contact_segment: 0,
        }
    };
    let rows: Vec<MotionRow> = ways.iter().enumerate().map(row).collect();
    let last = rows.len() - 1;
    let place = rows[last].turn * touch + rows[last].moved_mm;
    (Episode { rows, push: None }, place)
}

#[test]
fn motion_in_any_direction_with_holds_reversals_and_turns_is_followed() {
    let field = field(&drawn(1, Design::Paper));
    let settings = Settings::default();
    let (mut held, mut ratios, mut ignored) = (0, Vec::new(), 0);
    const EPISODES: usize = 20;
    for seed in 0..EPISODES as u64 {
        let (episode, place) = wandering(&field, seed);
        let path = ContactPath::new(&field, &episode).unwrap();
        let last = episode.rows.len() - 1;
        let truth = path.state_of(&place, last, None).unwrap();
        let bound = bound::bound_mm(&field, &episode, &settings, &truth)
            .unwrap()
            .unwrap();
        let found = estimate_contact(&field, &episode, &settings).unwrap();
        assert!(!found.disagrees(), "{seed}: {:?}", found.innovations);
        held += usize::from(found.posterior.unwrap().holds(&truth));
        ratios.push((found.places[last].place_mm.unwrap() - place).norm() / bound);
        // Control: the same motion without its turn.
        let mut straight = episode.clone();
        straight
            .rows
            .iter_mut()
            .for_each(|r| r.turn = Rotation3::identity());
        ignored += usize::from(
            estimate_contact(&field, &straight, &settings)
                .unwrap()
                .disagrees(),
        );
    }
    ratios.sort_by(f64::total_cmp);
    assert!(held >= EPISODES - 3, "{held} of {EPISODES}: {ratios:?}");
    assert!((0.2..1.3).contains(&ratios[EPISODES / 2]), "{ratios:?}");
    assert!(ignored * 2 > EPISODES, "{ignored} of {EPISODES}");
}

/// Control: moments that are off by more than their noise says are not covered, and doubted.
#[test]
fn a_wrong_map_is_neither_covered_nor_trusted() {
    let mut s = Score::default();
    let off = |e: &Episode| {
        let mut e = e.clone();
        // A map of another wire: one moment is a fifth too large, the other too small.
        e.rows
            .iter_mut()
            .for_each(|r| r.moment_nmm = [1.2 * r.moment_nmm[0], 0.8 * r.moment_nmm[1]]);
        e
    };
    score(&drawn(1, Design::Rich), off, &mut s);
    assert!(s.held * 2 < s.episodes && s.doubted > 0, "{s}");
}

/// The same episode with its motion multiplied.
fn scaled(episode: &Episode, factor: f64) -> Episode {
    let mut episode = episode.clone();
    if factor < 0.0 {
        episode.push = episode.push.map(|p| -p);
    }
    for row in &mut episode.rows {
        row.moved_mm *= factor;
        row.velocity_mm_s *= factor;
    }
    episode
}

/// Displacements count from the first loaded reading. Where it is gross and left out, they still
/// do.
#[test]
fn a_first_reading_that_is_left_out_moves_no_contact() {
    let case = drawn(3, Design::Rich);
    let (field, settings) = (field(&case), Settings::default());
    let mut steps = Vec::new();
    for (mut episode, _) in episodes(&case) {
        let along = |found: &EpisodeEstimate| {
            found.places[0]
                .place_mm
                .unwrap()
                .dot(&episode.push.unwrap())
        };
        let own = along(&estimate_contact(&field, &episode, &settings).unwrap());
        let loaded = |r: &MotionRow| {
            !r.free && r.moment_nmm[0].hypot(r.moment_nmm[1]) > 4.0 * r.noise_nmm2.trace().sqrt()
        };
        let first = episode.rows.iter().position(loaded).unwrap();
        let step = (episode.rows[first + 1].moved_mm - episode.rows[first].moved_mm).norm();
        episode.rows[first].moment_nmm[0] += 1.5;
        let found = estimate_contact(&field, &episode, &settings).unwrap();
        if found.places[first].outlier {
            let along = found.places[0]
                .place_mm
                .unwrap()
                .dot(&episode.push.unwrap());
            steps.push((along - own) / step);
        }
    }
    assert!(
        !steps.is_empty() && steps.iter().all(|s: &f64| s.abs() < 0.3),
        "in steps: {steps:?}"
    );
}

#[test]
fn motion_that_is_reversed_or_in_metres_is_doubted() {
    let case = drawn(3, Design::Rich);
    for factor in [-1.0, 1e-3] {
        let mut s = Score::default();
        // Whether the direction of the push is known or taken from the motion.
        for known in [true, false] {
            let found = score(
                &case,
                |e| {
                    let e = scaled(e, factor);
                    if known {
                        e
                    } else {
                        Episode { push: None, ..e }
                    }
                },
                &mut s,
            );
            let doubted = found.iter().filter(|f| f.disagrees()).count();
            assert!(
                doubted * 10 >= found.len() * 9,
                "{factor}: {doubted} of {}",
                found.len()
            );
        }
    }
}

/// A straight press in a random direction by the rod itself, not by the table that the tracker
/// interpolates in; each pose is read twice. `poses_mm`: displacements past first touch at an arc
/// length.
fn pressed(
    rod: &Rod,
    field: &MomentField,
    (noise_nmm, poses_mm): (f64, fn(f64) -> Vec<f64>),
    seed: u64,
) -> Option<(Episode, Vector3<f64>)> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let arclength_mm = rng.random_range(16.0..50.0);
    let (origin_mm, tangent) = field.free(arclength_mm);
    let normal = Vector3::new(-tangent.z, 0.0, tangent.x).normalize();
    let turn: f64 = rng.random_range(0.0..std::f64::consts::TAU);
    let line = Line {
        origin_mm,
        direction: normal * turn.cos() + normal.cross(&tangent) * turn.sin(),
    };
    let (free, xs): (Vec<f64>, Vec<f64>) = poses_mm(arclength_mm).iter().partition(|x| **x < 0.0);
    let mut moments: Vec<(f64, [f64; 2])> = free.iter().map(|x| (*x, [0.0; 2])).collect();
    for (x, outcome) in xs.iter().zip(rod.follow(&line, &xs)) {
        let Outcome::Held(e) = outcome else {
            return None;
        };
        moments.push((*x, MomentAxes::default().components_nmm(&e.moment_nmm)));
    }
    let row = |(k, (x, m)): (usize, &(f64, [f64; 2]))| MotionRow {
        t_s: k as f64,
        moment_nmm: m.map(|m| m + noise_nmm * rng.sample::<f64, _>(StandardNormal)),
        noise_nmm2: Matrix2::identity() * noise_nmm * noise_nmm,
        shared_nmm: Vec::new(),
        free_nmm2: None,
        shared_displacement_mm: Vec::new(),
        moved_mm: line.direction * *x,
        turn: Rotation3::identity(),
        velocity_mm_s: Vector3::zeros(),
        moved_sd_mm: 0.0,
        free: false,
        contact_segment: 0,
    };
    let twice: Vec<_> = moments.iter().flat_map(|m| [*m, *m]).collect();
    let rows = twice.iter().enumerate().map(row).collect();
    Some((
        Episode {
            rows,
            push: Some(line.direction),
        },
        line.point(free[0]),
    ))
}

/// Where the readings are better than the table, the table's own error is most of what is not
/// known.
#[test]
fn regions_hold_where_the_noise_is_smaller_than_the_table_s_error() {
    let rod = Rod::new(&WhiskerSpec::nominal(), 4.0).unwrap();
    let field = MomentField::new(&rod, &MomentAxes::default(), Friction::NONE);
    // From free poses to a bend of a sixth of the arc length; and from just past first touch on, as
    // a stream begins.
    let whole: fn(f64) -> Vec<f64> = |arclength_mm| {
        let deep = (1..=8).map(|k| 0.17 * arclength_mm * f64::from(k) / 8.0);
        [-1.0, -0.5].into_iter().chain(deep).collect()
    };
    let shallow: fn(f64) -> Vec<f64> = |_| (-10..8).map(|k| 0.05 + 0.2 * f64::from(k)).collect();
    let by_pose = |sd_nmm: f64| Settings {
        correlated: Some(CorrelatedNoise::ByPose {
            covariance_nmm2: Matrix2::identity() * sd_nmm * sd_nmm,
            length_mm: 0.5,
        }),
        ..Settings::default()
    };
    let held = |settings: Settings, poses_mm, noise_nmm: f64, stated_nmm: f64| {
        let (mut held, mut all, mut squares) = (0, 0, 0.0);
        for seed in 0..60 {
            let drawn = pressed(&rod, &field, (noise_nmm, poses_mm), seed);
            let Some((mut episode, place)) = drawn else {
                continue;
            };
            let stated = Matrix2::identity() * stated_nmm * stated_nmm;
            episode.rows.iter_mut().for_each(|r| r.noise_nmm2 = stated);
            let path = ContactPath::new(&field, &episode).unwrap();
            let truth = path.state_of(&place, 0, None).unwrap();
            let found = estimate_contact(&field, &episode, &settings).unwrap();
            all += 1;
            held += usize::from(found.posterior.unwrap().holds(&truth));
            squares += (found.places[0].place_mm.unwrap() - place).norm_squared();
        }
        let rmse_mm = (squares / f64::from(all)).sqrt();
        println!(
            "noise {noise_nmm} N mm, {stated_nmm} stated: {held} of {all} regions hold, {rmse_mm:.4} mm RMS"
        );
        assert!(all >= 50);
        held as f64 / f64::from(all)
    };
    // Sixty episodes: 95 % within 3 sd of the binomial.
    for noise_nmm in [1e-5, 1e-4, 1e-3] {
        let share = held(Settings::default(), whole, noise_nmm, noise_nmm);
        assert!(share > 0.865, "{noise_nmm}");
    }
    // The noise of the poses that the first loaded reading has is no larger than that of others.
    assert!(held(by_pose(4e-4), shallow, 1.2e-3, 1.2e-3) > 0.865);
    // Control: readings that are ten times worse than they say.
    assert!(held(Settings::default(), whole, 1e-3, 1e-4) < 0.7);
}
