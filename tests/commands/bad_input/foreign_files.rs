//! Tables and meshes as other programs write them: read, or named with the option that reads them.

use super::*;

const TEXT: &str = "Force (N),Signal (mV/V),Temp (\u{b0}C)\n0,-0.00001,21.3\n500,0.20026,21.3\n1000,0.40095,21.31\n";
const COLUMNS: &[&str] = &[
    "--kind",
    "transducer",
    "--stimulus",
    "Force (N)",
    "--response",
    "Signal (mV/V)",
    "--model",
    "linear",
    "--out",
    "s",
];

fn latin1(text: &str) -> Vec<u8> {
    text.chars()
        .map(|c| u8::try_from(u32::from(c)).unwrap())
        .collect()
}

fn utf16(text: &str) -> Vec<u8> {
    [0xfeff]
        .into_iter()
        .chain(text.encode_utf16())
        .flat_map(u16::to_le_bytes)
        .collect()
}

/// Decimal commas in a table of semicolons.
fn german(text: &str) -> String {
    text.replace(',', ";").replace('.', ",")
}

#[test]
fn a_table_in_another_form_is_read_and_the_option_named() {
    let tabs = TEXT.replace(',', "\t");
    let blanks = "load sig\n0 1.5\n500 2.5\n1000 3.5\n".to_owned();
    // Name, table, what is said, and the options that read it.
    type Case = (&'static str, String, &'static [&'static str]);
    let cases: Vec<Case> = vec![
        ("tabs", tabs, &["--separator", "tab"]),
        (
            "semicolons",
            TEXT.replace(',', ";"),
            &["--separator", "semicolon"],
        ),
        (
            "decimal commas",
            german(TEXT),
            &["--separator", "semicolon", "--decimal-comma"],
        ),
        ("blanks", blanks, &["--separator", "whitespace"]),
    ];
    for (name, text, options) in cases {
        let columns = match name {
            "blanks" => [&COLUMNS[..3], &["load", "--response", "sig"], &COLUMNS[6..]].concat(),
            _ => COLUMNS.to_vec(),
        };
        let points = |options: &[&str], says: &[&str]| {
            let place = tempfile::tempdir().unwrap();
            fs::write(place.path().join("t.csv"), &text).unwrap();
            let import = [&["import", "t.csv"], &columns[..], options].concat();
            judge(&wcal(place.path(), &import), 0, says)
                .unwrap_or_else(|why| panic!("{name}: {why}"));
            fs::read_to_string(place.path().join("s/points.csv")).unwrap()
        };
        let said = options.join(" ").replace(
            " --decimal-comma",
            ") and a comma before decimals (--decimal-comma",
        );
        assert_eq!(
            points(&[], &["3 rows", &said]),
            points(options, &["3 rows"]),
            "{name}"
        );
    }
    // Control: what is stated is not looked for, and a comma that may stand between thousands is no
    // decimal one.
    for (text, options, says) in [
        (
            TEXT.replace(',', ";"),
            &["--separator", "tab"][..],
            "a column Force (N)",
        ),
        (
            "Force (N);Signal (mV/V)\n0;1,500\n500;2,500\n".to_owned(),
            &[],
            "thousands separator",
        ),
        (
            "# the\tForce (N)\tof a cell\nForce,Signal\n1,2\n2,3\n".to_owned(),
            &[],
            "found the columns Force, Signal",
        ),
    ] {
        let place = tempfile::tempdir().unwrap();
        fs::write(place.path().join("t.csv"), text).unwrap();
        judge(
            &wcal(
                place.path(),
                &[&["import", "t.csv"], COLUMNS, options].concat(),
            ),
            1,
            &[says],
        )
        .unwrap();
    }
}

#[test]
fn what_needs_no_option_is_read() {
    let cases = [
        ("as it is", TEXT.as_bytes().to_vec()),
        ("byte order mark", format!("\u{feff}{TEXT}").into_bytes()),
        ("CR LF", TEXT.replace('\n', "\r\n").into_bytes()),
        ("CR", TEXT.replace('\n', "\r").into_bytes()),
        ("latin-1", latin1(TEXT)),
        ("UTF-16", utf16(&TEXT.replace('\n', "\r\n"))),
    ];
    let mut points = Vec::new();
    for (name, bytes) in cases {
        let place = tempfile::tempdir().unwrap();
        fs::write(place.path().join("t.csv"), bytes).unwrap();
        judge(
            &wcal(place.path(), &[&["import", "t.csv"], COLUMNS].concat()),
            0,
            &["3 rows"],
        )
        .unwrap_or_else(|why| panic!("{name}: {why}"));
        points.push(fs::read_to_string(place.path().join("s/points.csv")).unwrap());
    }
    assert!(
        points.windows(2).all(|pair| pair[0] == pair[1]),
        "{points:?}"
    );
    // A column whose name holds a semicolon is one column.
    let place = tempfile::tempdir().unwrap();
    fs::write(place.path().join("t.csv"), "a;b\n1\n2\n3\n").unwrap();
    let one = [
        "import",
        "t.csv",
        "--kind",
        "transducer",
        "--response",
        "a;b",
        "--model",
        "constant",
        "--out",
        "s",
    ];
    judge(&wcal(place.path(), &one), 0, &["3 rows"]).unwrap();
}

#[test]
fn sheets_and_archives_are_named_wherever_a_text_is_wanted() {
    for (bytes, says) in [
        (
            &b"PK\x03\x04\x14\x00\x06\x00"[..],
            &["spreadsheet", "CSV UTF-8"][..],
        ),
        (b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1", &[".xls", "CSV UTF-8"]),
        (b"\x1f\x8b\x08\x00", &["gzip", "unpack"]),
    ] {
        let place = tempfile::tempdir().unwrap();
        let session = place.path().join("session");
        fs::create_dir(&session).unwrap();
        Base::Whisker.write(&session);
        fs::write(place.path().join("t.csv"), bytes).unwrap();
        judge(
            &wcal(place.path(), &[&["import", "t.csv"], COLUMNS].concat()),
            1,
            says,
        )
        .unwrap();
        fs::write(session.join("points.csv"), bytes).unwrap();
        judge(
            &wcal(place.path(), &["verify", "session", "--check"]),
            1,
            says,
        )
        .unwrap();
        fs::write(place.path().join("plan.toml"), bytes).unwrap();
        judge(
            &wcal(
                place.path(),
                &[
                    "stage-sweep",
                    "--plan",
                    "plan.toml",
                    "--rig",
                    "plan.toml",
                    "--dry-run",
                ],
            ),
            1,
            says,
        )
        .unwrap();
    }
}

/// A session's own tables have one form; the way to it is named.
#[test]
fn a_sessions_table_in_another_form_names_the_way_out() {
    let base = tempfile::tempdir().unwrap();
    Base::Transducer.write(base.path());
    let table = fs::read_to_string(base.path().join("points.csv")).unwrap();
    for (name, bytes, says) in [
        ("tabs", table.replace(',', "\t").into_bytes(), "tabs"),
        ("CR", table.replace('\n', "\r").into_bytes(), "CR alone"),
        ("UTF-16", utf16(&table), "UTF-16"),
    ] {
        let place = tempfile::tempdir().unwrap();
        Base::Transducer.write(place.path());
        fs::write(place.path().join("points.csv"), bytes).unwrap();
        judge(
            &wcal(place.path(), &["verify", ".", "--check"]),
            1,
            &[says, "wcal import"],
        )
        .unwrap_or_else(|why| panic!("{name}: {why}"));
    }
}

#[test]
fn a_table_of_many_columns_is_refused_within_seconds() {
    let place = tempfile::tempdir().unwrap();
    Base::Transducer.write(place.path());
    let header: Vec<String> = (0..300_000).map(|k| format!("c{k}")).collect();
    let row = vec!["1"; 300_000].join(",");
    fs::write(
        place.path().join("points.csv"),
        format!("{}\n{row}\n", header.join(",")),
    )
    .unwrap();
    judge(
        &limits::limited(place.path(), &["verify", ".", "--check"]),
        1,
        &["columns", "300000"],
    )
    .unwrap();
    fs::write(place.path().join("points.csv"), vec![b'1'; 20_000_000]).unwrap();
    judge(
        &limits::limited(place.path(), &["verify", ".", "--check"]),
        1,
        &["points.csv", "at most"],
    )
    .unwrap();
}

/// An ASCII box; corners as text.
fn solid(name: &str, x0: f64, size: f64) -> String {
    let corner = |k: usize| {
        let at = |bit: usize| if k >> bit & 1 == 1 { size } else { 0.0 };
        format!("{} {} {}", x0 + at(0), at(1), at(2))
    };
    let faces = [
        [0, 2, 3, 1],
        [4, 5, 7, 6],
        [0, 1, 5, 4],
        [2, 6, 7, 3],
        [0, 4, 6, 2],
        [1, 3, 7, 5],
    ];
    let mut text = format!("solid {name}\n");
    for [a, b, c, d] in faces {
        for triangle in [[a, b, c], [a, c, d]] {
            let [p, q, r] = triangle.map(corner);
            text += &format!(
                "facet normal 0 0 0\nouter loop\nvertex {p}\nvertex {q}\nvertex {r}\nendloop\nendfacet\n"
            );
        }
    }
    text + &format!("endsolid {name}\n")
}

/// The same box in binary.
fn binary(text: &str, header: &str) -> Vec<u8> {
    let numbers: Vec<[f32; 3]> = text
        .lines()
        .filter_map(|line| line.strip_prefix("vertex "))
        .map(|line| {
            line.split(' ')
                .map(|n| n.parse().unwrap())
                .collect::<Vec<f32>>()
                .try_into()
                .unwrap()
        })
        .collect();
    let mut bytes = format!("{header:<80}").into_bytes();
    bytes.extend(u32::try_from(numbers.len() / 3).unwrap().to_le_bytes());
    for triangle in numbers.chunks(3) {
        bytes.extend([0; 12]);
        bytes.extend(triangle.iter().flatten().flat_map(|x| x.to_le_bytes()));
        bytes.extend([0; 2]);
    }
    bytes
}

/// The sweeps over a mesh, as its shard's tables say.
fn swept(mesh: &[u8]) -> Result<Vec<u8>, String> {
    let place = tempfile::tempdir().unwrap();
    fs::write(place.path().join("m.stl"), mesh).unwrap();
    let run = wcal(
        place.path(),
        &[
            "simulate", "--meshes", "m.stl", "--sweeps", "2", "--out", "o",
        ],
    );
    judge(&run, 0, &[])?;
    let names = listing(&place.path().join("o"));
    let samples = names
        .iter()
        .find(|name| name.ends_with(".samples.parquet"))
        .unwrap();
    Ok(fs::read(place.path().join("o").join(samples)).unwrap())
}

#[test]
fn a_mesh_is_read_as_programs_write_it() {
    let plain = solid("a", 0.0, 40.0);
    let expected = swept(plain.as_bytes()).unwrap();
    let same = [
        ("no name", plain.replace("solid a", "solid").into_bytes()),
        ("capitals", plain.to_uppercase().into_bytes()),
        (
            "tabs and a byte order mark",
            format!("\u{feff}{}", plain.replace(' ', "\t")).into_bytes(),
        ),
        ("binary", binary(&plain, "made by a scanner")),
        (
            "binary that begins with solid",
            binary(&plain, "solid a exported by CAD"),
        ),
    ];
    for (name, bytes) in same {
        assert!(
            swept(&bytes).unwrap_or_else(|why| panic!("{name}: {why}")) == expected,
            "{name}: other sweeps"
        );
    }
    // Every solid counts: another one beside the first is another object.
    let two = plain.clone() + &solid("b", 100.0, 40.0);
    assert!(
        swept(two.as_bytes()).unwrap() != expected,
        "the second solid is read"
    );
    let error = swept(&binary(&plain, "solid a")[..400]).unwrap_err();
    assert!(
        error.contains("expected 12 triangles") && error.contains("cut off"),
        "{error}"
    );
}

#[test]
fn formats_of_other_versions_are_refused() {
    let place = tempfile::tempdir().unwrap();
    let write = |name: &str, text: &str| fs::write(place.path().join(name), text).unwrap();
    let simulate = [
        "simulate",
        "--object",
        "can",
        "--sweeps",
        "1",
        "--whisker",
        "w.toml",
        "--out",
        "o",
    ];
    let keys = "[whisker]\ndiameter_mm = 0.3\nlength_mm = 60.0\nstraight_mm = 30.0\narc_radius_mm = 20.0\n";
    for (format, code) in [
        ("", 0),
        ("format = \"wcal-whisker/1\"\n", 0),
        ("format = \"wcal-session/1\"\n", 0),
        ("format = \"wcal-whisker/9\"\n", 1),
        ("format = \"wcal-plan/1\"\n", 1),
        ("format = 1\n", 1),
    ] {
        write("w.toml", &format!("{format}{keys}"));
        let says: &[&str] = if code == 1 {
            &["w.toml", "wcal-whisker/1"]
        } else {
            &[]
        };
        judge(&wcal(place.path(), &simulate), code, says)
            .unwrap_or_else(|why| panic!("{format:?}: {why}"));
        let _ = fs::remove_dir_all(place.path().join("o"));
    }
}

#[test]
fn a_whisker_of_metres_or_with_exchanged_moduli_is_named() {
    let place = tempfile::tempdir().unwrap();
    let good = "[whisker]\ndiameter_mm = 0.3\nlength_mm = 60.0\nstraight_mm = 30.0\narc_radius_mm = 20.0\nyoungs_gpa = 75.0\nshear_gpa = 28.2\n";
    let run = || {
        wcal(
            place.path(),
            &[
                "simulate",
                "--object",
                "can",
                "--sweeps",
                "1",
                "--whisker",
                "w.toml",
                "--out",
                "o",
            ],
        )
    };
    for (from, to, says) in [
        (
            "length_mm = 60.0",
            "length_mm = 0.06",
            "length_mm: expected a number between 1 and 2000, found 0.06 (in m?)",
        ),
        (
            "diameter_mm = 0.3",
            "diameter_mm = 300",
            "diameter_mm: expected a number between 0.005 and 10, found 300 (in um?)",
        ),
        ("youngs_gpa = 75.0", "youngs_gpa = 75e9", "(in Pa?)"),
        (
            "shear_gpa = 28.2",
            "shear_gpa = 282",
            "less than youngs_gpa = 75",
        ),
        (
            "straight_mm = 30.0",
            "straight_mm = 61",
            "at most length_mm = 60",
        ),
    ] {
        fs::write(place.path().join("w.toml"), good.replace(from, to)).unwrap();
        judge(&run(), 1, &["w.toml", says]).unwrap();
    }
    // Control: other wires are wires.
    for (from, to) in [("75.0", "3.2"), ("28.2", "1.2")].map(|(a, b)| (a, b)) {
        fs::write(
            place.path().join("w.toml"),
            good.replace("28.2", "1.2").replace(from, to),
        )
        .unwrap();
        judge(&run(), 0, &[]).unwrap();
        fs::remove_dir_all(place.path().join("o")).unwrap();
    }
}
