//! Names that the design identifies: readings that are equal in every input (stimulus, direction)
//! make a cell, and residuals are split between and within cells (`method::lack_of_fit`).
//!
//! What is a function of the cell repeats with the protocol, and laws over time, order or stimulus
//! can all take it. So each has to earn its gain where it says something by itself (two-stratum
//! analysis of variance; Fisher, "Design of Experiments", ch. IV): a law over time or order within
//! cells, beside their pure error; a law of the stimulus between cells, beside what it leaves among
//! them. And a name is none that rests on one level or one cycle: what a single place shows is a
//! matter of that place.

use super::floor::{level_keys, protocol_keys, replicate_keys};
use super::frame::ScalarRow;
use super::system::ScalarSystem;
use crate::effect::{EffectTerm, LawRequirement};
use crate::levels::{BETWEEN_STRATA, NEGLIGIBLE, WITHIN_STRATA};
use crate::measurement_model::{DesignTest, MeasurementModel};
use crate::method::{
    Fit, Hypothesis, NotIdentified, Part, REFIT_STEPS, SearchResult, Weights,
    extra_sum_of_squares_p, f_test, fit, influential_set, members, split, split_of, strongest,
};
use nalgebra::DVector;

/// Repeats from which cells say something of a law.
const MIN_PURE_DOF: usize = 5;
/// A load below this share of the largest one is none.
const UNLOADED: f64 = 0.05;

/// Cells hold repeats enough to say something.
fn repeated(cells: &[u64], weights: &[f64]) -> bool {
    let counted = members(cells, weights);
    counted.iter().map(Vec::len).sum::<usize>() >= counted.len() + MIN_PURE_DOF
}

/// Why a law over the clock is none.
const REPEATS: &str = "not observable: the protocol repeats with it";
/// Why a law of the clock, or of the way of the stimulus, is none.
const IN_STEPS: &str = "the stimulus moved while it was recorded in steps, which explains as much";
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
    /// Cells of a law over the clock, or of another one.
    fn of(&self, by_clock: bool) -> &[u64] {
        if by_clock {
            &self.protocol
        } else {
            &self.cells
        }
    }

    /// A term gains where it says something by itself: within cells, or for a law of the stimulus
    /// between them.
    fn explains_between_strata(
        &self,
        fits: [&Fit; 2],
        weights: &Weights,
        by_clock: bool,
        x: &[f64],
    ) -> bool {
        let [with, without] = fits.map(|fit| split(fit, weights, self.of(by_clock), x));
        // What a term says in both strata costs each its parameters: a loop from rest differs
        // within cells by its first reading alone.
        let between = Part {
            dof: with.between.dof - (without.within.dof - with.within.dof),
            ..with.between
        };
        extra_sum_of_squares_p(without.within, with.within).is_some_and(|p| p < WITHIN_STRATA)
            || (!by_clock
                && extra_sum_of_squares_p(without.between, between)
                    .is_some_and(|p| p < BETWEEN_STRATA))
    }
}

fn of_time(need: &LawRequirement) -> bool {
    matches!(need, LawRequirement::Clock | LawRequirement::Time)
}

impl ScalarSystem {
    /// A law over time or over the order of the readings: it says nothing of a cell, and everything
    /// of when its readings were taken.
    fn runs_with_the_clock(&self, term: &EffectTerm) -> bool {
        let effect = &self.catalogue()[term.effect];
        let law = effect.law(term.law);
        // Laws with memory of the stimulus need the time, but follow the protocol; the settling of
        // an earlier load does not.
        let by_stimulus = effect.has_memory && law.name != "settling";
        let by_clock = |n: &LawRequirement| *n == LawRequirement::Order || of_time(n);
        !by_stimulus && law.needs.iter().any(by_clock)
    }

    /// The law depends on the stimulus of earlier times (lag, creep).
    fn remembers_in_time(&self, term: &EffectTerm) -> bool {
        let effect = &self.catalogue()[term.effect];
        effect.has_memory && effect.law(term.law).needs.iter().any(of_time)
    }

    /// The tests of [`Strata::explains_between_strata`], of a term's signature.
    pub(crate) fn strata_tests(
        &self,
        h: &Hypothesis,
        term: &EffectTerm,
        signature: &DVector<f64>,
    ) -> Vec<DesignTest> {
        let by_clock = self.runs_with_the_clock(term);
        let Some(strata) = self.strata(h) else {
            return Vec::new();
        };
        let cells = strata.of(by_clock);
        let (values, x) = (signature.as_slice(), &self.frame.read_u);
        let parts = split_of(values, &h.fit, &h.weights, cells, x);
        // One more column takes one degree of freedom of what is left.
        let test = |part: Part, level| DesignTest {
            level,
            norm: part.ss.sqrt(),
            dof: part.dof - 1.0,
        };
        let within = test(parts.within, WITHIN_STRATA);
        let between = (!by_clock).then(|| test(parts.between, BETWEEN_STRATA));
        [within].into_iter().chain(between).collect()
    }

    /// The first term of `h` that this design does not identify: it gains nothing where it says
    /// something by itself, or it rests on one level or one cycle.
    pub(crate) fn unidentified_term(&self, h: &Hypothesis) -> Option<NotIdentified> {
        let strata = self.strata(h);
        let cycles = self.cycles(&h.weights);
        (0..h.fit.terms.len()).find_map(|k| {
            let (term, without) = (&h.fit.terms[k], h.without(self, |j, _| j == k)?);
            let terms: Vec<EffectTerm> =
                h.fit.terms.iter().filter(|t| *t != term).cloned().collect();
            let by_clock = self.runs_with_the_clock(term);
            let why = |why: String| {
                Some(NotIdentified {
                    effect: term.effect,
                    why,
                })
            };
            if (by_clock || self.catalogue()[term.effect].has_memory)
                && self.smooths_steps(h, &without)
            {
                return why(IN_STEPS.to_owned());
            }
            let without = without.fit;
            if let Some(plainer) = self.not_told_from(&terms, term, h) {
                return why(format!(
                    "on this range it cannot be distinguished from {plainer}"
                ));
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
            let (levels, value) = self.driving_levels(term, &h.weights);
            let rests_on = |sets: &[Vec<usize>]| {
                let set = influential_set(&h.fit, &without, sets)?;
                Some(sets[set][0])
            };
            let one_is_enough = self.effects[term.effect].shows_on_one_level;
            if let Some(row) = rests_on(&levels).filter(|_| !one_is_enough) {
                let level = value(&self.frame.rows[row]);
                return why(format!("it rests on one level ({level})"));
            }
            // A cycle is a stretch of the clock: a law over the clock may live in one.
            let row = rests_on(&cycles).filter(|_| !by_clock)?;
            let cycle = self.frame.groups[row];
            why(format!("it rests on one cycle ({cycle})"))
        })
    }

    /// The plainer effect that `term` looks like, where that one in its place is not contradicted:
    /// both together explain no more than it alone, or more than `term` alone.
    fn not_told_from(
        &self,
        others: &[EffectTerm],
        term: &EffectTerm,
        h: &Hypothesis,
    ) -> Option<&'static str> {
        let law = self.catalogue()[term.effect].law(term.law);
        let plainer = (self.effects[term.effect].looks_like)(law, &self.frame)?;
        let effect = self.catalogue().iter().position(|e| e.id == plainer)?;
        let plain = EffectTerm {
            effect,
            law: 0,
            values: Vec::new(),
        };
        let with = |more: &[&EffectTerm]| {
            let terms: Vec<EffectTerm> =
                others.iter().chain(more.iter().copied()).cloned().collect();
            fit(self, &terms, &h.weights, REFIT_STEPS)
        };
        let (alone, both) = (with(&[&plain])?, with(&[&plain, term])?);
        // F test of the one column that both have more.
        let gains = |from: &Fit| {
            f_test(from.ssr - both.ssr, from.ssr, from.dof, 1).is_some_and(|p| p < NEGLIGIBLE)
        };
        (!gains(&alone) || gains(&h.fit)).then_some(plainer)
    }

    /// A shape that is none of the effect describes the readings as well (Akaike, two parameters)
    /// in place of `term`, by any of its laws: stimuli in steps of a fixed number of places make of
    /// a slow bend over time a fast wave over the stimulus.
    fn spans_too_few_periods(
        &self,
        others: &[EffectTerm],
        term: &EffectTerm,
        h: &Hypothesis,
    ) -> bool {
        let effect = &self.effects[term.effect];
        let shaped = |law: usize| effect.effect.laws[law].parameters.len() == 1;
        let better = |law: usize, shape: f64| {
            let other = EffectTerm {
                effect: term.effect,
                law,
                values: vec![shape],
            };
            let terms: Vec<EffectTerm> = others.iter().cloned().chain([other]).collect();
            fit(self, &terms, &h.weights, 0)
                // Akaike: two parameters are worth 4 in -2 log L, here squares over s^2.
                .is_some_and(|f| f.ssr < h.fit.ssr + 4.0 * h.fit.variance())
        };
        effect.spans_too_few_periods.iter().any(|shape| {
            (0..effect.effect.laws.len()).any(|law| shaped(law) && better(law, *shape))
        })
    }

    /// Strata of the design; none where no cell is repeated.
    fn strata(&self, h: &Hypothesis) -> Option<Strata> {
        let cells = replicate_keys(&self.frame);
        // With a memory in time the readings of a cell differ in their past, too: they are no
        // repeats.
        let remembers = h.fit.terms.iter().any(|t| self.remembers_in_time(t));
        if remembers || !repeated(&cells, h.weights.relative()) {
            return None;
        }
        // A law of the clock that follows stimulus and way repeats with the protocol, whether the
        // way has a column or not.
        let protocol = protocol_keys(&self.frame);
        let protocol = if repeated(&protocol, h.weights.relative()) {
            protocol
        } else {
            cells.clone()
        };
        Some(Strata { cells, protocol })
    }

    /// Rows that count, by the settings of what drives `term`: a further column, else the stimulus;
    /// and its value in a row. A load that is not there drives nothing: most rows of an axis that
    /// is loaded by itself are none of its levels. Empty below two, without one of which the design
    /// says nothing of the term.
    fn driving_levels(
        &self,
        term: &EffectTerm,
        weights: &Weights,
    ) -> (Vec<Vec<usize>>, impl Fn(&ScalarRow) -> f64) {
        let column = self.catalogue()[term.effect].by_column.then_some(term.law);
        let value = move |row: &ScalarRow| {
            column
                .and_then(|k| row.covariates.get(k).copied())
                .unwrap_or(row.x)
        };
        let size = |i: &usize| value(&self.frame.rows[*i]).abs();
        let mut rows = members(&level_keys(&self.frame, column), weights.relative());
        let least = UNLOADED * rows.iter().map(|r| size(&r[0])).fold(0.0, f64::max);
        rows.retain(|level| column.is_none() || level.iter().any(|i| size(i) > least));
        if rows.len() < 2 {
            rows.clear();
        }
        (rows, value)
    }

    /// Rows that count, by cycle; empty below four: without one of three a law loses a third of its
    /// readings.
    fn cycles(&self, weights: &Weights) -> Vec<Vec<usize>> {
        const MIN_CYCLES: usize = 4;
        let keys: Vec<u64> = self.frame.groups.iter().map(|g| u64::from(*g)).collect();
        let cycles = members(&keys, weights.relative());
        Some(cycles)
            .filter(|cycles| cycles.len() >= MIN_CYCLES)
            .unwrap_or_default()
    }

    /// What the omnibus test still sees is a law of the clock alone, which the search did not take
    /// because cells do not bear it out.
    pub(crate) fn is_time_confounded(&self, found: &SearchResult) -> bool {
        let (best, test) = (&found.best, &found.last_test);
        if test.generic() || !repeated(&protocol_keys(&self.frame), best.weights.relative()) {
            return false;
        }
        let left = best.fit.stacked();
        let strongest = strongest(test.signatures.iter(), &left, &best.fit);
        strongest.is_some_and(|(_, s)| self.runs_with_the_clock(&s.term))
    }

    /// What `columns` explain of what `h` leaves says nothing within cells: it repeats with the
    /// protocol.
    pub(crate) fn is_block_effect(&self, h: &Hypothesis, columns: &[Vec<f64>]) -> bool {
        let cells = protocol_keys(&self.frame);
        if !repeated(&cells, h.weights.relative()) {
            return false;
        }
        let own = h.fit.raw_design.ncols();
        let mut richer = h.fit.clone();
        richer.raw_design = richer
            .raw_design
            .resize_horizontally(own + columns.len(), 0.0);
        for (k, column) in columns.iter().enumerate() {
            richer
                .raw_design
                .column_mut(own + k)
                .copy_from_slice(column);
        }
        let [plain, rich] =
            [&h.fit, &richer].map(|fit| split(fit, &h.weights, &cells, &self.frame.read_u).within);
        // Within cells the protocol repeats: only what differs there is more than the protocol.
        extra_sum_of_squares_p(plain, rich).is_none_or(|p| p >= WITHIN_STRATA)
    }
}
