//! Foreign tables are read by their layout.

use std::fs;
use wcal_session::{Separator, TextTableLayout, read_text_table};

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
