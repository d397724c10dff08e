//! Sweeps over stretched copies (SIMULATED) follow the split of the objects that they are copies of.

use wcal_core::observation::WhiskerSpec;
use wcal_mujoco::{Dataset, SweepEngine, SweepPlan, objects};
use wcal_track::course::read_courses;

#[test]
fn a_copy_is_read_where_its_object_is_asked_for_and_not_where_it_is_not() {
    let folder = tempfile::tempdir().unwrap();
    let dataset = Dataset {
        engine: SweepEngine::Rod,
        whisker: WhiskerSpec::nominal(),
        plan: SweepPlan { rate_hz: 10.0, most_mm: 20.0, ..SweepPlan::default() },
        objects: ["ball~1", "can~1", "can~2", "can"].map(|n| objects::named(n, None).unwrap()).into(),
        sweeps: 2,
        seed: 4,
        share: [0, 1],
    };
    dataset.make(folder.path(), |_, _| {}).unwrap();
    let names = |asked: &[&str]| {
        let asked: Vec<String> = asked.iter().map(|n| (*n).to_owned()).collect();
        let mut found: Vec<String> = read_courses(folder.path(), &asked).unwrap().into_keys().collect();
        found.sort();
        found
    };
    assert_eq!(names(&["can"]), ["can", "can~1", "can~2"]);
    assert_eq!(names(&["can~2"]), ["can~2"]);
    assert_eq!(names(&["ball"]), ["ball~1"]);
}
