//! `wcal-lab simulate` as a user runs it (SIMULATED sweeps).

use crate::support::{program_of, repository, run as wcal, text};

#[test]
fn a_dataset_is_made_and_a_second_run_finds_it_there() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("sweeps");
    let args = [
        "simulate",
        "--object",
        "can",
        "--sweeps",
        "3",
        "--json",
        "--out",
        out.to_str().unwrap(),
    ];
    let first = wcal(&args);
    assert_eq!(first.status.code(), Some(0), "{}", text(&first.stderr));
    let json: serde_json::Value = serde_json::from_slice(&first.stdout).unwrap();
    assert_eq!(
        (json["format"].as_str(), json["simulated"].as_bool()),
        (Some("wcal-sweeps/1"), Some(true))
    );
    assert_eq!(json["sweeps"], 3);
    assert!(json["samples"].as_u64().unwrap() > 20, "{json}");
    for table in ["sweeps", "samples", "contacts"] {
        assert!(out.join(format!("can-000000.{table}.parquet")).exists());
    }
    assert!(out.join("dataset.json").exists());
    let second: serde_json::Value = serde_json::from_slice(&wcal(&args).stdout).unwrap();
    assert_eq!(second["kept"], json["kept"]);
    assert!(
        second.get("sweeps_per_core_s").is_none(),
        "nothing was to be made: {second}"
    );
    // Another dataset into the same folder is refused by name, also by a check, and nothing is
    // replaced.
    let read = |name: &str| std::fs::read(out.join(name)).unwrap();
    let before = [read("can-000000.samples.parquet"), read("dataset.json")];
    for (more, words) in [
        (&["--seed", "2"][..], "seed: there 1, asked for 2"),
        (&["--seed", "2", "--check"], "seed: there 1, asked for 2"),
        (&["--object", "vase"], "object vase: not there"),
    ] {
        let other = wcal(&[&args[..], more].concat());
        let said = text(&other.stderr);
        assert!(
            other.status.code() == Some(1) && said.contains(words),
            "{more:?}: {said}"
        );
    }
    assert!(before == [read("can-000000.samples.parquet"), read("dataset.json")]);
    // A mixture from elsewhere is not trained on.
    let foreign = folder.path().join("foreign");
    let seed = [
        "simulate",
        "--object",
        "can",
        "--sweeps",
        "3",
        "--seed",
        "2",
        "--out",
        foreign.to_str().unwrap(),
    ];
    assert_eq!(wcal(&seed).status.code(), Some(0));
    for file in [
        "can-000000.json",
        "can-000000.sweeps.parquet",
        "can-000000.samples.parquet",
        "can-000000.contacts.parquet",
    ] {
        std::fs::copy(foreign.join(file), out.join(file)).unwrap();
    }
    let model = folder.path().join("model");
    let train = wcal(&[
        "train",
        out.to_str().unwrap(),
        "--out",
        model.to_str().unwrap(),
    ]);
    let said = text(&train.stderr);
    assert!(
        train.status.code() == Some(1) && said.contains("can-000000"),
        "{said}"
    );
}

#[test]
fn what_cannot_be_simulated_is_said_once() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    std::fs::write(path("empty.stl"), b"solid nothing\nendsolid nothing\n").unwrap();
    std::fs::write(path("plan.toml"), "speed_mm_s = [7.0, 3.0]\n").unwrap();
    std::fs::write(path("whisker.toml"), "[whisker]\ndiameter_mm = 0.3\n").unwrap();
    let out = path("out");
    for (args, words) in [
        (
            vec!["--object", "teapot"],
            ["built-in object: expected one of ball", "found teapot"],
        ),
        (vec![], ["expected an object", "found none"]),
        (
            vec!["--object", "can", "--shard", "3/2"],
            ["--shard: expected i/n", "3/2"],
        ),
        (
            vec!["--object", "can", "--plan", &path("plan.toml")],
            ["speed_mm_s: expected", "[7.0, 3.0]"],
        ),
        (
            vec!["--object", "can", "--whisker", &path("whisker.toml")],
            ["whisker.toml", "length_mm"],
        ),
        (
            vec!["--object", "can", "--object", "can"],
            ["different names", "\"can\" twice"],
        ),
        (
            vec!["--meshes", &path("empty.stl")],
            ["expected an object", "triangles, found 0"],
        ),
    ] {
        let mut all = vec!["simulate", "--sweeps", "1", "--out", &out];
        all.extend(args.iter().copied());
        let run = wcal(&all);
        let error = text(&run.stderr);
        assert_eq!(run.status.code(), Some(1), "{args:?}: {error}");
        assert!(words.iter().all(|w| error.contains(w)), "{args:?}: {error}");
        assert!(
            !std::path::Path::new(&out).exists(),
            "{args:?} left something behind"
        );
    }
    // An object that cannot be used is left out by name; the others are made.
    let run = wcal(&[
        "simulate",
        "--sweeps",
        "1",
        "--out",
        &out,
        "--object",
        "can",
        "--meshes",
        &path("empty.stl"),
    ]);
    assert_eq!(run.status.code(), Some(3), "{}", text(&run.stderr));
    assert!(
        text(&run.stderr).contains("empty.stl"),
        "{}",
        text(&run.stderr)
    );
}

/// The template of the plan states the defaults, key by key.
#[test]
fn the_plans_template_is_the_default() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let template = repository("lab/sweeps.toml");
    let plan_of = |more: &[&str], out: &str| {
        let fixed = [
            "simulate", "--object", "can", "--sweeps", "1", "--json", "--out",
        ];
        let done = wcal(&[&fixed[..], &[&at(out)], more].concat());
        let json: serde_json::Value = serde_json::from_slice(&done.stdout).unwrap();
        json["plan"].clone()
    };
    let usual = plan_of(&[], "usual");
    assert_eq!(
        plan_of(&["--plan", template.to_str().unwrap()], "template"),
        usual
    );
    let template = std::fs::read_to_string(&template).unwrap();
    let keys = |v: &serde_json::Value| v.as_object().unwrap().keys().cloned().collect::<Vec<_>>();
    for key in keys(&usual).into_iter().chain(keys(&usual["physics"])) {
        assert!(template.contains(&key), "{key} is not in the template");
    }
    // Negative control: another value is another plan, an unknown key is refused.
    std::fs::write(
        at("other.toml"),
        template
            .replace("weight = false", "weight = true")
            .replace("\"none\" ", "\"air\" "),
    )
    .unwrap();
    assert_ne!(plan_of(&["--plan", &at("other.toml")], "other"), usual);
    std::fs::write(at("wrong.toml"), "[physics]\nfrcition = [0.1, 0.2]\n").unwrap();
    let wrong = wcal(&[
        "simulate",
        "--object",
        "can",
        "--plan",
        &at("wrong.toml"),
        "--out",
        &at("wrong"),
    ]);
    assert!(
        wrong.status.code() == Some(1) && text(&wrong.stderr).contains("frcition"),
        "{}",
        text(&wrong.stderr)
    );
}

/// A tetrahedron as text.
fn tetrahedron(path: &std::path::Path, side: f64, faces: &[[usize; 3]]) {
    let corners = [
        [0.0; 3],
        [side, 0.0, 0.0],
        [0.0, side, 0.0],
        [0.0, 0.0, side],
        [side, side, side],
    ];
    let facet = |face: &[usize; 3]| {
        let vertex = |k: &usize| {
            format!(
                "vertex {} {} {}\n",
                corners[*k][0], corners[*k][1], corners[*k][2]
            )
        };
        let vertices: String = face.iter().map(vertex).collect();
        format!("facet normal 0 0 0\nouter loop\n{vertices}endloop\nendfacet\n")
    };
    let facets: String = faces.iter().map(facet).collect();
    std::fs::write(path, format!("solid t\n{facets}endsolid t\n")).unwrap();
}

#[test]
fn doubtful_meshes_and_rejected_sweeps_are_named_and_counted() {
    let folder = tempfile::tempdir().unwrap();
    let meshes = folder.path().join("meshes");
    std::fs::create_dir(&meshes).unwrap();
    let closed = [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]];
    let fin: Vec<[usize; 3]> = closed.iter().copied().chain([[0, 1, 4]]).collect();
    for (name, side, faces) in [
        ("good", 50.0, &closed[..]),
        ("metres", 0.05, &closed[..]),
        ("open", 50.0, &closed[..3]),
        ("fin", 50.0, &fin[..]),
        ("huge", 5000.0, &closed[..]),
        ("tiny", 1e-5, &closed[..]),
        ("inward", 50.0, &closed.map(|[a, b, c]| [a, c, b])[..]),
    ] {
        tetrahedron(&meshes.join(format!("{name}.stl")), side, faces);
    }
    std::fs::write(
        meshes.join("empty.stl"),
        "solid nothing\nendsolid nothing\n",
    )
    .unwrap();
    std::fs::write(meshes.join("cut.stl"), [0_u8; 90]).unwrap();
    let plan = folder.path().join("plan.toml");
    let run = |plan_text: &str, what: &[&str], name: &str| {
        std::fs::write(&plan, plan_text).unwrap();
        let out = folder.path().join(name);
        let fixed = [
            "simulate",
            "--sweeps",
            "2",
            "--json",
            "--plan",
            plan.to_str().unwrap(),
            "--out",
        ];
        let done = wcal(&[&fixed[..], &[out.to_str().unwrap()], what].concat());
        let json: serde_json::Value = serde_json::from_slice(&done.stdout).unwrap_or_default();
        (done.status.code(), json, text(&done.stderr))
    };
    let (code, json, said) = run(
        "most_mm = 15.0\n",
        &["--meshes", meshes.to_str().unwrap()],
        "meshes-out",
    );
    assert_eq!(code, Some(3), "{said}");
    let lines = |key: &str| {
        json[key]
            .as_array()
            .unwrap()
            .iter()
            .map(|l| l.to_string())
            .collect::<Vec<_>>()
    };
    for (key, words) in [
        ("notes", ["metres", "taken as metres"]),
        ("notes", ["open", "not watertight: 3 open edges"]),
        ("notes", ["fin", "not a manifold: 1 edges"]),
        ("notes", ["inward", "normals pointed inward"]),
        ("left_out", ["huge.stl", "a longest side of 3 to 2000 mm"]),
        ("left_out", ["tiny.stl", "a longest side of 3 to 2000 mm"]),
        ("left_out", ["empty.stl", "triangles, found 0"]),
        ("left_out", ["cut.stl", "is left out"]),
    ] {
        assert!(
            lines(key)
                .iter()
                .any(|l| words.iter().all(|w| l.contains(w))),
            "{words:?}: {json}"
        );
        assert!(words.iter().all(|w| said.contains(w)), "{words:?}: {said}");
    }
    assert_eq!(json["sweeps"], 10, "the five that can be swept are: {json}");
    let of_good = |l: &String| l.contains("good: ") && !l.contains("is kept");
    assert!(
        !lines("notes").iter().any(of_good),
        "nothing is wrong with the good one: {json}"
    );
    // What a sweep is rejected for is counted; an object without a usable sweep is a warning.
    for (plan, verdict) in [
        ("most_strain = 1e-4\n", "torque-too-high"),
        ("most_mm = 0.4\n", "no-contact"),
    ] {
        let (code, json, said) = run(plan, &["--object", "can"], verdict);
        assert_eq!(
            (code, &json["verdicts"][verdict]),
            (Some(3), &2.into()),
            "{said} {json}"
        );
        assert!(said.contains("of 2 sweeps"), "{said}");
    }
    // Negative control.
    let (code, json, _) = run("most_mm = 30.0\n", &["--object", "can"], "control");
    assert_eq!((code, &json["kept"]), (Some(0), &2.into()), "{json}");
}

#[test]
fn a_missing_mujoco_engine_is_named_and_nothing_else_needs_it() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    let session = concat!(env!("CARGO_MANIFEST_DIR"), "/../fixtures/whiskerfbg");
    let table = folder.path().join("twin.csv");
    let run = |args: &[&str]| {
        let mut command = program_of(args[0]);
        command
            .args(args)
            .env("WCAL_MUJOCO", "/nonexistent/wcal-mujoco")
            .output()
            .unwrap()
    };
    let sweeps = [
        "simulate",
        "--object",
        "can",
        "--sweeps",
        "1",
        "--out",
        out.to_str().unwrap(),
    ];
    let twin = ["twin", session, "--out", table.to_str().unwrap()];
    for args in [&sweeps[..], &twin[..]] {
        let found = run(&[args, &["--engine", "mujoco"]].concat());
        let error = text(&found.stderr);
        assert_eq!(found.status.code(), Some(1), "{error}");
        assert!(error.contains("WCAL_MUJOCO"), "{error}");
        assert!(error.contains("/nonexistent/wcal-mujoco"), "{error}");
        assert!(!out.exists() || args[0] == "twin", "nothing is left behind");
        assert_eq!(
            run(&[args, &["--engine", "rod"]].concat()).status.code(),
            Some(0)
        );
    }
}

const WHISKER: &str = "[whisker]\ndiameter_mm = 0.3\nlength_mm = 60.0\n";
const ARC: &str = "straight_mm = 30.0\narc_radius_mm = 20.0\n";

/// A whisker of free curvature is read as its points; a shape stated twice or not at all is an
/// error.
#[test]
fn a_whisker_may_have_any_rest_shape() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let points: Vec<String> = (0..=60)
        .map(|k| f64::from(k) / 60.0)
        .map(|x| {
            format!(
                "[{:.4}, 0.0, {:.4}]",
                20.0 * (3.0 * x).sin(),
                20.0 * ((3.0 * x).cos() - 1.0)
            )
        })
        .collect();
    let bent = format!("rest_shape = [{}]\n", points.join(", "));
    let run = |name: &str, keys: &str| {
        std::fs::write(at("whisker.toml"), format!("{WHISKER}{keys}")).unwrap();
        let out = at(name);
        let done = wcal(&[
            "simulate",
            "--object",
            "can",
            "--sweeps",
            "3",
            "--json",
            "--whisker",
            &at("whisker.toml"),
            "--out",
            &out,
        ]);
        (
            done.status.code(),
            std::fs::read(format!("{out}/can-000000.samples.parquet")).ok(),
            text(&done.stderr),
        )
    };
    let (code, table, said) = run("bent", &bent);
    assert!(matches!(code, Some(0 | 3)) && table.is_some(), "{said}");
    assert!(run("arc", ARC).1 != table, "negative control: another wire");
    for keys in [
        format!("{bent}{ARC}"),
        String::new(),
        "straight_mm = 30.0\n".to_owned(),
    ] {
        let (code, _, said) = run("wrong", &keys);
        assert!(
            code == Some(1) && said.contains("arc_radius_mm, or rest_shape"),
            "{said}"
        );
    }
}
