//! `wcal-lab train` without sweeps: it makes its own, trains on them, and its card says how
//! (SIMULATED).

use crate::support::program;
use serde_json::{Value, json};
use std::path::Path;
use std::process::Output;
use std::time::SystemTime;

fn wcal(folder: &Path, args: &[&str]) -> Output {
    program().current_dir(folder).args(args).output().unwrap()
}

fn read(path: &Path) -> Value {
    serde_json::from_slice(&std::fs::read(path).unwrap()).unwrap()
}

/// A box as STL in mm, its faces outward.
fn write_box(path: &Path, [x, y, z]: [f32; 3]) {
    let corner = |k: usize| {
        [(k & 1, x), (k >> 1 & 1, y), (k >> 2 & 1, z)]
            .map(|(high, size)| (high as f32 - 0.5) * size)
    };
    let faces = [
        [0, 2, 3, 1],
        [4, 5, 7, 6],
        [0, 1, 5, 4],
        [2, 6, 7, 3],
        [0, 4, 6, 2],
        [1, 3, 7, 5],
    ];
    let mut bytes = [vec![0; 80], 12_u32.to_le_bytes().to_vec()].concat();
    for [a, b, c, d] in faces {
        for triangle in [[a, b, c], [a, c, d]] {
            let numbers = [[0.0; 3]].into_iter().chain(triangle.map(corner)).flatten();
            bytes.extend(numbers.flat_map(|v: f32| v.to_le_bytes()));
            bytes.extend([0; 2]);
        }
    }
    std::fs::write(path, bytes).unwrap();
}

/// When each shard of the sweeps was written.
fn shards(model: &Path) -> Vec<(String, SystemTime)> {
    let mut all = Vec::new();
    for kind in ["clean", "friction", "upright"] {
        for entry in std::fs::read_dir(model.join("sweeps").join(kind)).unwrap() {
            let entry = entry.unwrap();
            let name = entry.file_name().into_string().unwrap();
            if name.ends_with(".parquet") {
                all.push((
                    format!("{kind}/{name}"),
                    entry.metadata().unwrap().modified().unwrap(),
                ));
            }
        }
    }
    all.sort();
    all
}

#[test]
fn one_command_makes_sweeps_and_model_and_goes_on_where_it_stopped() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    std::fs::create_dir(folder.join("boxes")).unwrap();
    for (name, size) in [
        ("brick", [60.0, 50.0, 70.0]),
        ("cube", [50.0; 3]),
        ("slab", [90.0, 40.0, 80.0]),
    ] {
        write_box(&folder.join("boxes").join(name).with_extension("stl"), size);
    }
    let options = [
        "--preset",
        "compact",
        "--sweeps-each",
        "2",
        "--epochs",
        "2",
        "--out",
        "model",
    ];
    let command = [&["train", "--meshes", "boxes"][..], &options].concat();
    let good = |args: &[&str]| {
        let run = wcal(folder, args);
        assert_eq!(
            run.status.code(),
            Some(0),
            "{}",
            String::from_utf8_lossy(&run.stderr)
        );
        read(&folder.join("model/model.json"))
    };
    let card = good(&command);
    // The card has the command as it was typed, and running just that is what follows.
    assert_eq!(
        card["command"],
        json!([&["wcal-lab"][..], &command].concat())
    );
    let seconds =
        |card: &Value, of: &str| ["wall_s", "cpu_s"].map(|k| card["cost"][of][k].as_f64().unwrap());
    let [sweeps, training] = ["sweeps", "training"].map(|of| seconds(&card, of));
    assert!(
        sweeps
            .iter()
            .chain(&training)
            .all(|s| *s > 0.0 && *s < 600.0),
        "{card}"
    );
    assert!(card["cost"]["cores"].as_u64().unwrap() >= 1, "{card}");
    assert!(
        training[1] >= card["passes"][1]["cpu_s"].as_f64().unwrap(),
        "{card}"
    );
    // Held out and unseen are whole objects; sweeps of two other kinds were trained on as well,
    // upright ones a quarter as many.
    assert_eq!(
        card["objects"]["held_out"].as_array().unwrap().len(),
        1,
        "{card}"
    );
    assert_eq!(card["data_beside"].as_array().unwrap().len(), 2, "{card}");
    let each = |kind: &str| read(&folder.join("model/sweeps").join(kind).join("dataset.json"));
    assert_eq!(
        ["clean", "friction", "upright"].map(|k| each(k)["sweeps_per_object"].clone()),
        [2, 2, 1].map(Value::from)
    );
    assert_eq!(
        each("friction")["plan"]["physics"]["friction"],
        json!([0.0, 0.3])
    );
    assert_eq!(each("upright")["plan"]["turn"], "faces");
    let made = shards(&folder.join("model"));
    // Three kinds over three objects, three tables each.
    assert_eq!(made.len(), 27, "{made:?}");

    // Again: nothing is made anew, and the card is the same to the last number.
    assert_eq!(good(&command), card);
    assert_eq!(shards(&folder.join("model")), made);
    // Stopped while a shard was written: that one is made, the others stay.
    std::fs::remove_file(folder.join("model/sweeps/friction/cube-000000.json")).unwrap();
    let again = good(&command);
    assert_eq!(again["weights_sha256"], card["weights_sha256"]);
    let anew: Vec<(String, SystemTime)> = shards(&folder.join("model"))
        .into_iter()
        .filter(|s| !made.contains(s))
        .collect();
    assert!(
        anew.len() == 3
            && anew
                .iter()
                .all(|(name, _)| name.starts_with("friction/cube")),
        "{anew:?}"
    );

    // Negative controls: other sweeps are not mixed with these; a number of sweeps is none of
    // sweeps that are there.
    let other = wcal(folder, &[&command[..], &["--seed", "2"]].concat());
    let said = String::from_utf8_lossy(&other.stderr);
    assert!(
        other.status.code() == Some(1) && said.contains("seed: "),
        "{said}"
    );
    let both = wcal(
        folder,
        &[
            "train",
            "model/sweeps/clean",
            "--sweeps-each",
            "2",
            "--out",
            "other",
        ],
    );
    assert_eq!(
        both.status.code(),
        Some(2),
        "{}",
        String::from_utf8_lossy(&both.stderr)
    );
}
