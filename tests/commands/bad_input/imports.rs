//! `wcal import` of tables that cannot be used, and of good ones.

use super::*;

struct BadImport {
    name: &'static str,
    table: &'static [u8],
    arguments: &'static [&'static str],
    code: i32,
    says: &'static [&'static str],
}

const LINEAR: &[&str] = &[
    "--kind",
    "transducer",
    "--stimulus",
    "x",
    "--response",
    "y",
    "--model",
    "linear",
];

const IMPORTS: &[BadImport] = &[
    BadImport {
        name: "empty",
        table: b"",
        arguments: LINEAR,
        code: 1,
        says: &["t.csv", "header"],
    },
    BadImport {
        name: "no rows",
        table: b"x,y\n",
        arguments: LINEAR,
        code: 1,
        says: &["t.csv", "empty table"],
    },
    BadImport {
        name: "no column",
        table: b"x,z\n1,2\n",
        arguments: LINEAR,
        code: 1,
        says: &["column y", "x, z"],
    },
    BadImport {
        name: "word",
        table: b"x,y\n1,2\n2,b\n",
        arguments: LINEAR,
        code: 1,
        says: &["line 3", "field y", "\"b\""],
    },
    BadImport {
        name: "NaN",
        table: b"x,y\n1,NaN\n",
        arguments: LINEAR,
        code: 1,
        says: &["line 2", "field y", "NaN"],
    },
    BadImport {
        name: "empty cell",
        table: b"x,y\n1,\n",
        arguments: LINEAR,
        code: 1,
        says: &["line 2", "field y", "in most rows"],
    },
    BadImport {
        name: "truncated",
        table: b"x,y\n1,2\n2",
        arguments: LINEAR,
        code: 1,
        says: &["line 3", "1 fields"],
    },
    BadImport {
        name: "semicolons, stated as commas",
        table: b"x;y\n1;2\n",
        arguments: &[
            "--kind",
            "transducer",
            "--stimulus",
            "x",
            "--response",
            "y",
            "--model",
            "linear",
            "--separator",
            "comma",
        ],
        code: 1,
        says: &["column x", "x;y"],
    },
    BadImport {
        name: "not text",
        table: b"x,y\n\xff,2\n",
        arguments: LINEAR,
        code: 1,
        says: &["a number"],
    },
    BadImport {
        name: "no stimulus",
        table: b"x,y\n1,2\n",
        arguments: &[
            "--kind",
            "transducer",
            "--response",
            "y",
            "--model",
            "linear",
        ],
        code: 1,
        says: &["--stimulus"],
    },
    BadImport {
        name: "no response",
        table: b"x,y\n1,2\n",
        arguments: &[
            "--kind",
            "transducer",
            "--stimulus",
            "x",
            "--model",
            "linear",
        ],
        code: 2,
        says: &["--response"],
    },
    BadImport {
        name: "unknown model",
        table: b"x,y\n1,2\n",
        arguments: &[
            "--kind",
            "transducer",
            "--stimulus",
            "x",
            "--response",
            "y",
            "--model",
            "cubic",
        ],
        code: 2,
        says: &["cubic", "quadratic"],
    },
    BadImport {
        name: "micrometres as millimetres",
        table: b"c,m\n1,1001\n2,2002\n3,3001\n",
        arguments: &["--kind", "axis", "--commanded", "c", "--measured", "m"],
        code: 1,
        says: &["same unit", "COLUMN*0.001"],
    },
    BadImport {
        name: "factor that is no number",
        table: b"c,m\n1,1.1\n2,2.1\n",
        arguments: &["--kind", "axis", "--commanded", "c", "--measured", "m*k"],
        code: 1,
        says: &["m*k", "\"k\""],
    },
    BadImport {
        name: "whisker without description",
        table: b"fbg_1_nm,fbg_2_nm\n1545,1543\n",
        arguments: &["--kind", "whisker"],
        code: 2,
        says: &["--model"],
    },
];

#[test]
fn import_refuses_and_leaves_nothing() {
    let mut wrong = Vec::new();
    for case in IMPORTS {
        let place = tempfile::tempdir().unwrap();
        fs::write(place.path().join("t.csv"), case.table).unwrap();
        let arguments = [&["import", "t.csv", "--out", "new"], case.arguments].concat();
        if let Err(why) = judge(&wcal(place.path(), &arguments), case.code, case.says) {
            wrong.push(format!("{}: {why}", case.name));
        }
        assert_eq!(listing(place.path()), ["t.csv"], "{}", case.name);
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn import_takes_good_tables_and_replaces_only_its_own() {
    let place = tempfile::tempdir().unwrap();
    fs::write(
        place.path().join("t.csv"),
        "\u{feff}x,y,T\r\n1,2.5,20\r\n2,4.5,21\r\n",
    )
    .unwrap();
    let mapped = [
        &[
            "import",
            "t.csv",
            "--out",
            "new",
            "--temperature",
            "T",
            "--json",
        ],
        LINEAR,
    ]
    .concat();
    let output = wcal(place.path(), &mapped);
    judge(&output, 0, &[]).unwrap();
    let document: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(document["rows"], 2);
    let points = fs::read_to_string(place.path().join("new/points.csv")).unwrap();
    assert_eq!(
        points,
        "point,role,stimulus,response,temperature_degc\n1,calibration,1,2.5,20\n2,calibration,2,4.5,21\n"
    );
    // The same again takes the place of the first, whole; what is not of an import is kept.
    fs::write(place.path().join("new/holdout.csv"), "of the first").unwrap();
    judge(&wcal(place.path(), &mapped), 0, &[]).unwrap();
    assert_eq!(
        listing(&place.path().join("new")),
        ["points.csv", "session.toml"]
    );
    fs::write(place.path().join("new/notes.txt"), "mine").unwrap();
    judge(
        &wcal(place.path(), &mapped),
        1,
        &["new", "notes.txt", "--force"],
    )
    .unwrap();
    judge(
        &wcal(place.path(), &[&mapped[..], &["--force"]].concat()),
        0,
        &[],
    )
    .unwrap();
    assert_eq!(
        listing(&place.path().join("new")),
        ["notes.txt", "points.csv", "session.toml"]
    );
    judge(
        &wcal(
            place.path(),
            &[
                "import",
                "none.csv",
                "--out",
                "other",
                "--kind",
                "axis",
                "--commanded",
                "c",
                "--measured",
                "m",
            ],
        ),
        1,
        &["none.csv", "no such file"],
    )
    .unwrap();
    assert_eq!(listing(place.path()), ["new", "t.csv"]);
}

/// No column goes without a word, and the option that is named takes it.
#[test]
fn columns_that_are_left_out_are_named() {
    let place = tempfile::tempdir().unwrap();
    fs::write(
        place.path().join("t.csv"),
        "x,y,humidity,remark,t_s\n1,2.5,40,a,0\n2,4.5,41,b,1\n",
    )
    .unwrap();
    fs::write(
        place.path().join("h.csv"),
        "x,y,humidity,t_s,more\n3,6.5,42,2,7\n",
    )
    .unwrap();
    let import = |more: &[&str]| {
        let arguments = [&["import", "t.csv", "--out", "new", "--json"], LINEAR, more].concat();
        let output = wcal(place.path(), &arguments);
        judge(&output, 0, &[]).unwrap();
        let document: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        (document["columns_left_out"].clone(), said)
    };
    let (left, said) = import(&[]);
    assert_eq!(left, serde_json::json!(["humidity", "remark"]));
    assert!(said.contains("humidity, remark; --covariate"), "{said}");
    let (left, _) = import(&["--covariate", "humidity", "--holdout", "h.csv"]);
    assert_eq!(left, serde_json::json!(["remark", "more"]));
    let points = fs::read_to_string(place.path().join("new/points.csv")).unwrap();
    assert!(
        points.starts_with("point,role,stimulus,response,humidity,t_s\n"),
        "{points}"
    );
    // Control: nothing is left out, and nothing said.
    fs::write(place.path().join("t.csv"), "x,y\n1,2.5\n2,4.5\n").unwrap();
    let (left, said) = import(&["--force"]);
    assert!(
        left == serde_json::json!([]) && !said.contains("not imported"),
        "{said}"
    );
}

#[test]
fn a_whisker_table_is_imported_with_its_description() {
    let place = tempfile::tempdir().unwrap();
    fs::write(place.path().join("meta.toml"), broken::WHISKER_TOML).unwrap();
    let table = broken::WHISKER_POINTS
        .replace("groove_x_mm", "gx")
        .replace("t_s", "time_ms");
    fs::write(place.path().join("t.csv"), table).unwrap();
    let arguments = [
        "import",
        "t.csv",
        "--kind",
        "whisker",
        "--model",
        "meta.toml",
        "--covariate",
        "groove_x_mm=gx",
        "--time",
        "time_ms*0.001",
        "--out",
        "new",
    ];
    judge(&wcal(place.path(), &arguments), 0, &["3 rows"]).unwrap();
    judge(
        &wcal(place.path(), &["verify", "new", "--check"]),
        3,
        &["t_s is present"],
    )
    .unwrap();
}

/// What was set cannot be what was read.
#[test]
fn one_column_for_both_signals_is_named() {
    let place = tempfile::tempdir().unwrap();
    fs::write(
        place.path().join("t.csv"),
        "p,u\n0,0.1\n1,0.2\n2,0.31\n3,0.4\n4,0.5\n",
    )
    .unwrap();
    let import = |response: &str| {
        let words = "import t.csv --kind transducer --model linear --stimulus p --response";
        let words: Vec<&str> = words
            .split(' ')
            .chain([response, "--out", "s", "--force"])
            .collect();
        wcal(place.path(), &words)
    };
    judge(
        &import("p"),
        1,
        &["t.csv", "stimulus", "response", "found p for both"],
    )
    .unwrap();
    // Control.
    judge(&import("u"), 0, &["5 rows"]).unwrap();
}
