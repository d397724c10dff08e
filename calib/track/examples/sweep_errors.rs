//! Where the squares of the error come from, on SIMULATED sweeps: `course_errors SWEEPS MESHES FIRST SWEEPS_EACH [MODEL|-] [OBJECT...]`.
//!
//! Prints each method's RMSE over all instants, the series with the most squares, and the share of the squares by cause.
//! `WCAL_COURSE=OBJECT/SWEEP` prints that series instant by instant, `WCAL_METHOD="bayes, speed known"` runs that method alone,
//! `WCAL_SETTINGS` (JSON) are other settings of the filter whose belief is looked at.
#![allow(missing_docs, clippy::print_stdout, reason = "an example")]

use nalgebra::Vector3;
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use wcal_sim::{Mesh, objects};
use wcal_track::evaluate::Method;
use wcal_track::filter::{BayesFilter, BayesSettings};
use wcal_track::{InverseGrid, InverseSolution, StaticInverse, SweepSeries, sweep_series};

/// Belief this near to the truth counts as there, mm, and the least of it.
const NEAR_MM: f64 = 1.0;
const HELD: f64 = 0.1;
/// Truths further from the curve of solutions than this are not on it, mm.
const OFF_CURVE_MM: f64 = 0.3;

/// One instant with contact.
struct Row {
    off_mm: f64,
    surface_mm: f64,
    curve_mm: f64,
    near: f64,
    evidence: f64,
    line: String,
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let args: Vec<String> = std::env::args().collect();
    let [_, sweeps, meshes, first, each, model, names @ ..] = &args[..] else {
        return Err("course_errors SWEEPS MESHES FIRST SWEEPS_EACH MODEL|- OBJECT...".into());
    };
    let (first, each): (u64, u64) = (first.parse()?, each.parse()?);
    let mut all_series = sweep_series::read_sweep_series(&PathBuf::from(sweeps), names)?;
    for of in all_series.values_mut() {
        of.retain(|c| c.sweep >= first && c.sweep < first + each);
    }
    let whisker = wcal_core::observation::WhiskerSpec::nominal();
    let inverse = StaticInverse::new(&whisker, InverseGrid::default())?;
    let tracker = match model.as_str() {
        "-" => None,
        folder => Some(wcal_track::model_file::load(&PathBuf::from(folder), &wcal_track::Device::flex())?.0),
    };
    let settings = match std::env::var("WCAL_SETTINGS") {
        Ok(json) => serde_json::from_str(&json)?,
        Err(_) => BayesSettings::default(),
    };
    let shown = std::env::var("WCAL_COURSE").unwrap_or_default();
    let mut methods = vec![
        ("bayes, speed known", Method::Bayes(&inverse, true, &settings)),
        ("bayes", Method::Bayes(&inverse, false, &settings)),
    ];
    if let Some(t) = &tracker {
        methods.push(("network, speed known", Method::Network(t, true)));
        methods.push(("network", Method::Network(t, false)));
    }
    let only = std::env::var("WCAL_METHOD").ok();
    for (name, method) in methods.iter().filter(|m| only.as_ref().is_none_or(|only| only == m.0)) {
        let known = name.ends_with("known");
        let (mut causes, mut worst) =
            (BTreeMap::<String, (usize, f64, BTreeMap<String, f64>)>::new(), Vec::new());
        let (mut n, mut squares, mut off_squares, mut object_rmse) = (0, 0.0, 0.0, Vec::new());
        let mut believed = 0.0;
        for (object, of) in &all_series {
            let mesh = objects::named(object, Some(Path::new(meshes)))?;
            let all: Vec<_> =
                of.par_iter().map(|c| (c, rows(c, &mesh, &inverse, method, known, settings))).collect();
            let (mut object_squares, mut object_n) = (0.0, 0);
            for (c, rows) in all {
                if shown == "all" || shown == format!("{object}/{}", c.sweep) {
                    rows.iter().for_each(|r| println!("{}", r.line));
                }
                let mut own = 0.0;
                for (k, row) in rows.iter().enumerate() {
                    let Some(cause) = cause(c, &rows, k) else { continue };
                    let square = row.surface_mm.powi(2);
                    own += square;
                    off_squares += row.off_mm.powi(2);
                    n += 1;
                    believed += (row.near + 1e-3).ln();
                    object_n += 1;
                    let (count, sum, by_course) = causes.entry(cause).or_default();
                    (*count, *sum) = (*count + 1, *sum + square);
                    *by_course.entry(format!("{object}/{}", c.sweep)).or_default() += square;
                }
                object_squares += own;
                worst.push((own, format!("{object}/{}", c.sweep)));
            }
            squares += object_squares;
            object_rmse.push((object_squares / f64::max(object_n as f64, 1.0)).sqrt());
        }
        println!(
            "{name}: {n} instants, surface RMSE {:.3} mm (mean over objects {:.3}), contact RMSE {:.3} mm, log belief {:.3}",
            (squares / n as f64).sqrt(),
            object_rmse.iter().sum::<f64>() / object_rmse.len() as f64,
            (off_squares / n as f64).sqrt(),
            believed / n as f64
        );
        worst.sort_by(|a, b| b.0.total_cmp(&a.0));
        let most: Vec<String> =
            worst.iter().take(12).map(|(s, c)| format!("{c} {:.1} %", 100.0 * s / squares)).collect();
        println!("  most squares: {}", most.join(", "));
        let mut causes: Vec<_> = causes.into_iter().collect();
        causes.sort_by(|a, b| b.1.1.total_cmp(&a.1.1));
        for (cause, (count, s, by_course)) in causes {
            let mut most: Vec<_> = by_course.into_iter().collect();
            most.sort_by(|a, b| b.1.total_cmp(&a.1));
            let most: Vec<String> =
                most.iter().take(4).map(|(c, own)| format!("{c} {:.0} %", 100.0 * own / s)).collect();
            println!(
                "  {:5.1} % of squares, {:5.1} % of instants: {cause} ({})",
                100.0 * s / squares,
                100.0 * count as f64 / n as f64,
                most.join(", ")
            );
        }
    }
    Ok(())
}

fn rows(
    series: &SweepSeries,
    mesh: &Mesh,
    inverse: &StaticInverse,
    method: &Method<'_>,
    known: bool,
    settings: BayesSettings,
) -> Vec<Row> {
    let estimates = method.run(series);
    let mut filter = BayesFilter::new(inverse, settings);
    // The same filter, told before each step where the contact was.
    let mut told = filter.clone();
    let mut last_s = 0.0;
    let one = |(i, e): (&wcal_track::SweepSample, &wcal_track::evaluate::Estimate)| {
        let dt = i.t_s - std::mem::replace(&mut last_s, i.t_s);
        let belief = filter.step(dt, i.moment_nmm, known.then_some(i.speed_mm_s));
        told.step(dt, i.moment_nmm, known.then_some(i.speed_mm_s));
        let told_evidence = told.log_evidence();
        let posterior = filter.posterior();
        let solutions = filter.solutions();
        let Some(truth) = i.contact else {
            let line = format!(
                "{:6.2} {:8.3} {:9.5} {:9.5} {:8} free",
                i.t_s, i.travel_mm, i.moment_nmm[0], i.moment_nmm[1], i.event
            );
            return Row { off_mm: 0.0, surface_mm: 0.0, curve_mm: 0.0, near: 1.0, evidence: 0.0, line };
        };
        let (curve_mm, node) = nearest(solutions, &truth.point_mm);
        let told_near = self::near(solutions, &told.posterior(), &truth.point_mm);
        told.condition_on(node);
        let near = near(solutions, &posterior, &truth.point_mm);
        let surface_mm = series.surface_distance_mm(mesh, i.travel_mm, &e.point_mm);
        let off_mm = (e.point_mm - truth.point_mm).norm();
        let line = format!(
            "{:6.2} {:8.3} {:9.5} {:9.5} {:8} n {} s {:5.1} true {:6.2} {:6.2} {:6.2} curve {curve_mm:6.3} (s {:5.1} lean {:.2}) near {near:5.3} at s {:5.1} off {off_mm:6.2} surface {surface_mm:6.2} ev {:7.2} told {told_evidence:7.2} {told_near:.2}{}",
            i.t_s,
            i.travel_mm,
            i.moment_nmm[0],
            i.moment_nmm[1],
            i.event,
            i.contacts,
            truth.arclength_mm,
            truth.point_mm.x,
            truth.point_mm.y,
            truth.point_mm.z + i.travel_mm,
            inverse.nodes[node].arclength_mm,
            inverse.nodes[node].tilt,
            belief.map_or(0.0, |b| b.arclength_mm),
            filter.log_evidence(),
            if i.settled { "" } else { " unsettled" }
        );
        Row { off_mm, surface_mm, curve_mm, near, evidence: filter.log_evidence(), line }
    };
    series.samples.iter().zip(&estimates).map(one).collect()
}

/// Distance of a point to the curve of solutions, mm, and the node there.
fn nearest(solutions: &[InverseSolution], point: &Vector3<f64>) -> (f64, usize) {
    let mut best = (f64::INFINITY, 0);
    for k in 0..solutions.len() - 1 {
        let (along, to) = (solutions[k + 1].point_mm - solutions[k].point_mm, point - solutions[k].point_mm);
        let u = (along.dot(&to) / along.norm_squared().max(1e-12)).clamp(0.0, 1.0);
        let off = (to - along * u).norm();
        if off < best.0 {
            best = (off, if u > 0.5 { k + 1 } else { k });
        }
    }
    best
}

fn near(solutions: &[InverseSolution], posterior: &[f64], point: &Vector3<f64>) -> f64 {
    let total: f64 = posterior.iter().sum();
    let at = solutions.iter().zip(posterior).filter(|(c, _)| (c.point_mm - point).norm() < NEAR_MM);
    at.map(|(_, w)| w).sum::<f64>() / total.max(1e-300)
}

/// Why the estimate is where it is; none without contact.
fn cause(series: &SweepSeries, rows: &[Row], k: usize) -> Option<String> {
    let now = &series.samples[k];
    let contact = now.contact?;
    let tip = |s: f64| if s > 59.5 { ", at the tip" } else { "" };
    if now.contacts > 1 {
        let held = if rows[k].near > HELD { "believed" } else { "not believed" };
        return Some(format!("several contacts now, the first {held}"));
    }
    if rows[k].curve_mm > OFF_CURVE_MM {
        return Some(format!("one contact, not on the curve{}", tip(contact.arclength_mm)));
    }
    if rows[k].near > HELD {
        let since =
            (0..=k).rev().find(|j| ["onset", "jump", "slip"].contains(&series.samples[*j].event.as_str()));
        let fresh = since.is_none_or(|j| now.travel_mm - series.samples[j].travel_mm < 2.0);
        let fresh = if fresh { "within 2 mm of its beginning" } else { "followed" };
        return Some(format!("one contact, believed, {fresh}{}", tip(contact.arclength_mm)));
    }
    // Back to where it was lost.
    let mut at = k;
    while at > 0
        && rows[at].near <= HELD
        && series.samples[at].contact.is_some()
        && series.samples[at].event != "onset"
    {
        at -= 1;
        if rows[at].near > HELD || series.samples[at].contact.is_none() {
            at += 1;
            break;
        }
    }
    let there = &series.samples[at];
    let from = at.saturating_sub(2);
    let several = series.samples[from..=at].iter().any(|i| i.contacts > 1);
    let off_curve = rows[from..=at].iter().any(|r| r.curve_mm > OFF_CURVE_MM);
    let what = if there.event != "none" {
        format!("at {}", there.event)
    } else if several {
        "with several contacts".into()
    } else if off_curve {
        "off the curve".into()
    } else {
        "with one contact".into()
    };
    let collapsed = if rows[at].evidence < -10.0 { ", evidence low" } else { "" };
    Some(format!("one contact, lost {what}{collapsed}{}", tip(there.contact.map_or(0.0, |c| c.arclength_mm))))
}
