//! Models, sweeps and meshes that tracking may not use, or says something of.

use super::*;

const SMALL: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/fixtures/tracker_small");

/// A copy of the small model with its card changed.
fn model(place: &Path, change: impl Fn(&mut serde_json::Value)) {
    fs::create_dir_all(place.join("model")).unwrap();
    fs::copy(
        format!("{SMALL}/model.safetensors"),
        place.join("model/model.safetensors"),
    )
    .unwrap();
    let text = fs::read_to_string(format!("{SMALL}/model.json")).unwrap();
    let mut card: serde_json::Value = serde_json::from_str(&text).unwrap();
    change(&mut card);
    fs::write(place.join("model/model.json"), card.to_string()).unwrap();
}

#[test]
fn a_model_of_another_filter_is_refused_by_name() {
    let place = tempfile::tempdir().unwrap();
    fs::write(
        place.path().join("t.csv"),
        "point,t_s,fbg_1_nm,fbg_2_nm\n1,0,1545,1543\n",
    )
    .unwrap();
    let track = || {
        let run = [
            "track",
            "t.csv",
            "--calibration",
            "none.json",
            "--model",
            "model",
            "--out",
            "out.csv",
        ];
        wcal(place.path(), &run)
    };
    model(place.path(), |card| {
        card["training"]["filter"]["particles"] = 500.into()
    });
    judge(&track(), 1, &["model.json", "unknown field `particles`"]).unwrap();
    model(place.path(), |card| {
        assert_eq!(card["network"]["two_filters"], true);
        let training = card["training"].as_object_mut().unwrap();
        assert!(training.remove("filter_frictionless").is_some());
    });
    judge(
        &track(),
        1,
        &[
            "model.json: training",
            "expected two, as the network weighs, found one",
        ],
    )
    .unwrap();
    model(place.path(), |card| {
        card["network"]["attention"] = "linear".into()
    });
    judge(&track(), 1, &["model.json", "unknown field `attention`"]).unwrap();
    // Control: as it is, the calibration is what is missing.
    model(place.path(), |_| ());
    judge(&track(), 1, &["none.json"]).unwrap();
    assert!(!place.path().join("out.csv").exists());
}

/// Sweeps over objects set aside for tests can be made and evaluated, not trained on.
#[test]
fn test_objects_are_not_trained_on() {
    let place = tempfile::tempdir().unwrap();
    let simulate = |out: &str, objects: &[&str]| {
        let objects: Vec<&str> = objects
            .iter()
            .flat_map(|name| ["--object", *name])
            .collect();
        let run = wcal(
            place.path(),
            &[&["simulate", "--sweeps", "3", "--out", out][..], &objects].concat(),
        );
        assert!(
            matches!(run.status.code(), Some(0 | 3)),
            "{}",
            String::from_utf8_lossy(&run.stderr)
        );
    };
    simulate("mixed", &["ball", "can", "capsule", "l-profile"]);
    simulate("plain", &["ball", "can", "cone"]);
    let train = |more: &[&str]| {
        wcal(
            place.path(),
            &[
                &["train", "plain", "--epochs", "1", "--out", "model"][..],
                more,
            ]
            .concat(),
        )
    };
    let names = ["test objects", "capsule, l-profile"];
    judge(&train(&["--additional", "mixed"]), 1, &names).unwrap();
    let run = wcal(
        place.path(),
        &["train", "mixed", "--epochs", "1", "--out", "model"],
    );
    judge(&run, 1, &names).unwrap();
    assert!(!place.path().join("model/model.json").exists());
    // Control: the others are.
    judge(&train(&[]), 0, &[]).unwrap();
}
