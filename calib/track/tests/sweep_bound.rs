//! The bound of sweeps and the error of the Bayes filter, which knows the base's speed, on SIMULATED sweeps over built-in objects.
#![allow(clippy::unwrap_used, reason = "a test that fails should say where")]
#![allow(missing_docs, reason = "tests")]
#![allow(clippy::print_stdout, reason = "tests")]

use nalgebra::Vector3;
use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal};
use wcal_core::observation::WhiskerSpec;
use wcal_sim::SweepPlan;
use wcal_sim::objects::built_in;
use wcal_track::filter::{BayesFilter, BayesSettings};
use wcal_track::generate_sweeps::{SweepRequest, generate_sweeps};
use wcal_track::sweep_bound::transition::TransitionDensities;
use wcal_track::sweep_bound::{ContactBound, SweepContacts, SweepKnowledge};
use wcal_track::{InverseGrid, StaticInverse, SweepSeries};

const OBJECTS: [&str; 6] = ["ball", "block", "can", "vase", "wedge", "rock"];
/// Noise of the moments, N mm.
const NOISE_NMM: f64 = 0.002;

fn sweeps() -> Vec<SweepSeries> {
    let plan = SweepPlan { rate_hz: 10.0, ..SweepPlan::default() };
    let request = SweepRequest { whisker: &WhiskerSpec::nominal(), plan: &plan, seed: 31, sweeps: 4 };
    OBJECTS.iter().flat_map(|name| generate_sweeps(&built_in(name).unwrap(), &request).unwrap()).collect()
}

/// Errors of the filter in space where there is a bound, mm.
fn filter_errors(
    inverse: &StaticInverse,
    series: &SweepSeries,
    noise_nmm: f64,
    seed: u64,
) -> Vec<Vector3<f64>> {
    let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
    let settings = BayesSettings::default().with_measurement_noise(noise_nmm, 0.0);
    let mut filter = BayesFilter::new(inverse, settings);
    let mut last_s = 0.0;
    let one = |s: &wcal_track::SweepSample| {
        let dt_s = s.t_s - std::mem::replace(&mut last_s, s.t_s);
        let mut noisy = || -> f64 {
            noise_nmm * <StandardNormal as Distribution<f64>>::sample(&StandardNormal, &mut rng)
        };
        let moment = s.moment_nmm.map(|m| m + noisy());
        let belief = filter.step(dt_s, moment, Some(s.speed_mm_s));
        match (belief, s.contact) {
            (Some(b), Some(c)) => b.point_mm - c.point_mm,
            _ => Vector3::repeat(f64::NAN),
        }
    };
    series.samples.iter().map(one).collect()
}

#[test]
fn no_filter_beats_the_bound_and_less_knowledge_raises_it() {
    let inverse = StaticInverse::new(&WhiskerSpec::nominal(), InverseGrid::default()).unwrap();
    let all = sweeps();
    let contacts: Vec<SweepContacts<'_>> = all.iter().map(|s| SweepContacts::new(&inverse, s)).collect();
    let densities = TransitionDensities::of_sweeps(&contacts).unwrap();
    println!("SIMULATED: {} sweeps; transition {densities:?}", all.len());
    let rms = |values: &[f64]| (values.iter().map(|v| v * v).sum::<f64>() / values.len() as f64).sqrt();
    let median = |values: &mut Vec<f64>| {
        values.sort_by(f64::total_cmp);
        values[values.len() / 2]
    };
    let speeds = |known: bool| (!known).then_some(([2.5, 7.5], 0.4));
    let bounds_mm = |noise_nmm: f64, known: bool| -> Vec<f64> {
        let knowledge = SweepKnowledge::of_noise(noise_nmm, speeds(known));
        contacts
            .iter()
            .flat_map(|c| c.bound(&densities, &knowledge))
            .flatten()
            .filter(ContactBound::is_regular)
            .map(|b| b.contact_mm())
            .collect()
    };
    let knowledge = SweepKnowledge::of_noise(NOISE_NMM, None);
    let (mut errors, mut bounds, mut surface) = (Vec::new(), Vec::new(), Vec::new());
    for (k, (series, contacts)) in all.iter().zip(&contacts).enumerate() {
        let off = filter_errors(&inverse, series, NOISE_NMM, k as u64);
        for (e, b) in off.iter().zip(contacts.bound(&densities, &knowledge)) {
            let Some(b) = b.filter(|b| b.is_regular() && e.norm().is_finite()) else { continue };
            assert!(b.covariance_mm2.symmetric_eigenvalues().min() > -1e-9, "{b:?}");
            errors.push(e.norm());
            bounds.push(b.contact_mm());
            surface.push((b.normal.dot(e).abs(), b.surface_mm()));
        }
    }
    let (across, across_bound): (Vec<f64>, Vec<f64>) = surface.into_iter().unzip();
    println!(
        "{} samples at {NOISE_NMM} N mm: filter {:.2} mm RMS, median {:.2}; bound {:.2} RMS, median {:.2}; across {:.3} of {:.3}",
        errors.len(),
        rms(&errors),
        median(&mut errors.clone()),
        rms(&bounds),
        median(&mut bounds.clone()),
        rms(&across),
        rms(&across_bound)
    );
    assert!(errors.len() > 500, "{}", errors.len());
    // Every estimator's error is the bound's or more; the margin is the scatter of 24 sweeps.
    assert!(rms(&errors) > 0.9 * rms(&bounds));
    assert!(rms(&across) > 0.9 * rms(&across_bound));
    // Controls: more noise and less knowledge of the motion raise it, and it is of a size that means something.
    let [quiet, noisy] = [1e-4, 0.01].map(|n| rms(&bounds_mm(n, true)));
    let unknown = rms(&bounds_mm(NOISE_NMM, false));
    println!("bound at 1e-4 N mm {quiet:.3}, at 0.01 {noisy:.3}; speed not known {unknown:.3} mm RMS");
    assert!(quiet < rms(&bounds) && rms(&bounds) < noisy);
    assert!(unknown > rms(&bounds) * 1.01);
    assert!(noisy < 30.0);
    a_zero_and_a_gain_that_are_not_known_raise_it(&all, &contacts, &densities);
}

fn a_zero_and_a_gain_that_are_not_known_raise_it(
    all: &[SweepSeries],
    contacts: &[SweepContacts<'_>],
    densities: &TransitionDensities,
) {
    let median = |of: &dyn Fn(&SweepSeries) -> SweepKnowledge| {
        let each = all.iter().zip(contacts).flat_map(|(s, c)| c.bound(densities, &of(s))).flatten();
        let mut each: Vec<f64> = each.map(|b| b.contact_mm()).collect();
        each.sort_by(f64::total_cmp);
        each[each.len() / 2]
    };
    let plain = |_: &SweepSeries| SweepKnowledge::of_noise(NOISE_NMM, None);
    let drifting = |s: &SweepSeries| SweepKnowledge { drift_nmm2_per_s: 1e-5, ..plain(s) };
    let gain = |share: f64| {
        move |s: &SweepSeries| {
            let of = |i: &wcal_track::SweepSample| vec![i.moment_nmm.map(|m| share * m)];
            SweepKnowledge { shared_nmm: s.samples.iter().map(of).collect(), ..plain(s) }
        }
    };
    let (own, drift, one, none) =
        (median(&plain), median(&drifting), median(&gain(0.05)), median(&gain(0.0)));
    println!("median bound {own:.3} mm; zero that drifts {drift:.3}; gain known to 5 % {one:.3}");
    assert!(drift > own * 1.02 && one > own * 1.02);
    assert!((none / own - 1.0).abs() < 1e-6, "a gain that is known changes nothing: {none} {own}");
}
