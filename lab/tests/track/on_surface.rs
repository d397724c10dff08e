//! Answers are trained to lie on the object's surface, too. On small SIMULATED series.

use crate::tracking::coarse_inverse;
use burn::tensor::Device;
use nalgebra::{Point3, Vector3};
use std::collections::BTreeMap;
use wcal_core::observation::WhiskerSpec;
use wcal_lab::SweepSeries;
use wcal_lab::evaluate::{Method, score_objects};
use wcal_lab::generate_sweeps::{SweepRequest, generate_sweeps};
use wcal_lab::model_file::{preset, runnable};
use wcal_lab::train::{TrainSettings, TrainingData, train};
use wcal_lab_sweeps::{SweepPlan, objects};
use wcal_mesh::Mesh;
use wcal_network::Tracker;
use wcal_network::network::NetworkConfig;
use wcal_network::sd_factors::SdFactors;

type Meshes = BTreeMap<String, Mesh>;

fn meshes() -> Meshes {
    ["ball", "can"]
        .map(|n| (n.to_owned(), objects::built_in(n).unwrap()))
        .into()
}

fn all_series(meshes: &Meshes, seed: u64, sweeps: usize) -> BTreeMap<String, Vec<SweepSeries>> {
    let (whisker, plan) = (
        WhiskerSpec::nominal(),
        SweepPlan {
            rate_hz: 10.0,
            max_travel_mm: 60.0,
            ..SweepPlan::default()
        },
    );
    let order = SweepRequest {
        whisker: &whisker,
        plan: &plan,
        seed,
        sweeps,
    };
    meshes
        .iter()
        .map(|(n, mesh)| (n.clone(), generate_sweeps(mesh, &order).unwrap()))
        .collect()
}

#[test]
fn a_point_above_the_ball_comes_down_to_where_it_was_lifted_from() {
    let meshes = meshes();
    let (ball, series) = (&meshes["ball"], &all_series(&meshes, 3, 1)["ball"][0]);
    let middle = Point3::from((ball.low_mm + ball.high_mm) / 2.0);
    let mut touched = 0;
    for instant in &series.samples {
        let Some(contact) = instant.contact else {
            continue;
        };
        let middle = series.base_from_object * middle - Vector3::z() * instant.travel_mm;
        let lifted = contact.point_mm + (contact.point_mm - middle.coords).normalize() * 2.0;
        let found = series.closest_surface_point(ball, instant.travel_mm, &lifted);
        // Facets of the ball are tilted by up to a tenth.
        assert!(
            (found - contact.point_mm).norm() < 0.3,
            "{found} {}",
            contact.point_mm
        );
        assert!((series.surface_distance_mm(ball, instant.travel_mm, &lifted) - 2.0).abs() < 0.05);
        assert!(series.surface_distance_mm(ball, instant.travel_mm, &found) < 1e-9);
        // Negative control: the object has moved on.
        let later = series.closest_surface_point(ball, instant.travel_mm + 20.0, &lifted);
        assert!((later - contact.point_mm).norm() > 1.0);
        touched += 1;
    }
    assert!(touched > 20, "{touched}");
}

/// The same network on the same series, with the true contacts alone, with the surfaces, and with
/// each other's.
#[test]
fn answers_come_nearer_to_the_surface_where_training_knows_it() {
    let meshes = meshes();
    let inverse = coarse_inverse();
    let small = preset("compact", inverse, true).unwrap();
    let config = NetworkConfig {
        layers: 1,
        heads: 2,
        width: 16,
        feed_forward: 32,
        encoder: 24,
        context: 24,
        ..small
    };
    let settings = TrainSettings {
        epochs: 40,
        batch: 4,
        window: 48,
        rate: 3e-3,
        patience: 99,
        noise_nmm: 0.0,
        ..TrainSettings::default()
    };
    let trained: Vec<SweepSeries> = all_series(&meshes, 3, 6).into_values().flatten().collect();
    let held_out: Vec<SweepSeries> = all_series(&meshes, 4, 2).into_values().flatten().collect();
    let judged = all_series(&meshes, 5, 6);
    let device = Device::flex();
    let surface_mm = |known: &Meshes| {
        let material = TrainingData {
            all_series: &trained,
            held_out: &held_out,
            inverse,
            meshes: known,
            from: None,
        };
        let (net, passes) = train(&config, &settings, &material, None, &device, |_| {}).unwrap();
        assert!(
            passes
                .iter()
                .all(|p| p.held_out_surface_mm.is_some() != known.is_empty())
        );
        let (filters, inverse) = (settings.filters(), inverse.clone());
        let tracker = Tracker {
            config,
            net: runnable(&net, &config).unwrap().0,
            inverse,
            filters,
            sd_factors: [1.0; 2].map(SdFactors::constant),
        };
        let rows = score_objects(
            &|c: &SweepSeries| Method::Network(&tracker, true).run(c),
            &judged,
            &meshes,
        );
        let rows = rows.unwrap();
        rows.iter().map(|r| r.all.rmse_mm).sum::<f64>() / rows.len() as f64
    };
    let swapped = [("ball", "can"), ("can", "ball")]
        .map(|(n, of)| (n.to_owned(), meshes[of].clone()))
        .into();
    let [contacts, surfaces, wrong] = [&Meshes::new(), &meshes, &swapped].map(surface_mm);
    println!(
        "from the surface: {contacts:.3} mm, with surfaces {surfaces:.3} mm, with wrong ones {wrong:.3} mm"
    );
    assert!(
        surfaces < contacts && surfaces < wrong,
        "{contacts} {surfaces} {wrong}"
    );
}
