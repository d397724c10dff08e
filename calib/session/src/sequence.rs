//! Does the order of the rows agree with what their columns say: a direction with the moves, a clock with itself?

use crate::error::InputError;

/// A row as its place in the sequence shows it.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Step {
    /// Line in the file.
    pub line: usize,
    /// Position or stimulus.
    pub x: f64,
    /// +1 or -1.
    pub direction: Option<f64>,
    /// Time, s.
    pub t_s: Option<f64>,
}

/// A stroke: a run of rows that rises or falls throughout.
struct Stroke {
    first: usize,
    sign: f64,
    direction: f64,
}

/// Rows of a stroke: with fewer, single targets that are approached again look like one.
const MIN_STROKE: usize = 3;

/// Strokes of one direction each.
fn strokes(rows: &[Step]) -> Vec<Stroke> {
    let mut out = Vec::new();
    let mut first = 0;
    while first + 1 < rows.len() {
        let sign = (rows[first + 1].x - rows[first].x).signum();
        let mut last = first + 1;
        let goes_on =
            |last: usize| rows.get(last + 1).is_some_and(|next| (next.x - rows[last].x) * sign > 0.0);
        if rows[first + 1].x == rows[first].x {
            first += 1;
            continue;
        }
        while goes_on(last) {
            last += 1;
        }
        // The rows at the turns may count to the stroke before or behind.
        let own = &rows[first + 1..last];
        if last - first + 1 >= MIN_STROKE
            && let Some(direction) = own[0].direction.filter(|d| own.iter().all(|r| r.direction == Some(*d)))
        {
            out.push(Stroke { first: first + 1, sign, direction });
        }
        first = last;
    }
    out
}

/// A direction column that says the opposite of the moves, where the table goes to and fro and so shows them.
///
/// A list by direction with every stroke in rising order, and targets that are approached from one side whatever the way between them,
/// contradict nothing: their strokes show no way back, or agree as often as not.
pub(crate) fn contradicted_direction(file: &str, column: &str, rows: &[Step]) -> Option<InputError> {
    let all = strokes(rows);
    let both = |f: fn(&Stroke) -> f64| all.iter().any(|s| f(s) > 0.0) && all.iter().any(|s| f(s) < 0.0);
    if !both(|s| s.sign) || !both(|s| s.direction) {
        return None;
    }
    let against: Vec<&Stroke> = all.iter().filter(|s| s.sign * s.direction < 0.0).collect();
    // All or nearly all the wrong way round, or few among many that agree; what lies between is another convention.
    let few = 4 * against.len() <= all.len();
    let most = 10 * against.len() >= 9 * all.len();
    let first = against.first().filter(|_| few || most)?;
    let row = &rows[first.first];
    let way = if first.sign > 0.0 { "rises" } else { "falls" };
    let found = format!(
        "direction {} where {column} {way} ({} of {} strokes)",
        row.direction.unwrap_or_default(),
        against.len(),
        all.len()
    );
    let expected = format!("a direction that agrees with {column}: 1 where it rises, -1 where it falls");
    let hint = if most {
        "turn it with --direction 'COLUMN*-1' at import, or leave --direction out"
    } else {
        "correct these rows, or leave --direction out at import"
    };
    Some(InputError::new(file, expected, found).at(row.line).field("direction").hint(hint))
}

/// Equal times in a row that are no coarse clock's any more.
const MIN_STANDING: usize = 6;

/// A clock that stands still: one time for all rows, or for many times as many as it has elsewhere.
pub(crate) fn standing_clock(file: &str, rows: &[Step]) -> Option<InputError> {
    let timed: Vec<(usize, f64)> = rows.iter().filter_map(|r| Some((r.line, r.t_s?))).collect();
    let mut runs: Vec<&[(usize, f64)]> = timed.chunk_by(|a, b| a.1 == b.1).collect();
    runs.sort_by_key(|run| run.len());
    let longest = *runs.last()?;
    let usual = if runs.len() > 1 { runs[(runs.len() - 1) / 2].len() } else { 1 };
    // A stamp of the minute or the day is shared by about as many rows each time.
    if longest.len() < MIN_STANDING.max(5 * usual) {
        return None;
    }
    let found = format!("t_s {} in {} rows one after another", longest[0].1, longest.len());
    let error = InputError::new(file, "a time that runs", found).at(longest[0].0).field("t_s");
    Some(error.hint("leave --time out at import: the order of the rows then stands for it"))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// `cycles` of five positions up and down; `direction` by cycle and way.
    fn axis(cycles: usize, direction: impl Fn(usize, f64) -> f64) -> Vec<Step> {
        let of = |k: usize| {
            let (cycle, place) = (k / 10, k % 10);
            let (x, way) = if place < 5 { (place, 1.0) } else { (9 - place, -1.0) };
            Step { line: k + 2, x: x as f64, direction: Some(direction(cycle, way)), t_s: None }
        };
        (0..10 * cycles).map(of).collect()
    }

    fn named(rows: &[Step]) -> Option<String> {
        contradicted_direction("t.csv", "commanded_mm", rows).map(|e| e.to_string())
    }

    #[test]
    fn a_direction_against_the_moves_is_named_and_other_conventions_are_not() {
        assert!(named(&axis(3, |_, way| way)).is_none());
        let all = named(&axis(3, |_, way| -way)).unwrap();
        assert!(all.contains("6 of 6 strokes") && all.contains("--direction 'COLUMN*-1'"), "{all}");
        let one = named(&axis(5, |cycle, way| if cycle == 3 { -way } else { way })).unwrap();
        assert!(one.contains("2 of 10 strokes") && one.contains("leave --direction out"), "{one}");
        // Approached from below always.
        assert!(named(&axis(3, |_, _| 1.0)).is_none());
        // Forward and backward readings listed in rising order.
        let mut list = axis(2, |_, way| way);
        list.sort_by(|a, b| b.direction.partial_cmp(&a.direction).unwrap().then(a.x.total_cmp(&b.x)));
        assert!(named(&list).is_none());
    }

    #[test]
    fn a_clock_that_stands_is_named_and_a_coarse_one_is_not() {
        let clock = |t: fn(usize) -> f64| -> Vec<Step> {
            (0..40).map(|k| Step { line: k + 2, x: 0.0, direction: None, t_s: Some(t(k)) }).collect()
        };
        assert!(standing_clock("t.csv", &clock(|k| k as f64)).is_none());
        assert!(standing_clock("t.csv", &clock(|k| (k / 8) as f64)).is_none());
        assert!(standing_clock("t.csv", &clock(|_| 12.0)).unwrap().to_string().contains("t_s 12 in 40 rows"));
        assert!(
            standing_clock("t.csv", &clock(|k| k.min(20) as f64)).unwrap().to_string().contains("20 rows")
        );
    }
}
