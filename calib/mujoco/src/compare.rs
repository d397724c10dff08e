//! What MuJoCo's wire gets wrong: statics against the continuous rod under the same load, sweeps against the quasi-static rod.

use crate::convex::Convex;
use crate::engine::protocol::{Frame, Request};
use crate::mjcf::{MjcfOptions, mjcf};
use crate::rod_engine::LINKS;
use crate::{CableEngine, Mesh, MujocoEngine, RodEngine, Sweep, SweepPlan, TwinError, Verdict};
use nalgebra::Vector3;
use serde::Serialize;
use wcal_core::observation::WhiskerSpec;
use wcal_rod::{Guess, Rod, Tangential};

/// Under the rod's own contact force: how far the wire is from where the rod is.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
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
    let refuse = |found: String| TwinError::Value {
        what: "whisker",
        expected: "a wire that can be bent".to_owned(),
        found,
    };
    let rod = Rod::new(whisker, 0.5).map_err(|e| refuse(e.to_string()))?;
    let length_mm = rod.shape.length_mm;
    let from = rod.shape.rest_point(LOADED_AT * length_mm);
    let mut guess = Guess { force_n: Vector3::zeros(), arclength_mm: LOADED_AT * length_mm };
    let mut held = None;
    for leg in 1..=PULLS {
        let point = from + Vector3::from(PULLED) * (length_mm * f64::from(leg) / f64::from(PULLS));
        let found =
            rod.solve(&point, &guess, Tangential::Frictionless).map_err(|e| refuse(format!("{e:?}")))?;
        guess = Guess::from(&found);
        held = Some(found);
    }
    let held = held.ok_or_else(|| refuse("no equilibrium".to_owned()))?;
    engine.load(&mjcf(whisker, options)?, false)?;
    let link_mm = length_mm / options.links as f64;
    let link = ((held.arclength_mm / link_mm) as usize).min(options.links - 1);
    let along_mm = held.arclength_mm - link as f64 * link_mm;
    let frame = engine.frame(&Request::Push {
        body: format!("link{link}"),
        along_m: along_mm * 1e-3,
        force_n: held.force_n.into(),
        steps: PUSH_STEPS,
    })?;
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
    at(link) + (at(link + 1) - at(link)).normalize() * along_mm
}

/// Sweeps by both engines at one speed.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SpeedRow {
    /// Speed of the base, mm/s.
    pub speed_mm_s: f64,
    /// Sweeps that both kept, of those run.
    pub kept: [usize; 2],
    /// Samples at which both touch.
    pub samples: usize,
    /// RMS of the difference of the base moments, N mm, and the rod's own RMS.
    pub moment_rms_nmm: [f64; 2],
    /// Mean of |moment| by MuJoCo over that by the rod, less 1: the speed's bias where it grows with it.
    pub bias: f64,
    /// RMS of the moments' difference from its own mean over three samples, N mm.
    pub ripple_nmm: f64,
    /// Median distance of the contact nearest to the base, mm.
    pub contact_mm: f64,
    /// Deepest overlap of the wire's skin with the mesh, mm.
    pub overlap_mm: f64,
    /// Share of samples that chatter.
    pub chatter: f64,
    /// MuJoCo's rejected sweeps with their reasons.
    pub rejected: Vec<&'static str>,
}

/// The same sweeps at constant speed by both engines, one row a speed.
///
/// # Errors
/// Where an engine cannot be started.
pub fn against_speed(
    whisker: &WhiskerSpec,
    options: &MjcfOptions,
    objects: &[(Mesh, Convex)],
    plan: &SweepPlan,
    speeds_mm_s: &[f64],
    sweeps: u64,
) -> Result<Vec<SpeedRow>, TwinError> {
    let rod = RodEngine::new(whisker, LINKS)?;
    let mut cable = CableEngine::start(whisker, options)?;
    let mut rows = Vec::new();
    for &speed in speeds_mm_s {
        let plan = SweepPlan { speed_mm_s: [speed; 2], acceleration_mm_s2: 0.0, ..plan.clone() };
        let mut sum = Sum::default();
        for (mesh, convex) in objects {
            let parts = convex.corners();
            for index in 0..sweeps {
                let Some(sweep) = Sweep::draw(mesh, &plan, 1, index, rod.reach_mm()) else { continue };
                let (quasi, dynamic) =
                    (rod.run(mesh, &sweep, &plan), cable.run(mesh, &parts, &sweep, &plan)?);
                sum.add(&quasi, &dynamic);
            }
        }
        rows.push(sum.row(speed));
    }
    Ok(rows)
}

#[derive(Default)]
struct Sum {
    run: usize,
    kept: usize,
    all: usize,
    chattering: usize,
    squares: f64,
    rod_squares: f64,
    sizes: [f64; 2],
    ripples: Vec<f64>,
    contacts_mm: Vec<f64>,
    overlap_mm: f64,
    rejected: Vec<&'static str>,
    samples: usize,
}

impl Sum {
    fn add(&mut self, quasi: &crate::rod_engine::Run, dynamic: &crate::rod_engine::Run) {
        self.run += 1;
        self.all += dynamic.samples.len();
        self.chattering += dynamic.samples.iter().filter(|s| !s.settled).count();
        let overlaps = dynamic.samples.iter().flat_map(|s| &s.contacts).map(|c| -c.gap_mm);
        self.overlap_mm = overlaps.fold(self.overlap_mm, f64::max);
        if let Verdict::Rejected(why) = dynamic.verdict {
            self.rejected.push(why);
        }
        if quasi.verdict != Verdict::Kept || dynamic.verdict != Verdict::Kept {
            return;
        }
        self.kept += 1;
        let mut differences = Vec::new();
        for (a, b) in quasi.samples.iter().zip(&dynamic.samples) {
            let (Some(here), Some(there)) = (a.contacts.first(), b.contacts.first()) else { continue };
            let difference = b.moment_nmm - a.moment_nmm;
            differences.push(difference);
            self.squares += difference.norm_squared();
            self.rod_squares += a.moment_nmm.norm_squared();
            self.sizes[0] += a.moment_nmm.norm();
            self.sizes[1] += b.moment_nmm.norm();
            self.contacts_mm.push((here.point_mm - there.point_mm).norm());
            self.samples += 1;
        }
        self.ripples
            .extend(differences.windows(3).map(|w| (w[1] - (w[0] + w[1] + w[2]) / 3.0).norm_squared()));
    }

    fn row(mut self, speed_mm_s: f64) -> SpeedRow {
        self.contacts_mm.sort_by(f64::total_cmp);
        let mean = |sum: f64, n: usize| (sum / n.max(1) as f64).sqrt();
        SpeedRow {
            speed_mm_s,
            kept: [self.kept, self.run],
            samples: self.samples,
            moment_rms_nmm: [mean(self.squares, self.samples), mean(self.rod_squares, self.samples)],
            bias: self.sizes[1] / self.sizes[0] - 1.0,
            ripple_nmm: mean(self.ripples.iter().sum(), self.ripples.len()),
            contact_mm: self.contacts_mm.get(self.contacts_mm.len() / 2).copied().unwrap_or(f64::NAN),
            overlap_mm: self.overlap_mm,
            chatter: self.chattering as f64 / self.all.max(1) as f64,
            rejected: self.rejected,
        }
    }
}
