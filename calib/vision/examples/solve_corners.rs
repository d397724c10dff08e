//! Solves two cameras from corners given as JSON on stdin, for side-by-side measurements:
//! `{"columns", "rows", "square", "image_size": [w, h], "repeat", "views": [{"left": [[x, y], ..], "right": [..]}]}`.
//! Prints RMS and baseline without and with board warp, and the median time of a solve from
//! scratch.
#![allow(clippy::print_stdout, reason = "an example talks to its user")]

use nalgebra::Vector2;
use serde_json::{Value, json};
use std::time::Instant;
use wcal_vision::calibrate::board::board_points;
use wcal_vision::calibrate::bundle::{BoardView, BundleState, Free, solve};
use wcal_vision::calibrate::solution::calibrate_stereo;
use wcal_vision::camera::OPENCV5;

fn main() -> anyhow::Result<()> {
    let input: Value = serde_json::from_reader(std::io::stdin())?;
    let size = |key: &str| input[key].as_u64().unwrap_or(0) as usize;
    let points = board_points(
        size("columns"),
        size("rows"),
        input["square"].as_f64().unwrap_or(1.0),
    );
    let image = [0, 1].map(|k| input["image_size"][k].as_u64().unwrap_or(0) as usize);
    let corners = |v: &Value| -> Vec<Option<Vector2<f64>>> {
        v.as_array()
            .into_iter()
            .flatten()
            .map(|p| Some(Vector2::new(p[0].as_f64()?, p[1].as_f64()?)))
            .collect()
    };
    let views: Vec<BoardView> = input["views"]
        .as_array()
        .into_iter()
        .flatten()
        .enumerate()
        .map(|(k, v)| BoardView {
            name: k.to_string(),
            corners: [corners(&v["left"]), corners(&v["right"])],
        })
        .collect();
    let mut seconds = Vec::new();
    let mut solution = calibrate_stereo(&points, views.clone(), image, OPENCV5)?;
    for _ in 0..size("repeat").max(1) {
        let start = Instant::now();
        solution = calibrate_stereo(&points, views.clone(), image, OPENCV5)?;
        seconds.push(start.elapsed().as_secs_f64());
    }
    seconds.sort_by(f64::total_cmp);
    let state = solution.bundle.state.clone();
    let flat = solve(
        &points,
        &solution.views,
        BundleState {
            warp: [0.0; 2],
            ..state.clone()
        },
        Free::All(false),
    );
    let bent = solve(&points, &solution.views, state, Free::All(true));
    let baseline = |s: &BundleState| s.right_from_left.translation.vector.norm();
    let out = json!({
        "views": solution.views.len(),
        "flat": {"rms_px": flat.rms_px(), "baseline": baseline(&flat.state)},
        "warp": {"rms_px": bent.rms_px(), "baseline": baseline(&bent.state)},
        "seconds": seconds[seconds.len() / 2],
    });
    println!("{out}");
    Ok(())
}
