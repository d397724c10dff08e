//! Rows of a table without a reading of their own: an instrument's overflow value, or a copy of an
//! earlier row. They are left out and counted in a warning, each by one plain rule. What
//! contradicts itself is an error that names the way out.

use crate::error::InputError;
use crate::row::Row;
use crate::table::TextTable;
use crate::warning::{SessionWarning, WarningKind};
use std::collections::{HashMap, HashSet};
use wcal_core::TransducerRow;
use wcal_core::order_statistics::extent;
use wcal_core::text::number;

/// No quantity of a calibration is this large: SCPI's 9.9e37 and 9.91e37, the largest float, 1e38
/// and their like.
const HUGE: f64 = 1e30;
/// A step between decades.
const DECADE: f64 = 10.0;
/// Fewer values beside a code say nothing of their column.
const MIN_OTHERS: usize = 4;
/// Rows of a block that repeats an earlier one: fewer agree by chance.
const MIN_BLOCK: usize = 6;
/// Longer tables come from programs, which paste nothing.
const MAX_ROWS: usize = 20_000;
/// A gauge with no more steps over what was read is coarse: its repeats agree. 12 bits.
const COARSE_STEPS: f64 = 4096.0;
/// Pairs of repeats that tell how often readings agree.
const MIN_PAIRS: usize = 8;
/// A block that chance gives so seldom is a copy.
const CHANCE: f64 = 1e-4;

/// Marks the rows in which an instrument wrote a code because it had no value: in columns that a
/// person `set`, and in those that were `read`.
pub(crate) fn overflow(
    table: &TextTable,
    [set, read]: [&[&str]; 2],
    out: &mut [bool],
) -> Result<Vec<SessionWarning>, InputError> {
    let mut warnings = Vec::new();
    let columns = set
        .iter()
        .map(|name| (name, true))
        .chain(read.iter().map(|name| (name, false)));
    for (name, by_hand) in columns {
        let values = column(table, name)?;
        let mut coded = 0;
        for code in codes(&values, by_hand) {
            let rows: Vec<usize> = (0..out.len())
                .filter(|&k| values[k] == Some(code))
                .collect();
            let shown = if code.abs() >= 1e12 {
                format!("{code:e}")
            } else {
                code.to_string()
            };
            const SAYS: &str = "is an overflow value of the instrument; left out as missing";
            let text = format!("{name} {shown} in {} row(s) {SAYS}", rows.len());
            warnings.push(left_out(table, &rows, text)?);
            rows.iter().for_each(|&k| out[k] = true);
            coded += rows.len();
        }
        // Codes in most rows are a dead instrument and no gaps.
        if 2 * coded > out.len() {
            let found = format!("overflow values in {coded} of {} rows", out.len());
            return Err(InputError::new(&table.file, "readings in most rows", found).field(*name));
        }
    }
    Ok(warnings)
}

/// Marks the rows that are copies. Readings of a `gauge` agree by themselves as often as its
/// repeats do; none where a row holds too much to agree by chance.
pub(crate) fn copied(
    table: &TextTable,
    gauge: Option<&str>,
    out: &mut [bool],
) -> Result<Option<SessionWarning>, InputError> {
    let kept: Vec<usize> = (0..out.len()).filter(|&k| !out[k]).collect();
    let readings = gauge.map(|name| column(table, name)).transpose()?;
    let coarse = readings.is_some_and(|values| is_coarse(kept.iter().filter_map(|&k| values[k])));
    let mut again = if kept.len() > MAX_ROWS {
        Vec::new()
    } else {
        copies(table, &kept)
    };
    if coarse {
        // Each block by itself: it could begin with any two repeats of a place.
        let repeats = gauge.and_then(|name| agreement(table, name, &kept, again.len()));
        let seldom = |block: &[(usize, usize)]| {
            repeats.is_some_and(|(pairs, share)| share.powi(block.len() as i32) * pairs <= CHANCE)
        };
        let blocks = again.chunk_by(|a, b| a.0 + 1 == b.0 && a.1 == b.1);
        again = blocks
            .filter(|block| seldom(block))
            .flatten()
            .copied()
            .collect();
    }
    let again: Vec<usize> = again.into_iter().map(|(k, _)| k).collect();
    if again.is_empty() {
        return Ok(None);
    }
    again.iter().for_each(|&k| out[k] = true);
    let (count, of) = (again.len(), kept.len());
    let text = format!("{count} of {of} rows are copies of others; counted once, left out");
    left_out(table, &again, text).map(Some)
}

/// Numbers of a column; none in each row where the table does not have it.
fn column(table: &TextTable, name: &str) -> Result<Vec<Option<f64>>, InputError> {
    Row::all(table).map(|row| row.number(name)).collect()
}

fn left_out(table: &TextTable, rows: &[usize], text: String) -> Result<SessionWarning, InputError> {
    let points = rows
        .iter()
        .map(|&k| Row::new(table, k).point_or_order())
        .collect::<Result<_, _>>()?;
    let lines = rows.iter().map(|&k| table.rows[k].0).collect();
    Ok(SessionWarning::new(&table.file, WarningKind::LeftOut(points), text).at(lines))
}

/// One of the numbers that instruments use as codes: huge, nines, an end of a converter's range, or
/// a power-up value; a power of ten is [`round`].
fn usual(value: f64) -> bool {
    let size = value.abs();
    let digits: Vec<char> = format!("{size}")
        .chars()
        .filter(char::is_ascii_digit)
        .collect();
    // Campbell's loggers have another digit before them: 7999, -6999.
    let nines = digits.len() >= 3
        && digits
            .iter()
            .skip(usize::from(digits.len() > 3))
            .all(|d| *d == '9');
    // Ends of 7 to 32 bits: 127, 128, 255, ..., 32767, 8388607, 4294967295.
    let end = (7..=32).any(|bits| [2f64.powi(bits), 2f64.powi(bits) - 1.0].contains(&size));
    // DS18B20 after power-up reads 85; absolute zero is no reading.
    size >= HUGE || nines || end || value == 85.0 || value == -273.15
}

/// A power of ten from 1e3 on, as -1000000 of measuring amplifiers. Series in decades have them as
/// readings.
fn round(value: f64) -> bool {
    let power = value.abs().log10();
    power > 2.5 && 10f64.powi(power.round() as i32) == value.abs()
}

/// The codes of a column: usual ones that lie further from its other values than these from each
/// other (round ones, ten times as far), in half of the rows at most. What a person `set` is a code
/// only where it is no quantity.
fn codes(values: &[Option<f64>], set: bool) -> Vec<f64> {
    let far = |code: f64| {
        // Other round values may be readings, as in series of decades.
        let others = values
            .iter()
            .flatten()
            .filter(|v| !usual(**v) && v.abs() != code.abs());
        let [low, high] = extent(others.clone().copied());
        let times = if usual(code) { 1.0 } else { DECADE };
        others.count() >= MIN_OTHERS && (low - code).max(code - high) > times * (high - low)
    };
    let known = |code: f64| usual(code) || round(code);
    let few = |code: f64| 2 * values.iter().filter(|v| **v == Some(code)).count() <= values.len();
    let is_code =
        |code: &f64| code.abs() >= HUGE || (!set && known(*code) && far(*code) && few(*code));
    let mut found: Vec<f64> = values.iter().flatten().copied().filter(is_code).collect();
    found.sort_by(f64::total_cmp);
    found.dedup();
    found
}

/// Whether readings are whole multiples of a step of their display, with few steps between the
/// lowest and the highest.
fn is_coarse(readings: impl Iterator<Item = f64> + Clone) -> bool {
    let [low, high] = extent(readings.clone());
    let unit = 10f64.powf(((high - low) / COARSE_STEPS).log10().ceil());
    !(high > low)
        || readings
            .into_iter()
            .all(|v| (v / unit - (v / unit).round()).abs() < 1e-6)
}

/// Pairs of readings of the gauge at one place, and how often they agree, copies and their sources
/// apart; none where few are repeats.
fn agreement(table: &TextTable, gauge: &str, kept: &[usize], copies: usize) -> Option<(f64, f64)> {
    let without = ["point", "t_s", gauge].map(|name| table.place(name));
    let mut places: HashMap<Vec<&str>, HashMap<Option<&str>, usize>> = HashMap::new();
    for &k in kept {
        let cells = &table.rows[k].1;
        let set = cells
            .iter()
            .enumerate()
            .filter(|(column, _)| !without.contains(&Some(*column)));
        let reading = without[2].map(|column| &cells[column]);
        *places
            .entry(set.map(|(_, cell)| cell).collect())
            .or_default()
            .entry(reading)
            .or_default() += 1;
    }
    let pairs = |count: usize| count * (count - 1) / 2;
    let all: usize = places
        .values()
        .map(|readings| pairs(readings.values().sum()))
        .sum();
    let alike: usize = places
        .values()
        .flat_map(HashMap::values)
        .map(|count| pairs(*count))
        .sum();
    let [others, alike] = [all, alike].map(|count| count.saturating_sub(copies));
    (others >= MIN_PAIRS).then(|| (all as f64, (alike + 1) as f64 / (others + 2) as f64))
}

/// The rows of `kept` that repeat an earlier one in every cell: with its point number or its time,
/// or in a block of rows that follow each other as they do there; each with how far before it that
/// row stands.
fn copies(table: &TextTable, kept: &[usize]) -> Vec<(usize, usize)> {
    let [point, time] = ["point", "t_s"].map(|name| table.place(name));
    let cells = |k: usize, without: Option<usize>| -> Vec<&str> {
        let all = table.rows[k].1.iter().enumerate();
        all.filter(|(column, _)| Some(*column) != without)
            .map(|(_, cell)| cell)
            .collect()
    };
    let rows: Vec<Vec<&str>> = kept.iter().map(|&k| cells(k, point)).collect();
    let (mut first, mut whole) = (HashMap::new(), HashSet::new());
    let mut copied = vec![0; rows.len()];
    // Each row of a block is a copy of the one that stands so many rows before it.
    let (mut block, mut back) = (0..0, 0);
    for (k, row) in rows.iter().enumerate() {
        let before = k - *first.entry(row).or_insert(k);
        let goes_on = back > 0 && rows[k - back] == *row;
        (block, back) = match (goes_on, before) {
            (true, _) => (block.start..k + 1, back),
            (false, 0) => (k..k, 0),
            (false, before) => (k..k + 1, before),
        };
        if block.len() >= MIN_BLOCK {
            copied[block.clone()].fill(back);
        }
        let timed = time.is_some_and(|column| !table.rows[kept[k]].1[column].is_empty());
        let again = !whole.insert(cells(kept[k], None)) || timed && before > 0;
        if again && copied[k] == 0 {
            copied[k] = before;
        }
    }
    kept.iter()
        .copied()
        .zip(copied)
        .filter(|(_, back)| *back > 0)
        .collect()
}

/// Two columns that stand in each other's place from some row on: the settings of the rows before
/// are read in the other column then, to the last digit, and no longer in their own.
pub(crate) fn exchanged(table: &TextTable, [set, read]: [&str; 2]) -> Result<(), InputError> {
    let columns = [column(table, set)?, column(table, read)?];
    for [own, other] in [[0, 1], [1, 0]] {
        let bits = |k: usize, column: usize| columns[column][k].map(f64::to_bits);
        let mut before: HashSet<Option<u64>> = HashSet::new();
        let rows = table.rows.len();
        // Where the columns are exchanged, a value stands in its own column for the first time and
        // in the other again.
        let first = (0..rows).find(|&k| {
            let begins = k >= MIN_BLOCK
                && !before.contains(&bits(k, own))
                && before.contains(&bits(k, other));
            before.insert(bits(k, own));
            begins
        });
        let Some(first) = first.filter(|first| rows - first >= MIN_BLOCK) else {
            continue;
        };
        let settings: HashSet<Option<u64>> = (0..first).map(|k| bits(k, own)).collect();
        let of = |rows: std::ops::Range<usize>, column: usize| {
            rows.filter(|&k| settings.contains(&bits(k, column)))
                .count()
        };
        let after = rows - first;
        // Settings repeat, and readings seldom meet one.
        if 2 * settings.len() <= first
            && of(first..rows, other) == after
            && 10 * of(first..rows, own) <= after
            && 10 * of(0..first, other) <= first
        {
            let found = format!(
                "them in the other column, {}, in all {after} rows from there on",
                [set, read][other]
            );
            let error = InputError::new(&table.file, "the settings of the rows before", found);
            return Err(error
                .at(table.rows[first].0)
                .field([set, read][own])
                .hint("the two columns are exchanged there?"));
        }
    }
    Ok(())
}

/// A clock that stands still, or a direction that says the opposite of the moves at rows before and
/// after which the position rises, or falls. At the turns, and where targets are approached singly,
/// nothing is contradicted, nor by a table whose moves or directions have one sign alone.
pub(crate) fn contradiction(
    file: &str,
    setting: &str,
    rows: &[TransducerRow],
) -> Result<(), InputError> {
    if let [first, _, ..] = rows
        && let Some(t_s) = first.t_s
        && rows.iter().all(|r| r.t_s == first.t_s)
    {
        let found = format!("t_s {} in all {} rows", number(t_s, 12), rows.len());
        let error = InputError::new(file, "a time that runs", found)
            .at(first.line)
            .field("t_s");
        return Err(
            error.hint("leave --time out at import: the order of the rows then stands for it")
        );
    }
    let way = |w: &[TransducerRow]| {
        let rises = w[1].stimulus.partial_cmp(&w[0].stimulus);
        f64::from(rises.map_or(0, |order| order as i8))
    };
    let seen: Vec<(usize, f64, f64)> = rows
        .windows(3)
        .filter(|w| way(&w[..2]) * way(&w[1..]) > 0.0)
        .filter_map(|w| Some((w[1].line, way(w), w[1].direction?)))
        .collect();
    let both = |f: fn(&(usize, f64, f64)) -> f64| {
        seen.iter().any(|s| f(s) > 0.0) && seen.iter().any(|s| f(s) < 0.0)
    };
    let against: Vec<_> = seen
        .iter()
        .filter(|(_, way, direction)| way * direction < 0.0)
        .collect();
    // All or nearly all the wrong way round, or few among many that agree; what lies between is
    // another convention.
    let (count, of) = (against.len(), seen.len());
    let named = both(|s| s.1) && both(|s| s.2) && (4 * count <= of || 10 * count >= 9 * of);
    let Some((line, _, direction)) = against.first().filter(|_| named) else {
        return Ok(());
    };
    let found =
        format!("direction {direction} against {setting} ({count} of {of} rows within a stroke)");
    let expected =
        format!("a direction that agrees with {setting}: 1 where it rises, -1 where it falls");
    let hint = "at import --direction 'COLUMN*-1' turns it; or leave --direction out";
    Err(InputError::new(file, expected, found)
        .at(*line)
        .field("direction")
        .hint(hint))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "a test that fails should say where")]
    use super::*;
    use crate::table::read_own;

    /// Lines of the rows that are left out as copies.
    fn copied_lines(text: &str, gauge: Option<&str>) -> Vec<usize> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("t.csv");
        std::fs::write(&path, text).unwrap();
        let table = read_own(&path, "t.csv").unwrap();
        let mut out = vec![false; table.rows.len()];
        copied(&table, gauge, &mut out).unwrap();
        (0..out.len())
            .filter(|&k| out[k])
            .map(|k| table.rows[k].0)
            .collect()
    }

    /// `sweeps` of eleven settings with numbers of points; `noise` counts of scatter in the last of
    /// `digits`, another in each sweep.
    fn sweeps(sweeps: usize, noise: f64, digits: usize) -> Vec<String> {
        let scatter = |k: usize| ((k as f64 * 12.9898).sin() * 43758.5453).rem_euclid(1.0) - 0.5;
        let last = 10f64.powi(-(digits as i32));
        let of = |k: usize| {
            let x = (k % 11) as f64;
            format!("{x},{:.digits$}", 0.2 * x + 3.4 * noise * last * scatter(k))
        };
        (0..11 * sweeps).map(of).collect()
    }

    fn table(rows: &[String], again: impl IntoIterator<Item = usize>) -> String {
        let all = rows.iter().chain(again.into_iter().map(|k| &rows[k]));
        let lines: String = all
            .enumerate()
            .map(|(k, row)| format!("{k},{row}\n"))
            .collect();
        "point,stimulus,response\n".to_owned() + &lines
    }

    #[test]
    fn pasted_sweeps_are_found_and_honest_repeats_stay() {
        let read = |text: String| copied_lines(&text, Some("response"));
        assert_eq!(
            read(table(&sweeps(1, 4.0, 5), (0..11).chain(0..11))),
            (13..35).collect::<Vec<_>>()
        );
        // One of three sweeps pasted once more, and too few rows of it.
        assert_eq!(
            read(table(&sweeps(3, 4.0, 5), 11..22)),
            (35..46).collect::<Vec<_>>()
        );
        assert!(read(table(&sweeps(3, 4.0, 5), 11..16)).is_empty());
        // Repeats with noise, and repeats of a gauge whose noise hides below its last digit.
        assert!(read(table(&sweeps(6, 4.0, 5), [])).is_empty());
        assert!(read(table(&sweeps(1, 0.0, 2), 0..11)).is_empty());
        assert!(read(table(&sweeps(6, 0.2, 2), [])).is_empty());
        // Four decimals are coarse, but repeats that scatter over several of them do not agree
        // eight times in a row; those of a quiet gauge may.
        assert_eq!(
            read(table(&sweeps(3, 8.0, 3), 11..19)),
            (35..43).collect::<Vec<_>>()
        );
        assert!(read(table(&sweeps(3, 0.6, 3), 11..19)).is_empty());
        for (count, noise) in [(3, 8.0), (60, 0.15), (60, 0.3), (60, 0.6)] {
            assert!(
                read(table(&sweeps(count, noise, 3), [])).is_empty(),
                "{count} {noise}"
            );
        }
        // A time is read once.
        let timed = "point,t_s,response\n0,1.5,0.123456\n1,2.5,0.234567\n2,1.5,0.123456\n";
        assert_eq!(copied_lines(timed, Some("response")), [4]);
    }

    #[test]
    fn codes_are_told_from_readings_by_their_column() {
        let codes =
            |values: &[f64], set| codes(&values.iter().map(|v| Some(*v)).collect::<Vec<_>>(), set);
        let volts = [0.1, 0.2, 0.3, 0.4, 0.5];
        for code in [
            9.9e37,
            -9.9e37,
            1e38,
            3.4028234e38,
            999_999.0,
            9999.0,
            -127.0,
            32767.0,
            -1e6,
            1e10,
            -6999.0,
        ] {
            let with: Vec<f64> = volts.iter().copied().chain([code]).collect();
            assert_eq!(codes(&with, false), [code]);
        }
        // In range, or no further out than the others are wide: a reading.
        assert!(codes(&[-180.0, -127.0, -60.0, 20.0, 50.0], false).is_empty());
        assert!(codes(&[2e5, 4e5, 6e5, 8e5, 999_999.0, 1.2e6], false).is_empty());
        assert!(
            codes(
                &[10.0, 20.0, 50.0, 100.0, 200.0, 500.0, 1000.0, 2000.0],
                false
            )
            .is_empty()
        );
        // An unusual number, however far out, is a matter of the noise.
        assert!(codes(&[0.1, 0.2, 0.3, 0.4, 5000.0], false).is_empty());
        // Loads in powers of two are set so; a huge number is none whatever stands beside it.
        let powers: Vec<f64> = (0..13).map(|k| 2f64.powi(k)).collect();
        assert!(codes(&powers, true).is_empty());
        assert_eq!(codes(&[0.1, 9.9e37], true), [9.9e37]);
        // Half of a column and more is its content.
        assert!(
            codes(
                &[0.1, 0.2, 0.3, 0.4, 9999.0, 9999.0, 9999.0, 9999.0, 9999.0],
                false
            )
            .is_empty()
        );
    }

    #[test]
    fn columns_that_change_places_are_named_and_readings_that_meet_a_setting_are_not() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("t.csv");
        let said = |row: &dyn Fn(usize, f64, f64) -> [f64; 2]| {
            let scatter =
                |k: usize| ((k as f64 * 12.9898).sin() * 43758.5453).rem_euclid(1.0) - 0.5;
            let lines = (0..44).map(|k| {
                let x = 10.0 * (k % 11) as f64;
                let [a, b] = row(k, x, 0.9 * x + 8.0 + scatter(k));
                format!("{a},{b}\n")
            });
            std::fs::write(
                &path,
                "stimulus,response\n".to_owned() + &lines.collect::<String>(),
            )
            .unwrap();
            let table = read_own(&path, "t.csv").unwrap();
            exchanged(&table, ["stimulus", "response"])
                .err()
                .map(|e| e.to_string())
        };
        let swapped = said(&|k, x, y| if k < 22 { [x, y] } else { [y, x] }).unwrap();
        assert!(
            swapped.contains("row at line 24, field stimulus")
                && swapped.contains("response, in all 22 rows"),
            "{swapped}"
        );
        let first = said(&|k, x, y| if k < 22 { [y, x] } else { [x, y] }).unwrap();
        assert!(first.contains("row at line 24, field response"), "{first}");
        // Nothing exchanged, a coarse gauge of a slope of one, settings that are readings
        // themselves, and new settings in the second half.
        assert_eq!(said(&|_, x, y| [x, y]), None);
        assert_eq!(said(&|_, x, _| [x, x]), None);
        assert_eq!(
            said(&|k, x, y| if k < 22 {
                [x + 1e-3 * y, y]
            } else {
                [y, x + 1e-3 * y]
            }),
            None
        );
        assert_eq!(
            said(&|k, x, _| if k < 22 {
                [x, x + 10.0]
            } else {
                [x + 5.0, x + 10.0]
            }),
            None
        );
    }

    /// `cycles` of five positions up and down; `direction` by cycle and way.
    fn axis(cycles: usize, direction: impl Fn(usize, f64) -> f64) -> Vec<TransducerRow> {
        let of = |k: usize| {
            let (cycle, place) = (k / 10, k % 10);
            let (x, way) = if place < 5 {
                (place, 1.0)
            } else {
                (9 - place, -1.0)
            };
            TransducerRow {
                source: "t.csv".to_owned(),
                line: k + 2,
                point: k as i64,
                role: wcal_core::Role::Calibration,
                stimulus: x as f64,
                stimulus_sd: None,
                response: 0.0,
                t_s: None,
                temperature_degc: None,
                direction: Some(direction(cycle, way)),
                replicate: None,
                covariates: Vec::new(),
            }
        };
        (0..10 * cycles).map(of).collect()
    }

    #[test]
    fn a_direction_against_the_moves_is_named_and_other_conventions_are_not() {
        let named = |rows: &[TransducerRow]| {
            contradiction("t.csv", "commanded_mm", rows)
                .err()
                .map(|e| e.to_string())
        };
        assert!(named(&axis(3, |_, way| way)).is_none());
        assert!(
            named(&axis(3, |_, way| -way))
                .unwrap()
                .contains("18 of 18 rows")
        );
        let one = named(&axis(5, |cycle, way| if cycle == 3 { -way } else { way })).unwrap();
        assert!(one.contains("6 of 30 rows"), "{one}");
        // Approached from below always.
        assert!(named(&axis(3, |_, _| 1.0)).is_none());
        // Forward and backward readings listed in rising order.
        let mut list = axis(2, |_, way| way);
        list.sort_by(|a, b| {
            let ways = b.direction.partial_cmp(&a.direction).unwrap();
            ways.then(a.stimulus.total_cmp(&b.stimulus))
        });
        assert!(named(&list).is_none());
    }
}
