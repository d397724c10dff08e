//! Tables as other programs write them: found, read and said, or refused with the way out. Each
//! holds the same eight readings.

use super::*;

const READINGS: [(u32, &str); 8] = [
    (0, "0.1003"),
    (1000, "0.4998"),
    (2000, "0.9005"),
    (3000, "1.2996"),
    (0, "0.0996"),
    (1000, "0.5003"),
    (2000, "0.8997"),
    (3000, "1.3004"),
];

/// One line a reading.
fn lines(line: impl Fn(usize, u32, &str) -> String) -> Vec<String> {
    READINGS
        .iter()
        .enumerate()
        .map(|(k, (load, sig))| line(k, *load, sig) + "\n")
        .collect()
}

fn plain() -> Vec<String> {
    lines(|_, load, sig| format!("{load},{sig}"))
}

/// A table under `header`.
fn under(header: &str, rows: &[String]) -> String {
    format!("{header}\n{}", rows.concat())
}

/// The readings with a time `step` apart before them, under `t`.
fn timed(t: &str, time: impl Fn(usize) -> String) -> String {
    under(
        &format!("{t};load;sig"),
        &lines(|k, load, sig| format!("{};{load};{sig}", time(k))),
    )
}

/// Imports a table; its exit code, what it says, and its points without their numbers and roles.
fn import(table: &str, more: &[&str]) -> (i32, String, Vec<String>) {
    let place = tempfile::tempdir().unwrap();
    fs::write(place.path().join("t.csv"), table).unwrap();
    let signals = ["--stimulus", "load", "--response", "sig"];
    let signals = if more.contains(&"--stimulus") {
        &[][..]
    } else {
        &signals[..]
    };
    let start = [
        "import",
        "t.csv",
        "--kind",
        "transducer",
        "--model",
        "linear",
        "--out",
        "s",
    ];
    let output = wcal(place.path(), &[&start, signals, more].concat());
    let said = [output.stdout, output.stderr]
        .map(|text| String::from_utf8(text).unwrap())
        .concat();
    let points = fs::read_to_string(place.path().join("s/points.csv")).unwrap_or_default();
    let cells = |line: &str| line.splitn(3, ',').nth(2).unwrap_or_default().to_owned();
    (
        output.status.code().unwrap(),
        said,
        points.lines().skip(1).map(cells).collect(),
    )
}

/// The points of all readings but some.
fn points(without: &[usize]) -> Vec<String> {
    let kept = READINGS
        .iter()
        .enumerate()
        .filter(|(k, _)| !without.contains(k));
    kept.map(|(_, (load, sig))| format!("{load},{}", sig.parse::<f64>().unwrap()))
        .collect()
}

#[test]
fn a_table_is_found_among_the_lines_around_it() {
    let rows = plain();
    let half = |middle: &str| {
        format!(
            "load,sig\n{}{middle}{}",
            rows[..4].concat(),
            rows[4..].concat()
        )
    };
    let toa5 =
        "\"TOA5\",\"st\"\n\"TIME\",\"load\",\"sig\"\n\"TS\",\"N\",\"mV\"\n\"\",\"Smp\",\"Avg\"\n";
    let lvm = "LabVIEW Measurement\t\nSeparator\tTab\nDecimal_Separator\t,\n***End_of_Header***\t\n\n\
        Y_Unit_Label\tNewton\tVolts\t\nX0\t0,0\t0,0\t\nDelta_X\t0,5\t0,5\t\n***End_of_Header***\t\t\t\nX_Value\tload\tsig\tComment\n";
    let cases: &[(&str, String, &[&str], i32, &str)] = &[
        ("plain", under("load,sig", &rows), &[], 0, ""),
        (
            "sep=",
            format!("sep=;\n{}", under("load,sig", &rows).replace(',', ";")),
            &[],
            0,
            "line 1",
        ),
        ("comment", half("# second cycle\n"), &[], 0, "line(s) 6"),
        ("commented header", under("# load,sig", &rows), &[], 0, ""),
        (
            "metadata",
            format!(
                "Model,X\n\nFormat,Y,\nScale,2e-3\n{}",
                under("load,sig", &rows)
            ),
            &[],
            0,
            "line 5",
        ),
        (
            "open quote",
            format!("Note,\"abc\n{}", under("load,sig", &rows)),
            &[],
            0,
            "line 2",
        ),
        (
            "unit row",
            under("load,sig\nN,mV", &rows),
            &[],
            0,
            "load in N, sig in mV",
        ),
        (
            "unit row partly empty",
            under("load,sig\nN,", &rows),
            &[],
            0,
            "load in N",
        ),
        (
            "trailing separators",
            under("load,sig,", &rows).replace("\n", ",\n"),
            &[],
            0,
            "",
        ),
        (
            "footer",
            under("load,sig", &rows) + "Mean,1.1003\nEnd,\n",
            &[],
            3,
            "line(s) 10, 11",
        ),
        (
            "footer of other width",
            under("load,sig", &rows) + "\nOperator: 5\n",
            &[],
            3,
            "line(s) 11",
        ),
        ("header again", half("load,sig\n"), &[], 3, "line(s) 6"),
        (
            "header and units again",
            half("load,sig\nN,mV\n"),
            &[],
            3,
            "line(s) 6",
        ),
        (
            "metadata again",
            half("Model,X\nload,sig\n"),
            &[],
            3,
            "line(s) 6",
        ),
        (
            "text between",
            half("--- cycle 2 ---\n"),
            &[],
            3,
            "line(s) 6",
        ),
        (
            "line break in the header",
            under("\"load\n(N)\",sig", &rows),
            &[
                "--stimulus",
                "load (N)",
                "--response",
                "sig",
                "--stimulus-unit",
                "N",
            ],
            0,
            "",
        ),
        (
            "TOA5",
            toa5.to_owned() + &lines(|_, load, sig| format!("\"\",{load},{sig}")).concat(),
            &[],
            0,
            "3, 4",
        ),
        (
            "lvm",
            lvm.to_owned()
                + &lines(|_, load, sig| format!("\t{load}\t{}\t", sig.replace('.', ","))).concat(),
            &["--stimulus-unit", "N", "--response-unit", "V"],
            0,
            "LabVIEW",
        ),
    ];
    for (name, table, more, code, says) in cases {
        let (found, said, held) = import(table, more);
        assert_eq!((found, &held), (*code, &points(&[])), "{name}: {said}");
        assert!(said.contains(says), "{name}: {said}");
    }
    // A statistic in a column of labels, and a column that is called #.
    for head in ["id,load,sig", "#,load,sig"] {
        let rows = lines(|k, load, sig| format!("P{k},{load},{sig}"));
        let (code, said, held) = import(&(under(head, &rows) + "Mean:,1500,0.7\n"), &[]);
        assert_eq!((code, held), (3, points(&[])), "{head}: {said}");
    }
    let (code, said, _) = import(&half("sig,load\n"), &[]);
    assert!(
        code == 1 && said.contains("line 6") && said.contains("sig, load"),
        "{said}"
    );
    let (code, said, _) = import(&under("load,sig", &rows).replace("1.3004", "1.3x04"), &[]);
    assert!(
        code == 1 && said.contains("line 9") && said.contains("1.3x04"),
        "no footer: {said}"
    );
}

#[test]
fn numbers_and_missing_values_of_other_programs_are_read() {
    let rows = plain();
    for load in [
        |load: u32| format!("{:.1}D+01", f64::from(load) / 10.0),
        |load| format!("{load}").replace("000", " 000"),
    ] {
        let table = under("load,sig", &lines(|_, x, sig| format!("{},{sig}", load(x))));
        assert_eq!(import(&table, &[]).2, points(&[]), "{table}");
    }
    for word in [
        "NaN",
        "n/a",
        "-",
        "",
        "OL",
        "#DIV/0!",
        "1.#INF",
        "Overflow",
        "-\u{221e}",
    ] {
        let table = under("load,sig", &rows).replace("0.9005", word);
        let (code, said, held) = import(&table, &[]);
        assert_eq!((code, held), (3, points(&[2])), "{word}: {said}");
        assert!(
            said.contains("line(s) 4") && said.contains("t.csv"),
            "{word}: {said}"
        );
    }
    // Codes stay in the session, which leaves them out; the lines are the file's.
    for code in ["-1000000", "1E+09", "-7999"] {
        let table = format!("Note\n{}", under("load,sig", &rows).replace("0.9005", code));
        let (exit, said, _) = import(&table, &[]);
        assert!(
            exit == 3 && said.contains("overflow value") && said.contains("line(s) 5"),
            "{code}: {said}"
        );
    }
    // Control: decades are readings.
    let decades: Vec<String> = (0..6).map(|k| format!("{k},1E{k}\n")).collect();
    let (code, said, _) = import(&under("load,sig", &decades), &[]);
    assert!(code == 0 && !said.contains("overflow"), "{said}");
    let direction = under(
        "load,sig,way",
        &lines(|k, x, sig| format!("{x},{sig},{}", ["up", "-"][k / 4])),
    );
    let (_, said, held) = import(&direction, &["--direction", "way"]);
    assert!(
        held[0].ends_with(",1") && held[4].ends_with(",-1"),
        "{held:?} {said}"
    );
}

/// First time and step of the samples below the header of an oscilloscope.
#[test]
fn samples_that_are_counted_have_times() {
    let rows = |last: &'static str| lines(move |k, load, sig| format!("{k},{load},{sig}{last}"));
    for (head, below, last) in [
        (
            "X,load,sig,Start,Increment",
            "Sequence,N,mV,-2.5e-1,0.5",
            ",,",
        ),
        (
            "X,load,sig,XZERO,XINCREMENT",
            "Sequence,N,mV,-2.5e-1,5e-01",
            "",
        ),
    ] {
        let table = format!("{head}\n{below}\n{}", rows(last).concat());
        let (code, said, held) = import(&table, &["--time", "X"]);
        assert!(
            code == 0 && said.contains("counts samples"),
            "{code} {said}"
        );
        assert!(
            held[0].ends_with(",-0.25") && held[4].ends_with(",1.75"),
            "{held:?}"
        );
    }
    // Control: columns of these names with a number in each row are columns.
    let table = format!("X,load,sig,Start,Increment\n{}", rows(",0,0.5").concat());
    let (_, said, held) = import(&table, &["--time", "X"]);
    assert!(
        !said.contains("counts samples") && held[4].ends_with(",4"),
        "{said} {held:?}"
    );
}

#[test]
fn times_are_in_the_unit_that_the_table_states_or_it_is_asked() {
    let seconds = |table: &str, t: &str| {
        let (code, said, held) = import(table, &["--separator", "semicolon", "--time", t]);
        let last = held
            .last()
            .and_then(|line| line.rsplit(',').next()?.parse::<f64>().ok());
        (
            code,
            last.map(|s| s - held[0].rsplit(',').next().unwrap().parse::<f64>().unwrap()),
            said,
        )
    };
    let clock = |k: usize| {
        format!(
            "{:02}:{:02}:{:02}",
            (23 + k.div_ceil(3)) % 24,
            (40 + 20 * k) % 60,
            5
        )
    };
    let stamp = |k: usize| format!("2025-03-0{}T{}", 4 + usize::from(k > 0), clock(k));
    for (t, time) in [
        (
            "t_s",
            &(|k: usize| (1200 * k).to_string()) as &dyn Fn(usize) -> String,
        ),
        ("time_ms", &|k: usize| (1_200_000 * k).to_string()),
        ("Zeit (min)", &|k: usize| (20 * k).to_string()),
        ("Zeit [Tage]", &|k: usize| {
            format!("{:.7}", 45720.4 + k as f64 / 72.0)
        }),
        ("clock", &clock),
        ("t [mm:ss]", &|k| format!("{:02}:00", 20 * k)),
        ("Zeit (hh:mm)", &|k| {
            format!("{}:{:02}", 10 + k / 3, 20 * (k % 3))
        }),
        ("stamp", &stamp),
        ("day first", &|k: usize| {
            format!("0{}.03.2025 {}", 4 + usize::from(k > 0), clock(k))
        }),
    ] {
        let (code, last, said) = seconds(&timed(t, time), t);
        assert!(
            code == 0 && last.is_some_and(|s| (s - 8400.0).abs() < 0.01),
            "{t}: {last:?} {said}"
        );
    }
    for (time, code, way) in [
        (
            &(|k: usize| (1_741_132_330_000_u64 + k as u64).to_string())
                as &dyn Fn(usize) -> String,
            1,
            "t*0.001",
        ),
        (
            &|k: usize| format!("{:.7}", 45720.4 + k as f64 / 4320.0),
            3,
            "t*86400",
        ),
        (&|k: usize| (20_000 * k + 1000).to_string(), 3, "t*0.001"),
    ] {
        let (found, _, said) = seconds(&timed("t", time), "t");
        assert!(found == code && said.contains(way), "{said}");
    }
    // Control: nothing says which of the two they are.
    let (code, _, said) = seconds(&timed("t", |k| format!("{:02}:00", 20 * k)), "t");
    assert!(code == 1 && said.contains("write hh:mm:ss"), "{said}");
    let units =
        |below: &str, more: &[&str]| import(&under(&format!("load,sig\n{below}"), &plain()), more);
    let (code, said, _) = units("kN,mV", &["--stimulus-unit", "N"]);
    assert!(code == 1 && said.contains("load*1000"), "{said}");
    let (code, said, _) = units(
        "Newton,mV",
        &["--stimulus-unit", "N", "--response-unit", "mV"],
    );
    assert_eq!(code, 0, "{said}");
}

#[test]
fn a_column_of_uncertainties_is_no_covariate() {
    let table = under(
        "load,u_load,sig",
        &lines(|_, x, sig| format!("{x},0.1,{sig}")),
    );
    let (code, said, _) = import(&table, &[]);
    assert!(code == 0 && said.contains("u_load"), "{said}");
    let (_, said, _) = import(&table.replace("u_load", "humidity"), &[]);
    assert!(
        said.contains("--covariate") && !said.contains("uncertainty"),
        "control: {said}"
    );
}

#[test]
fn a_second_table_is_named_and_never_mixed_in() {
    let rows = plain();
    let table = |between: &str, rest: &str| under("load,sig", &rows) + between + rest;
    for (rest, says) in [
        (
            "temp,offset\n15,0.0501\n20,0.0502\n",
            "line 11 (\"temp, offset\"): its 2 line(s)",
        ),
        (
            "temp,zero,note\nC,mV,\n15,0.05,7\n",
            "line 11 (\"temp, zero, note\"): its 2 line(s)",
        ),
    ] {
        let (code, said, held) = import(&table("\n", rest), &[]);
        assert_eq!((code, held), (3, points(&[])), "{said}");
        assert!(said.contains(says), "{said}");
    }
    // Without a line between them it may be a remark: it is asked.
    let (code, said, _) = import(&table("", "temp,offset\n15,0.0501\n"), &[]);
    assert!(
        code == 1 && said.contains("line 10") && said.contains("with #"),
        "{said}"
    );
    // The first table goes on below its own header.
    let half = format!(
        "load,sig\n{}\ntemp,zero\n15,0.05\n\nload,sig\n{}",
        rows[..4].concat(),
        rows[4..].concat()
    );
    let (code, said, held) = import(&half, &[]);
    assert_eq!((code, held), (3, points(&[])), "{said}");
    // Controls: a blank line, and a remark of one field.
    for between in ["\n", "\n--- cycle 2 ---\n"] {
        let table = format!(
            "load,sig\n{}{between}{}",
            rows[..4].concat(),
            rows[4..].concat()
        );
        let (_, said, held) = import(&table, &[]);
        assert!(
            held == points(&[]) && !said.contains("another table"),
            "{said}"
        );
    }
}

#[test]
fn what_looks_like_a_reading_is_read_or_refused_and_not_passed_over() {
    let negative = |form: fn(u32) -> String| {
        under("load,sig", &lines(|_, x, sig| format!("{},{sig}", form(x))))
    };
    let below = |x: u32| {
        if x == 0 {
            "0".to_owned()
        } else {
            format!("-{x}")
        }
    };
    let wanted = import(
        &negative(|x| {
            if x == 0 {
                "0".to_owned()
            } else {
                format!("-{x}")
            }
        }),
        &[],
    )
    .2;
    assert!(wanted[1].starts_with(&below(1000)), "{wanted:?}");
    for form in [
        (|x| {
            if x == 0 {
                "0".to_owned()
            } else {
                format!("({x})")
            }
        }) as fn(u32) -> String,
        |x| {
            if x == 0 {
                "0".to_owned()
            } else {
                format!("{x}-")
            }
        },
    ] {
        let (code, said, held) = import(&negative(form), &[]);
        assert_eq!((code, &held), (0, &wanted), "{said}");
        assert!(
            said.contains("1000") && said.contains("(6 cells)"),
            "{said}"
        );
    }
    // A form numbers its columns; a note in parentheses is text.
    let (code, said, held) = import(&under("load,sig\n(1),(2)", &plain()), &[]);
    assert!(
        code == 0 && held == points(&[]) && !said.contains("negative"),
        "{said}"
    );
    let (code, said, _) = import(
        &under("load,sig", &plain()).replace("1000,", "(1000 N),"),
        &[],
    );
    assert!(
        code == 1 && said.contains("line 3") && said.contains("(1000 N)"),
        "{said}"
    );
    // Units in the cells.
    let units = under(
        "load;sig",
        &lines(|k, x, sig| format!("{x}{};{sig}", if k % 2 == 1 { " N" } else { "" })),
    );
    let (code, said, _) = import(&units, &[]);
    assert!(code == 1 && said.contains("1000 N"), "{said}");
}

#[test]
fn a_column_without_a_name_is_called_by_its_place() {
    let head = |head: &str| under(head, &lines(|k, x, sig| format!("{x},{}.5,{sig}", 20 + k)));
    let (code, said, held) = import(&head("load,,sig"), &["--temperature", "column 2"]);
    assert!(code == 0 && held[0] == "0,0.1003,20.5", "{held:?} {said}");
    let (_, said, _) = import(&head("load,,sig"), &[]);
    assert!(said.contains(": column 2"), "{said}");
    // At the end, and none of them holds anything.
    let tail = under(
        "load,sig,,",
        &lines(|k, x, sig| format!("{x},{sig},{}.5,", 20 + k)),
    );
    let (_, said, held) = import(&tail, &["--temperature", "column 3"]);
    assert_eq!(held[7], "3000,1.3004,27.5", "{said}");
    let (code, said, held) = import(
        &under(",load,,sig,", &lines(|_, x, sig| format!(",{x},,{sig},"))),
        &[],
    );
    assert!(
        code == 0 && held == points(&[]) && !said.contains("not imported"),
        "{said}"
    );
    let (code, said, _) = import(&under("load,sig", &plain()), &["--temperature", "column 3"]);
    assert!(
        code == 1 && said.contains("a column column 3") | said.contains("column 3"),
        "control: {said}"
    );
}

#[test]
fn date_and_clock_in_two_columns_are_one_time() {
    let two = |date: fn(usize) -> String, clock: fn(usize) -> String| {
        under(
            "date,clock,load,sig",
            &lines(|k, x, sig| format!("{},{},{x},{sig}", date(k), clock(k))),
        )
    };
    let iso = |k: usize| format!("2026-03-{}", 11 + k / 4);
    let german = |k: usize| format!("{}.03.2026", 11 + k / 4);
    for (table, asked) in [
        (two(iso, |k| format!("09:{:02}:00", k % 4)), "clock"),
        (two(iso, |k| format!("09:{:02}:00", k % 4)), "date"),
        (two(german, |k| format!("9:{:02}", k % 4)), "clock"),
        (two(german, |k| format!("9:{:02} AM", k % 4)), "clock"),
    ] {
        let (code, said, held) = import(&table, &["--time", asked]);
        let last = held[7].rsplit(',').next().unwrap().to_owned();
        assert_eq!((code, last.as_str()), (0, "86580"), "{said}");
        assert!(
            said.contains("date") && said.contains("clock") && !said.contains("not imported"),
            "{said}"
        );
    }
    // Control: a clock alone, and one that is asked for as a number.
    let alone = under(
        "clock,load,sig",
        &lines(|k, x, sig| format!("09:0{k}:00,{x},{sig}")),
    );
    let (_, said, held) = import(&alone, &["--time", "clock"]);
    assert!(
        held[7].ends_with(",420") && !said.contains(" with "),
        "{said}"
    );
}

#[test]
fn a_unit_in_a_name_is_compared_in_every_form() {
    let named = |name: &str, more: &[&str]| {
        let options = [&["--stimulus", name, "--response", "sig"], more].concat();
        import(&under(&format!("{name},sig"), &plain()), &options)
    };
    for name in ["F / kN", "F in kN", "F [kN]", "F (kN)", "F_kN", "F kN"] {
        let (code, said, _) = named(name, &["--stimulus-unit", "N"]);
        assert!(
            code == 1 && said.contains(&format!("--stimulus '{name}*1000'")),
            "{name}: {said}"
        );
        let (code, said, _) = named(name, &["--stimulus-unit", "kN"]);
        assert!(
            code == 0 && !said.contains("though"),
            "control {name}: {said}"
        );
        let (_, said, _) = named(name, &[]);
        assert!(said.contains("kN"), "{name}: {said}");
    }
    for name in ["F / kN", "F in kN", "F [kN]", "F (kN)"] {
        let (code, said, _) = named(name, &["--stimulus-unit", "V"]);
        assert!(code == 1 && said.contains("another unit"), "{name}: {said}");
    }
    // In a line below another one, and in a column of its own: one in every row.
    let (code, said, _) = import(
        &under("load,sig\n(applied),(bridge)\nkN,mV", &plain()),
        &["--stimulus-unit", "N"],
    );
    assert!(code == 1 && said.contains("load*1000"), "{said}");
    let beside = |unit: fn(usize) -> &'static str| {
        let rows = lines(|k, x, sig| format!("{x},{sig},{}", unit(k)));
        import(&under("load,sig,Unit", &rows), &["--response-unit", "V"])
    };
    let (code, said, _) = beside(|k| if k % 4 == 0 { "mV" } else { "V" });
    assert!(
        code == 1 && said.contains("line 3") && said.contains("mV and V"),
        "{said}"
    );
    let (code, said, _) = beside(|_| "mV");
    assert!(code == 1 && said.contains("sig*0.001"), "{said}");
    assert_eq!(beside(|_| "V").0, 0, "control");
    // What only may be a unit is said.
    let (code, said, _) = named("F_kN", &["--stimulus-unit", "V"]);
    assert!(code == 0 && said.contains("as V,"), "{said}");
    let (_, said, _) = named("position in frame", &["--stimulus-unit", "mm"]);
    assert!(!said.contains("though"), "{said}");
}

/// Runs `verify` of a session made of the readings, with a later table held out, and `predict` of
/// that table.
fn held_out(header: &str, later: &str, import: &[&str]) -> (i32, String, i32, String) {
    let place = tempfile::tempdir().unwrap();
    let wobble = |k: usize| ((k as f64 * 12.9898).sin() * 43758.5453).rem_euclid(1.0) - 0.5;
    let rows = |seed: usize, day: usize| -> String {
        let row = |k: usize| {
            let x = 0.5 * (k % 11) as f64;
            let y = 0.3 + 0.02 * x + 1e-3 * wobble(k + seed);
            format!("{day:02}.03.2026;10:{k:02};{x:.1};{y:.5}\n")
                .replace('.', ",")
                .replace(",03,2026", ".03.2026")
        };
        (0..33).map(row).collect()
    };
    fs::write(
        place.path().join("a.csv"),
        format!("{header}\n{}", rows(0, 11)),
    )
    .unwrap();
    fs::write(
        place.path().join("h.csv"),
        format!("{later}\n{}", rows(100, 12)),
    )
    .unwrap();
    let start = [
        "import",
        "a.csv",
        "--kind",
        "transducer",
        "--model",
        "linear",
        "--out",
        "s",
    ];
    let run = |arguments: &[&str]| {
        let output = wcal(place.path(), arguments);
        let said = [output.stdout, output.stderr]
            .map(|text| String::from_utf8(text).unwrap())
            .concat();
        (output.status.code().unwrap(), said)
    };
    let (code, said) = run(&[&start, import].concat());
    assert_eq!(code, 0, "{said}");
    let (verified, said) = run(&["verify", "s", "--holdout", "h.csv", "--out", "v"]);
    let _ = run(&["verify", "s", "--out", "w"]);
    let (predicted, more) = run(&[
        "predict",
        "h.csv",
        "--calibration",
        "w/calibration.json",
        "--out",
        "p.csv",
    ]);
    (verified, said, predicted, more)
}

#[test]
fn a_holdout_has_the_columns_of_the_table_that_was_imported() {
    let asked = [
        "--stimulus",
        "Kraft",
        "--response",
        "Signal",
        "--time",
        "Uhrzeit",
    ];
    let head = "Datum;Uhrzeit;Kraft;Signal";
    let (verified, said, predicted, more) = held_out(head, head, &asked);
    assert!(verified == 0 && said.contains("from Kraft"), "{said}");
    assert!(said.contains("Uhrzeit since 11.03.2026 10:00"), "{said}");
    assert_eq!(predicted, 0, "{more}");
    // The unit that a later table states is compared.
    let (verified, said, predicted, more) = held_out(
        head,
        &format!("{head}\n;;N;kV"),
        &[&asked[..], &["--response-unit", "V"]].concat(),
    );
    assert!(verified == 1 && said.contains("found kV"), "{said}");
    assert!(predicted == 1 && more.contains("found kV"), "{more}");
    let same = format!("{head}\n;;N;V");
    let (verified, said, predicted, _) = held_out(
        head,
        &same,
        &[&asked[..], &["--response-unit", "V"]].concat(),
    );
    assert_eq!((verified, predicted), (0, 0), "control: {said}");
    // A table of the session's names needs no numbers and roles.
    let own = "Datum;t;stimulus;response";
    let (verified, said, _, _) = held_out(
        own,
        own,
        &["--stimulus", "stimulus", "--response", "response"],
    );
    assert!(verified == 0 && said.contains("held out"), "{said}");
    // Control: another table, and one without a needed column.
    let (verified, said, predicted, _) = held_out(head, "Datum;Uhrzeit;x;y", &asked);
    assert!(
        verified == 1 && predicted == 1 && said.contains("expected"),
        "{said}"
    );
    let (verified, said, predicted, _) = held_out(head, "Datum;Uhrzeit;Kraft;y", &asked);
    assert!(verified == 1 && predicted == 0, "{said}");
    assert!(said.contains("a column Signal"), "{said}");
}
