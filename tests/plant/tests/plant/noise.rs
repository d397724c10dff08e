//! Drawn noise has the property that its kind states, seen from the readings as written; white
//! normal noise has not.

use nalgebra::DMatrix;
use statrs::distribution::{ContinuousCDF, StudentsT};
use wcal_plant::noise::{Covariance, Law, visits};
use wcal_plant::scalar;
use wcal_plant::session::draw_on;
use wcal_plant::simulate::Plant;
use wcal_plant::{
    Case, CaseKind, Design, EffectSize, Make, Noise, Request, ScalarEffect, ScalarNoise,
    ScalarRequest, draw_under,
};

fn request(seed: u64, design: Design) -> Request {
    Request {
        seed,
        design,
        want: CaseKind::Null,
        target_sigma: 8.0,
        rivals: false,
    }
}

/// A case with its compensated residuals: readings less everything that is no noise, pm.
struct Read {
    case: Case,
    pm: Vec<[f64; 2]>,
}

fn read(noise: Noise, design: Design, seed: u64) -> Read {
    let case = draw_under(&request(seed, design), noise, Make::Usual).unwrap();
    let rows = case.readings.iter().map(|r| r.planned.clone()).collect();
    let bench = &case.bench;
    let mut plant = Plant::new(bench.clone(), bench.trajectories(), rows, &case.truth.noise);
    let clean = plant.clean(&[]).unwrap();
    let pm = case.readings.iter().zip(&clean).map(|(r, clean)| {
        let warm_pm = 1e3 * (r.reference_nm - bench.reference_nominal_nm);
        [0, 1].map(|c| {
            1e3 * (r.fbg_nm[c] - bench.nominal_nm[c])
                - warm_pm
                - bench.zero_pm[c]
                - clean.shift_pm[c]
        })
    });
    Read {
        pm: pm.collect(),
        case,
    }
}

impl Read {
    fn law(&self) -> &Law {
        &self.case.truth.noise
    }

    /// Root mean square over the rows that `of` picks, by row and share of the reach.
    fn rms(&self, of: impl Fn(usize, f64) -> bool) -> f64 {
        let trajectories = self.case.bench.trajectories();
        let picked: Vec<f64> = (0..self.pm.len())
            .filter(|&i| {
                let p = &self.case.readings[i].planned;
                of(i, p.commanded_mm / trajectories[p.trajectory].reach_mm)
            })
            .flat_map(|i| self.pm[i])
            .collect();
        (picked.iter().map(|v| v * v).sum::<f64>() / picked.len() as f64).sqrt()
    }

    fn rest(&self, i: usize) -> bool {
        self.case.readings[i].planned.role == "rest"
    }

    /// Loaded over rest.
    fn loaded_over_rest(&self) -> f64 {
        self.rms(|i, _| !self.rest(i)) / self.rms(|i, _| self.rest(i))
    }

    /// Deep over shallow, and what the law says of the same rows.
    fn deep_over_shallow(&self) -> (f64, f64) {
        let trajectories = self.case.bench.trajectories();
        let expected = |of: &dyn Fn(f64) -> bool| {
            let all = self.case.readings.iter().filter_map(|r| {
                let reach = trajectories[r.planned.trajectory].reach_mm;
                of(r.planned.commanded_mm / reach)
                    .then(|| self.law().white_pm(&r.planned, reach).powi(2))
            });
            let all: Vec<f64> = all.collect();
            (all.iter().sum::<f64>() / all.len() as f64).sqrt()
        };
        let (deep, shallow) = (|s: f64| s > 0.75, |s: f64| s < 0.3);
        (
            self.rms(|_, s| deep(s)) / self.rms(|_, s| shallow(s)),
            expected(&deep) / expected(&shallow),
        )
    }

    /// Correlation of readings in turn that belong to one visit.
    fn visit_correlation(&self) -> f64 {
        let rows: Vec<_> = self
            .case
            .readings
            .iter()
            .map(|r| r.planned.clone())
            .collect();
        let visits = visits(&rows);
        let pairs: Vec<(f64, f64)> = (1..rows.len())
            .filter(|&i| visits[i] == visits[i - 1])
            .flat_map(|i| [0, 1].map(|c| (self.pm[i - 1][c], self.pm[i][c])))
            .collect();
        assert!(pairs.len() > 100, "{}", pairs.len());
        correlation(&pairs)
    }

    /// Correlation of readings in turn, and what first-order noise of the law has on the same
    /// instants.
    fn step_correlation(&self) -> (f64, f64) {
        let at = |i: usize| self.case.readings[i].planned.t_s;
        let pairs: Vec<(f64, f64)> = (1..self.pm.len())
            .flat_map(|i| [0, 1].map(|c| (self.pm[i - 1][c], self.pm[i][c])))
            .collect();
        let law = self.law();
        let expected = law.drift.map_or(0.0, |d| {
            let share = d.sd_pm.powi(2) / (d.sd_pm.powi(2) + law.repeat_pm.powi(2));
            let kept: f64 = (1..self.pm.len())
                .map(|i| (-(at(i) - at(i - 1)) / d.time_constant_s).exp())
                .sum();
            share * kept / (self.pm.len() - 1) as f64
        });
        (correlation(&pairs), expected)
    }

    /// Readings beyond the 99 % range of Student's t of the law, scaled to the white noise, and
    /// all; drift taken off.
    fn tails(&self, dof: f64) -> (usize, usize) {
        let rows: Vec<_> = self
            .case
            .readings
            .iter()
            .map(|r| r.planned.clone())
            .collect();
        let series =
            self.law()
                .series(&rows, &self.case.bench.trajectories(), self.case.truth.seed);
        let scale = self.law().repeat_pm * ((dof - 2.0) / dof).sqrt();
        let limit = scale * StudentsT::new(0.0, 1.0, dof).unwrap().inverse_cdf(0.995);
        let white = self
            .pm
            .iter()
            .zip(&series.add_pm)
            .flat_map(|(a, b)| [a[0] - b[0], a[1] - b[1]]);
        (white.filter(|v| v.abs() > limit).count(), 2 * rows.len())
    }

    /// Mean square of the readings of points.csv after whitening with a law.
    fn whitened(&self, law: &Law) -> f64 {
        let rows: Vec<_> = self
            .case
            .readings
            .iter()
            .map(|r| r.planned.clone())
            .collect();
        let bench = &self.case.bench;
        let covariance = Covariance::new(law, bench, &rows, &bench.trajectories());
        let of = covariance.rows();
        let white = covariance.whiten(&DMatrix::from_fn(of.len(), 2, |i, c| self.pm[of[i]][c]));
        white.norm_squared() / white.len() as f64
    }
}

fn correlation(pairs: &[(f64, f64)]) -> f64 {
    let sum = |f: &dyn Fn(&(f64, f64)) -> f64| pairs.iter().map(f).sum::<f64>();
    sum(&|p| p.0 * p.1) / (sum(&|p| p.0 * p.0) * sum(&|p| p.1 * p.1)).sqrt()
}

/// Share beyond the 99 % range over a few sessions, each judged by its own degrees of freedom (or
/// by these).
fn tail_share(noise: Noise, judged_by: Option<f64>) -> f64 {
    let counts: Vec<(usize, usize)> = (0..6)
        .map(|seed| {
            let read = read(noise, Design::Rich, 900 + seed);
            read.tails(judged_by.or(read.law().tails_dof).unwrap())
        })
        .collect();
    let (beyond, all) = counts.iter().fold((0, 0), |(a, b), c| (a + c.0, b + c.1));
    beyond as f64 / all as f64
}

#[test]
fn students_noise_has_the_tails_of_its_degrees_of_freedom() {
    // About 5000 values: 1 % +- 0.14 %.
    for noise in [Noise::StudentT, Noise::DriftT] {
        let share = tail_share(noise, None);
        assert!((0.006..0.015).contains(&share), "{noise:?} {share}");
    }
    let normal = tail_share(Noise::Gaussian, Some(5.0));
    assert!(normal < 0.005, "{normal}");
}

#[test]
fn loaded_readings_are_noisier_than_rests() {
    for seed in [1, 2, 3] {
        let noisy = read(Noise::Loaded, Design::Rich, seed);
        let factor = noisy.law().loaded;
        assert!((2.0..5.0).contains(&factor));
        assert!(
            (noisy.loaded_over_rest() / factor - 1.0).abs() < 0.25,
            "{}",
            noisy.loaded_over_rest()
        );
        let even = read(Noise::Gaussian, Design::Rich, seed).loaded_over_rest();
        assert!((even - 1.0).abs() < 0.25, "{even}");
    }
}

#[test]
fn readings_of_one_visit_share_the_scatter_of_poses() {
    for (seed, design) in [(1, Design::Repeats), (2, Design::Shuffled)] {
        let scattered = read(Noise::Pose, design, seed);
        let law = scattered.law();
        let ratio = law.pose_pm / law.repeat_pm;
        assert!((2.0..5.0).contains(&ratio));
        let expected = ratio * ratio / (1.0 + ratio * ratio);
        assert!(
            (scattered.visit_correlation() - expected).abs() < 0.08,
            "{}",
            scattered.visit_correlation()
        );
        // Rest readings do not scatter.
        let rests = scattered.rms(|i, _| scattered.rest(i)) / law.repeat_pm;
        assert!((rests - 1.0).abs() < 0.25, "{rests}");
        let even = read(Noise::Gaussian, design, seed).visit_correlation();
        assert!(even.abs() < 0.2, "{even}");
    }
}

#[test]
fn noise_grows_with_depth() {
    for seed in [4, 5] {
        let deep = read(Noise::Depth, Design::Staircase, seed);
        let (found, expected) = deep.deep_over_shallow();
        assert!(
            expected > 1.4 && (found / expected - 1.0).abs() < 0.2,
            "{found} {expected}"
        );
        let (even, _) = read(Noise::Gaussian, Design::Staircase, seed).deep_over_shallow();
        assert!((even - 1.0).abs() < 0.2, "{even}");
    }
}

/// Wavelengths of the table as written.
fn written(case: &Case) -> Vec<String> {
    let folder = tempfile::tempdir().unwrap();
    case.write(folder.path()).unwrap();
    csv::Reader::from_path(folder.path().join("points.csv"))
        .unwrap()
        .records()
        .flat_map(|r| {
            let r = r.unwrap();
            [13, 14, 15].map(|k| r[k].to_owned())
        })
        .collect()
}

#[test]
fn rounded_wavelengths_are_written_in_whole_steps() {
    let on_steps = |values: &[String], step_pm: f64| {
        let on = |v: &&String| {
            let steps = 1e3 * v.parse::<f64>().unwrap() / step_pm;
            (steps - steps.round()).abs() < 2e-3
        };
        values.iter().filter(on).count() as f64 / values.len() as f64
    };
    let mut decimals = std::collections::BTreeSet::new();
    for (noise, seed) in (0..8)
        .map(|s| (Noise::Rounding, s))
        .chain((8..11).map(|s| (Noise::RoundedT, s)))
    {
        let case = draw_under(&request(seed, Design::Paper), noise, Make::Usual).unwrap();
        let r = case.truth.noise.rounding.unwrap();
        let values = written(&case);
        assert_eq!(on_steps(&values, r.step_pm), 1.0, "{r:?}");
        assert!(
            values
                .iter()
                .all(|v| v.split_once('.').unwrap().1.len() == r.decimals)
        );
        assert_eq!(
            case.truth.noise.tails_dof.is_some(),
            noise == Noise::RoundedT
        );
        decimals.insert(r.decimals);
        let smooth =
            draw_under(&request(seed, Design::Paper), Noise::Gaussian, Make::Usual).unwrap();
        assert!(on_steps(&written(&smooth), r.step_pm) < 0.2);
    }
    assert_eq!(decimals.into_iter().collect::<Vec<_>>(), [3, 4, 7]);
}

#[test]
fn gross_readings_are_the_flagged_ones_and_no_others() {
    for (noise, count) in [
        (Noise::OneGross, 1),
        (Noise::TwoGross, 2),
        (Noise::Gaussian, 0),
    ] {
        let mut held_out = 0;
        for seed in 20..28 {
            let read = read(noise, Design::Paper, seed);
            let far = |pm: &[f64; 2]| pm.iter().any(|v| v.abs() > 8.0 * read.law().repeat_pm);
            let found: Vec<_> = (0..read.pm.len())
                .filter(|&i| far(&read.pm[i]))
                .map(|i| {
                    let r = &read.case.readings[i];
                    (
                        if r.planned.holdout {
                            "holdout.csv"
                        } else {
                            "points.csv"
                        },
                        r.point,
                    )
                })
                .collect();
            let flagged: Vec<_> = read
                .case
                .truth
                .flagged
                .iter()
                .map(|f| (f.source.as_str(), f.point))
                .collect();
            assert_eq!(flagged.len(), count);
            assert!(
                found.iter().all(|f| flagged.contains(f)) && found.len() == count,
                "{found:?}"
            );
            held_out += flagged.iter().filter(|f| f.0 == "holdout.csv").count();
        }
        assert!(held_out < 8 * count.max(1));
    }
}

#[test]
fn drift_noise_is_correlated_in_time_by_its_law() {
    for noise in [Noise::Drift, Noise::DriftT] {
        let (mut found, mut expected) = (0.0, 0.0);
        for seed in 0..6 {
            let (f, e) = read(noise, Design::Rich, 40 + seed).step_correlation();
            (found, expected) = (found + f / 6.0, expected + e / 6.0);
        }
        assert!(
            expected > 0.4 && (found - expected).abs() < 0.12,
            "{noise:?} {found} {expected}"
        );
    }
    let (even, _) = read(Noise::Gaussian, Design::Rich, 40).step_correlation();
    assert!(even.abs() < 0.12, "{even}");
}

#[test]
fn true_covariance_whitens_every_kind() {
    for noise in Noise::ALL {
        let design = if noise == Noise::Pose {
            Design::Repeats
        } else {
            Design::Rich
        };
        let read = read(noise, design, 61);
        let own = read.whitened(read.law());
        // Wide for tails of few degrees of freedom; 720 values else.
        let limit = if read.law().tails_dof.is_some() {
            0.35
        } else {
            0.12
        };
        let gross = !read.law().gross.is_empty();
        assert!((own - 1.0).abs() < limit, "{noise:?} {own}");
        // Control: white noise alone does not explain what is not white (rounding may be small, t
        // has the same variance).
        let white = read.whitened(&Law::gaussian(&read.case.bench));
        let beyond = matches!(
            noise,
            Noise::Loaded | Noise::Pose | Noise::Depth | Noise::Drift | Noise::DriftT
        );
        assert_eq!(beyond || gross, white > 1.6, "{noise:?} {white}");
    }
}

#[test]
fn white_part_of_a_seed_is_the_same_under_every_kind() {
    // The plain draw, and that on a given bench, are the normal ones.
    let order = request(71, Design::Rich);
    let plain = wcal_plant::draw(&order).unwrap();
    assert_eq!(
        plain,
        draw_under(&order, Noise::Gaussian, Make::Usual).unwrap()
    );
    assert_eq!(plain.truth.noise, Law::gaussian(&plain.bench));
    let on = draw_on(&order, plain.bench.clone()).unwrap();
    assert_eq!(on.truth.noise.kind, Noise::Gaussian);
    let (a, b) = (
        read(Noise::Gaussian, Design::Rich, 71),
        read(Noise::Loaded, Design::Rich, 71),
    );
    let rests = (0..a.pm.len()).filter(|&i| a.rest(i));
    assert!(
        rests
            .into_iter()
            .all(|i| (a.pm[i][0] - b.pm[i][0]).abs() < 1e-6)
    );
    assert!(
        a.pm.iter()
            .zip(&b.pm)
            .any(|(a, b)| (a[0] - b[0]).abs() > 0.5)
    );
}

#[test]
fn layouts_come_back_to_poses_as_they_say() {
    let rows = |design: Design, seed: u64| -> Vec<_> {
        let case = draw_under(&request(seed, design), Noise::Gaussian, Make::Usual).unwrap();
        case.readings
            .into_iter()
            .map(|r| r.planned)
            .filter(|p| !p.holdout)
            .collect()
    };
    let mut all = std::collections::BTreeSet::new();
    for (design, seed) in [
        Design::Rich,
        Design::Repeats,
        Design::Shuffled,
        Design::Staircase,
    ]
    .into_iter()
    .flat_map(|d| [(d, 1), (d, 2)])
    {
        let rows = rows(design, seed);
        assert!(
            (280..=420).contains(&rows.len()),
            "{design:?} {}",
            rows.len()
        );
        assert_eq!(
            rows.iter().filter(|r| r.role == "calibration").count(),
            27,
            "{design:?}"
        );
        assert!(rows.windows(2).all(|w| w[1].t_s > w[0].t_s), "{design:?}");
        // Readings without moving in between.
        let stays = visits(&rows).windows(2).filter(|w| w[0] == w[1]).count();
        assert_eq!(
            stays > 0,
            matches!(design, Design::Repeats | Design::Shuffled),
            "{design:?} {stays}"
        );
        // Loaded poses met again after another, the same way and with the same dwell.
        let key = |p: &wcal_plant::layout::PlannedRow| {
            (
                p.trajectory,
                p.commanded_mm.to_bits(),
                p.direction,
                p.dwell_s.to_bits(),
            )
        };
        let settled = || {
            rows.iter()
                .filter(|p| p.role != "rest" && p.speed_mm_s == 0.0)
        };
        let distinct: std::collections::BTreeSet<_> = settled().map(key).collect();
        let again = settled().count() - distinct.len();
        assert_eq!(
            again >= 27 * 5,
            design == Design::Staircase,
            "{design:?} {again}"
        );
        assert!(
            rows.iter()
                .any(|p| p.direction < 0 && p.dwell_s > 0.0 && p.role != "rest")
        );
        all.insert(rows.len());
    }
    // Two and three readings a visit.
    let lengths: std::collections::BTreeSet<_> =
        (0..8).map(|s| rows(Design::Repeats, s).len()).collect();
    assert_eq!(lengths.len(), 2, "{lengths:?}");
}

#[test]
fn the_thin_wire_is_another_wire() {
    let thin = draw_under(&request(5, Design::Rich), Noise::Gaussian, Make::Thin).unwrap();
    let folder = tempfile::tempdir().unwrap();
    thin.write(folder.path()).unwrap();
    let toml = std::fs::read_to_string(folder.path().join("session.toml")).unwrap();
    assert!(
        toml.contains("diameter_mm = 0.2\nlength_mm = 40.0\n"),
        "{toml}"
    );
    let gain = |k: [[f64; 2]; 2]| (k[0][0] * k[1][1] - k[0][1] * k[1][0]).sqrt();
    assert!(gain(thin.truth.k) > 120.0);
    // Its readings span what those of the usual wire do, within a factor of two.
    let usual = draw_under(&request(5, Design::Rich), Noise::Gaussian, Make::Usual).unwrap();
    let span = |case: &Case| {
        let shifts = case
            .readings
            .iter()
            .map(|r| (r.fbg_nm[0] - case.bench.nominal_nm[0]).abs());
        shifts.fold(0.0, f64::max)
    };
    assert!(
        (0.5..2.0).contains(&(span(&thin) / span(&usual))),
        "{} {}",
        span(&thin),
        span(&usual)
    );
}

#[test]
fn size_is_measured_against_the_true_covariance() {
    let sized = |noise| {
        let want = CaseKind::Effects(vec![wcal_plant::Kind::TemperatureLinear]);
        let order = Request {
            want,
            target_sigma: 12.0,
            ..request(6, Design::Rich)
        };
        draw_under(&order, noise, Make::Usual).unwrap()
    };
    let (white, loaded) = (sized(Noise::Gaussian), sized(Noise::Loaded));
    for case in [&white, &loaded] {
        assert!((case.truth.projected_size_in_noises / 12.0 - 1.0).abs() < 0.05);
    }
    // The same size takes more where the noise is larger.
    assert!(loaded.effects[0].amplitude > 1.5 * white.effects[0].amplitude);
}

fn line(noise: ScalarNoise, effect: Option<ScalarEffect>, seed: u64) -> scalar::ScalarCase {
    scalar::draw(&ScalarRequest {
        seed,
        axis: seed % 2 == 1,
        noise,
        effect,
        size: EffectSize::Noises(9.0),
        layout: None,
        noise_seed: None,
    })
}

#[test]
fn lines_have_the_stated_correlation_and_tails() {
    for noise in ScalarNoise::ALL {
        let (mut found, mut rho, mut power, mut beyond, mut all) = (0.0, 0.0, 0.0, 0, 0);
        for seed in 0..20 {
            let case = line(noise, None, seed);
            let e: Vec<f64> = case
                .readings
                .iter()
                .map(|r| (r.y - r.clean) / case.truth.noise_sd)
                .collect();
            let pairs: Vec<(f64, f64)> = e.windows(2).map(|w| (w[0], w[1])).collect();
            found += correlation(&pairs) / 20.0;
            rho += case.truth.rho / 20.0;
            power += e.iter().map(|v| v * v).sum::<f64>() / e.len() as f64 / 20.0;
            beyond += e.iter().filter(|v| v.abs() > 3.3).count();
            all += e.len();
        }
        assert!((found - rho).abs() < 0.06, "{noise:?} {found} {rho}");
        assert!((power - 1.0).abs() < 0.3, "{noise:?} {power}");
        // A normal has 1 in 1000 there.
        let share = beyond as f64 / all as f64;
        if noise == ScalarNoise::White {
            assert!(found.abs() < 0.05 && share < 0.002, "{found} {share}");
        }
        if noise == ScalarNoise::StudentT {
            assert!(share > 0.003, "{share}");
        }
    }
}

#[test]
fn effects_of_lines_have_their_size() {
    for (k, effect) in ScalarEffect::ALL.into_iter().enumerate() {
        for noise in ScalarNoise::ALL {
            let seed = k as u64;
            let case = line(noise, Some(effect), seed);
            let size = case.truth.projected_size_in_noises;
            assert!(
                (size / 9.0 - 1.0).abs() < 0.03,
                "{effect:?} {noise:?} {size}"
            );
            assert_eq!(case.truth.names, [effect.name()]);
            // Without it the clean readings are a line, or a constant.
            let null = line(noise, None, seed);
            let bend: f64 = null
                .readings
                .windows(3)
                .map(|w| {
                    let (a, b, c) = (&w[0], &w[1], &w[2]);
                    if a.sweep == c.sweep {
                        (a.clean - 2.0 * b.clean + c.clean).abs()
                    } else {
                        0.0
                    }
                })
                .sum();
            assert!(bend < 1e-6 * case.truth.noise_sd.max(1.0));
            assert!(case.readings.iter().any(|r| r.direction < 0));
        }
    }
}

#[test]
fn lines_are_written_as_sessions() {
    let folder = tempfile::tempdir().unwrap();
    for seed in 0..4 {
        let case = line(ScalarNoise::White, None, seed);
        let out = folder.path().join(format!("case-{seed}"));
        case.write(&out).unwrap();
        let toml = std::fs::read_to_string(out.join("session.toml")).unwrap();
        let points = std::fs::read_to_string(out.join("points.csv")).unwrap();
        let kind = if case.axis { "axis" } else { "transducer" };
        assert!(toml.contains(&format!("kind = \"{kind}\"")));
        assert_eq!(points.contains("commanded_mm"), case.axis);
        assert_eq!(
            points.lines().count() - 1,
            case.readings.iter().filter(|r| !r.holdout).count()
        );
        let held_out = case.readings.iter().any(|r| r.holdout);
        assert_eq!(
            toml.contains("holdout.csv") && out.join("holdout.csv").exists(),
            held_out
        );
    }
}
