//! Documents, tables and meshes that are larger than their kind can be: refused before they are
//! read, with little memory.

use super::limits::sound;
use super::*;
use crate::support::{fixture, repository};
use std::io::Write;

/// `wcal ARGUMENTS` with a quarter of a gigabyte of memory beside the program itself: what reads
/// first and judges later does not end in it.
fn small(folder: &Path, arguments: &[&str]) -> Output {
    let script = "ulimit -v 1500000; ulimit -t 60; exec timeout 600 \"$0\" \"$@\" < /dev/null";
    let program = program_of(arguments[0]).get_program().to_owned();
    Command::new("sh")
        .args(["-c", script])
        .arg(program)
        .args(arguments)
        .current_dir(folder)
        .output()
        .unwrap()
}

/// A folder with a document of every kind that a command reads, each with such a command.
fn documents(place: &Path) -> Vec<(&'static str, &'static str)> {
    let copy = |from: &Path, to: &str| {
        let to = place.join(to);
        fs::create_dir_all(to.parent().unwrap()).unwrap();
        fs::copy(from, to).unwrap();
    };
    fs::create_dir_all(place.join("s")).unwrap();
    Base::Transducer.write(&place.join("s"));
    copy(&repository("rigs/virtual/rig.toml"), "rig.toml");
    copy(&repository("rigs/plans/paper-27.toml"), "plan.toml");
    copy(&repository("rigs/virtual/scenario.toml"), "scenario.toml");
    copy(&fixture("tracker_small/model.json"), "model/model.json");
    copy(
        &fixture("tracker_small/model.safetensors"),
        "model/model.safetensors",
    );
    copy(&fixture("pictured/stereo.json"), "stereo.json");
    for name in ["rig.toml", "run.json"] {
        copy(&fixture("pictured").join(name), &format!("recorded/{name}"));
    }
    let [_, _, scalar] = calibrations::models();
    fs::write(
        place.join("c.json"),
        calibrations::calibration(scalar).to_string(),
    )
    .unwrap();
    fs::write(place.join("cell.csv"), "point,response\n1,2.5\n2,4.5\n").unwrap();
    fs::write(place.join("sweeps.toml"), "rate_hz = 5.0\n").unwrap();
    fs::write(
        place.join("shapes.json"),
        "{\"format\": \"wcal-shapes/1\", \"pairs\": []}",
    )
    .unwrap();
    vec![
        ("s/session.toml", "verify s --check"),
        (
            "rig.toml",
            "stage-sweep --rig rig.toml --plan plan.toml --dry-run",
        ),
        (
            "plan.toml",
            "stage-sweep --rig rig.toml --plan plan.toml --dry-run",
        ),
        ("scenario.toml", "virtual-bench --scenario scenario.toml"),
        (
            "stereo.json",
            "stereo-shape left right --cameras stereo.json --rig rig.toml --out shapes",
        ),
        ("recorded/rig.toml", "reduce recorded"),
        ("recorded/run.json", "reduce recorded"),
        (
            "c.json",
            "predict cell.csv --calibration c.json --out o.csv",
        ),
        (
            "sweeps.toml",
            "simulate --object can --sweeps 1 --plan sweeps.toml --out o",
        ),
        (
            "shapes.json",
            "fit-whisker shapes.json --rig rig.toml --out fitted",
        ),
    ]
}

/// Blanks at its end change nothing of a document but its size.
fn padded(path: &Path, bytes: usize) {
    let mut file = fs::OpenOptions::new().append(true).open(path).unwrap();
    file.write_all(&vec![b'\n'; bytes]).unwrap();
}

#[test]
fn documents_have_the_size_that_their_kind_can_have() {
    const LIMIT: &str = "at most 16777216 bytes";
    let place = tempfile::tempdir().unwrap();
    for (file, command) in documents(place.path()) {
        let arguments: Vec<&str> = command.split(' ').collect();
        let path = place.path().join(file);
        let good = fs::read(&path).unwrap();
        padded(&path, 1 << 20);
        let output = small(place.path(), &arguments);
        let text = sound(&output).unwrap_or_else(|why| panic!("{file}: {why}"));
        assert!(
            !text.contains("bytes, found"),
            "{file}: negative control, a megabyte more: {text}"
        );
        padded(&path, 16 << 20);
        let output = small(place.path(), &arguments);
        let name = file.rsplit('/').next().unwrap();
        judge(&output, 1, &[name, LIMIT]).unwrap_or_else(|why| panic!("{file}: {why}"));
        fs::write(&path, good).unwrap();
    }
}

#[test]
fn a_tables_columns_are_counted_before_it_is_read() {
    let place = tempfile::tempdir().unwrap();
    let [_, _, scalar] = calibrations::models();
    fs::write(
        place.path().join("c.json"),
        calibrations::calibration(scalar).to_string(),
    )
    .unwrap();
    Base::Transducer.write(place.path());
    let wide = |columns: usize| {
        let names: String = (0..columns).map(|k| format!(",x{k}")).collect();
        let cells = ",1".repeat(columns);
        let head = "point,role,stimulus,response";
        format!(
            "{head}{names}\n0,calibration,1,2.5{cells}\n1,calibration,2,4.5{cells}\n2,calibration,3,6.5{cells}\n"
        )
    };
    for (columns, code) in [(900, 0), (20_003, 1)] {
        fs::write(place.path().join("points.csv"), wide(columns)).unwrap();
        let says: &[&str] = if code == 1 {
            &["points.csv", "at most 1000 columns", "20007"]
        } else {
            &[]
        };
        for command in [
            "predict points.csv --calibration c.json --out o.csv --force",
            "import points.csv --kind transducer --stimulus stimulus --response response --model linear --out i --force",
        ] {
            let arguments: Vec<&str> = command.split(' ').collect();
            let output = small(place.path(), &arguments);
            judge(&output, code, says).unwrap_or_else(|why| panic!("{columns}: {command}: {why}"));
        }
        if code == 1 {
            judge(&small(place.path(), &["verify", ".", "--check"]), 1, says).unwrap();
        }
    }
}

/// A file with a hole is as large as it says, and not on the disk.
#[test]
fn a_mesh_is_refused_by_the_number_of_its_triangles_before_it_is_read() {
    let place = tempfile::tempdir().unwrap();
    let path = place.path().join("large.stl");
    let simulate = "simulate --meshes large.stl --sweeps 1 --out o";
    let arguments: Vec<&str> = simulate.split(' ').collect();
    let mut header = vec![b' '; 80];
    header.extend(4_000_000_u32.to_le_bytes());
    fs::write(&path, header).unwrap();
    fs::OpenOptions::new()
        .write(true)
        .open(&path)
        .unwrap()
        .set_len(84 + 50 * 4_000_000)
        .unwrap();
    judge(
        &small(place.path(), &arguments),
        1,
        &["large.stl", "at most 1000000 triangles", "4000000"],
    )
    .unwrap();
    fs::write(&path, "solid large\n").unwrap();
    fs::OpenOptions::new()
        .write(true)
        .open(&path)
        .unwrap()
        .set_len(1 << 30)
        .unwrap();
    judge(
        &small(place.path(), &arguments),
        1,
        &["large.stl", "at most 419430400 bytes"],
    )
    .unwrap();
}

/// As many triangles as are allowed: a sheet of a thousand by five hundred fields.
#[test]
fn a_mesh_of_the_largest_number_of_triangles_stays_within_its_memory() {
    let place = tempfile::tempdir().unwrap();
    let (columns, rows) = (1000_u32, 500_u32);
    let at = |i: u32, k: u32| {
        let (x, y) = (0.05 * i as f32, 0.05 * k as f32);
        [x, y, 2.0 * (0.2 * x).sin() * (0.3 * y).cos()]
    };
    let mut bytes = vec![b' '; 80];
    bytes.extend((2 * columns * rows).to_le_bytes());
    let mut triangle = |corners: [[f32; 3]; 3]| {
        bytes.extend([0; 12]);
        corners
            .iter()
            .flatten()
            .for_each(|x| bytes.extend(x.to_le_bytes()));
        bytes.extend([0, 0]);
    };
    for i in 0..columns {
        for k in 0..rows {
            triangle([at(i, k), at(i + 1, k), at(i, k + 1)]);
            triangle([at(i + 1, k), at(i + 1, k + 1), at(i, k + 1)]);
        }
    }
    fs::write(place.path().join("sheet.stl"), &bytes).unwrap();
    let run = |limit_kb: &str, object: &str| {
        let script = format!("ulimit -v {limit_kb}; exec \"$0\" \"$@\" < /dev/null");
        let simulate = format!("simulate {object} --sweeps 1 --out o --force");
        Command::new("sh")
            .args(["-c", &script])
            .arg(program_of("simulate").get_program())
            .args(simulate.split(' '))
            .current_dir(place.path())
            .output()
    };
    let large = run("2500000", "--meshes sheet.stl").unwrap();
    let text = sound(&large).unwrap();
    assert!(
        large.status.code() != Some(1) && text.contains("sheet"),
        "{text}"
    );
    // Negative control: a limit below what it takes is met by this mesh, and by no small object.
    assert!(sound(&run("600000", "--meshes sheet.stl").unwrap()).is_err());
    assert!(sound(&run("600000", "--object can").unwrap()).is_ok());
}
