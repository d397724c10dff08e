//! Time stamps in a column: seconds after its first.

use jiff::civil::{DateTime, Time};
use jiff::fmt::strtime;

/// Dates that ISO 8601 does not have, the day before or after the month.
const DATES: [&str; 10] = [
    "%d.%m.%Y", "%d.%m.%y", "%d/%m/%Y", "%m/%d/%Y", "%d-%m-%Y", "%Y/%m/%d", "%Y.%m.%d", "%d-%b-%Y",
    "%d %b %Y", "%d/%m/%y",
];
/// Times of the day behind them.
const TIMES: [&str; 5] = ["", " %H:%M:%S%.f", " %H:%M", " %I:%M:%S%.f %p", " %I:%M %p"];
const DAY_S: f64 = 86_400.0;

/// A form of time stamps.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Form {
    /// ISO 8601 with its offset from UTC.
    Instant,
    /// ISO 8601 without one.
    Local,
    /// A date of [`DATES`] and a time of [`TIMES`].
    Other(usize, usize),
    /// Time of the day alone, or time that went by: hours, minutes, seconds.
    Clock,
    /// Time of the day with AM or PM.
    Halves,
}

impl Form {
    fn all() -> impl Iterator<Item = Self> {
        let others =
            (0..DATES.len()).flat_map(|d| (0..TIMES.len()).map(move |t| Self::Other(d, t)));
        [Self::Instant, Self::Local]
            .into_iter()
            .chain(others)
            .chain([Self::Clock, Self::Halves])
    }

    /// Seconds from the form's own zero.
    fn seconds(self, text: &str) -> Option<f64> {
        let since = |t: DateTime| {
            let span = t.duration_since(DateTime::constant(2000, 1, 1, 0, 0, 0, 0));
            Some(span.as_secs_f64())
        };
        // Some write the fraction of a second after a comma or a third colon, or a second blank.
        let plain = || {
            let text = text
                .replace(',', ".")
                .split_whitespace()
                .collect::<Vec<_>>()
                .join(" ");
            let third = text.match_indices(':').nth(2).map(|(at, _)| at);
            third.map_or(text.clone(), |at| {
                format!("{}.{}", &text[..at], &text[at + 1..])
            })
        };
        match self {
            Self::Instant => {
                let instant = text.parse::<jiff::Timestamp>().ok()?;
                since(instant.to_zoned(jiff::tz::TimeZone::UTC).datetime())
            }
            Self::Local => since(text.parse::<DateTime>().ok()?),
            Self::Other(date, time) => {
                let form = DATES[date].to_owned() + TIMES[time];
                since(
                    strtime::parse(form, plain())
                        .ok()?
                        .to_datetime()
                        .or_else(|_| {
                            strtime::parse(DATES[date], plain())?
                                .to_date()
                                .map(|d| d.at(0, 0, 0, 0))
                        })
                        .ok()?,
                )
            }
            Self::Clock => {
                let text = plain();
                let parts: Vec<&str> = text.split(':').collect();
                // Of two parts the second is one of seconds only where it has a fraction.
                let (hours, minutes, seconds) = match parts[..] {
                    [hours, minutes, seconds] => (hours, minutes, seconds),
                    [minutes, seconds] if seconds.contains('.') => ("0", minutes, seconds),
                    _ => return None,
                };
                let whole = |t: &str| {
                    t.bytes()
                        .all(|b| b.is_ascii_digit())
                        .then(|| t.parse::<f64>().ok())?
                };
                let below = |v: &f64| (0.0..60.0).contains(v);
                let seconds = seconds.parse::<f64>().ok().filter(below)?;
                Some(
                    3600.0 * whole(hours)?
                        + 60.0 * whole(minutes).filter(|m| hours == "0" || below(m))?
                        + seconds,
                )
            }
            Self::Halves => {
                let parse = |form| strtime::parse(form, plain()).and_then(|t| t.to_time());
                let time = parse("%I:%M:%S%.f %p")
                    .or_else(|_| parse("%I:%M %p"))
                    .ok()?;
                Some(time.duration_since(Time::midnight()).as_secs_f64())
            }
        }
    }
}

/// Whether a time stamp has no date.
pub(crate) fn is_clock(text: &str) -> bool {
    [Form::Clock, Form::Halves]
        .iter()
        .any(|form| form.seconds(text).is_some())
}

/// Whether a text is a time of the day, as it may stand behind a date.
pub(crate) fn is_time_of_day(text: &str) -> bool {
    const DATE: usize = 5;
    text.contains(':')
        && (1..TIMES.len()).any(|t| {
            Form::Other(DATE, t)
                .seconds(&format!("2025/03/04 {text}"))
                .is_some()
        })
}

/// Whether a text is a date without a time.
pub(crate) fn is_date(text: &str) -> bool {
    let dates = (0..DATES.len())
        .map(|d| Form::Other(d, 0))
        .chain([Form::Local]);
    !text.contains(':')
        && !text.contains('T')
        && is_stamp(text)
        && dates.into_iter().any(|f| f.seconds(text).is_some())
}

/// Whether a text is a time stamp.
pub(crate) fn is_stamp(text: &str) -> bool {
    text.len() >= 6
        && text.contains([':', '-', '/', '.', 'T'])
        && text.bytes().filter(u8::is_ascii_digit).count() >= 4
        && Form::all().any(|form| form.seconds(text).is_some())
}

/// Seconds after the first of the stamps, in their order, or which of them says why there are none:
/// a text that is no stamp, or two forms that all of them could have and that say different times.
pub(crate) fn seconds(stamps: &[&str]) -> Result<Vec<f64>, (usize, &'static str)> {
    // Day and month may be exchangeable in the first stamp: all its forms are tried on the others.
    let forms: Vec<Form> = Form::all()
        .filter(|f| stamps.first().is_some_and(|s| f.seconds(s).is_some()))
        .collect();
    let read = |form: &Form| -> Result<Vec<f64>, usize> {
        stamps
            .iter()
            .enumerate()
            .map(|(k, text)| form.seconds(text).ok_or(k))
            .collect()
    };
    let mut read: Vec<Result<Vec<f64>, usize>> = forms.iter().map(read).collect();
    let furthest = read
        .iter()
        .filter_map(|r| r.as_ref().err())
        .max()
        .copied()
        .unwrap_or(0);
    for (times, form) in read.iter_mut().zip(&forms) {
        if let Ok(times) = times {
            relative(times, matches!(form, Form::Clock | Form::Halves));
        }
    }
    let whole: Vec<Vec<f64>> = read.into_iter().filter_map(Result::ok).collect();
    let Some(first) = whole.first() else {
        return Err((furthest, "a time stamp of the form of the others"));
    };
    // A day and a month that could be exchanged: readings of one record follow each other forward
    // and closely.
    const CLOSER: f64 = 10.0;
    let widest = |times: &[f64]| {
        let steps = times.windows(2).map(|w| w[1] - w[0]);
        steps.fold(0.0, |most: f64, step| {
            if step < 0.0 {
                f64::INFINITY
            } else {
                most.max(step)
            }
        })
    };
    let best = whole
        .iter()
        .min_by(|a, b| widest(a).total_cmp(&widest(b)))
        .unwrap_or(first);
    let differs = |other: &Vec<f64>| other.iter().zip(best).any(|(a, b)| (a - b).abs() > 1e-6);
    if whole
        .iter()
        .any(|other| differs(other) && !(widest(other) > CLOSER * widest(best)))
    {
        return Err((
            0,
            "a time stamp whose day and month cannot be exchanged (YYYY-MM-DD)",
        ));
    }
    Ok(best.clone())
}

/// Times after the first; of a clock without dates the step back at midnight is one to the next
/// day.
fn relative(times: &mut [f64], of_day: bool) {
    let Some(&first) = times.first() else { return };
    let (mut before, mut days) = (first, 0.0);
    for time in times {
        let now = *time;
        if of_day && now < before - 0.5 * DAY_S {
            days += DAY_S;
        }
        before = now;
        // Whole microseconds: a difference of large numbers has no more.
        *time = ((now + days - first) * 1e6).round() / 1e6;
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "a test that fails should say where")]
    use super::*;

    #[test]
    fn the_forms_of_loggers_give_the_same_seconds() {
        for stamps in [
            ["2025-03-04T23:59:50", "2025-03-05T00:00:10"],
            ["2025-03-04 23:59:50", "2025-03-05 00:00:10"],
            ["20250304T235950", "20250305T000010"],
            ["2025-03-04T23:59:50Z", "2025-03-05T00:00:10Z"],
            ["2025-03-04T23:59:50+01:00", "2025-03-05T00:00:10+01:00"],
            ["04.03.2025 23:59:50", "05.03.2025 00:00:10"],
            ["04.03.25 23:59:50,000", "05.03.25 00:00:10,000"],
            ["2025/03/04 23:59:50.0", "2025/03/05 00:00:10.0"],
            ["03/14/2025 11:59:50 PM", "03/15/2025 12:00:10 AM"],
            ["04-Mar-2025 23:59:50", "05-Mar-2025 00:00:10"],
            ["23:59:50", "00:00:10"],
            ["11:59:50 PM", "12:00:10 AM"],
            ["24:59:50.0", "25:00:10.0"],
            ["59:50.5", "60:10.5"],
            ["03/14/2025 23:59:50:123", "03/15/2025 00:00:10:123"],
        ] {
            assert!(stamps.iter().all(|s| is_stamp(s)), "{stamps:?}");
            let found = seconds(&stamps).unwrap();
            assert!((found[1] - 20.0).abs() < 1e-6, "{stamps:?}: {found:?}");
        }
        assert_eq!(
            seconds(&["2025-01-01T00:00:00.25", "2025-01-01T00:00:01.5"]).unwrap(),
            [0.0, 1.25]
        );
        // The month or the day: nothing turns on it within one day, all does over the next.
        assert_eq!(
            seconds(&["04/03/2025 10:00:00", "04/03/2025 10:00:20"]).unwrap(),
            [0.0, 20.0]
        );
        assert_eq!(
            seconds(&["04/03/2025 23:59", "05/03/2025 00:01"]).unwrap(),
            [0.0, 120.0]
        );
        assert!(
            seconds(&["04/03/2025", "05/04/2025"])
                .unwrap_err()
                .1
                .contains("exchanged")
        );
        assert_eq!(seconds(&["2025-03-04T10:00:00", "later"]).unwrap_err().0, 1);
        assert_eq!(
            seconds(&["04.03.2025 10:00:00,100", "04.03.2025 10:00:01,101"]).unwrap(),
            [0.0, 1.001]
        );
        assert!(
            ["2025-03-04", "04.03.2025", "3/14/2025"]
                .iter()
                .all(|s| is_date(s) && !is_time_of_day(s))
        );
        assert!(
            ["9:05", "09:05:00,25", "9:05 PM"]
                .iter()
                .all(|s| is_time_of_day(s) && !is_date(s))
        );
        assert!(
            !["2025-03-04 09:05", "12.5", "90:10"]
                .iter()
                .any(|s| is_time_of_day(s) || is_date(s))
        );
        assert!(
            !["12.5", "A-101", "1.5.2", "cell 3:4", "n/a"]
                .iter()
                .any(|s| is_stamp(s))
        );
    }
}
