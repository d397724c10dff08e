//! Warning flags by their meaning for a measurement (firmware-notes/zaber-lsm100a.md).

use wcal_core::device::DeviceErrorKind;

/// What a flag forbids, and its name; `None` for notices.
pub(super) fn meaning(flag: &str) -> Option<(DeviceErrorKind, &'static str)> {
    use DeviceErrorKind as Kind;
    Some(match flag {
        "WR" => (Kind::NotHomed, "no reference position"),
        "WH" => (Kind::NotHomed, "not homed"),
        "FS" => (Kind::Stalled, "stalled and stopped"),
        "WS" => (Kind::Stalled, "stalled and recovered"),
        "WM" => (Kind::Displaced, "displaced when stationary"),
        "FD" => (Kind::DriverOff, "driver disabled"),
        "FO" => (Kind::DriverOff, "driver disabled until enabled"),
        "FE" => (Kind::OutOfRange, "limit error"),
        "WL" => (Kind::OutOfRange, "unexpected limit trigger"),
        "FF" => (Kind::CriticalFault, "critical system error"),
        "FQ" => (Kind::CriticalFault, "encoder error"),
        "WV" => (Kind::Health, "supply voltage out of range"),
        "WT" => (Kind::Health, "controller too hot"),
        other if other.starts_with('F') => {
            (Kind::CriticalFault, "a fault this program does not know")
        }
        other if other.starts_with('W') => (Kind::Health, "a warning this program does not know"),
        _ => return None,
    })
}

/// Whether a unit keeps a flag until `warnings clear`: what it tells of is over, and somebody has
/// to look first.
pub(crate) fn is_latched(flag: &str) -> bool {
    ["FS", "FE", "WS", "WM", "WL"].contains(&flag)
}

/// Who must do what about a flag, as the end of a sentence; empty where it goes by itself.
pub(crate) fn remedy(flag: &str) -> &'static str {
    match flag {
        "WR" | "WH" => "; `--home` searches the reference, and moves to the home switch",
        "FD" | "FO" => "; find out why, switch the unit off and on, then `--home`",
        "FF" => "; switch the unit off and on; if it comes back, ask the maker",
        other if is_latched(other) => {
            "; the unit keeps this flag: look at it and free what blocks it, then `--home --resume SESSION` clears the flag and \
             searches the reference anew (so does switching the unit off and on, then `--home`)"
        }
        other if other.starts_with('F') => {
            "; look it up in the maker's protocol manual, then switch the unit off and on"
        }
        _ => "",
    }
}

/// The first flag of a list that forbids measuring. While homing a missing reference is no
/// obstacle.
pub(super) fn worst(
    flags: &[String],
    homing: bool,
) -> Option<(&str, DeviceErrorKind, &'static str)> {
    flags.iter().find_map(|flag| {
        let (kind, text) = meaning(flag)?;
        let excused = homing && kind == DeviceErrorKind::NotHomed;
        (!excused).then_some((flag.as_str(), kind, text))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn notices_pass_faults_do_not_and_unknown_faults_are_faults() {
        assert_eq!(meaning("NC"), None);
        assert_eq!(meaning("--"), None);
        assert_eq!(meaning("FS").unwrap().0, DeviceErrorKind::Stalled);
        assert_eq!(meaning("FZ").unwrap().0, DeviceErrorKind::CriticalFault);
        assert_eq!(meaning("WX").unwrap().0, DeviceErrorKind::Health);
    }

    #[test]
    fn every_flag_that_forbids_says_who_must_do_what() {
        for (flag, word) in [
            ("WR", "`--home` searches the reference"),
            ("WH", "`--home` searches the reference"),
            ("FS", "then `--home --resume SESSION` clears the flag"),
            ("WS", "then `--home --resume SESSION` clears the flag"),
            ("FD", "switch the unit off and on"),
            ("FF", "ask the maker"),
            ("FZ", "protocol manual"),
        ] {
            assert!(remedy(flag).contains(word), "{flag}: {}", remedy(flag));
            assert_eq!(is_latched(flag), word.contains("--resume"), "{flag}");
        }
        // These go when their cause does.
        assert!(
            ["WV", "WT", "NI", "NC", "--"]
                .iter()
                .all(|flag| remedy(flag).is_empty() && !is_latched(flag))
        );
    }

    #[test]
    fn a_missing_reference_is_excused_only_while_homing() {
        let flags = ["WR".to_owned(), "NI".to_owned()];
        assert!(worst(&flags, true).is_none());
        assert_eq!(worst(&flags, false).unwrap().1, DeviceErrorKind::NotHomed);
        assert_eq!(
            worst(&["WR".to_owned(), "FS".to_owned()], true).unwrap().0,
            "FS"
        );
    }
}
