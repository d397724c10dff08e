//! Axes: range, round ticks and the way from data to pixels.

use crate::number::{significant, superscript};

/// How data is laid out along an axis.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Scale {
    /// Equal steps.
    Linear,
    /// Equal ratios; values must be positive.
    Log,
}

/// One axis of a chart.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Axis {
    /// Name with unit.
    pub label: String,
    /// Lower end, data unit.
    pub low: f64,
    /// Upper end, data unit; above `low`.
    pub high: f64,
    /// Layout.
    pub scale: Scale,
    /// Fixed ticks; none: round numbers.
    pub ticks: Option<Vec<(f64, String)>>,
}

impl Axis {
    /// Covers every finite value with a small margin.
    pub(crate) fn covering(
        label: impl Into<String>,
        values: impl IntoIterator<Item = f64>,
    ) -> Self {
        let (low, high) = extent(values);
        // Equal values, too, need an axis of some width to lie on.
        let margin = match high - low {
            span if span > 0.0 => 0.05 * span,
            _ => (0.1 * low.abs()).max(f64::MIN_POSITIVE.sqrt()),
        };
        Self::fixed(label, low - margin, high + margin)
    }

    /// Covers every finite value, zero in the middle.
    pub(crate) fn symmetric(
        label: impl Into<String>,
        values: impl IntoIterator<Item = f64>,
    ) -> Self {
        let (low, high) = extent(values);
        let reach = match low.abs().max(high.abs()) {
            reach if reach > 0.0 => 1.08 * reach,
            _ => 1.0,
        };
        Self::fixed(label, -reach, reach)
    }

    /// Covers every positive finite value in equal ratios.
    pub(crate) fn log_covering(
        label: impl Into<String>,
        values: impl IntoIterator<Item = f64>,
    ) -> Self {
        let (low, high) = extent(
            values
                .into_iter()
                .filter(|v| (1e-290..1e290).contains(v))
                .map(f64::log10),
        );
        // Less than a factor of three shows no round ticks.
        let margin = (0.06 * (high - low)).max(0.25 - 0.5 * (high - low));
        let (low, high) = (
            10f64.powf((low - margin).max(-300.0)),
            10f64.powf((high + margin).min(300.0)),
        );
        Self {
            scale: Scale::Log,
            ..Self::fixed(label, low, high)
        }
    }

    /// A linear axis of given ends.
    pub(crate) fn fixed(label: impl Into<String>, low: f64, high: f64) -> Self {
        // An axis without width would divide by zero in `position`.
        let high = if high > low { high } else { low + 1.0 };
        Self {
            label: label.into(),
            low,
            high,
            scale: Scale::Linear,
            ticks: None,
        }
    }

    /// Replaces the round ticks by named ones.
    pub(crate) fn with_ticks(mut self, ticks: Vec<(f64, String)>) -> Self {
        self.ticks = Some(ticks);
        self
    }

    /// Position along the axis, 0 at the lower end and 1 at the upper; `None` outside or not
    /// finite.
    pub(crate) fn position(&self, value: f64) -> Option<f64> {
        let share = match self.scale {
            Scale::Linear => (value - self.low) / (self.high - self.low),
            Scale::Log => (value / self.low).ln() / (self.high / self.low).ln(),
        };
        // By rounding, an end of the axis may come out just below 0 or above 1.
        (-1e-9..=1.0 + 1e-9).contains(&share).then_some(share)
    }

    /// The nearest value that lies on the axis; NaN stays NaN.
    pub(crate) fn clamp(&self, value: f64) -> f64 {
        if value.is_nan() {
            value
        } else {
            value.clamp(self.low, self.high)
        }
    }

    /// Ticks with their texts, about `wanted` of them, and the label, which carries a common power
    /// of ten.
    pub(crate) fn ticks(&self, wanted: usize) -> (Vec<(f64, String)>, String) {
        if let Some(ticks) = &self.ticks {
            return (ticks.clone(), self.label.clone());
        }
        match self.scale {
            Scale::Linear => self.linear_ticks(wanted),
            Scale::Log => (self.log_ticks(wanted), self.label.clone()),
        }
    }

    fn linear_ticks(&self, wanted: usize) -> (Vec<(f64, String)>, String) {
        let step = nice_step((self.high - self.low) / wanted.max(1) as f64);
        let largest = self.low.abs().max(self.high.abs());
        let power = largest.log10().floor() as i32;
        let shift = if (-2..5).contains(&power) { 0 } else { power };
        let decimals = shift
            .saturating_sub(step.log10().floor() as i32)
            .clamp(0, 9) as usize;
        let first = (self.low / step).ceil() as i64;
        let last = (self.high / step).floor() as i64;
        // A span below the resolution of the numbers gives no sensible ticks.
        let last = last.min(first.saturating_add(50));
        let text = |v: f64| {
            let scaled = v / 10f64.powi(shift);
            let scaled = if scaled.abs() < 0.5 * 10f64.powi(-(decimals as i32)) {
                0.0
            } else {
                scaled
            };
            format!("{scaled:.decimals$}").replace('-', "\u{2212}")
        };
        let ticks = (first..=last)
            .map(|k| k as f64 * step)
            .map(|v| (v, text(v)))
            .collect();
        let label = match shift {
            0 => self.label.clone(),
            _ => format!("{} ×10{}", self.label, superscript(shift)),
        };
        (ticks, label)
    }

    fn log_ticks(&self, wanted: usize) -> Vec<(f64, String)> {
        let decades = self.low.log10().floor() as i32..=self.high.log10().ceil() as i32;
        let all = |leads: &[f64]| -> Vec<f64> {
            let values = decades
                .clone()
                .flat_map(|d| leads.iter().map(move |l| l * 10f64.powi(d)));
            values.filter(|v| self.position(*v).is_some()).collect()
        };
        let fine = [
            &[1.0][..],
            &[1.0, 3.0],
            &[1.0, 2.0, 5.0],
            &[1.0, 2.0, 3.0, 5.0, 7.0],
        ];
        let chosen = fine
            .iter()
            .map(|leads| all(leads))
            .rfind(|t| t.len() <= wanted.max(2));
        let mut values = chosen.unwrap_or_else(|| all(&[1.0]));
        let every = values.len().div_ceil(wanted.max(2)).max(1);
        values = values.into_iter().step_by(every).collect();
        values.into_iter().map(|v| (v, significant(v, 2))).collect()
    }
}

/// Smallest and largest finite value; (0, 1) where there is none. Sizes near the end of the number
/// range cannot be drawn.
fn extent(values: impl IntoIterator<Item = f64>) -> (f64, f64) {
    let finite = values.into_iter().filter(|v| v.abs() < 1e290);
    let (low, high) = finite.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| {
        (low.min(v), high.max(v))
    });
    if low <= high { (low, high) } else { (0.0, 1.0) }
}

/// The round number (1, 2 or 5 times a power of ten) nearest to `raw` as a ratio.
fn nice_step(raw: f64) -> f64 {
    let power = 10f64.powf(raw.log10().floor());
    // The limits lie near the geometric means of neighbours: √2, √10 and √50.
    let nice = match raw / power {
        lead if lead < 1.5 => 1.0,
        lead if lead < 3.2 => 2.0,
        lead if lead < 7.0 => 5.0,
        _ => 10.0,
    };
    nice * power
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_round_and_inside() {
        let (ticks, label) = Axis::fixed("x (mm)", -0.13, 5.3).ticks(5);
        let texts: Vec<_> = ticks.iter().map(|t| t.1.as_str()).collect();
        assert_eq!(texts, ["0", "1", "2", "3", "4", "5"]);
        assert_eq!(label, "x (mm)");
    }

    #[test]
    fn small_numbers_move_their_power_into_the_label() {
        let (ticks, label) = Axis::fixed("y", -4e-4, 4e-4).ticks(4);
        assert_eq!(label, "y ×10⁻⁴");
        assert_eq!(
            ticks.iter().map(|t| t.1.as_str()).collect::<Vec<_>>(),
            ["−4", "−2", "0", "2", "4"]
        );
    }

    #[test]
    fn axes_survive_empty_constant_and_broken_data() {
        for values in [
            vec![],
            vec![3.0],
            vec![0.0],
            vec![f64::NAN, f64::INFINITY],
            vec![1e289, -1e289],
            vec![f64::MAX, 1.0],
            vec![5e-324, 1e-323],
        ] {
            for axis in [
                Axis::covering("", values.clone()),
                Axis::symmetric("", values.clone()),
                Axis::log_covering("", values.clone()),
            ] {
                assert!(axis.low < axis.high, "{values:?} {axis:?}");
                let ticks = axis.ticks(5).0;
                assert!(
                    ticks.len() <= 60 && ticks.iter().all(|t| t.0.is_finite()),
                    "{values:?} {ticks:?}"
                );
            }
        }
    }

    #[test]
    fn log_ticks_thin_out() {
        let axis = Axis::log_covering("", [0.5, 20_000.0]);
        assert!(axis.ticks(5).0.len() <= 5);
        assert!(axis.position(-1.0).is_none());
        assert!(axis.position(f64::NAN).is_none());
    }
}
