//! A clean session of the rich plan, from the sweep to contact points through its own calibration
//! (SIMULATED).

use crate::support::{code_and_messages, repository};
use nalgebra::{Matrix3, Vector3};
use serde_json::Value;
use std::path::Path;

/// A rig without cameras and a bench without effects, as files in a folder.
fn rig_and_scenario(folder: &Path, seed: u64) {
    let rig = std::fs::read_to_string(repository("rigs/virtual/rig.toml")).unwrap();
    let of_stage = rig
        .replace("rate_hz = 2000.0", "rate_hz = 500.0")
        .replace("clock_scale = 4.0\n", "");
    let (head, cameras) = (
        of_stage.split("[[camera]]").next().unwrap(),
        of_stage.contains("[[camera]]"),
    );
    assert!(cameras, "the rig's cameras come last");
    std::fs::write(folder.join("rig.toml"), head).unwrap();
    let scenario = format!(
        "format = \"wcal-scenario/1\"\nseed = {seed}\n[interrogator]\nrate_hz = 500.0\nnoise_pm = 1.0\n\
         [temperature]\ndrift_degc_per_h = 0.3\nswing_degc = 0.05\nswing_period_s = 600.0\n"
    );
    std::fs::write(folder.join("scenario.toml"), scenario).unwrap();
}

/// Settled rows whose stated 95 % ellipsoid holds the groove, and all of them; of a session's
/// points and its track.
fn settled_inside(points: &Path, track: &Path) -> [u64; 2] {
    let read = |path: &Path| -> Vec<Vec<String>> {
        let text = std::fs::read_to_string(path).unwrap();
        text.lines()
            .map(|line| line.split(',').map(str::to_owned).collect())
            .collect()
    };
    let (points, track) = (read(points), read(track));
    let number = |table: &[Vec<String>], row: usize, name: &str| -> Option<f64> {
        table[row][table[0].iter().position(|n| n == name).unwrap()]
            .parse()
            .ok()
    };
    let mut counts = [0, 0];
    for row in (1..track.len()).filter(|row| number(&points, *row, "speed_mm_s") == Some(0.0)) {
        let axis = ["x", "y", "z"];
        let off = axis.map(|a| {
            let groove = number(&points, row, &format!("groove_{a}_mm"))?;
            Some(number(&track, row, &format!("contact_{a}_mm"))? - groove)
        });
        let [Some(x), Some(y), Some(z)] = off else {
            continue;
        };
        let covariance = Matrix3::from_fn(|i, j| {
            let of = [axis[i.min(j)], axis[i.max(j)]].concat();
            let name = if i == j {
                format!("var_{of}_mm2")
            } else {
                format!("cov_{of}_mm2")
            };
            number(&track, row, &name).unwrap()
        });
        let off = Vector3::new(x, y, z);
        // Chi-squared with three degrees of freedom, 95 %.
        counts[0] += u64::from(
            covariance
                .cholesky()
                .is_some_and(|c| off.dot(&c.solve(&off)) <= 7.815),
        );
        counts[1] += 1;
    }
    counts
}

/// Rows, flagged rows, and trajectories whose region holds the groove; with the exit code.
fn tracked(session: &str, calibration: &str, out: &Path) -> (i32, [u64; 4]) {
    let table = out.display().to_string();
    let (code, text) = code_and_messages(&[
        "track",
        session,
        "--calibration",
        calibration,
        "--out",
        &table,
    ]);
    let document =
        std::fs::read(out.with_extension("json")).unwrap_or_else(|e| panic!("{e}: {text}"));
    let v: Value = serde_json::from_slice(&document).unwrap();
    let number = |v: &Value| v.as_u64().unwrap_or_else(|| panic!("{v}"));
    let groove = &v["groove_tracking"];
    let counts = [
        &v["rows"],
        &v["flagged_rows"],
        &groove["trajectories"],
        &groove["trajectories_held"],
    ];
    (code, counts.map(number))
}

/// Rows on the fly average 10 samples, settled ones 501; both have the noise that follows from
/// their own number.
#[test]
fn a_clean_rich_session_is_located_by_its_own_calibration() {
    let (mut held, mut settled) = ([0, 0], [0, 0]);
    // Not 11: with six open trajectories a smooth course over the temperature's rate is called an
    // unknown effect there (lab notes, tracking).
    for seed in [12, 13, 14] {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name).display().to_string();
        rig_and_scenario(folder.path(), seed);
        let plan = repository("rigs/plans/rich.toml").display().to_string();
        let (rig, scenario, session) = (at("rig.toml"), at("scenario.toml"), at("session"));
        let sweep = [
            "--rig",
            &rig,
            "--plan",
            &plan,
            "--scenario",
            &scenario,
            "--out",
            &session,
        ];
        let (code, text) = code_and_messages(&[&["stage-sweep", "--home"][..], &sweep].concat());
        assert_eq!(code, 0, "{text}");
        let verified = at("verified");
        let (code, text) = code_and_messages(&["verify", &session, "--out", &verified]);
        assert_eq!(code, 0, "{text}");
        let calibration = format!("{verified}/calibration.json");
        let (code, [rows, flagged, trajectories, inside]) =
            tracked(&session, &calibration, &folder.path().join("track.csv"));
        let [within, of] = settled_inside(
            &folder.path().join("session/points.csv"),
            &folder.path().join("track.csv"),
        );
        println!(
            "SIMULATED: seed {seed}: {flagged} of {rows} rows flagged, {inside} of {trajectories} held, {within} of {of} settled rows inside"
        );
        settled = [settled[0] + within, settled[1] + of];
        assert!(
            code == 0 && 20 * flagged <= rows,
            "seed {seed}: exit {code}, {flagged} of {rows} flagged"
        );
        held = [held[0] + inside, held[1] + trajectories];
        // Control: rows on the fly that claim as many samples as settled ones contradict the
        // motion.
        if seed == 12 {
            let points = folder.path().join("session/points.csv");
            let text = std::fs::read_to_string(&points).unwrap();
            let place = text
                .lines()
                .next()
                .unwrap()
                .split(',')
                .position(|c| c == "samples")
                .unwrap();
            let claimed = text.lines().enumerate().map(|(k, line)| {
                let mut cells: Vec<&str> = line.split(',').collect();
                if k > 0 {
                    cells[place] = "501";
                }
                cells.join(",") + "\n"
            });
            std::fs::write(&points, claimed.collect::<String>()).unwrap();
            let (code, [rows, flagged, ..]) =
                tracked(&session, &calibration, &folder.path().join("claimed.csv"));
            assert!(
                (3..=4).contains(&code) && 2 * flagged > rows,
                "exit {code}, {flagged} of {rows} flagged"
            );
        }
    }
    // Of 18 regions with 95 % each at most four miss (once in 600 such tests).
    assert!(held[1] == 18 && held[0] >= 14, "{held:?}");
    // The rows of a trajectory share their errors: as many as four of its 18 shares may miss here,
    // too.
    assert!(
        settled[1] > 700 && settled[0] * 18 >= settled[1] * 14,
        "{settled:?}"
    );
}

/// A whisker's table with names of its own is imported with the rig, whose gratings have the
/// wavelengths; one without gets all columns named at once, in a command that runs.
#[test]
fn a_whisker_table_is_imported_by_the_rig_and_its_own_names() {
    let place = tempfile::tempdir().unwrap();
    let table = std::fs::read_to_string(repository("fixtures/pictured/points.csv")).unwrap();
    let own = table
        .replacen("groove_", "object_", 3)
        .replacen("fbg_1_nm", "fbg_1_peak_nm", 1);
    let file = place.path().join("bench.csv");
    std::fs::write(&file, own).unwrap();
    let (file, out) = (file.display().to_string(), place.path().join("session"));
    let (rig, out) = (
        repository("rigs/virtual/rig.toml"),
        out.display().to_string(),
    );
    let rig = rig.display().to_string();
    let import = [
        "import", &file, "--kind", "whisker", "--model", &rig, "--out", &out,
    ];
    let (code, said) = code_and_messages(&import);
    let all = ["groove_x_mm", "groove_y_mm", "groove_z_mm", "fbg_1_nm"];
    assert!(
        code == 1 && all.iter().all(|name| said.contains(name)),
        "{said}"
    );
    let line = said
        .lines()
        .find(|line| line.trim().starts_with("wcal import"))
        .unwrap();
    let words: Vec<&str> = line.split_whitespace().skip(1).collect();
    let (code, said) = code_and_messages(&words);
    assert!(code == 0 || code == 3, "{said}");
    let session: toml::Table = std::fs::read_to_string(format!("{out}/session.toml"))
        .unwrap()
        .parse()
        .unwrap();
    assert_eq!(
        session["fbg"]["nominal_nm"].as_array().unwrap()[0].as_float(),
        Some(1541.2)
    );
    assert_eq!(
        session["fbg"]["reference_nominal_nm"].as_float(),
        Some(1537.3)
    );
    let again = std::fs::read_to_string(format!("{out}/points.csv")).unwrap();
    assert!(
        again.lines().next().unwrap().contains("groove_x_mm"),
        "{again}"
    );
}
