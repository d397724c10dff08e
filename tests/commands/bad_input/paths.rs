//! Every path of every command as a pipe that nobody writes to, as a folder, and as a device
//! without end.

use super::limits::{in_parallel, limited, sound};
use super::*;

const TRANSDUCER: &[&str] = &[
    "--kind",
    "transducer",
    "--stimulus",
    "x",
    "--response",
    "y",
    "--model",
    "linear",
];

/// Command lines with the path under test as `@`; the other files are there and good as far as the
/// command reads them first.
fn lines() -> Vec<Vec<&'static str>> {
    let mut all: Vec<Vec<&str>> = [
        "verify @ --check",
        "verify @ --out o",
        "fit-gpr @ --out o",
        "twin @ --out o.csv",
        "predict @ --calibration c.json --out o.csv",
        "predict t.csv --calibration @ --out o.csv",
        "stereo-calibrate @ pictures --board 9x6 --square-mm 6 --out o",
        "stereo-calibrate pictures @ --board 9x6 --square-mm 6 --out o",
        "stereo-shape @ pictures --cameras stereo.json --rig rig.toml --out o",
        "stereo-shape pictures pictures --cameras @ --rig rig.toml --out o",
        "stereo-shape pictures pictures --cameras stereo.json --rig @ --out o",
        "fit-whisker @ --rig rig.toml --out o",
        "fit-whisker shapes.json --rig @ --out o",
        "simulate --meshes @ --sweeps 1 --out o",
        "simulate --object can --sweeps 1 --plan @ --out o",
        "simulate --object can --sweeps 1 --whisker @ --out o",
        "train @ --out o",
        "train --whisker @ --sweeps-each 1 --out o",
        "train --meshes @ --sweeps-each 1 --out o",
        "train --from @ --sweeps-each 1 --out o",
        "evaluate sweeps --model @ --out o",
        "track @ --calibration c.json --out o.csv",
        "track t.csv --calibration @ --motion m.csv --out o.csv",
        "track t.csv --calibration c.json --motion @ --out o.csv",
        "track t.csv --calibration c.json --model @ --out o.csv",
        "track --calibration c.json --rig @ --out o.csv",
        "track --calibration c.json --rig rig.toml --bench @ --out o.csv",
        "stage-sweep --rig @ --plan plan.toml --dry-run",
        "stage-sweep --rig rig.toml --plan @ --dry-run",
        "stage-sweep --rig rig.toml --plan plan.toml --bench @ --out o",
        "stage-sweep --rig rig.toml --plan plan.toml --resume @",
        "reduce @",
        "virtual-bench --scenario @",
    ]
    .iter()
    .map(|line| line.split(' ').collect())
    .collect();
    all.push([&["import", "@"], TRANSDUCER, &["--out", "o"]].concat());
    all.push(
        [
            &["import", "xy.csv", "--holdout", "@"],
            TRANSDUCER,
            &["--out", "o"],
        ]
        .concat(),
    );
    all
}

/// The files that the lines name.
fn prepare(place: &Path) {
    let repository = Path::new(env!("CARGO_MANIFEST_DIR"));
    let write = |name: &str, text: &str| fs::write(place.join(name), text).unwrap();
    let copy = |from: &str, name: &str| fs::copy(repository.join(from), place.join(name)).unwrap();
    copy("rigs/virtual/rig.toml", "rig.toml");
    copy("rigs/plans/paper-27.toml", "plan.toml");
    copy("fixtures/pictured/stereo.json", "stereo.json");
    write("c.json", &calibrations::whisker_calibration().to_string());
    write(
        "t.csv",
        "point,t_s,fbg_1_nm,fbg_2_nm\n1,0,1541.3,1535.9\n2,1,1541.4,1535.9\n",
    );
    write(
        "m.csv",
        "t_s,object_x_mm,object_y_mm,object_z_mm\n0,0,0,0\n1,0,0,-1\n",
    );
    write("xy.csv", "x,y\n1,2.5\n2,4.5\n");
    write("w.csv", "fbg_1_nm,fbg_2_nm\n1545,1543\n");
    write(
        "optic.csv",
        &sweep_table("fbg_2,fbg_6,fbg_4", "1545,1543,1541", 2000),
    );
    write("action.csv", "ind,py\n0,0\n1000,0.01\n1999,0.02\n");
    write("m.stl", "solid\nendsolid\n");
    write(
        "shapes.json",
        "{\"format\": \"wcal-shapes/1\", \"pairs\": []}",
    );
    for folder in ["pictures", "sweeps", "a-folder"] {
        fs::create_dir(place.join(folder)).unwrap();
    }
    copy(
        "fixtures/pictured/pictures/left/00001.png",
        "pictures/00001.png",
    );
    let made = Command::new("mkfifo")
        .arg(place.join("a-pipe"))
        .status()
        .unwrap();
    assert!(made.success());
}

fn sweep_table(header: &str, row: &str, rows: usize) -> String {
    format!("{header}\n{}", format!("{row}\n").repeat(rows))
}

#[test]
fn pipes_folders_and_endless_devices_are_named_at_once() {
    let place = tempfile::tempdir().unwrap();
    prepare(place.path());
    let before = listing(place.path());
    let lines = lines();
    let cases: Vec<(usize, &Vec<&str>, &str)> = lines
        .iter()
        .enumerate()
        .flat_map(|(k, line)| ["a-pipe", "a-folder", "/dev/zero"].map(|path| (k, line, path)))
        .collect();
    let wrong = in_parallel(&cases, |(k, line, path)| {
        let out = format!("out-{k}-{}", path.replace('/', "-"));
        let table = format!("{out}.csv");
        let word = |word: &&'static str| match *word {
            "@" => *path,
            "o" => out.as_str(),
            "o.csv" => table.as_str(),
            other => other,
        };
        let arguments: Vec<&str> = line.iter().map(word).collect();
        let output = limited(place.path(), &arguments);
        let shown = arguments.join(" ");
        let text = sound(&output).map_err(|why| format!("{shown}: {why}"))?;
        // The one document of a refusal says why.
        let left = if place.path().join(&out).exists() {
            listing(&place.path().join(&out))
        } else {
            Vec::new()
        };
        if output.status.code() == Some(1)
            && text.contains(path)
            && left.iter().all(|name| name == "verify.json")
        {
            return Ok(());
        }
        let code = output.status.code();
        Err(format!(
            "{shown}: expected exit code 1 and the path's name, found {code:?}, {left:?}: {text}"
        ))
    });
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
    let left: Vec<String> = listing(place.path())
        .into_iter()
        .filter(|name| !name.starts_with("out-"))
        .collect();
    assert_eq!(left, before, "nothing else is written");
}

/// What a session names is read by the same rule.
#[test]
fn a_pipe_inside_a_session_is_named() {
    let place = tempfile::tempdir().unwrap();
    for name in ["session.toml", "points.csv"] {
        let session = place.path().join(name.replace('.', "-"));
        fs::create_dir(&session).unwrap();
        Base::Whisker.write(&session);
        // Control: as it is, it is read.
        judge(&limited(&session, &["verify", ".", "--check"]), 3, &[]).unwrap();
        fs::remove_file(session.join(name)).unwrap();
        assert!(
            Command::new("mkfifo")
                .arg(session.join(name))
                .status()
                .unwrap()
                .success()
        );
        for (command, more) in [
            ("verify", &["--check"][..]),
            ("verify", &["--out", "v"]),
            ("fit-gpr", &["--out", "g"]),
        ] {
            let output = limited(&session, &[&[command, "."], more].concat());
            judge(&output, 1, &[name]).unwrap();
            let text = sound(&output).unwrap();
            assert!(
                text.contains("a pipe") || text.contains("not a regular file"),
                "{command}: {text}"
            );
        }
    }
}

/// The limits themselves: a loop without end and too much memory are found.
#[test]
fn the_limits_hold() {
    let place = tempfile::tempdir().unwrap();
    judge(&limited(place.path(), &["--version"]), 0, &["wcal"]).unwrap();
    let shell = |script: &str| {
        let output = Command::new("sh").args(["-c", script]).output().unwrap();
        sound(&output)
    };
    assert!(shell("exit 124").unwrap_err().contains("ten minutes"));
    assert!(
        shell("echo thread main panicked")
            .unwrap_err()
            .contains("panic")
    );
    assert!(shell("kill -ABRT $$").unwrap_err().contains("signal"));
    assert!(shell("exit 3").is_ok());
}
