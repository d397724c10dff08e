//! Spreadsheets are tables, too: the readings of fixtures/sheets, see make.py there.

use std::path::{Path, PathBuf};
use wcal_session::{TextTable, TextTableLayout, read_text_table};

fn fixture(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("../../fixtures/sheets/{name}"))
}

/// A file's sheet with these columns, or the stated one.
fn read(path: &Path, sheet: Option<&str>) -> Result<TextTable, String> {
    let layout = TextTableLayout {
        asked: Some(["time", "load", "signal", "T"].map(str::to_owned).to_vec()),
        sheet: sheet.map(str::to_owned),
        ..TextTableLayout::default()
    };
    read_text_table(path, &layout).map_err(|e| e.to_string())
}

#[test]
fn sheets_hold_the_readings_of_their_cells() {
    let of = |name: &str| {
        let table = read(&fixture(name), None).unwrap();
        let column = |c: &str| {
            let k = table.column(c).unwrap();
            let cells = (0..table.rows.len()).map(|row| table.number(row, k).unwrap().unwrap());
            cells.collect::<Vec<f64>>()
        };
        let stamp = table.rows[29].1[table.column("time").unwrap()].to_owned();
        (column("load"), column("signal"), column("T"), stamp, table)
    };
    let (load, signal, warm, stamp, table) = of("cell.xlsx");
    assert_eq!(load[..6], [0.0, 50.0, 100.0, 150.0, 200.0, 200.0]);
    assert_eq!(load.len(), 30);
    // Noise of 2e-4 beside a hundredth of the load.
    let worst = load.iter().zip(&signal).map(|(x, y)| (y - 0.01 * x).abs());
    let worst = worst.fold(0.0, f64::max);
    assert!(worst > 1e-4 && worst < 1e-3, "{worst}");
    assert!(warm.iter().all(|t| *t == 20.5));
    assert_eq!(table.units, ["", "N", "mV/V", "degC"]);
    assert_eq!(stamp, "2026-03-05T00:05:32.500");
    // A row of the sheet is a line of the table.
    assert_eq!(table.rows[0].0, 4);
    let other = of("cell.ods");
    assert_eq!((&load, &warm), (&other.0, &other.2));
    // One of the writers keeps sixteen digits.
    let differences = signal.iter().zip(&other.1).map(|(a, b)| (a - b).abs());
    assert!(differences.fold(0.0, f64::max) < 1e-14);
    assert_eq!(other.3, "2026-03-05T00:05:32.500000");
}

#[test]
fn what_is_no_single_whole_sheet_is_named() {
    let says = |name: &str, sheet: Option<&str>| read(&fixture(name), sheet).unwrap_err();
    let of_two = says("two.xlsx", None);
    assert!(
        of_two.contains("Sheet, second") && of_two.contains("--sheet"),
        "{of_two}"
    );
    assert!(
        read(&fixture("two.xlsx"), Some("second")).is_ok(),
        "negative control"
    );
    // Hidden, the second is not meant unless by its name.
    assert!(read(&fixture("hidden.xlsx"), None).is_ok());
    assert!(read(&fixture("hidden.xlsx"), Some("second")).is_ok());
    assert!(says("cell.xlsx", Some("Run 2")).contains("Notes, Run 1"));
    assert!(says("locked.xlsx", None).contains("password"));
    let formula = says("formulas.xlsx", None);
    assert!(
        formula.contains("line 2") && formula.contains("formula"),
        "{formula}"
    );
    let far = says("far.xlsx", None);
    assert!(far.contains("at most") && far.contains("1048576"), "{far}");
}

#[test]
fn damage_is_an_error_and_never_a_panic() {
    let place = tempfile::tempdir().unwrap();
    let path = place.path().join("cut");
    let mut refused = 0;
    for name in ["cell.xlsx", "cell.ods"] {
        let bytes = std::fs::read(fixture(name)).unwrap();
        for at in (4..bytes.len()).step_by(61) {
            std::fs::write(&path, &bytes[..at]).unwrap();
            assert!(read(&path, None).is_err(), "{name} cut at {at}");
            // A byte that is wrong: refused, or in a part that is not read.
            let mut wrong = bytes.clone();
            wrong[at] ^= 0x55;
            std::fs::write(&path, wrong).unwrap();
            refused += usize::from(read(&path, None).is_err());
        }
    }
    assert!(refused > 50, "{refused}");
}
