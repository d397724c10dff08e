//! The noise floor, what a loaded reading at a repeated pose can reach.

use super::path::Reading;
use super::physical::PhysicalModel;
use super::system::WhiskerSystem;
use crate::MeasurementModel;
use crate::method::{Hypothesis, LackOfFit, Noise, Part, Split};
use crate::verify::FloorStatement;
use nalgebra::{DMatrix, RowDVector};
use std::collections::BTreeMap;
use wcal_core::verify_document::NoiseFloor;

/// Fewer degrees of freedom than this do not make a floor.
const MIN_DOF: f64 = 10.0;
/// Poses of one approach nearer than this share of its range may be one pose set again.
const NEAR_SHARE: f64 = 0.05;
/// Gaps between sorted positions that part poses are this many times those within one.
const GAP_RATIO: f64 = 3.0;

/// Number of the pose of each reading: equal for readings that agree in trajectory, direction,
/// speed and seating, and in position within a tolerance that follows from the positions themselves
/// (repeated poses cluster: gaps within a cluster are far smaller than between).
pub fn poses(readings: &[Reading]) -> Vec<usize> {
    let mut approaches: BTreeMap<(u32, u32, bool, i64, i64), Vec<usize>> = BTreeMap::new();
    for (i, r) in readings.iter().enumerate() {
        // Backlash, friction and lag make a pose depend on the way and the speed it was reached by.
        let direction = if r.rest { 0 } else { r.direction as i64 };
        let key = (
            r.seating,
            r.group,
            r.rest,
            direction,
            (r.velocity_mm_s * 10.0) as i64,
        );
        approaches.entry(key).or_default().push(i);
    }
    let mut pose = vec![0; readings.len()];
    let mut next = 0;
    for members in approaches.values_mut() {
        members.sort_by(|&a, &b| readings[a].x_mm.total_cmp(&readings[b].x_mm));
        let tolerance = tolerance_mm(
            &members
                .iter()
                .map(|&i| readings[i].x_mm)
                .collect::<Vec<_>>(),
        );
        for k in 0..members.len() {
            if k == 0 || readings[members[k]].x_mm - readings[members[k - 1]].x_mm > tolerance {
                next += 1;
            }
            pose[members[k]] = next;
        }
    }
    pose
}

/// Largest gap between sorted positions that still is one pose, mm.
fn tolerance_mm(sorted_mm: &[f64]) -> f64 {
    let range = sorted_mm
        .last()
        .zip(sorted_mm.first())
        .map_or(0.0, |(b, a)| b - a);
    let exact = (1e-5 * range).max(1e-6);
    let mut gaps: Vec<f64> = sorted_mm
        .windows(2)
        .map(|w| (w[1] - w[0]).max(exact))
        .collect();
    gaps.sort_by(f64::total_cmp);
    // Of sorted gaps the largest ratio parts the scatter within a pose from the way to the next.
    let jump = (1..gaps.len())
        .filter(|&k| gaps[k - 1] <= NEAR_SHARE * range && gaps[k] > GAP_RATIO * gaps[k - 1])
        .max_by(|&a, &b| (gaps[a] / gaps[a - 1]).total_cmp(&(gaps[b] / gaps[b - 1])));
    // The geometric mean lies as many times above the scatter as below the next gap.
    jump.map_or(exact, |k| (gaps[k - 1] * gaps[k]).sqrt())
}

/// Residuals by pose among the typical readings at rest, or loaded; settings held through count
/// once, by their mean.
fn by_pose(
    system: &WhiskerSystem,
    h: &Hypothesis,
    residual: &DMatrix<f64>,
    rest: bool,
) -> Vec<Vec<RowDVector<f64>>> {
    let (readings, inputs) = (&system.path.readings, system.noise_inputs());
    let pose = poses(readings);
    let mut groups: BTreeMap<usize, BTreeMap<usize, Vec<usize>>> = BTreeMap::new();
    let asked = |i: &usize| h.weights.counts(*i) && readings[*i].rest == rest && inputs.typical(*i);
    for i in (0..readings.len()).filter(asked) {
        groups
            .entry(pose[i])
            .or_default()
            .entry(inputs.settings[i])
            .or_default()
            .push(i);
    }
    let mean = |rows: &Vec<usize>| residual.select_rows(rows).row_mean();
    groups
        .values()
        .map(|settings| settings.values().map(mean).collect())
        .collect()
}

/// Sum of squares and degrees of freedom within poses, over all channels.
fn within(poses: &[Vec<RowDVector<f64>>]) -> Part {
    let mut part = Part { ss: 0.0, dof: 0.0 };
    for settings in poses {
        let mean = DMatrix::from_rows(settings).row_mean();
        // Each pose costs one mean a channel.
        part.dof += ((settings.len() - 1) * mean.len()) as f64;
        part.ss += settings
            .iter()
            .map(|m| (m - &mean).norm_squared())
            .sum::<f64>();
    }
    part
}

/// What `h` leaves of loaded poses against how well a pose that is set again reproduces; none where
/// too few were, or where readings share noise in time: poses that follow each other then differ by
/// less than those that do not. No parameter is counted, so that F errs to the small side: rest
/// readings, which are in no pose, take some.
pub fn lack_of_fit(system: &WhiskerSystem, h: &Hypothesis) -> Option<LackOfFit> {
    if h.weights
        .shared()
        .is_some_and(|shared| shared.correlated.is_some())
    {
        return None;
    }
    let poses = by_pose(system, h, &h.fit.raw_residual, false);
    let within = within(&poses);
    let total: f64 = poses.iter().flatten().map(RowDVector::norm_squared).sum();
    // Pythagoras: the squares between poses are those of all less those within.
    let between = Part {
        ss: total - within.ss,
        dof: (poses.len() * h.fit.raw_residual.ncols()) as f64,
    };
    (within.dof >= MIN_DOF)
        .then(|| LackOfFit::of(Split { between, within }))
        .flatten()
}

/// The floor under the noise of the accepted model, what a loaded reading at a repeated pose can
/// reach. `left`: something remains that the model does not explain, so its residuals are no noise
/// and only replicates tell the floor.
pub fn noise_floor(
    system: &WhiskerSystem,
    h: &Hypothesis,
    noise: &Noise,
    left: bool,
) -> FloorStatement {
    let inputs = system.noise_inputs();
    let readings = &system.path.readings;
    let residual = &h.fit.raw_residual * system.channels_pm();
    let replicates = within(&by_pose(system, h, &residual, false));
    let rest_repeats = within(&by_pose(system, h, &residual, true)).dof > 0.0;
    let sd = noise.reading_sd(&inputs);
    // From the engine's channels, whose noise is alike and independent, to the gratings'.
    let rms = |typical: bool| {
        let of = (0..sd.len()).filter(|&i| !readings[i].rest && inputs.typical(i) == typical);
        let squares: Vec<f64> = of.map(|i| sd[i] * sd[i]).collect();
        let mean = squares.iter().sum::<f64>() / squares.len() as f64;
        (squares.len() >= 2).then(|| system.noise_factor() * mean.sqrt())
    };
    let model = rms(true).filter(|m| m.is_finite());
    let replicated = replicates.dof >= MIN_DOF && model.is_some();
    let wavelength_pm = model.map(|model| match left && replicated {
        true => (replicates.ss / replicates.dof).sqrt(),
        false => model,
    });
    let sd = wavelength_pm.unwrap_or_else(|| noise.repeat.value * system.noise_factor());
    let sensitivity = PhysicalModel::new(system, h, sd).sensitivity();
    // Geometric mean of the two gains: pm a N mm.
    let gain = sensitivity.determinant().abs().sqrt();
    let source = match model {
        None => "none",
        Some(_) if replicated => "replicates",
        Some(_) => "difference",
    };
    let (mut reason, mut note) = (String::new(), None);
    if !replicated {
        reason = " Provisional: no loaded pose was set again, so the noise floor is an estimate from neighbours.".to_owned();
        let only_rest = if rest_repeats {
            "Only rest readings repeat"
        } else {
            "No reading repeats"
        };
        note = model.map(|_| format!(
            "{only_rest}: how well a loaded pose reproduces is not known from them. The floor is what the model leaves between neighbouring \
             poses; to know it, set at least five loaded poses again (move away and back) in two or more approaches."
        ));
    }
    FloorStatement {
        floor: NoiseFloor {
            wavelength_pm,
            moving_wavelength_pm: model.and_then(|_| rms(false)),
            moment_nmm: wavelength_pm.filter(|_| gain > 0.0).map(|sd| sd / gain),
            contact_mm: system.pictures().map(|p| p.contact_floor_mm()),
            source: source.to_owned(),
            ..NoiseFloor::default()
        },
        reason,
        note,
        sd,
        dof: None,
    }
}

#[cfg(test)]
mod tests {
    use super::tolerance_mm;

    #[test]
    fn repeated_poses_cluster_and_a_plain_sweep_does_not() {
        let jittered = [1.0, 1.02, 2.0, 2.05, 3.0, 3.01, 4.0, 4.03];
        let t = tolerance_mm(&jittered);
        assert!(t > 0.05 && t < 0.9, "{t}");
        let sweep: Vec<f64> = (0..12).map(f64::from).collect();
        assert!(tolerance_mm(&sweep) < 0.01);
        // Exact revisits.
        assert!(tolerance_mm(&[1.0, 1.0, 2.0, 2.0, 3.0, 3.0]) < 0.5);
    }
}
