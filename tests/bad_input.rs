//! Broken input through the program: one clear error, the documented exit code, no panic, nothing half-written.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test that fails should say where")]

#[path = "../calib/session/tests/broken/mod.rs"]
mod broken;

use broken::{Base, TABLE};
use std::fs;
use std::path::Path;
use std::process::{Command, Output};

fn wcal(folder: &Path, arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_wcal")).args(arguments).current_dir(folder).output().unwrap()
}

/// What is wrong with an outcome, if anything.
fn judge(output: &Output, code: i32, says: &[&str]) -> Result<(), String> {
    let text =
        format!("{}{}", String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
    if text.contains("panicked") {
        return Err(format!("a panic: {text}"));
    }
    if output.status.code() != Some(code) {
        return Err(format!("exit code {:?} instead of {code}: {text}", output.status.code()));
    }
    match says.iter().find(|says| !text.contains(**says)) {
        Some(missing) => Err(format!("{text:?} lacks {missing:?}")),
        None => Ok(()),
    }
}

/// Names in a folder, sorted.
fn listing(folder: &Path) -> Vec<String> {
    let names = fs::read_dir(folder).unwrap().map(|e| e.unwrap().file_name().to_string_lossy().into_owned());
    let mut names: Vec<String> = names.collect();
    names.sort();
    names
}

#[test]
fn doctor_names_what_is_broken() {
    let mut wrong = Vec::new();
    for case in TABLE {
        let place = tempfile::tempdir().unwrap();
        let session = place.path().join("s");
        fs::create_dir(&session).unwrap();
        case.write(&session);
        let before = listing(&session);
        if let Err(why) = judge(&wcal(place.path(), &["doctor", "s"]), 1, case.says) {
            wrong.push(format!("{}: {why}", case.name));
        }
        assert_eq!(before, listing(&session), "{}", case.name);
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn doctor_passes_good_sessions() {
    for (base, code) in [(Base::Whisker, 3), (Base::Transducer, 3), (Base::Axis, 3)] {
        let place = tempfile::tempdir().unwrap();
        base.write(place.path());
        // No pose is repeated in these three rows: usable, with a warning that matters.
        judge(&wcal(place.path(), &["doctor", "."]), code, &["no pose is repeated"]).unwrap();
        let json = wcal(place.path(), &["doctor", ".", "--json"]);
        let document: serde_json::Value = serde_json::from_slice(&json.stdout).unwrap();
        assert_eq!(document["worst"], "warn");
    }
}

struct BadImport {
    name: &'static str,
    table: &'static [u8],
    arguments: &'static [&'static str],
    code: i32,
    says: &'static [&'static str],
}

const LINEAR: &[&str] = &["--kind", "transducer", "--stimulus", "x", "--response", "y", "--model", "linear"];

const IMPORTS: &[BadImport] = &[
    BadImport { name: "empty", table: b"", arguments: LINEAR, code: 1, says: &["t.csv", "header"] },
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
        says: &["response", "nothing"],
    },
    BadImport {
        name: "truncated",
        table: b"x,y\n1,2\n2",
        arguments: LINEAR,
        code: 1,
        says: &["line 3", "1 fields"],
    },
    BadImport {
        name: "semicolons",
        table: b"x;y\n1;2\n",
        arguments: LINEAR,
        code: 1,
        says: &["column x", "x;y"],
    },
    BadImport { name: "not text", table: b"x,y\n\xff,2\n", arguments: LINEAR, code: 1, says: &["UTF-8"] },
    BadImport {
        name: "no stimulus",
        table: b"x,y\n1,2\n",
        arguments: &["--kind", "transducer", "--response", "y", "--model", "linear"],
        code: 1,
        says: &["--stimulus"],
    },
    BadImport {
        name: "no response",
        table: b"x,y\n1,2\n",
        arguments: &["--kind", "transducer", "--stimulus", "x", "--model", "linear"],
        code: 2,
        says: &["--response"],
    },
    BadImport {
        name: "unknown model",
        table: b"x,y\n1,2\n",
        arguments: &["--kind", "transducer", "--stimulus", "x", "--response", "y", "--model", "cubic"],
        code: 2,
        says: &["cubic", "quadratic"],
    },
    BadImport {
        name: "micrometres as millimetres",
        table: b"c,m\n1,1001\n2,2002\n3,3001\n",
        arguments: &["--kind", "axis", "--commanded", "c", "--measured", "m"],
        code: 1,
        says: &["same unit", "um?"],
    },
    BadImport {
        name: "factor that is no number",
        table: b"c,m\n1,1.1\n2,2.1\n",
        arguments: &["--kind", "axis", "--commanded", "c", "--measured", "m", "--scale", "measured_mm=k"],
        code: 1,
        says: &["--scale", "\"k\""],
    },
    BadImport {
        name: "whisker without description",
        table: b"fbg_1_nm,fbg_2_nm\n1545,1543\n",
        arguments: &["--kind", "whisker"],
        code: 2,
        says: &["--meta"],
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
    fs::write(place.path().join("t.csv"), "\u{feff}x,y,T\r\n1,2.5,20\r\n2,4.5,21").unwrap();
    let mapped = [&["import", "t.csv", "--out", "new", "--temperature", "T", "--json"], LINEAR].concat();
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
    assert_eq!(listing(&place.path().join("new")), ["points.csv", "session.toml"]);
    fs::write(place.path().join("new/notes.txt"), "mine").unwrap();
    judge(&wcal(place.path(), &mapped), 1, &["new", "notes.txt", "--force"]).unwrap();
    judge(&wcal(place.path(), &[&mapped[..], &["--force"]].concat()), 0, &[]).unwrap();
    assert_eq!(listing(&place.path().join("new")), ["notes.txt", "points.csv", "session.toml"]);
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

#[test]
fn a_whisker_table_is_imported_with_its_description() {
    let place = tempfile::tempdir().unwrap();
    fs::write(place.path().join("meta.toml"), broken::WHISKER_TOML).unwrap();
    let table = broken::WHISKER_POINTS.replace("groove_x_mm", "gx").replace("t_s", "time_ms");
    fs::write(place.path().join("t.csv"), table).unwrap();
    let arguments = [
        "import",
        "t.csv",
        "--kind",
        "whisker",
        "--meta",
        "meta.toml",
        "--map",
        "groove_x_mm=gx",
        "--time",
        "time_ms",
        "--scale",
        "t_s=0.001",
        "--out",
        "new",
    ];
    judge(&wcal(place.path(), &arguments), 0, &["3 rows"]).unwrap();
    judge(&wcal(place.path(), &["doctor", "new"]), 3, &["t_s is present"]).unwrap();
}

#[test]
fn templates_load_and_are_never_overwritten() {
    let place = tempfile::tempdir().unwrap();
    judge(&wcal(place.path(), &["init", "s"]), 0, &["session.toml", "points.csv"]).unwrap();
    let output = wcal(place.path(), &["doctor", "s"]);
    assert_ne!(output.status.code(), Some(1), "{}", String::from_utf8_lossy(&output.stdout));
    fs::write(place.path().join("s/session.toml"), "mine").unwrap();
    judge(&wcal(place.path(), &["init", "s"]), 1, &["session.toml"]).unwrap();
    assert_eq!(fs::read_to_string(place.path().join("s/session.toml")).unwrap(), "mine");
    for (kind, file) in [("rig", "rig.toml"), ("plan", "plan.toml")] {
        judge(&wcal(place.path(), &["init", "--kind", kind, kind]), 0, &[file]).unwrap();
        let text = fs::read_to_string(place.path().join(kind).join(file)).unwrap();
        text.parse::<toml::Table>().unwrap();
    }
}

#[test]
fn verify_and_fit_gpr_refuse_what_is_broken_and_leave_no_result() {
    let mut wrong = Vec::new();
    for case in TABLE {
        for command in ["verify", "fit-gpr"] {
            let place = tempfile::tempdir().unwrap();
            let session = place.path().join("s");
            fs::create_dir(&session).unwrap();
            case.write(&session);
            let output = wcal(place.path(), &[command, "s", "--out", "o"]);
            if let Err(why) = judge(&output, 1, case.says) {
                wrong.push(format!("{command} {}: {why}", case.name));
            }
            // All that may be there is the whole document that says why.
            let left =
                if place.path().join("o").exists() { listing(&place.path().join("o")) } else { Vec::new() };
            match left.as_slice() {
                [] => {}
                [only] if command == "verify" && only == "verify.json" => {
                    let text = fs::read(place.path().join("o/verify.json")).unwrap();
                    let document: serde_json::Value = serde_json::from_slice(&text).unwrap();
                    assert_eq!(document["verdict"], "refused", "{}", case.name);
                }
                other => wrong.push(format!("{command} {}: left {other:?}", case.name)),
            }
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

/// Every command with a folder or a file as --out, on arguments that would fail later: what is there is checked first.
const OUTPUTS: &[&[&str]] = &[
    &["verify", "s"],
    &["fit-gpr", "s"],
    &["import", "t.csv", "--kind", "axis", "--commanded", "c", "--measured", "m"],
    &["stereo-calibrate", "left", "right", "--board", "9x6", "--square-mm", "6"],
    &["stereo-shape", "left", "right", "--cameras", "stereo.json", "--rig", "rig.toml"],
    &["fit-whisker", "shapes.json", "--rig", "rig.toml"],
    &["simulate", "--object", "can", "--sweeps", "1"],
    &["train", "sweeps"],
    &["evaluate", "sweeps", "--model", "model"],
    &["demo"],
];

#[test]
fn every_out_folder_refuses_what_is_not_its_own_result() {
    let mut wrong = Vec::new();
    for arguments in OUTPUTS {
        let place = tempfile::tempdir().unwrap();
        fs::create_dir(place.path().join("o")).unwrap();
        fs::write(place.path().join("o/thesis.txt"), "mine").unwrap();
        fs::write(place.path().join("file"), "mine").unwrap();
        let own = format!("wcal {}", arguments[0]);
        for (out, says) in [("o", &["thesis.txt", "--force", &own][..]), ("file", &["expected a folder"])] {
            let output = wcal(place.path(), &[*arguments, &["--out", out]].concat());
            if let Err(why) = judge(&output, 1, says) {
                wrong.push(format!("{} --out {out}: {why}", arguments[0]));
            }
        }
        assert_eq!(listing(place.path()), ["file", "o"], "{}", arguments[0]);
        assert_eq!(fs::read(place.path().join("o/thesis.txt")).unwrap(), b"mine", "{}", arguments[0]);
        assert_eq!(listing(&place.path().join("o")), ["thesis.txt"], "{}", arguments[0]);
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn every_out_file_refuses_what_is_not_its_own_result() {
    let mut wrong = Vec::new();
    for arguments in [
        &["predict", "t.csv", "--calibration", "c.json"][..],
        &["twin", "s"],
        &["track", "t.csv", "--calibration", "c.json", "--model", "m"],
    ] {
        let place = tempfile::tempdir().unwrap();
        // Readings, labels of another simulator.
        for text in ["point,fbg_1_nm,fbg_2_nm\n1,1545,1543\n", "point,moment_1_nmm,moment_2_nmm\n1,2,3\n"] {
            fs::write(place.path().join("data.csv"), text).unwrap();
            let output = wcal(place.path(), &[arguments, &["--out", "data.csv"]].concat());
            if let Err(why) =
                judge(&output, 1, &["--out data.csv", "--force", &format!("wcal {}", arguments[0])])
            {
                wrong.push(format!("{}: {why}", arguments[0]));
            }
            assert_eq!(fs::read_to_string(place.path().join("data.csv")).unwrap(), text);
        }
        if let Err(why) = judge(&wcal(place.path(), &[arguments, &["--out", "."]].concat()), 1, &["a folder"])
        {
            wrong.push(format!("{}: {why}", arguments[0]));
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn a_table_in_place_of_a_session_is_told_how_to_become_one() {
    let place = tempfile::tempdir().unwrap();
    let transducer: String = (0..20).map(|k| format!("{k},{},{}\n", k % 5, 20 * (k % 5) + k)).collect();
    fs::write(place.path().join("cell.csv"), format!("t_s,load_n,out v\n{transducer}")).unwrap();
    for command in ["verify", "doctor", "fit-gpr"] {
        let out = if command == "doctor" { &[][..] } else { &["--out", "o"] };
        let run = wcal(place.path(), &[&[command, "cell.csv"], out].concat());
        judge(&run, 1, &["cell.csv", "use wcal import", &format!("wcal {command} cell")]).unwrap();
    }
    assert_eq!(listing(place.path()), ["cell.csv"]);
    // The command that is printed does it.
    let run = wcal(place.path(), &["verify", "cell.csv"]);
    let text = String::from_utf8_lossy(&run.stderr).into_owned();
    let line = text.lines().find(|l| l.trim().starts_with("wcal import")).unwrap().trim().to_owned();
    assert!(line.contains("--stimulus load_n --response 'out v'"), "{line}");
    let script = format!("{} {}", env!("CARGO_BIN_EXE_wcal"), line.strip_prefix("wcal ").unwrap());
    let done = Command::new("sh").args(["-c", &script]).current_dir(place.path()).output().unwrap();
    judge(&done, 0, &["20 rows"]).unwrap();
    judge(&wcal(place.path(), &["doctor", "cell"]), 0, &["20"]).unwrap();
    // A session's own table: the folder is named.
    judge(&wcal(place.path(), &["verify", "cell/points.csv"]), 1, &["wcal verify cell"]).unwrap();
    fs::write(place.path().join("axis.csv"), "commanded_mm;measured_mm\n1;1\n").unwrap();
    judge(&wcal(place.path(), &["verify", "axis.csv"]), 1, &["--separator semicolon --kind axis"]).unwrap();
}

/// A sealed calibration.json around a model.
fn calibration(model: serde_json::Value) -> serde_json::Value {
    let mut file = wcal_core::CalibrationFile {
        format: wcal_core::calibration::CALIBRATION_FORMAT.to_owned(),
        session: "s".to_owned(),
        verification: wcal_core::VerificationStatus::Verified,
        expires: None,
        model,
        provenance: wcal_core::Provenance::default(),
        whisker: None,
        content_sha256: String::new(),
    };
    file.content_sha256 = file.compute_hash().unwrap();
    serde_json::to_value(&file).unwrap()
}

fn models() -> [serde_json::Value; 3] {
    let fbg = serde_json::json!({
        "nominal_nm": [1541.2, 1535.8], "reference_nominal_nm": null, "temperature_pm_per_degc": null,
        "reference_temperature_pm_per_degc": null, "temperature_compensated": true,
    });
    let square = |size: usize| vec![vec![0.0; size]; size];
    let physical = serde_json::json!({
        "kind": "physical", "coefficients": [[3.0, -2.0], [72.0, -6.0], [9.0, 78.0], [1.5, 0.3], [-0.4, 0.2], [0.6, -1.0]],
        "covariance": square(14), "noise_sd_pm": 0.5, "seatings": 1, "fbg": fbg, "largest_moment_nmm": 1.0,
        "effects": [
            {"id": "fbg-nonlinearity", "law": "quadratic", "values": [], "parameters": []},
            {"id": "hysteresis", "law": "play", "values": [0.02, 0.1], "parameters": []},
        ],
    });
    let output = serde_json::json!({
        "trend": "constant", "kernel": {"form": "none"}, "nugget": 0.01, "variance_nmm2": 1.0, "dof": null, "inflation": 1.0,
        "offset_nmm": 0.0, "beta": [0.1], "alpha": [],
    });
    let triangle = [[0.0, 0.0], [100.0, 0.0], [0.0, 100.0]];
    let map = serde_json::json!({
        "kind": "map", "version": 1, "name": "affine", "labels": "rod", "centre_pm": [0.0, 0.0], "scale_pm": 100.0,
        "training_pm": triangle, "outputs": [output, output], "fbg": fbg,
        "valid_region": {"kind": "hull", "vertices_pm": triangle, "margin_pm": 10.0},
        "law": {"zero_pm": [0.0, 0.0], "k_pm_per_nmm": [[72.0, 9.0], [-6.0, 78.0]], "residual_sd_pm": [1.0, 1.0]},
    });
    let scalar = serde_json::json!({
        "kind": "scalar", "session_kind": "transducer", "stimulus_unit": "N", "response_unit": "V", "covariates": [],
        "declared": {"polynomial": 1}, "effects": [{"id": "nonlinearity-quadratic", "law": "power-2", "values": []}],
        "scaling": {"mid": 5.0, "half": 5.0, "time": null, "temperature": null, "covariates": [], "count": 20},
        "coefficients": [1.0, 2.0, 0.1], "covariance": square(3), "variance": 0.01, "dof": 17.0, "offset": 0.0, "spread": null,
        "stimulus_range": [0.0, 10.0], "polynomial": null, "lack_of_fit": [null, null],
    });
    [physical, map, scalar]
}

#[test]
fn calibrations_are_refused_by_name_before_anything_is_computed() {
    let place = tempfile::tempdir().unwrap();
    fs::write(place.path().join("whisker.csv"), "fbg_1_nm,fbg_2_nm\n1541.21,1535.81\n").unwrap();
    fs::write(place.path().join("scalar.csv"), "stimulus\n1\n2\n").unwrap();
    let run = |file: &serde_json::Value, table: &str| {
        fs::write(place.path().join("c.json"), file.to_string()).unwrap();
        wcal(place.path(), &["predict", table, "--calibration", "c.json", "--out", "out.csv"])
    };
    let [physical, map, scalar] = models();
    for (model, table) in [(&physical, "whisker.csv"), (&map, "whisker.csv"), (&scalar, "scalar.csv")] {
        // Control: as they are, they predict.
        judge(&run(&calibration(model.clone()), table), 0, &[])
            .unwrap_or_else(|e| panic!("{}: {e}", model["kind"]));
        fs::remove_file(place.path().join("out.csv")).unwrap();
    }
    let none: [f64; 0] = [];
    let far = 4_000_000_000_u32;
    let cases: &[(&serde_json::Value, &str, serde_json::Value, &[&str])] = &[
        (&physical, "/effects/0/id", "fbg-teleport".into(), &["catalogue", "fbg-teleport", "quadratic"]),
        (&physical, "/effects/1/law", "quantum".into(), &["catalogue", "hysteresis", "quantum"]),
        (
            &physical,
            "/effects/1/values",
            vec![0.02].into(),
            &["values of hysteresis (play)", "expected 2, found 1"],
        ),
        (&physical, "/seatings", far.into(), &["`seatings`", "expected 1", "found 4000000000"]),
        (
            &physical,
            "/coefficients",
            vec![vec![3.0, -2.0]].into(),
            &["`coefficients`", "at least 6 rows, found 1"],
        ),
        (
            &physical,
            "/covariance",
            vec![vec![0.0]].into(),
            &["`covariance`", "12 to 14 rows", "found 1 rows"],
        ),
        (&physical, "/covariance/3", none[..].into(), &["`covariance`", "0 numbers in row 4"]),
        (&physical, "/kind", "oracle".into(), &["c.json", "oracle"]),
        (&map, "/version", 2.into(), &["expected version 1, found 2"]),
        (&map, "/outputs/1/beta", none[..].into(), &["`outputs[1].beta` of 1 numbers", "found 0"]),
        (&map, "/valid_region/kind", "sphere".into(), &["valid_region.kind", "sphere"]),
        (&scalar, "/effects/0/id", "warp".into(), &["catalogue", "warp"]),
        (&scalar, "/effects/0/law", "power-9".into(), &["catalogue", "power-9"]),
        (&scalar, "/declared/polynomial", far.into(), &["`declared`", "at most 2", "found 4000000000"]),
        (&scalar, "/coefficients", vec![1.0].into(), &["`coefficients`", "expected 3, found 1"]),
        (&scalar, "/covariance", vec![vec![0.0]].into(), &["`covariance`", "3 rows"]),
        (
            &scalar,
            "/scaling/covariates",
            vec![vec![0.0, 1.0]].into(),
            &["`scaling.covariates`", "expected 0, found 1"],
        ),
    ];
    let mut wrong = Vec::new();
    for (model, pointer, value, says) in cases {
        let mut model = (*model).clone();
        *model.pointer_mut(pointer).unwrap() = value.clone();
        let table = if model["kind"] == "scalar" { "scalar.csv" } else { "whisker.csv" };
        if let Err(why) = judge(&run(&calibration(model), table), 1, says) {
            wrong.push(format!("{pointer}: {why}"));
        }
    }
    let mut newer = calibration(physical);
    newer["format"] = "wcal-calibration/2".into();
    wrong.extend(
        judge(&run(&newer, "whisker.csv"), 1, &["`format`", "wcal-calibration/1", "wcal-calibration/2"])
            .err(),
    );
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
    assert!(!place.path().join("out.csv").exists(), "nothing is half-written");
}
