//! What is drawn: effects of a scenario with sizes in standard deviations of a session, plan, rate
//! and pictures.
//!
//! ```text
//! size = smallest(plan) * sqrt(500 Hz / rate) * u,   ln u uniform in [0, ln 8]; one in four from there to the largest size that is usual
//! ```
//!
//! `smallest` is what verify.json states for a session of the plan without an effect: the size
//! found with 90 % power, some five standard deviations. So sizes lie between five and forty of
//! them, and beyond where the model's own error shows.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde_json::Value;
use std::collections::BTreeMap;

/// Rate of the sessions that tell the smallest sizes, Hz.
pub(crate) const REFERENCE_HZ: f64 = 500.0;
/// Largest size over the smallest detectable one, and the share of those beyond it.
const SPAN: f64 = 8.0;
const BEYOND: f64 = 0.25;
/// A drift that begins halfway is left by a linear one as a quarter of its size (standard
/// deviations over a session).
const HALFWAY: f64 = 4.0;

/// An effect that the bench can have.
pub(crate) struct Effect {
    /// Its name in the catalogue.
    pub id: &'static str,
    /// Key in a scenario's `[effects]`.
    key: &'static str,
    /// Size in the unit of verify.json over that of the scenario.
    per_key: f64,
    /// Largest size that such a part has, in the scenario's unit; drawn up to here where the plan
    /// cannot show the effect.
    largest: f64,
    /// Parameter of verify.json that is the size.
    parameter: &'static str,
}

const fn effect(
    id: &'static str,
    key: &'static str,
    per_key: f64,
    largest: f64,
    parameter: &'static str,
) -> Effect {
    Effect {
        id,
        key,
        per_key,
        largest,
        parameter,
    }
}

/// Largest sizes: what is usual for each. A quadratic share is of some 75 pm/(N mm).
pub(crate) const EFFECTS: [Effect; 10] = [
    effect("stage-backlash", "backlash_um", 1e-3, 100.0, "backlash_mm"),
    effect("time-lag", "lag_ms", 1e-3, 300.0, "lag_s"),
    effect(
        "zero-drift",
        "zero_drift_pm_per_min",
        1.0,
        2.0,
        "drift_pm_per_min_1",
    ),
    effect("creep", "creep_fraction", 1.0, 0.06, "creep_fraction"),
    effect("fbg-nonlinearity", "quadratic_fraction", 75.0, 0.04, ""),
    effect(
        "base-compliance",
        "root_turn_rad_per_nmm",
        1.0,
        0.06,
        "compliance_rad_per_nmm",
    ),
    effect("contact-offset", "groove_offset_mm", 1.0, 1.0, ""),
    effect("stage-periodic", "periodic_um", 1e-3, 50.0, ""),
    effect(
        "temperature-mismatch",
        "temperature_pm_per_degc",
        1.0,
        10.0,
        "mismatch_pm_per_degc_1",
    ),
    effect("stage-scale", "stage_scale", 1.0, 0.02, "relative_scale"),
];

/// Smallest detectable size of each effect in a session without one; none where the plan does not
/// show it.
pub(crate) type Smallest = BTreeMap<String, Option<f64>>;

/// The sizes that a verify.json states.
pub(crate) fn smallest(verify: &Value) -> Smallest {
    let rows = verify["detectable"].as_array().into_iter().flatten();
    let shown = |row: &Value| {
        (row["status"] == "testable")
            .then(|| row["smallest"].as_f64())
            .flatten()
    };
    rows.filter_map(|row| Some((row["id"].as_str()?.to_owned(), shown(row))))
        .collect()
}

/// An effect with what was drawn for it.
pub(crate) struct Act {
    /// The effect.
    pub effect: &'static Effect,
    /// Size in the scenario's unit.
    size: f64,
    /// Whether the plan shows it: an effect that it takes up or hides is rightly not named.
    pub shown: bool,
    /// Direction across the wire's root, or time constant, s.
    detail: f64,
}

impl Act {
    fn new(
        effect: &'static Effect,
        plan: &str,
        rate_hz: f64,
        smallest: &Smallest,
        rng: &mut ChaCha8Rng,
    ) -> Self {
        let per_rate = (REFERENCE_HZ / rate_hz).sqrt();
        let least = smallest
            .get(effect.id)
            .copied()
            .flatten()
            .map(|s| s / effect.per_key * per_rate);
        // The bench's play counts from loading, and the paper's poses are all approached so.
        let hidden = plan == "paper-27" && effect.id == "stage-backlash";
        let least = least.filter(|s| *s * SPAN <= effect.largest && !hidden);
        let (u, v): (f64, f64) = (rng.random(), rng.random());
        let size = match least {
            Some(least) if rng.random_bool(BEYOND) => {
                least * SPAN * (effect.largest / (least * SPAN)).powf(u)
            }
            Some(least) => least * SPAN.powf(u),
            None => effect.largest / SPAN.powf(u),
        };
        Self {
            effect,
            size,
            shown: least.is_some(),
            detail: if effect.id == "creep" {
                10.0 * 6f64.powf(v)
            } else {
                std::f64::consts::TAU * v
            },
        }
    }

    /// Across the wire: along y and z of the base.
    fn offset_mm(&self) -> [f64; 3] {
        let (sin, cos) = self.detail.sin_cos();
        [0.0, self.size * cos, self.size * sin]
    }

    /// Lines of `[effects]` in a scenario.
    fn lines(&self) -> String {
        match self.effect.id {
            "creep" => format!("creep_fraction = {}\ncreep_s = {}", self.size, self.detail),
            "contact-offset" => format!("groove_offset_mm = {:?}", self.offset_mm()),
            "temperature-mismatch" => String::new(),
            _ => format!("{} = {}", self.effect.key, self.size),
        }
    }

    /// Parameters of verify.json and their true values.
    pub(crate) fn truths(&self) -> Vec<(&'static str, f64)> {
        let size = self.size * self.effect.per_key;
        match self.effect.id {
            "creep" => vec![("creep_fraction", size), ("time_constant_s", self.detail)],
            "contact-offset" => ["offset_x_mm", "offset_y_mm", "offset_z_mm"]
                .into_iter()
                .zip(self.offset_mm())
                .collect(),
            // The lead of the bench's screw; sine and cosine follow from where the stage's zero is.
            "stage-periodic" => vec![("pitch_mm", 0.6096)],
            _ if self.effect.parameter.is_empty() => Vec::new(),
            _ => vec![(self.effect.parameter, size)],
        }
    }

    /// In words.
    pub(crate) fn words(&self) -> String {
        let detail = if self.effect.id == "creep" {
            format!(" {:.0} s", self.detail)
        } else {
            String::new()
        };
        let shown = if self.shown {
            ""
        } else {
            " (not shown by the plan)"
        };
        format!("{} {:.3e}{detail}{shown}", self.effect.key, self.size)
    }
}

/// What no catalogue has.
#[derive(Clone, Copy)]
pub(crate) enum Outside {
    /// A drift that sets in at a time, s, at a rate, pm/s.
    Drift([f64; 2]),
    /// One trajectory leaves its stated direction by an angle, rad.
    Turned(f64),
}

/// A drawn session.
pub(crate) struct Draw {
    /// Its number.
    pub k: u64,
    /// Seed of the bench.
    pub seed: u64,
    /// Plan.
    pub plan: &'static str,
    /// Scan rate, Hz.
    pub rate_hz: f64,
    /// Whether cameras look on.
    pub pictures: bool,
    /// What was put in.
    pub acts: Vec<Act>,
    /// What no catalogue has.
    pub outside: Option<Outside>,
}

/// A session without an effect at the reference's rate.
pub(crate) fn reference(seed: u64, plan: &'static str) -> Draw {
    Draw {
        k: 0,
        seed,
        plan,
        rate_hz: REFERENCE_HZ,
        pictures: false,
        acts: Vec::new(),
        outside: None,
    }
}

/// Draw `k` of a set. Of ten draws of a plan two are without an effect, two have two, one has
/// something outside the catalogue, and five have one: each in turn.
pub(crate) fn draw(
    seed: u64,
    k: u64,
    plan: &'static str,
    number: u64,
    smallest: &Smallest,
) -> Draw {
    let mut rng = ChaCha8Rng::seed_from_u64(seed.wrapping_mul(0x9e37_79b9).wrapping_add(k));
    let rate_hz = [200.0, 500.0, 1000.0, 2000.0][rng.random_range(0..4)];
    let mut act = |e: &'static Effect| Act::new(e, plan, rate_hz, smallest, &mut rng);
    let (place, singles) = ((number % 10) as usize, (number / 10 * 5) as usize);
    let mut drawn = Draw {
        k,
        seed: seed + k,
        plan,
        rate_hz,
        pictures: false,
        acts: Vec::new(),
        outside: None,
    };
    match place {
        0 | 5 => {}
        2 | 7 => {
            // Two that the plan shows.
            let shown: Vec<Act> = EFFECTS.iter().map(&mut act).filter(|a| a.shown).collect();
            let first = rng.random_range(0..shown.len());
            let second = (first + rng.random_range(1..shown.len())) % shown.len();
            drawn.acts = shown
                .into_iter()
                .enumerate()
                .filter(|(i, _)| [first, second].contains(i))
                .map(|(_, a)| a)
                .collect();
        }
        4 => {
            let u = SPAN.powf(rng.random::<f64>());
            let least = |id: &str| {
                smallest.get(id).copied().flatten().unwrap_or(0.1) * (REFERENCE_HZ / rate_hz).sqrt()
            };
            let (middle_s, depth_mm, trajectories) =
                (if plan == "rich" { 900.0 } else { 70.0 }, 3.0, 9f64);
            drawn.outside = Some(if rng.random() {
                Outside::Drift([middle_s, HALFWAY * u * least("zero-drift") / 60.0])
            } else {
                // An offset of one trajectory at its middle depth.
                Outside::Turned(
                    (u * trajectories.sqrt() * least("contact-offset") / depth_mm).min(0.2),
                )
            });
        }
        _ => {
            let single = singles
                + [1, 3, 6, 8, 9]
                    .iter()
                    .position(|p| *p == place)
                    .unwrap_or(0);
            drawn.acts = vec![act(&EFFECTS[(single + seed as usize) % EFFECTS.len()])];
        }
    }
    drawn.pictures = plan == "paper-27" && number % 4 == 3;
    drawn
}

impl Draw {
    /// What kind of draw it is.
    pub(crate) fn kind(&self) -> &'static str {
        match (&self.outside, self.acts.len()) {
            (Some(_), _) => "outside the catalogue",
            (None, 0) => "none",
            (None, 1) if !self.acts[0].shown => "not shown by the plan",
            (None, 1) => "single",
            _ => "pair",
        }
    }

    /// What was put in, in words.
    pub(crate) fn words(&self) -> String {
        match self.outside {
            Some(Outside::Drift([at_s, pm_per_s])) => {
                format!("drift from {at_s} s on, {:.3} pm/min", 60.0 * pm_per_s)
            }
            Some(Outside::Turned(rad)) => format!("trajectory 5 turned by {rad:.4} rad"),
            None if self.acts.is_empty() => "none".to_owned(),
            None => self
                .acts
                .iter()
                .map(Act::words)
                .collect::<Vec<_>>()
                .join(", "),
        }
    }

    /// scenario.toml at `speed`; `trajectories` of the rig file.
    pub(crate) fn scenario(&self, speed: f64, trajectories: &[toml::Value]) -> String {
        let effects: Vec<String> = self.acts.iter().map(Act::lines).collect();
        let mismatch = self
            .acts
            .iter()
            .find(|a| a.effect.id == "temperature-mismatch")
            .map_or(0.0, |a| a.size);
        let more = match self.outside {
            None => String::new(),
            Some(Outside::Drift([at_s, pm_per_s])) => {
                format!(
                    "[[fault]]\nat_s = {at_s}\nkind = \"signal-drift\"\npm_per_s = {pm_per_s}\n"
                )
            }
            Some(Outside::Turned(rad)) => trajectories.iter().map(|t| turned(t, rad)).collect(),
        };
        let cameras = if self.pictures { 2 } else { 0 };
        format!(
            "format = \"wcal-scenario/1\"\nseed = {}\nspeed = {speed}\n[interrogator]\nrate_hz = {}\nnoise_pm = 1.0\n[temperature]\n\
             drift_degc_per_h = 0.3\nswing_degc = 0.05\nswing_period_s = 600.0\n[cameras]\ncount = {cameras}\nrate_hz = 1.0\n\
             [fbg]\ntemperature_pm_per_degc = [{c}, {c}]\n[effects]\n{}\n{more}",
            self.seed,
            self.rate_hz,
            effects.join("\n"),
            c = 10.0 + mismatch,
        )
    }

    /// All of it in words, that a session recorded before may be recognised by.
    pub(crate) fn summary(&self) -> String {
        format!(
            "{} {} {} Hz, pictures {}: {}",
            self.seed,
            self.plan,
            self.rate_hz,
            self.pictures,
            self.words()
        )
    }

    /// Names of what the plan shows.
    pub(crate) fn names(&self) -> Vec<&'static str> {
        self.acts
            .iter()
            .filter(|a| a.shown)
            .map(|a| a.effect.id)
            .collect()
    }
}

/// A trajectory of the scenario; number 5 turned about the base's x axis.
fn turned(t: &toml::Value, rad: f64) -> String {
    let numbers = |key: &str| -> Vec<f64> {
        t[key]
            .as_array()
            .into_iter()
            .flatten()
            .filter_map(toml::Value::as_float)
            .collect()
    };
    let (id, origin, mut d) = (
        t["id"].as_integer().unwrap_or(0),
        numbers("origin_mm"),
        numbers("direction"),
    );
    if id == 5 {
        let (sin, cos) = rad.sin_cos();
        (d[1], d[2]) = (cos * d[1] - sin * d[2], sin * d[1] + cos * d[2]);
    }
    format!("[[trajectory]]\nid = {id}\norigin_mm = {origin:?}\ndirection = {d:?}\n")
}
