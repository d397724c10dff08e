//! What else a board with markers may be than what its user states: the mistakes that people make with the numbers of a board.

use crate::calibrate::board::TagOrder;
use crate::calibrate::chessboard::BoardSize;
use crate::calibrate::markers::{Charuco, MarkerBoard, Markers, TagGrid};
use crate::calibrate::noise::CornerNoise;

/// Another board, and how to state it.
pub(crate) struct Alternative {
    /// Completes "with ... RMS is".
    pub says: String,
    pub board: MarkerBoard,
}

/// Columns by which a board may be miscounted.
const MISCOUNT: i64 = 2;

/// Every alternative to a stated board. `noise` knows the tags' extent beside their distance from the pictures.
pub(crate) fn alternatives(stated: &MarkerBoard, noise: &CornerNoise) -> Vec<Alternative> {
    let found: Vec<(String, Markers)> = match stated.markers() {
        Markers::Charuco(board) => {
            charuco(board).into_iter().map(|(s, b)| (s, Markers::Charuco(b))).collect()
        }
        Markers::Tags(grid) => {
            let all = tag_sizes(grid, noise).into_iter().chain(tag_layouts(grid));
            all.map(|(s, g)| (s, Markers::Tags(g))).collect()
        }
    };
    found.into_iter().map(|(says, markers)| Alternative { says, board: MarkerBoard::of(markers) }).collect()
}

/// Without the digits of rounding.
fn rounded(mm: f64) -> f64 {
    (mm * 1e6).round() / 1e6
}

fn exchanged(size: BoardSize) -> BoardSize {
    BoardSize { columns: size.rows, rows: size.columns }
}

fn charuco(stated: &Charuco) -> Vec<(String, Charuco)> {
    let turned = exchanged(stated.size);
    let mut found = Vec::new();
    if turned != stated.size {
        let says = format!("columns and rows exchanged (--board {turned})");
        found.push((says, Charuco { size: turned, ..stated.clone() }));
    }
    for (size, more) in [(stated.size, String::new()), (turned, format!(" with --board {turned}"))] {
        // Only an even number of rows of squares differs between the layouts.
        if size.rows % 2 == 1 {
            let legacy = !stated.legacy;
            let says = if legacy {
                format!("the layout before OpenCV 4.6 (--pattern charuco-legacy){more}")
            } else {
                format!("the layout since OpenCV 4.6 (--pattern charuco){more}")
            };
            found.push((says, Charuco { size, legacy, ..stated.clone() }));
        }
    }
    found
}

/// Other sides and gaps. Pictures tell the ratio of the two; which of them is wrong is told by what explains it.
fn tag_sizes(stated: &TagGrid, noise: &CornerNoise) -> Vec<(String, TagGrid)> {
    let (side, gap) = (stated.side_mm, stated.gap_mm);
    let with = |side_mm: f64, gap_mm: f64| TagGrid { side_mm, gap_mm, ..stated.clone() };
    let mut found = Vec::new();
    let pitch = "is the distance of the tags' centres";
    if side > gap {
        let other = rounded(side - gap);
        found.push((
            format!("tags of {other} mm (--square-mm {other}; the stated {side} mm {pitch})"),
            with(other, gap),
        ));
    } else {
        let other = rounded(gap - side);
        found.push((
            format!("gaps of {other} mm (--marker-mm {other}; the stated {gap} mm {pitch})"),
            with(side, other),
        ));
    }
    let share = rounded(gap * side);
    let says = format!("gaps of {share} mm (--marker-mm {share}; the stated {gap} is a share of the side)");
    found.push((says, with(side, share)));
    found.push((format!("side and gap exchanged (--square-mm {gap} --marker-mm {side})"), with(gap, side)));
    // Half the side from the centre in both directions, in distances of the tags.
    let extents: Vec<f64> = noise.offsets.iter().map(|o| o.x.abs() + o.y.abs()).collect();
    let share = extents.iter().sum::<f64>() / extents.len().max(1) as f64;
    if share > 0.0 && share < 1.0 {
        let (beside, of) = (side * (1.0 / share - 1.0), gap / (1.0 / share - 1.0));
        let says = format!(
            "gaps of {beside:.3} mm beside tags of {side} mm, or tags of {of:.3} mm beside gaps of {gap} mm"
        );
        found.push((says, with(side, beside)));
    }
    found.retain(|(_, grid)| grid.side_mm > 0.0 && grid.gap_mm > 0.0);
    found
}

/// Other numbers of columns and rows, other orders of the numbers: tags turned against their numbering are one of them.
fn tag_layouts(stated: &TagGrid) -> Vec<(String, TagGrid)> {
    let turned = exchanged(stated.size);
    let with = |size: BoardSize, order: TagOrder| TagGrid { size, order, ..stated.clone() };
    let mut found = Vec::new();
    for size in [stated.size, turned] {
        for (name, order) in TagOrder::all().filter(|o| (size, o.1) != (stated.size, stated.order)) {
            let mut changes = Vec::new();
            if size != stated.size {
                changes.push(format!("columns and rows exchanged (--board {size})"));
            }
            if order != stated.order {
                changes.push(format!("tags numbered otherwise (--pattern {name})"));
            }
            found.push((changes.join(" and "), with(size, order)));
        }
        if turned == stated.size {
            break;
        }
    }
    for by in (-MISCOUNT..=MISCOUNT).filter(|by| *by != 0) {
        let columns = stated.size.columns as i64 + by;
        if columns >= 2 {
            let size = BoardSize { columns: columns as usize, rows: stated.size.rows };
            found.push((
                format!("{columns} columns of tags, not {}", stated.size.columns),
                with(size, stated.order),
            ));
        }
    }
    found
}
