//! The MJCF text: bodies nest, rest shape and stiffness are the rod's.
//! tests/peers/mujoco_statics.py loads it into MuJoCo itself.
#![allow(clippy::unwrap_used, reason = "a test that fails should say where")]

use nalgebra::Vector3;
use wcal_core::observation::WhiskerSpec;
use wcal_mujoco::mjcf::{MjcfOptions, mjcf};

fn whisker() -> WhiskerSpec {
    WhiskerSpec::nominal()
}

/// All numbers of an attribute, in order.
fn values(text: &str, element: &str, attribute: &str) -> Vec<Vec<f64>> {
    text.lines()
        .filter(|l| l.trim_start().starts_with(element))
        .filter_map(|l| {
            l.split(&format!(" {attribute}=\""))
                .nth(1)?
                .split('"')
                .next()
        })
        .map(|v| v.split(' ').map(|x| x.parse().unwrap()).collect())
        .collect()
}

#[test]
fn the_model_has_the_rods_stiffness_and_length() {
    let text = mjcf(
        &whisker(),
        &MjcfOptions {
            links: 30,
            ..MjcfOptions::default()
        },
    )
    .unwrap();
    assert_eq!(text.matches("<body ").count(), 31);
    assert_eq!(text.matches("</body>").count(), 31);
    let stiffness = values(&text, "<joint", "stiffness");
    assert_eq!(stiffness.len(), 90);
    let ei_nm2 = 75e9 * std::f64::consts::PI * 0.3e-3_f64.powi(4) / 64.0;
    // Springs in series: their compliances add up to L / EI.
    let compliance: f64 = stiffness
        .iter()
        .skip(1)
        .step_by(3)
        .map(|k| 1.0 / k[0])
        .sum();
    let half_link = 1e-3 / ei_nm2;
    assert!(
        (compliance + half_link - 0.06 / ei_nm2).abs() < 1e-9 / ei_nm2,
        "{compliance}"
    );
    // The rest turns: the arc's 1.5 rad but for the half link beyond the last joint.
    let turn: f64 = values(&text, "<body", "quat")
        .iter()
        .map(|q| 2.0 * q[2].atan2(q[0]))
        .sum();
    assert!((turn - (1.5 - 0.05)).abs() < 1e-6, "{turn}");
}

#[test]
fn the_clamp_goes_into_the_first_body_and_bad_options_are_named() {
    let options = MjcfOptions {
        root_offset_mm: Vector3::new(0.0, 0.5, -0.25),
        provenance: "wcal fit-whisker --json".to_owned(),
        ..MjcfOptions::default()
    };
    let text = mjcf(&whisker(), &options).unwrap();
    assert_eq!(
        values(&text, "<body name=\"link0\"", "pos")[0],
        [0.0, 0.0005, -0.00025]
    );
    assert!(
        text.contains("<!-- wcal fit-whisker - -json -->"),
        "two hyphens would end the comment"
    );
    let bad = MjcfOptions {
        step_s: 0.0,
        ..MjcfOptions::default()
    };
    let error = mjcf(&whisker(), &bad).unwrap_err().to_string();
    assert_eq!(error, "step_s: expected above 0, found 0");
}
