//! The tracker on small simulated series: gradients, order of time, streams, files, training.

use burn::tensor::{Device, Tensor, TensorData};
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::OnceLock;
use wcal_core::observation::WhiskerSpec;
use wcal_lab::dataset::Dataset;
use wcal_lab::evaluate::{Method, score_objects, track_series};
use wcal_lab::generate_sweeps::{SweepRequest, generate_sweeps};
use wcal_lab::model_file::{Card, Split, load, preset, runnable, save};
use wcal_lab::network::TrainableNet;
use wcal_lab::network::attention_bias;
use wcal_lab::sweep_series::{self, SweepSeries};
use wcal_lab::train::{TrainSettings, TrainingData, best, train};
use wcal_lab::train_model::{Seconds, TrainingCost};
use wcal_lab_sweeps::{SweepPlan, objects};
use wcal_network::filter::{BayesFilter, BayesSettings, FilterBank};
use wcal_network::model_file::FORMAT;
use wcal_network::network::NetworkConfig;
use wcal_network::sd_factors::SdFactors;
use wcal_network::{InverseGrid, Sample, StaticInverse, Tracker};

fn whisker() -> WhiskerSpec {
    WhiskerSpec::nominal()
}

fn grid() -> InverseGrid {
    InverseGrid {
        step_mm: 4.0,
        refine: 1,
        tilts: 3,
        directions: 24,
        steps: 16,
        ..InverseGrid::default()
    }
}

/// Of the nominal whisker, coarse.
pub(crate) fn coarse_inverse() -> &'static StaticInverse {
    static INVERSE: OnceLock<StaticInverse> = OnceLock::new();
    INVERSE.get_or_init(|| StaticInverse::new(&whisker(), grid()).unwrap())
}

/// As fine as the filter takes it.
fn fine() -> &'static StaticInverse {
    static FINE: OnceLock<StaticInverse> = OnceLock::new();
    FINE.get_or_init(|| StaticInverse::new(&whisker(), InverseGrid::default()).unwrap())
}

const SEED: u64 = 4;

fn plan() -> SweepPlan {
    SweepPlan {
        rate_hz: 10.0,
        ..SweepPlan::default()
    }
}

/// Ten sweeps over two objects, made once.
fn all_series() -> &'static BTreeMap<String, Vec<SweepSeries>> {
    static COURSES: OnceLock<BTreeMap<String, Vec<SweepSeries>>> = OnceLock::new();
    COURSES.get_or_init(|| {
        let folder = tempfile::tempdir().unwrap();
        let dataset = Dataset {
            engine: std::sync::Arc::new(wcal_lab::dataset::RodSweeps),
            whisker: whisker(),
            plan: plan(),
            objects: ["ball", "can"]
                .map(|n| objects::built_in(n).unwrap())
                .into(),
            sweeps: 5,
            seed: SEED,
            share: [0, 1],
        };
        dataset.make(folder.path(), |_, _| {}).unwrap();
        sweep_series::read_sweep_series(folder.path(), &[]).unwrap()
    })
}

fn tiny() -> NetworkConfig {
    let config = preset("compact", coarse_inverse(), true).unwrap();
    NetworkConfig {
        layers: 2,
        heads: 2,
        width: 16,
        feed_forward: 32,
        encoder: 24,
        context: 24,
        ..config
    }
}

/// Of weights that are the same at each call.
fn net(config: &NetworkConfig) -> TrainableNet {
    let device = Device::flex();
    device.seed(5);
    TrainableNet::new(config, &device).unwrap()
}

fn tracker(config: NetworkConfig) -> Tracker {
    Tracker {
        config,
        net: runnable(&net(&config), &config).unwrap().0,
        inverse: coarse_inverse().clone(),
        filters: TrainSettings::default().filters(),
        sd_factors: [1.0; 2].map(SdFactors::constant),
    }
}

fn samples(series: &SweepSeries) -> Vec<Sample> {
    let one = |i: &wcal_lab::SweepSample| Sample {
        t_s: i.t_s,
        moment_nmm: i.moment_nmm,
        base_mm_s: Some(i.speed_mm_s),
    };
    series.samples.iter().map(one).collect()
}

/// The true contact lies on the curve of solutions; that of half the moment does not pass by it.
#[test]
fn the_curve_of_candidates_passes_through_the_contact() {
    let (mut off, mut wrong, mut solutions) = (Vec::new(), Vec::new(), Vec::new());
    for instant in all_series().values().flatten().flat_map(|c| &c.samples) {
        let Some(contact) = instant
            .contact
            .filter(|_| instant.contacts == 1 && instant.settled)
        else {
            continue;
        };
        let mut nearest = |factor: f64| {
            fine().solutions(instant.moment_nmm.map(|m| m * factor), &mut solutions);
            solutions
                .iter()
                .map(|c| (c.point_mm - contact.point_mm).norm())
                .fold(f64::INFINITY, f64::min)
        };
        off.push(nearest(1.0));
        wrong.push(nearest(0.5));
    }
    let median = |v: &mut Vec<f64>| {
        v.sort_by(f64::total_cmp);
        v[v.len() / 2]
    };
    assert!(off.len() > 200, "{}", off.len());
    // Nodes lie 0.25 mm apart: rounding alone leaves 0.06 in the middle.
    let (right, half) = (median(&mut off), median(&mut wrong));
    assert!(right < 0.1 && half > 3.0 * right, "{right} {half}");
}

/// Where the tip is dragged along, its force leans toward the root: the curve's end holds it, and
/// the wire's own part does not.
#[test]
fn the_curve_holds_a_tip_whose_force_leans() {
    let (mut off, mut square, mut solutions) = (Vec::new(), Vec::new(), Vec::new());
    let on_wire = fine().nodes.iter().take_while(|n| n.tilt == 0.0).count();
    for instant in all_series().values().flatten().flat_map(|c| &c.samples) {
        let Some(contact) = instant
            .contact
            .filter(|c| c.arclength_mm > 59.99 && instant.contacts == 1)
        else {
            continue;
        };
        fine().solutions(instant.moment_nmm, &mut solutions);
        let nearest = |all: &[wcal_network::InverseSolution]| {
            all.iter()
                .map(|c| (c.point_mm - contact.point_mm).norm())
                .fold(f64::INFINITY, f64::min)
        };
        off.push(nearest(&solutions));
        square.push(nearest(&solutions[..on_wire]));
    }
    let p90 = |v: &mut Vec<f64>| {
        v.sort_by(f64::total_cmp);
        v[v.len() * 9 / 10]
    };
    assert!(off.len() > 50, "{}", off.len());
    let (right, wrong) = (p90(&mut off), p90(&mut square));
    assert!(right < 0.25 && wrong > 2.0 * right, "{right} {wrong}");
}

/// A series drawn on the spot is the one that the shards hold.
#[test]
fn drawn_courses_are_those_of_a_dataset() {
    let ball = objects::built_in("ball").unwrap();
    let made = |seed: u64| {
        generate_sweeps(
            &ball,
            &SweepRequest {
                whisker: &whisker(),
                plan: &plan(),
                seed,
                sweeps: 2,
            },
        )
        .unwrap()
    };
    let (right, other, kept) = (made(SEED), made(SEED + 1), &all_series()["ball"][..2]);
    assert_eq!(right.len(), 2);
    for (one, other) in right.iter().zip(kept) {
        assert_eq!((one.sweep, &one.samples), (other.sweep, &other.samples));
    }
    assert!(other[0].samples != kept[0].samples);
}

/// With the base's speed known the filter finds the contact; with another speed stated, it does
/// not.
#[test]
fn the_bayes_filter_follows_with_the_right_speed_only() {
    let meshes = ["ball", "can"]
        .map(|n| (n.to_owned(), objects::built_in(n).unwrap()))
        .into();
    let median = |all_series: &BTreeMap<String, Vec<SweepSeries>>| {
        let settings = BayesSettings::default();
        let method = Method::Bayes(fine(), true, &settings);
        let rows = score_objects(&|c: &SweepSeries| method.run(c), all_series, &meshes).unwrap();
        rows.iter()
            .map(|r| r.followed.true_contact_median_mm)
            .sum::<f64>()
            / rows.len() as f64
    };
    let mut hurried = all_series().clone();
    hurried
        .values_mut()
        .flatten()
        .flat_map(|c| &mut c.samples)
        .for_each(|i| i.speed_mm_s *= 1.6);
    let (right, wrong) = (median(all_series()), median(&hurried));
    assert!(right < 1.0 && wrong > 2.0 * right, "{right} {wrong}");
}

/// A base that stands or goes back, however fast, leaves beliefs and answers numbers; one that
/// keeps its way gives others.
#[test]
fn a_base_that_goes_back_leaves_answers_finite() {
    let tracker = tracker(tiny());
    let series = &all_series()["can"][0];
    let answers = |speed: &dyn Fn(usize) -> f64| {
        let mut all = samples(series);
        all.iter_mut()
            .enumerate()
            .for_each(|(k, s)| s.base_mm_s = Some(speed(k)));
        track_series(&tracker, tracker.filters, &all)
    };
    let back = answers(&|k| [0.0, -30.0, 5.0][k % 3]);
    assert!(
        back.iter()
            .all(|p| p.contact.is_finite() && p.point_mm.iter().all(|x| x.is_finite()))
    );
    assert!(back != answers(&|_| 5.0));
}

#[test]
fn every_parameter_learns() {
    use burn::module::{Module, ModuleVisitor, Param};
    use burn::optim::GradientsParams;
    struct Without<'a>(&'a GradientsParams, usize, Vec<usize>);
    impl ModuleVisitor for Without<'_> {
        fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
            let moved = self
                .0
                .get::<D>(param.id)
                .is_some_and(|g| g.abs().sum().into_scalar::<f32>() > 0.0);
            if !moved {
                self.2.push(self.1);
            }
            self.1 += 1;
        }
    }
    let device = Device::flex().autodiff();
    let config = tiny();
    let net = TrainableNet::new(&config, &device).unwrap();
    let times = vec![(0..6).map(|k| f64::from(k) * 0.1).collect::<Vec<_>>(); 2];
    let inputs: Vec<f32> = (0..2 * 6 * config.inputs)
        .map(|k| ((k * 37 % 101) as f32) / 50.0 - 1.0)
        .collect();
    let inputs = Tensor::<3>::from_data(TensorData::new(inputs, [2, 6, config.inputs]), &device);
    let out = net.forward(
        inputs,
        attention_bias(&times, config.heads, config.context, &device),
    );
    let gradients = GradientsParams::from_grads(out.square().sum().backward(), &net);
    let mut visitor = Without(&gradients, 0, Vec::new());
    net.visit(&mut visitor);
    // Six parts of two tensors a layer; two of the encoder, norm and head.
    assert_eq!((visitor.1, visitor.2), (2 * 12 + 8, Vec::<usize>::new()));
}

#[test]
fn a_later_sample_changes_no_earlier_answer_and_an_earlier_one_does() {
    let tracker = tracker(tiny());
    let all = samples(&all_series()["ball"][0]);
    let answers = track_series(&tracker, tracker.filters, &all);
    let change = |at: usize| {
        let mut changed = all.clone();
        changed[at].moment_nmm[0] += 0.3;
        track_series(&tracker, tracker.filters, &changed)
    };
    let middle = all.len() / 2;
    let later = change(middle);
    assert_eq!(answers[..middle], later[..middle]);
    assert!(answers[middle] != later[middle]);
    // Within the context an earlier sample matters.
    assert!(answers[middle] != change(middle - 5)[middle]);
}

/// A filter that is handed the solutions believes what it does by itself; it is another one than
/// the first.
#[test]
fn a_filter_beside_another_believes_what_it_does_alone() {
    let both = TrainSettings::default().filters();
    let filter = |settings| BayesFilter::new(coarse_inverse(), settings);
    let (mut first, mut beside, mut alone) = (
        filter(both.frictional),
        filter(both.frictionless.unwrap()),
        filter(both.frictionless.unwrap()),
    );
    let mut apart = 0.0_f64;
    for sample in samples(&all_series()["can"][1]) {
        first.step(0.1, sample.moment_nmm, sample.base_mm_s, None);
        beside.step(0.1, sample.moment_nmm, sample.base_mm_s, Some(&first));
        alone.step(0.1, sample.moment_nmm, sample.base_mm_s, None);
        assert_eq!(beside.solutions(), alone.solutions());
        assert_eq!(beside.posterior(), alone.posterior());
        let off = first
            .posterior()
            .iter()
            .zip(beside.posterior())
            .map(|(a, b)| (a - b).abs())
            .sum();
        apart = apart.max(off);
    }
    assert!(apart > 0.1, "{apart}");
}

/// A network that weighs two filters sees both; without the second it is refused.
#[test]
fn a_network_that_weighs_two_filters_needs_both() {
    let both = tracker(tiny());
    both.check().unwrap();
    let one = Tracker {
        filters: both.filters.frictional.into(),
        ..both.clone()
    };
    let error = one.check().unwrap_err().to_string();
    assert!(error.contains("filters below the network"), "{error}");
    let all = samples(&all_series()["can"][1]);
    let with_frictionless = |frictionless| {
        let filters = FilterBank {
            frictionless: Some(frictionless),
            ..both.filters
        };
        track_series(&both, filters, &all)
    };
    // The frictional filter in both places: another answer than with the one for objects without
    // friction.
    let (alone, apart) = (
        with_frictionless(both.filters.frictional),
        track_series(&both, both.filters, &all),
    );
    assert!(
        alone
            .iter()
            .zip(&apart)
            .any(|(a, b)| (a.point_mm[0] - b.point_mm[0]).abs() > 0.1)
    );
}

#[test]
fn a_model_comes_back_from_its_files_and_a_damaged_one_does_not() {
    let folder = tempfile::tempdir().unwrap();
    // Other filters than models have by default: the card says which ones.
    let filters = FilterBank {
        frictional: BayesSettings::multi_mu(),
        ..tracker(tiny()).filters
    };
    let before = Tracker {
        filters,
        ..tracker(tiny())
    };
    let mut card = Card {
        format: FORMAT.into(),
        trained_on_simulation: true,
        weights_sha256: String::new(),
        network: before.config,
        inverse: grid(),
        whisker: whisker(),
        sd_factors: [1.0; 2],
        sd_on_bench: [1.5; 2].map(SdFactors::constant),
        training: TrainSettings {
            filter: filters.frictional,
            ..TrainSettings::default()
        },
        passes: Vec::new(),
        objects: Split::default(),
        data: BTreeMap::new(),
        data_beside: Vec::new(),
        began_with: None,
        sweeps_trained: 0,
        command: vec!["wcal".into(), "train".into()],
        cost: Some(TrainingCost {
            sweeps: None,
            training: Seconds {
                wall_s: 2.5,
                cpu_s: 4.0,
            },
            cores: 2,
        }),
    };
    save(folder.path(), &net(&before.config), &mut card).unwrap();
    let (after, read) = load(folder.path()).unwrap();
    assert_eq!(read, card);
    for _ in 0..8 {
        save(folder.path(), &net(&before.config), &mut card).unwrap();
        assert_eq!(card, read, "the same weights have one hash");
    }
    let all = samples(&all_series()["ball"][2]);
    assert_eq!(
        track_series(&before, before.filters, &all),
        track_series(&after, after.filters, &all)
    );
    // A card tells more than what is read: other keys are left alone.
    let path = folder.path().join("model.json");
    let mut old: serde_json::Value =
        serde_json::from_slice(&std::fs::read(&path).unwrap()).unwrap();
    old["remark"] = serde_json::json!({"slope": 0.5});
    std::fs::write(&path, old.to_string()).unwrap();
    let (of_old, read) = load(folder.path()).unwrap();
    assert!(
        read == card
            && track_series(&of_old, of_old.filters, &all)
                == track_series(&after, after.filters, &all)
    );
    let weights = folder.path().join("model.safetensors");
    let bytes = std::fs::read(&weights).unwrap();
    std::fs::write(&weights, &bytes[..bytes.len() / 2]).unwrap();
    let error = load(folder.path()).err().unwrap().to_string();
    assert!(
        error.contains("model.safetensors") && error.contains("SHA-256"),
        "{error}"
    );
    // With the card adapted to the damage it is the weights' own format that refuses.
    card.weights_sha256 = wcal_core::provenance::sha256_hex(&bytes[..bytes.len() / 2]);
    std::fs::write(
        folder.path().join("model.json"),
        serde_json::to_string(&card).unwrap(),
    )
    .unwrap();
    let error = load(folder.path()).err().unwrap().to_string();
    assert!(error.contains("model.safetensors"), "{error}");
}

/// All passes in one go, and the rest of them after a stop, give the same network; and it has
/// learned something.
#[test]
fn training_learns_and_goes_on_where_it_stopped() {
    let all: Vec<SweepSeries> = all_series().values().flatten().cloned().collect();
    let meshes = BTreeMap::new();
    let material = TrainingData {
        all_series: &all[..8],
        held_out: &all[8..],
        inverse: coarse_inverse(),
        meshes: &meshes,
        from: None,
    };
    let settings = TrainSettings {
        epochs: 10,
        batch: 4,
        window: 48,
        rate: 1e-2,
        patience: 99,
        ..TrainSettings::default()
    };
    let device = Device::flex();
    let (_, whole) = train(&tiny(), &settings, &material, None, &device, |_| {}).unwrap();
    // It begins with what the filter believes: twenty steps add to that, and do not replace it. The
    // best pass is what is kept.
    let kept = best(&whole).unwrap();
    println!(
        "held-out loss: first {:.4}, kept {:.4} (pass {})",
        whole[0].held_out_loss, kept.held_out_loss, kept.epoch
    );
    assert!(
        kept.held_out_loss < 0.93 * whole[0].held_out_loss,
        "{whole:?}"
    );
    let folder = tempfile::tempdir().unwrap();
    let stopped = std::panic::catch_unwind(|| {
        train(
            &tiny(),
            &settings,
            &material,
            Some(folder.path()),
            &device,
            |pass| {
                assert!(pass.epoch < 2, "stopped on purpose");
            },
        )
        .unwrap();
    });
    assert!(stopped.is_err());
    let (_, resumed) = train(
        &tiny(),
        &settings,
        &material,
        Some(folder.path()),
        &device,
        |_| {},
    )
    .unwrap();
    assert_eq!(resumed.len(), 10);
    assert!(
        (resumed[9].held_out_loss - whole[9].held_out_loss).abs() < 1e-4,
        "{resumed:?} {whole:?}"
    );
    let one = TrainSettings {
        filter_frictionless: None,
        ..settings
    };
    let error = train(&tiny(), &one, &material, None, &device, |_| {})
        .err()
        .unwrap();
    assert!(
        error.to_string().contains("filters below the network"),
        "{error}"
    );
    let other = TrainSettings {
        rate: 1e-3,
        ..settings
    };
    let error = train(
        &tiny(),
        &other,
        &material,
        Some(folder.path()),
        &device,
        |_| {},
    )
    .err()
    .unwrap();
    assert!(error.to_string().contains("another folder"), "{error}");
}

/// The models that come with the program, on built-in objects: they have seen scans of other things
/// only.
#[test]
fn the_shipped_models_beat_the_static_inverse_by_far() {
    let meshes = ["ball", "can"]
        .map(|n| (n.to_owned(), objects::built_in(n).unwrap()))
        .into();
    let contact_mm = |method: Method<'_>| {
        let rows = score_objects(&|c: &SweepSeries| method.run(c), all_series(), &meshes).unwrap();
        rows.iter()
            .map(|r| r.followed.true_contact_rmse_mm)
            .sum::<f64>()
            / rows.len() as f64
    };
    for name in ["tracker", "tracker_small"] {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR"))
            .join("../fixtures")
            .join(name);
        let (tracker, card) = load(&folder).unwrap();
        assert!(card.trained_on_simulation && card.objects.training.len() > 20);
        // Cards of before 2026-11-25 name neither command nor cost, and are read all the same.
        assert_eq!(
            (card.command.is_empty(), card.cost.is_none()),
            [(true, true), (false, false)][usize::from(name == "tracker_small")]
        );
        let [known, blind] =
            [true, false].map(|known| contact_mm(Method::Network(&tracker, known)));
        let still = contact_mm(Method::Static(&tracker.inverse, 40.0));
        println!(
            "{name}: speed known {known:.2} mm, not known {blind:.2} mm, static inverse {still:.2} mm"
        );
        assert!(
            known < 0.4 * still && blind < 0.6 * still,
            "{name}: {known} {blind} {still}"
        );
    }
}
