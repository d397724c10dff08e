//! Trains a network on a folder of shards and scores it beside the baselines: `trial SHARDS MESHES EPOCHS MODEL`.
use burn::tensor::Device;
use std::collections::BTreeMap;
use std::path::Path;
use wcal_core::observation::{RestShape, WhiskerSpec};
use wcal_mujoco::Mesh;
use wcal_track::course::read_courses;
use wcal_track::evaluate::{Method, over_objects};
use wcal_track::model_file::{network_grid, preset};
use wcal_track::train::{Material, TrainSettings, train};
use wcal_track::{InverseGrid, StaticInverse, Tracker};
fn main() -> Result<(), Box<dyn std::error::Error>> {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let whisker = WhiskerSpec {
        diameter_mm: 0.3,
        youngs_gpa: 75.0,
        shear_gpa: 28.2,
        density_kg_m3: None,
        rest_shape: RestShape::StraightArc { straight_mm: 30.0, arc_radius_mm: 20.0, length_mm: 60.0 },
        gravity_direction: None,
    };
    let inverse = StaticInverse::new(&whisker, network_grid())?;
    let all = read_courses(Path::new(&words[0]), &[])?;
    let (mut courses, mut held, mut seen, mut unseen) =
        (Vec::new(), Vec::new(), BTreeMap::new(), BTreeMap::new());
    for (k, (name, mut c)) in all.into_iter().enumerate() {
        match k % 8 {
            5 => held.extend(c.into_iter().take(12)),
            2 => {
                c.truncate(8);
                unseen.insert(name, c);
            }
            _ => {
                let rest = c.split_off(c.len() - 8);
                if k % 8 == 0 {
                    seen.insert(name, rest);
                }
                courses.extend(c)
            }
        }
    }
    println!("{} courses, {} held out", courses.len(), held.len());
    let config = preset("default", &inverse)?;
    let settings = TrainSettings { epochs: words[2].parse()?, ..TrainSettings::default() };
    let material = Material { courses: &courses, held_out: &held, inverse: &inverse };
    let (net, _) = train(&config, &settings, &material, Some(Path::new(&words[3])), &Device::flex(), |p| {
        println!("{p:?}")
    })?;
    let tracker = Tracker { config, net, inverse, sd_factor: 1.0, device: Device::flex() };
    let fine = StaticInverse::new(&whisker, InverseGrid::default())?;
    for (what, set) in [("seen", &seen), ("unseen", &unseen)] {
        let meshes: BTreeMap<String, Mesh> = set
            .keys()
            .map(|n| Ok((n.clone(), Mesh::read(&Path::new(&words[1]).join(format!("{n}.stl")))?)))
            .collect::<Result<_, wcal_mujoco::TwinError>>()?;
        for (name, method) in [
            ("net, speed known", Method::Network(&tracker, true)),
            ("net", Method::Network(&tracker, false)),
            ("bayes, speed known", Method::Bayes(&fine, true)),
            ("bayes", Method::Bayes(&fine, false)),
            ("static 40 mm", Method::Static(&fine, 40.0)),
            ("constant", Method::Constant([40.0, 0.0, -3.0].into())),
        ] {
            let rows = over_objects(method, set, &meshes)?;
            let n = rows.len() as f64;
            let mean =
                |f: &dyn Fn(&wcal_track::evaluate::ObjectScores) -> f64| rows.iter().map(f).sum::<f64>() / n;
            println!(
                "{what:7} {name:20} surface rmse {:.3} (followed {:.3}), true contact rmse {:.3} ({:.3}) median {:.3}, cover90 {:.3}, F1 {:.3}",
                mean(&|r| r.all.rmse_mm),
                mean(&|r| r.followed.rmse_mm),
                mean(&|r| r.all.true_contact_rmse_mm),
                mean(&|r| r.followed.true_contact_rmse_mm),
                mean(&|r| r.all.true_contact_median_mm),
                mean(&|r| r.all.coverage90.unwrap_or(0.0)),
                mean(&|r| r.detection.f1)
            );
        }
    }
    Ok(())
}
