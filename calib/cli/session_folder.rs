//! The argument SESSION: a folder, not the table that may become one.

use crate::column_words::{option_of, quoted};
use anyhow::{Result, anyhow, bail};
use std::fmt::Write as _;
use std::path::Path;
use wcal_session::{Relation, TextTableLayout, read_table_text, relation, unit_in_name};

/// Columns that an import takes by their names, or that say when or how and not what was measured.
const BESIDE: &[&str] = &[
    "point",
    "role",
    "stimulus",
    "response",
    "t_s",
    "direction",
    "temperature_degc",
    "replicate",
    "cycle",
    "samples",
];

/// Refuses a table where a session is wanted, with the command line that makes one of it.
///
/// # Errors
/// Where `session` is a file other than `session.toml`.
pub(crate) fn expect_session(session: &Path, command: &str) -> Result<()> {
    let shown = session.display();
    if session.is_dir() || !session.exists() {
        return match session.join("session.toml").exists() {
            true => Ok(()),
            false => Err(no_session(session, command)),
        };
    }
    if !session.is_file() || session.file_name().is_some_and(|n| n == "session.toml") {
        return Ok(());
    }
    if let Some(folder) = session
        .parent()
        .filter(|f| f.join("session.toml").is_file())
    {
        let folder = if folder.as_os_str().is_empty() {
            Path::new(".")
        } else {
            folder
        };
        bail!(
            "{shown}: expected a session folder, found a table of one; use wcal {command} {}",
            folder.display()
        );
    }
    let table = read_table_text(session, &TextTableLayout::default())?;
    let mut lines = table.text.lines();
    let (header, rows) = (lines.next().unwrap_or_default(), lines.collect::<Vec<_>>());
    bail!(
        "{shown}: expected a session folder, found a file; to make a session of a table use wcal import, e.g.\n  {}\n  wcal {command} {}",
        import_line(session, header, &rows),
        target(session)
    )
}

/// Where there is no session: the one that is meant, if any is below.
fn no_session(folder: &Path, command: &str) -> anyhow::Error {
    let found = if folder.exists() {
        "a folder without session.toml"
    } else {
        "no such folder"
    };
    let below = std::fs::read_dir(folder)
        .into_iter()
        .flatten()
        .flatten()
        .map(|entry| entry.path());
    let meant = below
        .filter(|path| path.join("session.toml").is_file())
        .min();
    let way_out = meant.map_or_else(
        || "wcal import makes one of a table, wcal stage-sweep on the bench".to_owned(),
        |session| format!("wcal {command} {}", quoted(&session.display().to_string())),
    );
    anyhow!(
        "{}: expected a session folder, with session.toml, found {found}; {way_out}",
        folder.display()
    )
}

/// `cell.csv` becomes the session `cell`.
fn target(table: &Path) -> String {
    let name = table
        .file_stem()
        .map_or_else(|| "session".into(), |s| s.to_string_lossy().into_owned());
    if Path::new(&name).exists() {
        name + "-session"
    } else {
        name
    }
}

/// Whether two columns are one length, as commanded and as measured: both in units of length, with a
/// slope of 1 to a twentieth.
fn is_axis(names: [&str; 2], pairs: &[[f64; 2]]) -> bool {
    let in_mm = |name: &str| match relation(unit_in_name(name, "mm")?, "mm") {
        Relation::Times(factor) => Some(factor),
        _ => None,
    };
    let [Some(from), Some(to)] = names.map(in_mm) else {
        return false;
    };
    let mean = |k: usize| pairs.iter().map(|p| p[k]).sum::<f64>() / pairs.len() as f64;
    let [x, y] = [mean(0), mean(1)];
    // Products of deviations from the means: their ratio is the slope of least squares.
    let product = |k: usize| {
        pairs
            .iter()
            .map(|p| (p[0] - x) * (p[k] - [x, y][k]))
            .sum::<f64>()
    };
    (product(1) / product(0) * to / from - 1.0).abs() < 0.05
}

/// Kind of the session that a table would become, as its columns tell; none where they do not.
pub(crate) fn kind_of_table(table: &Path) -> Option<&'static str> {
    let read = read_table_text(table, &TextTableLayout::default()).ok()?;
    let mut lines = read.text.lines();
    let (header, rows) = (lines.next()?, lines.collect::<Vec<_>>());
    let line = import_line(table, header, &rows);
    let is_whole = !line.contains(" STIMULUS") && !line.contains(" RESPONSE");
    let is = |kind: &&str| is_whole && line.contains(&format!(" --kind {kind} "));
    ["axis", "whisker", "transducer"].into_iter().find(is)
}

/// The command that imports a table with this header and these rows; what they do not state is
/// written in capitals.
fn import_line(table: &Path, header: &str, rows: &[&str]) -> String {
    let separator = ['\t', ';', ',']
        .into_iter()
        .max_by_key(|s| header.matches(*s).count())
        .unwrap_or(',');
    let cells: Vec<&str> = header.split(separator).map(str::trim).collect();
    let number = |cell: &str| cell.trim().replace(',', ".").parse::<f64>().ok();
    let is_number = |cell: &&str| number(cell).is_some();
    let headless = cells.iter().all(is_number);
    let row: Vec<&str> = rows.first().map_or_else(Vec::new, |row| {
        row.split(separator).map(str::trim).collect()
    });
    let has = |name: &str| cells.contains(&name);
    let mut line = format!("wcal import {}", quoted(&table.display().to_string()));
    // With a header both are found by the names of the columns, below lines of units, too.
    let mark = match separator {
        ';' => " --separator semicolon",
        '\t' => " --separator tab",
        _ => "",
    };
    if headless {
        line += mark;
        if separator != ',' && cells.iter().any(|cell| cell.contains(',')) {
            line += " --decimal-comma";
        }
    }
    let measures = |k: usize| {
        let name = cells[k];
        let beside = name.is_empty() || BESIDE.contains(&name) || option_of(name).is_some();
        !headless && !beside && row.get(k).is_none_or(is_number)
    };
    let measured: Vec<usize> = (0..cells.len()).filter(|k| measures(*k)).collect();
    let axis = match measured[..] {
        [a, b] => {
            let pair = |row: &&str| {
                let cells: Vec<&str> = row.split(separator).collect();
                Some([number(cells.get(a)?)?, number(cells.get(b)?)?])
            };
            let pairs: Vec<[f64; 2]> = rows.iter().filter_map(pair).collect();
            let named = |names: &[&str; 2]| *names == ["commanded_mm", "measured_mm"];
            Some([cells[a], cells[b]]).filter(|names| named(names) || is_axis(*names, &pairs))
        }
        _ => None,
    };
    if let Some(names) = axis {
        let [commanded, measured] = names.map(quoted);
        line += &format!(" --kind axis --commanded {commanded} --measured {measured}");
    } else if cells.iter().any(|c| c.starts_with("fbg_1_")) {
        line += " --kind whisker --model WHISKER.toml";
    } else {
        let mut values = measured.into_iter().map(|k| cells[k]);
        let mut column = |own: &str, unknown: &str| {
            if has(own) {
                own.to_owned()
            } else {
                quoted(values.next().unwrap_or(unknown))
            }
        };
        if headless {
            line += " --columns STIMULUS,RESPONSE";
        }
        let (stimulus, response) = (
            column("stimulus", "STIMULUS"),
            column("response", "RESPONSE"),
        );
        let _ = write!(
            line,
            " --kind transducer --stimulus {stimulus} --response {response} --model linear"
        );
    }
    for name in cells
        .iter()
        .filter(|name| !headless && !BESIDE.contains(name))
    {
        let taken = option_of(name).filter(|option| !line.contains(option));
        line += &taken.map_or_else(String::new, |option| format!(" {option} {}", quoted(name)));
    }
    format!("{line} --out {}", quoted(&target(table)))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "a test that fails should say where")]
    use super::{expect_session, import_line};

    #[test]
    fn a_folder_that_is_no_session_is_named_with_the_one_below() {
        let place = tempfile::tempdir().unwrap();
        let said = |path: &std::path::Path| expect_session(path, "verify").unwrap_err().to_string();
        assert!(said(&place.path().join("none")).contains("no such folder"));
        let session = place.path().join("own");
        std::fs::create_dir(&session).unwrap();
        std::fs::write(session.join("session.toml"), "").unwrap();
        assert!(said(place.path()).contains(&format!("wcal verify {}", session.display())));
        assert!(
            expect_session(&session, "verify").is_ok(),
            "negative control"
        );
    }

    #[test]
    fn two_lengths_of_slope_one_are_an_axis() {
        let named = |header: &str, slope: f64| {
            let row = |x: f64| format!("{x},{},20.1,{}", slope * x + 0.003, 2.0 * x);
            let rows: Vec<String> = (0..9).map(|k| row(f64::from(k))).collect();
            let rows: Vec<&str> = rows.iter().map(String::as_str).collect();
            import_line("a.csv".as_ref(), header, &rows)
        };
        let line = |slope: f64| named("target_mm,encoder_mm,T_C,t_s", slope);
        let axis = line(1.0);
        assert!(
            axis.contains(
                "--kind axis --commanded target_mm --measured encoder_mm --temperature T_C"
            ),
            "{axis}"
        );
        assert!(!axis.contains("--model"));
        assert!(named("set [um],laser_um,T_C,t_s", 1.0).contains("--kind axis"));
        assert!(named("set_mm,laser_um,T_C,t_s", 1e3).contains("--kind axis"));
        for other in [line(1.2), named("set_mm,laser_um,T_C,t_s", 1.0)] {
            assert!(
                other.contains("--kind transducer"),
                "negative control: {other}"
            );
        }
    }

    #[test]
    fn separators_are_left_to_the_header() {
        let line = |header: &str, first: &str| import_line("t.csv".as_ref(), header, &[first]);
        assert!(!line("Kraft;Signal;T_C", "N;mV;C").contains("--separator"));
        assert!(
            line("1;2,5;3", "2;3,5;4").contains("--separator semicolon --decimal-comma"),
            "negative control"
        );
    }
}
