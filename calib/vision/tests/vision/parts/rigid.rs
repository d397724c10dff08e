//! Poses as rows.

use wcal_vision::rigid::{pose_from_rows, rows};

#[test]
fn rows_round_trip_also_for_a_half_turn() {
    let m = [
        [1.0, 0.0, 0.0, 3.0],
        [0.0, -1.0, 0.0, 2.0],
        [0.0, 0.0, -1.0, 1.0],
        [0.0, 0.0, 0.0, 1.0],
    ];
    let back = rows(&pose_from_rows(&m).unwrap());
    assert!(
        back.iter()
            .flatten()
            .zip(m.iter().flatten())
            .all(|(a, b)| (a - b).abs() < 1e-12)
    );
}

#[test]
fn a_mirror_is_refused() {
    let m = [
        [-1.0, 0.0, 0.0, 0.0],
        [0.0, 1.0, 0.0, 0.0],
        [0.0, 0.0, 1.0, 0.0],
        [0.0, 0.0, 0.0, 1.0],
    ];
    assert!(pose_from_rows(&m).is_none());
}
