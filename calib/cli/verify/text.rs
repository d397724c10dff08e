//! `predictions.csv`, and what a person reads in the terminal.

use crate::simulated::word;
use std::fmt::Write as _;
use std::path::Path;
use wcal_core::data_sheet::DataSheet;
use wcal_core::text::{brief, chance, readable, with_interval, with_unit};
use wcal_core::verify_document::{ContactComparison, HoldoutOutcome, WitnessTest};
use wcal_core::{ResidualRecord, TransducerModel};
use wcal_report::ReportInput;
use wcal_verify::verify::Assessment;
use wcal_verify::whisker::WhiskerVerification;

/// Every reading with what both models say of it, in the order of the tables.
pub(super) fn predictions_csv(done: &WhiskerVerification) -> anyhow::Result<String> {
    let mut csv = String::from(
        "source,point,role,moment_1_nmm_before,moment_2_nmm_before,moment_1_nmm_after,moment_2_nmm_after,\
         moment_1_sd_nmm,moment_2_sd_nmm,fbg_1_pm_before,fbg_2_pm_before,fbg_1_pm_after,fbg_2_pm_after\n",
    );
    let Assessment {
        whole,
        before,
        after,
        ..
    } = &done.assessment;
    // The model's rows follow the path of the stage; people look for theirs by the table.
    let mut order: Vec<usize> = (0..whole.path.rows.len()).collect();
    order.sort_by_key(|&i| whole.path.rows[i]);
    for i in order {
        let (row, [before, after]) = (whole.row(i), [before, after].map(|p| &p[i]));
        let role = serde_json::to_value(row.role)?;
        write!(
            csv,
            "{},{},{}",
            row.source,
            row.point,
            role.as_str().unwrap_or_default()
        )?;
        for pair in [before.moment_nmm, after.moment_nmm, after.moment_sd_nmm] {
            write!(csv, ",{:.7},{:.7}", pair[0], pair[1])?;
        }
        // What temperature adds to the compensated shift as read.
        let compensated = row.compensated_pm(&whole.data.fbg);
        let thermal_pm = [0, 1].map(|c| row.shift_pm[c] - compensated[c]);
        for p in [before, after] {
            write!(
                csv,
                ",{:.5},{:.5}",
                p.shift_pm[0] + thermal_pm[0],
                p.shift_pm[1] + thermal_pm[1]
            )?;
        }
        csv.push('\n');
    }
    Ok(csv)
}

/// Every reading with what both models say of it, in the session's units; a residual is measured
/// less predicted.
pub(super) fn scalar_csv(model: TransducerModel, records: &[ResidualRecord]) -> String {
    let axis = model == TransducerModel::Axis;
    // Of an axis the model's response is the error, measured less commanded.
    let (name, columns, residual) = if axis {
        ("error_um", "commanded_mm,measured_mm", "residual_um")
    } else {
        ("response", "stimulus", "residual")
    };
    let mut csv = format!(
        "source,point,role,{name}_measured,{name}_before,{name}_after,{name}_sd,rejected,{columns},{residual}_before,{residual}_after\n"
    );
    let place = if axis { "commanded_mm" } else { "stimulus" };
    let stimulus = |r: &ResidualRecord| {
        r.covariates
            .iter()
            .find(|(name, _)| name == place)
            .map_or(f64::NAN, |(_, value)| *value)
    };
    for r in records {
        let why = r.rejected.as_deref().unwrap_or_default();
        let values = [
            r.measured,
            r.predicted_before,
            r.predicted_after,
            r.noise_sd,
        ]
        .map(|v| v.to_string());
        let x = stimulus(r);
        // The error is in um, the positions are in mm.
        let place = if axis {
            format!("{x},{}", x + 1e-3 * r.measured)
        } else {
            x.to_string()
        };
        let [before, after] = [r.predicted_before, r.predicted_after].map(|p| r.measured - p);
        csv += &format!(
            "{},{},{},{},{why},{place},{before},{after}\n",
            r.source,
            r.point,
            r.role,
            values.join(",")
        );
    }
    csv
}

/// Parameters of an effect that are printed; a table of errors has as many as places.
const FEW: usize = 6;

/// Width of what stands before the errors.
const WIDTH: usize = 56;

/// The result as a person reads it.
pub(crate) fn print_text(report: &ReportInput, out: &Path) {
    let v = &report.verify;
    // Of a transducer the session declares the unit; the other kinds have theirs in the names.
    let unit = report
        .residuals
        .first()
        .map_or("", |r| r.unit.as_str())
        .trim();
    let verdict = serde_json::to_value(v.verdict).unwrap_or_default();
    let contradicted = v.holdout.outcome == HoldoutOutcome::Contradicted;
    let but = if contradicted {
        ", but the sealed readings contradict it"
    } else {
        ""
    };
    println!(
        "{}{}: {}{but}",
        brief(&v.session),
        word(v.simulated),
        verdict.as_str().unwrap_or_default()
    );
    if let Some(contact) = &v.contact {
        println!(
            "  contact: {}",
            contact_line(contact, contact.after.interval95, "each left out in turn")
        );
        if let Some(sealed) = &contact.sealed {
            println!(
                "  sealed contact: {}",
                contact_line(sealed, None, "in no fit")
            );
        }
    }
    println!("  {}", v.reason);
    for caution in &v.cautions {
        println!("  caution: {caution}");
    }
    if let Some(noise) = &v.noise {
        let shared = noise.correlated.map(|c| {
            format!(
                "{} of it shared by neighbours",
                with_unit(&readable(c.sd), &noise.unit)
            )
        });
        let tails = noise.tails_dof.map(|t| {
            format!(
                "tails heavier than a Gaussian's (Student's t, {:.0} degrees of freedom)",
                t.value
            )
        });
        let said: Vec<String> = shared.into_iter().chain(tails).collect();
        if !said.is_empty() {
            println!("  noise: {}", said.join("; "));
        }
    }
    for f in &v.twin.faults {
        let points: Vec<String> = f.points.iter().map(ToString::to_string).collect();
        println!(
            "  twin fault ({}): points {}: {}",
            f.kind,
            points.join(", "),
            f.detail
        );
    }
    for e in &v.effects {
        let parameters = e.parameters.iter().map(|p| {
            let [value, low, high] = with_interval(p.value, p.interval95);
            with_unit(&format!("{} = {value} [{low}, {high}]", p.name), &p.unit)
        });
        let parameters: Vec<String> = parameters.collect();
        let more = parameters.len().saturating_sub(FEW);
        // Single readings have no parameters: they are named.
        let flagged = v
            .flagged
            .iter()
            .map(|f| format!("{} point {}", f.source, f.point));
        let said: Vec<String> = match parameters.is_empty() {
            true => flagged.collect(),
            false => parameters.into_iter().take(FEW).collect(),
        };
        let rest = match more {
            0 => String::new(),
            more => format!(", and {more} more in verify.json"),
        };
        println!(
            "  {} ({}, class {}): {}{rest}",
            e.id,
            chance(e.p_value),
            e.class.join("/"),
            said.join(", ")
        );
    }
    if let (Some(b), Some(a)) = (&v.before, &v.after) {
        let head = format!(
            "  held-out error ({}, {} readings):",
            v.split_name(&a.split),
            a.points
        );
        println!(
            "{head:<WIDTH$} {:>10} {:>10} {:>10}",
            "before", "after", "expected"
        );
        for (name, before) in &b.rmse {
            let after = a.rmse.get(name).copied().unwrap_or(f64::NAN);
            let expected = a
                .expected
                .get(name)
                .map_or_else(|| "-".to_owned(), |e| readable(*e));
            let name = if name == "response_rmse" {
                with_unit(name, unit)
            } else {
                name.clone()
            };
            println!(
                "{:<WIDTH$} {:>10} {:>10} {expected:>10}",
                format!("    {name}"),
                readable(*before),
                readable(after)
            );
        }
        if let Some(trimmed) = &v.after_trimmed {
            let error = trimmed.rmse.values().next().copied().unwrap_or(f64::NAN);
            let dropped = a.points - trimmed.points;
            let without = format!("    without {dropped} sealed reading(s) far outside the noise");
            println!("{without:<WIDTH$} {:>10} {:>10}", "", readable(error));
        }
    }
    for line in v.data_sheet.iter().flat_map(DataSheet::lines) {
        println!("  result: {line}");
    }
    if v.holdout.outcome != HoldoutOutcome::Absent {
        let p = v.holdout.p.map_or_else(String::new, |p| {
            format!(" ({}, look {})", chance(p), v.holdout.look)
        });
        println!("  {}{p}", v.holdout.why);
    }
    let n = &v.noise_floor;
    for (floor, unit) in [
        (n.wavelength_pm, "pm"),
        (n.response, unit),
        (n.error_um, "um"),
    ] {
        if let Some(floor) = floor {
            println!(
                "  noise floor {} ({})",
                with_unit(&readable(floor), unit),
                n.source
            );
        }
    }
    if let Some(floor) = n.contact_mm {
        println!(
            "  noise floor of a contact {} mm (as the shapes state)",
            readable(floor)
        );
    }
    // That the declared model is refuted says the verdict.
    let shown = |t: &&WitnessTest| t.witness == "sweep" || t.refuted && !t.effects.is_empty();
    for t in v.tests.iter().filter(shown) {
        let name = if t.effects.is_empty() {
            "declared model".to_owned()
        } else {
            t.effects.join(" with ")
        };
        let refuted = if t.refuted { " REFUTED" } else { "" };
        println!(
            "  {}: {name:<44} {}, {}{refuted}",
            t.witness,
            with_unit(&readable(t.magnitude), &t.unit),
            chance(t.p)
        );
    }
    if let Some(c) = &v.calibration {
        let verdict = if c.holds { "holds" } else { "does NOT hold" };
        println!(
            "  {} {verdict} on {} readings: {}",
            c.path, c.error.points, c.why
        );
    }
    if let Some(n) = &v.next_measurement {
        println!(
            "  next: {} (expected power {:.2})",
            n.instruction, n.expected_power
        );
    }
    println!(
        "  written to {}; page {}",
        out.display(),
        out.join("report.html").display()
    );
}

/// What it is all for, in one line: by which trajectories, and with an interval whether anything
/// distinguishes both models.
fn contact_line(c: &ContactComparison, interval95: Option<[f64; 2]>, how: &str) -> String {
    let [before, after, expected] =
        [c.before.rms_mm, c.after.rms_mm, c.bound_mm].map(|mm| format!("{mm:.2}"));
    let same = if c.is_same() { ", no difference" } else { "" };
    let interval = interval95.map_or(String::new(), |[low, high]| {
        format!(" [{low:.2}, {high:.2}]{same}")
    });
    // A smaller move would be printed as 0.00 mm.
    let moved = match c.groove_moved_mm {
        mm if mm >= 0.005 => {
            format!("; the effects put the groove {mm:.2} mm from where it is stated")
        }
        _ => String::new(),
    };
    format!(
        "{before} mm -> {after} mm{interval}, expected {expected} ({} readings of {} trajectories, {how}; {} inside their 95 % regions){moved}",
        c.readings,
        c.trajectories.len(),
        c.inside95
    )
}
