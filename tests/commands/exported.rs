//! A calibration as code: the header is compiled, the module run, and both say what predict says.

use crate::bad_input::calibrations::{calibration, models, whisker_calibration};
use crate::support::not_run::not_run;
use crate::support::{code_and_messages, fixture, wcal};
use serde_json::{Value, json};
use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

const READINGS: usize = 10_000;
const DRIVER: &str = "#include <stdio.h>\n#include \"cal.h\"\nint main(void)\n{\n    double a, b, c;\n    \
    while (scanf(\"%lf %lf %lf\", &a, &b, &c) == 3) {\n        wcal_result r = wcal_apply(@);\n        \
    printf(\"%.17g %.17g %d\\n\", r.VALUE, r.HALF, r.status);\n    }\n    return wcal_self_test();\n}\n";

/// A folder with a calibration and what is made of it.
struct Place(tempfile::TempDir);

impl Place {
    fn of(calibration: &Value) -> Self {
        let place = Self(tempfile::tempdir().unwrap());
        fs::write(place.at("calibration.json"), calibration.to_string()).unwrap();
        place
    }

    /// A session's calibration by `command`.
    fn made(command: &str, session: &Path) -> Self {
        let place = Self(tempfile::tempdir().unwrap());
        let out = place.0.path().to_str().unwrap();
        let (code, said) =
            code_and_messages(&[command, session.to_str().unwrap(), "--out", out, "--force"]);
        assert!(code == 0 || code == 3, "{code}: {said}");
        place
    }

    fn at(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    fn export(&self, to: &str, out: &str) -> (i32, String) {
        let [calibration, out] = [self.at("calibration.json"), self.at(out)];
        let [calibration, out] = [&calibration, &out].map(|p| p.to_str().unwrap());
        code_and_messages(&["export", calibration, "--to", to, "--out", out])
    }

    /// Columns of predict's table at a table of inputs.
    fn predicted(&self, columns: &str, inputs: &[[f64; 3]], read: [&str; 3]) -> Vec<[f64; 3]> {
        let count = columns.split(',').count();
        let row = |r: &[f64; 3]| {
            r[..count]
                .iter()
                .map(f64::to_string)
                .collect::<Vec<_>>()
                .join(",")
        };
        let rows: Vec<String> = inputs.iter().map(row).collect();
        fs::write(
            self.at("t.csv"),
            format!("{columns}\n{}\n", rows.join("\n")),
        )
        .unwrap();
        let [t, c, o] = ["t.csv", "calibration.json", "p.csv"].map(|n| self.at(n));
        let [t, c, o] = [&t, &c, &o].map(|p| p.to_str().unwrap());
        let (code, said) =
            code_and_messages(&["predict", t, "--calibration", c, "--out", o, "--force"]);
        assert_eq!(code, 0, "{said}");
        let text = fs::read_to_string(self.at("p.csv")).unwrap();
        let names: Vec<&str> = text.lines().next().unwrap().split(',').collect();
        let at = read.map(|name| names.iter().position(|n| *n == name).unwrap());
        let cells = |line: &str| -> [f64; 3] {
            let cells: Vec<&str> = line.split(',').collect();
            at.map(|k| cells[k].parse().unwrap())
        };
        text.lines().skip(1).map(cells).collect()
    }

    /// Answers of a program of this folder to inputs, and its exit code.
    fn answers(&self, program: &mut Command, inputs: &[[f64; 3]]) -> (Vec<[f64; 3]>, i32) {
        let text: String = inputs
            .iter()
            .map(|[a, b, c]| format!("{a} {b} {c}\n"))
            .collect();
        fs::write(self.at("in.txt"), text).unwrap();
        let run = program
            .current_dir(self.0.path())
            .stdin(fs::File::open(self.at("in.txt")).unwrap());
        let run = run.output().unwrap();
        let said = String::from_utf8(run.stdout).unwrap();
        let row = |line: &str| -> [f64; 3] {
            let values: Vec<f64> = line.split(' ').map(|v| v.parse().unwrap()).collect();
            [values[0], values[1], values[2]]
        };
        (said.lines().map(row).collect(), run.status.code().unwrap())
    }

    /// Compiles the driver with the header of this folder.
    fn compiled(&self, arguments: &str, fields: [&str; 2]) -> Command {
        let driver = DRIVER
            .replace('@', arguments)
            .replace("VALUE", fields[0])
            .replace("HALF", fields[1]);
        fs::write(self.at("main.c"), driver).unwrap();
        let strict = [
            "-std=c99",
            "-Wall",
            "-Wextra",
            "-Wpedantic",
            "-Werror",
            "-O1",
            "main.c",
            "-o",
            "main",
            "-lm",
        ];
        let mut cc = Command::new("cc");
        let run = cc.args(strict).current_dir(self.0.path()).output().unwrap();
        assert!(
            run.status.success(),
            "{}",
            String::from_utf8_lossy(&run.stderr)
        );
        Command::new(self.at("main"))
    }

    /// Header and module agree with predict at `inputs`; false where a compiler lacks.
    fn agrees(&self, columns: &str, inputs: &[[f64; 3]], read: [&str; 3]) {
        let map = read[0].starts_with("moment");
        for (to, out) in [("c", "cal.h"), ("python", "cal.py")] {
            let (code, said) = self.export(to, out);
            assert_eq!(code, 0, "{said}");
        }
        let known = self.predicted(columns, inputs, read);
        let valid = |c: usize| known.iter().filter(|k| k[2] == 0.0).map(move |k| k[c]);
        let [low, high] = [
            valid(0).fold(f64::MAX, f64::min),
            valid(0).fold(f64::MIN, f64::max),
        ];
        // Tables of moments have six decimals.
        let rounding = if map { 6e-7 } else { 0.0 };
        let limits = [
            (high - low).max(valid(1).fold(0.0, f64::max)),
            valid(1).fold(0.0, f64::max),
        ];
        let limits = limits.map(|span| 1e-6 * span + rounding);
        let share = valid(0).count() as f64 / known.len() as f64;
        assert!((0.3..0.99).contains(&share), "some lie outside: {share}");
        let count = columns.split(',').count();
        let fields = if map {
            ["moment_nmm[0]", "half95_nmm[0]"]
        } else {
            ["value", "half95"]
        };
        let python = format!(
            "import sys, cal\nfor line in sys.stdin:\n    x = [float(v) for v in line.split()]\n    v, h, s = cal.apply(*x[:{count}])\n    \
             print(v{0}, h{0}, s)\nsys.exit(cal.self_test())\n",
            if map { "[0]" } else { "" }
        );
        let mut module = Command::new("python3");
        module.args(["-c", &python]);
        let mut header = self.compiled(&"a, b, c"[..3 * count - 2], fields);
        for (name, program) in [("C", &mut header), ("Python", &mut module)] {
            let (found, failures) = self.answers(program, inputs);
            assert_eq!((failures, found.len()), (0, inputs.len()), "{name}");
            let mut missed = [0.0_f64; 2];
            for ((found, known), input) in found.iter().zip(&known).zip(inputs) {
                assert_eq!(
                    found[2], known[2],
                    "{name} at {input:?}: {found:?}, {known:?}"
                );
                if known[2] == 1.0 {
                    assert!(
                        found[0].is_nan() && found[1].is_nan(),
                        "{name} at {input:?}"
                    );
                    continue;
                }
                missed = [0, 1].map(|c| missed[c].max((found[c] - known[c]).abs()));
            }
            println!("{name}: off by {missed:?} of {limits:?}");
            assert!(
                (0..2).all(|c| missed[c] <= limits[c]),
                "{name}: {missed:?} of {limits:?}"
            );
        }
    }

    /// Self-tests of the header and of the header with `from` replaced.
    fn control(&self, from: &str, to: &str, arguments: &str, fields: [&str; 2]) {
        let text = fs::read_to_string(self.at("cal.h")).unwrap();
        assert!(text.contains(from), "{from} in {text}");
        fs::write(self.at("cal.h"), text.replacen(from, to, 1)).unwrap();
        let (_, failures) = self.answers(&mut self.compiled(arguments, fields), &[]);
        assert!(failures > 0, "negative control: a coefficient was changed");
    }
}

/// Whether a test that needs a compiler and Python can run.
fn tools() -> bool {
    let there = |name: &str| {
        let mut command = Command::new(name);
        command
            .arg("--version")
            .stdout(Stdio::null())
            .stderr(Stdio::null());
        command.status().is_ok_and(|s| s.success())
    };
    let lacking = ["cc", "python3"].into_iter().find(|name| !there(name));
    lacking
        .inspect(|name| not_run(format!("needs {name}")))
        .is_none()
}

/// Inputs over a range and a little beyond.
fn over(low: f64, high: f64, of: impl Fn(f64, usize) -> [f64; 3]) -> Vec<[f64; 3]> {
    let place = |k: usize| low + (high - low) * (k as f64 * 0.618_033_988_75).fract();
    (0..READINGS).map(|k| of(place(k), k)).collect()
}

/// The first numbers of an array in a header, and the same with one of them changed.
fn changed(header: &Path, array: &str, index: usize) -> [String; 2] {
    let text = fs::read_to_string(header).unwrap();
    let row = text.split(array).nth(1).unwrap();
    let row = row.split(['}', '\n']).next().unwrap();
    let mut values: Vec<String> = row.split(", ").map(str::to_owned).collect();
    values[index] = format!("{:?}", values[index].parse::<f64>().unwrap() * 1.001);
    [
        format!("{array}{row}"),
        array.to_owned() + &values.join(", "),
    ]
}

#[test]
fn a_load_cell_gives_its_loads_in_c_and_python_and_yaml() {
    if !tools() {
        return;
    }
    let place = Place::made("verify", &fixture("nist/pontius"));
    let inputs = over(-0.1, 2.4, |y, _| [y, 0.0, 0.0]);
    place.agrees(
        "response",
        &inputs,
        ["stimulus", "stimulus_half95", "outside_valid_region"],
    );
    let [from, to] = changed(&place.at("cal.h"), "wcal_pieces[][9] = {{", 2);
    place.control(&from, &to, "a", ["value", "half95"]);
    // ESPHome's pieces, read as it reads them.
    let (code, said) = place.export("yaml", "cal.yaml");
    assert_eq!(code, 0, "{said}");
    let text = fs::read_to_string(place.at("cal.yaml")).unwrap();
    let points: Vec<[f64; 2]> = text
        .lines()
        .filter_map(|line| line.trim().strip_prefix("- ")?.split_once(" -> "))
        .map(|(x, y)| [x.parse().unwrap(), y.parse().unwrap()])
        .collect();
    assert!((3..=64).contains(&points.len()), "{text}");
    // Two points at one place of single precision would divide by zero.
    let doubled = |points: &[[f64; 2]]| points.windows(2).any(|p| p[0][0] as f32 == p[1][0] as f32);
    assert!(!doubled(&points), "{text}");
    assert!(doubled(&[points[0], points[0]]), "negative control");
    let stated = text
        .split("`wcal predict`: ")
        .nth(1)
        .unwrap()
        .split(',')
        .next()
        .unwrap();
    let stated: f64 = stated.parse().unwrap();
    let known = place.predicted(
        "response",
        &inputs,
        ["stimulus", "stimulus_half95", "outside_valid_region"],
    );
    let mut worst = 0.0_f64;
    for (input, known) in inputs.iter().zip(known).filter(|(_, k)| k[2] == 0.0) {
        let after = points
            .partition_point(|p| p[0] <= input[0])
            .clamp(1, points.len() - 1);
        let ([a, b], [c, d]) = (points[after - 1], points[after]);
        worst = worst.max((b + (d - b) * (input[0] - a) / (c - a) - known[0]).abs());
    }
    // Stated with two digits, and not far above what is found.
    assert!(
        worst <= 1.1 * stated && worst > 0.3 * stated,
        "{worst:e} {stated:e}"
    );
}

#[test]
fn an_axis_gives_its_errors_by_direction() {
    if !tools() {
        return;
    }
    let scatter = |k: usize| {
        let h = (k as u64 + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        let h = (h ^ (h >> 29)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        (h >> 11) as f64 / (1u64 << 53) as f64 - 0.5
    };
    let row = |k: usize| {
        let step = k % 160;
        let (x, way) = if step < 80 {
            (step, 1.0)
        } else {
            (160 - step, -1.0)
        };
        let x = 0.125 * x as f64;
        let error =
            3.0 + 2.0 * (x / 2.0 * std::f64::consts::TAU).sin() + if way < 0.0 { 6.0 } else { 0.0 };
        format!(
            "{k},calibration,{x},{},{},{way}",
            x + 1e-3 * (error + scatter(k)),
            2 * k
        )
    };
    let rows: Vec<String> = (0..480).map(row).collect();
    let session = tempfile::tempdir().unwrap();
    let toml = "format = \"wcal-session/1\"\nid = \"made \\\"X\\\" @STORED@\"\nkind = \"axis\"\nmedium = \"air\"\n\
        created = \"2026-01-01T00:00:00Z\"\n[files]\npoints = \"points.csv\"\n";
    fs::write(session.path().join("session.toml"), toml).unwrap();
    let table = format!(
        "point,role,commanded_mm,measured_mm,t_s,direction\n{}\n",
        rows.join("\n")
    );
    fs::write(session.path().join("points.csv"), table).unwrap();
    let place = Place::made("verify", session.path());
    let inputs = over(-1.0, 11.0, |x, k| {
        [x, if k % 2 == 0 { 1.0 } else { -1.0 }, 0.0]
    });
    place.agrees(
        "commanded_mm,direction",
        &inputs,
        ["error_um", "error_half95_um", "outside_valid_region"],
    );
    let (code, said) = place.export("yaml", "cal.yaml");
    assert!(code == 1 && said.contains("one input"), "{said}");
}

/// A transducer with a quadratic term whose zero and slope follow the temperature.
fn warm() -> Value {
    let [_, _, mut model] = models();
    model["effects"] = json!([
        {"id": "nonlinearity-quadratic", "law": "power-2", "values": []},
        {"id": "temperature", "law": "zero-and-sensitivity", "values": []},
    ]);
    model["scaling"]["temperature"] = json!(23.0);
    model["temperature_range"] = json!([5.0, 45.0]);
    model["coefficients"] = json!([1.0, 2.0, 0.1, 0.01, 0.004]);
    let entry = |i: usize, j: usize| {
        if i == j {
            [1e-3, 2e-3, 3e-3, 1e-6, 2e-6][i]
        } else {
            0.0
        }
    };
    model["covariance"] = (0..5)
        .map(|i| (0..5).map(|j| entry(i, j)).collect())
        .collect::<Vec<Vec<f64>>>()
        .into();
    model
}

#[test]
fn a_temperature_is_a_second_input_within_its_range() {
    if !tools() {
        return;
    }
    let place = Place::of(&calibration(warm()));
    let inputs = over(-4.0, 6.0, |y, k| {
        [y, 5.0 + 40.0 * (k as f64 * 0.414).fract(), 0.0]
    });
    place.agrees(
        "response,temperature_degc",
        &inputs,
        ["stimulus", "stimulus_half95", "outside_valid_region"],
    );
    let mut header = place.compiled("a, b", ["value", "half95"]);
    let (found, _) = place.answers(
        &mut header,
        &[[1.0, 4.9, 0.0], [1.0, 5.0, 0.0], [1.0, 45.1, 0.0]],
    );
    assert_eq!([0, 1, 2].map(|k| found[k][2]), [1.0, 0.0, 1.0]);
    // A calibration from before temperatures were kept.
    let mut before = warm();
    before.as_object_mut().unwrap().remove("temperature_range");
    let (code, said) = Place::of(&calibration(before)).export("c", "cal.h");
    assert!(code == 1 && said.contains("temperature_range"), "{said}");
}

#[test]
fn a_map_gives_its_moments_from_shifts_and_from_wavelengths_with_a_reference() {
    if !tools() {
        return;
    }
    let place = Place::made("fit-gpr", &fixture("whiskerfbg"));
    let read = [
        "moment_1_nmm",
        "moment_1_half95_nmm",
        "outside_valid_region",
    ];
    let inputs = over(-0.2, 0.05, |x, k| {
        [x, 0.25 * (k as f64 * 0.414).fract() - 0.2, 0.0]
    });
    place.agrees("fbg_1_shift_nm,fbg_2_shift_nm", &inputs, read);
    let [from, to] = changed(&place.at("cal.h"), "wcal_coefficients_1[] = {", 0);
    place.control(&from, &to, "a, b", ["moment_nmm[0]", "half95_nmm[0]"]);
    let [_, mut map, _] = models();
    map["fbg"] = json!({
        "nominal_nm": [1541.2, 1535.8], "reference_nominal_nm": 1550.0, "temperature_pm_per_degc": [10.0, 11.0],
        "reference_temperature_pm_per_degc": 9.0, "temperature_compensated": false,
    });
    for output in [0, 1] {
        map["outputs"][output]["trend"] = json!("affine");
        map["outputs"][output]["beta"] = json!([0.1, 0.5, -0.2]);
    }
    let place = Place::of(&calibration(map));
    let inputs = over(-0.02, 0.1, |x, k| {
        let [y, warm] = [0.414, 0.73].map(|step| (k as f64 * step).fract());
        [
            1541.2 + x,
            1535.8 + 0.12 * y - 0.02,
            1550.0 + 0.02 * warm - 0.01,
        ]
    });
    place.agrees("fbg_1_nm,fbg_2_nm,fbg_ref_nm", &inputs, read);
}

#[test]
fn what_needs_more_than_the_present_reading_is_refused_by_name() {
    let [_, _, scalar] = models();
    let with = |effect: Value, coefficients: &[f64], values: usize| {
        let mut model = scalar.clone();
        let size = coefficients.len() + values;
        model["effects"] = json!([effect]);
        model["coefficients"] = json!(coefficients);
        model["covariance"] = vec![vec![0.0; size]; size].into();
        model["scaling"]["time"] = json!([0.0, 100.0]);
        calibration(model)
    };
    let effect =
        |id: &str, law: &str, values: &[f64]| json!({"id": id, "law": law, "values": values});
    let loop_of = with(
        effect("hysteresis", "by-direction", &[]),
        &[1.0, 2.0, 0.1],
        0,
    );
    let drift = with(effect("drift", "linear", &[]), &[1.0, 2.0, 0.1], 0);
    let lag = with(effect("lag", "first-order", &[0.01]), &[1.0, 2.0], 1);
    let bent = with(
        effect("nonlinearity-quadratic", "power-2", &[]),
        &[1.0, 0.1, 2.0],
        0,
    );
    let mut play = scalar.clone();
    play["session_kind"] = json!("axis");
    play["declared"] = json!("axis");
    play["offset"] = json!(1e5);
    play["effects"] = json!([effect("backlash", "play", &[0.1])]);
    play["coefficients"] = json!([1.0]);
    play["covariance"] = vec![vec![0.0; 2]; 2].into();
    // Its knee moves along the response with the temperature: no table follows it.
    let mut moving = warm();
    moving["effects"][0] = effect("saturation", "upper-knee", &[0.5, 0.2]);
    moving["effects"][1] = effect("temperature", "sensitivity", &[]);
    moving["coefficients"] = json!([1.0, 2.0, 0.05]);
    let cases: [(Value, &[&str]); 7] = [
        (loop_of, &["hysteresis", "earlier readings", "wcal predict"]),
        (drift, &["drift", "time", "wcal predict"]),
        (lag, &["lag", "time", "wcal predict"]),
        (bent, &["rises or falls throughout", "wcal predict"]),
        (
            calibration(play),
            &["backlash", "earlier readings", "wcal predict"],
        ),
        (calibration(moving), &["tables within", "wcal predict"]),
        (whisker_calibration(), &["wcal fit-gpr"]),
    ];
    for (file, says) in cases {
        let place = Place::of(&file);
        let (code, said) = place.export("c", "cal.h");
        assert_eq!(code, 1, "{said}");
        assert!(
            says.iter().all(|s| said.contains(s)),
            "{said} lacks one of {says:?}"
        );
        assert!(!place.at("cal.h").exists());
    }
    // Control: the plain model is written, to stdout, too; another file stays.
    let place = Place::of(&calibration(scalar));
    fs::File::create(place.at("cal.h"))
        .unwrap()
        .write_all(b"mine\n")
        .unwrap();
    assert_eq!(place.export("c", "cal.h").0, 1);
    let path = place.at("calibration.json");
    let run = wcal(&[
        "export",
        path.to_str().unwrap(),
        "--to",
        "c",
        "--name",
        "cell_2",
    ]);
    let text = String::from_utf8(run.stdout).unwrap();
    assert!(
        run.status.success()
            && text.contains("cell_2_apply(double response)")
            && text.contains("#ifndef CELL_2_H")
    );
    let (code, said) = code_and_messages(&[
        "export",
        path.to_str().unwrap(),
        "--to",
        "c",
        "--name",
        "2;",
    ]);
    assert!(code == 1 && said.contains("--name"), "{said}");
}

#[test]
fn an_expired_or_simulated_calibration_says_so() {
    let [_, _, scalar] = models();
    let mut file: wcal_core::CalibrationFile<Value> =
        serde_json::from_value(calibration(scalar)).unwrap();
    for (expires, simulated, code) in [
        (None, false, 0),
        (None, true, 0),
        (Some("2020-01-01T00:00:00Z"), false, 4),
    ] {
        file.expires = expires.map(str::to_owned);
        file.provenance.simulated = simulated;
        file.content_sha256 = file.compute_hash().unwrap();
        let place = Place::of(&serde_json::to_value(&file).unwrap());
        for (to, mark) in [
            ("c", "WCAL_SIMULATED 1"),
            ("python", "SIMULATED = 1"),
            ("yaml", "SIMULATED"),
        ] {
            let (found, said) = place.export(to, "out");
            assert_eq!(found, code, "{said}");
            assert_eq!(said.contains("expired"), code == 4, "{said}");
            let text = fs::read_to_string(place.at("out")).unwrap();
            let first = text.lines().next().unwrap();
            assert_eq!(
                first.contains("SIMULATED: not measured"),
                simulated,
                "{first}"
            );
            assert_eq!(text.contains(mark), simulated, "{to}");
            assert!(text.contains(&file.content_sha256), "{to}");
        }
    }
}
