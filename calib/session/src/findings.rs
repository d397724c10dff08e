//! What `wcal verify --check` says of a session: counts, what is absent and what that hides, and what its reader warned of.

use crate::session::LoadedSession;
use schemars::JsonSchema;
use serde::Serialize;
use std::collections::{BTreeMap, BTreeSet, HashMap};
use wcal_core::{AxisData, Role, SessionData, TransducerData, WhiskerData};

/// How much a finding matters.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Severity {
    /// As it should be.
    Ok,
    /// As it is; limits what can be traced.
    Note,
    /// Usable, with something lost.
    Warn,
    /// Not usable for its purpose.
    Error,
}

/// One finding.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, JsonSchema)]
pub struct Finding {
    /// How much it matters.
    pub severity: Severity,
    /// What was checked, e.g. `rows`, `columns`, `noise`, `time`, `duplicates`, `holdout`.
    pub topic: String,
    /// One plain sentence.
    pub message: String,
}

/// Finds what deserves saying about a session that [`crate::load`] accepted.
pub fn examine(session: &LoadedSession) -> Vec<Finding> {
    let mut list = Findings::default();
    let columns = match &session.data {
        SessionData::Whisker(data) => whisker_columns(data),
        SessionData::Transducer(data) => transducer_columns(data),
        SessionData::Axis(data) => axis_columns(data),
    };
    counts(session, &mut list);
    for column in columns {
        if column.present {
            list.add(Severity::Ok, "columns", format!("{} is present", column.name));
        } else {
            list.add(
                Severity::Note,
                "columns",
                format!("{} is absent: {} cannot be traced", column.name, column.hides),
            );
        }
    }
    noise(&session.data, &mut list);
    time(session, &mut list);
    sealed(&session.data, &mut list);
    for warning in session.warnings.iter().filter(|w| !w.is_clock_problem()) {
        let severity = if warning.is_remark() { Severity::Note } else { Severity::Warn };
        list.add(severity, "files", warning.to_string());
    }
    list.0
}

#[derive(Default)]
struct Findings(Vec<Finding>);

impl Findings {
    fn add(&mut self, severity: Severity, topic: &str, message: String) {
        self.0.push(Finding { severity, topic: topic.to_owned(), message });
    }
}

/// A quantity and the effects that need it.
struct RequiredQuantity {
    name: &'static str,
    present: bool,
    hides: &'static str,
}

fn needed(name: &'static str, present: bool, hides: &'static str) -> RequiredQuantity {
    RequiredQuantity { name, present, hides }
}

fn whisker_columns(data: &WhiskerData) -> Vec<RequiredQuantity> {
    let rows = &data.rows;
    let unloading = rows.iter().any(|r| r.direction == Some(-1.0));
    let moving = rows.iter().any(|r| r.speed_mm_s.is_some_and(|v| v > 0.0));
    let reference = rows.iter().any(|r| r.reference_shift_pm.is_some());
    let thermometer = rows.iter().any(|r| r.temperature_degc.is_some());
    vec![
        needed("stage_mm", rows.iter().any(|r| r.stage_mm.is_some()), "stage-scale, stage-periodic"),
        needed("unloading (direction -1)", unloading, "stage-backlash, hysteresis"),
        needed("a moving row (speed_mm_s above 0)", moving, "time-lag"),
        needed("t_s", rows.iter().any(|r| r.t_s.is_some()), "zero-drift, creep"),
        needed("dwell_s", rows.iter().any(|r| r.dwell_s.is_some()), "creep within a dwell"),
        needed(
            "a temperature (fbg_ref_* or temperature_degc)",
            reference || thermometer,
            "temperature-mismatch",
        ),
        needed("[whisker] gravity_direction", data.whisker.gravity_direction.is_some(), "gravity"),
    ]
}

fn transducer_columns(data: &TransducerData) -> Vec<RequiredQuantity> {
    let rows = &data.rows;
    vec![
        needed("t_s", rows.iter().any(|r| r.t_s.is_some()), "drift, creep, lag and step in time"),
        needed("direction", rows.iter().any(|r| r.direction.is_some()), "hysteresis, backlash"),
        needed("temperature_degc", rows.iter().any(|r| r.temperature_degc.is_some()), "temperature"),
        needed("a further covariate", !data.covariates.is_empty(), "cross-axis"),
    ]
}

fn axis_columns(data: &AxisData) -> Vec<RequiredQuantity> {
    let rows = &data.rows;
    vec![
        needed("t_s", rows.iter().any(|r| r.t_s.is_some()), "drift, creep, lag and step in time"),
        needed("direction", rows.iter().any(|r| r.direction.is_some()), "backlash, hysteresis"),
        needed("cycle", rows.iter().any(|r| r.cycle.is_some()), "changes from stroke to stroke"),
        needed("temperature_degc", rows.iter().any(|r| r.temperature_degc.is_some()), "temperature"),
    ]
}

fn role_name(role: Role) -> &'static str {
    match role {
        Role::Rest => "rest",
        Role::Calibration => "calibration",
        Role::Verification => "verification",
        Role::Holdout => "holdout",
    }
}

fn counts(session: &LoadedSession, list: &mut Findings) {
    let (roles, holdout): (Vec<Role>, usize) = match &session.data {
        SessionData::Whisker(d) => (d.rows.iter().map(|r| r.role).collect(), d.holdout.len()),
        SessionData::Transducer(d) => (d.rows.iter().map(|r| r.role).collect(), d.holdout.len()),
        SessionData::Axis(d) => (d.rows.iter().map(|r| r.role).collect(), d.holdout.len()),
    };
    let mut by_role: BTreeMap<&str, usize> = BTreeMap::new();
    for role in &roles {
        *by_role.entry(role_name(*role)).or_default() += 1;
    }
    let parts: Vec<String> = by_role.iter().map(|(role, n)| format!("{n} {role}")).collect();
    list.add(
        Severity::Ok,
        "rows",
        format!("{} rows to fit ({}), {holdout} sealed", roles.len(), parts.join(", ")),
    );
    if by_role.keys().all(|role| *role == "rest") {
        list.add(Severity::Error, "rows", "every row is at rest: nothing can be fitted".to_owned());
    }
    if let SessionData::Whisker(data) = &session.data {
        trajectories(data, list);
    }
}

fn trajectories(data: &WhiskerData, list: &mut Findings) {
    let mut by_path: BTreeMap<u32, usize> = BTreeMap::new();
    for id in data.rows.iter().filter(|r| r.role != Role::Rest).filter_map(|r| r.trajectory) {
        *by_path.entry(id).or_default() += 1;
    }
    let parts: Vec<String> = by_path.iter().map(|(id, n)| format!("{id}: {n}")).collect();
    list.add(Severity::Ok, "trajectories", format!("readings by trajectory: {}", parts.join(", ")));
    if by_path.len() < 3 {
        let message = format!("{} trajectories: leaving one out needs three", by_path.len());
        list.add(Severity::Warn, "trajectories", message);
    }
    if !data.rows.iter().any(|r| r.role == Role::Rest) {
        list.add(Severity::Warn, "rows", "no row at rest: the zero is extrapolated".to_owned());
    }
}

/// Bits of a number, so that equal means exactly equal.
fn bits(value: f64) -> u64 {
    value.to_bits()
}

/// Rows that repeat a pose: what the noise floor can be taken from.
fn noise(data: &SessionData, list: &mut Findings) {
    let mut poses: HashMap<Vec<u64>, usize> = HashMap::new();
    let mut note = |key: Vec<u64>| *poses.entry(key).or_default() += 1;
    let single_sd = match data {
        SessionData::Whisker(d) => {
            for r in d.rows.iter().filter(|r| r.role != Role::Rest) {
                let groove = r.groove_mm.unwrap_or_default();
                let way = [r.direction.unwrap_or(0.0), r.speed_mm_s.unwrap_or(0.0)];
                note(groove.iter().chain(&way).map(|v| bits(*v)).collect());
            }
            d.rows.iter().any(|r| r.shift_sd_pm.is_some() && r.samples.is_some())
        }
        SessionData::Transducer(d) => {
            d.rows.iter().for_each(|r| note(vec![bits(r.stimulus), bits(r.direction.unwrap_or(0.0))]));
            false
        }
        SessionData::Axis(d) => {
            d.rows.iter().for_each(|r| note(vec![bits(r.commanded_mm), bits(r.direction.unwrap_or(0.0))]));
            false
        }
    };
    let degrees: usize = poses.values().map(|n| n - 1).sum();
    let again = repeated_trajectories(data);
    if degrees > 0 {
        let message =
            format!("{degrees} degrees of freedom of noise from repeated poses ({} poses)", poses.len());
        list.add(Severity::Ok, "noise", message);
    } else if again > 0 {
        let message = format!(
            "{again} trajectories were run again at other poses: noise from neighbours and from rest"
        );
        list.add(Severity::Ok, "noise", message);
    } else if single_sd {
        let message = "no pose is repeated; only the spread within a reading is known".to_owned();
        list.add(Severity::Warn, "noise", message);
    } else {
        let message =
            "no pose is repeated: the noise floor comes from neighbours and every verdict is provisional";
        list.add(Severity::Warn, "noise", message.to_owned());
    }
}

/// Trajectories with more than one replicate number.
fn repeated_trajectories(data: &SessionData) -> usize {
    let SessionData::Whisker(data) = data else { return 0 };
    let mut replicates: BTreeMap<u32, BTreeSet<u32>> = BTreeMap::new();
    for row in data.rows.iter().filter(|r| r.role != Role::Rest) {
        if let (Some(id), Some(replicate)) = (row.trajectory, row.replicate) {
            replicates.entry(id).or_default().insert(replicate);
        }
    }
    replicates.values().filter(|numbers| numbers.len() > 1).count()
}

fn time(session: &LoadedSession, list: &mut Findings) {
    let mut clean = true;
    for warning in session.warnings.iter().filter(|w| w.is_clock_problem()) {
        list.add(Severity::Warn, "time", warning.to_string());
        clean = false;
    }
    let timed = match &session.data {
        SessionData::Whisker(d) => d.rows.iter().any(|r| r.t_s.is_some()),
        SessionData::Transducer(d) => d.rows.iter().any(|r| r.t_s.is_some()),
        SessionData::Axis(d) => d.rows.iter().any(|r| r.t_s.is_some()),
    };
    if clean && timed {
        list.add(Severity::Ok, "time", "time runs forward in file order".to_owned());
    }
}

fn sealed(data: &SessionData, list: &mut Findings) {
    let count = match data {
        SessionData::Whisker(d) => d.holdout.len(),
        SessionData::Transducer(d) => d.holdout.len(),
        SessionData::Axis(d) => d.holdout.len(),
    };
    let message = match count {
        0 => "no holdout: errors are estimated by leaving data out in turn".to_owned(),
        _ => format!("{count} sealed rows"),
    };
    list.add(Severity::Ok, "holdout", message);
}
