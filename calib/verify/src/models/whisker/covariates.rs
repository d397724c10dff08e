//! What a residual that nothing explains may follow: the columns of a whisker's session, and what
//! can be made of them.
//!
//! ```text
//! largest moment   max over s <= t of |m(s)|                  what has yielded keeps the set of it
//! rate             (T(t + s) - T(t - s)) / 2 s, now or s earlier: a part that lags behind the gratings follows it
//! ```

use super::path::Reading;
use super::system::WhiskerSystem;

/// Readings on each side between which a rate is taken: few for a fast room, many for a noisy
/// thermometer; and readings before.
const SIDES: [[usize; 2]; 5] = [[3, 0], [10, 0], [10, 10], [30, 0], [30, 30]];

/// The columns, by name; a name may have several.
pub(super) fn covariates(system: &WhiskerSystem) -> Vec<(String, Vec<f64>)> {
    let (path, r) = (&system.path, &system.path.readings);
    let column = |f: &dyn Fn(&Reading) -> f64| r.iter().map(f).collect::<Vec<f64>>();
    let mut out = Vec::new();
    let mut add = |name: &str, values: Vec<f64>| out.push((name.to_owned(), values));
    add("stage_mm", column(&|r| r.x_mm));
    if let Some((sensed, _)) = system.moments(&[]) {
        let sizes: Vec<f64> = sensed.iter().map(|m| m[0].hypot(m[1])).collect();
        add("moment_1_nmm", sensed.iter().map(|m| m[0]).collect());
        add("moment_2_nmm", sensed.iter().map(|m| m[1]).collect());
        add("moment_nmm", sizes.clone());
        let so_far = sizes.iter().scan(0.0, |largest: &mut f64, size| {
            *largest = largest.max(*size);
            Some(*largest)
        });
        add("largest_moment_nmm", so_far.collect());
    }
    add("trajectory", column(&|r| f64::from(r.group)));
    add("order", (0..r.len()).map(|k| k as f64).collect());
    if path.columns.time {
        add("t_s", column(&|r| r.t_s));
        add("dwell_s", column(&|r| r.dwell_s));
    }
    if path.columns.temperature {
        add("temperature_degc", column(&|r| r.temperature_loo_degc));
    }
    if path.columns.temperature && path.columns.time {
        SIDES
            .into_iter()
            .for_each(|s| add("temperature_rate_degc_s", rates(r, s)));
    }
    if path.columns.both_directions {
        add(
            "direction",
            column(&|r| if r.rest { 0.0 } else { r.direction }),
        );
    }
    if path.columns.speeds {
        add("speed_mm_s", column(&|r| r.velocity_mm_s));
    }
    let arclength_mm = |r: &Reading| {
        r.line
            .filter(|_| !r.rest)
            .and_then(|l| system.rod_tables.arclength_mm(l, r.x_mm))
    };
    add(
        "contact_arclength_mm",
        column(&|r| arclength_mm(r).unwrap_or_default()),
    );
    out
}

/// Rate of the temperature, deg C/s, over `side` readings on both sides of the one `before` each:
/// what a reading's own noise has in them cancels.
fn rates(readings: &[Reading], [side, before]: [usize; 2]) -> Vec<f64> {
    let last = readings.len() - 1;
    let rate = |i: usize| {
        let (a, b) = (
            i.saturating_sub(before + side),
            (i + side).saturating_sub(before).min(last),
        );
        let (a, b) = (&readings[a], &readings[b]);
        // Central difference: the own noise of the reading in the middle cancels.
        let dt_s = b.t_s - a.t_s;
        if dt_s > 0.0 {
            (b.temperature_loo_degc - a.temperature_loo_degc) / dt_s
        } else {
            0.0
        }
    };
    (0..readings.len()).map(rate).collect()
}
