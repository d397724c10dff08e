//! Everything before the network at the interrogator's rate: peaks to gratings, temperature,
//! filter, map, for 16 whiskers.
//!
//! 2 kHz leave 500 us a scan, all whiskers together. Beside criterion's mean, quantiles of single
//! scans are printed, scans that complete rows included, with the multiple of real time. SIMULATED
//! peaks.
#![allow(
    clippy::expect_used,
    clippy::print_stdout,
    missing_docs,
    reason = "a bench reports on stdout and may stop"
)]

use criterion::{Criterion, criterion_group, criterion_main};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use std::hint::black_box;
use std::time::Instant;
use wcal_acquisition::whisker_reader::WhiskerReader;
use wcal_core::FbgSpec;
use wcal_core::device::{Clocks, FbgReading, InterrogatorHealth};
use wcal_core::rig_devices::{GratingRig, InterrogatorDriver, InterrogatorRig};
use wcal_gpr::{FitOptions, MapKind, MapPredictor, MapTraining, fit_map};
use wcal_network::stream::{SignalChain, SignalChainSettings};

const WHISKERS: usize = 16;
const RATE_HZ: f64 = 2000.0;
/// Gratings of a whisker, nm from its own beginning, and the distance of whiskers on one fibre.
const OFFSETS_NM: [f64; 3] = [0.0, 3.0, 6.0];
const PITCH_NM: f64 = 10.0;

/// Four whiskers on each of four fibres: wavelengths of reference and sensing gratings.
fn nominal_nm(whisker: usize) -> [f64; 3] {
    OFFSETS_NM.map(|o| 1527.0 + PITCH_NM * (whisker % 4) as f64 + o)
}

fn interrogator() -> InterrogatorRig {
    let grating = |w: usize, k: usize, name: &str| GratingRig {
        name: name.to_owned(),
        channel: w / 4 + 1,
        nominal_nm: nominal_nm(w)[k],
        window_nm: 1.4,
        whisker: format!("w{w}"),
    };
    let names = ["fbg_ref", "fbg_1", "fbg_2"];
    let all =
        (0..WHISKERS).flat_map(|w| names.iter().enumerate().map(move |(k, n)| grating(w, k, n)));
    InterrogatorRig {
        driver: InterrogatorDriver::Sm130,
        address: String::new(),
        peaks_address: None,
        rate_hz: RATE_HZ,
        grating: all.collect(),
    }
}

/// Moments of a whisker: free, then pressed and let go every four seconds.
fn moment_nmm(t_s: f64, whisker: usize) -> [f64; 2] {
    let phase = (t_s - 4.0 - 0.1 * whisker as f64).rem_euclid(4.0);
    let size = if t_s < 4.0 || phase > 2.0 {
        0.0
    } else {
        0.8 * (phase / 1.0).min(1.0)
    };
    [size * 0.8, size * 0.6]
}

fn scan(serial: u64, rng: &mut ChaCha8Rng) -> FbgReading {
    let t_s = serial as f64 / RATE_HZ;
    let mut peaks_nm = vec![Vec::new(); 4];
    for w in 0..WHISKERS {
        let m = moment_nmm(t_s, w);
        let shift_pm = [0.0, 72.0 * m[0] + 9.0 * m[1], -6.0 * m[0] + 78.0 * m[1]];
        for (nm, pm) in nominal_nm(w).iter().zip(shift_pm) {
            let noise: f64 = StandardNormal.sample(rng);
            peaks_nm[w / 4].push(nm + (pm + noise) * 1e-3);
        }
    }
    let clocks = Clocks {
        host_s: t_s,
        device_s: Some(t_s),
    };
    FbgReading {
        serial,
        peaks_nm,
        health: InterrogatorHealth::default(),
        clocks,
    }
}

fn whiskers(candidate: MapKind) -> Vec<(WhiskerReader, SignalChain)> {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let mut training = MapTraining::default();
    for k in 0..27 {
        let (size, turn) = (
            0.2 + 0.4 * f64::from(k / 9),
            std::f64::consts::TAU * f64::from(k % 9) / 9.0,
        );
        let m = [size * turn.cos(), size * turn.sin()];
        let noise: [f64; 2] = std::array::from_fn(|_| StandardNormal.sample(&mut rng));
        training.shifts_pm.push([
            72.0 * m[0] + 9.0 * m[1] + noise[0],
            -6.0 * m[0] + 78.0 * m[1] + noise[1],
        ]);
        training.moments_nmm.push(m);
        training.trajectory.push(Some(k as u32 % 9));
        training.point.push(i64::from(k));
    }
    let fit = fit_map(
        &training,
        &FitOptions {
            candidates: vec![candidate],
            ..FitOptions::default()
        },
    );
    let artefact = fit.expect("a map").artefact;
    let settings = SignalChainSettings {
        rate_hz: RATE_HZ,
        out_hz: 10.0,
        lag_s: 0.1,
        prefix_s: 3.0,
    };
    (0..WHISKERS)
        .map(|w| {
            let [reference, first, second] = nominal_nm(w);
            let fbg = FbgSpec {
                nominal_nm: Some([first, second]),
                reference_nominal_nm: Some(reference),
                temperature_pm_per_degc: Some([10.0, 10.0]),
                reference_temperature_pm_per_degc: Some(10.0),
                temperature_compensated: false,
            };
            let reader = WhiskerReader::new("rig", &interrogator(), &format!("w{w}"), &fbg)
                .expect("gratings");
            let map = MapPredictor::new(&artefact).expect("a sound map");
            (
                reader,
                SignalChain::new(&settings, Box::new(map)).expect("a chain"),
            )
        })
        .collect()
}

/// All whiskers take a scan; rows made.
fn take(whiskers: &mut [(WhiskerReader, SignalChain)], reading: &FbgReading) -> u64 {
    let mut made = 0;
    for (reader, chain) in whiskers {
        let sensed = reader.take(reading, false).expect("the rig's stream");
        made += u64::from(chain.push(black_box(&sensed)).is_some());
    }
    made
}

fn chain(c: &mut Criterion) {
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    let scans: Vec<FbgReading> = (0..60_000).map(|k| scan(k, &mut rng)).collect();
    for candidate in [MapKind::Affine, MapKind::ThinPlate] {
        let name = candidate.name();
        let mut all = whiskers(candidate);
        let (mut each_us, mut made) = (Vec::with_capacity(scans.len()), 0);
        for reading in &scans {
            let start = Instant::now();
            made += take(&mut all, reading);
            each_us.push(start.elapsed().as_secs_f64() * 1e6);
        }
        let total_s = each_us.iter().sum::<f64>() * 1e-6;
        each_us.sort_by(f64::total_cmp);
        let at = |q: f64| each_us[((each_us.len() - 1) as f64 * q) as usize];
        println!(
            "{{\"bench\":\"chain\",\"simulated\":true,\"map\":\"{name}\",\"whiskers\":{WHISKERS},\"p50_us\":{:.2},\"p99_us\":{:.2},\
             \"p999_us\":{:.2},\"worst_us\":{:.0},\"times_real_time\":{:.1},\"rows\":{made}}}",
            at(0.5),
            at(0.99),
            at(0.999),
            at(1.0),
            scans.len() as f64 / RATE_HZ / total_s
        );
        let (mut all, mut k) = (whiskers(candidate), 0);
        c.bench_function(&format!("16 whiskers, one scan, {name}"), |b| {
            b.iter(|| {
                k = (k + 1) % scans.len();
                // The stream begins anew at its end.
                if k == 0 {
                    all = whiskers(candidate);
                }
                take(&mut all, &scans[k])
            });
        });
    }
}

criterion_group!(benches, chain);
criterion_main!(benches);
