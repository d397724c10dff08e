//! What else a board may be than what its user states: the mistakes that people make with the
//! numbers of a board.

use crate::calibrate::board::{Board, Pattern, TagOrder};
use crate::calibrate::chessboard::BoardSize;
use crate::calibrate::markers::BoardLayout;
use crate::calibrate::noise::CornerNoise;

/// How another board is stated (completes "with ... RMS is"), and that board.
type Statement = (String, Board);

/// Columns by which a board may be miscounted.
const MISCOUNT: [isize; 4] = [-2, -1, 1, 2];

/// Every alternative to a stated board, a plain mistake before a number that is free. `noise` knows
/// the tags' extent beside their distance from the pictures. A plain chessboard has its squares and
/// nothing else to be wrong, but the print.
pub(crate) fn alternatives(
    stated: &BoardLayout,
    noise: &CornerNoise,
) -> Vec<(String, BoardLayout)> {
    let board = &stated.board;
    let found = match &board.pattern {
        Pattern::Chessboard => Vec::new(),
        Pattern::Charuco { legacy, .. } => charuco(board, *legacy),
        Pattern::AprilGrid { gap_mm, order, .. } => tag_sizes(board, *gap_mm, noise)
            .into_iter()
            .chain(tag_layouts(board, *order))
            .collect(),
    };
    found
        .into_iter()
        .map(|(says, other)| (says, BoardLayout::with_tags(other, stated.tags())))
        .collect()
}

/// The same board with another size, and a change of its pattern.
fn other(stated: &Board, size: BoardSize, change: impl Fn(&mut Pattern)) -> Board {
    let mut board = Board {
        size,
        ..stated.clone()
    };
    change(&mut board.pattern);
    board
}

/// The stated size, and the one with columns and rows exchanged, each with what is to be said of
/// it.
fn sizes(stated: BoardSize) -> Vec<(BoardSize, Option<String>)> {
    let turned = BoardSize {
        columns: stated.rows,
        rows: stated.columns,
    };
    let exchanged = Some(format!("columns and rows exchanged (--board {turned})"));
    let mut sizes = vec![(stated, None), (turned, exchanged)];
    sizes.dedup_by_key(|s| s.0);
    sizes
}

/// What is said of several changes at once; nothing of none.
fn joined(changes: [Option<String>; 2]) -> Option<String> {
    changes
        .into_iter()
        .flatten()
        .reduce(|a, b| format!("{a} and {b}"))
}

fn charuco(stated: &Board, stated_legacy: bool) -> Vec<Statement> {
    let mut found = Vec::new();
    for (size, exchanged) in sizes(stated.size) {
        for legacy in [stated_legacy, !stated_legacy] {
            let (name, since) = if legacy {
                ("charuco-legacy", "before")
            } else {
                ("charuco", "since")
            };
            let layout = format!("the layout {since} OpenCV 4.6 (--pattern {name})");
            let changes = [
                exchanged.clone(),
                (legacy != stated_legacy).then_some(layout),
            ];
            // Only an even number of rows of squares differs between the layouts.
            if legacy == stated_legacy || size.rows % 2 == 1 {
                let board = other(stated, size, |pattern| {
                    if let Pattern::Charuco { legacy: own, .. } = pattern {
                        *own = legacy;
                    }
                });
                found.extend(joined(changes).map(|says| (says, board)));
            }
        }
    }
    found
}

/// Other sides and gaps. Pictures tell the ratio of the two; which of them is wrong shows in what
/// explains it.
fn tag_sizes(stated: &Board, gap: f64, noise: &CornerNoise) -> Vec<Statement> {
    let side = stated.square_mm;
    // Without the digits of rounding.
    let [less, share] = [(side - gap).abs(), gap * side].map(|mm| (mm * 1e6).round() / 1e6);
    let pitch = "is the distance of the tags' centres";
    let mut found = vec![
        if side > gap {
            let says =
                format!("tags of {less} mm (--square-mm {less}; the stated {side} mm {pitch})");
            (less, gap, says)
        } else {
            (
                side,
                less,
                format!("gaps of {less} mm (--marker-mm {less}; the stated {gap} mm {pitch})"),
            )
        },
        (
            side,
            share,
            format!(
                "gaps of {share} mm (--marker-mm {share}; the stated {gap} is a share of the side)"
            ),
        ),
        (
            gap,
            side,
            format!("side and gap exchanged (--square-mm {gap} --marker-mm {side})"),
        ),
    ];
    // Half the side from the centre in both directions, in distances of the tags.
    let extents: Vec<f64> = noise
        .offsets
        .iter()
        .map(|o| o.x.abs() + o.y.abs())
        .collect();
    let share = extents.iter().sum::<f64>() / extents.len().max(1) as f64;
    if share > 0.0 && share < 1.0 {
        // share = side / (side + gap), solved for the gap and for the side.
        let (beside, of) = (side * (1.0 / share - 1.0), gap / (1.0 / share - 1.0));
        let says = format!(
            "gaps of {beside:.3} mm beside tags of {side} mm, or tags of {of:.3} mm beside gaps of {gap} mm"
        );
        found.push((side, beside, says));
    }
    found.retain(|(side, gap, _)| *side > 0.0 && *gap > 0.0);
    let board = |square_mm, gap| {
        let change = |pattern: &mut Pattern| {
            if let Pattern::AprilGrid { gap_mm, .. } = pattern {
                *gap_mm = gap;
            }
        };
        Board {
            square_mm,
            ..other(stated, stated.size, change)
        }
    };
    found
        .into_iter()
        .map(|(side, gap, says)| (says, board(side, gap)))
        .collect()
}

/// Other numbers of columns and rows, other orders of the numbers: tags turned against their
/// numbering are one of them.
fn tag_layouts(stated: &Board, stated_order: TagOrder) -> Vec<Statement> {
    let board = |size, by: TagOrder| {
        other(stated, size, |pattern| {
            if let Pattern::AprilGrid { order, .. } = pattern {
                *order = by;
            }
        })
    };
    let mut found = Vec::new();
    for (size, exchanged) in sizes(stated.size) {
        for (name, order) in TagOrder::all() {
            let order = TagOrder {
                first: stated_order.first,
                ..order
            };
            let numbered = format!("tags numbered otherwise (--pattern {name})");
            let changes = [
                exchanged.clone(),
                (order != stated_order).then_some(numbered),
            ];
            found.extend(joined(changes).map(|says| (says, board(size, order))));
        }
    }
    let BoardSize {
        columns: stated_columns,
        rows,
    } = stated.size;
    for columns in MISCOUNT
        .iter()
        .filter_map(|by| stated_columns.checked_add_signed(*by))
        .filter(|c| *c >= 2)
    {
        let says = format!("{columns} columns of tags, not {stated_columns}");
        found.push((says, board(BoardSize { columns, rows }, stated_order)));
    }
    found
}
