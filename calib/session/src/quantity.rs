//! Units as people write them, at the end of a column's name or in a line of units: what they
//! measure, and how much of its base unit they are.

use crate::cell::name_of;

/// Symbols that take SI prefixes.
const SYMBOLS: [&str; 13] = [
    "V/V", "N", "Pa", "V", "A", "m", "s", "g", "Hz", "W", "Nm", "Ohm", "K",
];
const PREFIXES: [(&str, &str, f64); 8] = [
    ("n", "nano", 1e-9),
    ("u", "micro", 1e-6),
    ("m", "milli", 1e-3),
    ("c", "centi", 1e-2),
    ("h", "hecto", 1e2),
    ("k", "kilo", 1e3),
    ("M", "mega", 1e6),
    ("G", "giga", 1e9),
];
/// Words for them, and other units: in small letters, with the base and the factor (inch,
/// pound-force, kilopond and psi by their definitions).
const WORDS: [(&str, &str, f64); 30] = [
    ("newton", "N", 1.0),
    ("pascal", "Pa", 1.0),
    ("volt", "V", 1.0),
    ("ampere|amp", "A", 1.0),
    ("meter|metre", "m", 1.0),
    ("gram", "g", 1.0),
    ("kelvin", "K", 1.0),
    ("ohm", "Ohm", 1.0),
    ("sec|second|sekunde|sekunden", "s", 1.0),
    ("msec|milli", "s", 1e-3),
    ("usec|micro", "s", 1e-6),
    ("min|minute|minuten", "s", 60.0),
    ("h|hr|hour|std|stunde|stunden", "s", 3600.0),
    ("d|day|tag|tage", "s", 86_400.0),
    ("in|inch", "m", 0.0254),
    ("lbf", "N", 4.448_221_615_260_5),
    ("kgf|kp", "N", 9.806_65),
    ("psi", "Pa", 6_894.757_293_168),
    ("bar", "Pa", 1e5),
    ("mbar", "Pa", 1e2),
    ("degc|celsius", "degC", 1.0),
    ("degf|fahrenheit|f", "degF", 1.0),
    ("t", "g", 1e6),
    ("lb", "g", 453.592_37),
    ("oz", "g", 28.349_523_125),
    ("ft", "m", 0.3048),
    ("atm", "Pa", 101_325.0),
    ("torr", "Pa", 133.322_368_421),
    ("mmhg", "Pa", 133.322_387_415),
    ("at", "Pa", 98_066.5),
];
/// What at the end of a name, without brackets, more often is something else than a unit: `x_m` is
/// measured, `sensor_in` an input.
const UNCLEAR: [&str; 4] = ["in", "m", "t", "at"];

/// Base and factor of a unit; none where it is not known.
fn parsed(unit: &str) -> Option<(&'static str, f64)> {
    let unit: String = unit
        .replace(['\u{b5}', '\u{3bc}'], "u")
        .replace('\u{b0}', "deg")
        .replace('\u{3a9}', "Ohm");
    let unit: String = unit
        .chars()
        .filter(|c| !c.is_whitespace() && !"\u{b7}*.[](){}".contains(*c))
        .collect();
    let symbol = |text: &str| SYMBOLS.into_iter().find(|s| *s == text);
    if let Some(base) = symbol(&unit) {
        return Some((base, 1.0));
    }
    // Of symbols the letters' size matters (mN, MN), of words it does not.
    let short = PREFIXES
        .iter()
        .find_map(|(p, _, f)| Some((symbol(unit.strip_prefix(p)?)?, *f)));
    let unit = unit.to_lowercase();
    let word = |text: &str| {
        let is = |w: &str| w == text || w.len() > 1 && text.strip_suffix('s') == Some(w);
        let found = WORDS.iter().find(|(words, ..)| words.split('|').any(is));
        found.map(|(_, base, factor)| (*base, *factor))
    };
    let long = || {
        PREFIXES
            .iter()
            .find_map(|(_, p, f)| word(unit.strip_prefix(p)?).map(|(b, own)| (b, own * f)))
    };
    // Times are written in capitals, too.
    let time = || {
        PREFIXES[..3]
            .iter()
            .find_map(|(p, _, f)| (unit.strip_prefix(p)? == "s").then_some(("s", *f)))
    };
    short
        .or_else(|| word(&unit))
        .or_else(long)
        .or_else(time)
        .or((unit == "s").then_some(("s", 1.0)))
}

/// Whether a text is a unit that is known.
pub fn is_unit(text: &str) -> bool {
    parsed(text).is_some()
}

/// How a unit is related to another one.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Relation {
    /// So many of the other are one of it.
    Times(f64),
    /// It measures something else.
    Other,
    /// One of them is not known.
    Unknown,
}

/// How the unit `from` is related to the unit `to`.
pub fn relation(from: &str, to: &str) -> Relation {
    match (parsed(from), parsed(to)) {
        // Texts that are alike are one unit, known or not.
        _ if from.trim() == to.trim() => Relation::Times(1.0),
        (Some((a, from)), Some((b, to))) if a == b => Relation::Times(from / to),
        (Some(_), Some(_)) => Relation::Other,
        _ => Relation::Unknown,
    }
}

/// What stands in brackets at the end of a column's name: `Force (N)`, `t [ms]`.
pub fn bracketed(name: &str) -> Option<&str> {
    let name = name.trim();
    [('(', ')'), ('[', ']'), ('{', '}'), ('<', '>')]
        .into_iter()
        .find_map(|(open, close)| {
            let (_, unit) = name.strip_suffix(close)?.rsplit_once(open)?;
            Some(unit.trim()).filter(|unit| !unit.is_empty())
        })
}

/// The unit that a column's name states: `Force (N)`, `t [ms]`, and as DIN 1313 has it `F / kN` and
/// `F in kN`, where the unit is known.
pub fn stated_unit(name: &str) -> Option<&str> {
    let standard = || {
        [" / ", " in "]
            .into_iter()
            .find_map(|mark| Some(name.rsplit_once(mark)?.1.trim()))
    };
    bracketed(name)
        .or_else(standard)
        .filter(|unit| parsed(unit).is_some())
}

/// Units that a column's name may end with: `load_kN`, `t_ms`, `elapsed min`, `timeMs`. None where
/// it has brackets, and none that more often is something else.
pub fn possible_units(name: &str) -> impl Iterator<Item = &str> {
    const MARKS: &[char] = &['_', ' ', '-', '.', ',', ':', '\u{a0}'];
    let last = name.rsplit(MARKS).next().unwrap_or_default();
    let part = last.rsplit('/').next().unwrap_or_default();
    let camel = part
        .rfind(char::is_uppercase)
        .filter(|at| *at > 0 && part[..*at].ends_with(char::is_lowercase));
    // A word that is a unit is one as a whole: kN is no k in newtons.
    let words = match parsed(last) {
        Some(_) => [Some(last), None],
        None => [(part != last).then_some(part), camel.map(|at| &part[at..])],
    };
    let stated = bracketed(name).is_some();
    words
        .into_iter()
        .flatten()
        .filter(move |unit| !stated && !UNCLEAR.contains(unit) && parsed(unit).is_some())
}

/// The unit in a column's name, where it is of one kind with `to`.
pub fn unit_in_name<'a>(name: &'a str, to: &str) -> Option<&'a str> {
    let of_kind = |unit: &&str| matches!(relation(unit, to), Relation::Times(_));
    match stated_unit(name) {
        Some(unit) => Some(unit).filter(of_kind),
        None => possible_units(name).find(of_kind),
    }
}

/// A unit as it is repeated in messages and documents.
pub(crate) fn written(unit: &str) -> String {
    name_of(
        bracketed(unit)
            .filter(|inner| inner.len() + 2 == unit.trim().len())
            .unwrap_or(unit),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn units_are_related_by_what_they_measure() {
        for (from, to, factor) in [
            ("ms", "s", 1e-3),
            ("\u{b5}s", "s", 1e-6),
            ("days", "s", 86_400.0),
            ("Minuten", "s", 60.0),
            ("milliseconds", "s", 1e-3),
            ("MS", "s", 1e-3),
            ("kN", "N", 1e3),
            ("Newton", "N", 1.0),
            ("Volts", "V", 1.0),
            ("mV/V", "mV / V", 1.0),
            ("um", "mm", 1e-3),
            ("N\u{b7}m", "N m", 1.0),
        ] {
            let Relation::Times(found) = relation(from, to) else {
                panic!("{from} {to}")
            };
            assert!((found / factor - 1.0).abs() < 1e-9, "{from} {to}: {found}");
        }
        assert_eq!(relation("V", "N"), Relation::Other);
        assert_eq!(relation("counts", "N"), Relation::Unknown);
    }

    #[test]
    fn every_form_of_a_name_states_the_same_unit() {
        for name in [
            "F / kN",
            "F in kN",
            "F [kN]",
            "F (kN)",
            "Kraft / kN",
            "F {kN}",
            "F / (kN)",
        ] {
            assert_eq!(stated_unit(name), Some("kN"), "{name}");
            assert_eq!(unit_in_name(name, "N"), Some("kN"), "{name}");
            assert_eq!(unit_in_name(name, "V"), None, "{name}");
        }
        for name in ["F_kN", "F kN", "F-kN", "F/kN"] {
            assert_eq!(
                (stated_unit(name), possible_units(name).next()),
                (None, Some("kN")),
                "{name}"
            );
            assert_eq!(unit_in_name(name, "N"), Some("kN"), "{name}");
        }
        for (name, unit) in [("Signal_mV/V", "mV/V"), ("kN", "kN"), ("timeMs", "Ms")] {
            assert_eq!(possible_units(name).collect::<Vec<_>>(), [unit], "{name}");
        }
        for name in [
            "position in frame",
            "in / out",
            "Time (local)",
            "sensor_in",
            "x_m",
            "load",
        ] {
            assert_eq!(
                (stated_unit(name), possible_units(name).next()),
                (None, None),
                "{name}"
            );
        }
    }

    #[test]
    fn the_unit_of_a_time_stands_at_the_end_of_its_name() {
        for (name, unit) in [
            ("time_ms", "ms"),
            ("Zeit (days)", "days"),
            ("t [\u{b5}s]", "\u{b5}s"),
            ("elapsed min", "min"),
            ("t / h", "h"),
            ("Zeit in Stunden", "Stunden"),
            ("timeMs", "Ms"),
            ("hours", "hours"),
            ("t_s", "s"),
        ] {
            assert_eq!(unit_in_name(name, "s"), Some(unit), "{name}");
        }
        for name in [
            "time",
            "t",
            "timestamp",
            "Time (local)",
            "load_N",
            "items",
            "Zeit",
        ] {
            assert_eq!(unit_in_name(name, "s"), None, "{name}");
        }
        assert_eq!(
            (unit_in_name("x_m", "mm"), unit_in_name("laser_um", "mm")),
            (None, Some("um"))
        );
    }
}
