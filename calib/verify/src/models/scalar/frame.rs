//! The rows of a transducer or axis session in the order in which they were taken, with normalised
//! covariates.

pub use super::row::ScalarRow;
use super::row::all;
use super::sequence::{MIN_REPEATS, directions, groups, series, sorted_with_repetitions};
use super::stimulus_scale::{absolute_zero, full_turn, wraps};
use crate::method::{cosine, means, reliability, settings};
use crate::models::range;
use nalgebra::DVector;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;
use wcal_core::Sealed;
use wcal_core::observation::{TransducerModel, TransducerRow};

/// Declared model of the session.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Declared {
    /// Polynomial of this degree in the stimulus with free coefficients.
    Polynomial(usize),
    /// measured = commanded + constant.
    Axis,
}

impl From<TransducerModel> for Declared {
    fn from(model: TransducerModel) -> Self {
        match model {
            TransducerModel::Constant => Self::Polynomial(0),
            TransducerModel::Linear => Self::Polynomial(1),
            TransducerModel::Quadratic => Self::Polynomial(2),
            TransducerModel::Axis => Self::Axis,
        }
    }
}

impl Declared {
    /// A session's row in the form that is fitted.
    fn form(self) -> fn(TransducerRow) -> ScalarRow {
        match self {
            Self::Polynomial(_) => |row| (&row).into(),
            Self::Axis => |row| ScalarRow::of_axis(&row),
        }
    }

    /// Rows of the points table.
    pub fn rows(self, rows: &[TransducerRow]) -> Vec<ScalarRow> {
        rows.iter().cloned().map(self.form()).collect()
    }

    /// Rows of the session's sealed table in this form, still sealed.
    pub fn sealed(self, rows: Sealed<TransducerRow>) -> Sealed<ScalarRow> {
        rows.convert(self.form())
    }

    /// A sentence about stimulus and response in the words of the session's kind: an axis has
    /// commanded and measured positions.
    pub fn format_text(self, sentence: &str) -> String {
        match self {
            Self::Polynomial(_) => sentence.to_owned(),
            Self::Axis => sentence
                .replace("stimuli", "commanded positions")
                .replace("stimulus", "commanded position")
                .replace("response", "measured position"),
        }
    }
}

/// Names by which the session calls things.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Names {
    /// Unit of the stimulus.
    pub stimulus: String,
    /// Unit of the response.
    pub response: String,
    /// The response is a deviation of the stimulus.
    pub deviation: bool,
    /// Standard uncertainty of the reference, in the unit of the stimulus.
    pub reference_sd: f64,
    /// Further covariates.
    pub covariates: Vec<String>,
}

/// Origins and spans by which covariates are normalised; taken from the fitted rows and kept for
/// prediction.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Scaling {
    /// Middle of the stimulus.
    pub mid: f64,
    /// Half of its range.
    pub half: f64,
    /// First time and duration, s.
    pub time: Option<[f64; 2]>,
    /// Mean temperature, deg C.
    pub temperature: Option<f64>,
    /// Middle and half range of each further covariate.
    pub covariates: Vec<[f64; 2]>,
    /// Readings of the points table, those that the search left out among them.
    pub count: usize,
    /// Share of the scatter of the stimulus within its settings that is its reading's alone (1 -
    /// reliability); 0 in a calibration: a new reading has no setting.
    #[serde(skip)]
    pub unreliability: f64,
    /// Places of an axis that were all read more than once, rising, as commanded: those of a table
    /// of errors.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub places: Vec<f64>,
    /// A full turn in the stimulus's unit, where the readings go around: its two ends are one
    /// place.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub turn: Option<f64>,
    /// Absolute zero in the stimulus's unit, where that is one of temperature.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub absolute_zero: Option<f64>,
    /// Where a count starts again, rising: between two places of the stimulus.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub wraps: Vec<f64>,
    /// Series that can each have a zero of their own.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub series: Vec<u32>,
}

/// Rows and normalised covariates, in the order of the measurement.
#[derive(Debug, Clone, PartialEq)]
pub struct Frame {
    /// Rows.
    pub rows: Vec<ScalarRow>,
    /// Normalisation.
    pub scaling: Scaling,
    /// Stimulus in half ranges from the middle, as read: the argument of the declared model.
    pub read_u: Vec<f64>,
    /// The same freed of the scatter of its reading: what effects follow.
    pub u: Vec<f64>,
    /// Number of the stimulus's setting, ascending.
    pub setting: Vec<usize>,
    /// Where stimulus 0 lies on that scale.
    pub zero_u: f64,
    /// Place in the order, first fitted row 0, last 1.
    pub order: Vec<f64>,
    /// Time in durations.
    pub time: Option<Vec<f64>>,
    /// Temperature less its mean, deg C.
    pub temperature: Option<Vec<f64>>,
    /// Direction, where both occur and the sequence is known.
    pub direction: Option<Vec<f64>>,
    /// Further covariates from -1 to 1; none where constant.
    pub covariates: Vec<Option<Vec<f64>>>,
    /// Declared model.
    pub declared: Declared,
    /// Group of each row.
    pub groups: Vec<u32>,
    /// The order of the rows is that of the measurement: time stamps say so, or nothing speaks
    /// against it.
    pub ordered: bool,
    /// The stimulus is the number of the reading, of a constant quantity: nothing was set, and the
    /// order alone can drive anything.
    pub counts_readings: bool,
    /// Rows that no fit sees: what needs enough readings to fit does not apply to them.
    pub new_rows: bool,
}

impl Scaling {
    /// Normalisation by the rows to be fitted.
    fn of(rows: &[ScalarRow]) -> Self {
        let [lo, hi] = range(rows.iter().map(|r| r.x));
        let time = all(rows, |r| r.t_s)
            .map(|t| range(t.into_iter()))
            .filter(|[a, b]| b > a);
        let temperature = all(rows, |r| r.temperature_degc).filter(|t| {
            let [a, b] = range(t.iter().copied());
            b > a
        });
        let count = rows.first().map_or(0, |r| r.covariates.len());
        let middle = |k: usize| {
            let [a, b] = range(rows.iter().map(|r| r.covariates[k]));
            [0.5 * (a + b), 0.5 * (b - a)]
        };
        let covariates = (0..count).map(middle).collect();
        Self {
            mid: 0.5 * (lo + hi),
            half: 0.5 * (hi - lo),
            time: time.map(|[a, b]| [a, b - a]),
            temperature: temperature.map(|t| t.iter().sum::<f64>() / t.len() as f64),
            covariates,
            count: rows.len(),
            unreliability: 0.0,
            places: Vec::new(),
            turn: None,
            absolute_zero: None,
            wraps: Vec::new(),
            series: series(rows),
        }
    }

    /// Normalisation of a session by the rows that the search takes of its `count`: with the scatter
    /// of the stimulus's reading where a response follows it, what the unit of the stimulus says of
    /// it, and where a count starts again; an axis is commanded to its places.
    pub fn of_session(rows: &[ScalarRow], declared: Declared, unit: &str, count: usize) -> Self {
        let [x, y] = [|r: &ScalarRow| r.x, |r: &ScalarRow| r.y]
            .map(|f| rows.iter().map(f).collect::<Vec<f64>>());
        let of = Self {
            count,
            ..Self::of(rows)
        };
        let Declared::Polynomial(degree) = declared else {
            let places = repeated_places(x);
            return Self { places, ..of };
        };
        let setting = settings(&x);
        let levels = setting.iter().max().map_or(0, |last| last + 1);
        Self {
            unreliability: if degree > 0 {
                // Slope within settings over that between them: scatter of the stimulus lowers it.
                1.0 - reliability(&setting, &x, &y)
            } else {
                0.0
            },
            turn: full_turn(unit, 2.0 * of.half, levels),
            absolute_zero: absolute_zero(unit),
            wraps: wraps(rows),
            ..of
        }
    }

    /// Half of the stimulus's range; 1 where it has none.
    pub(super) fn half_range(&self) -> f64 {
        if self.half > 0.0 { self.half } else { 1.0 }
    }
}

/// Places that were all read more than once, rising; none where one was not.
fn repeated_places(mut x: Vec<f64>) -> Vec<f64> {
    x.sort_by(f64::total_cmp);
    let all: Vec<&[f64]> = x.chunk_by(|a, b| a == b).collect();
    if all.len() > MAX_PLACES || all.iter().any(|level| level.len() < 2) {
        return Vec::new();
    }
    all.iter().map(|level| level[0]).collect()
}

/// A table of more places is a list of readings.
const MAX_PLACES: usize = 100;

/// Mean direction of a series that goes one way.
const ONE_WAY: f64 = 0.5;
/// Stimulus from which on a first reading is a loaded one, in half ranges.
const LOADED: f64 = 0.1;
impl Frame {
    /// Frame of `rows`, normalised by `scaling`; `new_rows`: for prediction alone, `y` unused.
    pub fn new(
        mut rows: Vec<ScalarRow>,
        scaling: &Scaling,
        declared: Declared,
        new_rows: bool,
    ) -> Self {
        let timed = rows.iter().all(|r| r.t_s.is_some());
        if timed {
            rows.sort_by(|a, b| {
                a.t_s
                    .unwrap_or_default()
                    .total_cmp(&b.t_s.unwrap_or_default())
            });
        }
        let half = scaling.half_range();
        let x: Vec<f64> = rows.iter().map(|r| r.x).collect();
        let setting = settings(&x);
        let mean = means(&setting, &x);
        // Of all readings of the session, so that a thinned table keeps its places in the order.
        let span = scaling.count.max(2) as f64 - 1.0;
        let covariate = |(k, [mid, half]): (usize, &[f64; 2])| {
            let values = rows.iter().map(|r| (r.covariates[k] - mid) / half);
            (*half > 0.0).then(|| values.collect())
        };
        let covariates = scaling.covariates.iter().enumerate();
        let covariates = covariates.map(covariate).collect();
        Self {
            read_u: x.iter().map(|x| (x - scaling.mid) / half).collect(),
            // Errors in variables: mean + lambda (x - mean) with lambda = 1 - unreliability.
            u: x.iter()
                .zip(&setting)
                .map(|(x, &k)| (x - scaling.unreliability * (x - mean[k]) - scaling.mid) / half)
                .collect(),
            zero_u: -scaling.mid / half,
            order: rows
                .iter()
                .enumerate()
                .map(|(k, r)| r.place.unwrap_or(k) as f64 / span)
                .collect(),
            time: scaling.time.filter(|_| timed).map(|[first, duration]| {
                rows.iter()
                    .map(|r| (r.t_s.unwrap_or(first) - first) / duration)
                    .collect()
            }),
            temperature: scaling
                .temperature
                .and_then(|mean| all(&rows, |r| r.temperature_degc.map(|t| t - mean))),
            direction: directions(&rows, &setting, if new_rows { 0 } else { MIN_REPEATS }),
            covariates,
            counts_readings: declared == Declared::Polynomial(0)
                && x.windows(2).all(|p| p[1] == p[0] + 1.0),
            declared,
            groups: groups(&rows),
            ordered: timed || !sorted_with_repetitions(&setting),
            setting,
            new_rows,
            scaling: scaling.clone(),
            rows,
        }
    }

    /// Places of a table of errors in half ranges.
    pub fn places(&self) -> Vec<f64> {
        let (mid, half) = (self.scaling.mid, self.scaling.half_range());
        let places = self.scaling.places.iter();
        places.map(|x| (x - mid) / half).collect()
    }

    /// The declared model has a term in the stimulus, so an effect may act on the stimulus.
    pub(crate) fn sloped(&self) -> bool {
        self.declared != Declared::Polynomial(0)
    }

    /// The stimulus goes around once: its ends are one place, and nothing bends along it.
    pub(crate) fn cyclic(&self) -> bool {
        // A hair more than a turn is one, too.
        self.scaling
            .turn
            .is_some_and(|turn| 2.0 * self.scaling.half < 1.001 * turn)
    }

    /// The stimulus only rises, or only falls, from reading to reading: the clock and the stimulus
    /// are one line, and what follows one follows the other.
    pub(crate) fn swept_once(&self) -> bool {
        let steps = || self.u.windows(2).map(|p| p[1] - p[0]);
        !self.counts_readings
            && self.u.len() > 2
            && (steps().all(|d| d > 0.0) || steps().all(|d| d < 0.0))
    }

    /// Each series goes one way, and both ways occur.
    pub(crate) fn strokes_are_series(&self) -> bool {
        let Some(direction) = &self.direction else {
            return false;
        };
        let mean_way = |s: &u32| {
            let own = direction.iter().zip(&self.groups).filter(|(_, g)| *g == s);
            let own: Vec<f64> = own.map(|(d, _)| *d).collect();
            own.iter().sum::<f64>() / own.len().max(1) as f64
        };
        let ways: Vec<f64> = self.scaling.series.iter().map(mean_way).collect();
        // The reading at the turn may count for the stroke before.
        ways.iter().all(|w| w.abs() > ONE_WAY) && ways.windows(2).any(|w| w[0] * w[1] < 0.0)
    }

    /// The directions, times `before` until the stimulus first moves: of new rows they are what
    /// they say.
    pub(crate) fn direction_begun(&self, before: f64) -> Option<Vec<f64>> {
        let mut direction = self.direction.clone()?;
        let still = self.setting.iter().map(|s| *s == self.setting[0]);
        let still = direction.iter_mut().zip(still).take_while(|d| d.1);
        if !self.new_rows {
            still.for_each(|(d, _)| *d *= before);
        }
        Some(direction)
    }

    /// Settings enough were read on either way: a loop is a difference at equal stimuli.
    pub(crate) fn read_both_ways(&self) -> bool {
        let Some(direction) = &self.direction else {
            return false;
        };
        let of = |way: f64| -> BTreeSet<usize> {
            let settings = self.setting.iter().zip(direction);
            let settings = settings.filter(|(_, d)| *d * way > 0.0);
            settings.map(|(s, _)| *s).collect()
        };
        of(1.0).intersection(&of(-1.0)).count() >= MIN_REPEATS
    }

    /// The first reading is a loaded one.
    pub(crate) fn begins_loaded(&self) -> bool {
        self.u
            .first()
            .is_some_and(|u| (u - self.zero_u).abs() > LOADED)
    }

    /// Settings of the stimulus.
    pub fn levels(&self) -> usize {
        self.setting.iter().max().map_or(0, |m| m + 1)
    }

    /// Time where it is known, else the order.
    pub fn clock(&self) -> &[f64] {
        self.time.as_deref().unwrap_or(&self.order)
    }
}

/// Correlation of two covariates.
pub(super) fn correlation(a: &[f64], b: &[f64]) -> f64 {
    let [a, b] = [a, b].map(|v| {
        // Cosine of what is left of both without their means.
        let v = DVector::from_column_slice(v);
        v.add_scalar(-v.mean())
    });
    cosine(&a, &b)
}
