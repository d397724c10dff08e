//! Draws whole sessions and writes them in the form of the practice sessions.

use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use serde_json::{Map, Value, json};

use crate::PlantError;
use crate::adversarial;
use crate::bench::{Bench, PM_PER_DEGC, REFERENCE_DEGC, Trajectory};
use crate::case::{Case, CaseKind, Flag, Make, PictureSetup, Reading, Request, Truth};
use crate::effects::Effect;
use crate::layout::{Asked, PlannedRow, plan, plan_asked, plan_quick};
use crate::noise::{self, Law, Noise};
use crate::rivals::{nearest, oracle_error_nmm};
use crate::shapes::{Cameras, Fault, WireAtPose, contact_sigma};
use crate::simulate::{NoiseFree, Plant};

/// Draws a session on the usual wire, with white normal noise.
///
/// # Errors
/// [`PlantError::Wire`] when the rod does not settle for a bench or an amplitude.
pub fn draw(request: &Request) -> Result<Case, PlantError> {
    draw_under(request, Noise::Gaussian, Make::Usual)
}

/// Draws a session with noise of a kind, on a wire of a make.
///
/// # Errors
/// As [`draw`].
pub fn draw_under(request: &Request, noise: Noise, wire: Make) -> Result<Case, PlantError> {
    let mut rng = ChaCha8Rng::seed_from_u64(request.seed);
    let bench = match wire {
        Make::Usual => Bench::draw(&mut rng),
        Make::Thin => Bench::draw_thin(&mut rng),
    };
    drawn(request, noise, wire, bench, None, rng)
}

/// Draws a session that cameras look at, with white normal noise.
///
/// # Errors
/// As [`draw`].
pub fn draw_looked(request: &Request, looked: PictureSetup) -> Result<Case, PlantError> {
    let mut rng = ChaCha8Rng::seed_from_u64(request.seed);
    let bench = Bench::draw(&mut rng);
    drawn(
        request,
        Noise::Gaussian,
        Make::Usual,
        bench,
        Some(looked),
        rng,
    )
}

/// Draws a session on a given bench, with white normal noise.
///
/// # Errors
/// As [`draw`].
pub fn draw_on(request: &Request, bench: Bench) -> Result<Case, PlantError> {
    let rng = ChaCha8Rng::seed_from_u64(request.seed);
    drawn(request, Noise::Gaussian, Make::Usual, bench, None, rng)
}

fn drawn(
    request: &Request,
    noise: Noise,
    wire: Make,
    declared: Bench,
    looked: Option<PictureSetup>,
    mut rng: ChaCha8Rng,
) -> Result<Case, PlantError> {
    let off_mm = looked.map_or(0.0, |l| l.straight_off_mm);
    let bench = Bench {
        straight_mm: declared.straight_mm + off_mm,
        ..declared.clone()
    };
    // The rig runs where the declared wire would be; the real wire lies beside it.
    let mut trajectories = declared.trajectories();
    for t in &mut trajectories {
        let (origin_mm, _) = bench.wire().rest(t.path.arclength_mm);
        t.path.offset_mm = t.path.origin_mm - origin_mm;
        t.path.origin_mm = origin_mm;
    }
    let rows = plan(request.design, &trajectories, &mut rng);
    let end_s = rows
        .iter()
        .rev()
        .find(|r| !r.holdout)
        .map_or(0.0, |r| r.t_s);
    let law = Law::draw(noise, &bench, &rows, request.seed);
    let mut plant = Plant::new(bench, trajectories, rows, &law);
    let without = plant.clean(&[])?;

    let kinds = match &request.want {
        CaseKind::Effects(kinds) => kinds.clone(),
        _ => Vec::new(),
    };
    let mut effects = Vec::new();
    let mut each = Map::new();
    let (mut target_reached, mut clear) = (true, true);
    for kind in kinds {
        let mut effect = Effect::draw(kind, end_s, &mut rng);
        let size = scale(&mut plant, &mut effect, &without, request.target_sigma)?;
        target_reached &= (size / request.target_sigma - 1.0).abs() < 0.05;
        each.insert(kind.name().0.into(), json!((size * 10.0).round() / 10.0));
        if looked.is_some() {
            let [with, without] = [
                plant.wires_in_groove(std::slice::from_ref(&effect))?,
                plant.wires_in_groove(&[])?,
            ];
            let [with, without] =
                [with, without].map(|s| s.into_iter().flatten().collect::<Vec<_>>());
            let contact = contact_sigma(&with, &without, &Cameras::default());
            clear &= size >= NEAR_ENOUGH * CLEAR_SIGMA || contact >= CLEAR_CONTACT_SIGMA;
        }
        effects.push(effect);
    }
    let clean = if effects.is_empty() {
        without.clone()
    } else {
        plant.clean(&effects)?
    };
    let projected = plant.size(&clean, &without);

    let readings = measure(&plant, &clean, &law, request.seed, &mut rng);
    let mut truth = truth(request, &plant, &effects, &clean, law);
    truth.wire = wire;
    (truth.sizes_each, truth.target_reached) = (each, target_reached);
    truth.clear = looked.map(|_| clear);
    truth.projected_size_in_noises = (projected * 10.0).round() / 10.0;
    truth.flagged = truth
        .noise
        .gross
        .iter()
        .map(|g| flag(&readings[g.row]))
        .collect();
    truth.flagged.sort();
    truth.oracle_after_nmm = oracle_error_nmm(&plant, &clean, &readings, &truth.noise.gross);
    if let ([one], true) = (effects.as_slice(), request.rivals) {
        truth.nearest_rival = nearest(&mut plant, one.kind.name().0, &clean, &without)?;
    }
    if let Some(name) = looked.and_then(|l| l.found()) {
        (truth.label, truth.names) = (name.into(), vec![name.into()]);
    }
    let shown = match looked {
        Some(looked) if looked.pictures => {
            points_shown(&readings, plant.wires_in_groove(&effects)?)
        }
        _ => Vec::new(),
    };
    let mut case = Case {
        bench: plant.bench.clone(),
        readings,
        truth,
        effects,
        declared,
        looked,
        shown,
    };
    if let CaseKind::Adversarial(trick) = request.want {
        adversarial::tamper(&mut case, trick, &mut rng);
    }
    Ok(case)
}

impl PictureSetup {
    /// Identifier of what is wrong with cameras or wire; none where nothing is.
    fn found(&self) -> Option<&'static str> {
        match self.fault {
            // Without pictures no camera is wrong.
            _ if !self.pictures && self.straight_off_mm == 0.0 => None,
            Fault::BoardScale(_) => Some("board-scale"),
            Fault::RigTag(_) => Some("rig-tag"),
            Fault::Moved(..) => Some("camera-pose"),
            Fault::None => (self.straight_off_mm != 0.0).then_some("rest-shape"),
        }
    }
}

/// What is shown of the rows of points.csv, each with its point.
fn points_shown(readings: &[Reading], shown: Vec<Option<WireAtPose>>) -> Vec<(usize, WireAtPose)> {
    let points = readings
        .iter()
        .zip(shown)
        .filter(|(r, _)| !r.planned.holdout);
    points.filter_map(|(r, s)| Some((r.point, s?))).collect()
}

fn flag(reading: &Reading) -> Flag {
    let file = if reading.planned.holdout {
        "holdout.csv"
    } else {
        "points.csv"
    };
    Flag {
        source: file.into(),
        point: reading.point,
    }
}

/// Size of a clear effect in noises of the wavelengths, the share of it that the scaling of effects
/// keeps, and size in the contacts.
const CLEAR_SIGMA: f64 = 8.0;
const NEAR_ENOUGH: f64 = 0.97;
const CLEAR_CONTACT_SIGMA: f64 = 5.0;

/// Largest change of a zero when the whisker is seated anew, pm.
const RESEAT_PM: f64 = 20.0;

/// The same sensor on another day: the readings that `asked` describes, with a zero of their own.
///
/// # Errors
/// [`PlantError::Wire`] when the rod does not settle.
pub fn later(case: &Case, asked: &[Asked]) -> Result<Case, PlantError> {
    let seed = case.truth.seed ^ 0x1a7e;
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut bench = case.bench.clone();
    for zero in &mut bench.zero_pm {
        *zero += rng.random_range(-RESEAT_PM..RESEAT_PM);
    }
    let trajectories = bench.trajectories();
    let rows = plan_asked(asked, &trajectories);
    let day = Day {
        bench,
        effects: case.effects.clone(),
        groove: trajectories,
    };
    another_day(case, &day, rows, seed, rng)
}

/// What a sensor has become on another day.
#[derive(Debug, Clone)]
pub struct Day {
    /// Its bench.
    pub bench: Bench,
    /// What acts.
    pub effects: Vec<Effect>,
    /// Where the groove really runs; the session declares the paths of the bench.
    pub groove: Vec<Trajectory>,
}

impl Day {
    /// The same as on the day of `case`.
    pub fn unchanged(case: &Case) -> Self {
        Self {
            bench: case.bench.clone(),
            effects: case.effects.clone(),
            groove: case.bench.trajectories(),
        }
    }
}

/// Ten quick readings of a sensor on another day.
///
/// # Errors
/// As [`later`].
pub fn quick_look(case: &Case, day: &Day, seed: u64) -> Result<Case, PlantError> {
    let rows = plan_quick(&day.bench.trajectories());
    another_day(case, day, rows, seed, ChaCha8Rng::seed_from_u64(seed))
}

fn another_day(
    case: &Case,
    day: &Day,
    rows: Vec<PlannedRow>,
    seed: u64,
    mut rng: ChaCha8Rng,
) -> Result<Case, PlantError> {
    // The noise is as before; what went grossly wrong in a reading does so once.
    let law = Law {
        gross: Vec::new(),
        ..case.truth.noise.clone()
    };
    let mut plant = Plant::new(day.bench.clone(), day.groove.clone(), rows, &law);
    let clean = plant.clean(&day.effects)?;
    plant.trajectories = day.bench.trajectories();
    let readings = measure(&plant, &clean, &law, seed, &mut rng);
    Ok(Case {
        bench: plant.bench,
        readings,
        ..case.clone()
    })
}

/// Sets the amplitude so that the effect's size is `target` noises, within its range; returns the
/// size.
fn scale(
    plant: &mut Plant,
    effect: &mut Effect,
    without: &[NoiseFree],
    target: f64,
) -> Result<f64, PlantError> {
    let range = effect.kind.range();
    let mut size_at = |a: f64, effect: &mut Effect| -> Result<f64, PlantError> {
        effect.amplitude = a;
        let with = plant.clean(std::slice::from_ref(effect))?;
        Ok(plant.size(&with, without))
    };
    let (mut low, mut high) = (range.low, range.high);
    let (mut low_tried, mut high_tried) = (false, false);
    let mut a = if low > 0.0 {
        (low * high).sqrt()
    } else {
        0.5 * (low + high)
    };
    let mut size = f64::NAN;
    for _ in 0..12 {
        size = size_at(a, effect)?;
        if (size / target - 1.0).abs() < 0.02 {
            break;
        }
        if size < target {
            (low, low_tried) = (a, true);
        } else {
            (high, high_tried) = (a, true);
        }
        if high - low < 1e-9 {
            break;
        }
        // Most effects grow in proportion; the bracket guards the rest.
        let guess = a * target / size.max(1e-9);
        a = if guess > low && guess < high {
            guess
        } else if guess >= high && !high_tried {
            high
        } else if guess <= low && !low_tried {
            low
        } else {
            0.5 * (low + high)
        };
    }
    Ok(size)
}

/// Turns noise-free answers into readings.
fn measure(
    plant: &Plant,
    clean: &[NoiseFree],
    law: &Law,
    seed: u64,
    rng: &mut impl Rng,
) -> Vec<Reading> {
    let bench = &plant.bench;
    let series = law.series(&plant.rows, &plant.trajectories, seed);
    let mut normal = |sd: f64| -> f64 {
        let z: f64 = StandardNormal.sample(rng);
        sd * z
    };
    let mut out = Vec::with_capacity(clean.len());
    let mut point = 0;
    for (i, (row, answer)) in plant.rows.iter().zip(clean).enumerate() {
        if i > 0 && row.holdout != plant.rows[i - 1].holdout {
            point = 0;
        }
        let samples = noise::samples(row);
        let gross = law.gross.iter().find(|g| g.row == i);
        let blur = bench.sample_sd_pm / (samples as f64).sqrt();
        let warm = bench.thermal.at(row.t_s);
        let trajectory = &plant.trajectories[row.trajectory];
        let groove = trajectory.path.at(row.commanded_mm);
        let fbg_nm = [0, 1].map(|c| {
            let noise = normal(series.scale_pm[i][c]) + normal(blur) + series.add_pm[i][c];
            let shift_pm = bench.zero_pm[c] + answer.shift_pm[c] + PM_PER_DEGC * warm + noise;
            let error_nm = gross.map_or(0.0, |g| g.error_nm[c]);
            law.rounded(bench.nominal_nm[c] + 1e-3 * shift_pm + error_nm)
        });
        let sd_pm =
            [0, 1].map(|_| bench.sample_sd_pm * (1.0 + 0.02 * normal(1.0).clamp(-2.5, 2.5)));
        out.push(Reading {
            point,
            planned: row.clone(),
            trajectory_id: trajectory.id,
            groove_mm: [groove.x, groove.y, groove.z],
            temperature_degc: REFERENCE_DEGC + warm + normal(0.02),
            reference_nm: law
                .rounded(bench.reference_nominal_nm + 1e-3 * (PM_PER_DEGC * warm + normal(blur))),
            fbg_nm,
            sd_pm,
            samples,
        });
        point += 1;
    }
    out
}

fn truth(
    request: &Request,
    plant: &Plant,
    effects: &[Effect],
    clean: &[NoiseFree],
    law: Law,
) -> Truth {
    let unknown = effects.iter().find(|e| e.kind.is_unknown());
    let driver = unknown.and_then(|e| e.kind.driver());
    let label = match (&request.want, effects) {
        (CaseKind::Adversarial(_), _) => "adversarial".to_owned(),
        (_, []) => "null".to_owned(),
        (_, [one]) => one.kind.name().0.to_owned(),
        _ => "pair".to_owned(),
    };
    let by_name = |f: &dyn Fn(&Effect) -> Value| -> Map<String, Value> {
        effects
            .iter()
            .map(|e| (e.kind.name().0.to_owned(), f(e)))
            .collect()
    };
    let (laws, mut parameters) = (
        by_name(&|e| json!(e.kind.name().1)),
        by_name(&|e| e.parameters()),
    );
    if let Some(length) = parameters
        .get_mut("wire-taper")
        .and_then(|v| v.get_mut("length_mm"))
    {
        *length = json!(plant.bench.length_mm);
    }
    let variances: Vec<f64> = plant
        .rows
        .iter()
        .filter(|r| r.role == "holdout")
        .map(|r| {
            law.new_pose_pm(&plant.bench, r, plant.trajectories[r.trajectory].reach_mm)
                .powi(2)
        })
        .collect();
    let expected = match request.want {
        CaseKind::Adversarial(trick) => trick.expected().iter().map(|s| (*s).to_owned()).collect(),
        _ => Vec::new(),
    };
    Truth {
        effects: parameters,
        design: request.design,
        noise_pm: plant.bench.noise_pm,
        new_pose_noise_pm: (variances.iter().sum::<f64>() / variances.len() as f64).sqrt(),
        repeat_noise_pm: law.repeat_at_rest_pm(&plant.bench),
        noise: law,
        flagged: Vec::new(),
        wire: Make::Usual,
        k: plant.bench.k,
        zero: plant.bench.zero_pm,
        label,
        names: effects.iter().map(|e| e.kind.name().0.to_owned()).collect(),
        size: match request.target_sigma {
            s if s < 10.0 => 1,
            s if s < 16.0 => 2,
            s if s < 30.0 => 3,
            _ => 4,
        },
        projected_size_in_noises: f64::NAN,
        holdout_moments_nmm: plant
            .rows
            .iter()
            .zip(clean)
            .filter(|(r, _)| r.holdout)
            .map(|(_, c)| c.moment_nmm.map(|m| (m * 1e6).round() / 1e6 + 0.0))
            .collect(),
        laws,
        sizes_each: Map::new(),
        target_sigma: request.target_sigma,
        target_reached: true,
        clear: None,
        driver: driver.map_or_else(Vec::new, |d| d.0.iter().map(|s| (*s).to_owned()).collect()),
        shape: driver.map(|d| d.1.to_owned()),
        expected,
        oracle_after_nmm: f64::NAN,
        nearest_rival: None,
        seed: request.seed,
    }
}

impl Case {
    /// The same session, its noise included, under effects of a given size; and what its settled
    /// poses look like, each with its point of points.csv.
    ///
    /// # Errors
    /// [`PlantError::Wire`] when the rod does not settle.
    pub fn under(
        &self,
        effects: &[Effect],
    ) -> Result<(Self, Vec<(usize, WireAtPose)>), PlantError> {
        let rows: Vec<PlannedRow> = self.readings.iter().map(|r| r.planned.clone()).collect();
        let mut plant = Plant::new(
            self.bench.clone(),
            self.bench.trajectories(),
            rows,
            &self.truth.noise,
        );
        let (without, with) = (plant.clean(&self.effects)?, plant.clean(effects)?);
        let shown = plant.wires_in_groove(effects)?;
        let mut case = Self {
            effects: effects.to_vec(),
            ..self.clone()
        };
        for ((reading, a), b) in case.readings.iter_mut().zip(&without).zip(&with) {
            for c in 0..2 {
                reading.fbg_nm[c] += 1e-3 * (b.shift_pm[c] - a.shift_pm[c]);
            }
        }
        let shown = points_shown(&case.readings, shown);
        Ok((case, shown))
    }
}
