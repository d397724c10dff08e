//! Which readings can be used at all.

use super::frame::{Declared, ScalarRow, Scaling};

/// Fewer readings than this are refused.
const LEAST_ROWS: usize = 8;
/// The search takes at most this many readings of a session; all are predicted.
const MOST_ROWS: usize = 1000;

/// Why the readings of the points table cannot be used; `sealed` are those of the holdout.
pub(super) fn refusal(
    rows: &[ScalarRow],
    sealed: &[ScalarRow],
    scaling: &Scaling,
    declared: Declared,
) -> Option<String> {
    let parameters = match declared {
        Declared::Polynomial(degree) => degree + 1,
        Declared::Axis => 1,
    };
    if rows.len() < LEAST_ROWS {
        return Some(format!("{} readings; at least {LEAST_ROWS} are needed", rows.len()));
    }
    if let Some(bad) = rows.iter().chain(sealed).find(|r| !(r.x.is_finite() && r.y.is_finite())) {
        return Some(format!("reading {} of {} is not a finite number", bad.origin.2, bad.origin.0));
    }
    let mut x: Vec<f64> = rows.iter().map(|r| r.x).collect();
    x.sort_by(f64::total_cmp);
    x.dedup();
    if x.len() < parameters || (parameters > 1 && !(scaling.half > 0.0)) {
        let count = x.len();
        return Some(
            declared.worded(&format!("{count} different stimuli do not determine {parameters} coefficients")),
        );
    }
    clock_fault(rows.iter().map(|r| r.t_s)).or_else(|| copied_holdout(rows, sealed))
}

/// Where the clock of a table in file order runs backwards, in words.
pub fn clock_fault(times: impl Iterator<Item = Option<f64>>) -> Option<String> {
    let times: Vec<f64> = times.flatten().collect();
    let k = times.windows(2).position(|w| w[1] < w[0])?;
    Some(format!(
        "the clock runs backwards after reading {} (t_s {} follows {})",
        k + 1,
        times[k + 1],
        times[k]
    ))
}

/// Sealed readings that are in the points table too. With a clock one agreement is a copy; without, coarse readings agree by chance.
fn copied_holdout(rows: &[ScalarRow], sealed: &[ScalarRow]) -> Option<String> {
    let key = |r: &ScalarRow| (r.x.to_bits(), r.y.to_bits(), r.t_s.map(f64::to_bits));
    let known: std::collections::BTreeSet<_> = rows.iter().map(key).collect();
    let copied = sealed.iter().filter(|r| known.contains(&key(r))).count();
    let timed = sealed.iter().all(|r| r.t_s.is_some());
    let suspicious = if timed { copied > 0 } else { copied > 2 && 2 * copied > sealed.len() };
    suspicious.then(|| {
        format!("{copied} rows of the holdout are also in the points table; a holdout that was in the fit proves nothing")
    })
}

/// Every k-th reading where there are too many for the search.
pub(super) fn thin(rows: Vec<ScalarRow>) -> (Vec<ScalarRow>, usize) {
    let every = rows.len().div_ceil(MOST_ROWS).max(1);
    (rows.into_iter().step_by(every).collect(), every)
}
