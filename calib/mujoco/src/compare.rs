//! What MuJoCo's wire gets wrong by its links alone: statics against the continuous rod under the
//! same load.
//!
//! The rod is pulled at 2/3 of its length without friction and gives force F, place s and
//! root moment M; MuJoCo's wire is pushed by the same F at s until it rests. Errors: |r -
//! r_rod| / |r_rod - r_rest| and |M - M_rod| / |M_rod|; both fall with 1 / links^2 (second
//! order).

use crate::engine::protocol::{Frame, Request};
use crate::mjcf::{MjcfOptions, mjcf};
use crate::{MujocoEngine, TwinError};
use nalgebra::Vector3;
use schemars::JsonSchema;
use serde::Serialize;
use wcal_core::observation::WhiskerSpec;
use wcal_rod::{Guess, Rod, Tangential};

/// Under the rod's own contact force: how far the wire is from where the rod is.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, JsonSchema)]
pub struct Statics {
    /// Links.
    pub links: usize,
    /// Distance of the loaded point from the rod's over its deflection.
    pub point_error: f64,
    /// Difference of the base moments over the rod's.
    pub moment_error: f64,
}

/// Place of the load and its way, share of the length.
const LOADED_AT: f64 = 2.0 / 3.0;
const PULLED: [f64; 3] = [0.0, 0.05, 0.067];
const PULLS: u32 = 10;
/// Steps under the load.
const PUSH_STEPS: u64 = 3000;

/// Loads the wire as the rod is loaded.
///
/// # Errors
/// Where the engine fails or the rod has no equilibrium there.
pub fn statics(
    engine: &mut MujocoEngine,
    whisker: &WhiskerSpec,
    options: &MjcfOptions,
) -> Result<Statics, TwinError> {
    let refuse = |found: String| TwinError::value("whisker", "a wire that can be bent", found);
    let rod = Rod::new(whisker, 0.5).map_err(|e| refuse(e.to_string()))?;
    let length_mm = rod.shape.length_mm;
    let from = rod.shape.rest_point(LOADED_AT * length_mm);
    let mut guess = Guess {
        force_n: Vector3::zeros(),
        arclength_mm: LOADED_AT * length_mm,
    };
    let mut held = None;
    // Continuation: each pull starts from the equilibrium before.
    for leg in 1..=PULLS {
        let point = from + Vector3::from(PULLED) * (length_mm * f64::from(leg) / f64::from(PULLS));
        let found = rod
            .solve(&point, &guess, Tangential::Frictionless)
            .map_err(|e| refuse(format!("{e:?}")))?;
        guess = Guess::from(&found);
        held = Some(found);
    }
    let held = held.ok_or_else(|| refuse("no equilibrium".to_owned()))?;
    // The same force on the link that holds its place.
    engine.load(&mjcf(whisker, options)?, false)?;
    // At the arc length where the rod is held: there the two are compared.
    let link_mm = length_mm / options.links as f64;
    let link = ((held.arclength_mm / link_mm) as usize).min(options.links - 1);
    let along_mm = held.arclength_mm - link as f64 * link_mm;
    let frame = engine.frame(&Request::Push {
        body: format!("link{link}"),
        along_m: along_mm * 1e-3,
        force_n: held.force_n.into(),
        steps: PUSH_STEPS,
    })?;
    // MuJoCo gives m and N m, the rod mm and N mm.
    let point = point_on(&frame, link, along_mm);
    let moment = Vector3::from(frame.base_moment_nm.unwrap_or([f64::NAN; 3])) * 1e3;
    let rest = rod.shape.rest_point(held.arclength_mm);
    Ok(Statics {
        links: options.links,
        point_error: (point - held.point_mm).norm() / (held.point_mm - rest).norm(),
        moment_error: (moment - held.moment_nmm).norm() / held.moment_nmm.norm(),
    })
}

fn point_on(frame: &Frame, link: usize, along_mm: f64) -> Vector3<f64> {
    let at = |j: usize| Vector3::from(frame.links_m[j]) * 1e3;
    // A link is straight between its joints.
    at(link) + (at(link + 1) - at(link)).normalize() * along_mm
}
