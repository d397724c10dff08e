//! The scores beside their goals, with Clopper-Pearson bounds. A goal is met where the whole 95 %
//! interval lies on its side, missed where none of it does, and open else: one session of one meets
//! nothing.

use serde::Serialize;

pub use crate::goal::{Goal, clopper_pearson};
use crate::goal::{Side, number, quantile_of, rate, share};
use crate::pictures::picture_goals;
use crate::score::{FollowUp, Kind, Outcome, Part};
use wcal_plant::Design;
use wcal_plant::case::Make;
use wcal_plant::noise::Noise;
use wcal_plant::scalar::ScalarNoise;

/// Alternatives of all ambiguous answers together over those that the data allow; nothing where no
/// rivals were computed.
fn set_over_allowed(ambiguous: &[&Outcome]) -> Vec<f64> {
    let counted: Vec<(usize, usize)> = ambiguous
        .iter()
        .filter_map(|o| Some((o.set_size, o.allowed?)))
        .collect();
    let (listed, allowed) = counted.iter().fold((0, 0), |(a, b), (l, k)| (a + l, b + k));
    if allowed == 0 {
        Vec::new()
    } else {
        vec![listed as f64 / allowed as f64]
    }
}

/// White normal noise in the layouts of the practice sessions, on their wire.
fn practice_like(o: &Outcome) -> bool {
    o.noise == Noise::Gaussian.name()
        && o.wire == Some(Make::Usual)
        && matches!(o.design, Some(Design::Rich | Design::Paper))
}

/// The table of goals for a set of outcomes: first those of sessions like the practice sessions,
/// then those of every kind of noise, then what holds for all.
pub fn summarise(outcomes: &[Outcome]) -> Vec<Goal> {
    let (looked, outcomes): (Vec<&Outcome>, Vec<&Outcome>) =
        outcomes.iter().partition(|o| o.pictures.is_some());
    let outcomes: Vec<Outcome> = outcomes.into_iter().cloned().collect();
    let outcomes = outcomes.as_slice();
    let practice: Vec<Outcome> = outcomes
        .iter()
        .filter(|o| practice_like(o))
        .cloned()
        .collect();
    let mut out = practice_goals(&practice);
    out.extend(noise_goals(outcomes));
    let seconds = |d: &[Design]| {
        let of = outcomes
            .iter()
            .filter(|o| o.design.is_some_and(|o| d.contains(&o)));
        of.map(|o| o.seconds).collect::<Vec<_>>()
    };
    let all: Vec<&Outcome> = outcomes.iter().chain(looked.iter().copied()).collect();
    let long = [
        Design::Rich,
        Design::Repeats,
        Design::Shuffled,
        Design::Staircase,
    ];
    out.extend(picture_goals(&looked));
    out.push(share(
        "crashes",
        "none of these",
        &all,
        |o| o.kind == Kind::Crash,
        Side::NoneOfThem,
    ));
    out.push(number(
        "slowest paper session, s",
        "<= 10",
        seconds(&[Design::Paper]),
        1.0,
        10.0,
    ));
    out.push(number(
        "slowest session of about 360 rows, s",
        "<= 60",
        seconds(&long),
        1.0,
        60.0,
    ));
    out
}

/// An effect that was not put in is among those named, also beside "unknown effect", or several are
/// offered.
fn names_something(o: &Outcome) -> bool {
    o.kind != Kind::Right && (o.extra > 0 || o.verdict == "ambiguous")
}

fn refused(o: &Outcome) -> bool {
    matches!(o.verdict.as_str(), "refused" | "twin-fault")
}

fn part_of<'a>(of: &[&'a Outcome], name: &str) -> Vec<&'a Part> {
    of.iter()
        .flat_map(|o| &o.parts)
        .filter(|p| p.name == name)
        .collect()
}

/// Factor within which a part of the noise counts as stated right.
const PART_FACTOR: f64 = 1.3;

/// Goals over all kinds of noise.
fn noise_goals(outcomes: &[Outcome]) -> Vec<Goal> {
    let honest =
        |o: &Outcome| o.label != "adversarial" && o.label != "unknown" && o.label != "pair";
    let pick = |f: &dyn Fn(&Outcome) -> bool| {
        outcomes
            .iter()
            .filter(|o| honest(o) && f(o))
            .collect::<Vec<_>>()
    };
    let whisker = |o: &Outcome| o.design.is_some();
    let nulls = pick(&|o| whisker(o) && o.label == "null");
    let singles = pick(&|o| {
        whisker(o) && o.design != Some(Design::Paper) && o.label != "null" && o.delta >= 0.97 * 8.0
    });
    let lines = pick(&|o| !whisker(o) && o.label == "null");
    let line_singles = pick(&|o| !whisker(o) && o.label != "null");
    let poses = part_of(&pick(&whisker), "pose");
    let one_gross = pick(&|o| o.noise == Noise::OneGross.name());
    let answered = pick(&|o| whisker(o) && (o.label == "null" || o.delta >= 6.0));
    let right = |o: &Outcome| o.kind == Kind::Right;
    let rejected = |o: &Outcome| o.verdict != "adequate";
    let wrong = |o: &Outcome| matches!(o.kind, Kind::Wrong | Kind::Part);
    let ratios = || {
        answered
            .iter()
            .filter_map(|o| o.after_ratio)
            .collect::<Vec<_>>()
    };
    let oracle = || answered.iter().map(|o| o.oracle_ratio).collect::<Vec<_>>();
    vec![
        share(
            "every noise: false names on nulls",
            "<= 5 %",
            &nulls,
            names_something,
            Side::AtMost(0.05),
        ),
        share(
            "every noise: nulls called unknown-effect",
            "-",
            &nulls,
            |o| o.verdict == "unknown-effect",
            Side::None,
        ),
        // What the program's error budget (`levels.rs` of wcal-verify) allows.
        share(
            "every noise: nulls not called adequate",
            "<= 2.5 %",
            &nulls,
            rejected,
            Side::AtMost(0.025),
        ),
        share(
            "every noise: refused",
            "none of these",
            &answered,
            refused,
            Side::NoneOfThem,
        ),
        share(
            "every noise: singles >= 8 sigma right",
            ">= 93 %",
            &singles,
            right,
            Side::AtLeast(0.93),
        ),
        share(
            "every noise: singles >= 8 sigma, wrong name",
            "<= 1 %",
            &singles,
            wrong,
            Side::AtMost(0.01),
        ),
        number(
            "every noise: after / floor, median",
            "<= 1.03",
            ratios(),
            0.5,
            1.03,
        ),
        number(
            "every noise: after / floor, 95th percentile",
            "<= 1.2",
            ratios(),
            0.95,
            1.2,
        ),
        number(
            "every noise: the same of the oracle, median",
            "-",
            oracle(),
            0.5,
            f64::INFINITY,
        ),
        number(
            "every noise: the same of the oracle, 95th percentile",
            "-",
            oracle(),
            0.95,
            f64::INFINITY,
        ),
        rate(
            "scatter of poses stated within a factor 1.3",
            ">= 95 %",
            poses.iter().filter(|p| p.within(PART_FACTOR)).count(),
            poses.len(),
            Side::AtLeast(0.95),
        ),
        share(
            "one gross reading: it alone flagged",
            ">= 98 %",
            &one_gross,
            |o| o.flags_right == Some(true),
            Side::AtLeast(0.98),
        ),
        share(
            "lines: false names on nulls",
            "<= 5 %",
            &lines,
            names_something,
            Side::AtMost(0.05),
        ),
        share(
            "lines: nulls called unknown-effect",
            "-",
            &lines,
            |o| o.verdict == "unknown-effect",
            Side::None,
        ),
        share(
            "lines: nulls not called adequate",
            "<= 2.5 %",
            &lines,
            rejected,
            Side::AtMost(0.025),
        ),
        share(
            "lines: singles >= 8 sigma right",
            "-",
            &line_singles,
            right,
            Side::None,
        ),
        share(
            "lines: singles >= 8 sigma, wrong name",
            "-",
            &line_singles,
            wrong,
            Side::None,
        ),
    ]
}

/// Hits of trials.
type Count = (usize, usize);

/// One kind of noise in the table.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct NoiseRow {
    /// Kind.
    pub noise: String,
    /// Nulls that name an effect.
    pub false_names: Count,
    /// Clopper-Pearson bounds of `false_names`.
    pub false_names_bounds: Option<(f64, f64)>,
    /// Nulls called adequate.
    pub adequate: Count,
    /// Nulls called unknown-effect.
    pub unknown: Count,
    /// Nulls and singles refused (or called a twin's fault).
    pub refused: Count,
    /// Singles of 8 sigma or more that are right.
    pub right: Count,
    /// Singles of 8 sigma or more with a wrong name.
    pub wrong: Count,
    /// Held-out values inside the stated 95 % intervals.
    pub covered: Count,
    /// Held-out error over the true noise: median and 95th percentile.
    pub after_floor: [f64; 2],
    /// The same of an oracle.
    pub oracle_floor: [f64; 2],
    /// Stated floor over the true noise at a new pose: 5th percentile, median and 95th percentile.
    pub stated_floor: [f64; 3],
    /// Answers that state a floor.
    pub states_floor: Count,
    /// Answers that flag just the readings that are off.
    pub flags: Count,
    /// For each part put in: stated within a factor 1.3, and inside the stated interval.
    pub parts: Vec<(String, Count, Count)>,
}

/// One row a kind of noise that occurs, whiskers first; pairs, tampered sessions and effects
/// outside the catalogue are left out.
pub fn by_noise(outcomes: &[Outcome]) -> Vec<NoiseRow> {
    let names = Noise::ALL
        .iter()
        .map(|n| n.name())
        .chain(ScalarNoise::ALL.iter().map(|n| n.name()));
    let of = |name: &str| -> Vec<&Outcome> {
        let here = outcomes
            .iter()
            .filter(|o| o.noise == name && o.pictures.is_none());
        here.filter(|o| !matches!(o.label.as_str(), "pair" | "unknown" | "adversarial"))
            .collect()
    };
    names
        .map(|name| (name, of(name)))
        .filter(|(_, of)| !of.is_empty())
        .map(|(n, of)| noise_row(n, &of))
        .collect()
}

fn noise_row(noise: &str, of: &[&Outcome]) -> NoiseRow {
    let nulls: Vec<&Outcome> = of.iter().copied().filter(|o| o.label == "null").collect();
    let singles: Vec<&Outcome> = of
        .iter()
        .copied()
        .filter(|o| o.label != "null" && o.delta >= 0.97 * 8.0)
        .collect();
    let sizeable: Vec<&Outcome> = of
        .iter()
        .copied()
        .filter(|o| o.label == "null" || o.delta >= 6.0)
        .collect();
    let count = |of: &[&Outcome], hit: &dyn Fn(&Outcome) -> bool| -> Count {
        (of.iter().filter(|o| hit(o)).count(), of.len())
    };
    let quantiles = |f: &dyn Fn(&Outcome) -> Option<f64>, q: f64| {
        quantile_of(sizeable.iter().filter_map(|o| f(o)).collect(), q)
    };
    let both = |f: &dyn Fn(&Outcome) -> Option<f64>| [0.5, 0.95].map(|q| quantiles(f, q));
    let false_names = count(&nulls, &names_something);
    let flagged: Vec<bool> = of.iter().filter_map(|o| o.flags_right).collect();
    let mut parts: Vec<(String, Count, Count)> = Vec::new();
    for part in of.iter().flat_map(|o| &o.parts) {
        if !parts.iter().any(|p| p.0 == part.name) {
            let all = part_of(of, &part.name);
            let near = all.iter().filter(|p| p.within(PART_FACTOR)).count();
            let inside: Vec<bool> = all.iter().filter_map(|p| p.inside).collect();
            let hits = inside.iter().filter(|i| **i).count();
            parts.push((part.name.clone(), (near, all.len()), (hits, inside.len())));
        }
    }
    NoiseRow {
        noise: noise.to_owned(),
        false_names,
        false_names_bounds: (false_names.1 > 0)
            .then(|| clopper_pearson(false_names.0, false_names.1)),
        adequate: count(&nulls, &|o| o.verdict == "adequate"),
        unknown: count(&nulls, &|o| o.verdict == "unknown-effect"),
        refused: count(of, &refused),
        right: count(&singles, &|o| o.kind == Kind::Right),
        wrong: count(&singles, &|o| matches!(o.kind, Kind::Wrong | Kind::Part)),
        covered: of
            .iter()
            .filter_map(|o| o.covered)
            .fold((0, 0), |(a, b), (k, n)| (a + k, b + n)),
        after_floor: both(&|o| o.after_ratio),
        oracle_floor: both(&|o| Some(o.oracle_ratio)),
        stated_floor: [0.05, 0.5, 0.95].map(|q| quantiles(&|o| o.floor_ratio, q)),
        states_floor: count(of, &|o| o.floor_ratio.is_some()),
        flags: (flagged.iter().filter(|f| **f).count(), flagged.len()),
        parts,
    }
}

/// Sessions like the practice sessions, by what a goal asks of them.
struct Practice<'a> {
    outcomes: &'a [Outcome],
    /// One effect of the catalogue, in a rich layout.
    singles: Vec<&'a Outcome>,
    /// Not tampered with, and without an effect outside the catalogue.
    known: Vec<&'a Outcome>,
}

fn rich(o: &Outcome) -> bool {
    o.design == Some(Design::Rich)
}

fn tampered(o: &Outcome) -> bool {
    o.label == "adversarial"
}

fn right(o: &Outcome) -> bool {
    o.kind == Kind::Right
}

impl<'a> Practice<'a> {
    fn new(outcomes: &'a [Outcome]) -> Self {
        let mut all = Self {
            outcomes,
            singles: Vec::new(),
            known: Vec::new(),
        };
        all.singles = all.pick(&|o| rich(o) && o.laws.len() == 1 && o.label != "unknown");
        all.known = all.pick(&|o| !tampered(o) && o.label != "unknown");
        all
    }

    fn pick(&self, f: &dyn Fn(&Outcome) -> bool) -> Vec<&'a Outcome> {
        self.outcomes.iter().filter(|o| f(o)).collect()
    }

    /// Goals of the names that are given.
    fn names(&self) -> Vec<Goal> {
        let nulls = self.pick(&|o| o.label == "null");
        let above = |sigma: f64| -> Vec<&Outcome> {
            self.singles
                .iter()
                .copied()
                .filter(|o| o.delta >= 0.97 * sigma)
                .collect()
        };
        let clear: Vec<&Outcome> = above(8.0)
            .into_iter()
            .filter(|o| o.rival_sigma.is_none_or(|r| r >= 3.0))
            .collect();
        let clear_big: Vec<&Outcome> = clear
            .iter()
            .copied()
            .filter(|o| o.delta >= 0.97 * 20.0)
            .collect();
        let pairs = self.pick(&|o| rich(o) && o.label == "pair" && o.delta_each >= 0.97 * 8.0);
        vec![
            share(
                "false attribution on nulls",
                "<= 5 %",
                &nulls,
                |o| o.kind == Kind::False,
                Side::AtMost(0.05),
            ),
            share(
                "right class, rich single >= 8 sigma, no rival within 3",
                ">= 93 %",
                &clear,
                right,
                Side::AtLeast(0.93),
            ),
            share(
                "right class, rich single >= 20 sigma, no rival within 3",
                ">= 98 %",
                &clear_big,
                right,
                Side::AtLeast(0.98),
            ),
            share(
                "right class, every rich single >= 8 sigma",
                "-",
                &above(8.0),
                right,
                Side::None,
            ),
            share(
                "right or in the set, rich single >= 8 sigma",
                "-",
                &above(8.0),
                |o| o.kind == Kind::Right || o.kind == Kind::AmbiguousIn,
                Side::None,
            ),
            share(
                "confident wrong name, rich single >= 8 sigma",
                "-",
                &above(8.0),
                |o| matches!(o.kind, Kind::Wrong | Kind::Part),
                Side::None,
            ),
            share(
                "exact set on pairs, each >= 8 sigma",
                ">= 80 %",
                &pairs,
                right,
                Side::AtLeast(0.80),
            ),
            share(
                "wrong extra effect on pairs",
                "<= 5 %",
                &pairs,
                |o| o.extra > 0,
                Side::AtMost(0.05),
            ),
        ]
    }

    /// Goals of answers that leave several explanations, and of the measurement that they ask for.
    fn ambiguities(&self) -> Vec<Goal> {
        let named = |o: &Outcome| o.label != "unknown" && o.label != "null";
        let ambiguous = self.pick(&|o| o.verdict == "ambiguous" && !tampered(o) && named(o));
        let followed: Vec<&FollowUp> = self
            .outcomes
            .iter()
            .filter_map(|o| o.follow_up.as_ref())
            .collect();
        let resolvable: Vec<&FollowUp> = followed
            .iter()
            .copied()
            .filter(|f| f.expected_power >= 0.95)
            .collect();
        vec![
            share(
                "truth inside the ambiguity set",
                ">= 95 %",
                &ambiguous,
                |o| o.in_set,
                Side::AtLeast(0.95),
            ),
            number(
                "alternatives in an ambiguous answer, median",
                "-",
                ambiguous.iter().map(|o| o.set_size as f64).collect(),
                0.5,
                f64::INFINITY,
            ),
            number(
                "alternatives listed over what the data allow (rivals within 3 noises), mean",
                "<= 1.2",
                set_over_allowed(&ambiguous),
                0.5,
                1.2,
            ),
            rate(
                "ambiguities that the program calls resolvable by three poses (power >= 0.95)",
                "-",
                resolvable.len(),
                followed.len(),
                Side::None,
            ),
            rate(
                "of these resolved by the measurement asked for",
                ">= 95 %",
                resolvable.iter().filter(|f| f.resolved).count(),
                resolvable.len(),
                Side::AtLeast(0.95),
            ),
            rate(
                "a wrong name after the measurement asked for",
                "-",
                followed
                    .iter()
                    .filter(|f| matches!(f.kind, Kind::Wrong | Kind::Part))
                    .count(),
                followed.len(),
                Side::None,
            ),
        ]
    }

    /// Goals of held-out errors and of intervals.
    fn errors(&self) -> Vec<Goal> {
        let known = self.known.iter();
        let (inside, values) = known
            .filter_map(|o| o.covered)
            .fold((0, 0), |(a, b), (k, n)| (a + k, b + n));
        let sizeable: Vec<&Outcome> = self
            .known
            .iter()
            .copied()
            .filter(|o| o.label == "null" || o.delta >= 6.0)
            .collect();
        let ratios = |f: &dyn Fn(&Outcome) -> Option<f64>, of: &[&Outcome]| {
            of.iter().filter_map(|o| f(o)).collect::<Vec<_>>()
        };
        let after = |o: &Outcome| o.after_ratio;
        vec![
            number(
                "held-out error after / floor, median",
                "<= 1.05",
                ratios(&after, &sizeable),
                0.5,
                1.05,
            ),
            number(
                "held-out error after / floor, 95th percentile",
                "<= 1.2",
                ratios(&after, &sizeable),
                0.95,
                1.2,
            ),
            number(
                "the same of the oracle, median",
                "-",
                sizeable.iter().map(|o| o.oracle_ratio).collect(),
                0.5,
                f64::INFINITY,
            ),
            number(
                "the same of the oracle, 95th percentile",
                "-",
                sizeable.iter().map(|o| o.oracle_ratio).collect(),
                0.95,
                f64::INFINITY,
            ),
            number(
                "held-out error before / floor, median",
                "-",
                ratios(&|o| o.before_ratio, &sizeable),
                0.5,
                f64::INFINITY,
            ),
            rate(
                "stated 95 % intervals cover, pooled",
                "95 % within bounds",
                inside,
                values,
                Side::Contains(0.95),
            ),
        ]
    }

    /// Goals of what the catalogue does not hold, and of sessions that were tampered with.
    fn unknowns(&self) -> Vec<Goal> {
        let unknown = self.pick(&|o| o.label == "unknown" && o.delta >= 0.97 * 8.0);
        let paper = self.pick(&|o| !rich(o) && o.label != "null" && !tampered(o));
        vec![
            share(
                "outside the catalogue, >= 8 sigma: unknown-effect",
                ">= 90 %",
                &unknown,
                right,
                Side::AtLeast(0.90),
            ),
            share(
                "outside the catalogue: driver right",
                ">= 85 %",
                &unknown,
                |o| o.driver_right == Some(true),
                Side::AtLeast(0.85),
            ),
            share(
                "false unknown on known effects and nulls",
                "<= 5 %",
                &self.known,
                |o| o.verdict == "unknown-effect",
                Side::AtMost(0.05),
            ),
            share(
                "paper-like sessions: no confident wrong name",
                "-",
                &paper,
                |o| !matches!(o.kind, Kind::Wrong | Kind::Part | Kind::Crash),
                Side::None,
            ),
            share(
                "tampered sessions: no confident wrong name",
                "all of these",
                &self.pick(&tampered),
                right,
                Side::All,
            ),
        ]
    }
}

/// Goals of sessions like the practice sessions.
fn practice_goals(outcomes: &[Outcome]) -> Vec<Goal> {
    let practice = Practice::new(outcomes);
    [
        practice.names(),
        practice.ambiguities(),
        practice.errors(),
        practice.unknowns(),
    ]
    .concat()
}
