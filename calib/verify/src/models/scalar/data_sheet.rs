//! The accepted model in the terms of data sheets (ISA-37.3; creep in 30 min: OIML R 60).
//!
//! ```text
//! m(x) = (up(x) + down(x)) / 2,     h(x) = |up(x) - down(x)|,     S = |m(high) - m(low)|
//! sensitivity: slope b of the least-squares line through m        non-linearity: max |m - line| / S
//! hysteresis: max h / S            repeatability: 2 s / S         zero: m(0)
//! U = k sqrt((noise^2 + fit^2) / m'^2 + reference^2) + bound of the memory      where it is largest
//! ```
//!
//! What follows the time is not in `m`: creep has a line of its own, a drift is that session's.

use super::frame::{Declared, Names, ScalarRow};
use super::inverse::Before;
use super::model::{ScalarModel, ScalarPrediction};
use super::parameters::physical;
use super::predictions::gradient;
use crate::effect::LawRequirement;
use crate::method::t95;
use crate::{Effect, EffectTerm, MeasurementModel};
use nalgebra::DVector;
use std::ops::Range;
use wcal_core::data_sheet::{Characteristic, DataSheet, UncertaintyBudget, UncertaintySource};
use wcal_core::observation::Role;
use wcal_core::text::{number, with_unit};

/// Places over the range.
const PLACES: usize = 64;
/// Time under load after which creep is stated, s (OIML R 60-1).
const CREEP_S: f64 = 1800.0;
/// A loop or bend below this share of the full scale is rounding.
const ROUNDING: f64 = 1e-9;
const PERCENT: f64 = 100.0;
/// Digits of an effect's values in the equation.
const SHORT: usize = 5;
/// Values of an effect that the equation has room for.
const FEW: usize = 6;

/// The response over a cycle from the low end up and back.
struct Cycle {
    x: Vec<f64>,
    /// Rows of the way up, in the order of `x`, and of the way down.
    ways: [Vec<usize>; 2],
    values: DVector<f64>,
    gradient: nalgebra::DMatrix<f64>,
    covariance: nalgebra::DMatrix<f64>,
}

impl Cycle {
    /// Mean of both ways.
    fn mean(&self, k: usize) -> f64 {
        0.5 * (self.values[self.ways[0][k]] + self.values[self.ways[1][k]])
    }

    /// Response on the way down less that on the way up.
    fn gap(&self, k: usize) -> f64 {
        self.values[self.ways[1][k]] - self.values[self.ways[0][k]]
    }

    /// Sum of `weights` times the means, and its standard deviation by the fit.
    fn combined(&self, weights: &[f64]) -> (f64, f64) {
        let mut of_rows = DVector::zeros(self.values.len());
        for (k, w) in weights.iter().enumerate() {
            self.ways.iter().for_each(|way| of_rows[way[k]] += 0.5 * w);
        }
        let by = self.gradient.transpose() * &of_rows;
        let variance = (by.transpose() * &self.covariance * &by)[0];
        (self.values.dot(&of_rows), variance.max(0.0).sqrt())
    }

    fn largest(&self, of: impl Fn(usize) -> f64) -> f64 {
        (0..self.x.len()).map(|k| of(k).abs()).fold(0.0, f64::max)
    }
}

impl ScalarModel {
    /// What to write down of the instrument; none of a constant, or where nothing can be predicted.
    pub fn data_sheet(&self) -> Option<DataSheet> {
        if self.declared == Declared::Polynomial(0) {
            return None;
        }
        let still = self.without(&|_, law_follows_time| law_follows_time)?;
        let cycle = still.cycle()?;
        let axis = self.declared == Declared::Axis;
        let characteristics = match axis {
            true => self.of_axis(&cycle),
            false => self.of_transducer(&still, &cycle)?,
        };
        let uncertainty = match axis {
            true => still.of_position(&cycle),
            // A response that does not determine its stimulus has no sensitivity.
            false => Some(still.of_stimulus(&cycle)?),
        };
        let mut conditions = Vec::new();
        if let Some(mean) = self.scaling.temperature {
            conditions.push(format!("at {} degC", number(mean, 4)));
        }
        if self.reference_sd == 0.0 {
            conditions.push(
                "U does not hold the uncertainty of the reference standard: add it in quadrature"
                    .to_owned(),
            );
        }
        if still.effects.len() < self.effects.len() {
            let gone = |t: &&super::model::ModelTerm| !still.effects.contains(t);
            let names: Vec<&str> = self
                .effects
                .iter()
                .filter(gone)
                .map(|t| t.id.as_str())
                .collect();
            conditions.push(format!(
                "at once: {} is not in the equation",
                names.join(", ")
            ));
        }
        Some(DataSheet {
            equation: self.equation()?,
            characteristics,
            uncertainty,
            range: self.stimulus_range,
            range_unit: self.stimulus_unit.clone(),
            conditions,
        })
    }

    /// The accepted model with its values.
    fn equation(&self) -> Option<String> {
        let [mid, half] = [self.scaling.mid, self.scaling.half_range()];
        let units = [("x", &self.stimulus_unit), ("y", &self.response_unit)];
        let stated = units.iter().filter(|(_, unit)| *unit != "1");
        let units: Vec<String> = stated.map(|(of, unit)| format!("{of} in {unit}")).collect();
        let units = match units.is_empty() {
            true => String::new(),
            false => format!("; {}", units.join(", ")),
        };
        let effects = self.effects_with_values()?;
        if self.declared == Declared::Axis {
            // Of a table of errors the first coefficient is the first place's.
            let constant = number(self.coefficients[0] - self.offset, SHORT);
            let all: Vec<String> = [constant].into_iter().chain(effects).collect();
            return Some(format!("error y(x) = {}{units}", all.join(" + ")));
        }
        let (coefficients, rest) = match &self.polynomial {
            Some(p) => (p.coefficients.clone(), String::new()),
            // Powers of u = (x - mid) / half, written in x.
            None => {
                let c = |k: usize| match self.declared {
                    Declared::Polynomial(degree) if k <= degree => self.coefficients[k],
                    _ => 0.0,
                };
                let b = [
                    c(0) - c(1) * mid / half + c(2) * (mid / half).powi(2),
                    c(1) / half - 2.0 * c(2) * mid / half.powi(2),
                    c(2) / half.powi(2),
                ];
                let degree = b.iter().rposition(|b| *b != 0.0).unwrap_or(0);
                let rest = effects.iter().map(|e| format!(" + {e}")).collect();
                (b[..=degree].to_vec(), rest)
            }
        };
        let term = |(k, b): (usize, &f64)| {
            let power = match k {
                0 => String::new(),
                1 => " x".to_owned(),
                k => format!(" x^{k}"),
            };
            number(*b, 10) + &power
        };
        let terms: Vec<String> = coefficients.iter().enumerate().map(term).collect();
        let terms = terms.join(" + ").replace("+ -", "- ");
        Some(format!("y = {terms}{rest}{units}"))
    }

    /// The accepted effects with their laws and values, e.g. `backlash(reversal_value = 1.5 um)`.
    fn effects_with_values(&self) -> Option<Vec<String>> {
        let system = self.system(Vec::new());
        let names = Names {
            stimulus: self.stimulus_unit.clone(),
            response: self.response_unit.clone(),
            deviation: self.declared == Declared::Axis,
            covariates: self.covariates.clone(),
            ..Names::default()
        };
        let terms = self.terms(&system).ok()?;
        let of = |(term, [columns, _]): (&EffectTerm, [Range<usize>; 2])| {
            let effect = &system.catalogue()[term.effect];
            let law = effect.law(term.law);
            let own = law.parameters.iter().zip(&term.values);
            let own = own.map(|(p, value)| (p.name, p.unit, *value));
            let linear = law.linear.iter().zip(columns);
            let linear = linear.map(|((name, unit), k)| (*name, *unit, self.coefficients[k]));
            let values: Vec<String> = own
                .chain(linear)
                .map(|(name, unit, value)| {
                    let (value, unit) = physical(unit, value, term.law, &system.frame, &names);
                    with_unit(&format!("{name} = {}", number(value, SHORT)), &unit)
                })
                .collect();
            match values.len() {
                0 => format!("{}({})", effect.id, law.name),
                1..=FEW => format!("{}({}: {})", effect.id, law.name, values.join(", ")),
                many => format!(
                    "{}({}: {many} values in calibration.json)",
                    effect.id, law.name
                ),
            }
        };
        Some(terms.iter().zip(self.slots(&terms)).map(of).collect())
    }

    /// The model without the terms that `goes` says of: the effect, and whether its law follows the
    /// time or the order.
    fn without(&self, goes: &dyn Fn(&Effect, bool) -> bool) -> Option<Self> {
        use LawRequirement::{Clock, Order, Time};
        let system = self.system(Vec::new());
        let terms = self.terms(&system).ok()?;
        let slots = self.slots(&terms);
        let count = self.coefficients.len();
        let declared = slots.first().map_or(count, |[columns, _]| columns.start);
        let mut columns: Vec<usize> = (0..declared).collect();
        let (mut values, mut effects) = (Vec::new(), Vec::new());
        for ((t, named), [own, nonlinear]) in terms.iter().zip(&self.effects).zip(slots) {
            let effect = &system.catalogue()[t.effect];
            let needs = &effect.law(t.law).needs;
            let timed = needs.iter().any(|n| matches!(n, Time | Clock | Order));
            if !goes(effect, timed) {
                columns.extend(own);
                values.extend(nonlinear);
                effects.push(named.clone());
            }
        }
        let slots: Vec<usize> = columns.iter().chain(&values).copied().collect();
        let row = |i: &usize| slots.iter().map(|j| self.covariance[*i][*j]).collect();
        Some(Self {
            effects,
            coefficients: columns.iter().map(|k| self.coefficients[*k]).collect(),
            covariance: slots.iter().map(row).collect(),
            ..self.clone()
        })
    }

    /// A reading at the middle of everything but the stimulus.
    fn row(&self, x: f64, direction: f64) -> ScalarRow {
        ScalarRow {
            origin: (String::new(), 0, 0),
            role: Role::Verification,
            x,
            x_sd: None,
            y: 0.0,
            t_s: None,
            temperature_degc: self.scaling.temperature,
            direction: Some(direction),
            cycle: None,
            covariates: self
                .scaling
                .covariates
                .iter()
                .map(|[mid, _]| *mid)
                .collect(),
            place: None,
        }
    }

    fn cycle(&self) -> Option<Cycle> {
        let [low, high] = self.stimulus_range;
        let mut x: Vec<f64> = (0..=PLACES)
            .map(|k| low + (high - low) * k as f64 / PLACES as f64)
            .collect();
        if low < 0.0 && high > 0.0 && !x.contains(&0.0) {
            x.push(0.0);
            x.sort_by(f64::total_cmp);
        }
        let last = x.len() - 1;
        // Held at the low end at first, so that what remembers has forgotten.
        let mut rows = vec![self.row(low, -1.0); 2];
        rows.extend(x.iter().map(|x| self.row(*x, 1.0)));
        rows.extend(x[..last].iter().rev().map(|x| self.row(*x, -1.0)));
        let system = self.system(rows);
        let fitted = self.fitted(self.terms(&system).ok()?).ok()?;
        let (values, gradient) = gradient(&system, &fitted)?;
        let up = 2..=2 + last;
        let down = (0..=last).map(|k| 2 + last + (last - k));
        Some(Cycle {
            ways: [up.collect(), down.collect()],
            values: values.add_scalar(-self.offset),
            gradient,
            covariance: fitted.covariance,
            x,
        })
    }

    fn of_axis(&self, cycle: &Cycle) -> Vec<Characteristic> {
        let of =
            |name, value, meaning| Characteristic::new(name, value, &self.response_unit, meaning);
        let mut out = vec![of(
            "largest error",
            cycle.largest(|k| cycle.mean(k)),
            "of a position without correction, mean of both directions",
        )];
        let reversal = cycle.largest(|k| cycle.gap(k));
        if reversal > ROUNDING * out[0].value.abs() {
            let meaning = "largest difference of both directions (ISO 230-2, B)";
            out.push(of("reversal", reversal, meaning));
        }
        out
    }

    fn of_transducer(&self, still: &Self, cycle: &Cycle) -> Option<Vec<Characteristic>> {
        let [x, y] = [&self.stimulus_unit, &self.response_unit];
        let k = t95(self.dof);
        let n = cycle.x.len() as f64;
        let mid = cycle.x.iter().sum::<f64>() / n;
        let square: f64 = cycle.x.iter().map(|x| (x - mid).powi(2)).sum();
        // Slope of least squares: sum (x - mean) m / sum (x - mean)^2.
        let weights: Vec<f64> = cycle.x.iter().map(|x| (x - mid) / square).collect();
        let (slope, slope_sd) = cycle.combined(&weights);
        let means = (0..cycle.x.len()).map(|k| cycle.mean(k));
        let level = means.sum::<f64>() / n;
        let last = cycle.x.len() - 1;
        let full_scale = (cycle.mean(last) - cycle.mean(0)).abs();
        if !(full_scale > 0.0) {
            return None;
        }
        let percent = |name: &str, value: f64, meaning: &str| {
            Characteristic::new(name, PERCENT * value / full_scale, "% FS", meaning)
        };
        let unit = match (y.as_str(), x.as_str()) {
            (y, "1") => y.to_owned(),
            (y, x) => format!("{y}/{x}"),
        };
        let line = "slope of the least-squares line over the range";
        let mut out = vec![Characteristic {
            half95: Some(k * slope_sd),
            ..Characteristic::new("sensitivity", slope, &unit, line)
        }];
        if let Some(zero) = cycle.x.iter().position(|x| *x == 0.0) {
            let at: Vec<f64> = (0..=last).map(|k| f64::from(k == zero)).collect();
            let (value, sd) = cycle.combined(&at);
            out.push(Characteristic {
                half95: Some(k * sd),
                ..Characteristic::new("zero", value, y, &with_unit("response at 0", x))
            });
        }
        let bend = cycle.largest(|k| cycle.mean(k) - level - slope * (cycle.x[k] - mid));
        let line = "largest distance from the least-squares line";
        out.extend((bend > ROUNDING * full_scale).then(|| percent("non-linearity", bend, line)));
        let gap = cycle.largest(|k| cycle.gap(k));
        let both = "largest difference of both directions";
        out.extend((gap > ROUNDING * full_scale).then(|| percent("hysteresis", gap, both)));
        let middle = self.system(vec![self.row(mid, 1.0)]);
        let noise = self.noise_sd(&middle.frame)[0];
        let spread = "two standard deviations of one reading at the middle";
        out.push(percent("repeatability", 2.0 * noise, spread));
        if let Some((creep, seconds)) = self.creep(still) {
            let name = format!("creep in {} s", number(seconds, 4));
            out.push(percent(
                &name,
                creep,
                "change under full load that was put on at once",
            ));
        }
        out.extend(still.of_temperature(cycle, slope, full_scale));
        Some(out)
    }

    /// Change of the response under full load, and the time that it takes, s.
    fn creep(&self, still: &Self) -> Option<(f64, f64)> {
        let creeps = |e: &Effect, timed: bool| timed && e.id != "creep";
        let model = self.without(&creeps)?;
        if model.effects.len() == still.effects.len() {
            return None;
        }
        let [low, high] = self.stimulus_range;
        let [first, duration] = self.scaling.time?;
        let seconds = CREEP_S.min(duration);
        let loaded = |by: f64| ScalarRow {
            t_s: Some(first + by),
            ..self.row(high, 1.0)
        };
        let before = Before {
            stimulus: low,
            direction: 1.0,
            late: false,
        };
        let found = model
            .after(&[loaded(0.0), loaded(seconds)], before, true)
            .ok()?;
        Some((found[1].value - found[0].value, seconds))
    }

    /// What a degree changes of zero and sensitivity.
    fn of_temperature(&self, cycle: &Cycle, slope: f64, full_scale: f64) -> Vec<Characteristic> {
        let Some(mean) = self.scaling.temperature else {
            return Vec::new();
        };
        let at = |rise: f64| {
            let mut model = self.clone();
            // Rows at the mean of a model whose mean is another one are that much warmer.
            model.scaling.temperature = Some(mean - rise);
            let row = |x: f64| ScalarRow {
                temperature_degc: Some(mean),
                ..self.row(x, 1.0)
            };
            let [low, high] = self.stimulus_range;
            model.predict(&[row(low), row(high)]).ok()
        };
        let (Some(warm), Some(cold)) = (at(0.5), at(-0.5)) else {
            return Vec::new();
        };
        let change = |k: usize| warm[k].value - cold[k].value;
        let span = change(1) - change(0);
        let last = cycle.x.len() - 1;
        let sensitivity = span / (cycle.x[last] - cycle.x[0]) / slope;
        let of = |name, value: f64, unit, meaning| {
            Characteristic::new(name, PERCENT * value, unit, meaning)
        };
        let mut out = Vec::new();
        if change(0).abs() > ROUNDING * full_scale {
            let meaning = "change of the response at the low end";
            out.push(of(
                "temperature, zero",
                change(0) / full_scale,
                "% FS/K",
                meaning,
            ));
        }
        if sensitivity.abs() > ROUNDING {
            let meaning = "relative change of the sensitivity";
            out.push(of("temperature, sensitivity", sensitivity, "%/K", meaning));
        }
        out
    }

    /// Uncertainty of the stimulus of one new reading, where it is largest.
    fn of_stimulus(&self, cycle: &Cycle) -> Option<UncertaintyBudget> {
        let rows: Vec<ScalarRow> = (0..cycle.x.len())
            .map(|k| ScalarRow {
                y: cycle.mean(k),
                direction: None,
                ..self.row(cycle.x[k], 1.0)
            })
            .collect();
        let found = self.invert(&rows).ok()?;
        let worst =
            (0..found.len()).max_by(|a, b| found[*a].half95.total_cmp(&found[*b].half95))?;
        // Local slope between the neighbouring places.
        let (a, b) = (worst.saturating_sub(1), (worst + 1).min(cycle.x.len() - 1));
        let slope = ((cycle.mean(b) - cycle.mean(a)) / (cycle.x[b] - cycle.x[a])).abs();
        let loop_bound = "direction and history of the load";
        let bounded = |half: f64| {
            let of_readings = self.beside_reference(half / slope);
            (found[worst].half95 - of_readings, loop_bound)
        };
        let unit = self.stimulus_unit.clone();
        self.budget(
            "stimulus",
            unit,
            (cycle.x[worst], found[worst].half95),
            slope,
            bounded,
        )
    }

    /// Uncertainty of a corrected position, where it is largest.
    fn of_position(&self, cycle: &Cycle) -> Option<UncertaintyBudget> {
        let rows: Vec<ScalarRow> = cycle.x.iter().map(|x| self.row(*x, 1.0)).collect();
        let found = self.predict(&rows).ok()?;
        let worst = found.iter().map(|p| p.half95).enumerate();
        let (worst, half) = worst.max_by(|a, b| a.1.total_cmp(&b.1))?;
        let unit = self.response_unit.clone();
        self.budget(
            "corrected position",
            unit,
            (cycle.x[worst], half),
            1.0,
            |_| (0.0, ""),
        )
    }

    /// The parts of an expanded uncertainty `half` at a stimulus; `bound` of what the response's own
    /// half width leaves.
    fn budget(
        &self,
        of: &str,
        unit: String,
        (at, half): (f64, f64),
        slope: f64,
        bound: impl Fn(f64) -> (f64, &'static str),
    ) -> Option<UncertaintyBudget> {
        let row = self.row(at, 1.0);
        let own: ScalarPrediction = *self.predict(std::slice::from_ref(&row)).ok()?.first()?;
        let noise = self.noise_sd(&self.system(vec![row]).frame)[0];
        let k = t95(self.dof);
        let fit = ((own.half95 / k).powi(2) - noise * noise).max(0.0).sqrt();
        let source = |source: &str, standard: f64, is_bound: bool| UncertaintySource {
            source: source.to_owned(),
            standard,
            is_bound,
        };
        let mut sources = vec![
            source("noise of one reading", noise / slope, false),
            source("fit of the coefficients", fit / slope, false),
        ];
        if self.reference_sd > 0.0 {
            sources.push(source("reference", self.reference_sd, false));
        }
        let (rest, name) = bound(own.half95);
        if rest > 1e-3 * half {
            sources.push(source(name, rest, true));
        }
        Some(UncertaintyBudget {
            of: of.to_owned(),
            expanded: half,
            k,
            unit,
            at,
            sources,
        })
    }
}
