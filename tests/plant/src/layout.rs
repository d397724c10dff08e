//! Order and timing of the readings, in the structure of the practice sessions, and the stage's
//! motion between them.

use rand::seq::SliceRandom;
use rand::{Rng, RngExt};

use crate::bench::{MICROSTEP_MM, Trajectory};

/// How many readings and of which kind.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Design {
    /// 36 rows: 27 approach-only points and 9 rests.
    Paper,
    /// 360 rows: two replicates up and down, three dwells, two speeds, rests.
    Rich,
    /// About 360 rows: every loaded pose read two or three times without moving.
    Repeats,
    /// About 340 rows: two rounds through the trajectories in random order, poses read once to
    /// three times.
    Shuffled,
    /// 369 rows: staircases up and down that come back to the same positions in the same way.
    Staircase,
}

/// A row before it is measured.
#[derive(Debug, Clone, PartialEq)]
pub struct PlannedRow {
    /// In holdout.csv (else points.csv).
    pub holdout: bool,
    /// `rest`, `calibration`, `verification` or `holdout`.
    pub role: &'static str,
    /// Index into the bench's trajectories.
    pub trajectory: usize,
    /// Replicate as written.
    pub replicate: usize,
    /// Time in s.
    pub t_s: f64,
    /// Commanded stage position in mm.
    pub commanded_mm: f64,
    /// Stage position read back in whole microsteps, mm.
    pub stage_mm: f64,
    /// +1 loading, -1 unloading.
    pub direction: i32,
    /// 0 when settled.
    pub speed_mm_s: f64,
    /// Time since arrival in s.
    pub dwell_s: f64,
}

struct Planner {
    rows: Vec<PlannedRow>,
    t_s: f64,
    commanded_mm: f64,
    trajectory: usize,
    holdout: bool,
}

/// Speed of settled moves and of the way home, mm/s.
const SETTLED_MM_S: f64 = 2.0;
const HOME_MM_S: f64 = 4.0;

impl Planner {
    fn settled(&mut self, to_mm: f64, dwell_s: f64, replicate: usize, role: &'static str) {
        let direction = if to_mm >= self.commanded_mm { 1 } else { -1 };
        let speed = if role == "rest" {
            HOME_MM_S
        } else {
            SETTLED_MM_S
        };
        self.t_s += (to_mm - self.commanded_mm).abs() / speed + dwell_s;
        self.push(to_mm, direction, 0.0, dwell_s, replicate, role);
    }

    /// Reads once more without moving; the time since arrival goes on.
    fn again(&mut self, wait_s: f64, replicate: usize, role: &'static str) {
        let Some((direction, dwell_s)) = self.rows.last().map(|r| (r.direction, r.dwell_s)) else {
            return;
        };
        self.t_s += wait_s;
        self.push(
            self.commanded_mm,
            direction,
            0.0,
            dwell_s + wait_s,
            replicate,
            role,
        );
    }

    /// A settled pose read `times` times.
    fn visit(&mut self, to_mm: f64, dwell_s: f64, times: usize, first: usize, role: &'static str) {
        self.settled(to_mm, dwell_s, first, role);
        for k in 1..times {
            self.again(1.5, first + k, "verification");
        }
    }

    fn moving(&mut self, to_mm: f64, speed_mm_s: f64) {
        let direction = if to_mm >= self.commanded_mm { 1 } else { -1 };
        self.t_s += (to_mm - self.commanded_mm).abs() / speed_mm_s;
        self.push(to_mm, direction, speed_mm_s, 0.0, 1, "verification");
    }

    fn push(
        &mut self,
        to_mm: f64,
        direction: i32,
        speed_mm_s: f64,
        dwell_s: f64,
        replicate: usize,
        role: &'static str,
    ) {
        self.commanded_mm = to_mm;
        self.rows.push(PlannedRow {
            holdout: self.holdout,
            role,
            trajectory: self.trajectory,
            replicate,
            t_s: self.t_s,
            commanded_mm: to_mm,
            stage_mm: (to_mm / MICROSTEP_MM).round() * MICROSTEP_MM,
            direction,
            speed_mm_s,
            dwell_s,
        });
    }

    fn next_trajectory(&mut self, index: usize, pause_s: f64) {
        self.trajectory = index;
        self.commanded_mm = 0.0;
        self.t_s += pause_s;
    }
}

/// Plans points and holdout rows; `trajectories` are those of
/// [`crate::bench::Bench::trajectories`].
pub fn plan(design: Design, trajectories: &[Trajectory], rng: &mut impl Rng) -> Vec<PlannedRow> {
    let mut p = Planner {
        rows: Vec::new(),
        t_s: 0.0,
        commanded_mm: 0.0,
        trajectory: 0,
        holdout: false,
    };
    let fitted: Vec<(usize, f64)> = trajectories
        .iter()
        .enumerate()
        .filter(|(_, t)| t.id < 100)
        .map(|(index, t)| (index, t.reach_mm))
        .collect();
    if design == Design::Shuffled {
        shuffled(&mut p, &fitted, rng);
    }
    let times = if design == Design::Repeats {
        rng.random_range(2..=3_usize)
    } else {
        1
    };
    for (index, reach_mm) in fitted.into_iter().filter(|_| design != Design::Shuffled) {
        p.next_trajectory(index, if index == 0 { 0.0 } else { 20.0 });
        match design {
            Design::Paper => {
                p.settled(0.0, 2.0, 1, "rest");
                for share in [1.0 / 3.0, 2.0 / 3.0, 1.0] {
                    p.settled(share * reach_mm, 2.0, 1, "calibration");
                }
            }
            Design::Rich | Design::Shuffled => rich(&mut p, reach_mm, rng),
            Design::Repeats => repeats(&mut p, index, reach_mm, times, rng),
            Design::Staircase => staircase(&mut p, reach_mm),
        }
    }
    p.t_s += 60.0;
    p.holdout = true;
    for (index, trajectory) in trajectories.iter().enumerate().filter(|(_, t)| t.id > 100) {
        p.next_trajectory(index, 20.0);
        let mut up: Vec<f64> = (0..4)
            .map(|_| rng.random_range(0.15..0.97) * trajectory.reach_mm)
            .collect();
        up.sort_by(f64::total_cmp);
        p.settled(0.0, 3.0, 1, "rest");
        for &x in up.iter().chain(up.iter().rev().skip(1)) {
            let dwell = [2.0, 6.0][rng.random_range(0..2_usize)];
            p.settled(x, dwell, 1, "holdout");
        }
        p.settled(0.0, 3.0, 1, "rest");
    }
    p.rows
}

/// A reading that the program asks for (`next_measurement` of verify.json).
#[derive(Debug, Clone, Copy, PartialEq, serde::Deserialize)]
pub struct Asked {
    /// Number of the trajectory.
    pub trajectory: usize,
    /// Stage position, mm.
    pub stage_mm: f64,
    /// -1: after the deepest pose.
    pub direction: f64,
    /// 0: settled.
    #[serde(default)]
    pub speed_mm_s: f64,
    /// Time since arrival, s.
    #[serde(default)]
    pub dwell_s: f64,
}

/// Times that every asked reading is taken.
const ASKED_REPEATS: usize = 4;

/// Plans the later session that `asked` describes: a rest reading before every excursion.
pub fn plan_asked(asked: &[Asked], trajectories: &[Trajectory]) -> Vec<PlannedRow> {
    let mut p = Planner {
        rows: Vec::new(),
        t_s: 0.0,
        commanded_mm: 0.0,
        trajectory: 0,
        holdout: false,
    };
    for (k, a) in asked.iter().enumerate() {
        let Some(index) = trajectories.iter().position(|t| t.id == a.trajectory) else {
            continue;
        };
        p.next_trajectory(index, if k == 0 { 0.0 } else { 20.0 });
        for replicate in 1..=ASKED_REPEATS {
            p.settled(0.0, 3.0, replicate, "rest");
            if a.direction < 0.0 {
                p.settled(trajectories[index].reach_mm, 2.0, replicate, "verification");
            }
            if a.speed_mm_s > 0.0 {
                p.moving(a.stage_mm, a.speed_mm_s);
            } else {
                p.settled(a.stage_mm, a.dwell_s, replicate, "verification");
            }
        }
        p.settled(0.0, 3.0, ASKED_REPEATS, "rest");
    }
    p.rows
}

/// Plans ten readings of a quick look: one at rest, and three along each of three of the
/// trajectories, the last of them on the way back.
pub fn plan_quick(trajectories: &[Trajectory]) -> Vec<PlannedRow> {
    let mut p = Planner {
        rows: Vec::new(),
        t_s: 0.0,
        commanded_mm: 0.0,
        trajectory: 0,
        holdout: false,
    };
    p.settled(0.0, 3.0, 1, "rest");
    for id in [1, 5, 9] {
        let Some(index) = trajectories.iter().position(|t| t.id == id) else {
            continue;
        };
        p.next_trajectory(index, if p.rows.len() > 1 { 20.0 } else { 0.0 });
        for share in [0.5, 1.0, 0.6] {
            p.settled(share * trajectories[index].reach_mm, 2.0, 1, "verification");
        }
    }
    p.rows
}

fn rich(p: &mut Planner, reach_mm: f64, rng: &mut impl Rng) {
    let shares = [1.0 / 6.0, 1.0 / 3.0, 0.5, 0.7, 0.85, 1.0];
    p.settled(0.0, 3.0, 1, "rest");
    for replicate in 1..=2 {
        let jitter = if replicate == 2 { 0.02 } else { 0.0 };
        let up = shares.map(|s| (s + jitter * rng.random_range(-1.0..1.0)) * reach_mm);
        for (i, x) in up.iter().chain(up.iter().rev().skip(1)).enumerate() {
            let role = if replicate == 1 && [1, 3, 5].contains(&i) {
                "calibration"
            } else {
                "verification"
            };
            let dwell = [1.5, 4.0, 12.0][rng.random_range(0..3_usize)];
            p.settled(*x, dwell, replicate, role);
        }
        p.settled(0.0, 3.0, replicate, "rest");
    }
    for speed in [2.0, 8.0] {
        for share in [0.25, 0.5, 0.75, 0.95, 0.8, 0.55, 0.3] {
            p.moving(share * reach_mm, speed);
        }
    }
    p.settled(0.0, 3.0, 3, "rest");
}

/// Up and down with every pose read `times` times; four poses more on the way up where two readings
/// suffice.
fn repeats(p: &mut Planner, index: usize, reach_mm: f64, times: usize, rng: &mut impl Rng) {
    let shares = [0.2, 0.35, 0.5, 0.7, 0.85, 1.0];
    p.settled(0.0, 3.0, 1, "rest");
    for (i, share) in shares.iter().chain(shares.iter().rev().skip(1)).enumerate() {
        let role = if [1, 3, 5].contains(&i) {
            "calibration"
        } else {
            "verification"
        };
        let dwell = [1.5, 4.0, 12.0][rng.random_range(0..3_usize)];
        p.visit(share * reach_mm, dwell, times, 1, role);
    }
    p.settled(0.0, 3.0, 2, "rest");
    if times == 2 {
        for low in [0.15, 0.4, 0.6, 0.8] {
            p.visit(
                (low + rng.random_range(0.0..0.15)) * reach_mm,
                4.0,
                times,
                3,
                "verification",
            );
        }
    }
    let speed = if index.is_multiple_of(2) { 2.0 } else { 8.0 };
    for share in [0.95, 0.75, 0.5, 0.25, 0.4, 0.65, 0.3] {
        p.moving(share * reach_mm, speed);
    }
    p.settled(0.0, 3.0, 3, "rest");
}

/// Two rounds through the trajectories, each in an order of its own: four poses up, three down,
/// once to three times each.
fn shuffled(p: &mut Planner, trajectories: &[(usize, f64)], rng: &mut impl Rng) {
    for round in 0..2 {
        let mut order = trajectories.to_vec();
        order.shuffle(rng);
        for (index, reach_mm) in order {
            p.next_trajectory(index, if p.rows.is_empty() { 0.0 } else { 20.0 });
            p.settled(0.0, 3.0, 1 + 2 * round, "rest");
            let first = 1 + 3 * round;
            let up = [0.2, 0.45, 0.7, 0.92].map(|s| (s + rng.random_range(-0.08..0.08)) * reach_mm);
            let down = [0.75, 0.5, 0.25].map(|s| (s + rng.random_range(-0.1..0.1)) * reach_mm);
            for (i, x) in up.into_iter().chain(down).enumerate() {
                let role = if round == 0 && (1..4).contains(&i) {
                    "calibration"
                } else {
                    "verification"
                };
                let dwell = rng.random_range(1.0..10.0_f64).round();
                p.visit(x, dwell, rng.random_range(1..=3_usize), first, role);
            }
            if round == 1 {
                for (share, speed) in [
                    (0.4, 3.0),
                    (0.8, 3.0),
                    (0.5, 3.0),
                    (0.9, 7.0),
                    (0.6, 7.0),
                    (0.3, 7.0),
                ] {
                    p.moving(share * reach_mm, speed);
                }
            }
            p.settled(0.0, 3.0, 2 + 2 * round, "rest");
        }
    }
}

/// Three steps up and one down, then all the way down, twice with the same positions, dwells and
/// directions.
fn staircase(p: &mut Planner, reach_mm: f64) {
    const STEPS: [f64; 15] = [1., 2., 3., 2., 3., 4., 5., 4., 5., 6., 5., 4., 3., 2., 1.];
    p.settled(0.0, 3.0, 1, "rest");
    for replicate in 1..=2 {
        for (i, step) in STEPS.iter().enumerate() {
            let role = if replicate == 1 && [1, 5, 9].contains(&i) {
                "calibration"
            } else {
                "verification"
            };
            let dwell = [2.0, 8.0][i % 2];
            p.settled(step / 6.0 * reach_mm, dwell, replicate, role);
        }
        p.settled(0.0, 3.0, replicate + 1, "rest");
    }
    for speed in [2.0, 8.0] {
        for share in [0.4, 0.9, 0.6, 0.2] {
            p.moving(share * reach_mm, speed);
        }
    }
    p.settled(0.0, 3.0, 4, "rest");
}

/// One instant of the session: end of a small step of motion or of a dwell.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Instant {
    /// Time in s.
    pub t_s: f64,
    /// Commanded stage position in mm.
    pub commanded_mm: f64,
    /// Index of the trajectory.
    pub trajectory: usize,
    /// False while the wire is out of the groove.
    pub loaded: bool,
    /// The row measured at this instant.
    pub row: Option<usize>,
    /// Signed stage speed at this instant, mm/s.
    pub velocity_mm_s: f64,
}

/// Longest step of motion in mm.
const STEP_MM: f64 = 0.1;

/// The whole motion, moves in small steps, ending each row's dwell with its instant.
pub fn motion(rows: &[PlannedRow]) -> Vec<Instant> {
    let mut out = Vec::new();
    let mut last: Option<&PlannedRow> = None;
    for (i, row) in rows.iter().enumerate() {
        let same = last.is_some_and(|l| l.trajectory == row.trajectory);
        let from_mm = if same {
            last.map_or(0.0, |l| l.commanded_mm)
        } else {
            0.0
        };
        let travel = row.commanded_mm - from_mm;
        let speed = match (row.speed_mm_s > 0.0, row.role) {
            (true, _) => row.speed_mm_s,
            (false, "rest") => HOME_MM_S,
            _ => SETTLED_MM_S,
        };
        let duration = travel.abs() / speed;
        let arrive = row.t_s - row.dwell_s;
        let count = (travel.abs() / STEP_MM).ceil() as usize;
        let loaded = row.role != "rest";
        let base = Instant {
            t_s: arrive - duration,
            commanded_mm: from_mm,
            trajectory: row.trajectory,
            loaded: same && last.is_some_and(|l| l.role != "rest"),
            row: None,
            velocity_mm_s: 0.0,
        };
        if !same || base.t_s > last.map_or(0.0, |l| l.t_s) + 1e-9 {
            out.push(base);
        }
        for k in 1..=count {
            let share = k as f64 / count as f64;
            let end = k == count;
            out.push(Instant {
                t_s: base.t_s + share * duration,
                commanded_mm: from_mm + share * travel,
                loaded: loaded || !end,
                row: (end && row.dwell_s == 0.0).then_some(i),
                velocity_mm_s: travel.signum() * speed,
                ..base
            });
        }
        if row.dwell_s > 0.0 {
            out.push(Instant {
                t_s: row.t_s,
                commanded_mm: row.commanded_mm,
                loaded,
                row: Some(i),
                ..base
            });
        }
        last = Some(row);
    }
    out
}
