//! What `wcal verify --dry-run` says of a session: counts, what is absent and what that hides, and
//! what its reader warned of.

use crate::session::LoadedSession;
use crate::warning::WarningKind;
use schemars::JsonSchema;
use serde::Serialize;
use std::collections::{BTreeMap, BTreeSet, HashMap};
use wcal_core::{Role, SessionData, TransducerModel, TransducerRow, WhiskerData, WhiskerRow};

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
    /// What was checked: `rows`, `trajectories`, `columns`, `noise`, `holdout`, `time` or `files`.
    pub topic: String,
    /// One plain sentence.
    pub message: String,
}

/// A quantity, whether it is there, and the effects that need it.
type Quantity = (&'static str, bool, &'static str);

/// Directions follow from rows in the order in which they were taken.
const BY_TIME: &str = "drift, creep, lag and step in time";
const BY_ORDER: &str =
    "where the order of the rows does not show rising and falling values, hysteresis and backlash";

/// What the checks ask of a row, readings of one pose ought to agree but for noise: role and pose.
type Seen = (Role, Vec<u64>);

fn seen(role: Role, pose: &[f64]) -> Seen {
    (role, pose.iter().map(|v| v.to_bits()).collect())
}

/// Finds what deserves saying about a session that [`crate::load`] accepted.
pub fn examine(session: &LoadedSession) -> Vec<Finding> {
    let mut list = Vec::new();
    let mut add = |severity, topic: &str, message: String| {
        list.push(Finding {
            severity,
            topic: topic.to_owned(),
            message,
        });
    };
    let sealed = session.sealed.len();
    let (rows, columns): (Vec<Seen>, _) = match &session.data {
        SessionData::Whisker(data) => {
            let pose = |r: &WhiskerRow| {
                // Direction and speed are part of a pose: friction and delay change the reading of
                // one place.
                let g = r.groove_mm.unwrap_or_default();
                let [direction, speed] = [r.direction, r.speed_mm_s].map(|v| v.unwrap_or(0.0));
                seen(r.role, &[g.x, g.y, g.z, direction, speed])
            };
            (data.rows.iter().map(pose).collect(), whisker_columns(data))
        }
        SessionData::Transducer(data) => {
            let rows = &data.rows;
            let pose = |r: &TransducerRow| seen(r.role, &[r.stimulus, r.direction.unwrap_or(0.0)]);
            let has = |of: fn(&TransducerRow) -> bool| rows.iter().any(of);
            let mut columns = vec![
                ("t_s", has(|r| r.t_s.is_some()), BY_TIME),
                ("direction", has(|r| r.direction.is_some()), BY_ORDER),
                (
                    "temperature_degc",
                    has(|r| r.temperature_degc.is_some()),
                    "temperature",
                ),
            ];
            if data.model == TransducerModel::Axis {
                let cycle = has(|r| r.replicate.is_some());
                columns.insert(2, ("cycle", cycle, "changes from stroke to stroke"));
            } else {
                let further = !data.covariates.is_empty();
                columns.push(("a further covariate", further, "cross-axis"));
            }
            (rows.iter().map(pose).collect(), columns)
        }
    };
    let at_rest = rows.iter().filter(|r| r.0 == Role::Rest).count();
    add(
        Severity::Ok,
        "rows",
        format!(
            "{} rows to fit ({at_rest} at rest), {sealed} sealed",
            rows.len()
        ),
    );
    if at_rest == rows.len() {
        add(
            Severity::Error,
            "rows",
            "every row is at rest: nothing can be fitted".to_owned(),
        );
    }
    if let SessionData::Whisker(data) = &session.data {
        let loaded = data.rows.iter().filter(|r| r.role != Role::Rest);
        let paths = loaded
            .filter_map(|r| r.trajectory)
            .collect::<BTreeSet<_>>()
            .len();
        if paths < 3 {
            let message = format!("{paths} trajectories: leaving one out needs three");
            add(Severity::Warn, "trajectories", message);
        }
        if at_rest == 0 {
            add(
                Severity::Warn,
                "rows",
                "no row at rest: the zero is extrapolated".to_owned(),
            );
        }
    }
    for (name, present, hides) in columns {
        if present {
            add(Severity::Ok, "columns", format!("{name} is present"));
        } else {
            let message = format!("{name} is absent: {hides} cannot be traced");
            add(Severity::Note, "columns", message);
        }
    }
    let (severity, message) = noise(&session.data, &rows);
    add(severity, "noise", message);
    let message = match sealed {
        0 => "no holdout: errors are estimated by leaving data out in turn".to_owned(),
        _ => format!("{sealed} sealed rows"),
    };
    add(Severity::Ok, "holdout", message);
    for warning in &session.warnings {
        let (severity, topic) = match warning.kind {
            WarningKind::OpenEnd => (Severity::Note, "files"),
            WarningKind::ClockProblem => (Severity::Warn, "time"),
            _ => (Severity::Warn, "files"),
        };
        add(severity, topic, warning.to_string());
    }
    list
}

fn whisker_columns(data: &WhiskerData) -> Vec<Quantity> {
    let rows = &data.rows;
    let any = |is: fn(&WhiskerRow) -> bool| rows.iter().any(is);
    let temperature = any(|r| r.reference_shift_pm.is_some() || r.temperature_degc.is_some());
    let moving = any(|r| r.speed_mm_s.is_some_and(|v| v > 0.0));
    let averaging = [
        (
            "samples",
            any(|r| r.samples.is_some()),
            "how much shorter moving rows were averaged, where no reference grating shows it,",
        ),
        (
            "average_s",
            any(|r| r.average_s.is_some()),
            "a lag apart from half the averaging time",
        ),
    ];
    let columns = [
        (
            "stage_mm",
            any(|r| r.stage_mm.is_some()),
            "stage-scale, stage-periodic",
        ),
        (
            "unloading (direction -1)",
            any(|r| r.direction == Some(-1.0)),
            "stage-backlash, hysteresis",
        ),
        (
            "dwell_s or speed_mm_s",
            any(|r| r.dwell_s.is_some() || r.speed_mm_s.is_some()),
            "which rows were read in motion, whose noise counts as that of settled ones,",
        ),
        ("a moving row (speed_mm_s above 0)", moving, "time-lag"),
        ("t_s", any(|r| r.t_s.is_some()), "zero-drift, creep"),
        (
            "dwell_s",
            any(|r| r.dwell_s.is_some()),
            "creep within a dwell",
        ),
        (
            "a temperature (fbg_ref_* or temperature_degc)",
            temperature,
            "temperature-mismatch",
        ),
        (
            "[whisker] gravity_direction",
            data.whisker.gravity_direction.is_some(),
            "gravity",
        ),
    ];
    // How long rows were averaged matters for those in motion alone.
    columns
        .into_iter()
        .chain(averaging.into_iter().filter(|_| moving))
        .collect()
}

/// What the noise floor can be taken from: rows that repeat a pose, or trajectories that were run
/// again.
fn noise(data: &SessionData, rows: &[Seen]) -> (Severity, String) {
    let whisker = if let SessionData::Whisker(data) = data {
        data.rows.as_slice()
    } else {
        &[]
    };
    let mut poses: HashMap<&[u64], usize> = HashMap::new();
    for (role, pose) in rows {
        // At rest nothing is pressed: repeats there do not show the noise of a loaded reading.
        if *role != Role::Rest || whisker.is_empty() {
            *poses.entry(pose).or_default() += 1;
        }
    }
    let degrees: usize = poses.values().map(|n| n - 1).sum();
    let mut replicates: BTreeMap<u32, BTreeSet<u32>> = BTreeMap::new();
    for row in whisker.iter().filter(|r| r.role != Role::Rest) {
        if let (Some(id), Some(replicate)) = (row.trajectory, row.replicate) {
            replicates.entry(id).or_default().insert(replicate);
        }
    }
    let again = replicates
        .values()
        .filter(|numbers| numbers.len() > 1)
        .count();
    let within = whisker
        .iter()
        .any(|r| r.shift_sd_pm.is_some() && r.samples.is_some());
    if degrees > 0 {
        let poses = poses.len();
        let text =
            format!("{degrees} degrees of freedom of noise from repeated poses ({poses} poses)");
        return (Severity::Ok, text);
    }
    if again > 0 {
        let how = "trajectories were run again at other poses: noise from neighbours and from rest";
        return (Severity::Ok, format!("{again} {how}"));
    }
    let what = if within {
        "no pose is repeated; only the spread within a reading is known"
    } else {
        "no pose is repeated: the noise floor comes from neighbours and every verdict is provisional"
    };
    (Severity::Warn, what.to_owned())
}
