//! Rest geometry of the whisker from measured centre lines: the rod, held where the groove held the
//! wire, laid through all of them.
//!
//! min over x of sum_k sum_i |d_ki(x)|^2 / sd_ki^2 + sum_k (L_k - L(x))^2 / sd_Lk^2, d_ki the
//! distance of point i of shape k from the rod across it; BIC = n ln(S / n) + p ln n with n the
//! independent observations; jackknife covariance (n - 1)/n sum (x_(-k) - mean)^2.
//!
//! A held wire's shape depends on the rest shape, the clamp and the groove point alone: stiffness
//! only scales the force. Unknown are the rest shape ([`RestModel`]) and the clamp (small turns,
//! offsets across the wire). Which model the lines ask for is decided by BIC (G. Schwarz, Ann.
//! Statist. 6, 1978). The sd of each unknown is a jackknife over the shapes (Efron & Stein, Ann.
//! Statist. 9, 1981): neighbouring points of one centre line share their errors. Errors that all
//! shapes share (the cameras' scale) are not in it: [`RestFit::add_common_errors`] fits shapes that
//! were moved by each.

mod lines;
mod model;
mod problem;

use crate::RodError;
pub use lines::MeasuredShape;
use lines::{GuessedShape, distances, loaded_nodes};
pub use model::RestModel;
use nalgebra::{DMatrix, DVector};
use problem::solve;
use wcal_core::observation::{RestShape, WhiskerSpec};

/// Places of the free curvatures that are tried.
const PLACES: [usize; 4] = [3, 5, 8, 12];
/// Correlation along a line below which points count as independent.
const UNCORRELATED: f64 = 0.1;

/// Which model of the rest shape is fitted.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum RestChoice {
    /// Straight part and arc.
    StraightArc,
    /// Free curvature; the number of places by BIC.
    FreeCurvature,
    /// Either, by BIC.
    #[default]
    Best,
}

/// What a shape leaves over.
#[derive(Debug, Clone, PartialEq)]
pub struct ShapeResidual {
    /// Name of the pair.
    pub name: String,
    /// Root mean square distance of its points from the rod, mm.
    pub rms_mm: f64,
    /// Largest distance, mm, and where along the wire, mm.
    pub largest_mm: [f64; 2],
}

/// A model that was tried.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ModelScore {
    /// Model.
    pub model: RestModel,
    /// Bayesian information criterion: the least is chosen; infinite where the fit did not
    /// converge.
    pub bic: f64,
}

/// The fitted rest geometry.
#[derive(Debug, Clone, PartialEq)]
pub struct RestFit {
    /// Model of the rest shape.
    pub model: RestModel,
    /// All models tried, and the independent observations that BIC counts with; none where the
    /// model was asked for.
    pub candidates: Vec<ModelScore>,
    /// See `candidates`.
    pub independent: f64,
    /// Values in the order of [`RestModel::names`].
    pub values: DVector<f64>,
    /// Their covariance by the jackknife over shapes, and by common errors once added; none for
    /// fewer than three shapes.
    pub covariance: Option<DMatrix<f64>>,
    /// The part of it that comes from errors common to all shapes.
    pub common: Option<DMatrix<f64>>,
    /// Residuals of the shapes used.
    pub shapes: Vec<ShapeResidual>,
    /// Shapes left out, with the reason.
    pub excluded: Vec<(String, String)>,
    /// Root mean square distance over all points, mm.
    pub rms_mm: f64,
    /// The same of the distances along either transverse axis over their stated standard deviation;
    /// some 1 where the model holds.
    pub rms_over_sd: f64,
}

impl RestFit {
    /// Standard deviation of an unknown.
    pub fn sd(&self, index: usize) -> Option<f64> {
        self.covariance.as_ref().map(|c| c[(index, index)].sqrt())
    }

    /// Adds errors common to all shapes. `moved`: for each independent one the shapes as they would
    /// be with one standard deviation more.
    ///
    /// # Errors
    /// Where a fit does not converge.
    pub fn add_common_errors(
        &mut self,
        nominal: &WhiskerSpec,
        moved: &[Vec<MeasuredShape>],
    ) -> Result<(), RodError> {
        let mut sum = DMatrix::zeros(self.values.len(), self.values.len());
        for shapes in moved {
            let held: Vec<GuessedShape<'_>> = shapes
                .iter()
                .filter(|s| self.shapes.iter().any(|used| used.name == s.name))
                .map(|shape| {
                    let (_, guess) = loaded_nodes(
                        nominal,
                        self.model,
                        &self.values,
                        &GuessedShape { shape, guess: None },
                    )
                    .map_err(|why| RodError::RestFit(format!("{}: {why}", shape.name)))?;
                    Ok(GuessedShape { shape, guess })
                })
                .collect::<Result<_, RodError>>()?;
            // One standard deviation of each error moves all unknowns together: independent ones
            // add as outer products.
            let off = solve(nominal, self.model, &self.values, &held)?.0 - &self.values;
            sum += &off * off.transpose();
        }
        if let Some(covariance) = &mut self.covariance {
            *covariance += &sum;
        }
        self.common = Some(sum);
        Ok(())
    }
}

/// Fits the rest geometry, starting at the nominal one.
///
/// # Errors
/// Where the nominal shape is not a straight part with an arc, no shape can be followed, or the fit
/// does not converge.
pub fn fit_rest(
    nominal: &WhiskerSpec,
    shapes: &[MeasuredShape],
    choice: RestChoice,
) -> Result<RestFit, RodError> {
    let RestShape::StraightArc {
        straight_mm,
        arc_radius_mm,
        length_mm,
    } = nominal.rest_shape
    else {
        return Err(RodError::RestFit(
            "expected a straight part with an arc, found a polyline".to_owned(),
        ));
    };
    let arc = [straight_mm, arc_radius_mm, length_mm];
    let start = DVector::from_vec([&arc[..], &[0.0; 5]].concat());
    let mut excluded = Vec::new();
    let mut used = Vec::new();
    for shape in shapes {
        let mut held = GuessedShape { shape, guess: None };
        match loaded_nodes(nominal, RestModel::StraightArc, &start, &held) {
            Ok((_, guess)) => {
                held.guess = guess;
                used.push(held);
            }
            Err(why) => excluded.push((shape.name.clone(), why)),
        }
    }
    if used.is_empty() {
        let reasons: Vec<String> = excluded.iter().map(|(n, w)| format!("{n}: {w}")).collect();
        return Err(RodError::RestFit(format!(
            "expected at least one usable shape, found none ({})",
            reasons.join("; ")
        )));
    }
    let (model, values, candidates, independent) = select_model(nominal, &start, &used, choice)?;
    let covariance = jackknife(nominal, model, &values, &used)?;
    let (mut residuals, mut squares, mut count, mut scaled) = (Vec::new(), 0.0, 0, 0.0);
    for held in &used {
        let across = distances(nominal, model, &values, held).map_err(RodError::RestFit)?;
        let norms: Vec<f64> = across.iter().map(|(_, d)| d[0].hypot(d[1])).collect();
        let sum: f64 = norms.iter().map(|d| d * d).sum();
        squares += sum;
        // Two distances across a point: half the sum is that of an axis.
        scaled += norms
            .iter()
            .zip(&held.shape.sd_mm)
            .map(|(d, sd)| 0.5 * (d / sd).powi(2))
            .sum::<f64>();
        count += norms.len();
        let largest = (0..norms.len())
            .max_by(|&a, &b| norms[a].total_cmp(&norms[b]))
            .unwrap_or(0);
        residuals.push(ShapeResidual {
            name: held.shape.name.clone(),
            rms_mm: (sum / norms.len() as f64).sqrt(),
            largest_mm: [norms[largest], across[largest].0],
        });
    }
    let [rms_mm, rms_over_sd] = [squares, scaled].map(|sum| (sum / count as f64).sqrt());
    Ok(RestFit {
        model,
        candidates,
        independent,
        values,
        covariance,
        common: None,
        shapes: residuals,
        excluded,
        rms_mm,
        rms_over_sd,
    })
}

/// Model and values that are chosen, all models tried, independent observations.
type Selection = (RestModel, DVector<f64>, Vec<ModelScore>, f64);

/// Fits the models that are asked for; BIC decides between several.
fn select_model(
    nominal: &WhiskerSpec,
    start: &DVector<f64>,
    used: &[GuessedShape<'_>],
    choice: RestChoice,
) -> Result<Selection, RodError> {
    let arc = RestModel::StraightArc;
    let first = solve(nominal, arc, start, used);
    if choice == RestChoice::StraightArc {
        let (values, _) = first?;
        return Ok((arc, values, Vec::new(), 0.0));
    }
    // A wire that is far from any arc may have no best one: the free curvature then starts from the
    // nominal one.
    let from = first
        .as_ref()
        .map_or_else(|_| start.clone(), |(values, _)| values.clone());
    let mut tried = vec![(arc, first)];
    for places in PLACES {
        let model = RestModel::FreeCurvature(places);
        tried.push((model, solve(nominal, model, &model.from_arc(&from), used)));
    }
    // The most flexible model leaves the noise: how long it is correlated tells how much was
    // observed.
    let found: Vec<(RestModel, &DVector<f64>, f64)> = tried
        .iter()
        .filter_map(|(m, r)| r.as_ref().ok().map(|(v, squares)| (*m, v, *squares)))
        .collect();
    let Some((flexible, values, _)) = found.last() else {
        return Err(tried
            .into_iter()
            .find_map(|(_, r)| r.err())
            .unwrap_or_else(|| RodError::RestFit("expected a model, found none".to_owned())));
    };
    let independent = independent(nominal, *flexible, values, used)?;
    // With the noise estimated from S itself, up to a constant.
    let bic = |model: RestModel, squares: f64| {
        independent * (squares / independent).ln() + model.names().len() as f64 * independent.ln()
    };
    let candidates: Vec<ModelScore> = tried
        .iter()
        .map(|(model, r)| ModelScore {
            model: *model,
            bic: r
                .as_ref()
                .map_or(f64::INFINITY, |(_, squares)| bic(*model, *squares)),
        })
        .collect();
    let may_be = |m: RestModel| choice == RestChoice::Best || m != arc;
    let best = found
        .into_iter()
        .filter(|f| may_be(f.0))
        .min_by(|a, b| bic(a.0, a.2).total_cmp(&bic(b.0, b.2)))
        .ok_or_else(|| {
            RodError::RestFit("expected a free curvature that fits, found none".to_owned())
        })?;
    Ok((best.0, best.1.clone(), candidates, independent))
}

/// Independent observations in all lines: points over the length, in points, within which residuals
/// are correlated.
fn independent(
    nominal: &WhiskerSpec,
    model: RestModel,
    values: &DVector<f64>,
    used: &[GuessedShape<'_>],
) -> Result<f64, RodError> {
    let mut lines: Vec<Vec<f64>> = Vec::new();
    for held in used {
        let across = distances(nominal, model, values, held).map_err(RodError::RestFit)?;
        let scaled = |axis: usize| {
            across
                .iter()
                .zip(&held.shape.sd_mm)
                .map(|(a, sd)| a.1[axis] / sd)
                .collect()
        };
        lines.extend([0, 1].map(scaled));
    }
    let points: usize = lines.iter().map(Vec::len).sum();
    // Autocovariance at a lag, over both axes of all lines.
    let product = |lag: usize| -> f64 {
        let of = |line: &Vec<f64>| {
            line.iter()
                .zip(line.iter().skip(lag))
                .map(|(a, b)| a * b)
                .sum::<f64>()
        };
        lines.iter().map(of).sum()
    };
    let all = product(0);
    let longest = lines.iter().map(Vec::len).max().unwrap_or(0);
    // Cut at the first lag of little correlation: estimates at long lags are noise that would add
    // up.
    let correlations = (1..longest)
        .map(|lag| product(lag) / all)
        .take_while(|c| *c > UNCORRELATED);
    // Integrated correlation: so many neighbours count as one observation.
    let span = 1.0 + 2.0 * correlations.sum::<f64>();
    Ok(points as f64 / span)
}

/// Covariance by leaving out one shape after the other; none for fewer than three.
fn jackknife(
    nominal: &WhiskerSpec,
    model: RestModel,
    values: &DVector<f64>,
    used: &[GuessedShape<'_>],
) -> Result<Option<DMatrix<f64>>, RodError> {
    if used.len() < 3 {
        return Ok(None);
    }
    let n = used.len() as f64;
    let mut deleted: Vec<DVector<f64>> = Vec::with_capacity(used.len());
    for skip in 0..used.len() {
        let rest = [&used[..skip], &used[skip + 1..]].concat();
        deleted.push(solve(nominal, model, values, &rest)?.0);
    }
    let mean = deleted.iter().sum::<DVector<f64>>() / n;
    let mut sum = DMatrix::zeros(values.len(), values.len());
    for d in &deleted {
        // Spread of the fits that each leave out one shape.
        let off = d - &mean;
        sum += &off * off.transpose();
    }
    // Fits without one shape share all others: (n - 1) / n of the sum of squares, not of its mean.
    Ok(Some(sum * ((n - 1.0) / n)))
}
