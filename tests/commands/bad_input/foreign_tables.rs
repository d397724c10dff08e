//! Tables as other programs write them: found, read and said, or refused with the way out. Each holds the same eight readings.

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
    READINGS.iter().enumerate().map(|(k, (load, sig))| line(k, *load, sig) + "\n").collect()
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
    under(&format!("{t};load;sig"), &lines(|k, load, sig| format!("{};{load};{sig}", time(k))))
}

/// Imports a table; its exit code, what it says, and its points without their numbers and roles.
fn import(table: &str, more: &[&str]) -> (i32, String, Vec<String>) {
    let place = tempfile::tempdir().unwrap();
    fs::write(place.path().join("t.csv"), table).unwrap();
    let signals = ["--stimulus", "load", "--response", "sig"];
    let signals = if more.contains(&"--stimulus") { &[][..] } else { &signals[..] };
    let start = ["import", "t.csv", "--kind", "transducer", "--model", "linear", "--out", "s"];
    let output = wcal(place.path(), &[&start, signals, more].concat());
    let said = [output.stdout, output.stderr].map(|text| String::from_utf8(text).unwrap()).concat();
    let points = fs::read_to_string(place.path().join("s/points.csv")).unwrap_or_default();
    let cells = |line: &str| line.splitn(3, ',').nth(2).unwrap_or_default().to_owned();
    (output.status.code().unwrap(), said, points.lines().skip(1).map(cells).collect())
}

/// The points of all readings but some.
fn points(without: &[usize]) -> Vec<String> {
    let kept = READINGS.iter().enumerate().filter(|(k, _)| !without.contains(k));
    kept.map(|(_, (load, sig))| format!("{load},{}", sig.parse::<f64>().unwrap())).collect()
}

#[test]
fn a_table_is_found_among_the_lines_around_it() {
    let rows = plain();
    let half = |middle: &str| format!("load,sig\n{}{middle}{}", rows[..4].concat(), rows[4..].concat());
    let toa5 = "\"TOA5\",\"st\"\n\"TIME\",\"load\",\"sig\"\n\"TS\",\"N\",\"mV\"\n\"\",\"Smp\",\"Avg\"\n";
    let lvm = "LabVIEW Measurement\t\nSeparator\tTab\nDecimal_Separator\t,\n***End_of_Header***\t\n\n\
        Y_Unit_Label\tNewton\tVolts\t\nX0\t0,0\t0,0\t\nDelta_X\t0,5\t0,5\t\n***End_of_Header***\t\t\t\nX_Value\tload\tsig\tComment\n";
    let cases: &[(&str, String, &[&str], i32, &str)] = &[
        ("plain", under("load,sig", &rows), &[], 0, ""),
        ("sep=", format!("sep=;\n{}", under("load,sig", &rows).replace(',', ";")), &[], 0, "line 1"),
        ("comment", half("# second cycle\n"), &[], 0, "line(s) 6"),
        ("commented header", under("# load,sig", &rows), &[], 0, ""),
        (
            "metadata",
            format!("Model,X\n\nFormat,Y,\nScale,2e-3\n{}", under("load,sig", &rows)),
            &[],
            0,
            "line 5",
        ),
        ("open quote", format!("Note,\"abc\n{}", under("load,sig", &rows)), &[], 0, "line 2"),
        ("unit row", under("load,sig\nN,mV", &rows), &[], 0, "load in N, sig in mV"),
        ("unit row partly empty", under("load,sig\nN,", &rows), &[], 0, "load in N"),
        ("trailing separators", under("load,sig,", &rows).replace("\n", ",\n"), &[], 0, ""),
        ("footer", under("load,sig", &rows) + "Mean,1.1003\nEnd,\n", &[], 3, "line(s) 10, 11"),
        ("footer of other width", under("load,sig", &rows) + "\nOperator: 5\n", &[], 3, "line(s) 11"),
        ("header again", half("load,sig\n"), &[], 3, "line(s) 6"),
        ("header and units again", half("load,sig\nN,mV\n"), &[], 3, "line(s) 6"),
        ("metadata again", half("Model,X\nload,sig\n"), &[], 3, "line(s) 6"),
        ("text between", half("--- cycle 2 ---\n"), &[], 3, "line(s) 6"),
        (
            "line break in the header",
            under("\"load\n(N)\",sig", &rows),
            &["--stimulus", "load (N)", "--response", "sig", "--stimulus-unit", "N"],
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
            lvm.to_owned() + &lines(|_, load, sig| format!("\t{load}\t{}\t", sig.replace('.', ","))).concat(),
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
    assert!(code == 1 && said.contains("line 6") && said.contains("sig, load"), "{said}");
    let (code, said, _) = import(&under("load,sig", &rows).replace("1.3004", "1.3x04"), &[]);
    assert!(code == 1 && said.contains("line 9") && said.contains("1.3x04"), "no footer: {said}");
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
    for word in ["NaN", "n/a", "-", "", "OL", "#DIV/0!", "1.#INF", "Overflow"] {
        let table = under("load,sig", &rows).replace("0.9005", word);
        let (code, said, held) = import(&table, &[]);
        assert_eq!((code, held), (3, points(&[2])), "{word}: {said}");
        assert!(said.contains("line(s) 4") && said.contains("t.csv"), "{word}: {said}");
    }
    // Codes stay in the session, which leaves them out; the lines are the file's.
    for code in ["-1000000", "1E+09", "-7999"] {
        let table = format!("Note\n{}", under("load,sig", &rows).replace("0.9005", code));
        let (exit, said, _) = import(&table, &[]);
        assert!(exit == 3 && said.contains("overflow value") && said.contains("line(s) 5"), "{code}: {said}");
    }
    // Control: decades are readings.
    let decades: Vec<String> = (0..6).map(|k| format!("{k},1E{k}\n")).collect();
    let (code, said, _) = import(&under("load,sig", &decades), &[]);
    assert!(code == 0 && !said.contains("overflow"), "{said}");
    let direction = under("load,sig,way", &lines(|k, x, sig| format!("{x},{sig},{}", ["up", "-"][k / 4])));
    let (_, said, held) = import(&direction, &["--direction", "way"]);
    assert!(held[0].ends_with(",1") && held[4].ends_with(",-1"), "{held:?} {said}");
}

#[test]
fn times_are_in_the_unit_that_the_table_states_or_it_is_asked() {
    let seconds = |table: &str, t: &str| {
        let (code, said, held) = import(table, &["--separator", "semicolon", "--time", t]);
        let last = held.last().and_then(|line| line.rsplit(',').next()?.parse::<f64>().ok());
        (code, last.map(|s| s - held[0].rsplit(',').next().unwrap().parse::<f64>().unwrap()), said)
    };
    let clock = |k: usize| format!("{:02}:{:02}:{:02}", (23 + k.div_ceil(3)) % 24, (40 + 20 * k) % 60, 5);
    let stamp = |k: usize| format!("2025-03-0{}T{}", 4 + usize::from(k > 0), clock(k));
    for (t, time) in [
        ("t_s", &(|k: usize| (1200 * k).to_string()) as &dyn Fn(usize) -> String),
        ("time_ms", &|k: usize| (1_200_000 * k).to_string()),
        ("Zeit (min)", &|k: usize| (20 * k).to_string()),
        ("Zeit [Tage]", &|k: usize| format!("{:.7}", 45720.4 + k as f64 / 72.0)),
        ("clock", &clock),
        ("stamp", &stamp),
        ("day first", &|k: usize| format!("0{}.03.2025 {}", 4 + usize::from(k > 0), clock(k))),
    ] {
        let (code, last, said) = seconds(&timed(t, time), t);
        assert!(code == 0 && last.is_some_and(|s| (s - 8400.0).abs() < 0.01), "{t}: {last:?} {said}");
    }
    for (time, code, way) in [
        (
            &(|k: usize| (1_741_132_330_000_u64 + k as u64).to_string()) as &dyn Fn(usize) -> String,
            1,
            "t*0.001",
        ),
        (&|k: usize| format!("{:.7}", 45720.4 + k as f64 / 4320.0), 3, "t*86400"),
        (&|k: usize| (20_000 * k + 1000).to_string(), 3, "t*0.001"),
    ] {
        let (found, _, said) = seconds(&timed("t", time), "t");
        assert!(found == code && said.contains(way), "{said}");
    }
    let units = |below: &str, more: &[&str]| import(&under(&format!("load,sig\n{below}"), &plain()), more);
    let (code, said, _) = units("kN,mV", &["--stimulus-unit", "N"]);
    assert!(code == 1 && said.contains("load*1000"), "{said}");
    let (code, said, _) = units("Newton,mV", &["--stimulus-unit", "N", "--response-unit", "mV"]);
    assert_eq!(code, 0, "{said}");
}

#[test]
fn a_column_of_uncertainties_is_no_covariate() {
    let table = under("load,u_load,sig", &lines(|_, x, sig| format!("{x},0.1,{sig}")));
    let (code, said, _) = import(&table, &[]);
    assert!(code == 0 && said.contains("u_load looks like an uncertainty"), "{said}");
    let (_, said, _) = import(&table.replace("u_load", "humidity"), &[]);
    assert!(said.contains("--covariate") && !said.contains("uncertainty"), "control: {said}");
}
