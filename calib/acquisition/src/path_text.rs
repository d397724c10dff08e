//! A plan's path for people: its duration, and a drawing of every trajectory.

use crate::plan::{Plan, Step};
use crate::rig::Rig;

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

/// The path as text: one line a trajectory block, a mark for every settled depth.
pub fn draw(steps: &[Step], rig: &Rig) -> String {
    const WIDTH: usize = 60;
    let deepest = steps
        .iter()
        .filter_map(|s| match s {
            Step::Settled(p) | Step::Moving { pose: p, .. } => Some(p.stage_mm),
            _ => None,
        })
        .fold(1e-9, f64::max);
    let low = rig.stage.retract_mm.min(0.0);
    let column = |mm: f64| (((mm - low) / (deepest - low)) * (WIDTH - 1) as f64).round() as usize;
    let mut out = format!("depth {low:.1} .. {deepest:.2} mm; | contact, o settled, = moving\n");
    let mut line: Option<(u32, Vec<char>, usize)> = None;
    let mut flush = |line: &mut Option<(u32, Vec<char>, usize)>| {
        // A mount that is turned only for a soak or a sync move has no path of its own.
        let taken = line.take().filter(|(_, marks, _)| marks.iter().any(|m| !matches!(m, ' ' | '|')));
        if let Some((id, marks, count)) = taken {
            let text: String = marks.into_iter().collect();
            out.push_str(&format!("trajectory {id:>3} [{text}] {count} readings\n"));
        }
    };
    for step in steps {
        match step {
            Step::Mount { trajectory } => {
                flush(&mut line);
                let mut marks = vec![' '; WIDTH];
                marks[column(0.0)] = '|';
                line = Some((*trajectory, marks, 0));
            }
            Step::Settled(pose) => {
                if let Some((_, marks, count)) = &mut line {
                    marks[column(pose.stage_mm).min(WIDTH - 1)] = 'o';
                    *count += 1;
                }
            }
            Step::Moving { from_mm, pose, .. } => {
                if let Some((_, marks, _)) = &mut line {
                    let (a, b) = (column(*from_mm), column(pose.stage_mm));
                    for mark in &mut marks[a.min(b)..=a.max(b).min(WIDTH - 1)] {
                        if *mark == ' ' {
                            *mark = '=';
                        }
                    }
                }
            }
            Step::Soak | Step::Sync { .. } => {}
        }
    }
    flush(&mut line);
    out
}
