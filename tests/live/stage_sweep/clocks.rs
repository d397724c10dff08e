//! An interrogator whose clock is set or stands still, or whose peak has no value: named for what
//! it is.

use super::safety::{cause, ended, finished};
use super::*;

fn reduced(bench: &Bench) -> (Option<i32>, String) {
    let run = program()
        .arg("reduce")
        .arg(bench.session())
        .output()
        .expect("wcal runs");
    (run.status.code(), text(&run.stderr))
}

#[test]
fn a_clock_step_is_called_a_clock_step_and_the_sweep_goes_on_later() {
    let mut bench = Bench::start("");
    let child = bench.begun_short();
    bench.type_fault("{\"kind\":\"clock-step\",\"seconds\":-3600}");
    let run = ended(child);
    let (kind, said, stopped) = cause(&run);
    assert!(
        kind == "clock" && said.contains("a clock step: 3600.0") && said.contains("back"),
        "{said}"
    );
    assert!(
        stopped && !text(&run.stderr).contains("fell behind"),
        "{}",
        text(&run.stderr)
    );
    let (code, said) = reduced(&bench);
    assert!(
        code == Some(3) && said.contains("a clock step") && !said.contains("fell behind"),
        "{said}"
    );
    // What was measured is kept, the rest is measured, and the step is still said.
    let run = bench.run_short("--resume");
    let sweep = document(&run);
    assert_eq!(
        (run.status.code(), &sweep["rows"]),
        (Some(3), &6.into()),
        "{sweep}"
    );
    assert!(
        sweep["warnings"].to_string().contains("a clock step"),
        "{sweep}"
    );
}

#[test]
fn a_clock_that_steps_ahead_or_stands_still_ends_the_sweep() {
    for (fault, word) in [
        (
            "{\"kind\":\"clock-step\",\"seconds\":3600}",
            "a clock step: 3600.0",
        ),
        ("{\"kind\":\"clock-stop\",\"on\":true}", "a stopped clock"),
    ] {
        let mut bench = Bench::start("");
        let child = bench.begun_short();
        bench.type_fault(fault);
        let run = ended(child);
        let (kind, said, stopped) = cause(&run);
        assert!(kind == "clock" && said.contains(word) && stopped, "{said}");
        assert!(
            !text(&run.stderr).contains("fell behind"),
            "{}",
            text(&run.stderr)
        );
        let (code, said) = reduced(&bench);
        assert!(
            code == Some(3) && said.contains(word) && !said.contains("fell behind"),
            "{said}"
        );
    }
}

#[test]
fn a_peak_without_a_value_marks_its_scan_and_does_not_end_a_sweep() {
    for driver in ["sm130", "hyperion"] {
        let mut bench = Bench::start("");
        let rig = std::fs::read_to_string(&bench.rig).expect("rig");
        assert!(rig.contains("driver = \"sm130\""), "{rig}");
        let own = rig.replace("driver = \"sm130\"", &format!("driver = \"{driver}\""));
        std::fs::write(&bench.rig, own).expect("written");
        let child = bench.begun_short();
        bench.type_fault("{\"kind\":\"nan-peak\",\"grating\":1,\"count\":3}");
        let run = ended(child);
        let sweep = document(&run);
        assert_eq!(
            (run.status.code(), &sweep["ending"]),
            (Some(3), &"finished".into()),
            "{sweep}"
        );
        assert!(sweep["warnings"].to_string().contains("3 scans"), "{sweep}");
        assert_eq!(
            (&sweep["rows"], &sweep["lost_scans"]),
            (&6.into(), &0.into()),
            "{sweep}"
        );
        // Control: without the fault nothing is said.
        std::fs::remove_dir_all(bench.session()).expect("removed");
        finished(&bench.run_short("--out"), 6);
    }
}
