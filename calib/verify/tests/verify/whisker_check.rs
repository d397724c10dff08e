//! Ten later readings of a whisker against its calibration: SIMULATED, on the poses of
//! fixtures/practice/case-004 (no effect), readings drawn from the calibration itself.

use super::Noise;
use super::whisker_stages::{data, fitted, system};
use nalgebra::Vector3;
use std::sync::OnceLock;
use wcal_core::observation::{Role, WhiskerData};
use wcal_verify::MeasurementModel;
use wcal_verify::change::CalibrationCheck;
use wcal_verify::whisker::{PhysicalModel, WhiskerSystem};

/// Noise of a reading, pm.
const NOISE_PM: f64 = 0.4;
const DRAWS: u64 = 24;

/// The calibration, and ten poses of its session: one at rest, three along each of three directions.
fn calibrated() -> &'static (PhysicalModel, WhiskerData) {
    static CALIBRATED: OnceLock<(PhysicalModel, WhiskerData)> = OnceLock::new();
    CALIBRATED.get_or_init(|| {
        let mut data = data("practice/case-004");
        let whole = system(&data);
        let model = PhysicalModel::new(&whole, &fitted(&whole, &[]), NOISE_PM);
        let rest = data.rows.iter().position(|r| r.role == Role::Rest);
        let mut kept = vec![rest.unwrap()];
        for line in [1, 5, 9] {
            let settled = |i: &usize| {
                let r = &data.rows[*i];
                r.trajectory == Some(line) && r.role != Role::Rest && r.speed_mm_s == Some(0.0)
            };
            let on: Vec<usize> = (0..data.rows.len()).filter(settled).collect();
            kept.extend([on[2], on[5], on[8]]);
        }
        data.rows = kept.iter().map(|i| data.rows[*i].clone()).collect();
        (model, data)
    })
}

/// What a sensor of `coefficients` reads at the poses, with noise.
fn read(seed: u64, coefficients: &[[f64; 2]]) -> WhiskerData {
    let (_, poses) = calibrated();
    let system: WhiskerSystem = system(poses);
    let design = system.design(&[]).unwrap();
    let mut rng = Noise::new(700 + seed);
    let mut data = poses.clone();
    for (i, row) in system.path.rows.iter().enumerate() {
        let now = data.rows[*row].compensated_pm(&poses.fbg);
        for c in 0..2 {
            let truth: f64 = (0..3).map(|j| design[(i, j)] * coefficients[j][c]).sum();
            data.rows[*row].shift_pm[c] += truth + NOISE_PM * rng.next() - now[c];
        }
    }
    data
}

fn check(data: &WhiskerData) -> CalibrationCheck {
    calibrated().0.check_session(data).unwrap().unwrap()
}

/// The session says that its groove is where it is not: the groove moved by the opposite.
fn moved(mut data: WhiskerData, by: Vector3<f64>) -> WhiskerData {
    data.trajectories.iter_mut().for_each(|t| t.origin_mm -= by);
    data
}

/// Draws whose first name is `name`, alone or among those that cannot be told apart, and draws in
/// which only others are named.
fn counts(name: &str, drawn: &dyn Fn(u64) -> WhiskerData) -> [u64; 2] {
    let mut out = [0, 0];
    for seed in 0..DRAWS {
        let found = check(&drawn(seed));
        let Some(first) = found.changes.first() else {
            continue;
        };
        let among = first.name == name || first.or.iter().any(|or| or == name);
        out[usize::from(!among)] += 1;
    }
    println!(
        "{name}: named in {}, otherwise in {} of {DRAWS}",
        out[0], out[1]
    );
    out
}

#[test]
fn ten_readings_show_an_unchanged_whisker_and_name_what_changed() {
    let own = &calibrated().0.coefficients;
    let unchanged = (0..DRAWS).filter(|s| check(&read(*s, own)).changes.is_empty());
    let unchanged = unchanged.count() as u64;
    println!("unchanged: {unchanged} of {DRAWS}");
    assert!(unchanged >= DRAWS - 3, "{unchanged}");
    let first = check(&read(0, own));
    assert!(
        first.is_tested() && first.unit == "mm",
        "{:?}",
        first.tested
    );
    let sd = |name: &str| {
        first
            .tested
            .iter()
            .find(|t| t.name == name)
            .unwrap()
            .sd
            .unwrap()
    };

    let zero = 5.0 * sd("zero of grating 1");
    let gain = 1.0 + 5.0 * sd("gain of grating 2");
    let deep = 5.0 * sd("groove along the wire") * Vector3::x();
    let of_zero = |s| read(s, &[[own[0][0] + zero, own[0][1]], own[1], own[2]]);
    let of_gain = |s| {
        read(
            s,
            &[
                own[0],
                [own[1][0], gain * own[1][1]],
                [own[2][0], gain * own[2][1]],
            ],
        )
    };
    for [named, otherwise] in [
        counts("zero of grating 1", &of_zero),
        counts("gain of grating 2", &of_gain),
        counts("groove along the wire", &|s| moved(read(s, own), deep)),
    ] {
        assert!(named >= DRAWS - 3 && otherwise <= 1, "{named} {otherwise}");
    }
}

#[test]
fn a_large_displacement_has_its_size_and_another_sensor_has_no_certain_name() {
    let own = &calibrated().0.coefficients;
    // Far beyond where the shifts follow the groove linearly.
    let found = check(&moved(read(1, own), Vector3::new(2.0, 0.0, 0.0)));
    let along = &found.changes[0];
    assert_eq!(along.name, "groove along the wire", "{:?}", found.changes);
    assert!((along.value - 2.0).abs() < 0.1, "{along:?}");
    // Moments see a displacement along the wire as a shorter one across it.
    assert!((0.3..2.1).contains(&along.cost), "{along:?}");
    // Control: gratings that exchanged their axes are none of these changes.
    let exchanged = read(1, &[own[0], own[2], own[1]]);
    let found = check(&exchanged);
    let certain =
        |c: &&wcal_verify::change::CalibrationChange| c.or.is_empty() && c.name != "scatter";
    assert!(!found.changes.is_empty(), "{found:?}");
    assert_eq!(
        found.changes.iter().filter(certain).count(),
        0,
        "{:?}",
        found.changes
    );
}

#[test]
fn too_few_readings_say_how_many_are_needed() {
    let own = &calibrated().0.coefficients;
    let mut few = read(3, own);
    few.rows.truncate(2);
    let found = check(&few);
    assert!(!found.is_tested(), "{:?}", found.tested);
    let zero = found.tested.iter().find(|t| t.name == "zero of grating 1");
    let needed = zero.and_then(|t| t.readings_needed).unwrap();
    assert!((3..=20).contains(&needed), "{zero:?}");
}
