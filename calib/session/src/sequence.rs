//! Does a direction column agree with the moves that the order of the rows shows?

use crate::error::InputError;

/// A row as its place in the sequence shows it: line in the file, position or stimulus, direction.
pub(crate) type Step = (usize, f64, Option<f64>);

/// A direction column that says the opposite of the moves: rows at which the position rises, or falls, before and after. At the turns, and where
/// targets are approached singly, nothing is contradicted, nor by a table whose moves or directions have one sign alone.
pub(crate) fn contradicted_direction(file: &str, column: &str, rows: &[Step]) -> Option<InputError> {
    let way = |w: &[Step]| (w[1].1 - w[0].1).signum() * f64::from(u8::from(w[1].1 != w[0].1));
    let within = rows.windows(3).filter(|w| way(&w[..2]) * way(&w[1..]) > 0.0);
    let seen: Vec<(usize, f64, f64)> = within.filter_map(|w| Some((w[1].0, way(w), w[1].2?))).collect();
    let both =
        |f: fn(&(usize, f64, f64)) -> f64| seen.iter().any(|s| f(s) > 0.0) && seen.iter().any(|s| f(s) < 0.0);
    if !both(|s| s.1) || !both(|s| s.2) {
        return None;
    }
    let against: Vec<_> = seen.iter().filter(|(_, way, direction)| way * direction < 0.0).collect();
    // All or nearly all the wrong way round, or few among many that agree; what lies between is another convention.
    let (few, most) = (4 * against.len() <= seen.len(), 10 * against.len() >= 9 * seen.len());
    let (line, way, direction) = against.first().filter(|_| few || most)?;
    let way = if *way > 0.0 { "rises" } else { "falls" };
    let (count, of) = (against.len(), seen.len());
    let found = format!("direction {direction} where {column} {way} ({count} of {of} rows within a stroke)");
    let expected = format!("a direction that agrees with {column}: 1 where it rises, -1 where it falls");
    let hint = if most {
        "turn it with --direction 'COLUMN*-1' at import, or leave --direction out"
    } else {
        "correct these rows, or leave --direction out at import"
    };
    Some(InputError::new(file, expected, found).at(*line).field("direction").hint(hint))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// `cycles` of five positions up and down; `direction` by cycle and way.
    fn axis(cycles: usize, direction: impl Fn(usize, f64) -> f64) -> Vec<Step> {
        let of = |k: usize| {
            let (cycle, place) = (k / 10, k % 10);
            let (x, way) = if place < 5 { (place, 1.0) } else { (9 - place, -1.0) };
            (k + 2, x as f64, Some(direction(cycle, way)))
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
        assert!(all.contains("18 of 18 rows") && all.contains("--direction 'COLUMN*-1'"), "{all}");
        let one = named(&axis(5, |cycle, way| if cycle == 3 { -way } else { way })).unwrap();
        assert!(one.contains("6 of 30 rows") && one.contains("leave --direction out"), "{one}");
        // Approached from below always.
        assert!(named(&axis(3, |_, _| 1.0)).is_none());
        // Forward and backward readings listed in rising order.
        let mut list = axis(2, |_, way| way);
        list.sort_by(|a, b| b.2.partial_cmp(&a.2).unwrap().then(a.1.total_cmp(&b.1)));
        assert!(named(&list).is_none());
    }
}
