//! `wcal track` past an object whose place is known: distances of the contacts, and a doubt where
//! they lie off it. The sweeps are the measured one over the bottle and a SIMULATED one, as they
//! are (control) and with one thing changed.

use crate::support::copy::copy_folder;
use crate::support::{fixture, text, wcal};
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::sync::LazyLock;
use wcal_plant::sweep::SweepCase;

/// A row of the sweep's points.csv: point, t_s, two shifts (nm), place of the base (mm), its turn.
type Row = [f64; 11];

struct Tracked {
    code: i32,
    said: String,
    summary: Value,
    table: String,
}

impl Tracked {
    /// Cells of a column.
    fn column(&self, name: &str) -> Vec<&str> {
        let mut lines = self.table.lines();
        let at = lines
            .next()
            .unwrap()
            .split(',')
            .position(|c| c == name)
            .unwrap();
        lines.map(|l| l.split(',').nth(at).unwrap()).collect()
    }
}

fn path(at: &Path) -> &str {
    at.to_str().unwrap()
}

/// The map of the 27 measured poses by the rod's labels, made once for all tests.
fn map() -> &'static str {
    static MAP: LazyLock<String> = LazyLock::new(|| {
        let (session, out) = (
            fixture("whiskerfbg"),
            Path::new(env!("CARGO_TARGET_TMPDIR")).join("passed-object-map"),
        );
        let run = wcal(&[
            "fit-gpr",
            path(&session),
            "--labels",
            "rod",
            "--out",
            path(&out),
        ]);
        assert_eq!(run.status.code(), Some(3), "{}", text(&run.stderr));
        assert!(
            text(&run.stdout).contains("another zero"),
            "{}",
            text(&run.stdout)
        );
        path(&out.join("calibration.json")).to_owned()
    });
    &MAP
}

fn track(calibration: &str, source: &Path, more: &[&str]) -> Tracked {
    let out = source.with_extension("track.csv");
    let arguments = [
        "track",
        path(source),
        "--calibration",
        calibration,
        "--force",
        "--out",
        path(&out),
        "--json",
    ];
    let run = wcal(&[&arguments[..], more].concat());
    let said = text(&run.stderr);
    let summary =
        serde_json::from_slice(&run.stdout).unwrap_or_else(|e| unreachable!("{e}: {said}"));
    let table = std::fs::read_to_string(out).unwrap();
    Tracked {
        code: run.status.code().unwrap(),
        said,
        summary,
        table,
    }
}

/// The bottle's sweep with changed rows.
fn changed(folder: &Path, name: &str, change: impl Fn(Vec<Row>) -> Vec<Row>) -> PathBuf {
    let sweep = folder.join(name);
    copy_folder(&fixture("whiskerfbg_bottle"), &sweep);
    let points = std::fs::read_to_string(sweep.join("points.csv")).unwrap();
    let mut lines = points.lines();
    let header = lines.next().unwrap();
    let row = |l: &str| -> Row {
        let cells: Vec<f64> = l.split(',').map(|c| c.parse().unwrap()).collect();
        cells.try_into().unwrap()
    };
    let rows = change(lines.map(row).collect());
    let line = |r: &Row| r.map(|v| v.to_string()).join(",");
    let lines: Vec<String> = std::iter::once(header.to_owned())
        .chain(rows.iter().map(line))
        .collect();
    std::fs::write(sweep.join("points.csv"), lines.join("\n") + "\n").unwrap();
    sweep
}

#[test]
fn distances_from_the_bottle_are_stated() {
    let folder = tempfile::tempdir().unwrap();
    let calibration = map();
    let sweep = changed(folder.path(), "as-it-is", |rows| rows);
    let own = track(calibration, &sweep, &[]);
    println!("{}", own.said);
    // The column is the distance of the wire's surface; the summary is made of it.
    let stated: Vec<f64> = own
        .column("object_distance_mm")
        .iter()
        .filter_map(|c| c.parse().ok())
        .collect();
    let object = &own.summary["object"];
    let of = |v: &Value, key: &str| v[key].as_f64().unwrap();
    assert_eq!(stated.len() as f64, of(object, "points"));
    let mean = stated.iter().map(|d| d.abs()).sum::<f64>() / stated.len() as f64;
    assert!(
        (mean - of(object, "mean_mm")).abs() < 1e-3,
        "{mean} {object}"
    );
    // From the outside of the bottle, which the wire touched: what 27 poses do not tell of the
    // gain, and what is not known of the bottle's place.
    let median = of(object, "median_mm");
    assert!((1.0..3.0).contains(&median), "{object}");
    assert!(
        own.said
            .contains("contacts and object do not belong together"),
        "{}",
        own.said
    );
    // A calibration that does not know the zero of the free wire refuses a beginning in contact.
    let late = changed(folder.path(), "in", |rows| rows[20..].to_vec());
    let out = folder.path().join("refused.csv");
    let run = wcal(&[
        "track",
        path(&late),
        "--calibration",
        calibration,
        "--force",
        "--out",
        path(&out),
    ]);
    let said = text(&run.stderr);
    assert!(
        run.status.code() == Some(1) && said.contains("free readings"),
        "{said}"
    );
}

/// On a SIMULATED sweep with a map of its own 27 poses, and the control.
#[test]
fn contacts_that_lie_off_their_object_are_doubted() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    SweepCase::draw(501).unwrap().write(folder.path()).unwrap();
    let run = wcal(&[
        "fit-gpr",
        path(&at("session")),
        "--labels",
        "rod",
        "--out",
        path(&at("map")),
    ]);
    assert_eq!(run.status.code(), Some(0), "{}", text(&run.stderr));
    let run = wcal(&[
        "import",
        path(&at("readings.csv")),
        "--kind",
        "sweep",
        "--motion",
        path(&at("base.csv")),
        "--object",
        path(&at("object.stl")),
        "--object-pose",
        "0,0,0,1,0,0,0",
        "--out",
        path(&at("sweep")),
    ]);
    assert!(run.status.success(), "{}", text(&run.stderr));
    let calibration = at("map/calibration.json");
    let points = std::fs::read_to_string(at("sweep/points.csv")).unwrap();
    let header: Vec<&str> = points.lines().next().unwrap().split(',').collect();
    let column = |name: &str| header.iter().position(|c| *c == name).unwrap();
    let base = column("base_x_mm");
    // Every other reading, changed: all rows in order of time, cells as numbers.
    let with = |name: &str, change: &dyn Fn(&mut Vec<Vec<f64>>)| {
        let numbers = |l: &str| l.split(',').map(|c| c.parse::<f64>().unwrap()).collect();
        let mut rows: Vec<Vec<f64>> = points.lines().skip(1).step_by(2).map(numbers).collect();
        change(&mut rows);
        let line = |r: &Vec<f64>| r.iter().map(f64::to_string).collect::<Vec<_>>().join(",");
        let lines: Vec<String> = std::iter::once(header.join(","))
            .chain(rows.iter().map(line))
            .collect();
        let sweep = at(name);
        copy_folder(&at("sweep"), &sweep);
        std::fs::write(sweep.join("points.csv"), lines.join("\n") + "\n").unwrap();
        track(path(&calibration), &sweep, &[])
    };
    let control = with("nothing", &|_| {});
    const APART: &str = "contacts and object do not belong together";
    assert!(!control.said.contains(APART), "{}", control.said);
    let doubted = |name: &str, run: &Tracked| {
        println!("{name}: exit {}: {}", run.code, run.said);
        let said = run.said.contains(APART) || run.said.contains("moments and motion disagree");
        assert!(
            said && (run.code == 3 || run.code == 4),
            "{name}: exit {}: {}",
            run.code,
            run.said
        );
    };
    let metres = with("metres", &|rows| {
        rows.iter_mut()
            .for_each(|r| r[base..base + 3].iter_mut().for_each(|v| *v *= 1e-3))
    });
    doubted("metres", &metres);
    // The arm's log of another sweep, to the end of which it stands still.
    let other: Vec<_> = SweepCase::draw(506)
        .unwrap()
        .readings
        .iter()
        .map(|r| r.base_mm)
        .collect();
    let foreign = with("another sweep's motion", &|rows| {
        for (k, r) in rows.iter_mut().enumerate() {
            r[base..base + 3].copy_from_slice(other[(2 * k).min(other.len() - 1)].as_slice());
        }
    });
    doubted("another sweep's motion", &foreign);
    let axis = with("axis", &|rows| {
        rows.iter_mut().for_each(|r| r.swap(base + 1, base + 2))
    });
    doubted("axis", &axis);
}

/// The object's friction stands in its session or on the command line; a number is refused by key.
#[test]
fn an_object_states_its_friction() {
    let folder = tempfile::tempdir().unwrap();
    let stated = |name: &str, line: &str| {
        let sweep = changed(folder.path(), name, |rows| rows);
        let place = sweep.join("session.toml");
        let session = std::fs::read_to_string(&place).unwrap();
        let session = if session.contains("[object]") {
            session.replace("[object]\n", &format!("[object]\n{line}\n"))
        } else {
            format!("{session}\n[object]\n{line}\n")
        };
        std::fs::write(place, session).unwrap();
        sweep
    };
    let assumed = |t: &Tracked| {
        let of_contacts = t.column("assumes").into_iter().find(|a| !a.is_empty());
        of_contacts.unwrap_or_default().to_owned()
    };
    let by_session = track(map(), &stated("stated", "friction = \"0.1 +- 0.05\""), &[]);
    assert!(
        assumed(&by_session).contains("friction=0.1+-0.05"),
        "{}",
        assumed(&by_session)
    );
    // What is typed counts before what the session holds, and without either nothing is stated.
    let typed = stated("typed", "friction = \"0.1 +- 0.05\"");
    let typed = track(map(), &typed, &["--friction", "0.2 +- 0.02"]);
    assert!(assumed(&typed).contains("friction=0.2+-0.02"));
    let none = track(map(), &changed(folder.path(), "none", |rows| rows), &[]);
    assert!(assumed(&none).contains("friction=0..0.3"));
    let wrong = stated("wrong", "friction = 0.1");
    let run = wcal(&[
        "track",
        path(&wrong),
        "--calibration",
        map(),
        "--out",
        "unused.csv",
    ]);
    assert_eq!(run.status.code(), Some(1));
    assert!(
        text(&run.stderr).contains("object.friction"),
        "{}",
        text(&run.stderr)
    );
}
