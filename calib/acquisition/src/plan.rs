//! Sweep plans: what people write, expanded into steps that are carried out one by one.

use crate::error::AcquisitionError;
use crate::limits::Limits;
use crate::rig::Rig;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use wcal_core::Role;
use wcal_core::document::from_toml;
use wcal_core::ranges::Range;
use wcal_core::rig_devices::{Approach, StageRig};

/// `format` of a plan file.
const PLAN_FORMAT: &str = "wcal-plan/1";

/// Readings of some days.
const MAX_STEPS: usize = 100_000;
/// A sync move goes from here to there, mm from first contact, or as far as the limits and the
/// trajectory's own depths allow.
const SYNC_MM: [f64; 2] = [-0.5, 1.0];
/// Depth below which it shows no delay, mm.
const MIN_SYNC_MM: f64 = 0.1;
/// Largest distance of the stage from its target, mm: above a microstep, below any significant
/// error.
pub(crate) const ARRIVAL_MM: f64 = 0.005;
/// A day, s.
const DAY_S: f64 = 86_400.0;

/// Numbers that a plan may state. Depths are held against the rig's limits, too, and speeds against
/// its highest.
const RANGES: &[Range] = &[
    Range::real("settle.gate_pm_per_s", 1e-6, 1e6),
    Range::real("settle.window_s", 1e-3, DAY_S),
    Range::real("settle.timeout_s", 0.0, 7.0 * DAY_S),
    Range::real("soak_s", 0.0, 7.0 * DAY_S),
    Range::real("block.depths_mm", 1e-6, 1e4),
    Range::whole("block.replicates", 1.0, 10_000.0),
    Range::real("block.speeds_mm_s", 1e-6, 1e4),
    Range::real("block.dwell_s", 0.0, 7.0 * DAY_S),
    Range::real("block.average_s", 1e-3, DAY_S),
    Range::real("block.on_the_fly_hz", 0.0, 1e4),
    Range::whole("block.trajectories", 0.0, 4e9),
    // The remaining rows: depths by trajectory.
    Range::real("", 1e-6, 1e4),
];

/// A plan.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Plan {
    /// `wcal-plan/1`.
    pub format: String,
    /// Name; part of the session's identifier.
    pub name: String,
    /// Surrounding medium.
    #[serde(default = "air")]
    pub medium: String,
    /// When the signal counts as settled.
    #[serde(default)]
    pub settle: Settle,
    /// Wait before the first pose until the signal has settled at rest, at most this long, s.
    #[serde(default)]
    pub soak_s: f64,
    /// A small move at start and end that determines the delay between stage and interrogator.
    #[serde(default = "yes")]
    pub sync_move: bool,
    /// Blocks in order.
    pub block: Vec<Block>,
}

fn air() -> String {
    "air".to_owned()
}

fn yes() -> bool {
    true
}

/// Drift gate.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Settle {
    /// Largest drift of a sensing grating, temperature taken out, pm/s.
    pub gate_pm_per_s: f64,
    /// Time over which the drift is judged, s.
    pub window_s: f64,
    /// Longest wait for it after the dwell, s.
    pub timeout_s: f64,
}

impl Default for Settle {
    fn default() -> Self {
        Self {
            gate_pm_per_s: 0.5,
            window_s: 1.0,
            timeout_s: 20.0,
        }
    }
}

/// Poses of one role.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Block {
    /// Role of its rows.
    pub role: Role,
    /// Trajectories, in order.
    pub trajectories: Vec<u32>,
    /// Depths past first contact, mm.
    #[serde(default)]
    pub depths_mm: Vec<f64>,
    /// Depths of single trajectories instead.
    #[serde(default)]
    pub depths_of: BTreeMap<String, Vec<f64>>,
    /// Repetitions of the whole path.
    #[serde(default = "once")]
    pub replicates: u32,
    /// Also during retraction.
    #[serde(default)]
    pub unloading: bool,
    /// Speeds of the moves, mm/s; the path is repeated for each. Empty: the rig's.
    #[serde(default)]
    pub speeds_mm_s: Vec<f64>,
    /// Wait after arrival, s.
    #[serde(default = "default_dwell_s")]
    pub dwell_s: f64,
    /// Averaging window, s.
    #[serde(default = "default_average_s")]
    pub average_s: f64,
    /// Rest reading before each path.
    #[serde(default = "yes")]
    pub rest: bool,
    /// Rows a second while moving from contact to the deepest depth; 0: settled rows only.
    #[serde(default)]
    pub on_the_fly_hz: f64,
}

fn once() -> u32 {
    1
}

fn default_dwell_s() -> f64 {
    2.0
}

fn default_average_s() -> f64 {
    1.0
}

/// One thing to do.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
#[serde(tag = "do", rename_all = "kebab-case")]
pub enum Step {
    /// Wait until the signal has settled.
    Soak,
    /// Show the delay between the devices: out of contact, into it, and back.
    Sync {
        /// Depths, mm: out of contact (negative), and in it.
        depths_mm: [f64; 2],
    },
    /// Turn to a trajectory, retracted.
    Mount {
        /// Trajectory.
        trajectory: u32,
    },
    /// A settled reading.
    Settled(Pose),
    /// Rows while moving from `from_mm` to the pose's depth.
    Moving {
        /// Start of a moving reading, mm.
        from_mm: f64,
        /// Rows a second while moving.
        rows_hz: f64,
        /// End and speed of a moving reading: the keys of a settled one.
        pose: Pose,
    },
}

impl Step {
    /// Depths that the stage is sent to, mm, in order, from where it stands. A sweep commands
    /// these, and its plan is checked by them.
    pub(crate) fn waypoints(&self, at_mm: f64, stage: &StageRig) -> Vec<f64> {
        match self {
            Self::Soak => Vec::new(),
            Self::Sync {
                depths_mm: [away_mm, press_mm],
            } => vec![*away_mm, *press_mm, *away_mm],
            Self::Mount { .. } => vec![stage.retract_mm],
            Self::Settled(pose) => {
                // Backlash: a pose of the loading branch is reached in the direction of loading. At
                // rest nothing is touched.
                let loading = pose.direction > 0 && pose.role != Role::Rest;
                let behind = at_mm > pose.stage_mm + ARRIVAL_MM;
                match stage.approach == Approach::OneSided && loading && behind {
                    true => vec![pose.stage_mm - stage.approach_mm, pose.stage_mm],
                    false => vec![pose.stage_mm],
                }
            }
            Self::Moving { from_mm, pose, .. } => vec![*from_mm, pose.stage_mm],
        }
    }

    /// For messages.
    fn name(&self) -> String {
        match self {
            Self::Soak => "soak".to_owned(),
            Self::Sync { .. } => "sync_move".to_owned(),
            Self::Mount { trajectory } => {
                format!("trajectory {trajectory}, retract before the mount turns")
            }
            Self::Settled(pose) => {
                format!("trajectory {}, depth {} mm", pose.trajectory, pose.stage_mm)
            }
            Self::Moving { pose, .. } => format!("trajectory {}, on the fly", pose.trajectory),
        }
    }
}

/// A pose with all that the rows need.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
pub struct Pose {
    /// Role.
    pub role: Role,
    /// Trajectory.
    pub trajectory: u32,
    /// Repetition, from 1.
    pub replicate: u32,
    /// Depth, mm; negative: away from the wire.
    pub stage_mm: f64,
    /// +1 loading, -1 unloading.
    pub direction: i32,
    /// Speed of the move, mm/s.
    pub speed_mm_s: f64,
    /// Wait after arrival, s.
    pub dwell_s: f64,
    /// Averaging window, s.
    pub average_s: f64,
    /// Belongs to the holdout file; its rest reading too.
    pub sealed: bool,
}

impl Plan {
    /// Parses and checks a plan.
    ///
    /// # Errors
    /// Field, what was expected and what was found; `place` names the file.
    pub fn parse(place: &str, text: &str) -> Result<Self, AcquisitionError> {
        let plan: Self = from_toml(text, PLAN_FORMAT, &[RANGES])
            .map_err(|e| AcquisitionError::document(place, "a plan file", e))?;
        let fail = |field: String, expected: &str, found: String| {
            Err(AcquisitionError::input(
                format!("{place}: {field}"),
                expected,
                found,
            ))
        };
        for (k, block) in plan.block.iter().enumerate() {
            let field = |name: &str| format!("block {}: {name}", k + 1);
            if block.role == Role::Rest {
                return fail(
                    field("role"),
                    "calibration, verification or holdout",
                    "rest".to_owned(),
                );
            }
            if block.trajectories.is_empty() {
                return fail(field("trajectories"), "at least one", "none".to_owned());
            }
            if let Some(id) = block
                .trajectories
                .iter()
                .find(|id| block.depths(**id).is_empty())
            {
                return fail(
                    field("depths_mm"),
                    "at least one depth",
                    format!("none (trajectory {id})"),
                );
            }
        }
        // Counted before anything is expanded: a slip in `replicates` would fill the memory.
        let steps = plan.block.iter().map(Block::count).sum::<usize>();
        if steps > MAX_STEPS {
            let expected =
                format!("replicates, speeds and depths that make at most {MAX_STEPS} readings");
            return fail("block".to_owned(), &expected, steps.to_string());
        }
        if plan.block.is_empty() {
            return fail("block".to_owned(), "at least one", "none".to_owned());
        }
        Ok(plan)
    }

    /// Steps in order. Every position that a step commands is checked against the rig's limits
    /// within the unit's travel, mm.
    ///
    /// # Errors
    /// Trajectories the rig lacks, and moves outside its limits.
    pub fn steps(&self, rig: &Rig, travel_mm: [f64; 2]) -> Result<Vec<Step>, AcquisitionError> {
        let limits = Limits::new(&rig.stage, travel_mm);
        limits.check("rig: stage.retract_mm", rig.stage.retract_mm)?;
        let mut steps = Vec::new();
        if self.soak_s > 0.0 {
            steps.push(Step::Soak);
        }
        let ends = |end: Option<&Block>, pick: fn(&[u32]) -> Option<&u32>| {
            end.and_then(|b| pick(&b.trajectories))
                .copied()
                .filter(|_| self.sync_move)
        };
        if let Some(trajectory) = ends(self.block.first(), <[u32]>::first) {
            steps.extend([Step::Mount { trajectory }, self.sync(trajectory, &limits)?]);
        }
        for block in &self.block {
            for trajectory in &block.trajectories {
                if rig.trajectory(*trajectory).is_none() {
                    let found = format!("trajectory {trajectory}");
                    return Err(AcquisitionError::input(
                        "plan: trajectories",
                        "trajectories of the rig",
                        found,
                    ));
                }
                steps.push(Step::Mount {
                    trajectory: *trajectory,
                });
                block.path(*trajectory, rig, &mut steps)?;
            }
        }
        if let Some(trajectory) = ends(self.block.last(), <[u32]>::last) {
            steps.push(self.sync(trajectory, &limits)?);
        }
        // From pose to pose, as the stage will go: a one-sided approach passes its target.
        let mut at_mm = rig.stage.retract_mm;
        for step in &steps {
            for depth_mm in step.waypoints(at_mm, &rig.stage) {
                limits.check(&format!("plan: {}", step.name()), depth_mm)?;
                at_mm = depth_mm;
            }
        }
        Ok(steps)
    }

    /// The sync move of a trajectory: within the limits, and no deeper than the plan itself goes
    /// there.
    fn sync(&self, trajectory: u32, limits: &Limits) -> Result<Step, AcquisitionError> {
        let own = self
            .block
            .iter()
            .filter(|b| b.trajectories.contains(&trajectory));
        let deepest_mm = own
            .flat_map(|b| b.depths(trajectory))
            .copied()
            .fold(0.0, f64::max);
        let [low_mm, high_mm] = limits.depths_mm();
        let (away_mm, press_mm) = (
            SYNC_MM[0].max(low_mm),
            SYNC_MM[1].min(high_mm).min(deepest_mm),
        );
        if away_mm <= 0.0 && press_mm >= MIN_SYNC_MM {
            return Ok(Step::Sync {
                depths_mm: [away_mm, press_mm],
            });
        }
        let expected = format!(
            "limits and depths of trajectory {trajectory} that reach from first contact to {MIN_SYNC_MM} mm (or sync_move = false)"
        );
        let found = format!("depths of {away_mm:.3}..{press_mm:.3} mm");
        Err(AcquisitionError::input("plan: sync_move", expected, found))
    }
}

impl Block {
    /// Readings at most.
    fn count(&self) -> usize {
        // Loading and unloading of each depth, a rest reading, and two moves on the fly.
        let once = |id: &u32| 2 * self.depths(*id).len() + 3;
        let paths = (self.replicates as usize).saturating_mul(self.speeds_mm_s.len().max(1));
        self.trajectories
            .iter()
            .map(once)
            .sum::<usize>()
            .saturating_mul(paths)
    }

    fn depths(&self, trajectory: u32) -> &[f64] {
        self.depths_of
            .get(&trajectory.to_string())
            .unwrap_or(&self.depths_mm)
    }

    /// Rest, loading, unloading, for every speed and replicate.
    fn path(
        &self,
        trajectory: u32,
        rig: &Rig,
        steps: &mut Vec<Step>,
    ) -> Result<(), AcquisitionError> {
        let own = [rig.stage.speed_mm_s];
        let speeds = if self.speeds_mm_s.is_empty() {
            &own[..]
        } else {
            &self.speeds_mm_s
        };
        if let Some(fast) = speeds
            .iter()
            .find(|s| !(**s > 0.0 && **s <= rig.stage.speed_mm_s))
        {
            let expected = format!("speeds up to the rig's {} mm/s", rig.stage.speed_mm_s);
            return Err(AcquisitionError::input(
                "plan: speeds_mm_s",
                expected,
                fast.to_string(),
            ));
        }
        let mut replicate = 0;
        for _ in 0..self.replicates {
            for speed in speeds {
                // Each pass has its own number: no two rows share pose and repetition.
                replicate += 1;
                let pose = |stage_mm: f64, direction: i32| Pose {
                    role: self.role,
                    trajectory,
                    replicate,
                    stage_mm,
                    direction,
                    speed_mm_s: *speed,
                    dwell_s: self.dwell_s,
                    average_s: self.average_s,
                    sealed: self.role == Role::Holdout,
                };
                // A rest reading before each pass shows how the zero drifts.
                if self.rest {
                    steps.push(Step::Settled(Pose {
                        role: Role::Rest,
                        ..pose(rig.stage.retract_mm, 1)
                    }));
                }
                let depths = self.depths(trajectory);
                steps.extend(depths.iter().map(|d| Step::Settled(pose(*d, 1))));
                // The deepest pose is not repeated: there loading ends and unloading begins.
                if self.unloading {
                    steps.extend(
                        depths
                            .iter()
                            .rev()
                            .skip(1)
                            .map(|d| Step::Settled(pose(*d, -1))),
                    );
                }
                if self.on_the_fly_hz > 0.0 {
                    let deepest = depths.iter().copied().fold(0.0, f64::max);
                    let rows_hz = self.on_the_fly_hz;
                    // Readings in motion carry the stream's delay: the map is not fitted to them.
                    let role = if self.role == Role::Calibration {
                        Role::Verification
                    } else {
                        self.role
                    };
                    let moving = |from: f64, to: f64, direction: i32| Step::Moving {
                        from_mm: from,
                        rows_hz,
                        pose: Pose {
                            role,
                            ..pose(to, direction)
                        },
                    };
                    steps.push(moving(0.0, deepest, 1));
                    steps.push(moving(deepest, 0.0, -1));
                }
            }
        }
        Ok(())
    }
}

/// Rough time that the steps take, s.
pub fn duration_s(steps: &[Step], rig: &Rig, plan: &Plan) -> f64 {
    let mut at_mm = rig.stage.retract_mm;
    steps
        .iter()
        .map(|step| match step {
            Step::Soak => plan.soak_s,
            Step::Sync { .. } => 3.0,
            Step::Mount { .. } => {
                let away = (at_mm - rig.stage.retract_mm).abs() / rig.stage.speed_mm_s;
                at_mm = rig.stage.retract_mm;
                away + 1.0
            }
            Step::Settled(pose) => {
                let travel = (pose.stage_mm - at_mm).abs() / pose.speed_mm_s;
                at_mm = pose.stage_mm;
                travel + pose.dwell_s + pose.average_s
            }
            Step::Moving { from_mm, pose, .. } => {
                let travel = (from_mm - at_mm).abs() + (pose.stage_mm - from_mm).abs();
                at_mm = pose.stage_mm;
                travel / pose.speed_mm_s + 0.5
            }
        })
        .sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    const PLAN: &str = "format = \"wcal-plan/1\"\nname = \"p\"\n[[block]]\nrole = \"calibration\"\ntrajectories = [1]\ndepths_mm = [1, 3, 5]\n";

    fn rig() -> Rig {
        Rig::parse("rig.toml", super::super::rig::tests::RIG).unwrap()
    }

    #[test]
    fn a_block_becomes_rest_loading_unloading_and_moving_steps() {
        let text = format!(
            "{PLAN}unloading = true\nreplicates = 2\nspeeds_mm_s = [2, 6]\non_the_fly_hz = 20\n"
        );
        let steps = Plan::parse("plan.toml", &text)
            .unwrap()
            .steps(&rig(), [0.0, 101.6])
            .unwrap();
        let settled = steps
            .iter()
            .filter(|s| matches!(s, Step::Settled(_)))
            .count();
        let moving = steps
            .iter()
            .filter(|s| matches!(s, Step::Moving { .. }))
            .count();
        assert_eq!((settled, moving), (4 * (1 + 3 + 2), 4 * 2));
        let sync = Step::Sync {
            depths_mm: [-0.5, 1.0],
        };
        assert_eq!(steps.iter().filter(|s| **s == sync).count(), 2);
    }

    /// Every position that the steps command, mm of the stage's own scale.
    fn commanded(steps: &[Step], rig: &Rig) -> Vec<f64> {
        let mut at_mm = rig.stage.retract_mm;
        let mut all = vec![at_mm];
        for step in steps {
            all.extend(step.waypoints(at_mm, &rig.stage));
            at_mm = *all.last().unwrap();
        }
        all.iter().map(|mm| rig.stage.zero_mm + mm).collect()
    }

    #[test]
    fn every_commanded_move_is_inside_the_limits_or_the_plan_is_refused_by_name() {
        let steps = |limits: &str, rig_extra: &str, plan: &str| {
            let text = super::super::rig::tests::RIG
                .replace("[0, 40]", limits)
                .replace("retract_mm = -2", &format!("retract_mm = -2\n{rig_extra}"));
            let rig = Rig::parse("rig.toml", &text).unwrap();
            let steps = Plan::parse("plan.toml", plan)?.steps(&rig, [0.0, 101.6])?;
            Ok::<_, AcquisitionError>((commanded(&steps, &rig), steps))
        };
        let shallow = PLAN.replace("[1, 3, 5]", "[0.2]");
        // A sync move of 1 mm would leave these limits: it is shortened to what the plan itself
        // does.
        let (all, _) = steps("[17.9, 20.25]", "", &shallow).unwrap();
        assert!(all.iter().all(|mm| (17.9..=20.25).contains(mm)), "{all:?}");
        // Control: where there is room, it is as long as ever.
        let (_, free) = steps("[0, 40]", "", PLAN).unwrap();
        assert!(free.contains(&Step::Sync {
            depths_mm: [-0.5, 1.0]
        }));
        // From 3 mm to 0.5 mm the stage passes by 3 mm and comes back in the direction of loading:
        // it is sent to -2.5 mm.
        let one_sided = "approach = \"one-sided\"\napproach_mm = 3.0";
        let back = PLAN.replace("[1, 3, 5]", "[3, 0.5]");
        for (limits, extra, plan, word) in [
            (
                "[17.9, 20.05]",
                "",
                shallow.replace("[0.2]", "[0.04]"),
                "plan: sync_move",
            ),
            ("[18, 20]", "", PLAN.to_owned(), "plan: sync_move"),
            ("[18, 22]", "", PLAN.to_owned(), "depth 3 mm"),
            (
                "[17.9, 40]",
                one_sided,
                back.clone(),
                "trajectory 1, depth 0.5 mm",
            ),
        ] {
            let error = steps(limits, extra, &plan).unwrap_err().to_string();
            assert!(error.contains(word), "{word}: {error}");
        }
        let (all, _) = steps("[17, 40]", one_sided, &back).unwrap();
        assert!(
            all.contains(&17.5),
            "control: with room the approach is one of the moves: {all:?}"
        );
    }

    #[test]
    fn plans_outside_the_rig_are_refused_before_anything_moves() {
        let plan = |from: &str, to: &str| {
            Plan::parse("plan.toml", &PLAN.replace(from, to))
                .and_then(|p| p.steps(&rig(), [0.0, 101.6]))
        };
        assert!(plan("", "").is_ok());
        for (from, to, word) in [
            ("5]", "50]", "stage position"),
            ("[1]", "[7]", "trajectories of the rig"),
            ("[1, 3, 5]", "[1, -3]", "block #1.depths_mm #2"),
            ("[1, 3, 5]", "[]", "at least one depth"),
            ("wcal-plan/1", "wcal-plan/3", "wcal-plan/1"),
            (
                "depths_mm = [1, 3, 5]",
                "depths_mm = [1]\nspeeds_mm_s = [99]",
                "speeds up to",
            ),
            ("depths_mm", "depth_mm", "plan file"),
        ] {
            let error = plan(from, to).unwrap_err().to_string();
            assert!(error.contains(word), "{word}: {error}");
        }
    }
}
