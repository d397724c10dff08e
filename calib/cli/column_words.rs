//! Which option of `wcal import` takes a column, as its name tells.

use wcal_session::is_among;

/// Words of a column's name, in lower case, and the option that takes such a column.
const WORDS: [(&str, &str); 4] = [
    ("--direction", "dir|direction|richtung|sense|updown"),
    (
        "--replicate",
        "cycle|zyklus|run|series|serie|rep|repeat|replicate|repetition",
    ),
    (
        "--temperature",
        "temp|temperature|temperatur|degc|t_c|t_k|t_f|t_degc",
    ),
    (
        "--time",
        "time|t|zeit|date|datum|timestamp|clock|elapsed|seconds",
    ),
];

/// Words of a column that holds corrections, deviations or errors of another quantity; a difference
/// is measured as such (a pressure `delta_p`).
const DEVIATIONS: &str = "correction|corr|deviation|dev|error|err|korrektur|abweichung|fehler";

/// Whether a column's name says that it is a deviation of the stimulus.
pub(crate) fn is_deviation(name: &str) -> bool {
    let name = name.to_lowercase();
    name.split(|c: char| !c.is_alphanumeric())
        .any(|word| is_among(DEVIATIONS, word))
}

/// The option that takes a column of this name; none where the name does not tell.
pub(crate) fn option_of(name: &str) -> Option<&'static str> {
    let name = name.to_lowercase();
    let words: Vec<&str> = name
        .split(|c: char| !c.is_alphanumeric())
        .filter(|word| !word.is_empty())
        .collect();
    // A temperature may be recognised by its unit alone: T_C, T (K).
    let whole = words.join("_");
    let holds = |of: &str| is_among(of, &whole) || words.iter().any(|word| is_among(of, word));
    WORDS
        .iter()
        .find(|(_, of)| holds(of))
        .map(|(option, _)| *option)
}

/// A word as a shell takes it.
pub(crate) fn quoted(word: &str) -> String {
    let plain = |c: char| c.is_alphanumeric() || "._-/=+:@%".contains(c);
    if !word.is_empty() && word.chars().all(plain) {
        word.to_owned()
    } else {
        format!("'{}'", word.replace('\'', r"'\''"))
    }
}

#[cfg(test)]
mod tests {
    use super::option_of;

    #[test]
    fn a_temperature_is_told_by_its_unit_and_a_time_by_its_own() {
        for name in ["T_C", "T (K)", "T [degC]", "Temp."] {
            assert_eq!(option_of(name), Some("--temperature"), "{name}");
        }
        for name in ["t_s", "t", "Zeit"] {
            assert_eq!(option_of(name), Some("--time"), "{name}");
        }
        assert_eq!(option_of("C"), None, "negative control");
    }
}
