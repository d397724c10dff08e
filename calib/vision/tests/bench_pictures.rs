//! The whole way on ray-traced pictures of the bench (simulated by an outside renderer): against what was drawn.

mod common;

use nalgebra::Vector3;
use serde_json::Value;
use wcal_vision::calibrate_folders::{Board, Pattern, calibrate_folders};
use wcal_vision::chessboard::BoardSize;
use wcal_vision::pairs::{list_pictures, pair_files};
use wcal_vision::rig::Rig;
use wcal_vision::shapes::shapes_of_pairs;
use wcal_vision::shapes_document::ShapesDocument;

fn folder(name: &str) -> String {
    common::fixture("stereo_bench").join(name).display().to_string()
}

fn run(rig_text: &str) -> ShapesDocument {
    let board =
        Board { size: BoardSize { columns: 9, rows: 6 }, square_mm: 6.0, pattern: Pattern::Chessboard };
    let (document, _) =
        calibrate_folders(&folder("board/left"), &folder("board/right"), &board, &|_| {}).unwrap();
    let stereo = document.stereo_cameras().unwrap();
    let rig = Rig::parse("rig.toml", rig_text).unwrap();
    let files = pair_files(
        &list_pictures(&folder("scene/left")).unwrap(),
        &list_pictures(&folder("scene/right")).unwrap(),
    )
    .unwrap();
    shapes_of_pairs(&stereo, &rig, &files, &|_| {}).document
}

fn vector(v: &Value) -> Vector3<f64> {
    Vector3::from_iterator(v.as_array().unwrap().iter().map(|x| x.as_f64().unwrap()))
}

fn distance(p: &Vector3<f64>, line: &[Vector3<f64>]) -> f64 {
    line.windows(2)
        .map(|w| {
            let d = w[1] - w[0];
            let u = ((p - w[0]).dot(&d) / d.norm_squared()).clamp(0.0, 1.0);
            (p - w[0] - d * u).norm()
        })
        .fold(f64::INFINITY, f64::min)
}

#[test]
fn wire_tip_and_groove_lie_where_they_were_drawn_and_a_wrong_rig_is_noticed() {
    let rig = std::fs::read_to_string(folder("rig.toml")).unwrap();
    let truth: Value = serde_json::from_str(&std::fs::read_to_string(folder("truth.json")).unwrap()).unwrap();
    let shapes = run(&rig);
    assert_eq!(shapes.pairs.len(), 3);
    for pair in &shapes.pairs {
        assert_eq!(pair.status, "ok", "{}: {}", pair.name, pair.why);
        let t = truth["scene"].as_array().unwrap().iter().find(|t| t["name"] == pair.name.as_str()).unwrap();
        let line: Vec<Vector3<f64>> = t["centreline"].as_array().unwrap().iter().map(vector).collect();
        let found: Vec<Vector3<f64>> = pair.centreline_mm.iter().map(|p| Vector3::from(*p)).collect();
        let rms = (found.iter().map(|p| distance(p, &line).powi(2)).sum::<f64>() / found.len() as f64).sqrt();
        assert!(rms <= 0.03, "{}: wire {rms} mm", pair.name);
        let tip = (found.last().unwrap() - line.last().unwrap()).norm();
        assert!(tip <= 0.05, "{}: tip {tip} mm", pair.name);
        if let (Some(g), Some(drawn)) = (&pair.groove, t["groove"].as_object()) {
            let d = (Vector3::from(g.position_mm) - vector(&drawn["position"])).norm();
            assert!(d <= 0.05, "{}: groove {d} mm", pair.name);
            let arc = g.contact_arclength_mm - drawn["contact_arclength"].as_f64().unwrap();
            assert!(arc.abs() <= 0.1, "{}: contact {arc} mm", pair.name);
            assert_eq!(g.contact, "vertex");
        }
    }
    // Negative control: a base tag that is said to stand 1 mm off is noticed, not silently believed.
    let wrong = run(&rig.replace("[0, 0, 1, -9]", "[0, 0, 1, -10]"));
    assert!(wrong.warnings.iter().any(|w| w.contains("disagree")), "{:?}", wrong.warnings);
}

#[test]
fn without_the_base_tag_a_pair_is_rejected_with_the_reason() {
    let rig = std::fs::read_to_string(folder("rig.toml")).unwrap().replace("id = 0", "id = 17");
    let shapes = run(&rig);
    for pair in &shapes.pairs {
        assert_eq!(pair.status, "rejected");
        assert!(pair.why.contains("base tag"), "{}", pair.why);
    }
}
