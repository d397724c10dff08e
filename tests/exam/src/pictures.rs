//! Scores of sessions that cameras look at, beside the same sessions without pictures.

use crate::goal::{Goal, Side, number, share};
use crate::score::{Kind, Outcome};

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

/// Goals of the sessions that cameras look at; those without their pictures have rows without a
/// goal.
pub(super) fn picture_goals(looked: &[&Outcome]) -> Vec<Goal> {
    let with: Vec<&Outcome> = looked
        .iter()
        .copied()
        .filter(|o| o.pictures == Some(true))
        .collect();
    let without: Vec<&Outcome> = looked
        .iter()
        .copied()
        .filter(|o| o.pictures == Some(false))
        .collect();
    let mut out = one_side("pictures", &with, true);
    out.extend(one_side("the same without pictures", &without, false));
    out
}

fn one_side(name: &str, of: &[&Outcome], goals: bool) -> Vec<Goal> {
    let pick =
        |f: &dyn Fn(&Outcome) -> bool| of.iter().copied().filter(|o| f(o)).collect::<Vec<_>>();
    let camera = |o: &Outcome| CAMERAS.contains(&o.label.as_str());
    let clear = |o: &Outcome| !camera(o) && o.label != "rest-shape" && o.clear == Some(true);
    let singles = pick(&|o| o.laws.len() == 1 && clear(o));
    let seen = pick(&|o| o.laws.len() == 1 && clear(o) && SEEN.contains(&o.label.as_str()));
    let pairs = pick(&|o| o.label == "pair" && clear(o));
    let cameras = pick(&camera);
    let nominals = pick(&|o| o.label == "rest-shape");
    let named = pick(&|o| o.label != "null");
    let nulls = pick(&|o| o.label == "null");
    let right = |o: &Outcome| o.kind == Kind::Right;
    let in_set = |o: &Outcome| o.kind == Kind::AmbiguousIn;
    let missed = |o: &Outcome| matches!(o.kind, Kind::Unknown | Kind::Missed);
    // An effect that was not put in is named, alone or beside a right one.
    let wrong = |o: &Outcome| o.kind == Kind::Wrong || (o.verdict == "effect" && o.extra > 0);
    let camera_said =
        |o: &Outcome| o.verdict == "effect" && o.got.iter().all(|g| CAMERAS.contains(&g.as_str()));
    let row =
        |what: &str, goal: &str, of: &[&Outcome], hit: &dyn Fn(&Outcome) -> bool, side: Side| {
            let (goal, side) = if goals {
                (goal, side)
            } else {
                ("-", Side::None)
            };
            share(&format!("{name}: {what}"), goal, of, hit, side)
        };
    let value =
        |what: &str, goal: &str, f: &dyn Fn(&Outcome) -> Option<f64>, quantile: f64, most: f64| {
            let (goal, most) = if goals {
                (goal, most)
            } else {
                ("-", f64::INFINITY)
            };
            number(
                &format!("{name}: {what}"),
                goal,
                of.iter().filter_map(|o| f(o)).collect(),
                quantile,
                most,
            )
        };
    let none = f64::INFINITY;
    vec![
        row(
            "clear single right",
            ">= 90 %",
            &singles,
            &right,
            Side::AtLeast(0.9),
        ),
        row(
            "clear single of wire or groove right",
            "-",
            &seen,
            &right,
            Side::None,
        ),
        row(
            "clear single ambiguous, truth in the set",
            "-",
            &singles,
            &in_set,
            Side::None,
        ),
        row(
            "clear single called adequate or unknown",
            "-",
            &singles,
            &missed,
            Side::None,
        ),
        row(
            "clear pair right",
            ">= 75 %",
            &pairs,
            &right,
            Side::AtLeast(0.75),
        ),
        row(
            "clear pair: one of the two named",
            "-",
            &pairs,
            &|o| o.kind == Kind::Part,
            Side::None,
        ),
        row("wrong name", "<= 1 %", &named, &wrong, Side::AtMost(0.01)),
        row(
            "fault of the cameras named",
            "-",
            &cameras,
            &right,
            Side::None,
        ),
        row(
            "fault of the cameras called one",
            ">= 95 %",
            &cameras,
            &camera_said,
            Side::AtLeast(0.95),
        ),
        row(
            "wrong nominal of the wire named",
            "-",
            &nominals,
            &right,
            Side::None,
        ),
        row(
            "null: anything named",
            "<= 5 %",
            &nulls,
            &|o| !right(o),
            Side::AtMost(0.05),
        ),
        value(
            "contact error before / floor, median",
            "-",
            &|o| o.contact_before_ratio,
            0.5,
            none,
        ),
        value(
            "contact error after / floor, median",
            "<= 1.1",
            &|o| o.contact_after_ratio,
            0.5,
            1.1,
        ),
        value(
            "contact error after / floor, 95th percentile",
            "-",
            &|o| o.contact_after_ratio,
            0.95,
            none,
        ),
        value("slowest session, s", "-", &|o| Some(o.seconds), 1.0, none),
    ]
}
