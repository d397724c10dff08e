//! Every column of every table that a command reads, with numbers that no bench writes: taken as
//! they are, or refused by file and column. One such cell ended four commands by an abort.

use super::limits::{in_parallel, limited, sound};
use super::*;
use crate::support::copy::copy_folder;

/// What is put in place of a cell.
const CELLS: [&str; 15] = [
    "",
    "x",
    "NaN",
    "inf",
    "-inf",
    "1e308",
    "-1e308",
    "1e-308",
    "9.9e37",
    "1e18",
    "1e9",
    "-1e9",
    "4294967296",
    "0",
    "-1",
];

/// A table, and a command that reads it in its folder.
struct Table {
    file: &'static str,
    text: String,
    arguments: &'static str,
    /// The commands hold it against the whole session, too: what is refused may be so under another
    /// column's name.
    beside: &'static [&'static str],
}

impl Table {
    fn columns(&self) -> Vec<String> {
        self.text
            .lines()
            .next()
            .unwrap()
            .split(',')
            .map(str::to_owned)
            .collect()
    }

    /// The table with one cell of its last row replaced.
    fn with(&self, column: usize, cell: &str) -> String {
        let mut lines: Vec<String> = self.text.lines().map(str::to_owned).collect();
        let last = lines.last_mut().unwrap();
        let mut cells: Vec<&str> = last.split(',').collect();
        cells[column] = cell;
        *last = cells.join(",");
        lines.join("\n") + "\n"
    }
}

/// Runs the command on the table with every cell of its last row replaced in turn; what a user may
/// not meet.
fn walk(place: &Path, table: &Table) -> Vec<String> {
    let columns = table.columns();
    let cases: Vec<(usize, &str)> = (0..columns.len())
        .flat_map(|column| CELLS.map(|cell| (column, cell)))
        .collect();
    let arguments: Vec<&str> = table.arguments.split(' ').collect();
    let run = |text: &str| {
        let own = tempfile::tempdir().unwrap();
        copy_folder(place, own.path());
        fs::write(own.path().join(table.file), text).unwrap();
        limited(own.path(), &arguments)
    };
    // Negative control: as it is, the command takes it.
    let good = run(&table.text);
    let text = sound(&good).unwrap_or_else(|why| panic!("{}: {why}", table.arguments));
    assert_ne!(good.status.code(), Some(1), "{}: {text}", table.arguments);
    in_parallel(&cases, |(column, cell)| {
        let name = &columns[*column];
        let shown = format!("{}: {} {name} = {cell:?}", table.arguments, table.file);
        let output = run(&table.with(*column, cell));
        let text = sound(&output).map_err(|why| format!("{shown}: {why}"))?;
        if output.status.code() != Some(1) {
            // No quantity of a table has these.
            let never = ["x", "NaN", "inf", "-inf", "1e308", "-1e308"].contains(cell);
            let free = matches!(name.as_str(), "role" | "batch");
            return if never && !free {
                Err(format!("{shown}: taken"))
            } else {
                Ok(())
            };
        }
        let named =
            text.contains(name.as_str()) || table.beside.iter().any(|other| text.contains(other));
        // A label of a point that is no longer there is the label's fault.
        let file = if text.contains("twin.csv") && name == "point" {
            "twin.csv"
        } else {
            table.file
        };
        if named && text.contains(file) {
            Ok(())
        } else {
            Err(format!("{shown}: not named: {text}"))
        }
    })
}

/// Columns of a whisker's table that the smallest session leaves out.
fn whole_whisker(points: &str) -> String {
    let more = [
        "replicate,dwell_s,average_s,stream,fbg_2_sd_pm",
        "1,2,1,ok,1.1",
        "1,2,1,ok,1.2",
        "1,2,1,ok,1.3",
    ];
    points
        .lines()
        .zip(more)
        .map(|(line, more)| format!("{line},{more}\n"))
        .collect()
}

#[test]
fn no_cell_of_a_session_ends_a_command_otherwise_than_by_its_name() {
    let mut wrong = Vec::new();
    for base in [Base::Whisker, Base::Transducer, Base::Axis] {
        let place = tempfile::tempdir().unwrap();
        base.write(place.path());
        let points = fs::read_to_string(place.path().join("points.csv")).unwrap();
        let whisker = base == Base::Whisker;
        let text = if whisker {
            whole_whisker(&points)
        } else {
            points
        };
        let beside: &[&str] = if whisker {
            &["groove", "origin + stage_mm", "point"]
        } else {
            &["point", "readings"]
        };
        wrong.extend(walk(
            place.path(),
            &Table {
                file: "points.csv",
                text,
                arguments: "verify . --check",
                beside,
            },
        ));
        if whisker {
            let twin = fs::read_to_string(place.path().join("twin.csv")).unwrap();
            wrong.extend(walk(
                place.path(),
                &Table {
                    file: "twin.csv",
                    text: twin,
                    arguments: "verify . --check",
                    beside,
                },
            ));
        }
    }
    assert!(
        wrong.is_empty(),
        "{} faults\n{}",
        wrong.len(),
        wrong.join("\n")
    );
}

/// The commands that the issue names, on the column that ended them.
#[test]
fn a_stage_a_thousand_kilometres_away_is_refused_by_every_command() {
    for command in [
        "verify s --check",
        "verify s --out o",
        "fit-gpr s --out o",
        "twin s --out t.csv",
    ] {
        let place = tempfile::tempdir().unwrap();
        let session = place.path().join("s");
        fs::create_dir(&session).unwrap();
        Base::Whisker.write(&session);
        let path = session.join("points.csv");
        let points = fs::read_to_string(&path).unwrap();
        fs::write(&path, points.replace("2.5,1,0,18", "1e9,1,0,18")).unwrap();
        let arguments: Vec<&str> = command.split(' ').collect();
        let output = limited(place.path(), &arguments);
        judge(&output, 1, &["points.csv", "stage_mm", "1e9"])
            .unwrap_or_else(|why| panic!("{command}: {why}"));
    }
}

#[test]
fn no_cell_of_a_table_to_predict_or_to_track_ends_a_command_otherwise_than_by_its_name() {
    let place = tempfile::tempdir().unwrap();
    let write = |name: &str, text: &str| fs::write(place.path().join(name), text).unwrap();
    let [physical, _, scalar] = calibrations::models();
    write(
        "physical.json",
        &calibrations::calibration(physical).to_string(),
    );
    write(
        "scalar.json",
        &calibrations::calibration(scalar).to_string(),
    );
    write(
        "whisker.json",
        &calibrations::whisker_calibration().to_string(),
    );
    let readings = "point,t_s,fbg_1_nm,fbg_2_nm\n1,0,1541.21,1535.81\n2,1,1541.4,1535.9\n";
    write("whisker.csv", readings);
    write("cell.csv", "point,response\n1,2.5\n2,4.5\n");
    let rows = |of: &dyn Fn(u32) -> String| (0..40).map(of).collect::<String>();
    let track = rows(&|k| {
        format!(
            "{k},{},{},{}\n",
            0.1 * f64::from(k),
            1541.21 + 1e-3 * f64::from(k),
            1535.81
        )
    });
    let motion = rows(&|k| {
        format!(
            "{},{},0,20\n",
            0.1 * f64::from(k),
            18.0 - 0.1 * f64::from(k)
        )
    });
    write("t.csv", &format!("point,t_s,fbg_1_nm,fbg_2_nm\n{track}"));
    write(
        "motion.csv",
        &format!("t_s,object_x_mm,object_y_mm,object_z_mm\n{motion}"),
    );
    let read = |name: &str| fs::read_to_string(place.path().join(name)).unwrap();
    let table =
        |file: &'static str, arguments: &'static str, beside: &'static [&'static str]| Table {
            file,
            text: read(file),
            arguments,
            beside,
        };
    let mut wrong = Vec::new();
    for table in [
        table(
            "whisker.csv",
            "predict whisker.csv --calibration physical.json --out o.csv --force",
            &[],
        ),
        table(
            "cell.csv",
            "predict cell.csv --calibration scalar.json --out o.csv --force",
            &[],
        ),
        table(
            "t.csv",
            "track t.csv --calibration whisker.json --motion motion.csv --force --out o.csv",
            &["t_s", "clock"],
        ),
        table(
            "motion.csv",
            "track t.csv --calibration whisker.json --motion motion.csv --force --out o.csv",
            &["t_s", "line", "clock"],
        ),
    ] {
        wrong.extend(walk(place.path(), &table));
    }
    assert!(
        wrong.is_empty(),
        "{} faults\n{}",
        wrong.len(),
        wrong.join("\n")
    );
}

/// A table that was cut inside its last number reads as one with another number: the missing line
/// end is what tells.
#[test]
fn a_table_that_ends_within_its_last_row_is_named_in_one_line() {
    let cut = |place: &Path, file: &str| {
        let path = place.join(file);
        let text = fs::read_to_string(&path).unwrap();
        fs::write(path, text.trim_end()).unwrap();
    };
    let said = |output: &Output| {
        let text = String::from_utf8_lossy(&output.stdout).into_owned()
            + &String::from_utf8_lossy(&output.stderr);
        text.lines()
            .filter(|line| line.contains("without a line end"))
            .map(str::to_owned)
            .collect::<Vec<_>>()
    };
    for base in [Base::Whisker, Base::Transducer, Base::Axis] {
        let place = tempfile::tempdir().unwrap();
        base.write(place.path());
        assert!(
            said(&wcal(place.path(), &["verify", ".", "--check"])).is_empty(),
            "{base:?}: negative control"
        );
        cut(place.path(), "points.csv");
        let lines = said(&wcal(place.path(), &["verify", ".", "--check"]));
        assert!(
            lines.len() == 1 && lines[0].contains("points.csv") && lines[0].contains("line 4"),
            "{base:?}: {lines:?}"
        );
    }
    let place = tempfile::tempdir().unwrap();
    fs::write(
        place.path().join("t.csv"),
        "load,out\n1,2.5\n2,4.5\n3,6.5\n4,8.25",
    )
    .unwrap();
    let import =
        "import t.csv --kind transducer --stimulus load --response out --model linear --out s";
    let output = wcal(place.path(), &import.split(' ').collect::<Vec<_>>());
    assert_eq!(
        said(&output).len(),
        1,
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
}
