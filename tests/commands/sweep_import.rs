//! A record in the layout of the WhiskerFBG release (SIMULATED, made by the rod engine): made into
//! tables by the script of the fixture, imported as a sweep, tracked and scored against the mesh.

use crate::support::{text, wcal};
use nalgebra::{Matrix3, UnitQuaternion, Vector3};
use std::fmt::Write as _;
use std::path::Path;
use wcal_core::observation::WhiskerSpec;
use wcal_lab::SweepSeries;
use wcal_lab::generate_sweeps::{SweepRequest, generate_sweeps};
use wcal_lab_sweeps::{SweepPlan, objects};
use wcal_mesh::Mesh;

/// Shifts by moments, nm/(N mm).
const K: [[f64; 2]; 2] = [[0.20, 0.03], [-0.02, 0.18]];
const RATE_HZ: f64 = 2000.0;
/// Frame of the release by that of the program: x, y, z become y, z, x.
const RELEASE: Matrix3<f64> = Matrix3::new(0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0);
/// Samples before the sweep: longer than the zero of the release.
const LEAD: usize = 4000;

fn shifts(m: [f64; 2]) -> [f64; 2] {
    [0, 1].map(|c| K[c][0] * m[0] + K[c][1] * m[1])
}

/// A session whose map is K, for `fit-gpr`.
fn calibration(folder: &Path) -> String {
    let session = folder.join("session");
    std::fs::create_dir_all(&session).unwrap();
    let (mut points, mut twin) = (
        "point,role,trajectory,replicate,stage_mm,groove_x_mm,groove_y_mm,groove_z_mm,fbg_1_shift_nm,fbg_2_shift_nm\n".to_owned(),
        "point,moment_1_nmm,moment_2_nmm\n".to_owned(),
    );
    for k in 0..49 {
        let m = [k % 7, k / 7].map(|i| 0.5 * (f64::from(i) - 3.0));
        let [a, b] = shifts(m);
        let stage = 0.1 * f64::from(k);
        writeln!(points, "{k},calibration,1,1,{stage},30,0,{stage},{a},{b}").unwrap();
        writeln!(twin, "{k},{},{}", m[0], m[1]).unwrap();
    }
    std::fs::write(session.join("points.csv"), points).unwrap();
    std::fs::write(session.join("twin.csv"), twin).unwrap();
    // The wire as points, in the frame of the release: along +y, the base goes along +x.
    let mut shape = "x_mm,y_mm,z_mm\n".to_owned();
    for p in WhiskerSpec::nominal().rest_shape.points(0.5) {
        let p = RELEASE * p;
        writeln!(shape, "{},{},{}", p.x, p.y, p.z).unwrap();
    }
    std::fs::write(session.join("rest_shape.csv"), shape).unwrap();
    let description = "format = \"wcal-session/1\"\nid = \"exact-map\"\nkind = \"whisker\"\nmedium = \"air\"\n\
        [files]\npoints = \"points.csv\"\ntwin = \"twin.csv\"\nrest_shape = \"rest_shape.csv\"\n\
        [whisker]\ndiameter_mm = 0.3\nyoungs_gpa = 75.0\nshear_gpa = 28.2\n\
        [moments]\naxes = [[0.0, 0.0, 1.0], [1.0, 0.0, 0.0]]\nsign = 1.0\n\
        [fbg]\ntemperature_compensated = true\n\
        [[trajectory]]\nid = 1\norigin_mm = [30.0, 0.0, 0.0]\ndirection = [0.0, 0.0, 1.0]\n[provenance]\nsimulated = true\n";
    std::fs::write(session.join("session.toml"), description).unwrap();
    let out = folder.join("fit");
    let run = wcal(&[
        "fit-gpr",
        session.to_str().unwrap(),
        "--out",
        out.to_str().unwrap(),
    ]);
    assert!(
        run.status.code().is_some_and(|c| c == 0 || c == 3),
        "{}",
        text(&run.stderr)
    );
    out.join("calibration.json").to_str().unwrap().to_owned()
}

/// A mesh as binary STL in metres, as the release has it.
fn stl(mesh: &Mesh) -> Vec<u8> {
    let points: Vec<_> = mesh.points().collect();
    let mut bytes = vec![0_u8; 80];
    bytes.extend((mesh.triangles().len() as u32).to_le_bytes());
    for t in mesh.triangles() {
        bytes.extend([0_u8; 12]);
        for corner in t {
            bytes.extend(
                points[*corner as usize]
                    .iter()
                    .flat_map(|x| ((x * 1e-3) as f32).to_le_bytes()),
            );
        }
        bytes.extend([0_u8; 2]);
    }
    bytes
}

/// The release's two tables of a sweep: `sign` of the moments.
fn record(series: &SweepSeries, sign: f64) -> (String, String) {
    let first_s = series.samples[0].t_s;
    let last_s = series.samples[series.samples.len() - 1].t_s;
    let at = |t_s: f64| {
        let after = series
            .samples
            .partition_point(|s| s.t_s < t_s)
            .clamp(1, series.samples.len() - 1);
        let (a, b) = (&series.samples[after - 1], &series.samples[after]);
        let u = ((t_s - a.t_s) / (b.t_s - a.t_s)).clamp(0.0, 1.0);
        let mix = |x: f64, y: f64| x + (y - x) * u;
        let m = [0, 1].map(|k| mix(a.moment_nmm[k], b.moment_nmm[k]));
        (m, mix(a.travel_mm, b.travel_mm))
    };
    let samples = LEAD + ((last_s - first_s) * RATE_HZ) as usize;
    let (mut optic, mut action) = ("fbg_2,fbg_4,fbg_6\n".to_owned(), ",py,ind\n".to_owned());
    for i in 0..samples {
        let (m, travel_mm) = at(first_s + (i as f64 - LEAD as f64) / RATE_HZ);
        let [a, b] = shifts(m.map(|m| sign * m));
        // The laboratory warms up: 20 pm over the record.
        let warm = 0.02 * i as f64 / samples as f64;
        writeln!(
            optic,
            "{:.7},{:.7},{:.7}",
            1545.0 + warm + a,
            1542.0 + warm,
            1543.0 + warm + b
        )
        .unwrap();
        if i >= LEAD - 1000 && i.is_multiple_of(200) {
            writeln!(action, "{},{:.9},{i}", i / 200, 1e-3 * (travel_mm - 107.0)).unwrap();
        }
    }
    (optic, action)
}

/// The fixture's script.
fn as_tables(optic: &str, action: &str, out: &Path) -> std::process::Output {
    let script = concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/fixtures/whiskerfbg_bottle/release_layout.py"
    );
    std::process::Command::new("python3")
        .arg(script)
        .args([optic, action])
        .arg(out)
        .output()
        .unwrap()
}

#[test]
fn a_sweep_in_the_release_s_layout_is_tracked_and_scored_against_its_mesh() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let calibration = calibration(folder.path());
    let mesh = objects::built_in("can").unwrap();
    let plan = SweepPlan {
        rate_hz: 20.0,
        ..SweepPlan::default()
    };
    let request = SweepRequest {
        whisker: &WhiskerSpec::nominal(),
        plan: &plan,
        seed: 7,
        sweeps: 1,
    };
    let series = generate_sweeps(&mesh, &request).unwrap();
    std::fs::write(path("can.stl"), stl(&mesh)).unwrap();
    let model = concat!(env!("CARGO_MANIFEST_DIR"), "/fixtures/tracker");

    // The base has gone 107 mm less at the same travel: so has the object in the frame that the
    // base moves in.
    let at_start = &series[0].base_from_object;
    let t = at_start.translation.vector;
    let t = RELEASE * Vector3::new(t.x, t.y, t.z - 107.0);
    let q = (UnitQuaternion::from_matrix(&RELEASE) * at_start.rotation).coords;
    let pose = format!("{},{},{},{},{},{},{}", t.x, t.y, t.z, q.w, q.x, q.y, q.z);
    let by_motion = std::cell::RefCell::new(Vec::new());
    let score = |name: &str, sign: f64| -> serde_json::Value {
        let (optic, action) = record(&series[0], sign);
        let files = ["optic", "action"].map(|f| path(&format!("{name}-{f}.csv")));
        std::fs::write(&files[0], optic).unwrap();
        std::fs::write(&files[1], action).unwrap();
        let (session, out) = (path(name), path(&format!("{name}-track.csv")));
        assert!(
            as_tables(&files[0], &files[1], folder.path())
                .status
                .success()
        );
        std::fs::write(path("SIMULATED"), "").unwrap();
        let run = wcal(&[
            "import",
            &path("readings.csv"),
            "--kind",
            "sweep",
            "--motion",
            &path("base.csv"),
            "--object",
            &path("can.stl"),
            "--object-pose",
            &pose,
            "--json",
            "--out",
            &session,
        ]);
        assert_eq!(run.status.code(), Some(0), "{}", text(&run.stderr));
        assert!(
            text(&run.stderr).contains("metres"),
            "{}",
            text(&run.stderr)
        );
        let document: serde_json::Value = serde_json::from_slice(&run.stdout).unwrap();
        assert_eq!(
            (&document["kind"], &document["simulated"]),
            (&"sweep".into(), &true.into())
        );
        let run = wcal(&[
            "track",
            &session,
            "--calibration",
            &calibration,
            "--model",
            model,
            "--force",
            "--out",
            &out,
            "--json",
        ]);
        assert!(
            run.status.code().is_some_and(|c| c != 1),
            "{}",
            text(&run.stderr)
        );
        println!("{name}: {}", text(&run.stderr));
        let summary: serde_json::Value = serde_json::from_slice(&run.stdout).unwrap();
        assert_eq!(summary["simulated"], true);
        // Without a network: physics, along the arm's log.
        let physics = path(&format!("{name}-physics.csv"));
        let run = wcal(&[
            "track",
            &session,
            "--calibration",
            &calibration,
            "--force",
            "--out",
            &physics,
            "--json",
        ]);
        assert!(
            run.status.code().is_some_and(|c| c != 1),
            "{}",
            text(&run.stderr)
        );
        println!("{name}, without a network: {}", text(&run.stderr));
        let by_physics: serde_json::Value = serde_json::from_slice(&run.stdout).unwrap();
        by_motion.borrow_mut().push(by_physics);
        summary["object"].clone()
    };
    let right = score("right", 1.0);
    let of = |s: &serde_json::Value, key: &str| s[key].as_f64().unwrap();
    assert!(of(&right, "points") > 20.0, "{right}");
    // 0.3 mm of it is the tracker's on clean sweeps; the mean of 300 samples rounds the onset.
    assert!(of(&right, "rmse_mm") < 1.5, "{right}");
    // Control: moments of the other sign are no sweep over this object.
    let wrong = score("wrong", -1.0);
    assert!(
        wrong.is_null() || of(&wrong, "rmse_mm") > 3.0 * of(&right, "rmse_mm"),
        "{right} {wrong}"
    );
    {
        // Without a network: the contact slides over the can, and the motion predicts its moments;
        // with the other sign it does not.
        let of = by_motion.borrow();
        let slides = |d: &serde_json::Value| {
            d["contacts"]
                .as_array()
                .unwrap()
                .iter()
                .any(|c| c["contact"] == "sliding")
        };
        assert!(
            slides(&of[0]) && !slides(&of[1]),
            "{} {}",
            of[0]["contacts"],
            of[1]["contacts"]
        );
        assert!(
            of[0]["object"]["rmse_mm"].as_f64().unwrap() < 1.5,
            "{}",
            of[0]["object"]
        );
    }
}

#[test]
fn what_is_no_such_record_is_named_and_nothing_is_written() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let row = "1545,1542,1543\n";
    let optic = |rows: usize| format!("fbg_2,fbg_4,fbg_6\n{}", row.repeat(rows));
    let way = |unit: f64| {
        (0..4)
            .map(|k| {
                format!(
                    "{},{}\n",
                    unit * (0.1 + 0.01 * f64::from(k)),
                    25_100 + 100 * k
                )
            })
            .collect::<String>()
    };
    for (rows, metre, said) in [
        (1, 1.0, "1700 samples"),
        (26_000, 1e3, "metres"),
        (26_000, 1.0, ""),
    ] {
        std::fs::write(path("optic.csv"), optic(rows)).unwrap();
        std::fs::write(path("action.csv"), format!("py,ind\n{}", way(metre))).unwrap();
        let run = as_tables(
            &path("optic.csv"),
            &path("action.csv"),
            &folder.path().join("out"),
        );
        assert_eq!(
            run.status.success(),
            said.is_empty(),
            "{}",
            text(&run.stderr)
        );
        assert!(text(&run.stderr).contains(said), "{}", text(&run.stderr));
        assert_eq!(folder.path().join("out").exists(), said.is_empty());
    }
}
