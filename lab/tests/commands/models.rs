//! `wcal-lab train`, `wcal-lab evaluate` and `wcal track` as a user runs them (SIMULATED sweeps).

use crate::support::{run as wcal, text};
use std::path::Path;
use std::process::Output;

/// A table in which the base holds still in contact: tracked, and said to be in a motion that is
/// not known to be one of training.
fn doubted(run: &Output) {
    let said = text(&run.stderr);
    assert_eq!(run.status.code(), Some(3), "{said}");
    assert!(said.contains("motion-assumed"), "{said}");
}

fn good(args: &[&str]) -> serde_json::Value {
    let run = wcal(args);
    assert_eq!(
        run.status.code(),
        Some(0),
        "{args:?}: {}",
        text(&run.stderr)
    );
    serde_json::from_slice(&run.stdout).unwrap_or_default()
}

/// The session whose readings are tracked.
const SESSION: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../fixtures/practice/case-004");

/// A table of a track.
struct Table {
    names: Vec<String>,
    rows: Vec<Vec<String>>,
}

impl Table {
    fn read(path: &str) -> Self {
        let written = std::fs::read_to_string(path).unwrap();
        let mut lines = written
            .lines()
            .map(|l| l.split(',').map(str::to_owned).collect());
        Self {
            names: lines.next().unwrap(),
            rows: lines.collect(),
        }
    }

    fn column(&self, name: &str) -> usize {
        self.names.iter().position(|n| n == name).unwrap()
    }

    fn number(&self, row: usize, name: &str) -> Option<f64> {
        self.rows[row][self.column(name)].parse().ok()
    }

    fn statuses(&self) -> impl Iterator<Item = &str> {
        let status = self.column("status");
        self.rows.iter().map(move |r| r[status].as_str())
    }
}

/// A folder with sweeps, a model trained on them, a calibration and tracks through both.
struct Place(tempfile::TempDir);

impl Place {
    fn path(&self, name: &str) -> String {
        self.0.path().join(name).to_str().unwrap().to_owned()
    }

    /// `wcal track` of a table into a file of the folder.
    fn track(&self, table: &str, out: &str, more: &[&str]) -> Output {
        let [calibration, model, out] =
            ["fit/calibration.json", "model", out].map(|name| self.path(name));
        let track = [
            "track",
            table,
            "--calibration",
            &calibration,
            "--model",
            &model,
            "--out",
            &out,
        ];
        wcal(&[&track, more].concat())
    }

    /// The session's readings through both, by force: nobody verified the calibration.
    fn track_session(&self, out: &str, more: &[&str]) -> Table {
        let table = format!("{SESSION}/points.csv");
        doubted(&self.track(&table, out, &[more, &["--force"]].concat()));
        Table::read(&self.path(out))
    }

    fn train(&self) {
        let (plan, sweeps, model) = (
            self.path("plan.toml"),
            self.path("sweeps"),
            self.path("model"),
        );
        std::fs::write(&plan, "rate_hz = 10.0\nmost_mm = 40.0\n").unwrap();
        let objects = ["--object", "ball", "--object", "block", "--object", "can"];
        let simulate = [
            "simulate", "--sweeps", "3", "--plan", &plan, "--out", &sweeps,
        ];
        good(&[&simulate[..], &objects[..]].concat());
        let card = good(&["train", &sweeps, "--epochs", "1", "--out", &model, "--json"]);
        assert_eq!(
            (&card["format"], &card["trained_on_simulation"]),
            (&"wcal-model/1".into(), &true.into())
        );
        assert_eq!(card["objects"]["unseen"].as_array().unwrap().len(), 1);
        for k in 0..2 {
            let numbers = |key: &str| -> Vec<f64> {
                let of = card["sd_on_bench"][k][key].as_array().unwrap();
                of.iter().map(|x| x.as_f64().unwrap()).collect()
            };
            let (at_mm, factors) = (numbers("at_mm"), numbers("factors"));
            assert!(
                at_mm.len() == factors.len()
                    && at_mm.is_sorted()
                    && factors.iter().all(|f| *f > 0.0),
                "{card}"
            );
        }
    }

    fn evaluate(&self) {
        // A bench whose session `verify` explains; that of seed 1 leaves an unknown effect, and no
        // calibration by effects.
        let (sweeps, model, out) = (
            self.path("sweeps"),
            self.path("model"),
            self.path("evaluation"),
        );
        let evaluate = [
            "evaluate",
            &sweeps,
            "--model",
            &model,
            "--sweeps-each",
            "2",
            "--seed",
            "2",
        ];
        let scores = good(&[&evaluate[..], &["--out", &out, "--json"]].concat());
        // The objects set aside: two draws, the network with and without the base's speed, the
        // filter with it.
        assert_eq!(
            scores["test_objects"]["rows"].as_array().unwrap().len(),
            6,
            "{scores}"
        );
        assert_eq!(scores["simulated"], true);
        // Six methods on the unseen object and on the sweep kept back.
        assert_eq!(scores["methods"].as_array().unwrap().len(), 12, "{scores}");
        assert_eq!(scores["virtual_real"]["virtual"], true);
        assert!(
            scores["virtual_real"]["worst_mm"].as_f64().unwrap() > 0.0,
            "{scores}"
        );
        // Known motion on the bench's session, beside its bound.
        let known = &scores["known_motion"];
        let ratio = known["error_over_bound"].as_f64().unwrap();
        assert!(
            ratio > 0.2 && known["bound_mm"].as_f64().unwrap() > 0.0,
            "{known}"
        );
        assert!(Path::new(&self.path("evaluation/evaluation.json")).exists());
        // Every error of several sweeps has its interval.
        let within = |row: &serde_json::Value, key: &str| {
            let interval = &row["interval95"][key];
            let [low, value, high] =
                [&interval[0], &row[key], &interval[1]].map(|v| v.as_f64().unwrap());
            assert!(low <= value && value <= high, "{key}: {low} {value} {high}");
        };
        within(&scores["virtual_real"], "worst_mm");
        within(&scores["virtual_real"], "unseen_mean_mm");
        // One sweep was kept back of those seen, several are of the unseen object.
        let unseen = scores["methods"]
            .as_array()
            .unwrap()
            .iter()
            .find(|m| m["set"] == "unseen")
            .unwrap();
        within(unseen, "rmse_mm");
    }

    /// A stream's spread is that of a bench: twice the factor, four times the covariance.
    fn spread_follows_the_card(&self, rows: &Table) {
        let place = self.path("model/model.json");
        let mut card: serde_json::Value =
            serde_json::from_str(&std::fs::read_to_string(&place).unwrap()).unwrap();
        for factor in card["sd_on_bench"]
            .as_array_mut()
            .unwrap()
            .iter_mut()
            .flat_map(|by| by["factors"].as_array_mut())
        {
            factor
                .iter_mut()
                .for_each(|f| *f = (2.0 * f.as_f64().unwrap()).into());
        }
        std::fs::write(&place, card.to_string()).unwrap();
        let wider = self.track_session("wider.csv", &["--sweep"]);
        // Rows whose motion is not known to be one of training are not the network's alone: what
        // the moments tell counts as well.
        let trained = rows
            .statuses()
            .enumerate()
            .filter(|(_, status)| !status.contains("motion-assumed"));
        let ratios: Vec<f64> = trained
            .filter_map(|(k, _)| {
                Some(wider.number(k, "var_xx_mm2")? / rows.number(k, "var_xx_mm2")?)
            })
            .collect();
        // The session's wire is not the model's: what the moments alone allow is the other half of
        // the spread.
        let half = |r: &f64| (1.0..4.05).contains(r);
        assert!(ratios.len() > 5 && ratios.iter().all(half), "{ratios:?}");
        assert!(
            ratios.iter().filter(|r| **r > 2.0).count() > 5,
            "{ratios:?}"
        );
    }

    /// `wcal track` of readings with poses of the base, with or without the strain-isolated grating
    /// that the calibration needs; one reading lacks its value.
    fn track_carried(&self, reference: bool) -> Output {
        let mut rows = String::from(
            "t_s,fbg_1_nm,fbg_2_nm,base_x_mm,base_y_mm,base_z_mm,base_qw,base_qx,base_qy,base_qz",
        );
        rows += if reference { ",fbg_ref_nm\n" } else { "\n" };
        for k in 0..20 {
            let (t, z) = (0.1 * f64::from(k), 0.4 * f64::from(k));
            rows += &format!("{t},1545.249,1543.606,7,0,{z},1,0,0,0");
            rows += match reference {
                true if k != 12 => ",1542.461\n",
                true => ",\n",
                false => "\n",
            };
        }
        let file = self.path(if reference {
            "carried.csv"
        } else {
            "unreferenced.csv"
        });
        std::fs::write(&file, rows).unwrap();
        self.track(&file, "track.csv", &["--force"])
    }

    /// Damage and lack are named.
    fn damage_is_named(&self) {
        let timeless = self.path("timeless.csv");
        std::fs::write(
            &timeless,
            "point,fbg_1_shift_nm,fbg_2_shift_nm\n0,0.1,0.1\n",
        )
        .unwrap();
        let refused = |run: &Output, word: &str| {
            let said = text(&run.stderr);
            assert!(
                run.status.code() == Some(1) && said.contains(word),
                "{word}: {said}"
            );
        };
        refused(&self.track(&timeless, "track.csv", &["--force"]), "t_s");
        refused(&self.track_carried(false), "fbg_ref_nm");
        // Other files beside an earlier track stay.
        let own = self.path("track-notes.txt");
        std::fs::write(&own, "earlier").unwrap();
        let run = self.track_carried(true);
        assert!(Path::new(&own).exists());
        assert_eq!(run.status.code(), Some(3), "{}", text(&run.stderr));
        let carried = Table::read(&self.path("track.csv"));
        let has = |row: usize, cell: &str| carried.rows[row].iter().any(|c| c == cell);
        // The reading without its reference is flagged and has no contact.
        assert!(has(12, "reference-lost"), "{:?}", carried.rows[12]);
        assert!(
            carried.number(12, "contact_x_mm").is_none(),
            "{:?}",
            carried.rows[12]
        );
        // Of another wire than the model's, where it touches.
        assert!(
            has(11, "ok") || has(11, "wire-assumed"),
            "{:?}",
            carried.rows[11]
        );
        assert!(
            has(11, "unverified|other-whisker"),
            "{:?}",
            carried.rows[11]
        );
        let number = |name: &str| carried.number(11, name).unwrap();
        assert!((number("base_speed_mm_s") - 4.0).abs() < 1e-6);
        let moved = |axis: &str| {
            number(&format!("world_{axis}_mm")) - number(&format!("contact_{axis}_mm"))
        };
        assert!((moved("x") - 7.0).abs() < 1e-3 && (moved("z") - 4.4).abs() < 1e-3);
        let weights = self.path("model/model.safetensors");
        let bytes = std::fs::read(&weights).unwrap();
        std::fs::write(&weights, &bytes[..bytes.len() / 2]).unwrap();
        refused(
            &self.track(&format!("{SESSION}/points.csv"), "track.csv", &["--sweep"]),
            "model.safetensors",
        );
    }
}

#[test]
fn sweeps_become_a_model_that_tracks_and_says_what_it_leans_on() {
    let place = Place(tempfile::tempdir().unwrap());
    place.train();
    place.evaluate();
    good(&["fit-gpr", SESSION, "--out", &place.path("fit")]);
    let points = format!("{SESSION}/points.csv");
    let run = place.track(&points, "track.csv", &["--sweep"]);
    assert_eq!(run.status.code(), Some(4), "{}", text(&run.stderr));
    assert!(
        text(&run.stderr).contains("never verified")
            && !Path::new(&place.path("track.csv")).exists()
    );
    let track = place.track_session("track.csv", &["--sweep"]);
    let doubtful = track.column("calibration_doubtful");
    assert_eq!(
        track.rows.len(),
        std::fs::read_to_string(&points).unwrap().lines().count() - 1
    );
    assert!(
        track
            .rows
            .iter()
            .all(|r| r.len() == track.names.len() && r[doubtful] == "1"),
        "every row says so"
    );

    let summary: serde_json::Value =
        serde_json::from_str(&std::fs::read_to_string(place.path("track.json")).unwrap()).unwrap();
    let of_segments: u64 = summary["segments"]
        .as_array()
        .unwrap()
        .iter()
        .map(|s| s["rows"].as_u64().unwrap())
        .sum();
    let segment = track.column("segment");
    assert_eq!(
        track.rows.iter().filter(|r| !r[segment].is_empty()).count() as u64,
        of_segments
    );
    // What makes the exit code 3 is marked row by row.
    let marked = track
        .statuses()
        .filter(|s| s.split('|').any(|s| s == "motion-assumed"))
        .count() as u64;
    assert!(
        marked > 0 && summary["motion_assumed_rows"] == marked,
        "{marked}: {summary}"
    );
    // Control: nobody vouches for the motion, and no row that states a contact is ok any more.
    let assumed = place.track_session("unvouched.csv", &[]);
    let contact = |k: usize| {
        assumed
            .number(k, "contact_probability")
            .is_some_and(|p| p > 0.6)
    };
    assert_eq!(
        assumed
            .statuses()
            .enumerate()
            .filter(|(k, s)| *s == "ok" && contact(*k))
            .count(),
        0
    );
    // The first reading as the zero: every row moves by the same moments.
    let after = place.track_session("tared.csv", &["--sweep", "--tare-s", "0.001"]);
    let moment = |table: &Table, k: usize| table.number(k, "moment_1_nmm").unwrap();
    assert_eq!(moment(&after, 0), 0.0);
    let zero = moment(&track, 0);
    let same = |k: usize| (moment(&track, k) - moment(&after, k) - zero).abs() < 3e-6;
    assert!(zero.abs() > 1e-5 && (0..track.rows.len()).all(same));
    place.spread_follows_the_card(&track);
    place.damage_is_named();
}

/// Trained with additional sweeps with friction, begun with another model.
#[test]
fn a_training_goes_on_from_a_model_beside_other_physics() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let (sweeps, rough, first, model) =
        (path("sweeps"), path("rough"), path("first"), path("model"));
    let (plan, with_friction) = (path("plan.toml"), path("friction.toml"));
    std::fs::write(&plan, "rate_hz = 10.0\nmost_mm = 40.0\n").unwrap();
    std::fs::write(
        &with_friction,
        "rate_hz = 10.0\nmost_mm = 40.0\n[physics]\nfriction = [0.1, 0.3]\n",
    )
    .unwrap();
    let simulate = |seed: &str, plan: &str, out: &str| {
        let objects = ["--object", "ball", "--object", "block", "--object", "can"];
        good(
            &[
                &[
                    "simulate", "--sweeps", "3", "--seed", seed, "--plan", plan, "--out", out,
                ][..],
                &objects,
            ]
            .concat(),
        );
    };
    simulate("1", &plan, &sweeps);
    simulate("2", &with_friction, &rough);
    let epochs = ["--epochs", "1", "--json"];
    let before = good(&[&["train", &sweeps, "--out", &first][..], &epochs].concat());
    assert!(before.get("began_with").is_none(), "{before}");
    let more = ["train", &sweeps, "--from", &first, "--out", &model];
    let additional = ["--additional", &rough];
    let card = good(&[&more[..], &additional, &epochs].concat());
    assert_eq!(card["began_with"], before["weights_sha256"]);
    assert_eq!(
        card["data_beside"][0].as_object().unwrap().len(),
        3,
        "{card}"
    );
    assert_ne!(card["data_beside"][0]["ball"], card["data"]["ball"]);
    // The surfaces of built-in objects are known.
    assert!(
        card["passes"][0]["held_out_surface_mm"].as_f64().unwrap() > 0.0,
        "{card}"
    );
    let evaluate = [
        "evaluate",
        &sweeps,
        "--model",
        &model,
        "--out",
        &path("scores"),
        "--simulation-only",
        "--json",
    ];
    let scores = good(&evaluate);
    assert!(
        scores.get("virtual_real").is_none() && scores["methods"].is_array(),
        "{scores}"
    );

    // What must not be: weights that have seen what this split keeps unseen, or of another network.
    let refused = |args: &[&str], said: &str| {
        let run = wcal(&[args, &epochs].concat());
        assert_eq!(run.status.code(), Some(1), "{}", text(&run.stderr));
        assert!(text(&run.stderr).contains(said), "{}", text(&run.stderr));
    };
    let other = path("other");
    let again = ["train", &sweeps, "--from", &first, "--out", &other];
    refused(
        &[&again[..], &["--seed", "3"]].concat(),
        "split as in this training",
    );
    refused(
        &[&again[..], &["--preset", "paper"]].concat(),
        "that of this training",
    );
}

#[test]
fn sweeps_that_cannot_be_trained_on_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let (sweeps, out) = (folder.path().join("sweeps"), folder.path().join("model"));
    let [sweeps, out] = [&sweeps, &out].map(|p| p.to_str().unwrap().to_owned());
    let train = ["train", &sweeps, "--epochs", "1", "--out", &out];
    let run = wcal(&train);
    assert_eq!(run.status.code(), Some(1));
    assert!(text(&run.stderr).contains(&sweeps), "{}", text(&run.stderr));
    good(&[
        "simulate", "--object", "can", "--sweeps", "1", "--out", &sweeps,
    ]);
    let run = wcal(&train);
    assert_eq!(run.status.code(), Some(1));
    assert!(
        text(&run.stderr).contains("left to train on"),
        "{}",
        text(&run.stderr)
    );
    let table = std::path::Path::new(&sweeps).join("can-000000.samples.parquet");
    let bytes = std::fs::read(&table).unwrap();
    std::fs::write(&table, &bytes[..bytes.len() - 9]).unwrap();
    let run = wcal(&train);
    assert_eq!(run.status.code(), Some(1));
    assert!(
        text(&run.stderr).contains("can-000000.samples.parquet"),
        "{}",
        text(&run.stderr)
    );
}
