//! What `wcal-lab simulate` reads: whisker and objects.

use super::arguments::SimulateArgs;
use anyhow::{Context, bail, ensure};
use nalgebra::Vector3;
use serde::Deserialize;
use std::path::{Path, PathBuf};
use wcal::fit_whisker;
use wcal_acquisition::rig::RIG_FORMAT;
use wcal_core::document;
use wcal_core::format;
use wcal_core::observation::{RestShape, WHISKER_RANGES, WhiskerSpec};
use wcal_core::ranges::{self, Range};
use wcal_lab_sweeps::objects;
use wcal_mesh::Mesh;
use wcal_mujoco::mjcf::{MjcfOptions, Touch};
use wcal_session::SESSION_FORMAT;

#[derive(Debug, Deserialize)]
struct WhiskerFile {
    whisker: WhiskerKeys,
    dynamics: Option<DynamicsKeys>,
}

/// Keys of `[dynamics]` as `wcal fit-whisker --dynamics` writes them.
#[derive(Debug, Deserialize)]
struct DynamicsKeys {
    damping_s: f64,
    armature_s2: f64,
    contact_time_s: f64,
    width_mm: f64,
    impedance: [f64; 2],
}

/// Numbers of `[dynamics]`.
const RANGES: &[Range] = &[
    Range::real("dynamics.damping_s", 1e-9, 1e3),
    Range::real("dynamics.armature_s2", 1e-15, 1e3),
    Range::real("dynamics.contact_time_s", 1e-6, 10.0),
    Range::real("dynamics.width_mm", 1e-6, 1e3),
    Range::real("dynamics.impedance", 1e-4, 0.9999),
];

/// Keys of `[whisker]` as in session.toml.
#[derive(Debug, Deserialize)]
struct WhiskerKeys {
    diameter_mm: f64,
    length_mm: f64,
    straight_mm: Option<f64>,
    arc_radius_mm: Option<f64>,
    /// Points of another shape, mm.
    rest_shape: Option<Vec<[f64; 3]>>,
    #[serde(default = "youngs_gpa")]
    youngs_gpa: f64,
    #[serde(default = "shear_gpa")]
    shear_gpa: f64,
}

/// NiTi (docs/src/system.md).
fn youngs_gpa() -> f64 {
    75.0
}

fn shear_gpa() -> f64 {
    28.2
}

fn read(path: &Path) -> anyhow::Result<WhiskerFile> {
    let reading = || format!("reading {}", path.display());
    let text = wcal_core::files::read_text(path)?;
    let table = document::toml(&text).with_context(reading)?;
    // The keys are those of a session and of a rig, too; a table of one's own may state no format.
    let found = table.get("format").and_then(toml::Value::as_str);
    if table.contains_key("format") && found != Some(SESSION_FORMAT) && found != Some(RIG_FORMAT) {
        format::expect(fit_whisker::FORMAT, found)
            .map_err(anyhow::Error::msg)
            .with_context(reading)?;
    }
    ranges::check(&table, &[RANGES, WHISKER_RANGES]).with_context(reading)?;
    document::toml_as(&text).with_context(reading)
}

/// Damping and contact of a file for MuJoCo's wire; the usual ones where it has none.
///
/// # Errors
/// Where the file cannot be read.
pub(crate) fn mjcf_options(path: Option<&Path>) -> anyhow::Result<MjcfOptions> {
    let usual = MjcfOptions::default();
    let Some(found) = path.map(read).transpose()?.and_then(|file| file.dynamics) else {
        return Ok(usual);
    };
    let touch = Touch {
        time_s: found.contact_time_s,
        width_mm: found.width_mm,
        impedance: found.impedance,
        ..usual.touch
    };
    Ok(MjcfOptions {
        damping_s: found.damping_s,
        armature_s2: found.armature_s2,
        touch,
        ..usual
    })
}

/// Whisker of a file, or the nominal one.
///
/// # Errors
/// Where the file cannot be read.
pub fn whisker(path: Option<&Path>) -> anyhow::Result<WhiskerSpec> {
    let Some(path) = path else {
        return Ok(WhiskerSpec::nominal());
    };
    let keys = read(path)?.whisker;
    let rest_shape = match (keys.rest_shape, keys.straight_mm, keys.arc_radius_mm) {
        (Some(points), None, None) => {
            RestShape::Polyline(points.into_iter().map(Vector3::from).collect())
        }
        (None, Some(straight_mm), Some(arc_radius_mm)) => RestShape::StraightArc {
            straight_mm,
            arc_radius_mm,
            length_mm: keys.length_mm,
        },
        (points, straight, radius) => {
            let keys = [
                ("straight_mm", straight.is_some()),
                ("arc_radius_mm", radius.is_some()),
                ("rest_shape", points.is_some()),
            ];
            let found: Vec<&str> = keys.iter().filter(|k| k.1).map(|k| k.0).collect();
            bail!(
                "{}, [whisker]: expected straight_mm and arc_radius_mm, or rest_shape, found {}",
                path.display(),
                if found.is_empty() {
                    "neither".to_owned()
                } else {
                    found.join(" and ")
                }
            );
        }
    };
    let whisker = WhiskerSpec {
        diameter_mm: keys.diameter_mm,
        youngs_gpa: keys.youngs_gpa,
        shear_gpa: keys.shear_gpa,
        density_kg_m3: None,
        rest_shape,
        gravity_direction: None,
    };
    whisker
        .check()
        .with_context(|| format!("{}, [whisker]", path.display()))?;
    Ok(whisker)
}

/// Usable objects, and those left out with the reason.
///
/// # Errors
/// Where two have one name, or none is usable.
pub(crate) fn objects_of(args: &SimulateArgs) -> anyhow::Result<(Vec<Mesh>, Vec<String>)> {
    let (mut all, mut left_out) = (Vec::new(), Vec::new());
    for name in &args.object {
        if name == "all" {
            for name in objects::NAMES {
                all.push(objects::built_in(name)?);
            }
        } else {
            all.push(objects::built_in(name)?);
        }
    }
    for path in &args.meshes {
        for file in stl_files(path)? {
            match Mesh::read(&file) {
                Ok(mesh) => all.push(mesh),
                Err(e) => left_out.push(format!("{} is left out: {e}", file.display())),
            }
        }
    }
    let mut names: Vec<&str> = all.iter().map(|m| m.name.as_str()).collect();
    names.sort_unstable();
    if let Some(twice) = names.windows(2).find(|w| w[0] == w[1]) {
        bail!(
            "expected objects of different names, found {:?} twice",
            twice[0]
        );
    }
    ensure!(
        !all.is_empty(),
        "expected an object (--object NAME or --meshes PATH), found none{}",
        if left_out.is_empty() {
            String::new()
        } else {
            format!(": {}", left_out.join("; "))
        }
    );
    Ok((all, left_out))
}

fn stl_files(path: &Path) -> anyhow::Result<Vec<PathBuf>> {
    if !path.is_dir() {
        return Ok(vec![path.to_owned()]);
    }
    let mut files = Vec::new();
    for entry in std::fs::read_dir(path).with_context(|| format!("reading {}", path.display()))? {
        let file = entry?.path();
        // Finder and others leave "._NAME" beside NAME.
        let hidden = file
            .file_name()
            .is_some_and(|name| name.to_string_lossy().starts_with('.'));
        if !hidden
            && file
                .extension()
                .is_some_and(|e| e.eq_ignore_ascii_case("stl"))
        {
            files.push(file);
        }
    }
    ensure!(
        !files.is_empty(),
        "{}: expected STL files, found none",
        path.display()
    );
    files.sort();
    Ok(files)
}
