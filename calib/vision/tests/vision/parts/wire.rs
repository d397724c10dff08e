//! One piece of wire (simulated pictures).

use nalgebra::Vector2;
use wcal_vision::picture::Picture;
use wcal_vision::profile::blurred_step;
use wcal_vision::wire::piece::{Appearance, Station, fit_piece};

/// A bar of 3.6 px across unequal backgrounds, drawn by its own formula (simulated).
fn drawn(centre: f64, right: f64, width: f64) -> Picture {
    let data = (0..60usize)
        .flat_map(|_| {
            (0..60usize).map(move |x| {
                let (a, _) = blurred_step(x as f64 - centre + 0.5 * width, 0.9);
                let (b, _) = blurred_step(x as f64 - centre - 0.5 * width, 0.9);
                (180.0 * (1.0 - a) + right * b + 80.0 * (a - b)).round() as u8
            })
        })
        .collect();
    Picture::new(60, 60, data).unwrap()
}

fn station() -> Station {
    Station {
        arc_mm: 0.0,
        position_px: Vector2::new(30.0, 30.0),
        tangent: Vector2::new(0.0, 1.0),
        bend_per_px: 0.0,
        width_px: 3.6,
    }
}

#[test]
fn unequal_sides_do_not_move_the_centre() {
    let appearance = Appearance {
        blur_px: 0.9,
        width_scale: 1.0,
    };
    for right in [180.0, 120.0] {
        let piece = fit_piece(&drawn(30.37, right, 3.6), &station(), appearance, 2.0).unwrap();
        // The normal of a downward tangent points to -x.
        assert!(
            (30.0 - piece.offset_px - 30.37).abs() < 0.01,
            "{right}: {}",
            piece.offset_px
        );
        assert!(piece.evidence > 0.0);
    }
}

#[test]
fn an_edge_is_no_wire() {
    let appearance = Appearance {
        blur_px: 0.9,
        width_scale: 1.0,
    };
    let edge = drawn(30.0, 80.0, 3.6);
    assert!(
        fit_piece(&edge, &station(), appearance, 2.0)
            .is_none_or(|p| p.evidence < 0.0 || p.depth[1].abs() < 3.0)
    );
}
