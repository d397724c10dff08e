//! What the shipped model says of a wire that touches nothing, under the noise and drift of a bench
//! (SIMULATED).

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::path::Path;
use wcal_core::observation::WhiskerSpec;
use wcal_lab::dataset::{Dataset, RodSweeps};
use wcal_lab::model_file::load;
use wcal_lab::sweep_series::{self, SweepSeries};
use wcal_lab_sweeps::{SweepPlan, objects};
use wcal_network::filter::{BayesFilter, BayesSettings};
use wcal_network::{InverseGrid, Sample, StaticInverse, Tracker};

const ROWS: usize = 600;
const RATE_HZ: f64 = 10.0;

/// Rows that are called contact under noise (standard deviation of each axis, N mm), `known`: with
/// the base's speed.
fn called(
    tracker: &Tracker,
    quiet: &[(f64, [f64; 2], f64)],
    noise_nmm: f64,
    known: bool,
) -> Vec<bool> {
    let mut rng = ChaCha8Rng::seed_from_u64(8);
    // Twelve even ones less their mean are as good as Gaussian here.
    let mut gauss = || (0..12).map(|_| rng.random::<f64>() - 0.5).sum::<f64>();
    let mut stream = tracker.stream_with(tracker.filters.with_measurement_noise(noise_nmm, 0.0));
    let one = |(t_s, moment_nmm, speed): &(f64, [f64; 2], f64)| {
        let moment_nmm = moment_nmm.map(|m| m + noise_nmm * gauss());
        let sample = Sample {
            t_s: *t_s,
            moment_nmm,
            base_mm_s: known.then_some(*speed),
        };
        stream.push(&sample).contact > 0.5
    };
    quiet.iter().map(one).collect()
}

/// Sweeps over a ball, and for each instant whether the wire is clearly pressed.
fn sweeps() -> Vec<SweepSeries> {
    let folder = tempfile::tempdir().unwrap();
    let dataset = Dataset {
        engine: std::sync::Arc::new(RodSweeps),
        whisker: WhiskerSpec::nominal(),
        plan: SweepPlan {
            rate_hz: RATE_HZ,
            ..SweepPlan::default()
        },
        objects: ["ball"].map(|n| objects::built_in(n).unwrap()).into(),
        sweeps: 4,
        seed: 3,
        share: [0, 1],
    };
    dataset.make(folder.path(), |_, _| {}).unwrap();
    sweep_series::read_sweep_series(folder.path(), &[])
        .unwrap()
        .into_values()
        .flatten()
        .collect()
}

/// At most one free row in fifty; the model without such wires in its training called one in nine
/// at 0.003 N mm.
#[test]
fn a_free_wire_under_noise_and_drift_is_not_called_touched() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../fixtures/tracker");
    let tracker = load(&folder).unwrap().0;
    let sweeps = sweeps();
    for (noise, drift) in [(0.0003, 0.0), (0.001, 0.0), (0.003, 0.0), (0.001, 2e-5)] {
        for known in [true, false] {
            let quiet: Vec<_> = (0..ROWS)
                .map(|k| k as f64 / RATE_HZ)
                .map(|t| (t, [drift * t; 2], 5.0))
                .collect();
            let free = called(&tracker, &quiet, noise, known)
                .into_iter()
                .filter(|c| *c)
                .count();
            // Control: the same noise on wires that are pressed.
            let (mut pressed, mut found) = (0, 0);
            for series in &sweeps {
                let all: Vec<_> = series
                    .samples
                    .iter()
                    .map(|i| (i.t_s, i.moment_nmm, i.speed_mm_s))
                    .collect();
                for (i, called) in series
                    .samples
                    .iter()
                    .zip(called(&tracker, &all, noise, known))
                {
                    let clear = i.contact.is_some()
                        && i.moment_nmm[0].hypot(i.moment_nmm[1]) > 10.0 * noise;
                    pressed += usize::from(clear);
                    found += usize::from(clear && called);
                }
            }
            println!(
                "noise {noise} N mm, drift {drift} N mm/s: {free} of {ROWS} free rows, {found} of {pressed} pressed ones"
            );
            assert!(
                free <= ROWS / 50,
                "{noise} {drift}: {free} of {ROWS} free rows called contact"
            );
            assert!(
                pressed > 100 && found * 100 >= pressed * 97,
                "{noise}: {found} of {pressed} pressed rows"
            );
        }
    }
}

/// Rounding gives a free wire's moments some direction: nothing that is seen depends on it, above
/// the onset all of it does.
#[test]
fn moments_below_the_onset_have_no_direction() {
    let inverse = StaticInverse::new(&WhiskerSpec::nominal(), InverseGrid::default()).unwrap();
    let settings = BayesSettings::multi_mu();
    let seen = |moment_nmm: [f64; 2]| {
        let mut filter = BayesFilter::new(&inverse, settings);
        filter.step(0.1, moment_nmm, Some(5.0), None);
        (filter.posterior(), filter.solutions().to_vec())
    };
    for size_nmm in [0.0, 1e-31, 0.9 * settings.onset_nmm] {
        assert_eq!(
            seen([0.0, size_nmm]),
            seen([-size_nmm, 0.0]),
            "{size_nmm} N mm"
        );
    }
    let size_nmm = 1.1 * settings.onset_nmm;
    assert_ne!(seen([0.0, size_nmm]), seen([-size_nmm, 0.0]), "control");
}
