//! Broken input through the program: one clear error, the documented exit code, no panic, nothing
//! half-written.

#[path = "../../calib/session/tests/session/broken.rs"]
mod broken;
pub(crate) mod calibrations;
mod closed_pipes;
mod columns;
mod documents;
mod foreign_files;
mod foreign_tables;
mod gratings;
mod imports;
mod limits;
mod number_walk;
mod numbers;
mod paths;
mod recordings;
mod refusals;
mod tracking;

use crate::support::{PROGRAM, program_of};
use broken::{Base, TABLE};
use std::fs;
use std::path::Path;
use std::process::{Command, Output};

fn wcal(folder: &Path, arguments: &[&str]) -> Output {
    program_of(arguments[0])
        .args(arguments)
        .current_dir(folder)
        .output()
        .unwrap()
}

/// What is wrong with an outcome, if anything.
fn judge(output: &Output, code: i32, says: &[&str]) -> Result<(), String> {
    let text = format!(
        "{}{}",
        String::from_utf8_lossy(&output.stdout),
        String::from_utf8_lossy(&output.stderr)
    );
    if text.contains("panicked") {
        return Err(format!("a panic: {text}"));
    }
    if output.status.code() != Some(code) {
        return Err(format!(
            "exit code {:?} instead of {code}: {text}",
            output.status.code()
        ));
    }
    match says.iter().find(|says| !text.contains(**says)) {
        Some(missing) => Err(format!("{text:?} lacks {missing:?}")),
        None => Ok(()),
    }
}

/// Names in a folder, sorted.
fn listing(folder: &Path) -> Vec<String> {
    let names = fs::read_dir(folder)
        .unwrap()
        .map(|e| e.unwrap().file_name().to_string_lossy().into_owned());
    let mut names: Vec<String> = names.collect();
    names.sort();
    names
}

#[test]
fn a_check_names_what_is_broken() {
    let mut wrong = Vec::new();
    for case in TABLE {
        let place = tempfile::tempdir().unwrap();
        let session = place.path().join("s");
        fs::create_dir(&session).unwrap();
        case.write(&session);
        let before = listing(&session);
        if let Err(why) = judge(
            &wcal(place.path(), &["verify", "s", "--check"]),
            1,
            case.says,
        ) {
            wrong.push(format!("{}: {why}", case.name));
        }
        assert_eq!(before, listing(&session), "{}", case.name);
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn a_check_passes_good_sessions() {
    for (base, code) in [(Base::Whisker, 3), (Base::Transducer, 3), (Base::Axis, 3)] {
        let place = tempfile::tempdir().unwrap();
        base.write(place.path());
        // No pose is repeated in these three rows: usable, with a warning that matters.
        judge(
            &wcal(place.path(), &["verify", ".", "--check"]),
            code,
            &["no pose is repeated"],
        )
        .unwrap();
        let json = wcal(place.path(), &["verify", ".", "--check", "--json"]);
        let document: serde_json::Value = serde_json::from_slice(&json.stdout).unwrap();
        assert_eq!(document["worst"], "warn");
    }
}

#[test]
fn the_templates_load() {
    let place = tempfile::tempdir().unwrap();
    let templates = Path::new(env!("CARGO_MANIFEST_DIR")).join("examples/templates");
    for name in ["session.toml", "points.csv"] {
        fs::copy(templates.join(name), place.path().join(name)).unwrap();
    }
    let output = wcal(place.path(), &["verify", ".", "--check"]);
    assert_ne!(
        output.status.code(),
        Some(1),
        "{}",
        String::from_utf8_lossy(&output.stdout)
    );
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
            let left = if place.path().join("o").exists() {
                listing(&place.path().join("o"))
            } else {
                Vec::new()
            };
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

/// Every command with a folder or a file as --out, on arguments that would fail later: what is
/// there is checked first.
const OUTPUTS: &[&[&str]] = &[
    &["verify", "s"],
    &["fit-gpr", "s"],
    &[
        "import",
        "t.csv",
        "--kind",
        "axis",
        "--commanded",
        "c",
        "--measured",
        "m",
    ],
    &[
        "stereo-calibrate",
        "left",
        "right",
        "--board",
        "9x6",
        "--square-mm",
        "6",
    ],
    &[
        "stereo-shape",
        "left",
        "right",
        "--cameras",
        "stereo.json",
        "--rig",
        "rig.toml",
    ],
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
        let own = format!(" {}", arguments[0]);
        for (out, says) in [
            ("o", &["thesis.txt", "--force", &own][..]),
            ("file", &["expected a folder"]),
        ] {
            let output = wcal(place.path(), &[*arguments, &["--out", out]].concat());
            if let Err(why) = judge(&output, 1, says) {
                wrong.push(format!("{} --out {out}: {why}", arguments[0]));
            }
        }
        assert_eq!(listing(place.path()), ["file", "o"], "{}", arguments[0]);
        assert_eq!(
            fs::read(place.path().join("o/thesis.txt")).unwrap(),
            b"mine",
            "{}",
            arguments[0]
        );
        assert_eq!(
            listing(&place.path().join("o")),
            ["thesis.txt"],
            "{}",
            arguments[0]
        );
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
        for text in [
            "point,fbg_1_nm,fbg_2_nm\n1,1545,1543\n",
            "point,moment_1_nmm,moment_2_nmm\n1,2,3\n",
        ] {
            fs::write(place.path().join("data.csv"), text).unwrap();
            let output = wcal(place.path(), &[arguments, &["--out", "data.csv"]].concat());
            if let Err(why) = judge(
                &output,
                1,
                &[
                    "--out data.csv",
                    "--force",
                    &format!("wcal {}", arguments[0]),
                ],
            ) {
                wrong.push(format!("{}: {why}", arguments[0]));
            }
            assert_eq!(
                fs::read_to_string(place.path().join("data.csv")).unwrap(),
                text
            );
        }
        if let Err(why) = judge(
            &wcal(place.path(), &[arguments, &["--out", "."]].concat()),
            1,
            &["a folder"],
        ) {
            wrong.push(format!("{}: {why}", arguments[0]));
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

/// A recorded session under another name.
fn renamed(place: &Path, name: &str) {
    let folder = place.join(name);
    crate::support::copy::copy_folder(&crate::support::fixture("nist/pontius"), &folder);
    let path = folder.join("session.toml");
    let mut table: toml::Table = fs::read_to_string(&path).unwrap().parse().unwrap();
    table.insert("id".to_owned(), name.into());
    fs::write(path, toml::to_string(&table).unwrap()).unwrap();
}

#[test]
fn verify_writes_beside_its_session_and_replaces_no_other_sessions_result() {
    let place = tempfile::tempdir().unwrap();
    let session_of = |out: &str| -> String {
        let text = fs::read(place.path().join(out).join("calibration.json")).unwrap();
        serde_json::from_slice::<serde_json::Value>(&text).unwrap()["session"]
            .as_str()
            .unwrap()
            .to_owned()
    };
    for name in ["a", "b"] {
        renamed(place.path(), name);
        judge(&wcal(place.path(), &["verify", name]), 0, &[]).unwrap();
    }
    assert_eq!(
        listing(place.path()),
        ["a", "a-verified", "b", "b-verified"]
    );
    assert_eq!(
        [session_of("a-verified"), session_of("b-verified")],
        ["a", "b"]
    );
    // From within, by its description, and again: the same place.
    judge(&wcal(&place.path().join("a"), &["verify", "."]), 0, &[]).unwrap();
    judge(&wcal(place.path(), &["verify", "a/session.toml"]), 0, &[]).unwrap();
    assert_eq!(listing(place.path()).len(), 4);
    // Another session's result is named, and kept.
    let other = ["verify", "b", "--out", "a-verified"];
    judge(
        &wcal(place.path(), &other),
        1,
        &["a-verified", "result of b, found that of a", "--force"],
    )
    .unwrap();
    assert_eq!(session_of("a-verified"), "a");
    judge(
        &wcal(place.path(), &[&other[..], &["--force"]].concat()),
        0,
        &[],
    )
    .unwrap();
    assert_eq!(session_of("a-verified"), "b");
    // A session that cannot be read leaves no refusal in its place, either.
    fs::write(place.path().join("a/points.csv"), "point\n").unwrap();
    judge(
        &wcal(place.path(), &["verify", "a", "--out", "a-verified"]),
        1,
        &["points.csv", "found that of b"],
    )
    .unwrap();
    assert_eq!(session_of("a-verified"), "b");
}

#[test]
fn maps_and_imported_sessions_replace_none_of_other_data() {
    let place = tempfile::tempdir().unwrap();
    let write = |name: &str, text: &str| {
        let path = place.path().join(name);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, text).unwrap();
    };
    fs::create_dir(place.path().join("w")).unwrap();
    Base::Whisker.write(&place.path().join("w"));
    write("o/fit-gpr.json", r#"{"format":"wcal-map/1"}"#);
    write(
        "o/calibration.json",
        r#"{"format":"wcal-calibration/1","session":"another"}"#,
    );
    judge(
        &wcal(place.path(), &["fit-gpr", "w", "--out", "o"]),
        1,
        &["result of w, found that of another"],
    )
    .unwrap();
    let import = |table: &str, columns: [&str; 2], more: &[&str]| {
        let start = [
            "import",
            table,
            "--kind",
            "transducer",
            "--model",
            "linear",
            "--out",
            "s",
        ];
        wcal(
            place.path(),
            &[
                &start[..],
                &["--stimulus", columns[0], "--response", columns[1]],
                more,
            ]
            .concat(),
        )
    };
    write("load.csv", "t_s,load,out\n0,1,2.5\n1,2,4.5\n2,3,6.5\n");
    write("strain.csv", "strain,volts\n1,2.5\n2,4.5\n3,6.5\n");
    let whole = |output: &Output| output.status.code() != Some(1);
    assert!(whole(&import("load.csv", ["load", "out"], &[])));
    let before = fs::read(place.path().join("s/points.csv")).unwrap();
    judge(
        &import("strain.csv", ["strain", "volts"], &[]),
        1,
        &["strain.csv", "found that of load.csv", "--force"],
    )
    .unwrap();
    assert_eq!(fs::read(place.path().join("s/points.csv")).unwrap(), before);
    // The same table with further options, and a later state of it with the same columns.
    assert!(whole(&import(
        "load.csv",
        ["load", "out"],
        &["--time", "t_s"]
    )));
    write(
        "load.csv",
        "t_s,load,out\n0,1,2.5\n1,2,4.5\n2,3,6.5\n3,4,8.5\n",
    );
    assert!(whole(&import(
        "load.csv",
        ["load", "out"],
        &["--time", "t_s"]
    )));
    assert!(whole(&import(
        "strain.csv",
        ["strain", "volts"],
        &["--force"]
    )));
}

#[test]
fn a_table_in_place_of_a_session_is_told_how_to_become_one() {
    let place = tempfile::tempdir().unwrap();
    let transducer: String = (0..20)
        .map(|k| format!("{k},{},{}\n", k % 5, 20 * (k % 5) + k))
        .collect();
    fs::write(
        place.path().join("cell.csv"),
        format!("t_s,load_n,out v\n{transducer}"),
    )
    .unwrap();
    for command in ["verify", "fit-gpr"] {
        let run = wcal(place.path(), &[command, "cell.csv", "--out", "o"]);
        judge(
            &run,
            1,
            &[
                "cell.csv",
                "use wcal import",
                &format!("wcal {command} cell"),
            ],
        )
        .unwrap();
    }
    assert_eq!(listing(place.path()), ["cell.csv"]);
    // The command that is printed does it.
    let run = wcal(place.path(), &["verify", "cell.csv"]);
    let text = String::from_utf8_lossy(&run.stderr).into_owned();
    let line = text
        .lines()
        .find(|l| l.trim().starts_with("wcal import"))
        .unwrap()
        .trim()
        .to_owned();
    assert!(
        line.contains("--stimulus load_n --response 'out v'"),
        "{line}"
    );
    let script = format!("{PROGRAM} {}", line.strip_prefix("wcal ").unwrap());
    let done = Command::new("sh")
        .args(["-c", &script])
        .current_dir(place.path())
        .output()
        .unwrap();
    judge(&done, 0, &["20 rows"]).unwrap();
    judge(
        &wcal(place.path(), &["verify", "cell", "--check"]),
        0,
        &["20"],
    )
    .unwrap();
    // A session's own table: the folder is named.
    judge(
        &wcal(place.path(), &["verify", "cell/points.csv"]),
        1,
        &["wcal verify cell"],
    )
    .unwrap();
    fs::write(
        place.path().join("axis.csv"),
        "commanded_mm;measured_mm\n1;1\n",
    )
    .unwrap();
    judge(
        &wcal(place.path(), &["verify", "axis.csv"]),
        1,
        &["wcal import axis.csv --kind axis"],
    )
    .unwrap();
}
