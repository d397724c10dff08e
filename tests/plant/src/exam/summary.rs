//! The scores beside their goals, with Clopper-Pearson bounds.

use serde::Serialize;
use statrs::distribution::{Beta, ContinuousCDF};

use super::score::{FollowUp, Kind, Outcome};
use crate::Design;

/// One line of the table.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Goal {
    /// What is measured.
    pub score: String,
    /// The goal in words.
    pub goal: String,
    /// Measured value.
    pub value: f64,
    /// 95 % bounds, for shares.
    pub bounds: Option<(f64, f64)>,
    /// Hits and trials, for shares; else the number of values.
    pub counts: (usize, usize),
    /// Whether the measured value meets the goal; none where there is no goal or no data.
    pub met: Option<bool>,
}

/// Exact 95 % bounds of a share: `hits` of `trials` (Clopper and Pearson 1934).
pub fn clopper_pearson(hits: usize, trials: usize) -> (f64, f64) {
    let (k, n) = (hits as f64, trials as f64);
    let quantile = |a: f64, b: f64, p: f64| Beta::new(a, b).map_or(f64::NAN, |d| d.inverse_cdf(p));
    let low = if hits == 0 { 0.0 } else { quantile(k, n - k + 1.0, 0.025) };
    let high = if hits == trials { 1.0 } else { quantile(k + 1.0, n - k, 0.975) };
    (low, high)
}

/// Which side of a number a goal lies on.
enum Side {
    AtLeast(f64),
    AtMost(f64),
    /// The upper bound stays below.
    UpperAtMost(f64),
    /// The bounds contain it.
    Contains(f64),
    None,
}

fn share(score: &str, goal: &str, of: &[&Outcome], hit: impl Fn(&Outcome) -> bool, side: Side) -> Goal {
    let hits = of.iter().filter(|o| hit(o)).count();
    rate(score, goal, hits, of.len(), side)
}

fn rate(score: &str, goal: &str, hits: usize, trials: usize, side: Side) -> Goal {
    let value = hits as f64 / trials as f64;
    let bounds = (trials > 0).then(|| clopper_pearson(hits, trials));
    let met = bounds.and_then(|(low, high)| match side {
        Side::AtLeast(g) => Some(value >= g),
        Side::AtMost(g) => Some(value <= g),
        Side::UpperAtMost(g) => Some(high <= g),
        Side::Contains(g) => Some(low <= g && g <= high),
        Side::None => None,
    });
    Goal { score: score.into(), goal: goal.into(), value, bounds, counts: (hits, trials), met }
}

fn number(score: &str, goal: &str, mut values: Vec<f64>, quantile: f64, most: f64) -> Goal {
    values.retain(|v| v.is_finite());
    values.sort_by(f64::total_cmp);
    let value = if values.is_empty() {
        f64::NAN
    } else {
        let at = quantile * (values.len() - 1) as f64;
        let (i, f) = (at.floor() as usize, at.fract());
        values[i] + f * (values[(i + 1).min(values.len() - 1)] - values[i])
    };
    let met = (!values.is_empty() && most.is_finite()).then_some(value <= most);
    Goal {
        score: score.into(),
        goal: goal.into(),
        value,
        bounds: None,
        counts: (values.len(), values.len()),
        met,
    }
}

/// Alternatives of all ambiguous answers together over those that the data allow; nothing where no rivals were computed.
fn set_over_allowed(ambiguous: &[&Outcome]) -> Vec<f64> {
    let counted: Vec<(usize, usize)> =
        ambiguous.iter().filter_map(|o| Some((o.set_size, o.allowed?))).collect();
    let (listed, allowed) = counted.iter().fold((0, 0), |(a, b), (l, k)| (a + l, b + k));
    if allowed == 0 { Vec::new() } else { vec![listed as f64 / allowed as f64] }
}

/// The table of issue 3's goals for a set of outcomes.
pub fn summarise(outcomes: &[Outcome]) -> Vec<Goal> {
    let pick = |f: &dyn Fn(&Outcome) -> bool| outcomes.iter().filter(|o| f(o)).collect::<Vec<_>>();
    let rich = |o: &Outcome| o.design == Design::Rich;
    let tampered = |o: &Outcome| o.label == "adversarial";
    let single = |o: &Outcome| o.laws.len() == 1 && o.label != "unknown";
    let right = |o: &Outcome| o.kind == Kind::Right;
    let nulls = pick(&|o| o.label == "null");
    let singles = pick(&|o| rich(o) && single(o));
    let above = |sigma: f64| -> Vec<&Outcome> {
        singles.iter().copied().filter(|o| o.delta >= 0.97 * sigma).collect()
    };
    let clear: Vec<&Outcome> =
        above(8.0).into_iter().filter(|o| o.rival_sigma.is_none_or(|r| r >= 3.0)).collect();
    let clear_big: Vec<&Outcome> = clear.iter().copied().filter(|o| o.delta >= 0.97 * 20.0).collect();
    let pairs = pick(&|o| rich(o) && o.label == "pair" && o.delta_each >= 0.97 * 8.0);
    let unknown = pick(&|o| o.label == "unknown" && o.delta >= 0.97 * 8.0);
    let known = pick(&|o| !tampered(o) && o.label != "unknown");
    let paper = pick(&|o| !rich(o) && o.label != "null" && !tampered(o));
    let ambiguous =
        pick(&|o| o.verdict == "ambiguous" && !tampered(o) && o.label != "unknown" && o.label != "null");
    let followed: Vec<&FollowUp> = outcomes.iter().filter_map(|o| o.follow_up.as_ref()).collect();
    let resolvable: Vec<&FollowUp> = followed.iter().copied().filter(|f| f.expected_power >= 0.95).collect();
    let covered: Vec<(usize, usize)> =
        outcomes.iter().filter(|o| !tampered(o) && o.label != "unknown").filter_map(|o| o.covered).collect();
    let (inside, values) = covered.iter().fold((0, 0), |(a, b), (k, n)| (a + k, b + n));
    let ratios = |f: &dyn Fn(&Outcome) -> Option<f64>, of: &[&Outcome]| {
        of.iter().filter_map(|o| f(o)).collect::<Vec<_>>()
    };
    let after = |o: &Outcome| o.after_ratio;
    let sizeable = pick(&|o| known.iter().any(|k| k.name == o.name) && (o.label == "null" || o.delta >= 6.0));
    let seconds =
        |d: Design| outcomes.iter().filter(|o| o.design == d).map(|o| o.seconds).collect::<Vec<_>>();

    vec![
        share(
            "false attribution on nulls",
            "upper bound <= 5 %",
            &nulls,
            |o| o.kind == Kind::False,
            Side::UpperAtMost(0.05),
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
        share("right class, every rich single >= 8 sigma", "-", &above(8.0), right, Side::None),
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
        share("exact set on pairs, each >= 8 sigma", ">= 80 %", &pairs, right, Side::AtLeast(0.80)),
        share("wrong extra effect on pairs", "<= 5 %", &pairs, |o| o.extra > 0, Side::AtMost(0.05)),
        share("truth inside the ambiguity set", ">= 95 %", &ambiguous, |o| o.in_set, Side::AtLeast(0.95)),
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
            followed.iter().filter(|f| matches!(f.kind, Kind::Wrong | Kind::Part)).count(),
            followed.len(),
            Side::None,
        ),
        number("held-out error after / floor, median", "<= 1.05", ratios(&after, &sizeable), 0.5, 1.05),
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
            &known,
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
            "100 %",
            &pick(&tampered),
            right,
            Side::AtLeast(1.0),
        ),
        share(
            "crashes",
            "0",
            &outcomes.iter().collect::<Vec<_>>(),
            |o| o.kind == Kind::Crash,
            Side::AtMost(0.0),
        ),
        number("slowest paper session, s", "<= 10", seconds(Design::Paper), 1.0, 10.0),
        number("slowest rich session, s", "<= 60", seconds(Design::Rich), 1.0, 60.0),
    ]
}
