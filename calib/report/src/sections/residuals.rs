//! Residuals against every covariate, before and after; first those that the residuals follow most.
//!
//! ```text
//! eta^2 = sum of n (mean - mean of all)^2 over the parts / sum of squares about the mean of all
//! ```

use super::parts::{absent, distinct, figure, joined, legend, series};
use crate::input::ReportInput;
use crate::markup::escape;
use crate::number::split_unit;
use crate::plot::{Axis, Layer, Marker, Plot, stride, svg};
use wcal_core::ResidualRecord;

/// Covariates with a place of their own in the order; others follow as they come.
const ORDER: [(&str, &str); 12] = [
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
    ("cycle", "cycle"),
    ("contact_arclength_mm", "arc length of the contact (mm)"),
];

/// Points a series and chart; a larger session is thinned evenly.
const MAX_POINTS: usize = 3000;
/// Points a series from which on they cover one another: small ones, with their means.
const DENSE: usize = 300;
/// Parts of equal count whose means are taken.
const PARTS: usize = 20;
/// Charts that are not folded.
const FIRST: usize = 3;

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
        "trajectory" | "cycle" => named.or((record.group > 0).then_some(f64::from(record.group))),
        "order" => named.or(Some(record.line as f64)),
        _ => named,
    }
    .filter(|v| v.is_finite())
}

/// The section.
pub(super) fn body(input: &ReportInput) -> String {
    if input.residuals.is_empty() {
        return String::new();
    }
    let mut out = String::from(
        "<p>Residual = measured − predicted, for every covariate that varies, the one that they follow most first. Before and after share one vertical scale; the band is twice the noise floor to either side. Where readings are many they are specks, and markers are means of equal counts. Crosses mark rejected readings; those beyond the scale lie on its edge.</p>",
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
        let (mut drawn, constant): (Vec<_>, Vec<_>) = columns(input, &view.records)
            .into_iter()
            .partition(|column| view.varies(column));
        drawn.sort_by(|a, b| view.strength(b).total_cmp(&view.strength(a)));
        let panels = |columns: &[String]| {
            let figures: String = columns.iter().map(|c| view.figure(input, c)).collect();
            format!("<div class=\"panels\">\n{figures}</div>\n")
        };
        let (first, rest) = drawn.split_at(drawn.len().min(FIRST));
        out += &panels(first);
        if !rest.is_empty() {
            let names: Vec<String> = rest.iter().map(|c| label_of(c)).collect();
            out += &format!(
                "<details><summary>Against {}</summary>{}</details>\n",
                escape(&joined(&names)),
                panels(rest)
            );
        }
        let constant: Vec<String> = constant.iter().map(|c| label_of(c)).collect();
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

fn columns(input: &ReportInput, records: &[&ResidualRecord]) -> Vec<String> {
    let named = records
        .iter()
        .flat_map(|r| r.covariates.iter().map(|(name, _)| name.as_str()));
    let mut out = distinct(ORDER.iter().map(|(name, _)| *name).chain(named));
    let of_other_kinds = |column: &str| {
        let is_group = matches!(column, "trajectory" | "cycle");
        is_group && column != input.verify.group_name()
    };
    out.retain(|column| {
        !of_other_kinds(column) && records.iter().any(|r| value_of(r, column).is_some())
    });
    out
}

fn before(record: &ResidualRecord) -> f64 {
    record.measured - record.predicted_before
}

fn after(record: &ResidualRecord) -> f64 {
    record.measured - record.predicted_after
}

/// Means of x and y, and the count, in parts of about equal counts that do not divide equal x.
fn means(mut points: Vec<[f64; 2]>) -> Vec<[f64; 3]> {
    points.sort_by(|a, b| a[0].total_cmp(&b[0]));
    let least = points.len().div_ceil(PARTS);
    let mut parts: Vec<Vec<[f64; 2]>> = Vec::new();
    for same in points.chunk_by(|a, b| a[0] == b[0]) {
        match parts.last_mut() {
            Some(part) if part.len() < least => part.extend(same),
            _ => parts.push(same.to_vec()),
        }
    }
    let of = |part: &Vec<[f64; 2]>| {
        let n = part.len() as f64;
        let [x, y] = [0, 1].map(|k| part.iter().map(|p| p[k]).sum::<f64>() / n);
        [x, y, n]
    };
    parts.iter().map(of).collect()
}

/// Readings of one unit with their common vertical scales.
struct View<'a> {
    records: Vec<&'a ResidualRecord>,
    channels: Vec<String>,
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
            common,
            close,
            band,
        }
    }

    /// Correlation ratio of the residuals before with a covariate (see the module), channels pooled.
    fn strength(&self, column: &str) -> f64 {
        let (mut between, mut total) = (0.0, 0.0);
        for channel in &self.channels {
            let points: Vec<[f64; 2]> = self
                .records
                .iter()
                .filter(|r| r.channel == *channel && r.rejected.is_none())
                .filter_map(|r| Some([value_of(r, column)?, before(r)]))
                .filter(|p| p[1].is_finite())
                .collect();
            let count = points.len() as f64;
            let mean = points.iter().map(|p| p[1]).sum::<f64>() / count;
            total += points.iter().map(|p| (p[1] - mean).powi(2)).sum::<f64>();
            let parts = means(points);
            between += parts
                .iter()
                .map(|[_, y, n]| n * (y - mean).powi(2))
                .sum::<f64>();
        }
        match between / total {
            share if share.is_finite() => share,
            _ => 0.0,
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
        let mut means_of = Vec::new();
        for (k, channel) in self.channels.iter().enumerate() {
            let (class, marker) = series(k);
            let of: Vec<_> = self
                .records
                .iter()
                .filter(|r| r.channel == *channel)
                .collect();
            // Readings of one class would lie on one another: spread them by a golden-ratio
            // sequence.
            let share = (k as f64 + 0.5) / self.channels.len() as f64;
            let [own, spread] = if classes {
                [0.4 * share - 0.2, 0.36]
            } else {
                [0.0; 2]
            };
            let spread = |i: usize| own + spread * ((i as f64 * 0.618_034).fract() - 0.5);
            let place = |(i, r): (usize, &&&ResidualRecord)| {
                Some([value_of(r, column)? + spread(i), y.clamp(residual(r))])
            };
            let kept: Vec<_> = of.iter().filter(|r| r.rejected.is_none()).collect();
            let is_dense = kept.len() > DENSE;
            let step = stride(kept.len(), MAX_POINTS);
            let at = kept
                .iter()
                .enumerate()
                .step_by(step)
                .filter_map(|(i, r)| place((i, r)))
                .collect();
            layers.push(Layer::Points {
                class,
                marker: if is_dense { Marker::Speck } else { marker },
                at,
                titles: Vec::new(),
            });
            if is_dense {
                let points = kept
                    .iter()
                    .filter_map(|r| Some([value_of(r, column)?, residual(r)]));
                let finite = points.filter(|p| p[1].is_finite()).collect();
                let parts = means(finite).into_iter();
                let at = parts.map(|[x, mean, _]| [x + own, y.clamp(mean)]).collect();
                means_of.push((class, marker, at));
            }
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
        // Above the specks of every channel.
        layers.extend(
            means_of
                .into_iter()
                .map(|(class, marker, at)| Layer::Points {
                    class,
                    marker,
                    at,
                    titles: Vec::new(),
                }),
        );
        svg(&Plot {
            title: title.into(),
            description: format!(
                "Residuals of {} against {}, {title}",
                self.channels.join(", "),
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
