//! Sweep plans: what people write, expanded into steps that are carried out one by one.

use crate::error::AcquisitionError;
use crate::rig::Rig;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use wcal_core::Role;
use wcal_core::document::from_toml;
use wcal_core::ranges::Range;

/// `format` of a plan file.
pub const PLAN_FORMAT: &str = "wcal-plan/1";

/// Readings of some days.
const MAX_STEPS: usize = 100_000;
/// A day, s.
const DAY_S: f64 = 86_400.0;

/// Numbers that a plan may state. Depths are held against the rig's limits, too, and speeds against its highest.
const RANGES: &[Range] = &[
    Range::real("settle.gate_pm_per_s", 1e-6, 1e6),
    Range::real("settle.window_s", 1e-3, DAY_S),
    Range::real("settle.timeout_s", 0.0, 7.0 * DAY_S),
    Range::real("soak_s", 0.0, 7.0 * DAY_S),
    // More attitudes add no information, and a person cannot hold them all.
    Range::whole("board_views", 0.0, 100.0),
    Range::real("block.depths_mm", 1e-6, 1e4),
    Range::whole("block.replicates", 1.0, 10_000.0),
    Range::real("block.speeds_mm_s", 1e-6, 1e4),
    Range::real("block.dwell_s", 0.0, 7.0 * DAY_S),
    Range::real("block.average_s", 1e-3, DAY_S),
    Range::real("block.on_the_fly_hz", 0.0, 1e4),
    Range::whole("block.trajectories", 0.0, 4e9),
    // What is left: depths by trajectory.
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
    /// Attitudes of the calibration board that are pictured before anything moves; 0: none.
    #[serde(default)]
    pub board_views: u32,
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
        Self { gate_pm_per_s: 0.5, window_s: 1.0, timeout_s: 20.0 }
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
    /// Show the delay between the devices.
    Sync,
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
            Err(AcquisitionError::input(format!("{place}: {field}"), expected, found))
        };
        for (k, block) in plan.block.iter().enumerate() {
            let field = |name: &str| format!("block {}: {name}", k + 1);
            if block.role == Role::Rest {
                return fail(field("role"), "calibration, verification or holdout", "rest".to_owned());
            }
            if block.trajectories.is_empty() {
                return fail(field("trajectories"), "at least one", "none".to_owned());
            }
            if let Some(id) = block.trajectories.iter().find(|id| block.depths(**id).is_empty()) {
                return fail(field("depths_mm"), "at least one depth", format!("none (trajectory {id})"));
            }
        }
        let steps = plan.block.iter().map(Block::count).sum::<usize>();
        if steps > MAX_STEPS {
            let expected = format!("replicates, speeds and depths that make at most {MAX_STEPS} readings");
            return fail("block".to_owned(), &expected, steps.to_string());
        }
        if plan.block.is_empty() {
            return fail("block".to_owned(), "at least one", "none".to_owned());
        }
        Ok(plan)
    }

    /// Steps in order, checked against the rig.
    ///
    /// # Errors
    /// Trajectories the rig lacks, and positions outside its limits.
    pub fn steps(&self, rig: &Rig, travel_mm: [f64; 2]) -> Result<Vec<Step>, AcquisitionError> {
        let mut steps = Vec::new();
        if self.soak_s > 0.0 {
            steps.push(Step::Soak);
        }
        rig.check_depth("rig: stage.retract_mm", rig.stage.retract_mm, travel_mm)?;
        let first = self.block.first().and_then(|b| b.trajectories.first()).copied();
        if let Some(trajectory) = first.filter(|_| self.sync_move) {
            steps.extend([Step::Mount { trajectory }, Step::Sync]);
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
                for depth in block.depths(*trajectory) {
                    let what = format!("plan: trajectory {trajectory}, depth {depth} mm");
                    rig.check_depth(&what, *depth, travel_mm)?;
                }
                steps.push(Step::Mount { trajectory: *trajectory });
                block.path(*trajectory, rig, &mut steps)?;
            }
        }
        if self.sync_move {
            steps.push(Step::Sync);
        }
        Ok(steps)
    }
}

impl Block {
    /// Readings at most.
    fn count(&self) -> usize {
        let once = |id: &u32| 2 * self.depths(*id).len() + 3;
        let paths = (self.replicates as usize).saturating_mul(self.speeds_mm_s.len().max(1));
        self.trajectories.iter().map(once).sum::<usize>().saturating_mul(paths)
    }

    fn depths(&self, trajectory: u32) -> &[f64] {
        self.depths_of.get(&trajectory.to_string()).unwrap_or(&self.depths_mm)
    }

    /// Rest, loading, unloading, for every speed and replicate.
    fn path(&self, trajectory: u32, rig: &Rig, steps: &mut Vec<Step>) -> Result<(), AcquisitionError> {
        let own = [rig.stage.speed_mm_s];
        let speeds = if self.speeds_mm_s.is_empty() { &own[..] } else { &self.speeds_mm_s };
        if let Some(fast) = speeds.iter().find(|s| !(**s > 0.0 && **s <= rig.stage.speed_mm_s)) {
            let expected = format!("speeds up to the rig's {} mm/s", rig.stage.speed_mm_s);
            return Err(AcquisitionError::input("plan: speeds_mm_s", expected, fast.to_string()));
        }
        let mut replicate = 0;
        for _ in 0..self.replicates {
            for speed in speeds {
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
                if self.rest {
                    steps.push(Step::Settled(Pose { role: Role::Rest, ..pose(rig.stage.retract_mm, 1) }));
                }
                let depths = self.depths(trajectory);
                steps.extend(depths.iter().map(|d| Step::Settled(pose(*d, 1))));
                if self.unloading {
                    steps.extend(depths.iter().rev().skip(1).map(|d| Step::Settled(pose(*d, -1))));
                }
                if self.on_the_fly_hz > 0.0 {
                    let deepest = depths.iter().copied().fold(0.0, f64::max);
                    let rows_hz = self.on_the_fly_hz;
                    let role = if self.role == Role::Calibration { Role::Verification } else { self.role };
                    let moving = |from: f64, to: f64, direction: i32| Step::Moving {
                        from_mm: from,
                        rows_hz,
                        pose: Pose { role, ..pose(to, direction) },
                    };
                    steps.push(moving(0.0, deepest, 1));
                    steps.push(moving(deepest, 0.0, -1));
                }
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::path_text::draw;

    const PLAN: &str = "format = \"wcal-plan/1\"\nname = \"p\"\n[[block]]\nrole = \"calibration\"\ntrajectories = [1]\ndepths_mm = [1, 3, 5]\n";

    fn rig() -> Rig {
        Rig::parse("rig.toml", super::super::rig::tests::RIG).unwrap()
    }

    #[test]
    fn a_block_becomes_rest_loading_unloading_and_moving_steps() {
        let text =
            format!("{PLAN}unloading = true\nreplicates = 2\nspeeds_mm_s = [2, 6]\non_the_fly_hz = 20\n");
        let steps = Plan::parse("plan.toml", &text).unwrap().steps(&rig(), [0.0, 101.6]).unwrap();
        let settled = steps.iter().filter(|s| matches!(s, Step::Settled(_))).count();
        let moving = steps.iter().filter(|s| matches!(s, Step::Moving { .. })).count();
        assert_eq!((settled, moving), (4 * (1 + 3 + 2), 4 * 2));
        assert_eq!(steps.iter().filter(|s| **s == Step::Sync).count(), 2);
        assert!(draw(&steps, &rig()).contains("trajectory   1"));
    }

    #[test]
    fn plans_outside_the_rig_are_refused_before_anything_moves() {
        let plan = |from: &str, to: &str| {
            Plan::parse("plan.toml", &PLAN.replace(from, to)).and_then(|p| p.steps(&rig(), [0.0, 101.6]))
        };
        assert!(plan("", "").is_ok());
        for (from, to, word) in [
            ("5]", "50]", "stage position"),
            ("[1]", "[7]", "trajectories of the rig"),
            ("[1, 3, 5]", "[1, -3]", "block #1.depths_mm #2"),
            ("[1, 3, 5]", "[]", "at least one depth"),
            ("wcal-plan/1", "wcal-plan/3", "wcal-plan/1"),
            ("depths_mm = [1, 3, 5]", "depths_mm = [1]\nspeeds_mm_s = [99]", "speeds up to"),
            ("depths_mm", "depth_mm", "plan file"),
            (
                "name = \"p\"",
                "name = \"p\"\nboard_views = 1000",
                "board_views: expected a whole number between 0 and 100",
            ),
            ("name = \"p\"", "name = \"p\"\nboard_views = -1", "board_views"),
        ] {
            let error = plan(from, to).unwrap_err().to_string();
            assert!(error.contains(word), "{word}: {error}");
        }
    }
}
