//! Files and sessions are written whole or not at all.

use std::fs;
use wcal_session::{Separator, SessionFiles, TextTableLayout, read_text_table, write_session};

const TOML: &str = "format = \"wcal-session/1\"\nid = \"t\"\nkind = \"transducer\"\n[files]\npoints = \"points.csv\"\n\
    [transducer]\nstimulus_unit = \"N\"\nresponse_unit = \"V\"\nmodel = \"linear\"\n";

fn session(points: &str) -> SessionFiles {
    SessionFiles {
        session_toml: TOML.to_owned(),
        tables: vec![("points.csv".to_owned(), points.as_bytes().to_vec())],
    }
}

#[test]
fn a_session_that_does_not_load_is_not_written() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("s");
    let error = write_session(
        &out,
        &session("point,role,stimulus,response\n1,calibration,1,x\n"),
    )
    .unwrap_err();
    assert!(error.to_string().contains("response"), "{error}");
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0);
    let good = session("point,role,stimulus,response\n1,calibration,1,2\n");
    assert_eq!(write_session(&out, &good).unwrap().folder, out);
    let error = write_session(&out, &good).unwrap_err().to_string();
    assert!(error.contains("does not exist yet"), "{error}");
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
}

#[test]
fn foreign_tables_are_read_by_their_layout() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("t.txt");
    fs::write(&path, "head\nhead\n  .5  1\n\n -1E1  2\n").unwrap();
    let blanks = TextTableLayout {
        skip_lines: 2,
        columns: Some(vec!["y".into(), "x".into()]),
        separator: Some(Separator::Whitespace),
        ..TextTableLayout::default()
    };
    let table = read_text_table(&path, &blanks).unwrap();
    assert_eq!(
        (table.number(0, 0).unwrap(), table.number(1, 0).unwrap()),
        (Some(0.5), Some(-10.0))
    );
    assert_eq!(table.rows[1].0, 5);
    assert!(table.column("z").unwrap_err().to_string().contains("y, x"));

    fs::write(&path, "a;b\n1,5;2\n3;x\n").unwrap();
    let layout = TextTableLayout {
        separator: Some(Separator::Semicolon),
        decimal_comma: true,
        ..Default::default()
    };
    let table = read_text_table(&path, &layout).unwrap();
    assert_eq!(table.number(0, 0).unwrap(), Some(1.5));
    let error = table.number(1, 1).unwrap_err().to_string();
    assert!(
        error.contains("line 3") && error.contains("field b"),
        "{error}"
    );
    let error = read_text_table(&path, &TextTableLayout::default())
        .unwrap_err()
        .to_string();
    assert!(error.contains("fields"), "{error}");
}
