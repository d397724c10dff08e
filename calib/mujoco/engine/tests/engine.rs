//! MuJoCo itself, through the program (SIMULATED). Without libmujoco (`make setup`) only what is
//! then said is tested, and CI fails.
#![allow(
    clippy::unwrap_used,
    clippy::print_stderr,
    reason = "a test that fails should say where"
)]

#[path = "../../../../tests/support/not_run.rs"]
mod not_run;

use nalgebra::Vector3;
use not_run::not_run;
use std::io::{BufRead, BufReader, Write};
use std::process::{Command, Stdio};
use wcal_core::observation::{RestShape, WhiskerSpec};
use wcal_lab_sweeps::CableEngine;
use wcal_lab_sweeps::convex::Convex;
use wcal_lab_sweeps::physics::{Medium, PhysicsPlan};
use wcal_lab_sweeps::rod_engine::LINKS;
use wcal_lab_sweeps::{RodEngine, Sweep, SweepPlan, Verdict, objects};
use wcal_mujoco::MujocoEngine;
use wcal_mujoco::compare::statics;
use wcal_mujoco::dynamics::{Parameters, Targets, fit_dynamics, record};
use wcal_mujoco::engine::protocol::Request;
use wcal_mujoco::groove::Preset;
use wcal_mujoco::labels::labels;
use wcal_mujoco::mjcf::MjcfOptions;

fn whisker() -> WhiskerSpec {
    WhiskerSpec::nominal()
}

/// Points the library at the program that cargo built; false without MuJoCo in it.
fn ready() -> bool {
    use std::sync::OnceLock;
    static READY: OnceLock<bool> = OnceLock::new();
    *READY.get_or_init(|| {
        // Tests stand in deps/, the program one folder up: the library looks there.
        match MujocoEngine::start() {
            Ok(engine) => {
                assert_eq!(engine.version, "3.17.0");
                true
            }
            Err(e) => {
                assert!(e.to_string().contains("built without libmujoco"), "{e}");
                not_run(e);
                false
            }
        }
    })
}

#[test]
fn statics_tend_to_the_rods_with_second_order() {
    if !ready() {
        return;
    }
    let mut engine = MujocoEngine::start().unwrap();
    let options = MjcfOptions {
        damping_s: 5e-3,
        armature_s2: 1e-6,
        ..MjcfOptions::default()
    };
    let [coarse, fine] = [20, 40].map(|links| {
        statics(
            &mut engine,
            &whisker(),
            &MjcfOptions {
                links,
                ..options.clone()
            },
        )
        .unwrap()
    });
    assert!(fine.moment_error < 5e-3, "{fine:?}");
    let order = (coarse.point_error / fine.point_error).log2();
    assert!(order > 1.8, "{coarse:?} {fine:?}");
    // Negative control: five links are too few for that bound.
    let few = statics(
        &mut engine,
        &whisker(),
        &MjcfOptions {
            links: 5,
            ..options
        },
    )
    .unwrap();
    assert!(few.moment_error > 5e-3, "{few:?}");
}

#[test]
fn a_released_label_is_reproduced_and_one_whose_wire_still_swings_is_told() {
    if !ready() {
        return;
    }
    let folder =
        std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../fixtures/whiskerfbg");
    let rows = |name: &str| -> Vec<Vec<f64>> {
        let text = std::fs::read_to_string(folder.join(name)).unwrap();
        text.lines()
            .skip(1)
            .map(|l| {
                l.split(',')
                    .map(|x| x.parse().unwrap_or(f64::NAN))
                    .collect()
            })
            .collect()
    };
    let shape = rows("rest_shape.csv")
        .iter()
        .map(|p| Vector3::new(p[0], p[1], p[2]))
        .collect();
    let whisker = WhiskerSpec {
        diameter_mm: 0.3048,
        youngs_gpa: 75.0,
        shear_gpa: 28.0,
        density_kg_m3: Some(6450.0),
        rest_shape: RestShape::Polyline(shape),
        gravity_direction: None,
    };
    let points = rows("points.csv");
    let place = |k: usize| Vector3::new(points[k][5], points[k][6], points[k][7]);
    // Columns: point, role, trajectory, replicate, stage, groove x, y, z.
    let found = labels(
        &whisker,
        Preset::Released,
        &[vec![place(9), place(11)]],
        &|| {},
    )
    .unwrap();
    let known = rows("twin.csv");
    let [sure, unsure] = &found[0][..] else {
        panic!("{found:?}")
    };
    let [sure_nmm, unsure_nmm] = [sure, unsure].map(|l| l.moment_nmm.unwrap());
    // 1e-3 of the labels' own span. The twin reports minus (position x force).
    for (axis, column) in [(0, 1), (2, 2)] {
        assert!(
            (-sure_nmm[axis] - known[9][column]).abs() < 3e-3,
            "{sure:?}"
        );
    }
    assert!(sure.certain() && !sure.chatters, "{sure:?}");
    // Without the labels: the wire swings, and straight from the start it comes free.
    assert!(
        !unsure.certain() && unsure.elsewhere.is_some(),
        "{unsure:?}"
    );
    // Negative control: its label is missed.
    assert!((-unsure_nmm.x - known[11][1]).abs() > 3e-3, "{unsure:?}");
}

#[test]
fn a_sweep_agrees_with_the_rods_and_its_labels_lie_on_the_mesh() {
    if !ready() {
        return;
    }
    let mesh = objects::built_in("block").unwrap();
    let folder = tempfile::tempdir().unwrap();
    let convex = Convex::of(&mesh, folder.path()).unwrap();
    assert!(
        convex.parts.len() == 1 && convex.hausdorff_mm() < 0.01,
        "{convex:?}"
    );
    assert_eq!(
        Convex::of(&mesh, folder.path()).unwrap(),
        convex,
        "taken from the folder"
    );
    let plan = SweepPlan {
        speed_mm_s: [6.0, 6.0],
        max_travel_mm: 25.0,
        rate_hz: 2.0,
        ..SweepPlan::default()
    };
    let (rod, parts) = (RodEngine::new(&whisker(), LINKS).unwrap(), convex.corners());
    let mut cable = CableEngine::start(&whisker(), &MjcfOptions::default()).unwrap();
    let sweep = (0..).find_map(|k| {
        let sweep = Sweep::draw(&mesh, &plan, 5, k, rod.reach_mm())?;
        let run = rod.run(&mesh, &sweep, &plan);
        let touching = run
            .samples
            .iter()
            .filter(|s| s.contacts.first().is_some_and(|c| c.arclength_mm < 50.0))
            .count();
        (run.verdict == Verdict::Kept && touching > 4).then_some((sweep, run))
    });
    let (sweep, quasi) = sweep.unwrap();
    let dynamic = cable.run(&mesh, &parts, &sweep, &plan).unwrap();
    assert_eq!(dynamic.verdict, Verdict::Kept);
    let (mut off, mut size, mut pairs) = (0.0, 0.0, 0);
    for (a, b) in quasi.samples.iter().zip(&dynamic.samples) {
        for contact in &b.contacts {
            let shift = sweep.shift_mm - Vector3::z() * b.travel_mm;
            let label = sweep.turn.tr_mul(&(contact.point_mm - shift));
            assert!(mesh.closest_point(&label, 10.0).unwrap().distance_mm.abs() < 1e-6);
        }
        if !a.contacts.is_empty() && !b.contacts.is_empty() {
            off += (a.moment_nmm - b.moment_nmm).norm_squared();
            size += a.moment_nmm.norm_squared();
            pairs += 1;
        }
    }
    assert!(
        pairs > 4 && off < 0.1_f64.powi(2) * size,
        "{pairs} samples, {} of {}",
        off.sqrt(),
        size.sqrt()
    );
    assert_eq!(
        cable.run(&mesh, &parts, &sweep, &plan).unwrap(),
        dynamic,
        "the same twice"
    );
    // A step of a tenth of a second without damping cannot be right: named, and the engine goes on.
    let wild = MjcfOptions {
        step_s: 0.02,
        damping_s: 0.0,
        armature_s2: 1e-9,
        ..MjcfOptions::default()
    };
    let mut wild = CableEngine::start(&whisker(), &wild).unwrap();
    let run = wild.run(&mesh, &parts, &sweep, &plan).unwrap();
    assert!(
        matches!(
            run.verdict,
            Verdict::Rejected("unstable" | "penetration" | "torque-too-high")
        ),
        "{:?}",
        run.verdict
    );
}

/// What is recorded of a wire tells its damping (SIMULATED record): ring-down and speed bias grow
/// with it.
#[test]
fn ring_down_and_speed_bias_grow_with_the_damping() {
    if !ready() {
        return;
    }
    let of = |damping_nms_rad: f64| {
        let parameters = Parameters {
            damping_nms_rad,
            width_mm: 1.0,
            d0: 0.95,
            dmax: 1.0,
        };
        record(&whisker(), &parameters).unwrap()
    };
    let [slack, stiff] = [0.005, 0.015].map(of);
    let ring_down = |t: &Targets| t.ring_down_s.unwrap();
    // Watched for 0.6 s: a longer ring-down is cut short there.
    assert!(
        ring_down(&stiff) > 1.2 * ring_down(&slack),
        "{slack:?} {stiff:?}"
    );
    assert!(stiff.bias > slack.bias + 0.1, "{slack:?} {stiff:?}");
    // Negative control: the same wire twice is the same record.
    assert_eq!(of(0.005), slack);
}

/// A known wire is fitted to its own record, its damping between two of the grid's steps and its
/// contact far from the one that the search starts from: what the fit says is determined comes back
/// to a step of the grid, the rest is named.
fn the_fit_finds(damping_nms_rad: f64) {
    if !ready() {
        return;
    }
    let known = Parameters {
        damping_nms_rad,
        width_mm: 4.0,
        d0: 0.93,
        dmax: 0.99,
    };
    let fit = fit_dynamics(&whisker(), record(&whisker(), &known).unwrap(), 10, |_| {}).unwrap();
    let (p, loose) = (
        &fit.trials[fit.best].parameters,
        fit.sensitivity.undetermined(),
    );
    eprintln!("{p:?} {:?}; not determined: {loose:?}", fit.sensitivity);
    for (name, off, step, sd) in [
        (
            "damping",
            p.damping_nms_rad - known.damping_nms_rad,
            0.005,
            0,
        ),
        ("width", p.width_mm - known.width_mm, 1.0, 1),
        ("d0", p.d0 - known.d0, 0.05, 2),
        ("dmax", p.dmax - known.dmax, 0.05, 3),
    ] {
        // Two standard deviations, and no less than the step to which it is said to be determined.
        let within = step * (2.0 * fit.sensitivity.together_steps[sd]).max(1.0);
        assert!(off.abs() < within, "{name}: {p:?} {:?}", fit.sensitivity);
    }
    // Nearer than the grid alone comes, which is off by 0.0015 and more.
    assert!(
        (p.damping_nms_rad - known.damping_nms_rad).abs() < 0.0014,
        "{p:?}"
    );
    assert!(
        !loose.contains(&"damping") && loose.len() < 4,
        "negative control: {loose:?}"
    );
}

// Between the grid's steps, on both sides of its second one; at once, each on a core.
#[test]
fn the_fit_of_a_weak_damping_and_contact_finds_what_it_says_it_can() {
    the_fit_finds(0.0035);
}

#[test]
fn the_fit_of_a_strong_damping_and_contact_finds_what_it_says_it_can() {
    the_fit_finds(0.0078);
}

/// Weight, buoyancy and drag reach the base of MuJoCo's wire as they reach the rod's.
#[test]
fn the_medium_bends_mujocos_wire_as_it_bends_the_rod() {
    if !ready() {
        return;
    }
    let mesh = objects::built_in("block").unwrap();
    let convex = Convex::of(&mesh, tempfile::tempdir().unwrap().path()).unwrap();
    let rod = RodEngine::new(&whisker(), LINKS).unwrap();
    let mut cable = CableEngine::start(&whisker(), &MjcfOptions::default()).unwrap();
    let mut run = |physics: PhysicsPlan, speed: f64| {
        // The lead is long: the first samples are of the free wire.
        let plan = SweepPlan {
            speed_mm_s: [speed; 2],
            lead_mm: [speed * 2.0; 2],
            max_travel_mm: speed * 1.4,
            rate_hz: 2.0,
            physics,
            ..SweepPlan::default()
        };
        let sweep = (0..)
            .find_map(|k| Sweep::draw(&mesh, &plan, 5, k, rod.reach_mm()))
            .unwrap();
        let both = [
            rod.run(&mesh, &sweep, &plan),
            cable.run(&mesh, &convex.corners(), &sweep, &plan).unwrap(),
        ];
        both.map(|r| r.samples.last().unwrap().moment_nmm)
    };
    let heavy = PhysicsPlan {
        medium: Medium::Water,
        weight: true,
        ..PhysicsPlan::default()
    };
    let [quasi, dynamic] = run(heavy, 5.0);
    assert!(
        quasi.norm() > 2e-3 && (quasi - dynamic).norm() < 0.02 * quasi.norm(),
        "{quasi} {dynamic}"
    );
    let stream = PhysicsPlan {
        medium: Medium::Water,
        current_mm_s: [60.0; 2],
        ..PhysicsPlan::default()
    };
    let [quasi, dynamic] = run(stream, 100.0);
    assert!(
        quasi.norm() > 1e-3 && (quasi - dynamic).norm() < 0.03 * quasi.norm(),
        "{quasi} {dynamic}"
    );
    // Negative control: without a medium neither bends.
    let [quasi, dynamic] = run(PhysicsPlan::default(), 5.0);
    assert!(
        quasi.norm() < 1e-6 && dynamic.norm() < 2e-4,
        "{quasi} {dynamic}"
    );
}

#[test]
fn what_is_missing_is_named() {
    if !ready() {
        return;
    }
    let mut engine = MujocoEngine::start().unwrap();
    let error = engine
        .load("<mujoco><nonsense/></mujoco>", false)
        .unwrap_err()
        .to_string();
    assert!(
        error.contains("MuJoCo refuses the model") && error.contains("nonsense"),
        "{error}"
    );
    let error = engine
        .frame(&Request::Run { steps: 1 })
        .unwrap_err()
        .to_string();
    assert!(
        error.contains("expected a model to be loaded first"),
        "{error}"
    );
    // Still alive.
    engine.load("<mujoco/>", false).unwrap();
    // Without the plugin's file MuJoCo would end the process.
    let ask = |request: &str| ask(&[("WCAL_NATIVE", "/nonexistent")], request);
    let line = ask(r#"{"do":"load","xml":"<mujoco/>","cable_plugin":true}"#);
    assert!(
        line.contains("cable plugin: expected /nonexistent"),
        "{line}"
    );
    let line = ask(
        r#"{"do":"decompose","points":[],"triangles":[],"threshold":0.05,"most_parts":1,"seed":1}"#,
    );
    assert!(line.contains("CoACD: expected /nonexistent"), "{line}");
}

/// What the program answers to one request in this environment.
fn ask(environment: &[(&str, &str)], request: &str) -> String {
    let mut program = Command::new(env!("CARGO_BIN_EXE_wcal-mujoco"));
    answer(program.envs(environment.iter().copied()), request)
}

/// The first line that a program answers to one request.
fn answer(program: &mut Command, request: &str) -> String {
    let mut child = program
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    writeln!(child.stdin.take().unwrap(), "{request}").unwrap();
    let mut line = String::new();
    BufReader::new(child.stdout.take().unwrap())
        .read_line(&mut line)
        .unwrap();
    child.wait().unwrap();
    line
}

/// Copies the files below a folder.
fn copy(from: &std::path::Path, to: &std::path::Path) {
    std::fs::create_dir_all(to).unwrap();
    for entry in std::fs::read_dir(from).unwrap().map(Result::unwrap) {
        let (from, to) = (entry.path(), to.join(entry.file_name()));
        if from.is_dir() {
            copy(&from, &to)
        } else {
            assert!(std::fs::copy(from, to).is_ok())
        }
    }
}

/// The folder of WCAL_NATIVE may be anybody's: a library with one other byte is named and not
/// loaded.
#[test]
fn a_library_that_is_not_the_expected_one_is_not_loaded() {
    if !ready() {
        return;
    }
    let place = tempfile::tempdir().unwrap();
    let native = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../native");
    copy(&native, place.path());
    let folder = place.path().to_str().unwrap();
    const TETRAHEDRON: &str = r#"{"do":"decompose","points":[[0,0,0],[9,0,0],[0,9,0],[0,0,9]],"triangles":[[0,2,1],[0,1,3],[0,3,2],[1,2,3]],"threshold":0.05,"most_parts":1,"seed":1}"#;
    const CABLE: &str = r#"{"do":"load","xml":"<mujoco/>","cable_plugin":true}"#;
    let asked = |request: &str| ask(&[("WCAL_NATIVE", folder)], request);
    assert!(
        asked(TETRAHEDRON).contains("parts"),
        "negative control: {}",
        asked(TETRAHEDRON)
    );
    assert!(
        asked(CABLE).contains("loaded-model"),
        "negative control: {}",
        asked(CABLE)
    );
    for (library, request) in [
        ("coacd/coacd/lib_coacd.so", TETRAHEDRON),
        ("coacd/coacd.libs/libgomp-a34b3233.so.1.0.0", TETRAHEDRON),
        ("mujoco/plugin/libelasticity.so", CABLE),
    ] {
        let path = place.path().join(library);
        let whole = std::fs::read(&path).unwrap();
        // Behind the end a byte changes nothing of what the library does.
        std::fs::write(&path, [&whole[..], &[0]].concat()).unwrap();
        let line = asked(request);
        assert!(
            line.contains("SHA-256") && line.contains(library),
            "{library}: {line}"
        );
        std::fs::write(&path, whole).unwrap();
    }
    // MuJoCo itself is loaded with the program: another one is asked nothing.
    let mujoco = place.path().join("mujoco");
    let path = mujoco.join("libmujoco.so.3.17.0");
    let instead = |request: &str| ask(&[("LD_LIBRARY_PATH", mujoco.to_str().unwrap())], request);
    assert!(
        instead(r#"{"do":"hello"}"#).contains("3.17.0"),
        "negative control"
    );
    let whole = std::fs::read(&path).unwrap();
    std::fs::write(&path, [&whole[..], &[0]].concat()).unwrap();
    let line = instead(r#"{"do":"hello"}"#);
    assert!(
        line.contains("SHA-256") && line.contains("libmujoco"),
        "{line}"
    );
}

/// An installed program takes the libraries of `lib/wcal` beside its own folder, checked as ever.
#[test]
fn an_installed_program_takes_the_libraries_beside_it() {
    if !ready() {
        return;
    }
    let place = tempfile::tempdir_in(env!("CARGO_TARGET_TMPDIR")).unwrap();
    let [bin, lib] = ["bin", "lib/wcal"].map(|folder| place.path().join(folder));
    let native = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../native");
    copy(&native, &lib);
    std::fs::create_dir(&bin).unwrap();
    let program = bin.join("wcal-mujoco");
    // A copy may still be open for writing in a child of another test.
    std::fs::hard_link(env!("CARGO_BIN_EXE_wcal-mujoco"), &program).unwrap();
    const CABLE: &str = r#"{"do":"load","xml":"<mujoco/>","cable_plugin":true}"#;
    let asked = || answer(&mut Command::new(&program), CABLE);
    assert!(asked().contains("loaded-model"), "{}", asked());
    // Negative control: what the folder lacks is not taken from the one of the build.
    std::fs::remove_file(lib.join("mujoco/plugin/libelasticity.so")).unwrap();
    assert!(
        asked().contains("lib/wcal/mujoco/plugin/libelasticity.so, found none"),
        "{}",
        asked()
    );
}
