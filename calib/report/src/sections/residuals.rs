//! Residuals against every covariate, before and after.

use super::parts::{absent, distinct, figure, legend, series};
use crate::input::ReportInput;
use crate::number::split_unit;
use crate::plot::{Axis, Layer, Marker, Plot, stride, svg};
use wcal_core::ResidualRecord;

/// Covariates with a place of their own in the order; others follow as they come.
const ORDER: [(&str, &str); 11] = [
    ("stage_mm", "stage position (mm)"),
    ("direction", "direction of travel"),
    ("speed_mm_s", "speed (mm/s)"),
    ("t_s", "time (s)"),
    ("dwell_s", "dwell before the reading (s)"),
    ("temperature_degc", "temperature (°C)"),
    ("moment_1_nmm", "moment 1 (N\u{a0}mm)"),
    ("moment_2_nmm", "moment 2 (N\u{a0}mm)"),
    ("order", "order of the readings"),
    ("trajectory", "trajectory"),
    ("contact_arclength_mm", "arc length of the contact (mm)"),
];

/// Points a series and chart; a larger session is thinned evenly.
const MAX_POINTS: usize = 3000;

/// Stands for `before` and `after` where nothing was added to the model.
pub(super) const UNCHANGED: &str = "before and after alike: nothing was added";

/// True where the accepted model predicts exactly what the declared one does.
pub(super) fn unchanged(input: &ReportInput) -> bool {
    input
        .residuals
        .iter()
        .all(|r| r.predicted_before == r.predicted_after)
}

/// Readable name of a covariate with its unit.
pub(super) fn label_of(column: &str) -> String {
    match ORDER.iter().find(|(name, _)| *name == column) {
        Some((_, label)) => (*label).into(),
        None => match split_unit(column) {
            (name, unit) if unit.is_empty() => name,
            (name, unit) => format!("{name} ({unit})"),
        },
    }
}

/// Unit of a covariate.
pub(super) fn unit_of(column: &str) -> String {
    split_unit(column).1
}

/// Value of a covariate in one record; trajectory and order are there even when not named.
fn value_of(record: &ResidualRecord, column: &str) -> Option<f64> {
    let named = record
        .covariates
        .iter()
        .find(|(name, _)| name == column)
        .map(|(_, v)| *v);
    match column {
        "trajectory" => named.or((record.group > 0).then_some(f64::from(record.group))),
        "order" => named.or(Some(record.line as f64)),
        _ => named,
    }
    .filter(|v| v.is_finite())
}

/// The section.
pub(super) fn body(input: &ReportInput) -> String {
    if input.residuals.is_empty() {
        return absent("No residual records were handed to this report.");
    }
    let mut out = String::from(
        "<p>Residual = measured − predicted, for every covariate that varies. Before and after share one vertical scale; the band is twice the noise floor to either side. Crosses mark rejected readings; those beyond the scale lie on its edge.</p>",
    );
    let unfit = input
        .residuals
        .iter()
        .filter(|r| !before(r).is_finite() || !after(r).is_finite())
        .count();
    if unfit > 0 {
        out += &format!("<p>{unfit} readings without a finite residual are not drawn.</p>");
    }
    for unit in distinct(input.residuals.iter().map(|r| r.unit.as_str())) {
        let records: Vec<_> = input.residuals.iter().filter(|r| r.unit == unit).collect();
        let view = View::new(input, records, &unit);
        out += &legend(&view.channels);
        let mut constant = Vec::new();
        out += "<div class=\"panels\">\n";
        for column in columns(&view.records) {
            match view.varies(&column) {
                true => out += &view.figure(input, &column),
                false => constant.push(label_of(&column)),
            }
        }
        out += "</div>\n";
        if !constant.is_empty() {
            out += &absent(&format!(
                "The same for all readings, hence not drawn: {}.",
                constant.join(", ")
            ));
        }
        if view.is_thinned() {
            out +=
                &absent("Charts of this many readings show every n-th one and all rejected ones.");
        }
    }
    out
}

/// The panel of one covariate, for the place where an unknown effect is described.
pub(super) fn driver_figure(input: &ReportInput, driver: &str) -> String {
    let carriers: Vec<_> = input
        .residuals
        .iter()
        .filter(|r| value_of(r, driver).is_some())
        .collect();
    let Some(first) = carriers.first() else {
        return String::new();
    };
    let unit = first.unit.clone();
    let records = input.residuals.iter().filter(|r| r.unit == unit).collect();
    View::new(input, records, &unit).figure(input, driver)
}

fn columns(records: &[&ResidualRecord]) -> Vec<String> {
    let named = records
        .iter()
        .flat_map(|r| r.covariates.iter().map(|(name, _)| name.as_str()));
    let mut out = distinct(ORDER.iter().map(|(name, _)| *name).chain(named));
    out.retain(|column| records.iter().any(|r| value_of(r, column).is_some()));
    out
}

fn before(record: &ResidualRecord) -> f64 {
    record.measured - record.predicted_before
}

fn after(record: &ResidualRecord) -> f64 {
    record.measured - record.predicted_after
}

/// Readings of one unit with their common vertical scales.
struct View<'a> {
    records: Vec<&'a ResidualRecord>,
    channels: Vec<String>,
    unit: String,
    /// Common scale of before and after.
    common: Axis,
    /// Own scale of what remains; none where the common one shows it well enough.
    close: Option<Axis>,
    band: Option<f64>,
}

impl<'a> View<'a> {
    /// A channel has more readings than a chart shows.
    fn is_thinned(&self) -> bool {
        let shown = |channel: &String| {
            let of = |r: &&&ResidualRecord| r.channel == *channel && r.rejected.is_none();
            self.records.iter().filter(of).count()
        };
        self.channels.iter().any(|c| shown(c) > MAX_POINTS)
    }

    fn new(input: &ReportInput, records: Vec<&'a ResidualRecord>, unit: &str) -> Self {
        let channels = distinct(records.iter().map(|r| r.channel.as_str()));
        let unit = crate::number::unit_text(unit);
        let label = if unit.is_empty() {
            "residual".into()
        } else {
            format!("residual ({unit})")
        };
        // One rejected reading may lie so far off that all others would shrink to a line.
        let kept = || records.iter().filter(|r| r.rejected.is_none());
        let floor = &input.verify.noise_floor;
        let band = match input.verify.kind.as_str() {
            "whisker" if unit == "pm" => floor.wavelength_pm,
            "transducer" => floor.response,
            "axis" if unit == "µm" => floor.error_um,
            _ => None,
        }
        .filter(|f| f.is_finite() && *f > 0.0)
        .map(|f| 2.0 * f);
        // A little beyond the band, so that both of its edges are seen.
        let edge = band.unwrap_or(0.0) * 1.3;
        let common = Axis::symmetric(
            label.clone(),
            kept().flat_map(|r| [before(r), after(r)]).chain([edge]),
        );
        let own = Axis::symmetric(label, kept().map(|r| after(r)).chain([edge]));
        // Where the remainder fills most of the common scale, its own one shows nothing more.
        let close = (own.high < 0.4 * common.high).then_some(own);
        Self {
            records,
            channels,
            unit,
            common,
            close,
            band,
        }
    }

    fn varies(&self, column: &str) -> bool {
        let mut values = self.records.iter().filter_map(|r| value_of(r, column));
        let Some(first) = values.next() else {
            return false;
        };
        values.any(|v| v != first)
    }

    fn figure(&self, input: &ReportInput, column: &str) -> String {
        let label = label_of(column);
        let charts = if unchanged(input) {
            self.chart(column, UNCHANGED, &self.common, before)
        } else {
            let mut charts = self.chart(column, "before", &self.common, before);
            charts += &self.chart(column, "after, same scale", &self.common, after);
            if let Some(close) = &self.close {
                charts += &self.chart(column, "after, enlarged", close, after);
            }
            charts
        };
        let class = if self.close.is_some() {
            "three"
        } else {
            "pair"
        };
        figure(
            input.verify.simulated,
            class,
            &charts,
            &format!("Residuals against {label}."),
        )
    }

    fn chart(
        &self,
        column: &str,
        title: &str,
        y: &Axis,
        residual: fn(&ResidualRecord) -> f64,
    ) -> String {
        let mut values: Vec<f64> = self
            .records
            .iter()
            .filter_map(|r| value_of(r, column))
            .collect();
        values.sort_by(f64::total_cmp);
        values.dedup();
        // A few whole numbers are classes, such as trajectories: decimals between them mean
        // nothing.
        let classes = values.len() <= 12 && values.iter().all(|v| v.fract() == 0.0);
        let mut x = match (classes, values.first(), values.last()) {
            (true, Some(low), Some(high)) => Axis::fixed(label_of(column), low - 0.5, high + 0.5)
                .with_ticks(
                    values
                        .iter()
                        .map(|v| (*v, class_name(column, *v)))
                        .collect(),
                ),
            _ => Axis::covering(label_of(column), values.iter().copied()),
        };
        // On so long an axis the texts of neighbours such as 1 and 2 would overlap.
        if classes && column != "direction" && x.high - x.low > 24.0 {
            x.ticks = None;
        }
        let mut layers: Vec<Layer> = self
            .band
            .map(|b| Layer::Band { between: [-b, b] })
            .into_iter()
            .collect();
        layers.push(Layer::HorizontalRule { at: 0.0 });
        for (k, channel) in self.channels.iter().enumerate() {
            let (class, marker) = series(k);
            let of: Vec<_> = self
                .records
                .iter()
                .filter(|r| r.channel == *channel)
                .collect();
            // Readings of one class would lie on one another: spread them by a golden-ratio
            // sequence.
            let spread = |i: usize| match classes {
                true => {
                    0.36 * ((i as f64 * 0.618_034).fract() - 0.5)
                        + 0.4 * (k as f64 + 0.5) / self.channels.len() as f64
                        - 0.2
                }
                false => 0.0,
            };
            let place = |(i, r): (usize, &&&ResidualRecord)| {
                Some([value_of(r, column)? + spread(i), y.clamp(residual(r))])
            };
            let kept: Vec<_> = of.iter().filter(|r| r.rejected.is_none()).collect();
            let step = stride(kept.len(), MAX_POINTS);
            let at = kept
                .iter()
                .enumerate()
                .step_by(step)
                .filter_map(|(i, r)| place((i, r)))
                .collect();
            layers.push(Layer::Points {
                class,
                marker,
                at,
                titles: Vec::new(),
            });
            // Whoever looks for a mistake at the bench needs every rejected reading: none is
            // thinned out.
            let rejected: Vec<_> = of.iter().filter(|r| r.rejected.is_some()).collect();
            let titles = rejected
                .iter()
                .filter(|r| value_of(r, column).is_some())
                .map(|r| {
                    format!(
                        "point {}, rejected: {}",
                        r.point,
                        r.rejected.as_deref().unwrap_or_default()
                    )
                })
                .collect();
            let at = rejected
                .iter()
                .enumerate()
                .filter_map(|(i, r)| place((i, r)))
                .collect();
            layers.push(Layer::Points {
                class: "bad",
                marker: Marker::Cross,
                at,
                titles,
            });
        }
        svg(&Plot {
            title: title.into(),
            description: format!(
                "Residuals of {} ({}) against {}, {title}",
                self.channels.join(", "),
                self.unit,
                label_of(column)
            ),
            width: if self.close.is_some() { 330.0 } else { 270.0 },
            height: 200.0,
            x,
            y: y.clone(),
            layers,
        })
    }
}

fn class_name(column: &str, value: f64) -> String {
    match (column, value) {
        ("direction", 1.0) => "loading".into(),
        ("direction", -1.0) => "unloading".into(),
        _ => crate::number::number(value),
    }
}
