//! Documents and tables as the program writes them, on small sessions.

use super::repository;
use crate::support::program_of;
use crate::support::virtual_bench::VirtualBench;
use serde_json::Value;
use std::path::Path;

/// A document: its schema, what wrote it, and what it says.
pub(crate) type Written = (&'static str, String, Value);

/// A folder with the repository's data in it.
pub(crate) fn folder() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    for name in ["fixtures", "rigs"] {
        std::os::unix::fs::symlink(repository(name), folder.path().join(name)).unwrap();
    }
    folder
}

struct Place<'a>(&'a Path);

impl Place<'_> {
    /// Runs the program; its standard output. Words are separated by spaces.
    fn run(&self, command: &str, codes: &[i32]) -> String {
        let words: Vec<&str> = command.split_whitespace().collect();
        let output = program_of(words[0])
            .args(&words)
            .current_dir(self.0)
            .output()
            .unwrap();
        let said = String::from_utf8_lossy(&output.stderr);
        let code = output.status.code().unwrap_or(-1);
        assert!(
            codes.contains(&code),
            "wcal {command}: exit code {code}, expected {codes:?}\n{said}"
        );
        String::from_utf8(output.stdout).unwrap()
    }

    fn printed(&self, schema: &'static str, command: &str, codes: &[i32]) -> Written {
        let text = self.run(command, codes);
        (
            schema,
            command.to_owned(),
            serde_json::from_str(&text).unwrap(),
        )
    }

    fn file(&self, schema: &'static str, name: &str) -> Written {
        let text = std::fs::read(self.0.join(name)).unwrap_or_else(|e| panic!("{name}: {e}"));
        (
            schema,
            name.to_owned(),
            serde_json::from_slice(&text).unwrap(),
        )
    }

    /// The state within a live page that was kept.
    fn live(&self, name: &str) -> Written {
        let page = std::fs::read_to_string(self.0.join(name)).unwrap();
        let state = page.split("id=\"last\">").nth(1).unwrap();
        let state = state.split("</script>").next().unwrap();
        (
            "live",
            name.to_owned(),
            serde_json::from_str(state).unwrap(),
        )
    }

    fn header(&self, name: &str) -> (String, String) {
        let text =
            std::fs::read_to_string(self.0.join(name)).unwrap_or_else(|e| panic!("{name}: {e}"));
        (
            name.to_owned(),
            text.lines().next().unwrap_or_default().to_owned(),
        )
    }

    /// A session of the fixtures that may be written to.
    fn copy(&self, from: &str, to: &str) {
        let target = self.0.join(to);
        std::fs::create_dir_all(&target).unwrap();
        for entry in std::fs::read_dir(repository(from)).unwrap() {
            let entry = entry.unwrap();
            if entry.file_name() != "unsealed.json" {
                std::fs::copy(entry.path(), target.join(entry.file_name())).unwrap();
            }
        }
    }

    fn verify(&self, session: &str, out: &str, codes: &[i32]) -> Vec<Written> {
        self.run(&format!("verify {session} --out {out}"), codes);
        let calibration = format!("{out}/calibration.json");
        let mut all = vec![self.file("verify", &format!("{out}/verify.json"))];
        if self.0.join(&calibration).exists() {
            all.push(self.file("calibration", &calibration));
        }
        all
    }
}

const IMPORT: &str = "import fixtures/nist/PONTIUS.DAT --skip-lines 25 --whitespace --columns deflection,load --kind transducer --stimulus load \
    --response deflection --model linear --out cell";
const TRACK: &str =
    "--calibration held-verified/calibration.json --model fixtures/tracker_small --force --out";

/// Every document, by three threads in one folder.
pub(crate) fn documents(folder: &Path) -> Vec<Written> {
    let place = Place(folder);
    std::thread::scope(|scope| {
        let parts = [
            scope.spawn(|| traced(&place)),
            scope.spawn(|| pictured(&place)),
            scope.spawn(|| swept(&place)),
        ];
        let mut all: Vec<Written> = parts.into_iter().flat_map(|p| p.join().unwrap()).collect();
        // Needs a calibration of the first and a recording of the third.
        place.run(
            &format!("track session --live-page {TRACK} stream.csv"),
            &[3, 4, 0],
        );
        place.run(
            &format!("track fixtures/practice/case-004/points.csv {TRACK} table.csv"),
            &[3, 4, 0],
        );
        place.run(
            "track held --calibration held-verified/calibration.json --out groove.csv",
            &[0, 3, 4],
        );
        all.extend(
            ["stream.json", "table.json", "groove.json"].map(|name| place.file("track", name)),
        );
        all.push(place.live("stream.live.html"));
        all
    })
}

/// Sessions, their checks and their calibrations.
fn traced(place: &Place<'_>) -> Vec<Written> {
    place.copy("fixtures/practice/case-004", "held");
    let mut all = vec![place.printed("import", &format!("{IMPORT} --json"), &[0])];
    all.extend(place.verify("cell", "cell-verified", &[0]));
    all.extend(place.verify("fixtures/nist/berger1", "berger1", &[0, 3, 4]));
    all.extend(place.verify("fixtures/nist/lew", "lew", &[0, 3, 4]));
    all.extend(place.verify("fixtures/whiskerfbg", "whisker-verified", &[4]));
    all.extend(place.verify("held", "held-verified", &[0]));
    all.push(place.file("unsealed", "held/unsealed.json"));
    place.run(
        "predict held/points.csv --calibration held-verified/calibration.json --out moments.csv",
        &[0, 4],
    );
    place.run(
        "twin fixtures/whiskerfbg --engine rod --out twin.csv",
        &[0, 3],
    );
    // A calibration that is judged, and data that are refused.
    place.run(
        "verify held --calibration held-verified/calibration.json --out judged",
        &[0, 1, 3, 4],
    );
    all.push(place.file("verify", "judged/verify.json"));
    all.push(place.printed(
        "predict",
        "predict cell/points.csv --calibration cell-verified/calibration.json --out predicted.csv --json",
        &[0],
    ));
    let later: String = (1..=10)
        .map(|k| format!("{},{}\n", 3e5 * f64::from(k), 0.2196 * f64::from(k)))
        .collect();
    std::fs::write(
        place.0.join("later.csv"),
        format!("load,deflection\n{later}"),
    )
    .unwrap();
    all.push(place.printed(
        "calibration-check",
        "check later.csv --calibration cell-verified/calibration.json --json",
        &[0, 4],
    ));
    std::fs::create_dir(place.0.join("unit")).unwrap();
    for name in ["unit/calibration-1.json", "unit/calibration-2.json"] {
        let from = place.0.join("cell-verified/calibration.json");
        std::fs::copy(from, place.0.join(name)).unwrap();
    }
    all.push(place.printed("history", "check --history unit --json", &[0]));
    place.run("calibrate --out calibrated", &[0]);
    all.push(place.file("calibrate", "calibrated/calibrate.json"));
    place.run("fit-gpr fixtures/whiskerfbg --out map", &[0, 3]);
    all.extend([
        place.file("fit-gpr", "map/fit-gpr.json"),
        place.file("calibration", "map/calibration.json"),
    ]);
    all.push(place.printed("check", "verify held --dry-run --json", &[0, 3]));
    all.push(place.printed(
        "path",
        "stage-sweep --rig rigs/paper --plan rigs/plans/rich.toml --dry-run --json",
        &[0],
    ));
    all
}

/// Cameras and shapes; sweeps over objects, a model and its errors.
fn pictured(place: &Place<'_>) -> Vec<Written> {
    const SCENE: &str = "fixtures/stereo_bench/scene";
    const BOARD: &str = "fixtures/stereo_bench/board";
    place.run(
        &format!(
            "stereo-calibrate {BOARD}/left {BOARD}/right --board 9x6 --square-mm 6 --out cameras"
        ),
        &[0, 3],
    );
    let cameras = "--cameras cameras/stereo.json --rig fixtures/stereo_bench/rig.toml";
    place.run(
        &format!("stereo-shape {SCENE}/left {SCENE}/right {cameras} --out shapes"),
        &[0, 3],
    );
    place.run(
        "simulate --object ball --object can --object vase --object cone --sweeps 3 --out sweeps",
        &[0],
    );
    place.run(
        "train sweeps --held-out 1 --unseen 1 --epochs 1 --preset compact --out model",
        &[0],
    );
    place.run(
        "evaluate sweeps --model model --simulation-only --objects 1 --sweeps-each 1 --out evaluation",
        &[0],
    );
    vec![
        place.file("stereo", "cameras/stereo.json"),
        place.file("shapes", "shapes/shapes.json"),
        place.file("dataset", "sweeps/dataset.json"),
        place.file("shard", "sweeps/can-000000.json"),
        place.file("recipe", "sweeps/recipe.json"),
        place.file("model", "model/model.json"),
        place.file("model", "fixtures/tracker/model.json"),
        place.file("model", "fixtures/tracker_small/model.json"),
        place.file("evaluation", "evaluation/evaluation.json"),
    ]
}

const SCENARIO: &str = "format = \"wcal-scenario/1\"\nseed = 7\nspeed = 20\n[interrogator]\nrate_hz = 250\n[fbg]\nnominal_nm = [1545.249, 1543.606]\nreference_nominal_nm = 1542.461\n[cameras]\nrate_hz = 1\nsize_px = [64, 48]\n";
const PLAN: &str = "format = \"wcal-plan/1\"\nname = \"short\"\n[settle]\ntimeout_s = 2\n[[block]]\nrole = \"calibration\"\ntrajectories = [1]\ndepths_mm = [1, 2]\n\
    [[block]]\nrole = \"holdout\"\ntrajectories = [1]\ndepths_mm = [1.5]\n";

/// A sweep on a virtual bench.
fn swept(place: &Place<'_>) -> Vec<Written> {
    let write = |name: &str, text: &str| std::fs::write(place.0.join(name), text).unwrap();
    write("plan.toml", PLAN);
    let rig = std::fs::read_to_string(repository("rigs/virtual/rig.toml")).unwrap();
    // The gratings of the calibration that the recording is tracked with.
    let changes = [
        ("rate_hz = 2000.0", "rate_hz = 250.0"),
        (
            "nominal_nm = 1537.3, window_nm = 0.7",
            "nominal_nm = 1542.461, window_nm = 0.5",
        ),
        (
            "nominal_nm = 1541.2, window_nm = 1.5",
            "nominal_nm = 1545.249, window_nm = 0.8",
        ),
        (
            "nominal_nm = 1535.8, window_nm = 0.7",
            "nominal_nm = 1543.606, window_nm = 0.6",
        ),
    ];
    let changed = changes.iter().fold(rig, |rig, (from, to)| {
        assert!(rig.contains(from), "{from}");
        rig.replace(from, to)
    });
    write("rig.toml", &changed);
    let _bench = VirtualBench::serve(place.0, "", SCENARIO);
    vec![
        place.file("bench", "bench.json"),
        // On a busy machine the bench's scans may come late, which the program says with 3.
        place.printed(
            "sweep",
            "stage-sweep --rig rig.toml --plan plan.toml --bench bench.json --home --live-page --out session --json",
            &[0, 3],
        ),
        place.live("session/live.html"),
        place.file("run", "session/run.json"),
        place.printed("reduction", "reduce session --json", &[0, 3]),
    ]
}

/// First lines of the tables that [`documents`] left in the folder.
pub(crate) fn tables(folder: &Path) -> Vec<(String, String)> {
    let place = Place(folder);
    let names = [
        "cell/points.csv",
        "cell-verified/predictions.csv",
        "held-verified/predictions.csv",
        "predicted.csv",
        "moments.csv",
        "twin.csv",
        "table.csv",
        "groove.csv",
        "stream.csv",
        "session/points.csv",
        "session/holdout.csv",
        "session/compensation.csv",
        "session/outliers.csv",
        "fixtures/whiskerfbg/points.csv",
        "fixtures/whiskerfbg/rest_shape.csv",
        "fixtures/practice/case-004/points.csv",
    ];
    names.iter().map(|name| place.header(name)).collect()
}
