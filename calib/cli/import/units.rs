//! Units of the foreign table: those that stand in its names and below its header become the
//! session's.

use super::noticed::Noticed;
use crate::column_words::quoted;
use anyhow::{Result, bail};
use wcal_core::text::number;
use wcal_session::{
    Relation, TextTable, bracketed, is_unit, possible_units, relation, stated_unit, unit_in_name,
};

/// Columns of a session whose unit is fixed, and the options that take them.
const FIXED: [(&str, &str, &str); 4] = [
    ("t_s", "s", "--time"),
    ("commanded_mm", "mm", "--commanded"),
    ("measured_mm", "mm", "--measured"),
    ("temperature_degc", "degC", "--temperature"),
];

/// Factor from the unit that the table states of a column, in its name or below the header, to that
/// of the session's column; 1 where it states none.
///
/// # Errors
/// Where it states two, or one that measures something else.
pub(super) fn factor(
    table: &TextTable,
    index: usize,
    name: &str,
    noticed: &mut Noticed,
) -> Result<f64> {
    let Some((_, to, option)) = FIXED.iter().find(|(fixed, ..)| *fixed == name) else {
        return Ok(1.0);
    };
    let (file, column, below) = (&table.file, &table.columns[index], below(table, index)?);
    let mut found: Option<(&str, f64)> = None;
    // A temperature in another unit is refused wherever that stands.
    let last = column.rsplit(['_', ' ']).next().filter(|unit| {
        name == "temperature_degc"
            && ["K", "degF"]
                .iter()
                .any(|t| matches!(relation(unit, t), Relation::Times(_)))
    });
    let stated = unit_in_name(column, to)
        .into_iter()
        .chain(stated_unit(column))
        .chain(last)
        .chain(below);
    for unit in stated {
        match (relation(unit, to), found) {
            (Relation::Times(factor), None) => found = Some((unit, factor)),
            (Relation::Times(factor), Some((other, same))) if factor != same => {
                bail!("{file}, field {column}: expected one unit, found {other} and {unit}")
            }
            (Relation::Other, _) => {
                // Temperatures have another zero.
                let way = match name {
                    "temperature_degc" => "convert the column".to_owned(),
                    _ => format!("{option} '{column}*FACTOR' takes another unit"),
                };
                bail!("{file}, field {column}: expected {to}, found {unit} ({way})")
            }
            _ => {}
        }
    }
    match found {
        Some((unit, factor)) if factor != 1.0 => {
            noticed.remarks.push(format!(
                "{file}: {column} is in {unit}; times {} it is in {to}",
                number(factor, 12)
            ));
            Ok(factor)
        }
        None if name == "t_s" => question(table, index, noticed).map(|()| 1.0),
        _ => Ok(1.0),
    }
}

/// What a table says of a column's unit below its header, or in each row in a column of units
/// beside it.
///
/// # Errors
/// Where rows have several.
fn below(table: &TextTable, index: usize) -> Result<Option<&str>> {
    let below = table
        .units
        .get(index)
        .map(String::as_str)
        .filter(|unit| !unit.is_empty());
    let named = |name: &String| {
        ["unit", "einheit"]
            .iter()
            .any(|word| name.to_lowercase().contains(word))
    };
    if below.is_some() || !table.columns.get(index + 1).is_some_and(named) {
        return Ok(below);
    }
    let mut units = table
        .rows
        .iter()
        .map(|(line, cells)| (line, &cells[index + 1]));
    let first = units
        .next()
        .map(|(_, unit)| unit)
        .filter(|unit| is_unit(unit));
    if let Some((line, other)) = units.find(|(_, unit)| first.is_some_and(|first| first != *unit)) {
        let (file, column, first) = (
            &table.file,
            &table.columns[index],
            first.unwrap_or_default(),
        );
        bail!(
            "{file}, row at line {line}, field {column}: expected one unit, found {first} and {other}"
        );
    }
    Ok(first)
}

/// Times without a unit are taken as seconds, which is said; where they hardly are seconds, it is
/// asked.
///
/// # Errors
/// Where they can be none.
fn question(table: &TextTable, index: usize, noticed: &mut Noticed) -> Result<()> {
    /// Numbers of days since 1900 in spreadsheets: the years 1954 to 2119.
    const DAYS: std::ops::Range<f64> = 2e4..8e4;
    /// Seconds since 1970 stay below it for three thousand years.
    const MOST: f64 = 1e11;
    /// Seconds between readings that are long, and of a record that is.
    const LONG_S: [f64; 2] = [1e3, 86_400.0];
    let (file, column) = (&table.file, &table.columns[index]);
    // Time stamps have units of their own.
    let times: Vec<f64> = (0..table.rows.len())
        .filter_map(|row| table.number(row, index).ok()?)
        .collect();
    let mut steps: Vec<f64> = times
        .windows(2)
        .map(|w| (w[1] - w[0]).abs())
        .filter(|s| *s > 0.0)
        .collect();
    steps.sort_by(f64::total_cmp);
    let (Some(step), Some(first)) = (steps.get(steps.len() / 2), times.first()) else {
        return Ok(());
    };
    let [low, high] = times
        .iter()
        .fold([*first; 2], |[a, b], t| [a.min(*t), b.max(*t)]);
    let way = |factor: &str| format!("--time '{column}*{factor}'");
    if high > MOST {
        // Since 1970 about 1.7e12 ms, 1.7e15 us or 1.7e18 ns have passed.
        let power = if high < 1e14 {
            "0.001"
        } else if high < 1e17 {
            "1e-6"
        } else {
            "1e-9"
        };
        bail!(
            "{file}, field {column}: expected seconds, found {} (parts of a second since 1970? {})",
            number(high, 17),
            way(power)
        );
    }
    // Steps of whole quarters of an hour are those of a logger, in seconds.
    let whole = |unit: f64| times.iter().all(|t| (t - first) % unit == 0.0);
    let asked = if DAYS.contains(&low) && DAYS.contains(&high) && *step < 1e-2 {
        Some(format!("days? {}", way("86400")))
    } else if *step < 1e-3 {
        Some(format!("days ({}), hours ({})?", way("86400"), way("3600")))
    } else if *step >= LONG_S[0]
        && !whole(900.0)
        && whole(1.0)
        && (high - low > LONG_S[1] || whole(100.0))
    {
        Some(format!("milliseconds? {}", way("0.001")))
    } else {
        None
    };
    let taken = format!(
        "{file}: {column} names no unit, taken as seconds: readings {} s apart",
        number(*step, 4)
    );
    match asked {
        Some(asked) => noticed.warnings.push(format!("{taken}; {asked}")),
        None => noticed.remarks.push(taken),
    }
    Ok(())
}

/// Unit of the stimulus or the response: as stated, else as the table has it, else 1.
///
/// # Errors
/// Where the table has another one than is stated.
pub(super) fn signal(
    (option, stated): (&str, Option<&str>),
    column: Option<&str>,
    table: &TextTable,
    remarks: &mut Vec<String>,
) -> Result<String> {
    let taken = stated.unwrap_or("1").to_owned();
    let Some(column) = column
        .map(|text| table.asked(text))
        .transpose()?
        .filter(|c| c.factor.is_none())
    else {
        return Ok(taken);
    };
    let index = column.index;
    let (file, name) = (&table.file, &table.columns[index]);
    let sure = below(table, index)?.or_else(|| stated_unit(name));
    // A last word that is a unit may be one, and is where it is of one kind with what is stated:
    // `load_kN`.
    let last = possible_units(name).next().or_else(|| bracketed(name));
    let of_kind = |unit: &&str| {
        matches!(
            relation(unit, stated.unwrap_or_default()),
            Relation::Times(_)
        )
    };
    // Without a statement a symbol stands for itself: `load_N`, not `side_a`, `channel_A`, `time_h`.
    let symbol = |unit: &&str| {
        let plain = unit.len() > 1 || unit.chars().all(char::is_uppercase) && *unit != "A";
        stated.is_none() && bracketed(name).is_none() && plain
    };
    let found = sure.or(last.filter(|unit| of_kind(unit) || symbol(unit)));
    let Some(found) = found else {
        match (last, stated) {
            (unit, None) => remarks.push(format!(
                "{file}: no unit of {name} is stated, taken as 1 ({option}-unit {} states it)",
                unit.map_or("UNIT".to_owned(), quoted)
            )),
            (Some(unit), Some(stated)) if unit.len() > 1 && unit != stated => {
                remarks.push(format!(
                    "{file}: {name} is taken as {stated}, though its name ends with {unit}"
                ));
            }
            _ => {}
        }
        return Ok(taken);
    };
    let Some(stated) = stated else {
        remarks.push(format!(
            "{file}: {name} is in {found}, as the table says ({option}-unit states another)"
        ));
        return Ok(found.to_owned());
    };
    let error = |way: String| {
        bail!("{file}, field {name}: expected {stated} ({option}-unit), found {found} {way}")
    };
    match relation(found, stated) {
        Relation::Times(factor) if (factor - 1.0).abs() > 1e-9 => error(format!(
            "({option} '{name}*{}' converts it)",
            number(factor, 12)
        )),
        Relation::Other => error("in the table (another column, or another unit?)".to_owned()),
        Relation::Unknown if found != stated => {
            remarks.push(format!(
                "{file}: {name} is in {found} by the table, taken as {stated}"
            ));
            Ok(taken)
        }
        _ => Ok(taken),
    }
}

/// Whether a column's name says that it holds uncertainties: `u_load`, `U95_ref`, `u(m)`, `sd`,
/// `std_dev`, `Unsicherheit`. A voltage may be called `u_mv`.
pub(super) fn is_uncertainty(name: &str) -> bool {
    let name = name.to_lowercase();
    let words: Vec<&str> = name
        .split(|c: char| !c.is_alphanumeric())
        .filter(|word| !word.is_empty())
        .collect();
    let word = |w: &&str| {
        matches!(
            *w,
            "sd" | "std" | "stdev" | "stddev" | "sigma" | "unc" | "stderr" | "se"
        )
    };
    let volts = |w: &&str| matches!(*w, "v" | "mv" | "uv" | "kv" | "volt" | "volts");
    let of_a_quantity = match words[..] {
        ["u" | "u95", .., last] => !volts(&last),
        _ => false,
    };
    [
        "uncert",
        "unsicher",
        "std_dev",
        "standard deviation",
        "standardabw",
    ]
    .iter()
    .any(|w| name.contains(w))
        || words.iter().any(word)
        || of_a_quantity
}
