//! Scores of sessions that cameras look at, beside the same sessions without pictures.

use super::score::{Kind, Outcome};
use super::summary::{Goal, Side, number, share};

/// Effects of the cameras' setup.
const CAMERAS: [&str; 4] = ["camera-pose", "board-scale", "rig-tag", "picture-clock"];
/// Effects that move the contact or bend the wire: cameras see them.
const SEEN: [&str; 6] = [
    "contact-offset",
    "base-compliance",
    "wire-taper",
    "superelastic-softening",
    "groove-friction",
    "stage-periodic",
];

/// Goals of the sessions that cameras look at; those without their pictures have rows without a goal.
pub(super) fn picture_goals(looked: &[&Outcome]) -> Vec<Goal> {
    let with: Vec<&Outcome> = looked.iter().copied().filter(|o| o.pictures == Some(true)).collect();
    let without: Vec<&Outcome> = looked.iter().copied().filter(|o| o.pictures == Some(false)).collect();
    let mut out = one_side("pictures", &with, true);
    out.extend(one_side("the same without pictures", &without, false));
    out
}

fn one_side(name: &str, of: &[&Outcome], goals: bool) -> Vec<Goal> {
    let pick = |f: &dyn Fn(&Outcome) -> bool| of.iter().copied().filter(|o| f(o)).collect::<Vec<_>>();
    let camera = |o: &Outcome| CAMERAS.contains(&o.label.as_str());
    let shape = |o: &Outcome| o.label == "rest-shape";
    let single = |o: &Outcome| o.laws.len() == 1 && !camera(o) && o.delta >= 0.97 * 8.0;
    let seen = |o: &Outcome| single(o) && SEEN.contains(&o.label.as_str());
    let pairs = pick(&|o| o.label == "pair" && o.delta_each >= 0.97 * 8.0);
    let named = pick(&|o| o.label != "null");
    let nulls = pick(&|o| o.label == "null");
    let right = |o: &Outcome| o.kind == Kind::Right;
    let wrong = |o: &Outcome| matches!(o.kind, Kind::Wrong | Kind::Part);
    // Anything of the bench named or offered where only the cameras are wrong.
    let camera_said =
        |o: &Outcome| o.verdict == "effect" && o.got.iter().all(|g| CAMERAS.contains(&g.as_str()));
    let contacts = |f: &dyn Fn(&Outcome) -> Option<f64>| of.iter().filter_map(|o| f(o)).collect::<Vec<_>>();
    let row = |what: &str, goal: &str, of: &[&Outcome], hit: &dyn Fn(&Outcome) -> bool, side: Side| {
        let (goal, side) = if goals { (goal, side) } else { ("-", Side::None) };
        share(&format!("{name}: {what}"), goal, of, hit, side)
    };
    let value = |what: &str, goal: &str, values: Vec<f64>, quantile: f64, most: f64| {
        number(&format!("{name}: {what}"), goal, values, quantile, most)
    };
    vec![
        row("single >= 8 sigma right", ">= 90 %", &pick(&single), &right, Side::AtLeast(0.9)),
        row("single >= 8 sigma of wire or groove right", "-", &pick(&seen), &right, Side::None),
        row(
            "single >= 8 sigma ambiguous, truth in the set",
            "-",
            &pick(&single),
            &|o| o.kind == Kind::AmbiguousIn,
            Side::None,
        ),
        row(
            "single >= 8 sigma called unknown or adequate",
            "-",
            &pick(&single),
            &|o| matches!(o.kind, Kind::Unknown | Kind::Missed),
            Side::None,
        ),
        row("pair, each >= 8 sigma, right", ">= 75 %", &pairs, &right, Side::AtLeast(0.75)),
        row("wrong name", "<= 1 %", &named, &wrong, Side::AtMost(0.01)),
        row("fault of the cameras named", "-", &pick(&camera), &right, Side::None),
        row("fault of the cameras called one", ">= 95 %", &pick(&camera), &camera_said, Side::AtLeast(0.95)),
        row("wrong nominal of the wire named", "-", &pick(&shape), &right, Side::None),
        row("null: anything named", "<= 5 %", &nulls, &|o| !right(o), Side::AtMost(0.05)),
        value(
            "contact error before / floor, median",
            "-",
            contacts(&|o| o.contact_before_ratio),
            0.5,
            f64::INFINITY,
        ),
        value(
            "contact error after / floor, median",
            "<= 1.1",
            contacts(&|o| o.contact_after_ratio),
            0.5,
            1.1,
        ),
        value(
            "contact error after / floor, 95th percentile",
            "-",
            contacts(&|o| o.contact_after_ratio),
            0.95,
            f64::INFINITY,
        ),
        value("slowest session, s", "<= 30", of.iter().map(|o| o.seconds).collect(), 1.0, 30.0),
    ]
}
