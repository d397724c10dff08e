//! What a residual that nothing explains may follow: the columns of a whisker's session, and what can be made of them.
//!
//! ```text
//! largest moment   max over s <= t of |m(s)|                  what has yielded keeps the set of it
//! rate             (T - z) / tau,   z' = (T - z) / tau        of a part that lags behind the gratings; small tau: dT/dt
//! ```

use super::effects::creep::relax;
use super::path::Reading;
use super::system::WhiskerSystem;

/// Time constants by which a part may lag behind, s: as far as a bench shows.
const LAGS_S: [f64; 4] = [10.0, 30.0, 100.0, 300.0];

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
        LAGS_S.into_iter().for_each(|lag_s| add("temperature_rate_degc_s", behind(r, lag_s)));
    }
    if path.columns.both_directions {
        add("direction", column(&|r| if r.rest { 0.0 } else { r.direction }));
    }
    if path.columns.speeds {
        add("speed_mm_s", column(&|r| r.velocity_mm_s));
    }
    let arclength_mm =
        |r: &Reading| r.line.filter(|_| !r.rest).and_then(|l| system.rod_tables.arclength_mm(l, r.x_mm));
    add("contact_arclength_mm", column(&|r| arclength_mm(r).unwrap_or(0.0)));
    out
}

/// How far a part with a time constant is behind the gratings' temperature, over that constant.
fn behind(readings: &[Reading], lag_s: f64) -> Vec<f64> {
    let mut last: Option<(f64, f64, f64)> = None;
    let of = |r: &Reading| {
        let now = r.temperature_loo_degc;
        let own = last.map_or(now, |(t_s, then, own)| relax(own, then, now, r.t_s - t_s, lag_s));
        last = Some((r.t_s, now, own));
        (now - own) / lag_s
    };
    readings.iter().map(of).collect()
}
