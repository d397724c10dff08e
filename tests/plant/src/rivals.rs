//! What an examiner who knows the physics can say beforehand: the oracle's error, and the nearest
//! rival effect.

use nalgebra::{DMatrix, DVector, Matrix2, Vector2};
use std::collections::BTreeSet;

use crate::PlantError;
use crate::case::{Reading, Rival};
use crate::effects::{Effect, Kind};
use crate::noise::Outlier;
use crate::simulate::{NoiseFree, Plant, moments};

/// Distance (noises) within which data do not decide.
const UNDECIDED: f64 = 3.0;

/// Held-out moment error in N mm (rms over both components) of an oracle that knows the effect's
/// readings, the noise's covariance and the gross readings, and fits only K and the zero on the
/// points.
pub fn oracle_error_nmm(
    plant: &Plant,
    clean: &[NoiseFree],
    readings: &[Reading],
    gross: &[Outlier],
) -> f64 {
    let points = plant.covariance.rows();
    let moment = |i: usize| clean[i].moment_nmm;
    // Reading without the declared temperature term and without the effect's own part.
    let reading = |i: usize, c: usize| {
        let r = &readings[i];
        let warm_pm = 1e3 * (r.reference_nm - plant.bench.reference_nominal_nm);
        let linear = plant.bench.shift_pm(moment(i))[c];
        1e3 * (r.fbg_nm[c] - plant.bench.nominal_nm[c]) - warm_pm - (clean[i].shift_pm[c] - linear)
    };
    let svd = plant
        .covariance
        .whiten(&moments(points, clean))
        .svd(true, true);
    let y = DMatrix::from_fn(points.len(), 2, |i, c| reading(points[i], c));
    let Ok(fit) = svd.solve(&plant.covariance.whiten(&y), 1e-12) else {
        return f64::NAN;
    };
    // Rows are channels.
    let k = Matrix2::new(fit[(1, 0)], fit[(2, 0)], fit[(1, 1)], fit[(2, 1)]);
    let Some(inverse) = k.try_inverse() else {
        return f64::NAN;
    };
    let (mut sum, mut count) = (0.0, 0);
    for i in (0..plant.rows.len()).filter(|&i| plant.rows[i].role == "holdout") {
        if gross.iter().any(|g| g.row == i) {
            continue;
        }
        let d = Vector2::new(reading(i, 0) - fit[(0, 0)], reading(i, 1) - fit[(0, 1)]);
        sum += (inverse * d - Vector2::from(moment(i))).norm_squared();
        count += 2;
    }
    (sum / f64::from(count)).sqrt()
}

/// Signatures of one rival: several sets of columns, each set an alternative (a time constant on a
/// grid, a law).
type Alternatives = Vec<Vec<Effect>>;

fn rivals() -> Vec<(&'static str, Alternatives)> {
    let one = |kind, amplitude, shape: &[f64]| Effect {
        kind,
        amplitude,
        shape: shape.to_vec(),
    };
    let half = std::f64::consts::FRAC_PI_2;
    let axes = |kind, amplitude, n: usize| -> Vec<Effect> {
        (0..n)
            .map(|i| {
                one(
                    kind,
                    amplitude,
                    &(0..n)
                        .map(|j| f64::from(u8::from(i == j)))
                        .collect::<Vec<_>>(),
                )
            })
            .collect()
    };
    let waves = |pitch: f64| {
        vec![
            one(Kind::PeriodicLead, 0.01, &[pitch, 0.0]),
            one(Kind::PeriodicLead, 0.01, &[pitch, half]),
        ]
    };
    vec![
        (
            "groove-friction",
            vec![
                vec![one(Kind::FrictionCoulomb, 0.15, &[])],
                vec![one(Kind::FrictionPresliding, 0.15, &[0.1])],
            ],
        ),
        (
            "stage-backlash",
            vec![
                vec![one(Kind::BacklashApproach, 0.03, &[])],
                vec![one(Kind::BacklashSymmetric, 0.03, &[])],
            ],
        ),
        ("stage-scale", vec![vec![one(Kind::StageScale, 0.01, &[])]]),
        ("stage-periodic", vec![waves(0.6096), waves(1.2192)]),
        (
            "time-lag",
            vec![
                vec![one(Kind::LagPose, 0.02, &[])],
                vec![one(Kind::LagDelay, 0.02, &[])],
                vec![one(Kind::LagLowPass, 0.02, &[])],
            ],
        ),
        ("contact-offset", vec![axes(Kind::OffsetGroove, 0.1, 3)]),
        (
            "base-compliance",
            vec![axes(Kind::ComplianceTwoAxes, 0.01, 2)],
        ),
        (
            "temperature-mismatch",
            vec![axes(Kind::TemperatureLinear, 1.0, 2)],
        ),
        ("zero-drift", vec![axes(Kind::DriftLinear, 0.1, 2)]),
        (
            "creep",
            [4.0, 12.0, 40.0, 120.0, 400.0]
                .iter()
                .map(|&tau| vec![one(Kind::CreepProny1, 0.03, &[tau])])
                .chain([vec![one(Kind::CreepLog, 0.03, &[])]])
                .collect(),
        ),
        (
            "hysteresis",
            vec![
                vec![one(Kind::HysteresisBoucWen, 0.01, &[0.05, 0.5])],
                vec![one(Kind::HysteresisBoucWen, 0.01, &[0.12, 0.5])],
                vec![one(Kind::HysteresisPlay, 0.01, &[0.08, 0.2])],
                vec![one(Kind::HysteresisVector, 0.01, &[0.1])],
            ],
        ),
        (
            "superelastic-softening",
            vec![vec![one(Kind::SofteningBilinear, 0.8, &[0.6])]],
        ),
        ("fbg-nonlinearity", vec![axes(Kind::FbgFull, 0.01, 6)]),
        (
            "dead-zone",
            vec![
                vec![one(Kind::DeadZoneRadial, 0.03, &[])],
                vec![one(Kind::DeadZoneComponent, 0.03, &[])],
            ],
        ),
        ("wire-taper", vec![vec![one(Kind::TaperLinear, 0.1, &[])]]),
    ]
}

/// The nearest rival of a single effect among the catalogue's other effects, linearised, K and zero
/// free.
///
/// # Errors
/// [`PlantError::Wire`] when a rival's rod does not settle.
pub fn nearest(
    plant: &mut Plant,
    own: &str,
    with: &[NoiseFree],
    without: &[NoiseFree],
) -> Result<Option<Rival>, PlantError> {
    let rows = plant.covariance.rows().to_vec();
    let n = rows.len();
    // Both channels, whitened, one above the other.
    let stack = |plant: &Plant, a: &[NoiseFree]| -> DVector<f64> {
        let d = DMatrix::from_fn(n, 2, |i, c| {
            a[rows[i]].shift_pm[c] - without[rows[i]].shift_pm[c]
        });
        DVector::from_column_slice(plant.covariance.whiten(&d).as_slice())
    };
    let effect = stack(plant, with);
    let base = plant.covariance.whiten(&moments(&rows, without));
    let mut best: Option<Rival> = None;
    let mut close: BTreeSet<&str> = BTreeSet::new();
    let mut signatures = Vec::new();
    for (id, alternatives) in rivals().into_iter().filter(|(id, _)| *id != own) {
        for set in alternatives {
            let mut answers = Vec::new();
            for e in &set {
                answers.push(plant.clean(std::slice::from_ref(e))?);
            }
            signatures.push((id, answers));
        }
    }
    for (id, answers) in signatures {
        let columns: Vec<DVector<f64>> = answers.iter().map(|a| stack(plant, a)).collect();
        // K and the zero of each channel are six nuisance columns.
        let design = DMatrix::from_fn(2 * n, 6 + columns.len(), |i, j| match j {
            0..6 if j / 3 != i / n => 0.0,
            0..6 => base[(i % n, j % 3)],
            _ => columns[j - 6][i],
        });
        let svd = design.clone().svd(true, true);
        let Ok(x) = svd.solve(&effect, 1e-9) else {
            continue;
        };
        let sigma = (&effect - &design * x).norm();
        if sigma < UNDECIDED {
            close.insert(id);
        }
        if best.as_ref().is_none_or(|b| sigma < b.sigma) {
            best = Some(Rival {
                id: id.to_owned(),
                sigma: (sigma * 10.0).round() / 10.0,
                within_three: 0,
            });
        }
    }
    Ok(best.map(|b| Rival {
        within_three: close.len(),
        ..b
    }))
}
