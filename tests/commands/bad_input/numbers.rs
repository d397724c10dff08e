//! Numbers that the documents of each command may hold ([`super::number_walk`]).

use super::number_walk::{Document, impossible, json, judge_all, read, toml};
use super::*;
use crate::support::{fixture, repository};
use serde_json::Value;

/// Every key of a plan.
const PLAN: &str = r#"
format = "wcal-plan/1"
name = "p"
soak_s = 10.0
[settle]
gate_pm_per_s = 0.5
window_s = 1.0
timeout_s = 20.0
[[block]]
role = "calibration"
trajectories = [1]
depths_mm = [1.0, 3.0]
depths_of = { 1 = [1.0, 2.0] }
replicates = 2
unloading = true
speeds_mm_s = [2.0]
dwell_s = 2.0
average_s = 1.0
on_the_fly_hz = 10.0
"#;

#[test]
fn what_no_bench_can_have_is_told_by_key_and_value() {
    for (way, value) in [
        ("/whisker/length_mm", "0"),
        ("/fbg/nominal_nm/0", "-1"),
        ("/model/variance", "-1"),
        ("/x", "1e308"),
    ] {
        assert!(impossible(way, value), "{way} {value}");
    }
    for (way, value) in [
        ("/whisker/straight_mm", "0"),
        ("/stage/zero_mm", "-1"),
        ("/whisker/length_mm", "1000000000"),
    ] {
        assert!(!impossible(way, value), "negative control: {way} {value}");
    }
}

#[test]
fn rigs_and_plans_hold_only_numbers_that_a_bench_can_have() {
    let place = tempfile::tempdir().unwrap();
    let more = "baud = 9600\naddress = 1\naxis = 1\napproach_mm = 0.5\nretract_mm";
    let rig = read("rigs/virtual/rig.toml").replacen("retract_mm", more, 1);
    let base = "\n[base]\nworld_from_base = [[1.0, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]\ncarried_along = [0, 0, 1]\n";
    judge_all(
        place.path(),
        &[
            Document::new(
                "plan",
                "plan.toml",
                toml(PLAN),
                "stage-sweep --rig . --plan plan.toml --dry-run",
            ),
            Document::new(
                "rig",
                "rig.toml",
                toml(&(rig + base)),
                "stage-sweep --rig rig.toml --plan plan.toml --dry-run",
            ),
        ],
    );
}

/// Every number of a scenario; the wire is the bench's own, which is there at once.
const SCENARIO: &str = r#"
format = "wcal-scenario/1"
seed = 1
speed = 4.0
[stage]
baud = 9600
zero_mm = 20.0
[stage.unit]
device_id = 50105
serial = 67890
microstep_um = 0.047625
limit_steps = 2133333
max_speed_mm_s = 26.0
acceleration_mm_s2 = 200.0
start_mm = 37.0
[mount]
steps_per_trajectory = 10000
[interrogator]
rate_hz = 2000.0
noise_pm = 1.0
split_bytes = 0
buffer = 60000
clock_offset_s = 0.0
clock_drift_ppm = 0.0
[fbg]
nominal_nm = [1541.2, 1535.8]
reference_nominal_nm = 1537.3
k_pm_per_nmm = [[72.0, 9.0], [-6.0, 78.0]]
temperature_pm_per_degc = [10.0, 10.0]
reference_temperature_pm_per_degc = 10.0
zero_pm = [3.0, -2.0]
[whisker]
diameter_mm = 0.3
length_mm = 60.0
straight_mm = 30.0
arc_radius_mm = 20.0
youngs_gpa = 75.0
shear_gpa = 28.2
[[trajectory]]
id = 1
origin_mm = [18.0, 0.0, 0.0]
direction = [0.0, 0.0, 1.0]
[temperature]
start_degc = 21.0
drift_degc_per_h = 0.3
swing_degc = 0.05
swing_period_s = 600.0
[effects]
backlash_um = 1.0
stage_scale = 0.001
periodic_um = 1.0
lag_ms = 10.0
zero_drift_pm_per_min = 0.1
creep_fraction = 0.01
creep_s = 10.0
quadratic_fraction = 0.01
groove_offset_mm = [0.0, 0.0, 0.0]
root_turn_rad_per_nmm = 0.001
[cameras]
count = 2
rate_hz = 5.0
size_px = [640, 480]
skew_ms = 0.0
moving_binning = 4
exposure = 1.0
blur_px = 0.6
noise_dn = 0.8
uneven_light = [0.12, 0.1]
board_views = 12
board_corners = [9, 6]
board_square_mm = 6.0
[cameras.errors]
moved_mm = [0.0, 0.0, 0.0]
moved_deg = [0.0, 0.0, 0.0]
board_scale = 1.0
rig_tag_mm = [0.0, 0.0, 0.0]
rig_tag_deg = [0.0, 0.0, 0.0]
[[fault]]
at_s = 1.0
kind = "stream-gap"
seconds = 1.0
"#;

#[test]
fn scenarios_hold_only_numbers_that_a_bench_can_have() {
    let place = tempfile::tempdir().unwrap();
    let command = "virtual-bench --scenario s.toml";
    judge_all(
        place.path(),
        &[Document::new("scenario", "s.toml", toml(SCENARIO), command)],
    );
}

#[test]
fn sessions_hold_only_numbers_that_a_wire_can_have() {
    let place = tempfile::tempdir().unwrap();
    Base::Whisker.write(place.path());
    let session = fs::read_to_string(place.path().join("session.toml")).unwrap();
    judge_all(
        place.path(),
        &[Document::new(
            "session",
            "session.toml",
            toml(&session),
            "verify . --check",
        )],
    );
}

const SWEEPS: &str = r#"
speed_mm_s = [3.0, 7.0]
acceleration_mm_s2 = 0.4
rate_hz = 5.0
gap_mm = [22.0, 47.0]
lead_mm = [2.0, 12.0]
most_mm = 30.0
tail_mm = 5.0
step_mm = 1.0
most_strain = 0.015
[physics]
friction = [0.0, 0.2]
softening_onset_per_m = [25.0, 70.0]
softening_hardening = 0.1
medium = "water"
current_mm_s = [0.0, 1.0]
"#;

const WHISKER: &str = r#"
format = "wcal-whisker/1"
[whisker]
diameter_mm = 0.3
length_mm = 60.0
straight_mm = 30.0
arc_radius_mm = 20.0
youngs_gpa = 75.0
shear_gpa = 28.2
[dynamics]
damping_s = 0.02
armature_s2 = 1e-6
contact_time_s = 0.002
width_mm = 0.1
impedance = [0.95, 0.99]
"#;

#[test]
fn whiskers_and_sweep_plans_hold_only_numbers_that_can_be_swept() {
    let place = tempfile::tempdir().unwrap();
    let polyline = "[whisker]\ndiameter_mm = 0.3\nlength_mm = 60.0\nrest_shape = [[0.0, 0.0, 0.0], [30.0, 0.0, 0.0], [55.0, 0.0, -12.0]]\n";
    judge_all(
        place.path(),
        &[
            Document::new(
                "sweep plan",
                "sweeps.toml",
                toml(SWEEPS),
                "simulate --object can --sweeps 1 --plan sweeps.toml --out o",
            ),
            Document::new(
                "whisker",
                "whisker.toml",
                toml(WHISKER),
                "simulate --object can --sweeps 1 --plan sweeps.toml --whisker whisker.toml --out o",
            ),
            Document::new(
                "whisker of points",
                "points.toml",
                toml(polyline),
                "simulate --object can --sweeps 1 --plan sweeps.toml --whisker points.toml --out o",
            ),
        ],
    );
}

#[test]
fn calibrations_hold_only_numbers_that_a_table_can_be_put_through() {
    let place = tempfile::tempdir().unwrap();
    let write = |name: &str, text: &str| fs::write(place.path().join(name), text).unwrap();
    write(
        "whisker.csv",
        "point,t_s,fbg_1_nm,fbg_2_nm\n1,0,1541.21,1535.81\n2,1,1541.4,1535.9\n",
    );
    write("cell.csv", "point,response\n1,2.5\n2,4.5\n");
    let [physical, map, scalar] = calibrations::models();
    let documents = [
        (
            "physical",
            physical,
            "predict whisker.csv --calibration physical.json --out o.csv",
            "physical.json",
        ),
        (
            "map",
            map,
            "predict whisker.csv --calibration map.json --out o.csv",
            "map.json",
        ),
        (
            "scalar",
            scalar,
            "predict cell.csv --calibration scalar.json --out o.csv",
            "scalar.json",
        ),
    ]
    .map(|(name, model, arguments, file)| Document {
        sealed: true,
        ..Document::new(name, file, calibrations::calibration(model), arguments)
    });
    judge_all(place.path(), &documents);
}

#[test]
fn models_hold_only_numbers_that_a_network_can_have() {
    let place = tempfile::tempdir().unwrap();
    let write = |name: &str, text: &str| fs::write(place.path().join(name), text).unwrap();
    write("c.json", &calibrations::whisker_calibration().to_string());
    write(
        "t.csv",
        "point,t_s,fbg_1_nm,fbg_2_nm\n1,0,1541.21,1535.81\n2,0.1,1551.4,1535.9\n",
    );
    fs::create_dir(place.path().join("model")).unwrap();
    let weights = "fixtures/tracker_small/model.safetensors";
    fs::copy(
        repository(weights),
        place.path().join("model/model.safetensors"),
    )
    .unwrap();
    let mut card = json(&read("fixtures/tracker_small/model.json"));
    // A coarse curve: the table is made in every run.
    let inverse = &mut card["inverse"];
    (inverse["directions"], inverse["steps"], inverse["links"]) = (8.into(), 4.into(), 10.into());
    let command = "track t.csv --calibration c.json --model model --force --out o.csv";
    judge_all(
        place.path(),
        &[Document::new("model", "model/model.json", card, command)],
    );
}

/// Weights that are no numbers would give contacts that are none.
#[test]
fn weights_that_are_no_numbers_are_refused_by_their_tensor() {
    let place = tempfile::tempdir().unwrap();
    let folder = place.path().join("model");
    fs::create_dir(&folder).unwrap();
    let fixture = fixture("tracker_small");
    let good = fs::read(fixture.join("model.safetensors")).unwrap();
    let mut card = json(&read("fixtures/tracker_small/model.json"));
    let write = |name: &str, text: &str| fs::write(place.path().join(name), text).unwrap();
    write("c.json", &calibrations::whisker_calibration().to_string());
    write(
        "t.csv",
        "point,t_s,fbg_1_nm,fbg_2_nm\n1,0,1541.21,1535.81\n",
    );
    let track = [
        "track",
        "t.csv",
        "--calibration",
        "c.json",
        "--model",
        "model",
        "--force",
        "--out",
        "o.csv",
    ];
    for (bits, found) in [
        (1.0_f32, false),
        (f32::NAN, true),
        (f32::NEG_INFINITY, true),
    ] {
        let mut weights = good.clone();
        let last = weights.len() - 4;
        weights[last..].copy_from_slice(&bits.to_le_bytes());
        card["weights_sha256"] = wcal_core::provenance::sha256_hex(&weights).into();
        fs::write(folder.join("model.safetensors"), &weights).unwrap();
        fs::write(folder.join("model.json"), card.to_string()).unwrap();
        let run = wcal(place.path(), &track);
        let said = String::from_utf8_lossy(&run.stderr);
        let named = ["model.safetensors", "norm.gamma", "finite"]
            .iter()
            .all(|word| said.contains(word));
        assert_eq!(
            (run.status.code() == Some(1), named),
            (found, found),
            "{said}"
        );
    }
}

#[test]
fn cameras_and_shapes_hold_only_numbers_that_pictures_can_have() {
    let place = tempfile::tempdir().unwrap();
    let fixture = fixture("pictured");
    // One pair is enough for the cameras.
    for side in ["left", "right"] {
        fs::create_dir(place.path().join(side)).unwrap();
        let name = format!("{side}/00001.png");
        fs::copy(
            fixture.join("pictures").join(&name),
            place.path().join(name),
        )
        .unwrap();
    }
    fs::copy(fixture.join("rig.toml"), place.path().join("rig.toml")).unwrap();
    let mut cameras = json(&read("fixtures/pictured/stereo.json"));
    // What says how the calibration went is carried along and not used.
    for key in ["covariance", "projection_sd_px", "per_view_rms_px"] {
        cameras[key] = json("[]");
    }
    judge_all(
        place.path(),
        &[
            Document::new(
                "cameras",
                "stereo.json",
                cameras,
                "stereo-shape left right --cameras stereo.json --rig rig.toml --out o",
            ),
            Document::new(
                "shapes",
                "shapes.json",
                shapes(),
                "fit-whisker shapes.json --rig rig.toml --out o",
            ),
        ],
    );
}

/// Three views of the nominal wire, free.
fn shapes() -> Value {
    let (straight_mm, radius_mm) = (30.0, 20.0);
    let point = |s_mm: f64| {
        let turn = (s_mm - straight_mm).max(0.0) / radius_mm;
        let x_mm = s_mm.min(straight_mm) + radius_mm * turn.sin();
        serde_json::json!([x_mm, 0.0, -radius_mm * (1.0 - turn.cos())])
    };
    let line: Vec<Value> = (0..=60).map(|s| point(f64::from(s))).collect();
    let error = |by_mm: f64| {
        let moved = vec![serde_json::json!([0.0, by_mm, 0.0]); 3];
        serde_json::json!({"centreline_mm": moved, "length_mm": 0.01})
    };
    let pair = |k: usize| {
        serde_json::json!({
            "name": format!("{k}"), "status": "ok", "centreline_mm": line, "centreline_sd_mm": vec![0.02; line.len()],
            "length_mm": 60.0, "length_sd_mm": 0.1,
            "groove": {
                "position_mm": point(40.0), "sd_mm": [0.02, 0.02, 0.02], "contact_arclength_mm": 40.0,
                "contact_arclength_sd_mm": 0.05, "axis": [1.0, 0.0, 0.0], "contact": "vertex", "contacts_mm": [40.0],
            },
            "errors": {
                "stations": [0, 30, 60], "stations_mm": [0.0, 30.0, 60.0], "own": [], "floor_mm": 0.0,
                "shared": [error(0.001), error(0.002)],
            },
        })
    };
    let format = wcal_core::shapes_document::SHAPES_FORMAT;
    serde_json::json!({
        "format": format, "pairs": [pair(1), pair(2), pair(3)],
        "shared_covariance": [[1.0, 0.1], [0.1, 1.0]],
    })
}
