//! Friction and the wire's own weight, on small SIMULATED series.

use std::collections::BTreeMap;
use wcal_core::observation::WhiskerSpec;
use wcal_lab::dataset::{Dataset, RodSweeps};
use wcal_lab::evaluate::{Method, score_objects};
use wcal_lab::generate_sweeps::{SweepRequest, generate_sweeps};
use wcal_lab::sweep_series::{self, SweepSeries};
use wcal_lab_sweeps::physics::{Medium, PhysicsPlan};
use wcal_lab_sweeps::{SweepPlan, objects};
use wcal_mesh::Mesh;
use wcal_network::filter::BayesSettings;
use wcal_network::{InverseGrid, StaticInverse};

const SWEEPS: usize = 6;
const SEED: u64 = 9;

fn plan(friction: f64, weight: bool) -> SweepPlan {
    let physics = PhysicsPlan {
        friction: [friction; 2],
        medium: Medium::Air,
        weight,
        ..PhysicsPlan::default()
    };
    SweepPlan {
        rate_hz: 10.0,
        physics,
        ..SweepPlan::default()
    }
}

fn meshes() -> BTreeMap<String, Mesh> {
    ["ball", "can"]
        .map(|n| (n.to_owned(), objects::built_in(n).unwrap()))
        .into()
}

fn all_series(plan: &SweepPlan) -> BTreeMap<String, Vec<SweepSeries>> {
    let order = SweepRequest {
        whisker: &WhiskerSpec::nominal(),
        plan,
        seed: SEED,
        sweeps: SWEEPS,
    };
    meshes()
        .into_iter()
        .map(|(name, mesh)| (name, generate_sweeps(&mesh, &order).unwrap()))
        .collect()
}

/// Mean over objects of the median distance to the true contact where it is followed, mm.
fn followed_mm(all_series: &BTreeMap<String, Vec<SweepSeries>>, settings: &BayesSettings) -> f64 {
    let inverse = StaticInverse::new(&WhiskerSpec::nominal(), InverseGrid::default()).unwrap();
    let method = Method::Bayes(&inverse, true, settings);
    let rows = score_objects(&|c: &SweepSeries| method.run(c), all_series, &meshes()).unwrap();
    rows.iter()
        .map(|r| r.followed.true_contact_median_mm)
        .sum::<f64>()
        / rows.len() as f64
}

/// Where the wire slides under friction, a filter that weighs friction finds the contact better
/// than one that knows of none.
#[test]
fn the_filter_that_weighs_friction_follows_a_wire_that_is_dragged() {
    let (with, without) = (
        BayesSettings::multi_mu(),
        BayesSettings {
            friction: [0.0; 3],
            ..BayesSettings::multi_mu()
        },
    );
    let dragged = all_series(&plan(0.2, false));
    let [told, not] = [&with, &without].map(|s| followed_mm(&dragged, s));
    assert!(
        told < 0.7 * not,
        "with friction: {told} mm by a filter that weighs it, {not} mm by one that does not"
    );
    // Negative control: where there is none, the one that knows so is the better of the two.
    let smooth = all_series(&plan(0.0, false));
    let [told, not] = [&with, &without].map(|s| followed_mm(&smooth, s));
    assert!(
        not < told && told < 1.5,
        "without friction: {told} mm, {not} mm"
    );
}

/// The zero of a series is the free wire: its weight is no push, whether the series is drawn on the
/// spot or read.
#[test]
fn a_free_wire_that_hangs_has_no_moment() {
    let plan = plan(0.1, true);
    let folder = tempfile::tempdir().unwrap();
    let dataset = Dataset {
        engine: std::sync::Arc::new(RodSweeps),
        whisker: WhiskerSpec::nominal(),
        plan: plan.clone(),
        objects: vec![objects::built_in("ball").unwrap()],
        sweeps: SWEEPS as u64,
        seed: SEED,
        share: [0, 1],
    };
    dataset.make(folder.path(), |_, _| {}).unwrap();
    let read = sweep_series::read_sweep_series(folder.path(), &[]).unwrap();
    for series in read["ball"].iter().chain(&all_series(&plan)["ball"]) {
        let most = |instants: &mut dyn Iterator<Item = &wcal_lab::SweepSample>| {
            instants
                .map(|i| i.moment_nmm[0].hypot(i.moment_nmm[1]))
                .fold(0.0, f64::max)
        };
        let idle = most(&mut series.samples.iter().take_while(|i| i.contact.is_none()));
        let pressed = most(&mut series.samples.iter().filter(|i| i.contact.is_some()));
        // The wire's weight alone makes 0.008 N mm where it lies level; air makes some 1e-7.
        assert!(
            idle < 1e-4,
            "{}/{}: {idle} N mm",
            series.object,
            series.sweep
        );
        assert!(
            pressed > 0.01,
            "{}/{}: {pressed} N mm",
            series.object,
            series.sweep
        );
    }
    // A series has as many contacts whether it is drawn on the spot or read.
    for (read, drawn) in read["ball"].iter().zip(&all_series(&plan)["ball"]) {
        let counts = |c: &SweepSeries| c.samples.iter().map(|i| i.contacts).collect::<Vec<_>>();
        assert_eq!((read.sweep, counts(read)), (drawn.sweep, counts(drawn)));
    }
    // Negative control: the twin's own moment is that of the weight.
    let samples =
        wcal_lab::dataset::read::table(&folder.path().join(first_shard(folder.path()))).unwrap();
    let [y, z] = ["moment_y_nmm", "moment_z_nmm"].map(|k| samples.real(k).unwrap()[0]);
    assert!(y.hypot(z) > 1e-3, "{y} {z}");
}

fn first_shard(folder: &std::path::Path) -> String {
    let (name, _) = wcal_lab::dataset::read::manifests(folder)
        .unwrap()
        .into_iter()
        .next()
        .unwrap();
    format!("{name}.samples.parquet")
}
