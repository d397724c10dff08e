//! Residuals between and within cells: readings that are equal in every input (stimulus, direction) make a cell.
//!
//! ```text
//! S = S_between + S_within,   S_within = |(I - P_[M, D]) y|^2        M: model's columns and tangents, D: one column a cell
//! ```
//!
//! What is a function of the cell repeats with the protocol, and laws over time, order or stimulus can all take it. So each has to earn its
//! gain where it says something of its own (two-stratum analysis of variance; Fisher, "Design of Experiments", ch. IV):
//! a law over time or order within cells, beside their pure error; a law of the stimulus between cells, beside what it leaves among them.
//! And a name is none that rests on one level or one cycle: what a single place shows is a matter of that place.

use super::floor::{level_keys, protocol_keys, replicate_keys};
use super::frame::ScalarRow;
use super::system::ScalarSystem;
use crate::effect::{EffectTerm, LawRequirement};
use crate::levels::{BETWEEN_STRATA, WITHIN_STRATA};
use crate::measurement_model::MeasurementModel;
use crate::method::admissible::REFIT_STEPS;
use crate::method::deletion_diagnostics::influential_set;
use crate::method::distributions::f_tail;
use crate::method::fit::{Fit, Weights, fit};
use crate::method::hypothesis::{Hypothesis, NotIdentified};
use crate::method::linear::Basis;
use crate::method::min_p::{f_test, signature_p};
use crate::method::search_result::SearchResult;
use crate::method::signature::Signature;
use nalgebra::{DMatrix, DVector};

/// Repeats from which cells say something of a law.
const MIN_PURE_DOF: usize = 5;
/// Level at which a plainer effect is contradicted.
const CONTRADICTED: f64 = 1e-3;

/// A sum of squares with its degrees of freedom.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Part {
    /// Sum of squares.
    pub ss: f64,
    /// Degrees of freedom.
    pub dof: f64,
}

/// What a fit leaves, between cells and within.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Split {
    /// Between cells.
    pub between: Part,
    /// Within cells.
    pub within: Part,
}

/// Rows that count, by cell.
fn members(cells: &[u64], weights: &[f64]) -> Vec<Vec<usize>> {
    let mut rows: Vec<usize> = (0..cells.len()).filter(|&i| weights[i] > 0.0).collect();
    rows.sort_by_key(|&i| cells[i]);
    rows.chunk_by(|&a, &b| cells[a] == cells[b]).map(<[usize]>::to_vec).collect()
}

/// `values` weighted, less the weighted mean of each cell where `within`.
fn weighted(values: &[f64], weights: &[f64], cells: &[Vec<usize>], within: bool) -> DVector<f64> {
    let mut out = DVector::from_fn(values.len(), |i, _| weights[i] * values[i]);
    for cell in cells.iter().filter(|_| within) {
        let square: f64 = cell.iter().map(|&i| weights[i].powi(2)).sum();
        let mean = cell.iter().map(|&i| weights[i].powi(2) * values[i]).sum::<f64>() / square;
        cell.iter().for_each(|&i| out[i] -= weights[i] * mean);
    }
    out
}

/// Share within cells, in that of the stimulus, below which a column is one of the cell alone: thirty waves over the range change 54 times as much.
const OF_STIMULUS: f64 = 100.0;

/// Splits what `fit` leaves; readings independent but for their relative spread. Of a stimulus `x` that is read with scatter within cells, what
/// follows it says nothing there.
pub fn split(fit: &Fit, weights: &Weights, cells: &[u64], x: &[f64]) -> Split {
    let w = weights.relative();
    let cells = members(cells, w);
    let norms = |column: &[f64]| [true, false].map(|within| weighted(column, w, &cells, within).norm());
    let [scatter, size] = norms(x);
    let negligible = OF_STIMULUS * scatter / size.max(1e-300);
    let of = |within: bool| {
        let mut basis = Basis::default();
        let tangents = fit.raw_tangents.iter().map(|t| t.column(0).clone_owned());
        for column in fit.raw_design.column_iter().map(|c| c.clone_owned()).chain(tangents) {
            let [inside, whole] = norms(column.as_slice());
            if !within || inside > negligible * whole {
                basis.push_beside(&weighted(column.as_slice(), w, &cells, within), whole);
            }
        }
        let left = weighted(fit.raw_residual.column(0).clone_owned().as_slice(), w, &cells, within);
        (basis.project_off(&left).norm_squared(), basis.rank() as f64)
    };
    let readings = cells.iter().map(Vec::len).sum::<usize>() as f64;
    let ((whole, rank), (inside, rank_inside)) = (of(false), of(true));
    let within = Part { ss: inside, dof: readings - cells.len() as f64 - rank_inside };
    let between = Part { ss: (whole - inside).max(0.0), dof: readings - rank - within.dof };
    Split { between, within }
}

/// p-value of a fall from `without` to `with` beside what is left; 1 where nothing is gained or nothing left to compare with.
fn extra_sum_of_squares_p(without: Part, with: Part) -> f64 {
    let (gain, extra) = (without.ss - with.ss, without.dof - with.dof);
    if extra < 0.5 || with.dof < 0.5 || gain <= 0.0 {
        return 1.0;
    }
    let f = gain / extra / (with.ss / with.dof).max(1e-300);
    f_tail(f, [extra, with.dof]).unwrap_or(1.0)
}

/// Cells hold repeats enough to say something.
fn repeated(cells: &[u64], weights: &[f64]) -> bool {
    let counted = members(cells, weights);
    counted.iter().map(Vec::len).sum::<usize>() >= counted.len() + MIN_PURE_DOF
}

/// Why a law over the clock is none.
const REPEATS: &str = "not observable: the protocol repeats with it";
/// Why a law of the stimulus is none.
const AS_A_TABLE: &str = "a table of as many places would explain as much";

/// Cells in which repeats tell a law from what belongs to places.
struct Strata {
    /// Equal stimulus and direction.
    cells: Vec<u64>,
    /// Equal stimulus and way of the protocol.
    protocol: Vec<u64>,
}

impl Strata {
    /// A term gains where it says something of its own: within cells, or for a law of the stimulus between them.
    fn explains_between_strata(&self, fits: [&Fit; 2], weights: &Weights, by_clock: bool, x: &[f64]) -> bool {
        let cells = if by_clock { &self.protocol } else { &self.cells };
        let [with, without] = fits.map(|fit| split(fit, weights, cells, x));
        extra_sum_of_squares_p(without.within, with.within) < WITHIN_STRATA
            || (!by_clock && extra_sum_of_squares_p(without.between, with.between) < BETWEEN_STRATA)
    }
}

impl ScalarSystem {
    /// A law over time or over the order of the readings: it says nothing of a cell, and everything of when its readings were taken.
    fn runs_with_the_clock(&self, term: &EffectTerm) -> bool {
        let effect = &self.catalogue()[term.effect];
        let law = effect.law(term.law);
        // Laws with memory of the stimulus need the time, but follow the protocol; the settling of an earlier load does not.
        let by_stimulus = effect.has_memory && law.name != "settling";
        !by_stimulus
            && law
                .needs
                .iter()
                .any(|n| matches!(n, LawRequirement::Clock | LawRequirement::Order | LawRequirement::Time))
    }

    /// The law depends on the stimulus of earlier times (lag, creep).
    fn remembers_in_time(&self, term: &EffectTerm) -> bool {
        let effect = &self.catalogue()[term.effect];
        let by_time = |n: &LawRequirement| matches!(n, LawRequirement::Clock | LawRequirement::Time);
        effect.has_memory && effect.law(term.law).needs.iter().any(by_time)
    }

    /// The first term of `h` that this design does not identify: it gains nothing where it says something of its own, or it rests on one
    /// level or one cycle.
    pub fn unidentified_term(&self, h: &Hypothesis) -> Option<NotIdentified> {
        let strata = self.strata(h);
        let cycles = self.cycles(&h.weights);
        (0..h.fit.terms.len()).find_map(|k| {
            let (term, without) = (&h.fit.terms[k], h.without(self, |j, _| j == k)?.fit);
            let terms: Vec<EffectTerm> = h.fit.terms.iter().filter(|t| *t != term).cloned().collect();
            let by_clock = self.runs_with_the_clock(term);
            let why = |why: String| Some(NotIdentified { effect: term.effect, why });
            if let Some(plainer) = self.not_told_from(&terms, term, h) {
                return why(format!("on this range it cannot be distinguished from {plainer}"));
            }
            if !term.values.is_empty() && self.spans_too_few_periods(&terms, term, h) {
                return why("a bend of fewer periods describes the readings as well".to_owned());
            }
            if let Some(strata) = &strata
                && !strata.explains_between_strata(
                    [&h.fit, &without],
                    &h.weights,
                    by_clock,
                    &self.frame.read_u,
                )
            {
                return why(if by_clock { REPEATS } else { AS_A_TABLE }.to_owned());
            }
            let (levels, value) = self.levels(term, &h.weights);
            if let Some(level) = influential_set(&h.fit, &without, &levels) {
                return why(format!("it rests on one level ({})", value(&self.frame.rows[levels[level][0]])));
            }
            // A cycle is a stretch of the clock: a law over the clock may live in one.
            let cycle = influential_set(&h.fit, &without, &cycles).filter(|_| !by_clock)?;
            why(format!("it rests on one cycle ({})", self.frame.groups[cycles[cycle][0]]))
        })
    }

    /// The plainer effect that `term` looks like, where that one in its place is not contradicted: both together explain no more than it alone,
    /// or more than `term` alone.
    fn not_told_from(
        &self,
        others: &[EffectTerm],
        term: &EffectTerm,
        h: &Hypothesis,
    ) -> Option<&'static str> {
        let law = self.catalogue()[term.effect].law(term.law);
        let plainer = (self.effects[term.effect].looks_like)(law, &self.frame)?;
        let effect = self.catalogue().iter().position(|e| e.id == plainer)?;
        let plain = EffectTerm { effect, law: 0, values: Vec::new() };
        let with = |more: &[&EffectTerm]| {
            let terms: Vec<EffectTerm> = others.iter().chain(more.iter().copied()).cloned().collect();
            fit(self, &terms, &h.weights, REFIT_STEPS)
        };
        let (alone, both) = (with(&[&plain])?, with(&[&plain, term])?);
        let gain = |from: &Fit| f_test(from.ssr - both.ssr, from.ssr, from.dof, 1);
        (gain(&alone) > CONTRADICTED || gain(&h.fit) < CONTRADICTED).then_some(plainer)
    }

    /// A shape that is none of the effect describes the readings as well (Akaike, two parameters) in place of `term`, by any of its laws: stimuli in steps of a fixed
    /// number of places make of a slow bend over time a fast wave over the stimulus.
    fn spans_too_few_periods(&self, others: &[EffectTerm], term: &EffectTerm, h: &Hypothesis) -> bool {
        let effect = &self.effects[term.effect];
        let shaped = |law: usize| effect.effect.laws[law].parameters.len() == 1;
        let better = |law: usize, shape: f64| {
            let other = EffectTerm { effect: term.effect, law, values: vec![shape] };
            let terms: Vec<EffectTerm> = others.iter().cloned().chain([other]).collect();
            fit(self, &terms, &h.weights, 0).is_some_and(|f| f.ssr < h.fit.ssr + 4.0 * h.fit.variance())
        };
        effect
            .spans_too_few_periods
            .iter()
            .any(|shape| (0..effect.effect.laws.len()).any(|law| shaped(law) && better(law, *shape)))
    }

    /// Strata of the design; none where no cell is repeated.
    fn strata(&self, h: &Hypothesis) -> Option<Strata> {
        let cells = replicate_keys(&self.frame);
        // With a memory in time the readings of a cell differ in their past, too: they are no repeats.
        let remembers = h.fit.terms.iter().any(|t| self.remembers_in_time(t));
        if remembers || !repeated(&cells, h.weights.relative()) {
            return None;
        }
        // A law of the clock that follows stimulus and way repeats with the protocol, whether the way has a column or not.
        let protocol = protocol_keys(&self.frame);
        let protocol = if repeated(&protocol, h.weights.relative()) { protocol } else { cells.clone() };
        Some(Strata { cells, protocol })
    }

    /// Rows that count, by the settings of what drives `term`: a further column, else the stimulus; and its value in a row.
    fn levels(&self, term: &EffectTerm, weights: &Weights) -> (Vec<Vec<usize>>, impl Fn(&ScalarRow) -> f64) {
        let column = self.catalogue()[term.effect].by_column.then_some(term.law);
        let rows = members(&level_keys(&self.frame, column), weights.relative());
        (rows, move |row: &ScalarRow| column.and_then(|k| row.covariates.get(k).copied()).unwrap_or(row.x))
    }

    /// Rows that count, by cycle; empty below four: without one of three a law loses a third of its readings.
    fn cycles(&self, weights: &Weights) -> Vec<Vec<usize>> {
        const MIN_CYCLES: usize = 4;
        let keys: Vec<u64> = self.frame.groups.iter().map(|g| u64::from(*g)).collect();
        let cycles = members(&keys, weights.relative());
        if cycles.len() < MIN_CYCLES { Vec::new() } else { cycles }
    }

    /// What the omnibus test still sees is a law of the clock alone, which the search did not take because cells do not bear it out.
    pub fn is_time_confounded(&self, found: &SearchResult) -> bool {
        let (best, test) = (&found.best, &found.last_test);
        if test.generic() || !repeated(&protocol_keys(&self.frame), best.weights.relative()) {
            return false;
        }
        let left = best.fit.stacked();
        let p = |s: &Signature| signature_p(s, s.gain(&left), best.fit.ssr, best.fit.dof);
        let strongest = test.signatures.iter().min_by(|a, b| p(a).total_cmp(&p(b)));
        strongest.is_some_and(|s| self.runs_with_the_clock(&s.term))
    }

    /// What `columns` explain of what `h` leaves says nothing within cells: it repeats with the protocol.
    pub fn is_block_effect(&self, h: &Hypothesis, columns: &[Vec<f64>]) -> bool {
        let cells = protocol_keys(&self.frame);
        if !repeated(&cells, h.weights.relative()) {
            return false;
        }
        let n = cells.len();
        let old = &h.fit.raw_design;
        let added = DMatrix::from_fn(n, old.ncols() + columns.len(), |i, j| {
            if j < old.ncols() { old[(i, j)] } else { columns[j - old.ncols()][i] }
        });
        let richer = Fit { raw_design: added, ..h.fit.clone() };
        extra_sum_of_squares_p(
            split(&h.fit, &h.weights, &cells, &self.frame.read_u).within,
            split(&richer, &h.weights, &cells, &self.frame.read_u).within,
        ) >= WITHIN_STRATA
    }
}
