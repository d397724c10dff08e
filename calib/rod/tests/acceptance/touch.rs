//! First touch: the first approach along the travel, on the measured bent wire whose paths cross it
//! twice.

use crate::{bent, spec};
use nalgebra::Vector3;
use wcal_core::observation::RestShape;
use wcal_rod::{Line, Outcome, Rod};

fn fixture(name: &str) -> String {
    let path = format!(
        "{}/../../fixtures/whiskerfbg/{name}",
        env!("CARGO_MANIFEST_DIR")
    );
    std::fs::read_to_string(path).unwrap()
}

fn triple(text: &str) -> Vector3<f64> {
    let numbers: Vec<f64> = text.split(',').map(|n| n.trim().parse().unwrap()).collect();
    Vector3::from_column_slice(&numbers)
}

fn measured_wire() -> Rod {
    let points = fixture("rest_shape.csv")
        .lines()
        .skip(1)
        .map(triple)
        .collect();
    let mut wire = spec(RestShape::Polyline(points));
    wire.diameter_mm = 0.3048;
    Rod::new(&wire, 2.0).unwrap()
}

/// The nine paths of the session.
fn measured_paths() -> Vec<Line> {
    let text = fixture("session.toml");
    let values = |key: &str| -> Vec<Vector3<f64>> {
        text.lines()
            .filter_map(|l| {
                l.strip_prefix(key)?
                    .split_once('[')?
                    .1
                    .split_once(']')
                    .map(|v| triple(v.0))
            })
            .collect()
    };
    let (origins, directions) = (values("origin_mm"), values("direction"));
    assert_eq!((origins.len(), directions.len()), (9, 9));
    origins
        .into_iter()
        .zip(directions)
        .map(|(origin_mm, d)| Line {
            origin_mm,
            direction: d.normalize(),
        })
        .collect()
}

/// Smallest distance between the path ahead of its origin and the wire beyond `from_mm`.
fn closest_beyond(rod: &Rod, line: &Line, from_mm: f64) -> f64 {
    (0..2000)
        .map(|k| from_mm + (rod.shape.length_mm - from_mm) * f64::from(k) / 2000.0)
        .map(|s| {
            let r = rod.shape.rest_point(s);
            (line.point((r - line.origin_mm).dot(&line.direction).max(0.0)) - r).norm()
        })
        .fold(f64::INFINITY, f64::min)
}

#[test]
fn the_first_of_two_crossings_counts() {
    let rod = measured_wire();
    let mut crossed_twice = 0;
    for (j, line) in measured_paths().iter().enumerate() {
        let touch = rod.first_touch(line, 0.0, 40.0);
        let later = closest_beyond(&rod, line, touch.arclength_mm + 12.0);
        println!(
            "path {}: touch at {:.2} mm, s {:.2} mm, gap {:.3} mm; closest later {later:.3} mm",
            j + 1,
            touch.x_mm,
            touch.arclength_mm,
            touch.gap_mm
        );
        assert!(
            touch.x_mm < 5.0 && touch.gap_mm < 1.0,
            "path {}: {touch:?}",
            j + 1
        );
        assert!(touch.arclength_mm < 16.0);
        crossed_twice += usize::from(later < 0.1);
        // A groove that starts behind the first crossing meets the second one: the search does not
        // prefer the root.
        let behind = Line {
            origin_mm: line.point(touch.x_mm + 6.0),
            ..*line
        };
        let second = rod.first_touch(&behind, 0.0, 40.0);
        if later < 0.1 {
            assert!(
                second.arclength_mm > touch.arclength_mm + 12.0,
                "path {}: {second:?}",
                j + 1
            );
        }
    }
    assert!(
        crossed_twice >= 1,
        "the set has a planar path that crosses the bent wire twice"
    );
}

#[test]
fn the_measured_paths_can_be_followed_from_first_touch() {
    let rod = measured_wire();
    for (j, line) in measured_paths().iter().enumerate() {
        let xs: Vec<f64> = (1..=30).map(f64::from).collect();
        let out = rod.follow(line, &xs);
        let held = out.iter().filter(|o| matches!(o, Outcome::Held(_))).count();
        println!(
            "path {}: {held} of 30 held, last {:?}",
            j + 1,
            out.last().map(|o| o.equilibrium().is_some())
        );
        let arcs: Vec<f64> = out
            .iter()
            .filter_map(|o| Some(o.equilibrium()?.arclength_mm))
            .collect();
        assert!(arcs.len() >= 8, "path {}: {out:?}", j + 1);
        assert!(
            arcs.windows(2).all(|w| (w[1] - w[0]).abs() < 6.0),
            "path {}: contact jumps {arcs:?}",
            j + 1
        );
    }
}

#[test]
fn an_offset_groove_still_touches_where_it_starts() {
    let rod = bent(2.0);
    let at = rod.shape.rest_point(34.0);
    let line = Line {
        origin_mm: at + Vector3::new(0.0, 0.4, 0.0),
        direction: Vector3::y(),
    };
    // The stage may not go back: the wire is already 0.4 mm behind the groove and is pulled there.
    let touch = rod.first_touch(&line, 0.0, 10.0);
    assert_eq!(touch.x_mm, 0.0);
    assert!(
        (touch.gap_mm - 0.4).abs() < 1e-6 && (touch.arclength_mm - 34.0).abs() < 0.1,
        "{touch:?}"
    );
    let free = rod.first_touch(&line, 1.0, 10.0);
    assert!(
        (free.x_mm + 0.4).abs() < 1e-6 && free.gap_mm < 1e-9,
        "{free:?}"
    );
}
