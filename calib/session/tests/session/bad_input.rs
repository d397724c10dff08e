//! Every broken session gives one clear error; harmless variants load.

use crate::broken::{Base, TABLE, WHISKER_POINTS};
use std::fs;
use std::path::Path;
use wcal_core::{Role, SessionData, WhiskerData, WhiskerRow};
use wcal_session::{
    LoadedSession, WarningKind, add_session, attach_holdout, examine, load, load_table,
};

#[test]
fn good_sessions_load_without_warnings() {
    for base in [Base::Whisker, Base::Transducer, Base::Axis] {
        let folder = tempfile::tempdir().unwrap();
        base.write(folder.path());
        let session = load(folder.path()).unwrap_or_else(|e| panic!("{base:?}: {e}"));
        assert!(
            session.warnings.is_empty(),
            "{base:?}: {:?}",
            session.warnings
        );
    }
}

#[test]
fn each_broken_session_gives_its_error() {
    let mut wrong = Vec::new();
    for case in TABLE {
        let folder = tempfile::tempdir().unwrap();
        case.write(folder.path());
        match load(folder.path()) {
            Ok(_) => wrong.push(format!("{}: loaded", case.name)),
            Err(error) => {
                let text = error.to_string();
                let missing: Vec<_> = case
                    .says
                    .iter()
                    .filter(|says| !text.contains(**says))
                    .collect();
                if !missing.is_empty() || text.contains('\n') {
                    wrong.push(format!("{}: {text:?} lacks {missing:?}", case.name));
                }
            }
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

/// A session that was handed on reads nothing but its own folder, whatever its links say.
#[test]
fn links_that_lead_out_of_the_folder_are_refused() {
    let (outer, folder) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    Base::Whisker.write(outer.path());
    Base::Whisker.write(folder.path());
    let points = folder.path().join("points.csv");
    let link = |to: &Path| {
        fs::remove_file(&points).unwrap();
        std::os::unix::fs::symlink(to, &points).unwrap();
        load(folder.path()).map(|_| ()).map_err(|e| e.to_string())
    };
    let out = link(&outer.path().join("points.csv")).unwrap_err();
    assert!(
        out.contains("files.points") && out.contains("a link to"),
        "{out}"
    );
    let device = link(Path::new("/dev/zero")).unwrap_err();
    assert!(device.contains("/dev/zero"), "{device}");
    // Control: a link that stays inside is a file of the folder.
    fs::write(folder.path().join("real.csv"), WHISKER_POINTS).unwrap();
    assert_eq!(link(Path::new("real.csv")), Ok(()));
}

fn whisker_with(edit: impl Fn(&str) -> String) -> (tempfile::TempDir, LoadedSession) {
    let folder = tempfile::tempdir().unwrap();
    Base::Whisker.write(folder.path());
    fs::write(folder.path().join("points.csv"), edit(WHISKER_POINTS)).unwrap();
    let session = load(folder.path()).unwrap();
    (folder, session)
}

fn data(session: &LoadedSession) -> &WhiskerData {
    match &session.data {
        SessionData::Whisker(data) => data,
        other => panic!("{other:?}"),
    }
}

#[test]
fn bom_crlf_and_a_missing_final_newline_change_nothing() {
    let (_a, plain) = whisker_with(str::to_owned);
    let (_b, dressed) =
        whisker_with(|text| format!("\u{feff}{}", text.trim_end().replace('\n', "\r\n")));
    assert_eq!(plain.data, dressed.data);
    assert_eq!(data(&dressed).rows[2].line, 4);
    let (_c, spaced) = whisker_with(|text| text.replacen("\n1,", "\n\n1,", 1));
    assert_eq!(data(&spaced).rows[2].line, 5);
}

#[test]
fn values_are_in_the_units_of_their_names() {
    let (_folder, session) = whisker_with(str::to_owned);
    let row = &data(&session).rows[1];
    assert!((row.shift_pm[0] - 30.0).abs() < 1e-6 && (row.shift_pm[1] - 40.0).abs() < 1e-6);
    assert_eq!(
        (row.source.as_str(), row.line, row.point, row.role),
        ("points.csv", 3, 1, Role::Calibration)
    );
    assert_eq!(data(&session).rows[0].trajectory, None);
    let hash = wcal_core::provenance::sha256_hex(WHISKER_POINTS.as_bytes());
    assert!(
        session
            .inputs
            .iter()
            .any(|i| i.path == "points.csv" && i.sha256 == hash)
    );
}

/// Readings are in the order of their times, whatever the order of the lines; a clock that runs
/// back while the numbers rise is none of that.
#[test]
fn the_order_of_the_lines_changes_nothing() {
    let reversed = |points: &str| {
        let (head, rows) = points.split_once('\n').unwrap();
        rows.lines()
            .rev()
            .fold(format!("{head}\n"), |table, row| format!("{table}{row}\n"))
    };
    let in_order = |session: &LoadedSession| {
        let rows = data(session).rows.iter().map(|r| WhiskerRow {
            line: 0,
            ..r.clone()
        });
        (
            rows.collect::<Vec<_>>(),
            data(session).fbg.clone(),
            session.warnings.len(),
        )
    };
    let (_kept, plain) = whisker_with(str::to_owned);
    let (_folder, other) = whisker_with(reversed);
    assert!(
        data(&other)
            .rows
            .iter()
            .any(|r| r.line != data(&plain).rows[r.point as usize].line)
    );
    assert_eq!(in_order(&plain), in_order(&other));
}

#[test]
fn time_that_runs_backwards_is_a_clock_problem_not_an_error() {
    let (_folder, session) = whisker_with(|text| text.replace("1,3,2.5", "1,1.5,2.5"));
    let warning = session
        .warnings
        .iter()
        .find(|w| w.kind == WarningKind::ClockProblem)
        .unwrap()
        .to_string();
    assert!(
        warning.contains("line(s) 4") && warning.contains("0.5 s"),
        "{warning}"
    );
}

#[test]
fn stage_and_groove_that_disagree_are_reported() {
    let (_folder, session) = whisker_with(|text| text.replace("18,0,2.5", "18,0.3,2.5"));
    assert!(
        session
            .warnings
            .iter()
            .any(|w| w.to_string().contains("0.300 mm at line 4")),
        "{:?}",
        session.warnings
    );
}

#[test]
fn unknown_columns_and_keys_are_warnings() {
    let folder = tempfile::tempdir().unwrap();
    Base::Whisker.write(folder.path());
    let path = folder.path().join("points.csv");
    fs::write(&path, WHISKER_POINTS.replace("samples", "colour")).unwrap();
    let toml = crate::broken::WHISKER_TOML.replace("[fbg]", "[fbg]\nnominal = 3");
    fs::write(folder.path().join("session.toml"), toml).unwrap();
    let warnings = load(folder.path()).unwrap().warnings;
    let warnings = warnings
        .iter()
        .map(ToString::to_string)
        .collect::<Vec<_>>()
        .join("\n");
    assert!(
        warnings.contains("colour") && warnings.contains("fbg.nominal"),
        "{warnings}"
    );
}

#[test]
fn holdout_rows_of_the_points_table_are_sealed() {
    let folder = tempfile::tempdir().unwrap();
    Base::Transducer.write(folder.path());
    let path = folder.path().join("points.csv");
    let text = fs::read_to_string(&path)
        .unwrap()
        .replace("2,calibration", "2,holdout");
    fs::write(&path, text).unwrap();
    let session = load(folder.path()).unwrap();
    let SessionData::Transducer(data) = &session.data else {
        panic!("kind")
    };
    assert_eq!((data.rows.len(), session.sealed.len()), (2, 1));
    assert_eq!(data.covariates, ["batch"]);
}

#[test]
fn an_attached_holdout_must_be_new() {
    let (folder, mut session) = whisker_with(str::to_owned);
    let points = folder.path().join("points.csv");
    let error = attach_holdout(&mut session, &points)
        .unwrap_err()
        .to_string();
    assert!(error.contains("no fit has seen"), "{error}");
    session = load(folder.path()).unwrap();
    let fresh = folder.path().join("fresh.csv");
    fs::write(&fresh, WHISKER_POINTS.replace("1545.03", "1545.0301")).unwrap();
    attach_holdout(&mut session, &fresh).unwrap();
    assert_eq!(session.sealed.len(), 3);
    // Two of the three rows are still copies: under a clock `verify` refuses them.
    let findings = examine(&session);
    assert!(
        findings
            .iter()
            .any(|f| f.topic == "holdout" && f.message.contains("3 sealed rows")),
        "{findings:?}"
    );
}

#[test]
fn a_holdout_session_brings_its_trajectories_and_nominals() {
    let (_folder, mut session) = whisker_with(str::to_owned);
    let other = tempfile::tempdir().unwrap();
    Base::Whisker.write(other.path());
    let toml = crate::broken::WHISKER_TOML
        .replace("[18.0, 0.0, 0.0]", "[20.0, 0.0, 0.0]")
        .replace("[1545.0,", "[1545.5,");
    fs::write(other.path().join("session.toml"), toml).unwrap();
    fs::write(
        other.path().join("points.csv"),
        WHISKER_POINTS.replace(",18,0", ",20,0"),
    )
    .unwrap();
    attach_holdout(&mut session, other.path()).unwrap();
    let sealed = crate::opened(std::mem::take(&mut session.sealed).whisker());
    let data = data(&session);
    assert_eq!(data.trajectories.len(), 2);
    assert_eq!(sealed[1].trajectory, Some(2));
    // The same absolute wavelength is the same shift from this session's nominal.
    assert!((sealed[1].shift_pm[0] - data.rows[1].shift_pm[0]).abs() < 1e-6);
}

#[test]
fn a_table_for_prediction_needs_wavelengths_only() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("new.csv");
    fs::write(&path, "fbg_1_nm,fbg_2_nm\n1545.1,1543.2\n1545.2,1543.1\n").unwrap();
    let fbg = wcal_core::FbgSpec {
        nominal_nm: Some([1545.0, 1543.0]),
        ..Default::default()
    };
    let table = load_table(&path, &fbg).unwrap();
    assert_eq!(
        table.rows.iter().map(|r| r.point).collect::<Vec<_>>(),
        [0, 1]
    );
    assert!((table.rows[1].shift_pm[0] - 200.0).abs() < 1e-6);
    fs::write(&path, "fbg_1_nm\n1545.1\n").unwrap();
    let error = load_table(&path, &fbg).unwrap_err().to_string();
    assert!(error.contains("fbg_2_nm"), "{error}");
}

#[test]
fn a_column_of_runs_groups_the_readings_and_is_no_covariate() {
    let read = |column: &str| {
        let folder = tempfile::tempdir().unwrap();
        Base::Transducer.write(folder.path());
        let rows: String = (0..12)
            .map(|k| format!("{k},calibration,{},{}.5,{}\n", k % 4, k, k / 4))
            .collect();
        let text = format!("point,role,stimulus,response,{column}\n{rows}");
        fs::write(folder.path().join("points.csv"), text).unwrap();
        let session = load(folder.path()).unwrap();
        let SessionData::Transducer(data) = session.data else {
            panic!("kind")
        };
        (
            data.rows.iter().map(|r| r.replicate).collect::<Vec<_>>(),
            data.covariates,
        )
    };
    let groups: Vec<Option<u32>> = (0..12).map(|k| Some(k / 4)).collect();
    for column in ["replicate", "cycle", "run", "pose", "day"] {
        assert_eq!(read(column), (groups.clone(), Vec::new()), "{column}");
    }
    // Control: any other number is a covariate.
    assert_eq!(read("batch"), (vec![None; 12], vec!["batch".to_owned()]));
}

#[test]
fn copied_replicates_count_once() {
    let copied = |time: &dyn Fn(usize, &str) -> String| {
        let (_folder, session) = whisker_with(|text| {
            let row = text.lines().nth(2).unwrap();
            let copies: String = (3..9)
                .map(|i| format!("{i}{}\n", &time(i, row)[1..]))
                .collect();
            text.to_owned() + &copies
        });
        let SessionData::Whisker(data) = &session.data else {
            panic!("kind")
        };
        (data.rows.len(), examine(&session))
    };
    let (rows, findings) = copied(&|_, row| row.to_owned());
    assert!(
        rows == 3
            && findings
                .iter()
                .any(|f| f.message.contains("6 of 9 rows are copies of others")),
        "{findings:?}"
    );
    // Control: the same values at times of their own were read again; a coarse instrument does
    // that.
    let later = |i: usize, row: &str| {
        let mut cells: Vec<String> = row.split(',').map(str::to_owned).collect();
        cells[3] = format!("{}", 100 + i);
        cells.join(",")
    };
    let (rows, findings) = copied(&later);
    assert_eq!(rows, 9, "{findings:?}");
}

#[test]
fn a_million_rows_stream_in() {
    let folder = tempfile::tempdir().unwrap();
    Base::Transducer.write(folder.path());
    let mut text = String::from("point,role,stimulus,response,t_s\n");
    for i in 0..1_000_000 {
        text.push_str(&format!(
            "{i},calibration,{},{}.25,{i}\n",
            i % 977,
            i % 1013
        ));
    }
    fs::write(folder.path().join("points.csv"), text).unwrap();
    let start = std::time::Instant::now();
    let SessionData::Transducer(data) = load(folder.path()).unwrap().data else {
        panic!("kind")
    };
    assert_eq!(data.rows.len(), 1_000_000);
    println!("a million rows in {:.1} s", start.elapsed().as_secs_f64());
}

#[test]
fn every_session_among_the_fixtures_loads() {
    let fixtures = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fixtures");
    let counts = [
        ("whiskerfbg", 28, 0),
        ("practice/case-004", 360, 54),
        ("practice/case-008", 360, 54),
        ("nist/pontius", 40, 0),
        ("nist/loadcell", 33, 0),
        ("nist/berger1", 107, 0),
        ("nist/lew", 200, 0),
    ];
    for (name, rows, holdout) in counts {
        let session = load(&fixtures.join(name)).unwrap();
        let found = match &session.data {
            SessionData::Whisker(d) => d.rows.len(),
            SessionData::Transducer(d) => d.rows.len(),
        };
        assert_eq!((found, session.sealed.len()), (rows, holdout), "{name}");
        assert!(
            session.warnings.is_empty(),
            "{name}: {:?}",
            session.warnings
        );
    }
}

/// Rows of a later session are series and times of their own, behind those that are sealed, too.
#[test]
fn a_later_session_has_its_own_series_and_times() {
    let write = |rows: &str| {
        let folder = tempfile::tempdir().unwrap();
        let session = "format = \"wcal-session/1\"\nid = \"a\"\nkind = \"transducer\"\n[files]\npoints = \"points.csv\"\n\
            [transducer]\nmodel = \"linear\"\nstimulus_unit = \"N\"\nresponse_unit = \"V\"\n";
        fs::write(folder.path().join("session.toml"), session).unwrap();
        let head = "point,role,stimulus,response,replicate,t_s\n";
        fs::write(folder.path().join("points.csv"), format!("{head}{rows}")).unwrap();
        folder
    };
    let first = "1,calibration,0,1,1,100\n2,calibration,1,2,1,110\n3,calibration,2,3,1,120\n";
    let later = "1,calibration,0,1.1,1,5\n2,calibration,1,2.1,1,15\n3,calibration,2,3.1,2,25\n";
    let joined = |first: &str| -> Vec<(u32, f64)> {
        let (first, later) = (write(first), write(later));
        let mut session = load(first.path()).unwrap();
        add_session(&mut session, later.path()).unwrap();
        let SessionData::Transducer(data) = session.data else {
            panic!("kind")
        };
        data.rows
            .iter()
            .map(|r| (r.replicate.unwrap(), r.t_s.unwrap()))
            .collect()
    };
    let plain = joined(first);
    assert_eq!(plain[..3], [(1, 100.0), (1, 110.0), (1, 120.0)]);
    // As long after the last reading as the first session took.
    assert_eq!(plain[3..], [(2, 140.0), (2, 150.0), (3, 160.0)]);
    // A sealed series keeps its number to itself.
    let sealed = joined(&format!("{first}4,holdout,1,2,4,130\n"));
    assert_eq!(sealed[3..], [(5, 160.0), (5, 170.0), (6, 180.0)]);
}

#[test]
fn a_table_of_too_many_columns_is_refused_at_its_header() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("wide.csv");
    let read = |columns: usize, asked: Option<Vec<String>>| {
        let line =
            |cell: &dyn Fn(usize) -> String| (0..columns).map(cell).collect::<Vec<_>>().join(";");
        // The rows are damaged: were they split first, that would be said.
        fs::write(
            &path,
            format!(
                "{}\n{}\n1;2\n",
                line(&|k| format!("c{k}")),
                line(&|k| k.to_string())
            ),
        )
        .unwrap();
        let layout = wcal_session::TextTableLayout {
            asked,
            ..Default::default()
        };
        wcal_session::read_text_table(&path, &layout)
            .map_or_else(|error| error.to_string(), |_| String::new())
    };
    for asked in [None, Some(vec!["c1".to_owned()])] {
        let error = read(20_005, asked.clone());
        assert!(
            error.contains("line 1") && error.contains("at most 1000 columns, found 20005"),
            "{error}"
        );
        assert!(
            !read(1000, asked).contains("at most 1000"),
            "negative control"
        );
    }
}
