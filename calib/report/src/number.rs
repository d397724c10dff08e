//! Numbers and units as a reader expects them: a few significant digits, true minus sign, no NaN.

use wcal_core::text;

/// What stands for a value that is not finite.
pub(crate) const NOT_AVAILABLE: &str = "n/a";

/// Four significant digits without trailing zeros, e.g. `0.6`, `134.1`, `2.052×10⁻⁴`; `n/a` where
/// not finite.
pub fn number(value: f64) -> String {
    significant(value, 4)
}

/// `digits` significant digits without trailing zeros.
pub(crate) fn significant(value: f64, digits: usize) -> String {
    if !value.is_finite() {
        return NOT_AVAILABLE.into();
    }
    if value == 0.0 {
        return "0".into();
    }
    let (mantissa, exponent) = split(value, digits);
    if (-3..6).contains(&exponent) {
        let decimals = (digits as i32 - 1 - exponent).max(0) as usize;
        trim(format!("{value:.decimals$}")).replace('-', "\u{2212}")
    } else {
        format!(
            "{}×10{}",
            trim(mantissa).replace('-', "\u{2212}"),
            superscript(exponent)
        )
    }
}

/// A value with its interval, both rounded to two significant digits of the half width.
pub fn with_interval(value: f64, interval: [f64; 2]) -> (String, String) {
    let half = (interval[1] - interval[0]).abs() / 2.0;
    let all = [value, interval[0], interval[1]];
    let [value, low, high] = match half > 0.0 && half.is_finite() && value.is_finite() {
        true => text::with_interval(value, interval).map(|t| typeset(&t)),
        // Without a finite width there is nothing to round to.
        false => all.map(number),
    };
    (value, format!("[{low}, {high}]"))
}

/// True minus sign, and a power of ten in place of an exponent.
fn typeset(text: &str) -> String {
    let (mantissa, exponent) = match text.split_once('e') {
        Some((mantissa, exponent)) => (mantissa, exponent.parse().ok()),
        None => (text, None),
    };
    let power = exponent.map_or(String::new(), |e| format!("×10{}", superscript(e)));
    mantissa.replace('-', "\u{2212}") + &power
}

/// A p-value: two significant digits, `< 0.0001` below that.
pub fn p_value(p: f64) -> String {
    match p {
        p if !p.is_finite() => NOT_AVAILABLE.into(),
        p if p < 1e-4 => "< 0.0001".into(),
        p if p < 1e-3 => trim(format!("{p:.5}")),
        p => significant(p, 2),
    }
}

/// A share of one in percent, e.g. `94.1 %`.
pub fn percent(share: f64) -> String {
    if share.is_finite() {
        format!("{} %", significant(share * 100.0, 3))
    } else {
        NOT_AVAILABLE.into()
    }
}

/// Unit as printed: `1` vanishes, `degc` and `N mm` take their usual form.
pub(crate) fn unit_text(unit: &str) -> String {
    match unit {
        "1" | "" => String::new(),
        "nmm" | "N mm" => "N\u{a0}mm".into(),
        "degc" => "°C".into(),
        "um" => "µm".into(),
        other => other.replace("degc", "°C").replace("N mm", "N\u{a0}mm"),
    }
}

/// A number with its unit.
pub(crate) fn quantity(value: f64, unit: &str) -> String {
    join_unit(&number(value), unit)
}

/// Puts a unit behind a text that is already a number.
pub(crate) fn join_unit(text: &str, unit: &str) -> String {
    match unit_text(unit) {
        u if u.is_empty() || text == NOT_AVAILABLE => text.into(),
        u => format!("{text}\u{a0}{u}"),
    }
}

/// Name and unit of a column such as `stage_mm` or `speed_mm_s`: (`stage`, `mm`).
pub(crate) fn split_unit(column: &str) -> (String, String) {
    // Longer suffixes come first: `_mm_s` ends in `_s`, too.
    const SUFFIXES: [(&str, &str); 16] = [
        ("_pm_per_degc", "pm/°C"),
        ("_degc_s", "°C/s"),
        ("_degc_per_s", "°C/s"),
        ("_mm_s", "mm/s"),
        ("_nmm", "N\u{a0}mm"),
        ("_mm", "mm"),
        ("_um", "µm"),
        ("_nm", "nm"),
        ("_pm", "pm"),
        ("_degc", "°C"),
        ("_rad", "rad"),
        ("_deg", "°"),
        ("_hz", "Hz"),
        ("_n", "N"),
        ("_px", "px"),
        ("_s", "s"),
    ];
    let found = SUFFIXES
        .iter()
        .find_map(|(suffix, unit)| Some((column.strip_suffix(suffix)?, *unit)));
    let (name, unit) = found.unwrap_or((column, ""));
    (name.replace('_', " "), unit.into())
}

/// Decimal mantissa text and exponent of `value` rounded to `digits` digits.
fn split(value: f64, digits: usize) -> (String, i32) {
    let text = format!("{value:.*e}", digits.saturating_sub(1));
    match text.split_once('e') {
        Some((mantissa, exponent)) => (mantissa.into(), exponent.parse().unwrap_or(0)),
        None => (text, 0),
    }
}

fn trim(text: String) -> String {
    if text.contains('.') {
        text.trim_end_matches('0').trim_end_matches('.').into()
    } else {
        text
    }
}

/// Exponent in superscript digits.
pub(crate) fn superscript(exponent: i32) -> String {
    const DIGITS: [char; 10] = ['⁰', '¹', '²', '³', '⁴', '⁵', '⁶', '⁷', '⁸', '⁹'];
    let turn = |c: char| c.to_digit(10).map_or('⁻', |d| DIGITS[d as usize]);
    exponent.to_string().chars().map(turn).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn significant_digits_and_exponents() {
        assert_eq!(number(0.6), "0.6");
        assert_eq!(number(134.07), "134.1");
        assert_eq!(number(2.0518e-4), "2.052×10⁻⁴");
        assert_eq!(number(-0.5), "−0.5");
        assert_eq!(number(123_456.0), "123456");
        assert_eq!(number(1.5e9), "1.5×10⁹");
        assert_eq!(number(9.99999), "10");
    }

    #[test]
    fn what_is_not_finite_never_prints_as_nan() {
        for v in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
            assert_eq!(number(v), NOT_AVAILABLE);
            assert_eq!(percent(v), NOT_AVAILABLE);
            assert_eq!(p_value(v), NOT_AVAILABLE);
        }
        assert_eq!(
            with_interval(1.0, [f64::NAN, 2.0]),
            ("1".into(), "[n/a, 2]".into())
        );
    }

    #[test]
    fn the_interval_sets_the_digits() {
        assert_eq!(
            with_interval(0.21, [0.18, 0.24]),
            ("0.210".into(), "[0.180, 0.240]".into())
        );
        assert_eq!(
            with_interval(134.07, [120.0, 150.0]),
            ("134".into(), "[120, 150]".into())
        );
        assert_eq!(with_interval(0.02, [-0.0001, 0.04]).1, "[0.000, 0.040]");
        assert_eq!(
            with_interval(2.05e-4, [1.9e-4, 2.3e-4]).1,
            "[1.90×10⁻⁴, 2.30×10⁻⁴]"
        );
        assert_eq!(
            with_interval(1.0, [1.0, 1.0]),
            ("1".into(), "[1, 1]".into())
        );
    }

    #[test]
    fn p_values_stay_decimal() {
        assert_eq!(p_value(0.0005), "0.0005");
        assert_eq!(p_value(2e-6), "< 0.0001");
        assert_eq!(p_value(0.713), "0.71");
    }

    #[test]
    fn units_leave_the_column_name() {
        assert_eq!(split_unit("speed_mm_s"), ("speed".into(), "mm/s".into()));
        assert_eq!(
            split_unit("temperature_degc"),
            ("temperature".into(), "°C".into())
        );
        assert_eq!(
            split_unit("contact_arclength_mm"),
            ("contact arclength".into(), "mm".into())
        );
        assert_eq!(split_unit("order"), ("order".into(), String::new()));
    }
}
