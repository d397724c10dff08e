//! Held-out errors, what the model after says of them, and the noise floor.

use crate::input::{MOMENT_NAMES, ReportInput};
use crate::markup::{Table, TableCell, escape, with_sign};
use crate::number::{join_unit, number, p_value, percent, quantity, with_interval};
use crate::plot::{Axis, Layer, Marker, Plot, svg};
use wcal_core::verify_document::{
    ContactComparison, GrooveTracking, HeldOutError, HoldoutJudgement, HoldoutOutcome, NoiseFloor,
    TrackError, TrajectoryContact, VerifyDocument, WitnessTest,
};

/// One column: an error and what it is held against.
struct Quantity {
    /// Key in `HeldOutError::rmse`, or `moment 1` and `moment 2` of the pair.
    key: String,
    /// Name as printed.
    name: String,
    /// Unit as printed.
    unit: String,
    /// Noise floor in the same unit: of a typical reading.
    floor: Option<f64>,
    /// What the model after expects of the rows that count.
    expected: Option<f64>,
    /// Index into `moment_rmse_nmm_each`.
    each: Option<usize>,
}

impl Quantity {
    /// Value and interval in one model's errors.
    fn of(&self, error: &HeldOutError) -> (Option<f64>, Option<[f64; 2]>) {
        match self.each {
            Some(k) => (error.moment_rmse_nmm_each.map(|pair| pair[k]), None),
            None => (
                error.rmse.get(&self.key).copied(),
                error.interval95.get(&self.key).copied(),
            ),
        }
    }
}

/// Errors of one model under its name.
struct Model<'a> {
    name: String,
    error: &'a HeldOutError,
}

/// Every model with an error, the declared one first.
fn models(input: &ReportInput) -> Vec<Model<'_>> {
    let model = |name: &str, error| Model {
        name: name.to_owned(),
        error,
    };
    let before = input
        .verify
        .before
        .iter()
        .map(|e| model("before: declared model", e));
    let name = format!("after: {}", input.model_after());
    let after = input.verify.after.iter().map(|e| model(&name, e));
    let further = input.further_errors.iter().map(|(name, e)| model(name, e));
    before.chain(after).chain(further).collect()
}

/// Every quantity that some model has an error for, in the order wavelength, moments, others.
fn quantities(input: &ReportInput, errors: &[&HeldOutError]) -> Vec<Quantity> {
    let floor = &input.verify.noise_floor;
    let mut keys: Vec<&String> = errors.iter().flat_map(|e| e.rmse.keys()).collect();
    keys.sort_by_key(|key| (!key.starts_with("wavelength"), key.as_str()));
    keys.dedup();
    let response_unit = input.response_unit();
    let mut out: Vec<Quantity> = keys
        .into_iter()
        .map(|key| {
            let (name, unit, floor) = describe(key, floor, response_unit);
            Quantity {
                key: key.clone(),
                name,
                unit,
                floor,
                expected: expected(&input.verify, key),
                each: None,
            }
        })
        .collect();
    // The model after states no expected error for one moment alone.
    if errors.iter().any(|e| e.moment_rmse_nmm_each.is_some()) {
        out.extend((0..2).map(|k| Quantity {
            key: String::new(),
            name: MOMENT_NAMES[k].into(),
            unit: "N\u{a0}mm".into(),
            floor: floor.moment_nmm,
            expected: None,
            each: Some(k),
        }));
    }
    out
}

/// Error that the model after states for the rows that count.
fn expected(verify: &VerifyDocument, key: &str) -> Option<f64> {
    // Nothing can be held against an expected error of zero: the ratio has no value.
    verify
        .after
        .as_ref()?
        .expected
        .get(key)
        .copied()
        .filter(|e| *e > 0.0)
}

fn describe(key: &str, floor: &NoiseFloor, response_unit: &str) -> (String, String, Option<f64>) {
    match key {
        "wavelength_rmse_pm" => ("wavelength".into(), "pm".into(), floor.wavelength_pm),
        "moment_rmse_nmm" => (
            "moments, pooled".into(),
            "N\u{a0}mm".into(),
            floor.moment_nmm,
        ),
        "contact_rmse_mm" => ("contact".into(), "mm".into(), floor.contact_mm),
        "response_rmse" => (
            "response".into(),
            crate::number::unit_text(response_unit),
            floor.response,
        ),
        "error_rmse_um" => ("position error".into(), "µm".into(), floor.error_um),
        other => (other.replace('_', " "), String::new(), None),
    }
}

/// `contact (mm)`.
fn with_unit(name: &str, unit: &str) -> String {
    match unit {
        "" => name.to_owned(),
        unit => format!("{name} ({unit})"),
    }
}

/// Value and, where there is one, its interval.
fn value_text(value: f64, interval: Option<[f64; 2]>) -> (String, Option<String>) {
    match interval {
        Some(interval) => {
            let (value, interval) = with_interval(value, interval);
            (value, Some(interval))
        }
        None => (number(value), None),
    }
}

fn ratio_text(value: f64, expected: Option<f64>) -> Option<String> {
    let ratio = value / expected?;
    let decimals = if ratio < 10.0 { 2 } else { 1 };
    ratio
        .is_finite()
        .then(|| format!("{ratio:.decimals$} × expected"))
}

/// The tracker on the groove: error, bound and coverage in a sentence.
fn groove(t: &GrooveTracking) -> String {
    let of = if t.split == "holdout" {
        "held-out readings"
    } else {
        "readings of the fit"
    };
    let doubted = if t.doubted > 0 {
        format!(
            " On {} of {} trajectories moments and motion do not belong together.",
            t.doubted, t.trajectories
        )
    } else {
        String::new()
    };
    let mut table = Table::new(
        "Map U to contact U (expanded, k = 2): known motion, the trajectories' own readings",
        &[
            "#arc length (mm)",
            "#trajectories",
            "#largest moment (N mm)",
            "#U of it by the map (N mm)",
            "#contact U by the map (mm)",
            "#contact U (mm)",
        ],
    );
    for u in &t.uncertainty {
        let values = [
            u.moment_nmm,
            u.moment_u_nmm,
            u.contact_u_by_map_mm,
            u.contact_u_mm,
        ];
        let counts = [number(u.arclength_mm), u.trajectories.to_string()];
        table.row(counts.into_iter().chain(values.map(number)));
    }
    let table = table.html();
    format!(
        "<p>Down to contact points: from its moments and the stage's way alone the tracker finds the groove to <strong>{} mm</strong> RMS \
         ({} {of}); by its covariance {} mm are expected there. Its 95 % regions hold the groove on {} of \
         {} trajectories, whose readings share one error.{doubted}</p>{table}",
        number(t.rmse_mm),
        t.points,
        number(t.bound_mm),
        t.trajectories_held,
        t.trajectories,
    )
}

/// Distance of the tracked contact from the groove on each trajectory, by both models.
fn contact_figure(simulated: bool, c: &ContactComparison) -> String {
    // A logarithmic axis has no place for an error of zero.
    let by = |of: fn(&TrajectoryContact) -> f64| {
        let places = c.trajectories.iter().map(move |t| [t.arclength_mm, of(t)]);
        places
            .filter(|[_, error]| *error > 0.0)
            .collect::<Vec<[f64; 2]>>()
    };
    let (before, after) = (by(|t| t.before_mm), by(|t| t.after_mm));
    let all = || before.iter().chain(&after);
    let points = |class, marker, at: &[[f64; 2]]| Layer::Points {
        class,
        marker,
        at: at.to_vec(),
        titles: Vec::new(),
    };
    let chart = svg(&Plot {
        title: "Contact beside the groove".into(),
        description: "Distance of the tracked contact from where the groove is, by trajectory, declared and accepted model".into(),
        width: 520.0,
        height: 240.0,
        x: Axis::covering("arc length of first touch (mm)", all().map(|p| p[0])),
        y: Axis::log_covering("distance (mm)", all().map(|p| p[1]).chain([c.bound_mm])),
        layers: vec![
            Layer::HorizontalRule { at: c.bound_mm },
            points("s2", Marker::Cross, &before),
            points("s1", Marker::Diamond, &after),
        ],
    });
    // A smaller move would be printed as 0.00 mm.
    let moved = match c.groove_moved_mm {
        mm if mm >= 0.005 => format!(
            " The accepted effects put the groove {mm:.2} mm from where it is stated (RMS), each fitted without the trajectory; diamonds are distances from there."
        ),
        _ => String::new(),
    };
    let sealed = c.sealed.as_ref().map_or_else(String::new, |s| {
        format!(
            " Sealed trajectories, through the calibration of all the others: {:.2} mm, then {:.2} mm where {:.2} mm are expected ({} readings of {}).",
            s.before.rms_mm,
            s.after.rms_mm,
            s.bound_mm,
            s.readings,
            s.trajectories.len()
        )
    });
    let caption = format!(
        "Contacts in the groove, each trajectory left out in turn and located by the calibrations of the others: cross by the declared model ({:.2} mm \
         RMS), diamond by the accepted one ({:.2} mm). Line: the expected error ({:.2} mm), by the noise of the readings and the calibration's own \
         uncertainty.{moved}{sealed}",
        c.before.rms_mm, c.after.rms_mm, c.bound_mm
    );
    super::parts::figure(simulated, "contacts", &chart, &caption)
}

/// Table and picture.
pub(super) fn body(input: &ReportInput) -> String {
    let models = models(input);
    if models.is_empty() {
        return String::new();
    }
    let errors: Vec<&HeldOutError> = models.iter().map(|m| m.error).collect();
    let quantities = quantities(input, &errors);
    let mut out = table(input, &models, &quantities);
    if let Some(coverage) = input.verify.coverage95 {
        out += &format!(
            "<p>The stated 95 % intervals hold <strong>{}</strong> of the held-out readings.</p>",
            percent(coverage)
        );
    }
    if let Some(contacts) = &input.verify.contact {
        out += &contact_figure(input.verify.simulated, contacts);
    }
    if let Some(tracked) = &input.verify.groove_tracking {
        out += &groove(tracked);
    }
    if input.verify.holdout.outcome != HoldoutOutcome::Absent {
        out += &holdout(&input.verify.holdout);
    }
    if !input.verify.tests.is_empty() {
        out += &witnesses(&input.verify.tests);
    }
    out
}

fn table(input: &ReportInput, models: &[Model<'_>], quantities: &[Quantity]) -> String {
    let head = |q: &Quantity| format!("#{}", with_unit(&q.name, &q.unit));
    let heads: Vec<String> = quantities.iter().map(head).collect();
    let mut columns = vec!["model", "split", "#points"];
    columns.extend(heads.iter().map(String::as_str));
    let mut table = Table::new(
        "Held-out error (root mean square) with 95 % intervals",
        &columns,
    );
    for Model { name, error, .. } in models {
        let mut cells = vec![
            TableCell::Text(name.clone()),
            TableCell::Text(input.verify.split_name(&error.split)),
            TableCell::Text(error.points.to_string()),
        ];
        for quantity in quantities {
            let (value, interval) = quantity.of(error);
            cells.push(value.map_or(TableCell::Text("–".into()), |value| {
                let (text, interval) = value_text(value, interval);
                let mut notes: Vec<String> = interval.into_iter().collect();
                notes.extend(ratio_text(value, quantity.expected));
                TableCell::WithNotes(text, notes)
            }));
        }
        table.row(cells);
    }
    let mut row = |name: String, of: &dyn Fn(&Quantity) -> Option<f64>| {
        let mut cells = vec![
            TableCell::Text(name),
            TableCell::Text("–".into()),
            TableCell::Text("–".into()),
        ];
        let text = |q: &Quantity| TableCell::Text(of(q).map_or("unknown".into(), number));
        cells.extend(quantities.iter().map(text));
        table.marked_row("floor", cells);
    };
    row("expected by the model after, of these rows".into(), &|q| {
        q.expected
    });
    let source = input.verify.noise_floor.source.as_str();
    let name = "noise floor of a typical reading";
    row(
        if source.is_empty() {
            name.into()
        } else {
            format!("{name} ({source})")
        },
        &|q| q.floor,
    );
    table.html()
}

/// What further measurements of the instrument say of each explanation.
fn witnesses(tests: &[WitnessTest]) -> String {
    let sizes = [
        (
            "sweep",
            "median distance of the nearest possible contact from the object",
        ),
        ("replicates", "standard deviation within a setting"),
    ];
    let of = |(name, size): &(&str, &str)| {
        let is_there = tests.iter().any(|t| t.witness == *name);
        is_there.then(|| format!("; size of {name}: {size}"))
    };
    let sizes: String = sizes.iter().filter_map(of).collect();
    let mut table = Table::new(
        &format!("Each explanation against further readings{sizes}"),
        &[
            "witness",
            "explanation",
            "#size",
            "#statistic",
            "#degrees of freedom",
            "#p",
            "verdict",
        ],
    );
    for t in tests {
        let name = if t.effects.is_empty() {
            "declared model".into()
        } else {
            t.effects.join(" with ")
        };
        table.row([
            t.witness.clone(),
            name,
            quantity(t.magnitude, &t.unit),
            format!("{:.1}", t.statistic),
            format!("{:.0}", t.dof),
            p_value(t.p),
            if t.refuted { "refuted" } else { "stands" }.into(),
        ]);
    }
    table.html()
}

/// What the sealed readings say of what was decided without them.
fn holdout(judged: &HoldoutJudgement) -> String {
    let p = judged.p.map_or_else(String::new, |p| {
        format!(" (prediction F test, p {})", with_sign(&p_value(p)))
    });
    // Every further look at the same sealed files adds a chance of a false alarm.
    let later = match judged.look {
        0 | 1 => String::new(),
        n => {
            format!(" It is look {n} at these files: its level is smaller than that of the first.")
        }
    };
    format!("<p>{}{p}{later}</p>", escape(&judged.why))
}

/// An error before and after, and what is expected of it.
struct Change {
    /// Quantity with its unit.
    name: String,
    /// Which readings.
    readings: String,
    /// Before, after and expected, with intervals.
    errors: [(String, Option<String>); 3],
    /// Before and after with the unit, and of what.
    claim: String,
}

/// What a reader wants to know first: the contact, then the wavelengths or the response.
fn changes(input: &ReportInput) -> Vec<Change> {
    let contact = input.verify.contact.iter().map(|c| {
        let mm = |e: f64| format!("{e:.2}");
        let error = |e: &TrackError| {
            let interval = e
                .interval95
                .map(|[low, high]| format!("[{low:.2}, {high:.2}]"));
            (mm(e.rms_mm), interval)
        };
        let same = if c.is_same() { "; no difference" } else { "" };
        Change {
            name: "contact (mm)".into(),
            readings: format!(
                "{} readings of {} trajectories, each left out in turn{same}",
                c.readings,
                c.trajectories.len()
            ),
            errors: [error(&c.before), error(&c.after), (mm(c.bound_mm), None)],
            claim: claim(&mm(c.before.rms_mm), &mm(c.after.rms_mm), "mm", "a contact"),
        }
    });
    contact.chain(held_out(input)).collect()
}

/// The same of the held-out readings: of their wavelengths where there are any.
fn held_out(input: &ReportInput) -> Option<Change> {
    let verify = &input.verify;
    let (before, after) = (verify.before.as_ref()?, verify.after.as_ref()?);
    let keys = before
        .rmse
        .keys()
        .filter(|key| after.rmse.contains_key(*key));
    let key = keys.max_by_key(|key| key.starts_with("wavelength"))?;
    let (name, unit, _) = describe(key, &verify.noise_floor, input.response_unit());
    let text = |e: &HeldOutError| value_text(e.rmse[key], e.interval95.get(key).copied());
    let [b, a] = [before, after].map(text);
    let expected = expected(verify, key).map_or("unknown".into(), number);
    Some(Change {
        claim: claim(&b.0, &a.0, &unit, &name),
        name: with_unit(&name, &unit),
        readings: format!(
            "{} readings, {}",
            after.points,
            verify.split_name(&after.split)
        ),
        errors: [b, a, (expected, None)],
    })
}

/// `1.37 → 0.08 mm error of a contact`, ready for HTML.
fn claim(before: &str, after: &str, unit: &str, of: &str) -> String {
    let after = join_unit(after, unit);
    format!(
        "<p class=\"claim\">{} → {} <span>error of {}</span></p>",
        escape(before),
        escape(&after),
        escape(of)
    )
}

/// What changed most of all, in large type; empty where no error was computed.
pub(crate) fn first_claim(input: &ReportInput) -> String {
    let first = changes(input).into_iter().next();
    first.map_or(String::new(), |c| c.claim)
}

/// What changed, row by row; empty where no error was computed.
pub(crate) fn summary(input: &ReportInput) -> String {
    let mut table = Table::new(
        "Errors of readings that were left out of the fit (root mean square, 95 % interval)",
        &["error of", "#before", "#after", "#expected"],
    );
    for c in changes(input) {
        let cell = |(text, interval): (String, Option<String>)| {
            TableCell::WithNotes(text, interval.into_iter().collect())
        };
        let head = TableCell::WithNotes(c.name, vec![c.readings]);
        table.row([head].into_iter().chain(c.errors.map(cell)));
    }
    table.html()
}
