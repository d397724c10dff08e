//! Unit suffixes of column names.

/// Suffixes that name a unit, longest first so that `_mm_s` wins over `_s`.
const SUFFIXES: &str = "mm_s|um_s|m_s|cm_s|degc|degf|mrad|kpa|mpa|gpa|nmm|ohm|min|deg|rad|mm|um|nm|pm|cm|in|ms|us|ns|mv|mn|kn|hz|px|pa|m|s|h|k|c|f|n|v";

/// Splits `groove_x_mm` into `groove_x` and `mm`; a name without a unit has an empty suffix.
pub(crate) fn split_unit(name: &str) -> (&str, &str) {
    for unit in SUFFIXES.split('|') {
        let base = name.strip_suffix(unit).and_then(|b| b.strip_suffix('_'));
        if let Some(base) = base.filter(|b| !b.is_empty()) {
            return (base, unit);
        }
    }
    (name, "")
}

#[cfg(test)]
mod tests {
    use super::split_unit;

    #[test]
    fn suffixes_split_at_the_longest_unit() {
        assert_eq!(split_unit("groove_x_mm"), ("groove_x", "mm"));
        assert_eq!(split_unit("speed_mm_s"), ("speed", "mm_s"));
        assert_eq!(split_unit("t_s"), ("t", "s"));
        assert_eq!(split_unit("point"), ("point", ""));
        assert_eq!(split_unit("fbg_1_shift_nm"), ("fbg_1_shift", "nm"));
    }
}
