//! Trains a network on a folder of shards: `trial SHARDS EPOCHS [OBJECT that is held out ...]`.
use burn::tensor::Device;
use std::path::Path;
use wcal_core::observation::{RestShape, WhiskerSpec};
use wcal_track::course::read_courses;
use wcal_track::network::{FeatureMaker, NetworkConfig};
use wcal_track::train::{TrainSettings, train};
use wcal_track::{InverseGrid, StaticInverse};
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
    let inverse = StaticInverse::new(
        &whisker,
        InverseGrid { step_mm: 2.0, refine: 1, slants: 6, ..InverseGrid::default() },
    )?;
    println!("nodes {}", inverse.nodes.len());
    let all = read_courses(Path::new(&words[0]), &[])?;
    let (mut courses, mut held) = (Vec::new(), Vec::new());
    for (k, (_, c)) in all.into_iter().enumerate() {
        if k % 8 == 5 { held.extend(c.into_iter().take(12)) } else { courses.extend(c) }
    }
    println!("{} courses, {} held out", courses.len(), held.len());
    let nodes = inverse.nodes.len();
    let config = NetworkConfig::small(FeatureMaker::width(nodes), nodes);
    let settings = TrainSettings { epochs: words[1].parse()?, ..TrainSettings::default() };
    train(&config, &settings, &inverse, &courses, &held, &Device::flex(), |p, _| {
        println!("{p:?}");
        true
    })?;
    Ok(())
}
