//! The objects that are set aside for tests: network and Bayes filter side by side on sweeps drawn
//! on the spot. All of it is SIMULATED.
//!
//! No setting may be chosen by looking at this table (fixtures/test_objects/README.md).

use crate::LabError;
use crate::evaluate::{Method, score_objects};
use crate::evaluation::document::{ObjectRow, TestObjects, TestRow, coverage90, intervals, mean};
use crate::evaluation::request::Order;
use crate::generate_sweeps::{SweepRequest, generate_sweeps};
use crate::sweep_series::SweepSeries;
use std::collections::BTreeMap;
use wcal_core::WhiskerSpec;
use wcal_lab_sweeps::objects::{TEST_NAMES, built_in};
use wcal_lab_sweeps::{SweepPlan, Turn};
use wcal_mesh::Mesh;
use wcal_network::Tracker;
use wcal_network::filter::BayesSettings;

/// Seeds of these sweeps are no training's.
const SEED: u64 = 0x7465_7374_6f62_6a73;
/// Readings a second, and steps of the base in which jumps are distinguished from slides, mm, as in
/// the paper's table.
const RATE_HZ: f64 = 10.0;
const STEP_MM: f64 = 0.1;
/// Faces of an upright object, in turn.
const FACES: usize = 4;

/// Upright on four faces without jumps, as in the paper's table I, and at random turns.
fn draws(sweeps: usize) -> [(&'static str, SweepPlan, usize); 2] {
    let plan = SweepPlan {
        rate_hz: RATE_HZ,
        ..SweepPlan::default()
    };
    let upright = SweepPlan {
        turn: Turn::Faces,
        keep_jumps: false,
        step_mm: STEP_MM,
        ..plan.clone()
    };
    [
        ("upright", upright, sweeps.next_multiple_of(FACES)),
        ("random", plan, sweeps),
    ]
}

/// The table for evaluation.json.
///
/// # Errors
/// Where whisker or network cannot be used.
pub(crate) fn table(
    (tracker, whisker): (&Tracker, &WhiskerSpec),
    order: &Order<'_>,
    progress: &dyn Fn(&str),
) -> Result<TestObjects, LabError> {
    let meshes: BTreeMap<String, Mesh> = TEST_NAMES
        .iter()
        .map(|name| Ok(((*name).to_owned(), built_in(name)?)))
        .collect::<Result<_, wcal_mesh::MeshError>>()?;
    let multi_mu = BayesSettings::multi_mu();
    let methods = [
        ("network", true, Method::Network(tracker, true)),
        ("network", false, Method::Network(tracker, false)),
        (
            "bayes",
            true,
            Method::Bayes(&tracker.inverse, true, &multi_mu),
        ),
    ];
    let mut rows = Vec::new();
    for (turns, plan, sweeps) in &draws(order.sweeps_each) {
        progress(&format!("test objects, {turns}"));
        let request = SweepRequest {
            whisker,
            plan,
            seed: order.seed ^ SEED,
            sweeps: *sweeps,
        };
        let mut all = BTreeMap::new();
        for (name, mesh) in &meshes {
            let series = generate_sweeps(mesh, &request)?;
            if !series.is_empty() {
                all.insert(name.clone(), series);
            }
        }
        for (name, known, method) in &methods {
            let scores = score_objects(&|c: &SweepSeries| method.run(c), &all, &meshes)?;
            rows.push(TestRow {
                turns,
                method: name,
                speed_known: *known,
                rmse_mm: mean(&scores, |o| o.all.rmse_mm),
                true_contact_rmse_mm: mean(&scores, |o| o.all.true_contact_rmse_mm),
                coverage90: coverage90(&scores),
                interval95: intervals(&scores),
                objects: scores.iter().map(|o| ObjectRow::of(o, "test")).collect(),
            });
        }
    }
    Ok(TestObjects {
        set_aside: "2026-11-25",
        names: TEST_NAMES.to_vec(),
        rows,
    })
}
