//! A recorded session with pictures (fixtures/pictured, SIMULATED) through the program: shapes,
//! then a verdict that they sharpen.

use crate::support::copy::copy_folder;
use crate::support::{code_and_messages, fixture};
use serde_json::Value;
use std::path::PathBuf;

/// What the bench's scenario moved the groove by, base frame, mm.
const OFFSET_MM: [f64; 3] = [0.0, 0.06, 0.08];

/// Exit code, messages and verify.json.
fn verify(session: &str) -> (i32, String, Value) {
    let out = tempfile::tempdir().unwrap();
    let (code, text) = code_and_messages(&[
        "verify",
        session,
        "--out",
        out.path().to_str().unwrap(),
        "--force",
    ]);
    let document = std::fs::read(out.path().join("verify.json")).unwrap();
    (code, text, serde_json::from_slice(&document).unwrap())
}

/// Intervals of the offset where it is the one effect that was named.
fn offsets(document: &Value) -> Option<Vec<[f64; 2]>> {
    let effects = document["effects"].as_array()?;
    if effects.len() != 1 || effects[0]["id"] != "contact-offset" {
        return None;
    }
    let interval = |p: &Value| Some([p["interval95"][0].as_f64()?, p["interval95"][1].as_f64()?]);
    effects[0]["parameters"]
        .as_array()?
        .iter()
        .map(interval)
        .collect()
}

#[test]
fn pictures_tell_where_the_groove_is() {
    let folder = tempfile::tempdir().unwrap();
    let place: PathBuf = folder.path().join("session");
    copy_folder(&fixture("pictured"), &place);
    let session = place.to_str().unwrap();
    // Negative control: without shapes the same session tells it at least ten times less sharply,
    // if at all.
    let (_, _, blind) = verify(session);
    assert!(
        blind["tests"].is_null() && blind["after"]["contact_rmse_mm"].is_null(),
        "{blind}"
    );
    let before = offsets(&blind);

    let (code, text) = code_and_messages(&[
        "stereo-shape",
        session,
        "--cameras",
        place.join("stereo.json").to_str().unwrap(),
    ]);
    assert!(
        code == 0 && text.contains("SIMULATED") && text.contains("12 of 12 pairs"),
        "{text}"
    );
    let (code, text, document) = verify(session);
    assert_eq!(
        (code, &document["verdict"]),
        (0, &Value::from("effect")),
        "{text}"
    );
    let found = offsets(&document).unwrap_or_else(|| unreachable!("{}", document["effects"]));
    for ([low, high], truth) in found.iter().zip(OFFSET_MM) {
        // Three 95 % intervals of one recorded session: half as wide again as stated is allowed.
        let (middle, half) = (0.5 * (low + high), 0.5 * (high - low));
        assert!(
            (truth - middle).abs() < 1.5 * half && half < 0.002,
            "{found:?}"
        );
    }
    if let Some(before) = before {
        assert!(
            before
                .iter()
                .zip(&found)
                .skip(1)
                .all(|(b, f)| b[1] - b[0] > 10.0 * (f[1] - f[0])),
            "{before:?}"
        );
    }
    let contact = |key: &str| document[key]["contact_rmse_mm"].as_f64().unwrap();
    assert!(
        contact("after") < 0.3 * contact("before"),
        "{} {}",
        contact("before"),
        contact("after")
    );
    assert!(document["simulated"] == true, "the mark goes along");

    // Cameras that were calibrated anew since, or another rig: the shapes are named and left out,
    // the readings used.
    let file = place.join("session.toml");
    let good = std::fs::read_to_string(&file).unwrap();
    for (key, why) in [
        ("cameras_sha256", "another calibration of the cameras"),
        ("shapes_rig_sha256", "another rig"),
    ] {
        std::fs::write(
            &file,
            good.replace(&format!("{key} = \""), &format!("{key} = \"0")),
        )
        .unwrap();
        let (code, text, document) = verify(session);
        assert!(
            code == 3 && text.contains("12 pair(s)") && text.contains(why),
            "{key}: {text}"
        );
        assert!(document["after"]["contact_rmse_mm"].is_null(), "{key}");
    }
}
