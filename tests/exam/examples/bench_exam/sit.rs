//! A session of the program alone: `stage-sweep`, then `verify`. The bench is in the sweep's
//! process, where nothing waits and a seed gives the same recording on every computer; with
//! pictures it is `virtual-bench`, and `stereo-calibrate` and `stereo-shape` come before `verify`.

use crate::Options;
use crate::board_pictures::board_pictures;
use crate::draw::Draw;
use anyhow::{Context, ensure};
use serde_json::Value;
use std::fs;
use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Child, Command, Stdio};

/// Bench seconds per wall second with cameras: pictures take the processor's time.
const SPEED_WITH_CAMERAS: f64 = 6.0;

/// A bench that ends when it is dropped.
struct Bench(Child);

impl Bench {
    /// Its addresses are in `bench.json`.
    fn start(o: &Options, folder: &Path) -> anyhow::Result<Self> {
        let mut child = Command::new(&o.wcal)
            .args(["virtual-bench", "--scenario", "scenario.toml"])
            .current_dir(folder)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(fs::File::create(folder.join("bench.txt"))?)
            .spawn()
            .with_context(|| format!("starting {}", o.wcal.display()))?;
        let mut line = String::new();
        BufReader::new(child.stdout.take().context("no output of the bench")?)
            .read_line(&mut line)?;
        fs::write(folder.join("bench.json"), line)?;
        Ok(Self(child))
    }
}

impl Drop for Bench {
    fn drop(&mut self) {
        drop(self.0.stdin.take());
        let _ = self.0.wait();
    }
}

/// Runs the program in `folder`; its exit code. What it said is in `said.txt`.
fn wcal(o: &Options, folder: &Path, arguments: &[&str]) -> anyhow::Result<Option<i32>> {
    let said = fs::File::options()
        .create(true)
        .append(true)
        .open(folder.join("said.txt"))?;
    let mut command = Command::new(&o.wcal);
    command
        .args(arguments)
        .current_dir(folder)
        .stdout(Stdio::null())
        .stderr(said);
    // Beside each other they would share the cores anyway.
    command.env("RAYON_NUM_THREADS", "1");
    Ok(command.status()?.code())
}

/// Serves and sweeps; the session is in `folder/session`.
fn record(o: &Options, d: &Draw, folder: &Path) -> anyhow::Result<()> {
    let root = &Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let rig = fs::read_to_string(root.join("rigs/virtual/rig.toml"))?;
    let table: toml::Table = rig.parse()?;
    let trajectories = table["trajectory"]
        .as_array()
        .context("no trajectories in the rig")?;
    fs::write(
        folder.join("scenario.toml"),
        d.scenario(SPEED_WITH_CAMERAS, trajectories),
    )?;
    // The cameras stand at the end of the file.
    let without = rig.split("[[camera]]").next().unwrap_or_default();
    let rig = if d.pictures { &rig } else { without };
    let rate = format!("rate_hz = {:.1}", d.rate_hz);
    fs::write(
        folder.join("rig.toml"),
        rig.replace("rate_hz = 2000.0", &rate),
    )?;
    let plan = fs::read_to_string(root.join("rigs/plans").join(format!("{}.toml", d.plan)))?;
    fs::write(folder.join("plan.toml"), plan)?;
    let sweep = [
        "stage-sweep",
        "--rig",
        "rig.toml",
        "--plan",
        "plan.toml",
        "--home",
        "--out",
        "session",
    ];
    let swept = if d.pictures {
        let bench = Bench::start(o, folder)?;
        let told: Value = serde_json::from_slice(&fs::read(folder.join("bench.json"))?)?;
        let cameras = [0, 1].map(|k| told["cameras"][k].as_str().unwrap_or_default());
        board_pictures(cameras, &folder.join("board"), 12)?;
        let swept = wcal(
            o,
            folder,
            &[&sweep[..], &["--bench", "bench.json"]].concat(),
        );
        drop(bench);
        swept?
    } else {
        wcal(
            o,
            folder,
            &[&sweep[..], &["--scenario", "scenario.toml"]].concat(),
        )?
    };
    ensure!(
        matches!(swept, Some(0 | 3)),
        "the sweep ended with {swept:?}"
    );
    if d.pictures {
        let sides = ["board/left", "board/right"];
        let board = ["--board", "9x6", "--square-mm", "6", "--out", "cameras"];
        let code = wcal(
            o,
            folder,
            &[&["stereo-calibrate"], &sides[..], &board[..]].concat(),
        )?;
        ensure!(
            matches!(code, Some(0 | 3)),
            "stereo-calibrate ended with {code:?}"
        );
        let code = wcal(
            o,
            folder,
            &[
                "stereo-shape",
                "session",
                "--cameras",
                "cameras/stereo.json",
            ],
        )?;
        ensure!(
            matches!(code, Some(0 | 3)),
            "stereo-shape ended with {code:?}"
        );
    }
    // The raw streams are large, and the tables are made.
    let _ = fs::remove_file(folder.join("session/recording.mcap"));
    fs::write(folder.join("recorded"), d.summary())?;
    Ok(())
}

/// verify.json of a draw; a session that was recorded before is verified anew.
pub(crate) fn sit(o: &Options, d: &Draw, folder: &Path) -> anyhow::Result<Value> {
    fs::create_dir_all(folder)?;
    let same =
        |file: &str| fs::read_to_string(folder.join(file)).is_ok_and(|text| text == d.summary());
    if !same("recorded") {
        let _ = fs::remove_dir_all(folder.join("session"));
        record(o, d, folder)?;
    }
    let _ = fs::remove_dir_all(folder.join("verify"));
    wcal(o, folder, &["verify", "session", "--out", "verify"])?;
    Ok(serde_json::from_slice(&fs::read(
        folder.join("verify/verify.json"),
    )?)?)
}
