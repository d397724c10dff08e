//! What the shipped model says of a wire that touches nothing, under the noise and drift of a bench.
#![allow(missing_docs, reason = "tests")]

use burn::tensor::Device;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::path::Path;
use wcal_track::bayes::BayesSettings;
use wcal_track::model_file::load;
use wcal_track::{Sample, Tracker};

const ROWS: usize = 600;
const RATE_HZ: f64 = 10.0;

/// Rows called contact, of [`ROWS`]; `pressed_nmm` is the moment under the noise (standard deviation `noise_nmm` on each axis).
fn called(tracker: &Tracker, noise_nmm: f64, drift_nmm_s: f64, pressed_nmm: f64, known: bool) -> usize {
    let mut rng = ChaCha8Rng::seed_from_u64(8);
    // Twelve even ones less their mean are as good as Gaussian here.
    let mut gauss = || (0..12).map(|_| rng.random::<f64>() - 0.5).sum::<f64>();
    let mut stream = tracker.stream_told(BayesSettings::stated(noise_nmm, 0.0));
    (0..ROWS)
        .filter(|k| {
            let t_s = *k as f64 / RATE_HZ;
            let moment_nmm = [pressed_nmm, 0.0].map(|m| m + drift_nmm_s * t_s + noise_nmm * gauss());
            let sample = Sample { t_s, moment_nmm, base_mm_s: known.then_some(5.0) };
            stream.push(&sample).contact > 0.5
        })
        .count()
}

#[test]
fn a_free_wire_under_noise_and_drift_is_not_called_touched() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fixtures/tracker");
    let tracker = load(&folder, &Device::flex()).unwrap().0;
    for (noise, drift) in [(0.0003, 0.0), (0.001, 0.0), (0.003, 0.0), (0.001, 2e-5)] {
        for known in [true, false] {
            let free = called(&tracker, noise, drift, 0.0, known);
            // Control: the same noise on a wire that is pressed.
            let pressed = called(&tracker, noise, drift, 30.0 * noise, known);
            println!(
                "noise {noise} N mm, drift {drift} N mm/s: {free} of {ROWS} free rows, {pressed} pressed ones"
            );
            assert!(free <= ROWS / 200, "{noise} {drift}: {free} of {ROWS} free rows called contact");
            assert!(
                pressed >= ROWS * 9 / 10,
                "{noise} {drift}: {pressed} of {ROWS} pressed rows called contact"
            );
        }
    }
}
