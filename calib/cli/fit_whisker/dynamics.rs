//! Damping and contact of the MuJoCo model, by trials in MuJoCo itself.

use crate::output::OutputFolder;
use crate::progress::Progress;
use anyhow::{Context, Result, ensure};
use clap::Args;
use serde::Serialize;
use std::cell::Cell;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use wcal_core::observation::WhiskerSpec;
use wcal_mujoco::dynamics::{
    DynamicsFit, Parameters, Score, Sensitivity, Targets, Trial, fit_dynamics, ring_down_s,
};
use wcal_mujoco::mjcf::MjcfOptions;
use wcal_session::{TextTableLayout, read_text_table};

/// Arguments of the fit of damping and contact.
#[derive(Debug, Args)]
pub struct DynamicsArgs {
    /// Fit damping and contact of the MuJoCo model too (minutes; needs wcal-mujoco)
    #[arg(long)]
    pub dynamics: bool,
    /// Recorded ring-down of the released wire: a table with columns t_s and moment_nmm, from the
    /// release on
    #[arg(long, value_name = "CSV", requires = "dynamics")]
    pub ring_down: Option<PathBuf>,
    /// Wanted speed of the bounce over the undamped wire's
    #[arg(long, default_value_t = 0.5, requires = "dynamics")]
    pub bounce_ratio: f64,
    /// Recorded ripple of a sweep's moment, N mm; 0: as little as can be
    #[arg(
        long,
        value_name = "N_MM",
        default_value_t = 0.0,
        requires = "dynamics"
    )]
    pub ripple_nmm: f64,
    /// Recorded change of the mean moment from 3.2 to 7.7 mm/s, as a share; 0: as little as can be
    #[arg(
        long,
        value_name = "SHARE",
        default_value_t = 0.0,
        requires = "dynamics",
        allow_negative_numbers = true
    )]
    pub speed_bias: f64,
    /// Evaluations of each of NLopt's searches (BOBYQA, then CRS2)
    #[arg(
        long,
        default_value_t = 60,
        requires = "dynamics",
        value_parser = clap::value_parser!(u32).range(1..)
    )]
    pub evaluations: u32,
}

/// About how many trials of the grid come before the two searches, for the time left.
const GRID_TRIALS: u32 = 50;

/// `[dynamics]` of whisker.toml.
#[derive(Debug, Serialize)]
pub(crate) struct Dynamics {
    simulated: bool,
    /// Material time (damping over stiffness), s, and armature over stiffness, s^2: they hold for
    /// any number of links.
    damping_s: f64,
    armature_s2: f64,
    contact_time_s: f64,
    /// The contact as the model has it: overlap of full impedance, mm, and impedances.
    width_mm: f64,
    impedance: [f64; 2],
    chosen: Parameters,
    score: Score,
    sensitivity: Sensitivity,
    targets: Targets,
    trials: usize,
    why: Vec<String>,
}

/// Fits, adds dynamics.csv, and gives the model's options.
pub(crate) fn dynamics(
    args: &DynamicsArgs,
    whisker: &WhiskerSpec,
    out: &mut OutputFolder<'_>,
) -> Result<(Dynamics, MjcfOptions)> {
    ensure!(
        args.bounce_ratio > 0.0 && args.bounce_ratio <= 1.0,
        "--bounce-ratio: expected above 0 and at most 1, found {}",
        args.bounce_ratio
    );
    ensure!(
        args.ripple_nmm >= 0.0 && args.ripple_nmm.is_finite(),
        "--ripple-nmm: expected 0 or more, found {}",
        args.ripple_nmm
    );
    ensure!(
        args.speed_bias.abs() < 1.0,
        "--speed-bias: expected a share between -1 and 1 (0.05 is 5 %), found {}",
        args.speed_bias
    );
    let recorded = args.ring_down.as_deref().map(read_ring_down).transpose()?;
    let targets = Targets {
        ring_down_s: recorded,
        bounce_ratio: Some(args.bounce_ratio),
        ripple_nmm: args.ripple_nmm,
        bias: args.speed_bias,
    };
    let (progress, trials) = (Progress::new("fit-whisker"), Cell::new(0_u32));
    let all = f64::from(GRID_TRIALS + 2 * args.evaluations);
    let fit = fit_dynamics(whisker, targets, args.evaluations, |trial| {
        trials.set(trials.get() + 1);
        let stage = format!(
            "trial {} ({}): {:.3}",
            trials.get(),
            trial.stage,
            trial.score.total
        );
        // The number of trials is an estimate: 100 % would promise the end.
        progress.at(&stage, (f64::from(trials.get()) / all).min(0.99));
    })?;
    drop(progress);
    let best = &fit.trials[fit.best];
    let why = reasons(&fit, &targets);
    out.put("dynamics.csv", table(&fit.trials)?);
    // Found by trials in MuJoCo: whatever was recorded, these numbers are simulated.
    let dynamics = Dynamics {
        simulated: true,
        damping_s: fit.options.damping_s,
        armature_s2: fit.options.armature_s2,
        contact_time_s: fit.options.touch.time_s,
        width_mm: fit.options.touch.width_mm,
        impedance: fit.options.touch.impedance,
        chosen: best.parameters,
        score: best.score,
        sensitivity: fit.sensitivity,
        targets,
        trials: fit.trials.len(),
        why,
    };
    Ok((dynamics, fit.options))
}

/// Time constant of a recorded ring-down, s.
fn read_ring_down(path: &Path) -> Result<f64> {
    let table = read_text_table(path, &TextTableLayout::default())?;
    let values = |name: &str| -> Result<Vec<f64>> {
        let column = table.column(name)?;
        let cells = (0..table.rows.len()).map(|row| table.number(row, column));
        let cells: Option<Vec<f64>> = cells.collect::<Result<_, _>>()?;
        cells.with_context(|| {
            format!(
                "{}, {name}: expected a number in every row, found none",
                table.file
            )
        })
    };
    let (time_s, moment) = (values("t_s")?, values("moment_nmm")?);
    ensure!(
        time_s.windows(2).all(|w| w[1] > w[0]),
        "{}: expected times that rise, found some that do not",
        table.file
    );
    ring_down_s(&time_s, &moment).filter(|tau| *tau > 0.0).with_context(|| {
        format!(
            "{}: expected a moment that falls below 1/e of its start over ten rows or more, found none",
            table.file
        )
    })
}

/// Why the chosen one, in sentences.
fn reasons(fit: &DynamicsFit, targets: &Targets) -> Vec<String> {
    let (best, s4) = (&fit.trials[fit.best], &fit.sensitivity);
    let (p, s) = (&best.parameters, &best.score);
    let percent = s.bias.map_or(f64::NAN, |b| 100.0 * b);
    let [damping, width, d0, dmax] = s4.together_steps;
    let loose = s4.undetermined();
    let known = if loose.is_empty() {
        "all four are determined to a step".to_owned()
    } else {
        format!("the data do not determine {} to a step", loose.join(", "))
    };
    let ring_down = match targets.ring_down_s {
        Some(wanted) => format!("Ring-down {:.4} s, recorded {wanted:.4} s.", s.ring_down_s),
        None => format!(
            "No ring-down was recorded: it is not judged (here {:.4} s).",
            s.ring_down_s
        ),
    };
    vec![
        format!(
            "Least sum of squares ({:.3}) of {} trials, found by {}: damping {:.4} N m s/rad, width {:.2} mm, impedance {:.3} to {:.3}.",
            s.total,
            fit.trials.len(),
            best.stage,
            p.damping_nms_rad,
            p.width_mm,
            p.d0,
            p.dmax
        ),
        format!(
            "More damping slows the bounce and smooths the ripple but makes the moment depend on the speed: here the bounce is {:.2} of the undamped wire's (wanted {:.2}), the mean moment changes by {percent:.2} % from 3.2 to 7.7 mm/s.",
            s.bounce_ratio,
            targets.bounce_ratio.unwrap_or(f64::NAN)
        ),
        format!(
            "A softer contact bounces less but lets the wire in: overlap {:.3} mm, ripple {:.4} N mm.",
            s.overlap_mm.unwrap_or(f64::NAN),
            s.ripple_nmm.unwrap_or(f64::NAN)
        ),
        format!(
            "A step of the grid changes the demands by {:.2} (damping, 0.005 N m s/rad), {:.2} (width, 1 mm), {:.2} (d0, 0.05) and {:.2} (dmax, 0.05) of what counts, each alone.",
            s4.damping, s4.width, s4.d0, s4.dmax
        ),
        format!(
            "With the others free they are known to {damping:.2}, {width:.2}, {d0:.2} and {dmax:.2} steps: {known}."
        ),
        ring_down,
    ]
}

fn table(trials: &[Trial]) -> Result<String> {
    let mut text = String::from(
        "stage,damping_nms_rad,width_mm,d0,dmax,ring_down_s,bounce_ratio,ripple_nmm,bias,overlap_mm,total\n",
    );
    let maybe = |v: Option<f64>| v.map_or_else(String::new, |v| v.to_string());
    for Trial {
        stage,
        parameters: p,
        score: s,
    } in trials
    {
        writeln!(
            text,
            "{stage},{},{},{},{},{},{},{},{},{},{}",
            p.damping_nms_rad,
            p.width_mm,
            p.d0,
            p.dmax,
            s.ring_down_s,
            s.bounce_ratio,
            maybe(s.ripple_nmm),
            maybe(s.bias),
            maybe(s.overlap_mm),
            s.total
        )?;
    }
    Ok(text)
}
