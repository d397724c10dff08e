//! Time of a streamed row, and where it goes: inverse, filters, network, answer.
//!
//! `stream_time MODEL ROWS`: sweeps over built-in objects (SIMULATED), streamed row by row on one
//! thread, with the base's speed known and not known; prints a table. Times are of the processor,
//! so that who else computes on the machine counts little; the last column is the slowest of a
//! hundred by the clock. Inverse and filters are timed by themselves on the same rows.
#![allow(missing_docs, clippy::print_stdout, reason = "an example")]

use std::path::Path;
use std::time::Instant;
use wcal_lab::SweepSeries;
use wcal_lab::dataset::thread_s;
use wcal_lab::generate_sweeps::{SweepRequest, generate_sweeps};
use wcal_lab::model_file::load;
use wcal_lab_sweeps::{SweepPlan, objects};
use wcal_network::network::FeatureExtractor;
use wcal_network::{Sample, Tracker};

/// As in `wcal`.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

const OBJECTS: [&str; 4] = ["can", "vase", "block", "ball"];
const SEED: u64 = 5;
const SWEEPS: usize = 5;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let args: Vec<String> = std::env::args().collect();
    let [_, model, rows] = &args[..] else {
        return Err("stream_time MODEL ROWS".into());
    };
    let rows: usize = rows.parse()?;
    let (tracker, card) = load(Path::new(model))?;
    let plan = SweepPlan {
        rate_hz: 10.0,
        ..SweepPlan::default()
    };
    let order = SweepRequest {
        whisker: &card.whisker,
        plan: &plan,
        seed: SEED,
        sweeps: SWEEPS,
    };
    let mut all = Vec::new();
    for name in OBJECTS {
        all.extend(generate_sweeps(&objects::built_in(name)?, &order)?);
    }
    println!(
        "speed      rows/s  mean us  p50 us  p99 us | inverse us  filters us  network and answer us | p99 by the clock us"
    );
    for known in [true, false] {
        let samples: Vec<Vec<Sample>> = all.iter().map(|s| samples(s, known)).collect();
        let [mut us, mut clock_us] = whole(&tracker, &samples, rows);
        let features = features(&tracker, &samples, rows);
        let inverse = inverse(&tracker, &samples, rows);
        let mean = us.iter().sum::<f64>() / us.len() as f64;
        us.sort_by(f64::total_cmp);
        clock_us.sort_by(f64::total_cmp);
        println!(
            "{:9} {:7.0} {mean:8.0} {:7.0} {:7.0} | {inverse:10.0} {:11.0} {:22.0} | {:19.0}",
            if known { "known" } else { "not known" },
            1e6 / mean,
            us[us.len() / 2],
            us[us.len() * 99 / 100],
            features - inverse,
            mean - features,
            clock_us[clock_us.len() * 99 / 100]
        );
    }
    Ok(())
}

fn samples(series: &SweepSeries, known: bool) -> Vec<Sample> {
    let sample = |i: &wcal_lab::SweepSample| Sample {
        t_s: i.t_s,
        moment_nmm: i.moment_nmm,
        base_mm_s: known.then_some(i.speed_mm_s),
    };
    series.samples.iter().map(sample).collect()
}

/// Every row's time, of the processor and by the clock, us.
fn whole(tracker: &Tracker, all: &[Vec<Sample>], rows: usize) -> [Vec<f64>; 2] {
    let (mut us, mut clock_us) = (Vec::with_capacity(rows), Vec::with_capacity(rows));
    for samples in all.iter().cycle() {
        let mut stream = tracker.stream();
        for sample in samples {
            let (begin, begin_s) = (Instant::now(), thread_s());
            std::hint::black_box(stream.push(sample));
            us.push((thread_s() - begin_s) * 1e6);
            clock_us.push(begin.elapsed().as_secs_f64() * 1e6);
        }
        if us.len() >= rows {
            break;
        }
    }
    [us, clock_us]
}

/// Mean time of the network's inputs, us.
fn features(tracker: &Tracker, all: &[Vec<Sample>], rows: usize) -> f64 {
    let (begin_s, mut count) = (thread_s(), 0);
    for samples in all.iter().cycle() {
        let mut features = FeatureExtractor::new(&tracker.inverse, tracker.filters);
        for sample in samples {
            std::hint::black_box(features.push(0.1, sample.moment_nmm, sample.base_mm_s));
        }
        count += samples.len();
        if count >= rows {
            break;
        }
    }
    (thread_s() - begin_s) * 1e6 / count as f64
}

/// Mean time of the curve of solutions, us.
fn inverse(tracker: &Tracker, all: &[Vec<Sample>], rows: usize) -> f64 {
    let mut out = Vec::new();
    let begin_s = thread_s();
    for sample in all.iter().flatten().cycle().take(rows) {
        tracker.inverse.solutions(sample.moment_nmm, &mut out);
        std::hint::black_box(&out);
    }
    (thread_s() - begin_s) * 1e6 / rows as f64
}
