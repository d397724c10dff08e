//! What the live page shows of a sweep.

use crate::live_page::{LivePage, LiveState};
use crate::simulated::is_simulated;
use anyhow::Result;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};
use wcal_acquisition::plan::Step;
use wcal_acquisition::record::{RecordResult, plan_only};
use wcal_acquisition::sweep::{Ending, Progress, SweepReport};
use wcal_core::FbgSpec;

/// Between two states of one step.
const PERIOD: Duration = Duration::from_millis(100);

/// The page of a sweep.
pub(super) struct LiveSweep {
    page: LivePage,
    folder: PathBuf,
    /// Steps of the plan that are settled readings.
    readings: Vec<usize>,
    steps: usize,
    fbg: FbgSpec,
    /// Wavelength of the reference from which temperature counts, nm.
    reference_nm: Option<f64>,
    simulated: Option<bool>,
    /// When the newest state was shown, and its step.
    shown: Option<(Instant, usize)>,
}

impl LiveSweep {
    /// Serves the page of a plan on a rig.
    ///
    /// # Errors
    /// When the port is taken, or rig and plan do not fit.
    pub(super) fn open(port: u16, rig: &str, plan: &str, folder: &Path) -> Result<Self> {
        let (rig, _, steps) = plan_only(("rig", rig), ("plan", plan))?;
        let planned = steps.iter().enumerate().filter_map(|(k, step)| match step {
            Step::Settled(pose) => Some((k, pose.trajectory, pose.stage_mm, pose.role)),
            _ => None,
        });
        let planned: Vec<_> = planned.collect();
        let columns = "t_s stage_mm fbg_ref_nm fbg_1_nm fbg_2_nm temperature_degc";
        let state = LiveState::new("stage-sweep", folder, columns);
        Ok(Self {
            page: LivePage::open(port, &planned, state)?,
            folder: folder.to_owned(),
            steps: steps.len(),
            readings: planned.iter().map(|p| p.0).collect(),
            reference_nm: rig.grating("fbg_ref").map(|g| g.nominal_nm),
            fbg: rig.fbg.try_into().unwrap_or_default(),
            simulated: None,
            shown: None,
        })
    }

    /// Shows where the sweep is, and how long it may still take, s.
    pub(super) fn show(&mut self, p: &Progress, left_s: Option<f64>) {
        let recent = |(at, step): (Instant, usize)| step == p.step && at.elapsed() < PERIOD;
        if self.shown.is_some_and(recent) {
            return;
        }
        self.shown = Some((Instant::now(), p.step));
        // run.json is written once the devices have answered.
        let run_file = self.folder.join("run.json");
        let simulated = *self
            .simulated
            .get_or_insert_with(|| is_simulated(&run_file));
        let [reference, one, two] = p.wavelengths_nm;
        let over = |(nm, zero): (f64, f64)| self.fbg.rise_degc((nm - zero) * 1e3);
        let degc = reference.zip(self.reference_nm).and_then(over);
        let row = [p.device_s, Some(p.stage_mm), reference, one, two, degc];
        let report = SweepReport {
            ending: Ending::Finished,
            done: p.step,
            unsettled: p.unsettled,
            counts: p.counts,
        };
        self.page.snapshot.show(|state| {
            at(state, &self.readings, p.step, &report);
            (state.simulated, state.left_s) = (Some(simulated), left_s);
            state.warnings = report.warnings();
            state.measured(row.to_vec());
        });
    }

    /// The last state, which stays in the session.
    pub(super) fn end(self, recorded: &RecordResult) {
        let (ending, cause, step) = match &recorded.sweep.ending {
            Ending::Finished => ("finished", None, self.steps),
            Ending::Stopped { cause, .. } => {
                let step = self.shown.map_or(0, |(_, step)| step);
                ("stopped", Some(cause.to_string()), step)
            }
        };
        self.page.end(&self.folder.join("live.html"), |state| {
            (state.ending, state.cause) = (ending, cause);
            at(state, &self.readings, step, &recorded.sweep);
            (state.simulated, state.warnings) = (Some(recorded.simulated), recorded.warnings());
        });
    }
}

fn at(state: &mut LiveState, readings: &[usize], step: usize, report: &SweepReport) {
    state.step = Some(step);
    state.readings = readings.partition_point(|reading| *reading < step);
    let counts = &report.counts;
    (state.scans, state.lost_scans, state.gaps) = (counts.scans, counts.lost, Some(counts.gaps));
}
