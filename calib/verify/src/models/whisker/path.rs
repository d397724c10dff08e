//! The session as it really ran: readings in time order, with the moves and dwells between them.

use super::temperature::RandomWalkModel;
use crate::models::range;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use wcal_core::observation::{FbgSpec, Role, Trajectory, WhiskerData, WhiskerRow};
use wcal_core::order_statistics::median;
use wcal_rod::Line;

/// One reading in the form the models need.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Reading {
    /// Index of the trajectory in [`WhiskerPath::lines`]; none at rest away from any.
    pub line: Option<usize>,
    /// Stage position, mm.
    pub x_mm: f64,
    /// No load.
    pub rest: bool,
    /// +1 loading, -1 unloading, 0 unknown.
    pub direction: f64,
    /// Signed speed, mm/s.
    pub velocity_mm_s: f64,
    /// Time, s; file order where the session has none.
    pub t_s: f64,
    /// Time since arrival, s.
    pub dwell_s: f64,
    /// Read while the stage stood.
    pub settled: bool,
    /// Time for which the groove stays after `t_s`: the rest of the averaging window, s.
    pub stays_s: f64,
    /// Temperature, deg C: above the reference grating's nominal where there is one. The zero takes
    /// up any constant. Freed of its sensor's noise where the session's walk is known.
    pub rise_degc: f64,
    /// The same as the other readings have it: free of this reading's own noise, which compensation
    /// brings into its shifts.
    pub temperature_loo_degc: f64,
    /// Compensated shifts, pm.
    pub shift_pm: [f64; 2],
    /// Known part of the noise: sample sd over root samples, pm.
    pub sample_sd_pm: [f64; 2],
    /// Samples averaged, where the session says so.
    pub samples: Option<u32>,
    /// The same for how readings' noise compares: of a session that does not say so, in units of a
    /// settled reading's.
    pub averaged: Option<f64>,
    /// Trajectory identifier (0 at rest without one).
    pub group: u32,
    /// Belongs to the sealed table.
    pub holdout: bool,
    /// Seating of the whisker: 0 in the first session.
    pub seating: u32,
    /// The stage sped up or slowed down, or its answer came late: where it was is not known well
    /// enough.
    pub unsteady: bool,
}

/// A moment on the path: a reading, or an arrival between readings.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Node {
    /// Time, s.
    pub t_s: f64,
    /// Line, if the groove is near the wire.
    pub line: Option<usize>,
    /// Stage position, mm.
    pub x_mm: f64,
    /// The wire is free here.
    pub rest: bool,
    /// The groove moves here.
    pub moving: bool,
    /// Reading taken here.
    pub reading: Option<usize>,
}

impl Node {
    /// The line on which the groove may touch the wire.
    pub(crate) fn loaded_line(&self) -> Option<usize> {
        self.line.filter(|_| !self.rest)
    }
}

/// Which optional columns the session has; what is absent limits what can be traced.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Columns {
    /// Time stamps, increasing.
    pub time: bool,
    /// A temperature or a reference grating.
    pub temperature: bool,
    /// Loading and unloading.
    pub both_directions: bool,
    /// At least two speeds while moving, or moving and settled.
    pub speeds: bool,
    /// Positions of the stage at all loaded readings.
    pub stage: bool,
}

/// A whisker session on its path.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct WhiskerPath {
    /// Readings in time order.
    pub readings: Vec<Reading>,
    /// For each reading the index of its row in the table it came from.
    pub rows: Vec<usize>,
    /// Nodes in time order; every reading has one.
    pub nodes: Vec<Node>,
    /// Paths of the groove.
    pub lines: Vec<Line>,
    /// Largest stage position on each line, mm.
    pub reach_mm: Vec<f64>,
    /// Smallest stage position on each line, mm.
    pub start_mm: Vec<f64>,
    /// Columns present.
    pub columns: Columns,
}

impl WhiskerPath {
    /// Node of each reading, in their order.
    pub(super) fn reading_nodes(&self) -> impl Iterator<Item = usize> {
        let is_reading = move |k: &usize| self.nodes[*k].reading.is_some();
        (0..self.nodes.len()).filter(is_reading)
    }

    /// One column a seating after the first, 1 at its readings: the zero of each seating is its
    /// own.
    pub(crate) fn seating_columns(&self, seatings: u32) -> Vec<Vec<f64>> {
        let of = |k: u32| {
            self.readings
                .iter()
                .map(|r| f64::from(u8::from(r.seating == k)))
                .collect()
        };
        (1..seatings).map(of).collect()
    }
}

/// Distinct loaded stage positions on every line, ascending.
pub(crate) fn positions(nodes: &[Node], xs_mm: &[f64], lines: usize) -> Vec<Vec<f64>> {
    let mut out = vec![Vec::new(); lines];
    for (node, &x) in nodes.iter().zip(xs_mm) {
        if let Some(l) = node.loaded_line() {
            out[l].push(x);
        }
    }
    for xs in &mut out {
        xs.sort_by(f64::total_cmp);
        xs.dedup();
    }
    out
}

/// Temperature of a reading, deg C: of its reference grating where there is one, else of the wire's
/// sensor.
fn temperature_of(row: &WhiskerRow, fbg: &FbgSpec) -> Option<f64> {
    row.reference_shift_pm
        .and_then(|shift_pm| fbg.rise_degc(shift_pm))
        .or(row.temperature_degc)
}

/// Where the readout's columns of time and temperature are zero: at the means of the session's
/// readings, wherever its clock and its thermometer begin.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
pub struct ReadoutOrigin {
    /// Time, s.
    pub t_s: f64,
    /// Temperature, deg C.
    pub temperature_degc: f64,
}

impl ReadoutOrigin {
    /// That of a session; 0 where a reading lacks the column.
    pub fn of(data: &WhiskerData) -> Self {
        let mean = |of: &dyn Fn(&WhiskerRow) -> Option<f64>| {
            let sum: Option<f64> = data.rows.iter().map(of).sum();
            sum.unwrap_or_default() / data.rows.len().max(1) as f64
        };
        Self {
            t_s: mean(&|r| r.t_s),
            temperature_degc: mean(&|r| temperature_of(r, &data.fbg)),
        }
    }
}

/// Averages of more different lengths than this ratio have variances of their own.
const AVERAGED_ALIKE: f64 = 1.5;

/// How long a reading was averaged, whether it is loaded, and whether it had settled.
type Averaged = (Option<f64>, bool, bool);

/// Variances that averages have by their numbers of samples, 1 for a typical settled loaded
/// reading; none where all are alike or a number is missing.
fn averaging_variance(readings: &[Averaged]) -> Option<Vec<f64>> {
    let typical = typical(readings)?;
    // The variance of a mean of n independent samples is 1 / n of one sample's.
    let variances = readings.iter().map(|r| Some(typical / r.0?));
    let variances: Vec<f64> = variances.collect::<Option<_>>()?;
    let [least, most] = range(variances.iter().copied());
    (most > AVERAGED_ALIKE * least).then_some(variances)
}

/// Samples of a typical settled loaded reading; of a loaded one where none settled.
fn typical(readings: &[Averaged]) -> Option<f64> {
    let of = |settled: bool| {
        let kept = readings.iter().filter(|r| r.1 && (r.2 || !settled));
        median(kept.filter_map(|r| r.0))
    };
    of(true).or_else(|| of(false))
}

/// [`averaging_variance`] of readings on a path.
pub(crate) fn averaged_readings(readings: &[Reading]) -> Option<Vec<f64>> {
    let of = |r: &Reading| (r.averaged, !r.rest, r.settled);
    averaging_variance(&readings.iter().map(of).collect::<Vec<_>>())
}

/// [`typical`] of the stated samples of readings on a path.
pub(crate) fn typical_samples(readings: &[Reading]) -> Option<f64> {
    let of = |r: &Reading| (r.samples.map(f64::from), !r.rest, r.settled);
    typical(&readings.iter().map(of).collect::<Vec<_>>())
}

/// Whether a row was read while the stage stood: by its dwell, else by its speed.
fn settled(row: &WhiskerRow) -> bool {
    row.dwell_s.map_or(row.speed_mm_s == Some(0.0), |d| d > 0.0)
}

/// How long a row was averaged: its samples, or, where `moving_variance` is known instead, in units
/// of a settled one's.
fn averaged(row: &WhiskerRow, moving_variance: Option<f64>) -> Option<f64> {
    // Variance goes with 1 / n, so its ratio stands for the number of samples.
    let by_reference = moving_variance.map(|v| if settled(row) { 1.0 } else { 1.0 / v });
    row.samples.map(|n| f64::from(n.max(1))).or(by_reference)
}

/// Variances of a moving reading's noise that are tried, 1 for a settled one's: two a decade.
const MOVING_VARIANCES: [f64; 6] = [3.0, 10.0, 30.0, 100.0, 300.0, 1000.0];
/// Rise of twice the log likelihood from which they are unlike: chance gives as much once in a
/// thousand sessions.
const UNLIKE: f64 = 10.8;

/// The temperature's walk over `rows`; none where they have no clock, no temperature, or it does
/// not scatter. All gratings of a row are averaged alike, and no moment moves the reference: where
/// the rows do not say how many samples they average, its noise shows how much less a moving row
/// is.
pub(crate) fn temperature_walk(rows: &[WhiskerRow], fbg: &FbgSpec) -> Option<RandomWalkModel> {
    let walk = |moving_variance: Option<f64>| {
        let averaged = |r: &WhiskerRow| averaged(r, moving_variance);
        let sizes = rows
            .iter()
            .map(|r| (averaged(r), r.role != Role::Rest, settled(r)));
        let sizes: Vec<Averaged> = sizes.collect();
        let variances = averaging_variance(&sizes).unwrap_or_else(|| vec![1.0; rows.len()]);
        let read = rows
            .iter()
            .zip(variances)
            .map(|(r, variance)| Some([r.t_s?, temperature_of(r, fbg)?, variance]));
        let mut read: Vec<[f64; 3]> = read.collect::<Option<_>>()?;
        read.sort_by(|a, b| a[0].total_cmp(&b[0]));
        let [t_s, degc, variances] =
            [0, 1, 2].map(|c| read.iter().map(|r| r[c]).collect::<Vec<f64>>());
        let mut walk = RandomWalkModel::of(&t_s, &degc, &variances)?;
        walk.moving_variance = moving_variance;
        Some(walk)
    };
    let alike = walk(None)?;
    // A thermometer averages by itself; only a reference grating averages as the sensing ones do.
    let by_reference = fbg.needs_reference() && rows.iter().all(|r| r.reference_shift_pm.is_some());
    if !by_reference || rows.iter().any(|r| r.samples.is_some()) {
        return Some(alike);
    }
    let unlike = MOVING_VARIANCES.iter().filter_map(|v| walk(Some(*v)));
    // Twice the log likelihood decides whether moving rows are unlike.
    let best = unlike.min_by(|a, b| a.misfit.total_cmp(&b.misfit));
    Some(
        best.filter(|b| b.misfit < alike.misfit - UNLIKE)
            .unwrap_or(alike),
    )
}

fn stage_position(row: &WhiskerRow, trajectory: Option<&Trajectory>) -> f64 {
    match (row.stage_mm, row.groove_mm, trajectory) {
        (Some(x), _, _) => x,
        // Of groove = origin + stage direction, with a unit direction.
        (None, Some(groove), Some(t)) => (groove - t.origin_mm).dot(&t.direction),
        _ => 0.0,
    }
}

impl WhiskerPath {
    /// Builds the path of `rows` (points first, then sealed rows) in time order; with `walk` the
    /// temperature is freed of its noise.
    pub fn new(
        rows: &[WhiskerRow],
        trajectories: &[Trajectory],
        fbg: &FbgSpec,
        walk: Option<&RandomWalkModel>,
    ) -> Self {
        let time = !rows.is_empty() && rows.iter().all(|r| r.t_s.is_some());
        let temperature = !rows.is_empty() && rows.iter().all(|r| temperature_of(r, fbg).is_some());
        let mut order: Vec<usize> = (0..rows.len()).collect();
        if time {
            let t_s = |k: usize| rows[k].t_s.unwrap_or_default();
            order.sort_by(|&a, &b| t_s(a).total_cmp(&t_s(b)));
        }
        let line_of =
            |id: Option<u32>| id.and_then(|id| trajectories.iter().position(|t| t.id == id));
        let mut readings: Vec<Reading> = order
            .iter()
            .enumerate()
            .map(|(k, &i)| {
                let r = &rows[i];
                let line = line_of(r.trajectory);
                let direction = r.direction.unwrap_or_default();
                // Standard error of a mean: the samples' deviation over the root of their number.
                let root = f64::from(r.samples.unwrap_or(1).max(1)).sqrt();
                let (sd, degc) = (r.shift_sd_pm.unwrap_or_default(), temperature_of(r, fbg));
                Reading {
                    line,
                    x_mm: stage_position(r, line.map(|l| &trajectories[l])),
                    rest: r.role == Role::Rest,
                    direction,
                    // A row's speed has no sign; unloading goes against the trajectory's direction.
                    velocity_mm_s: r.speed_mm_s.unwrap_or_default()
                        * if direction < 0.0 { -1.0 } else { 1.0 },
                    t_s: if time {
                        r.t_s.unwrap_or_default()
                    } else {
                        k as f64
                    },
                    dwell_s: r.dwell_s.unwrap_or_default(),
                    settled: settled(r),
                    // `t_s` is the middle of the averaging window: half of it is still to come.
                    stays_s: r.average_s.unwrap_or_default() / 2.0,
                    rise_degc: degc.unwrap_or_default(),
                    temperature_loo_degc: degc.unwrap_or_default(),
                    shift_pm: r.compensated_pm(fbg),
                    sample_sd_pm: sd.map(|s| s / root),
                    samples: r.samples,
                    averaged: averaged(r, walk.and_then(|w| w.moving_variance)),
                    group: r.trajectory.unwrap_or(0),
                    holdout: r.sealed,
                    seating: r.seating,
                    unsteady: false,
                }
            })
            .collect();
        if let Some(walk) = walk.filter(|_| temperature && time) {
            let (t_s, read): (Vec<f64>, Vec<f64>) =
                readings.iter().map(|r| (r.t_s, r.rise_degc)).unzip();
            let alike = || vec![1.0; readings.len()];
            let variances = averaged_readings(&readings).unwrap_or_else(alike);
            let levels = walk.smooth(&t_s, &read, &variances);
            for (r, level) in readings.iter_mut().zip(levels) {
                (r.rise_degc, r.temperature_loo_degc) = (level.by_all, level.by_others);
            }
        }
        if time {
            exclude_ramps(&mut readings);
        }
        let loaded = || readings.iter().filter(|r| !r.rest);
        let columns = Columns {
            time,
            temperature,
            both_directions: loaded().any(|r| r.direction < 0.0)
                && loaded().any(|r| r.direction > 0.0),
            speeds: loaded().any(|r| r.velocity_mm_s != 0.0),
            stage: rows
                .iter()
                .all(|r| r.role == Role::Rest || r.stage_mm.is_some()),
        };
        let lines: Vec<Line> = trajectories
            .iter()
            .map(|t| Line {
                origin_mm: t.origin_mm,
                direction: t.direction,
            })
            .collect();
        let extent = |l: usize| {
            let on = readings.iter().filter(|r| r.line == Some(l));
            // Depth 0 is first contact, whether a reading stands there or not.
            range(on.map(|r| r.x_mm).chain([0.0]))
        };
        let ends = (0..lines.len())
            .map(extent)
            .map(|[start, reach]| (start, reach));
        let (start_mm, reach_mm) = ends.unzip();
        let nodes = nodes_of(&readings, time);
        Self {
            readings,
            rows: order,
            nodes,
            lines,
            reach_mm,
            start_mm,
            columns,
        }
    }
}

/// Fewest readings of a stroke whose speed is known.
const MIN_STROKE: usize = 4;
/// Difference from the stroke's speed from which a reading was taken on a ramp, or beside a late
/// answer of the stage.
const STEADY: f64 = 0.05;
/// A stage that is unsteady more often than this is moved by hand: no reading is better than the
/// others.
const MAX_UNSTEADY: f64 = 0.4;

/// Ratios of the speed between two readings and their own from which both belong to one motion.
const ONE_MOTION: [f64; 2] = [0.3, 2.0];

/// Whether two neighbours were read in one motion: passes one after the other have the way back and
/// the dwells between them.
fn one_motion(a: &Reading, b: &Reading) -> bool {
    let [va, vb] = [a, b].map(|r| r.velocity_mm_s);
    let same = a.line == b.line && a.seating == b.seating && va * vb > 0.0;
    let fastest = if va.abs() > vb.abs() { va } else { vb };
    // Passes one after the other lie far apart in time beside the way between them.
    let ratio = (b.x_mm - a.x_mm) / ((b.t_s - a.t_s) * fastest);
    same && (ONE_MOTION[0]..=ONE_MOTION[1]).contains(&ratio)
}

/// Marks readings on the fly whose speed is not that of their stroke: between two answers of the
/// stage its position is interpolated at one speed, which is wrong on a ramp and where an answer
/// came late.
fn exclude_ramps(readings: &mut [Reading]) {
    let (mut off, mut on_the_fly, mut start) = (Vec::new(), 0, 0);
    for stroke in readings.chunk_by(one_motion) {
        let first = start;
        start += stroke.len();
        if stroke.len() < MIN_STROKE {
            continue;
        }
        on_the_fly += stroke.len();
        let mut speeds: Vec<f64> = stroke.iter().map(|r| r.velocity_mm_s.abs()).collect();
        speeds.sort_by(f64::total_cmp);
        // Ramps and late answers make a stage seem slow: its speed is the upper quartile.
        let top = speeds[3 * (speeds.len() - 1) / 4];
        let unsteady = |r: &Reading| (r.velocity_mm_s.abs() / top - 1.0).abs() > STEADY;
        off.extend((first..start).filter(|i| unsteady(&stroke[i - first])));
    }
    if off.len() as f64 <= MAX_UNSTEADY * on_the_fly as f64 {
        off.into_iter().for_each(|i| readings[i].unsteady = true);
    }
}

/// Where the groove was at each reading, mm: between steady readings of one stroke an unsteady
/// one's place is interpolated.
fn places(readings: &[Reading]) -> Vec<f64> {
    let place = |motion: &[Reading], i: usize| {
        let r = &motion[i];
        let before = motion[..i].iter().rfind(|r| !r.unsteady);
        let after = motion[i + 1..].iter().find(|r| !r.unsteady);
        match (before, after) {
            // A stroke has one speed, so its place goes linearly with time.
            (Some(a), Some(b)) if r.unsteady && b.t_s > a.t_s => {
                a.x_mm + (b.x_mm - a.x_mm) * (r.t_s - a.t_s) / (b.t_s - a.t_s)
            }
            _ => r.x_mm,
        }
    };
    let of =
        |motion: &[Reading]| -> Vec<f64> { (0..motion.len()).map(|i| place(motion, i)).collect() };
    readings.chunk_by(one_motion).flat_map(of).collect()
}

/// A settled reading lies in a dwell: its arrival is a node, and so is the end of its averaging
/// window. Changing lines, the groove leaves the wire.
fn nodes_of(readings: &[Reading], time: bool) -> Vec<Node> {
    let mut nodes: Vec<Node> = Vec::with_capacity(2 * readings.len());
    let places_mm = places(readings);
    for (i, r) in readings.iter().enumerate() {
        // Between seatings the whisker was free.
        if i > 0 && readings[i - 1].seating != r.seating {
            let free = |t_s: f64| Node {
                t_s,
                rest: true,
                ..Node::default()
            };
            let arrived_s = r.t_s - r.dwell_s;
            // Moments go linearly between nodes: rest needs a node at both ends of the gap.
            nodes.extend([free(readings[i - 1].t_s + 1e-3), free(arrived_s - 1e-3)]);
        }
        let still = |t_s| Node {
            t_s,
            line: r.line,
            x_mm: places_mm[i],
            rest: r.rest,
            ..Node::default()
        };
        // Creep and lag depend on how long the load has stood: since the arrival.
        if time && r.velocity_mm_s == 0.0 && r.dwell_s > 0.0 {
            // A dwell stated too long must not turn the clock back.
            let earliest = nodes.last().map_or(f64::NEG_INFINITY, |n| n.t_s);
            nodes.push(still((r.t_s - r.dwell_s).max(earliest)));
        }
        nodes.push(Node {
            moving: r.velocity_mm_s != 0.0,
            reading: Some(i),
            ..still(r.t_s)
        });
        let next_s = readings
            .get(i + 1)
            .map_or(f64::INFINITY, |n| n.t_s - n.dwell_s);
        // Without a node at the window's end the groove would leave in the middle of the average.
        if time && r.stays_s > 0.0 && r.t_s + r.stays_s < next_s {
            nodes.push(still(r.t_s + r.stays_s));
        }
    }
    nodes
}

/// A row that says nothing but its shifts.
#[cfg(test)]
pub(crate) fn bare_row(k: usize, t_s: f64, shift_pm: [f64; 2]) -> WhiskerRow {
    WhiskerRow {
        source: String::new(),
        line: k,
        point: k as i64,
        role: Role::Verification,
        trajectory: None,
        replicate: None,
        t_s: Some(t_s),
        stage_mm: None,
        direction: None,
        speed_mm_s: None,
        dwell_s: None,
        average_s: None,
        groove_mm: None,
        temperature_degc: None,
        shift_pm,
        reference_shift_pm: None,
        shift_sd_pm: None,
        samples: None,
        seating: 0,
        sealed: false,
        pair: None,
    }
}

#[cfg(test)]
mod tests {
    use super::{
        Reading, WhiskerPath, WhiskerRow, bare_row, exclude_ramps, places, settled,
        temperature_walk,
    };
    use rand::SeedableRng;
    use rand_distr::{Distribution, StandardNormal};
    use wcal_core::observation::FbgSpec;

    #[test]
    fn rows_are_settled_by_their_dwell_or_their_speed_and_the_stage_states_its_own_positions() {
        let row = |speed_mm_s, dwell_s, stage_mm| WhiskerRow {
            speed_mm_s,
            dwell_s,
            stage_mm,
            ..bare_row(0, 0.0, [0.0; 2])
        };
        assert!(settled(&row(None, Some(2.0), None)) && settled(&row(Some(0.0), None, None)));
        let moving = [(Some(2.0), None), (Some(2.0), Some(0.0)), (None, None)];
        for (speed_mm_s, dwell_s) in moving {
            assert!(
                !settled(&row(speed_mm_s, dwell_s, None)),
                "negative control"
            );
        }
        let states = |stage_mm| {
            let rows = [row(None, None, stage_mm)];
            WhiskerPath::new(&rows, &[], &FbgSpec::default(), None)
                .columns
                .stage
        };
        assert!(states(Some(1.0)) && !states(None));
    }

    /// Of twenty sessions, each of 40 strokes of eight settled and twelve moving rows whose noise
    /// is `sd` times as large: what their reference grating says of the variance.
    fn moving_variances(sd: f64) -> Vec<Option<f64>> {
        let fbg = FbgSpec {
            temperature_pm_per_degc: Some([10.0, 10.0]),
            reference_temperature_pm_per_degc: Some(10.0),
            ..FbgSpec::default()
        };
        let of = |seed: u64| {
            let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
            let mut normal = || -> f64 { StandardNormal.sample(&mut rng) };
            let (mut t_s, mut level) = (0.0, 0.0);
            let mut row = |k: usize| {
                let moving = k % 20 >= 8;
                let step_s: f64 = if moving { 0.1 } else { 4.0 };
                t_s += step_s;
                level += 0.1 * step_s.sqrt() * normal();
                let noise = if moving { sd } else { 1.0 } * normal();
                WhiskerRow {
                    dwell_s: Some(if moving { 0.0 } else { 3.0 }),
                    reference_shift_pm: Some(level + noise),
                    ..bare_row(k, t_s, [0.0; 2])
                }
            };
            let rows: Vec<WhiskerRow> = (0..800).map(&mut row).collect();
            temperature_walk(&rows, &fbg).unwrap().moving_variance
        };
        (0..20).map(of).collect()
    }

    #[test]
    fn the_reference_grating_shows_how_much_less_moving_rows_are_averaged() {
        let found = moving_variances(10.0);
        assert!(
            found
                .iter()
                .all(|v| v.is_some_and(|v| (30.0..=300.0).contains(&v))),
            "{found:?}"
        );
        // Control: rows that are averaged alike.
        assert_eq!(moving_variances(1.0), [None; 20]);
    }

    fn reading(t_s: f64, x_mm: f64, velocity_mm_s: f64) -> Reading {
        Reading {
            line: Some(0),
            x_mm,
            rest: false,
            direction: 1.0,
            velocity_mm_s,
            t_s,
            dwell_s: 0.0,
            settled: false,
            stays_s: 0.0,
            rise_degc: 0.0,
            temperature_loo_degc: 0.0,
            shift_pm: [0.0; 2],
            sample_sd_pm: [0.0; 2],
            samples: Some(10),
            averaged: Some(10.0),
            group: 1,
            holdout: false,
            seating: 0,
            unsteady: false,
        }
    }

    fn marked(mut readings: Vec<Reading>) -> (Vec<usize>, Vec<f64>) {
        exclude_ramps(&mut readings);
        (
            (0..readings.len())
                .filter(|&i| readings[i].unsteady)
                .collect(),
            places(&readings),
        )
    }

    #[test]
    fn a_late_answer_of_the_stage_is_marked_and_its_place_interpolated() {
        // 2 mm/s, read every 0.1 s; the fourth answer came late: the stage seems to have stood
        // back.
        let mut stroke: Vec<Reading> = (0..8)
            .map(|k| reading(0.1 * f64::from(k), 0.2 * f64::from(k), 2.0))
            .collect();
        assert!(marked(stroke.clone()).0.is_empty(), "a steady stroke");
        (stroke[3].x_mm, stroke[3].velocity_mm_s) = (0.5, 1.0);
        let (unsteady, places) = marked(stroke);
        assert_eq!(unsteady, [3]);
        assert!((places[3] - 0.6).abs() < 1e-12, "{places:?}");
    }

    #[test]
    fn passes_at_several_speeds_and_a_stage_moved_by_hand_are_left_alone() {
        // Each reading belongs to a separate pass, with the way back in between.
        let passes = [
            (10.0, 1.0, 2.0),
            (20.0, 2.0, 8.0),
            (30.0, 3.0, 2.0),
            (40.0, 4.0, 8.0),
            (50.0, 5.0, 2.0),
        ];
        assert!(
            marked(passes.iter().map(|p| reading(p.0, p.1, p.2)).collect())
                .0
                .is_empty()
        );
        let by_hand = [
            (0.0, 0.0, 1.0),
            (0.1, 0.12, 1.4),
            (0.2, 0.28, 1.8),
            (0.3, 0.43, 1.2),
            (0.4, 0.52, 0.7),
        ];
        assert!(
            marked(by_hand.iter().map(|p| reading(p.0, p.1, p.2)).collect())
                .0
                .is_empty()
        );
    }
}
