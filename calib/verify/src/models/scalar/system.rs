//! A transducer or axis session as a system: stimulus -> effects on the stimulus -> declared model
//! -> additive effects.

use super::admission::number;
use super::effects;
use super::frame::{Declared, Frame, Names, ScalarRow, Scaling};
use super::range_limit::{RangeLimit, read_out};
use super::row::all;
use super::scalar_effect::ScalarEffect;
use super::stimulus_scale::times_wrapped;
use crate::effect::{Effect, EffectModel, EffectTerm, LawRequirement, Values};
use crate::measurement_model::{DesignTest, MeasurementModel, design_of, finite};
use crate::method::{Hypothesis, NoiseInputs, NotIdentified, Spread, SpreadLaw, relative_sd};
use nalgebra::{DMatrix, DVector};
use std::collections::BTreeSet;
use std::sync::Arc;
use wcal_core::order_statistics::median;
use wcal_core::repeats::decimal_step;

/// Why a session does not give what a law needs; none where it does.
fn unmet(need: LawRequirement, frame: &Frame) -> Option<&'static str> {
    use LawRequirement::{BothDirections, Clock, Covariate, Order, Slope, Temperature, Time};
    let (met, why) = match need {
        Slope => (
            frame.sloped(),
            "the declared model is constant: it does not follow the stimulus",
        ),
        Time if frame.time.is_none() => (false, "the session has no time stamps"),
        Time | Clock | Order if frame.swept_once() => (false, SWEPT_ONCE),
        Clock | Order => (
            frame.ordered,
            "the table has no time stamps and is sorted by the stimulus, repetitions side by side: the order of the readings is unknown",
        ),
        BothDirections => (
            frame.direction.is_some(),
            "the table has no readings in both directions (column direction, or times with rising and falling stimulus)",
        ),
        Temperature => (
            frame.temperature.is_some(),
            "the session has no temperature column, or it is constant",
        ),
        Covariate => (
            frame.covariates.iter().any(Option::is_some),
            "the table has no further covariate that varies",
        ),
        _ => return None,
    };
    (!met).then_some(why)
}

/// Why no law of the clock shows in a single series of rising loads (ASTM E74, ISO 376 and DKD-R
/// 6-1 turn directions for that reason).
pub(super) const SWEPT_ONCE: &str = "the stimulus only rises or only falls, so that what follows the time follows the stimulus, too: take a falling series, or the stimuli in another order";
/// Why nothing bends over a full turn.
const ONE_PLACE: &str = "the stimulus goes around once: 0 and a full turn are one place";

/// A scalar session, its declared model and the catalogue.
#[derive(Clone)]
pub struct ScalarSystem {
    /// Rows and covariates.
    pub frame: Frame,
    /// The effects with their hooks.
    pub(super) effects: Vec<ScalarEffect>,
    catalogue: Vec<Effect>,
    measured: DMatrix<f64>,
    /// 1 / relative standard deviation of each reading, where the spread follows the stimulus.
    weights: Vec<f64>,
    /// By which names the session calls things.
    pub(super) names: Names,
    /// Every reading of the points table, those that the search leaves out among them.
    pub(super) points: Arc<Vec<ScalarRow>>,
    /// Rows that were sealed.
    pub(super) sealed: Vec<bool>,
    /// Limits of the read-out at which readings stand.
    pub(super) limits: Vec<RangeLimit>,
    /// Trend of the spread, where one was found.
    pub(super) spread: Option<Spread>,
    /// A trend was found and did not outlive the effects that were found with it.
    pub(super) given_up_spread: bool,
    /// Far offset that the axis's known part enters with, added to every measured value (0 for
    /// transducers), see `design`.
    pub(super) offset: f64,
}

/// Standard deviation of the noise at every row of `frame`, in units of that at `centre`, by a law
/// of the spread.
pub(crate) fn relative_sd_at(
    frame: &Frame,
    law: SpreadLaw,
    exponent: f64,
    centre: f64,
) -> Vec<f64> {
    law.scale(frame)
        .iter()
        .map(|v| relative_sd(exponent, v - centre))
        .collect()
}

/// Least and largest stated variance beside a typical one; a reference mass of nothing is no
/// reading without noise.
const STATED: [f64; 2] = [1e-2, 1e6];

/// Stated variances of the stimuli beside a typical one: the shape of what the reference adds to
/// the noise (ISO/TS 28037, the slope taken as one over the range). Empty where they are not
/// stated, or all alike.
fn stated_variances(rows: &[ScalarRow]) -> Vec<f64> {
    let Some(sd) = all(rows, |r| r.x_sd) else {
        return Vec::new();
    };
    let typical = median(sd.iter().copied().filter(|sd| *sd > 0.0)).unwrap_or_default();
    let alike = sd.iter().all(|v| *v == sd[0]);
    // A stimulus error enters the response by the slope, which the ratio to a typical one cancels.
    let variance = |sd: &f64| (sd / typical).powi(2).clamp(STATED[0], STATED[1]);
    if alike || typical <= 0.0 {
        Vec::new()
    } else {
        sd.iter().map(variance).collect()
    }
}

/// Stimuli that a further power of a smooth curve takes, and most of them: higher ones swing
/// between the places.
const READINGS_A_POWER: usize = 3;
const MAX_POWERS: usize = 5;

/// An axis is measured from a point this many times the largest error away.
const FAR: f64 = 1e5;

impl ScalarSystem {
    /// System of a frame; `covariate_names` belong to the rows' further covariates.
    pub fn new(frame: Frame, covariate_names: &[String]) -> Self {
        let effects = effects::scalar_catalogue(&frame, covariate_names.len());
        let n = frame.rows.len();
        let largest = frame.rows.iter().map(|r| r.y.abs()).fold(0.0, f64::max);
        let offset = match frame.declared {
            Declared::Axis => FAR * if largest > 0.0 { largest } else { 1.0 },
            Declared::Polynomial(_) => 0.0,
        };
        Self {
            measured: DMatrix::from_fn(n, 1, |i, _| frame.rows[i].y + offset),
            weights: vec![1.0; n],
            names: Names {
                covariates: covariate_names.to_vec(),
                ..Names::default()
            },
            points: Arc::new(frame.rows.clone()),
            sealed: vec![false; n],
            limits: Vec::new(),
            spread: None,
            given_up_spread: false,
            frame,
            catalogue: effects.iter().map(|e| e.effect.clone()).collect(),
            effects,
            offset,
        }
    }

    /// With the session's names, every reading of its points table that measures, and the limits at
    /// which the others stand.
    pub fn of_session(
        mut self,
        names: Names,
        points: Vec<ScalarRow>,
        limits: Vec<RangeLimit>,
    ) -> Self {
        (self.names, self.points, self.limits) = (names, Arc::new(points), limits);
        self
    }

    /// The same effects seen on every row of the session, unsealed ones behind the others; far
    /// offset and law of the spread kept.
    pub(crate) fn with_unsealed(&self, unsealed: &[ScalarRow]) -> Self {
        let mut unsealed = unsealed.to_vec();
        // They go on behind, unless the clock says otherwise.
        number(&mut unsealed);
        for row in &mut unsealed {
            row.place = row.place.map(|p| p + self.points.len());
        }
        let origins: BTreeSet<_> = unsealed.iter().map(|r| r.origin.clone()).collect();
        let rows = self.points.iter().cloned().chain(unsealed).collect();
        // A sealed reading is predicted like any new one: at the stimulus that was read.
        let as_read = Scaling {
            unreliability: 0.0,
            ..self.frame.scaling.clone()
        };
        let frame = Frame::new(rows, &as_read, self.frame.declared, true);
        let mut all = Self::new(frame, &self.names.covariates).with_offset(self.offset);
        // What stands at a limit measures nothing there, either.
        let measures = |r: &ScalarRow| {
            self.limits
                .iter()
                .all(|l| l.value != read_out(r, self.frame.declared))
        };
        let sealed = |r: &ScalarRow| origins.contains(&r.origin) && measures(r);
        all.sealed = all.frame.rows.iter().map(sealed).collect();
        (all.names, all.points) = (self.names.clone(), self.points.clone());
        all.limits = self.limits.clone();
        let Some(s) = &self.spread else { return all };
        let relative_sd = relative_sd_at(&all.frame, s.law, s.exponent, s.law.centre(&self.frame));
        all.with_spread(Spread {
            relative_sd,
            ..s.clone()
        })
    }

    /// Step of a coarse read-out; 0 where it is fine.
    pub(super) fn step(&self) -> f64 {
        let steps = self.noise_inputs().step;
        steps.first().copied().flatten().unwrap_or_default()
    }

    /// The same rows seen from another far point.
    pub(crate) fn with_offset(mut self, offset: f64) -> Self {
        self.measured.add_scalar_mut(offset - self.offset);
        self.offset = offset;
        self
    }

    /// The same rows whose noise has this trend.
    pub(crate) fn with_spread(mut self, spread: Spread) -> Self {
        self.weights = spread.relative_sd.iter().map(|sd| 1.0 / sd).collect();
        self.spread = Some(spread);
        self
    }

    /// The same rows with equal noise.
    pub(super) fn with_equal_noise(mut self) -> Self {
        self.weights.fill(1.0);
        self.spread = None;
        self
    }

    /// The same rows with equal noise, whose trend is given up for good.
    pub(crate) fn without_spread(self) -> Self {
        let given_up_spread = self.given_up_spread || self.spread.is_some();
        Self {
            given_up_spread,
            ..self.with_equal_noise()
        }
    }
}

impl MeasurementModel for ScalarSystem {
    fn measured(&self) -> &DMatrix<f64> {
        &self.measured
    }

    fn design(&self, terms: &[EffectTerm]) -> Option<DMatrix<f64>> {
        let frame = &self.frame;
        let mut u = finite(frame.u.clone())?;
        let active = || {
            terms.iter().map(|t| {
                let effect = &self.effects[t.effect];
                let law = effect.effect.law(t.law);
                (effect, Values::new(law, t.law, &t.values))
            })
        };
        for (effect, values) in active() {
            finite(values.all())?;
            if !(effect.warp)(&values, frame, &mut u) {
                return None;
            }
            finite(&u)?;
        }
        let mut columns: Vec<Vec<f64>> = match frame.declared {
            Declared::Polynomial(degree) => {
                // The declared model stands at the stimulus as read; effects add to it.
                let read = |i: usize| frame.read_u[i] + (u[i] - frame.u[i]);
                let power = |k: usize| (0..u.len()).map(|i| read(i).powi(k as i32)).collect();
                (0..=degree).map(power).collect()
            }
            // measured - commanded = constant + (x_eff - x): the second part has no free
            // coefficient. Seen from a far point it rides on the constant's column, with a
            // coefficient of one to within error / offset = 1e-5.
            Declared::Axis => {
                let um = 1e3 * frame.scaling.half / self.offset;
                let moved = u.iter().zip(&frame.u);
                vec![moved.map(|(e, c)| 1.0 + um * (e - c)).collect()]
            }
        };
        for (effect, values) in active() {
            columns.extend((effect.columns)(&values, frame)?);
        }
        design_of(&columns)
    }

    fn smooth_columns(&self) -> Vec<Vec<f64>> {
        let Declared::Polynomial(declared) = self.frame.declared else {
            return Vec::new();
        };
        // More powers than places can carry would follow single readings.
        let further = self.frame.levels().saturating_sub(declared + 1) / READINGS_A_POWER;
        let power = |k: usize| self.frame.u.iter().map(|u| u.powi(k as i32)).collect();
        let powers = (declared + 1..=declared + further.min(MAX_POWERS)).map(power);
        let wraps = Some(&self.frame.scaling.wraps).filter(|wraps| !wraps.is_empty());
        powers
            .chain(wraps.map(|wraps| times_wrapped(&self.frame.rows, wraps)))
            .collect()
    }

    fn catalogue(&self) -> &[Effect] {
        &self.catalogue
    }

    fn not_observable(&self, effect: usize) -> Option<String> {
        let ScalarEffect {
            effect,
            not_observable,
            bend,
            degree,
            ..
        } = &self.effects[effect];
        if (*bend || degree.is_some()) && self.frame.counts_readings {
            return Some("no stimulus was set: its column counts the readings".to_owned());
        }
        if *bend && self.frame.cyclic() {
            return Some(ONE_PLACE.to_owned());
        }
        // None of its laws has what it needs.
        let unmet = |law: &EffectModel| law.needs.iter().find_map(|need| unmet(*need, &self.frame));
        let unmet: Option<Vec<&str>> = effect.laws.iter().map(unmet).collect();
        unmet
            .and_then(|all| Some((*all.first()?).to_owned()))
            .or_else(|| not_observable(&self.frame))
    }

    fn not_identified(&self, h: &Hypothesis) -> Option<NotIdentified> {
        self.unidentified_term(h)
    }

    fn design_tests(
        &self,
        h: &Hypothesis,
        term: &EffectTerm,
        signature: &DVector<f64>,
    ) -> Vec<DesignTest> {
        self.strata_tests(h, term, signature)
    }

    fn further_columns(&self) -> &[String] {
        &self.names.covariates
    }

    fn groups(&self) -> &[u32] {
        &self.frame.groups
    }

    fn covariates(&self) -> Vec<(String, Vec<f64>)> {
        let frame = &self.frame;
        let stimulus = if frame.declared == Declared::Axis {
            "commanded_mm"
        } else {
            "stimulus"
        };
        let column = |f: &dyn Fn(&ScalarRow) -> f64| frame.rows.iter().map(f).collect::<Vec<f64>>();
        let mut out = vec![(stimulus.to_owned(), column(&|r| r.x))];
        let mut add = |name: &str, values: Vec<f64>| out.push((name.to_owned(), values));
        let clock = !frame.swept_once();
        if frame.ordered && clock {
            add("order", (0..frame.rows.len()).map(|k| k as f64).collect());
        }
        if frame.time.is_some() && clock {
            add("t_s", column(&|r| r.t_s.unwrap_or_default()));
        }
        if frame.temperature.is_some() {
            let degc = column(&|r| r.temperature_degc.unwrap_or_default());
            add("temperature_degc", degc);
        }
        if let Some(direction) = &frame.direction {
            add("direction", direction.clone());
        }
        for (k, name) in self.names.covariates.iter().enumerate() {
            if frame.covariates.get(k).is_some_and(Option::is_some) {
                add(name, column(&|r| r.covariates[k]));
            }
        }
        // The first of drivers that say the same is named: a column that counts the readings says
        // it last.
        if frame.counts_readings {
            out.rotate_left(1);
        }
        out
    }

    fn noise_inputs(&self) -> NoiseInputs {
        let frame = &self.frame;
        let n = frame.rows.len();
        let values: Vec<f64> = frame.rows.iter().map(|r| r.y).collect();
        // The order of the rows stands in for a clock where nothing speaks against it; a break
        // between sweeps shows in the time constant.
        let times = all(&frame.rows, |r| r.t_s);
        let counts_readings = times.is_none();
        let order = || frame.ordered.then(|| (0..n).map(|k| k as f64).collect());
        NoiseInputs {
            clock: times.or_else(order).map(Arc::new),
            counts_readings,
            known: self.weights.clone(),
            averaged: stated_variances(&frame.rows),
            step: vec![decimal_step(&values)],
            ..NoiseInputs::none(n)
        }
    }
}
