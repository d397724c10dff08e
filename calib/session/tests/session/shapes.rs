//! shapes.json of a session: what cannot be used is left out by name, and the rest is used.

#[allow(dead_code, reason = "only the good session is of use here")]
use crate::broken::Base;
use serde_json::{Value, json};
use std::fs;
use wcal_core::{SessionData, WhiskerData};
use wcal_session::load;

/// Two pairs, of points 1 and 2, with errors of their own and one that they share.
fn shapes() -> Value {
    let column = |x: f64| json!({"centreline_mm": [[0.0, x, 0.0]], "groove_mm": [0.0, x, 0.0], "contact_arclength_mm": x});
    let pair = |point: i64| {
        json!({
            "name": format!("{point:05}"), "status": "ok", "point": point,
            "centreline_mm": [[0.0, 0.0, 0.0], [9.0, 0.0, 0.1], [18.0, 0.0, 1.25]],
            "groove": {
                "position_mm": [18.0, 0.0, 1.25], "sd_mm": [0.02, 0.02, 0.02],
                "contact_arclength_mm": 18.1, "contact_arclength_sd_mm": 0.03, "axis": [1.0, 0.0, 0.0], "contact": "vertex",
                "covariance_mm2": [[4e-4, 0.0, 0.0], [0.0, 4e-4, 0.0], [0.0, 0.0, 4e-4]],
            },
            "errors": {"stations": [1], "stations_mm": [9.0], "own": [column(0.02)], "floor_mm": 1e-3, "shared": [column(1.0)]},
        })
    };
    json!({
        "format": "wcal-shapes/1", "pairs": [pair(1), pair(2)],
        "shared_parameters": [{"name": "left fx", "unit": "px", "cause": "cameras"}], "shared_covariance": [[1e-4]],
        "source": {"cameras_sha256": "c0", "rig_sha256": "r0", "session": "w"},
    })
}

/// Points whose pair counts, and the warnings; or the error.
fn loaded(text: &str) -> Result<(Vec<i64>, Vec<String>), String> {
    let folder = tempfile::tempdir().unwrap();
    Base::Whisker.write(folder.path());
    let toml = fs::read_to_string(folder.path().join("session.toml")).unwrap();
    let provenance = "[provenance]\ncameras_sha256 = \"c0\"\nshapes_rig_sha256 = \"r0\"\n";
    let toml = toml.replace("[files]\n", "[files]\nshapes = \"shapes.json\"\n") + provenance;
    fs::write(folder.path().join("session.toml"), toml).unwrap();
    fs::write(folder.path().join("shapes.json"), text).unwrap();
    let session = load(folder.path()).map_err(|e| e.to_string())?;
    let SessionData::Whisker(WhiskerData { rows, shapes, .. }) = &session.data else {
        panic!("kind")
    };
    assert!(shapes.is_some() && session.inputs.iter().any(|i| i.path == "shapes.json"));
    let counted = rows
        .iter()
        .filter(|r| r.pair.is_some())
        .map(|r| r.point)
        .collect();
    Ok((
        counted,
        session.warnings.iter().map(ToString::to_string).collect(),
    ))
}

fn with(edit: impl Fn(&mut Value)) -> Result<(Vec<i64>, Vec<String>), String> {
    let mut value = shapes();
    edit(&mut value);
    loaded(&value.to_string())
}

#[test]
fn good_shapes_stand_with_their_rows() {
    assert_eq!(with(|_| ()), Ok((vec![1, 2], vec![])));
    // A pair at rest says nothing of a contact; nothing is wrong with it.
    assert_eq!(
        with(|v| v["pairs"][0]["point"] = json!(0)),
        Ok((vec![2], vec![]))
    );
    // The first pair of a point counts.
    let (counted, warnings) = with(|v| v["pairs"][1]["point"] = json!(1)).unwrap();
    assert!(
        counted == [1] && warnings[0].contains("another pair has its point already"),
        "{warnings:?}"
    );
    // What a pair does not state is not asked for.
    let bare = with(|v| {
        for pair in v["pairs"].as_array_mut().unwrap() {
            pair.as_object_mut().unwrap().remove("errors");
        }
    });
    assert_eq!(bare, Ok((vec![1, 2], vec![])));
}

/// Pairs of the holdout file have a document of their own; they are sealed with their rows.
#[test]
fn sealed_pairs_stand_with_sealed_rows() {
    let folder = tempfile::tempdir().unwrap();
    Base::Whisker.write(folder.path());
    let put = |name: &str, text: &str| fs::write(folder.path().join(name), text).unwrap();
    let toml = fs::read_to_string(folder.path().join("session.toml")).unwrap();
    let files = "[files]\nshapes = \"shapes.json\"\nholdout = \"holdout.csv\"\nholdout_shapes = \"sealed.json\"\n";
    put("session.toml", &toml.replace("[files]\n", files));
    put(
        "holdout.csv",
        &fs::read_to_string(folder.path().join("points.csv"))
            .unwrap()
            .replace("calibration", "holdout"),
    );
    put("shapes.json", &shapes().to_string());
    let mut sealed = shapes();
    sealed["pairs"][1]["point"] = json!(9);
    put("sealed.json", &sealed.to_string());
    let session = load(folder.path()).unwrap();
    let said: Vec<String> = session.warnings.iter().map(ToString::to_string).collect();
    assert!(
        said.len() == 1 && said[0].contains("sealed.json") && said[0].contains("point 9"),
        "{said:?}"
    );
    let SessionData::Whisker(data) = &session.data else {
        panic!("kind")
    };
    assert_eq!(data.rows.iter().filter(|r| r.pair.is_some()).count(), 2);
    assert_eq!(data.rows.iter().filter(|r| r.pair.is_some()).count(), 2);
    let rows = crate::opened(session.sealed.whisker());
    assert_eq!(
        rows.iter()
            .filter(|r| r.pair.is_some())
            .map(|r| r.point)
            .collect::<Vec<_>>(),
        [1]
    );
}

#[test]
fn a_pair_that_cannot_be_used_is_left_out_by_name() {
    type Edit = fn(&mut Value);
    let cases: [(&str, Edit); 17] = [
        ("line not seen", |p| {
            p["status"] = json!("rejected");
            p["why"] = json!("line not seen");
        }),
        ("point 77 is not in the points table", |p| {
            p["point"] = json!(77)
        }),
        ("names no point", |p| p["point"] = Value::Null),
        ("rig tag is not seen", |p| p["groove"] = Value::Null),
        ("does not touch the groove", |p| {
            p["groove"]["contact"] = json!("none")
        }),
        ("not in the groove's vertex", |p| {
            p["groove"]["contact"] = json!("out-of-vertex")
        }),
        // What is no number (NaN) is written as null.
        ("cannot be read", |p| {
            p["groove"]["position_mm"][0] = Value::Null
        }),
        ("cannot be read", |p| p["groove"]["sd_mm"] = json!("small")),
        ("its groove is no place", |p| {
            p["groove"]["position_mm"][0] = json!(1e30)
        }),
        ("standard deviation of its groove is not positive", |p| {
            p["groove"]["sd_mm"][1] = json!(0.0)
        }),
        ("covariance of its groove is not positive", |p| {
            p["groove"]["covariance_mm2"][0][0] = json!(-1e-4)
        }),
        ("covariance of its groove is not positive", |p| {
            p["groove"]["covariance_mm2"][0][1] = json!(1e-3)
        }),
        ("station 9 is not on a centre line of 3 points", |p| {
            p["errors"]["stations"] = json!([9])
        }),
        ("2 arc lengths for 1 stations", |p| {
            p["errors"]["stations_mm"] = json!([9.0, 10.0])
        }),
        ("0 derivatives for 1 shared", |p| {
            p["errors"]["shared"] = json!([])
        }),
        ("501 own errors", |p| {
            p["errors"]["own"] = json!(vec![json!({}); 501])
        }),
        ("does not cover the stations", |p| {
            p["errors"]["own"][0]["centreline_mm"] = json!([[0, 0, 0], [0, 0, 0]])
        }),
    ];
    for (says, edit) in cases {
        let (counted, warnings) = with(|v| edit(&mut v["pairs"][0])).unwrap();
        let text = warnings.join("\n");
        assert_eq!(counted, [2], "{says}: {text}");
        assert!(
            text.contains("1 pair(s) of pictures left out") && text.contains(says),
            "{says}: {text}"
        );
    }
}

#[test]
fn shapes_of_another_session_or_of_other_cameras_are_left_out_whole() {
    type Edit = fn(&mut Value);
    let cases: [(&str, Edit); 7] = [
        ("those of session \"other\"", |v| {
            v["source"]["session"] = json!("other")
        }),
        ("another calibration of the cameras", |v| {
            v["source"]["cameras_sha256"] = json!("c1")
        }),
        ("another rig", |v| v["source"]["rig_sha256"] = json!("r1")),
        ("is no covariance", |v| {
            v["shared_covariance"] = json!([[-1.0]])
        }),
        ("is no covariance", |v| {
            v["shared_covariance"] = json!([[Value::Null]])
        }),
        ("2 rows for 1 parameters", |v| {
            v["shared_covariance"] = json!([[1e-4, 0.0], [0.0, 1e-4]])
        }),
        ("0 rows for 201 parameters", |v| {
            let one = v["shared_parameters"][0].clone();
            v["shared_parameters"] = json!(vec![one; 201]);
            v["shared_covariance"] = json!([]);
        }),
    ];
    for (says, edit) in cases {
        let (counted, warnings) = with(edit).unwrap();
        let text = warnings.join("\n");
        assert!(counted.is_empty(), "{says}: {text}");
        assert!(
            text.contains("2 pair(s)") && text.contains("00001, 00002") && text.contains(says),
            "{says}: {text}"
        );
    }
}

#[test]
fn what_is_no_shapes_file_is_an_error() {
    for text in [
        "",
        "{",
        "[]",
        "{\"format\":\"wcal-stereo/1\",\"pairs\":[]}",
        "{\"format\":\"wcal-shapes/1\",\"pairs\":[NaN]}",
    ] {
        let error = loaded(text).unwrap_err();
        assert!(error.contains("shapes.json"), "{text}: {error}");
    }
    let many = with(|v| v["pairs"] = json!(vec![json!({}); 20_001])).unwrap_err();
    assert!(many.contains("at most 20000 pairs"), "{many}");
}
