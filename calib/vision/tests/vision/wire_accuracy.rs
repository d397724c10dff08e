//! The wire's centre on drawn lines (simulated): against the Cramer-Rao bound, Steger's method's
//! published errors, and uneven backgrounds.

use crate::common;
use nalgebra::{DMatrix, DVector, Vector2};
use wcal_vision::picture::Picture;
use wcal_vision::profile::blurred_step;
use wcal_vision::wire::appearance::fit_appearance;
use wcal_vision::wire::piece::{Appearance, PIECE_PX, Piece, Station, fit_piece};

const ANGLE: f64 = 0.37;
const WIDTHS: [f64; 3] = [2.0, 3.0, 6.0];

/// A straight dark line through the middle; `right` adds to the background on one side, `texture`
/// varies it.
fn line(width: f64, noise: f64, right: f64, texture: f64, seed: u64) -> Picture {
    let normal = Vector2::new(-ANGLE.sin(), ANGLE.cos());
    let centre = Vector2::new(160.3, 120.6);
    common::draw(320, 240, 0.9, noise, seed, |x, y| {
        let u = normal.dot(&(Vector2::new(x, y) - centre));
        let background = 170.0 + texture * (0.05 * x).sin() * (0.04 * y).cos();
        if u.abs() < 0.5 * width {
            80.0
        } else {
            background + if u > 0.0 { right } else { 0.0 }
        }
    })
}

fn pieces(picture: &Picture, width: f64, appearance: Appearance) -> Vec<Piece> {
    let along = Vector2::new(ANGLE.cos(), ANGLE.sin());
    (-30..=30)
        .filter_map(|k| {
            let station = Station {
                arc_mm: 0.0,
                position_px: Vector2::new(160.3, 120.6) + along * (f64::from(k) * PIECE_PX),
                tangent: along,
                bend_per_px: 0.0,
                width_px: width,
            };
            fit_piece(picture, &station, appearance, 1.5)
        })
        .collect()
}

fn fitted(picture: &Picture, width: f64) -> Vec<Piece> {
    let start = Appearance {
        blur_px: 1.2,
        width_scale: 1.0,
    };
    let appearance = fit_appearance(picture, &pieces(picture, width, start), start);
    pieces(picture, width, appearance)
}

fn rms(pieces: &[Piece]) -> f64 {
    (pieces.iter().map(|p| p.offset_px.powi(2)).sum::<f64>() / pieces.len() as f64).sqrt()
}

/// Cramer-Rao bound of a piece's centre: noise over the root of the summed squared slopes, less
/// what the unknown levels of the bar and of both sides take of them, within `fit_piece`'s window.
/// The pixel's own area adds 1/12 px^2 to the blur.
fn cramer_rao_px(width: f64, noise: f64) -> f64 {
    const STEP_PX: f64 = 0.01;
    let (depth, blur, half) = (90.0, (0.9f64 * 0.9 + 1.0 / 12.0).sqrt(), 0.5 * width);
    let near = half + 3.0 * blur + 2.0;
    let count = (2.0 * near / STEP_PX) as usize;
    let at = |k: usize| (k as f64 + 0.5) * STEP_PX - near;
    let edge = |x: f64| blurred_step(x, blur);
    let levels = DMatrix::from_fn(count, 3, |k, j| {
        let (a, b) = (edge(at(k) + half).0, edge(at(k) - half).0);
        [1.0 - a, b, a - b][j]
    });
    let slope = DVector::from_fn(count, |k, _| {
        depth * (edge(at(k) + half).1 - edge(at(k) - half).1)
    });
    let taken = levels.clone().svd(true, true).solve(&slope, 1e-12).unwrap();
    noise / (PIECE_PX * STEP_PX * (slope - levels * taken).norm_squared()).sqrt()
}

#[test]
fn errors_reach_the_cramer_rao_bound_and_the_stated_sd_is_that_error() {
    for (width, steger_clean) in [(2.0, 0.025), (3.0, 0.012), (6.0, 0.011)] {
        let clean = fitted(&line(width, 0.0, 0.0, 0.0, 7), width);
        assert!(
            rms(&clean) < steger_clean,
            "width {width}: clean {}",
            rms(&clean)
        );
        // Some 360 pieces: their RMS is known to 4 %.
        let noisy: Vec<Piece> = (7..13)
            .flat_map(|seed| fitted(&line(width, 8.0, 0.0, 0.0, seed), width))
            .collect();
        let bound = cramer_rao_px(width, 8.0);
        assert!(
            rms(&noisy) <= 1.2 * bound,
            "width {width}: {} against {bound}",
            rms(&noisy)
        );
        let stated =
            (noisy.iter().map(|p| p.sd_px.powi(2)).sum::<f64>() / noisy.len() as f64).sqrt();
        assert!(
            (0.8..1.8).contains(&(stated / rms(&noisy))),
            "width {width}: stated {stated}, {}",
            rms(&noisy)
        );
    }
}

#[test]
fn unequal_sides_and_uneven_background_stay_below_a_twentieth_of_a_pixel() {
    for width in WIDTHS {
        for (right, texture) in [(-50.0, 0.0), (40.0, 10.0), (0.0, 20.0)] {
            let found = fitted(&line(width, 1.0, right, texture, 7), width);
            assert!(
                found.len() > 50 && rms(&found) <= 0.05,
                "width {width}, {right}, {texture}: {}",
                rms(&found)
            );
        }
    }
}

#[test]
fn where_there_is_no_line_there_is_no_evidence() {
    let empty = common::draw(320, 240, 0.9, 3.0, 3, |_, _| 150.0);
    let appearance = Appearance {
        blur_px: 0.9,
        width_scale: 1.0,
    };
    let found = pieces(&empty, 3.0, appearance);
    let seen = found.iter().filter(|p| p.evidence > 0.0).count();
    assert!(seen * 20 <= found.len(), "{seen} of {}", found.len());
}
