//! Does a whisker's calibration still hold, and what changed since?
//!
//! ```text
//! f(x) = B' c(m(x), v)                                         shifts at the pose x, see `physical`
//! V    = R s_i s_j corr(t_i - t_j) + J cov(B, v) J'            R: of both gratings, which share the reference's noise
//! G_i  = df(x_i) / d groove,     d = G_i^+ c_i                 displacement of the contact that a change c_i of the shifts looks like
//! ```
//!
//! Columns of [`crate::models::change`]: each grating's zero and temperature; the gain, together and
//! of each grating; the groove along the wire, in depth and sideways, and turned about the wire; the
//! stage's zero; effects that grow with use, by their plainest law; as much more of what is accepted.

use super::path::Reading;
use super::physical::PhysicalModel;
use super::rod_parameters::RodParameters;
use super::system::WhiskerSystem;
use crate::effect::{EffectTerm, Role};
use crate::levels::NORMAL_95;
use crate::measurement_model::MeasurementModel;
use crate::models::change::{CalibrationCheck, Column, NewReadings};
use nalgebra::{
    DMatrix, DVector, Matrix2, Matrix2x3, Matrix3x2, Rotation3, Unit, Vector2, Vector3,
};
use wcal_core::observation::{Trajectory, WhiskerData};
use wcal_rod::RodError;

/// Effects that can come or grow between two sessions of one whisker.
const GROWING: [&str; 4] = [
    "groove-friction",
    "stage-backlash",
    "base-compliance",
    "hysteresis",
];
/// Step of the differences by a displacement of the groove, mm, and by its turn, degrees.
const STEP_MM: f64 = 0.1;
const STEP_DEG: f64 = 0.5;
/// The same by a share.
const STEP_SHARE: f64 = 0.01;
/// The same by a value of an effect, in its standard deviations.
const VALUE_STEP: f64 = 0.1;
/// Mean length of the stage's directions from which they are one.
const ONE_DIRECTION: f64 = 0.999;
/// Share of the largest slope by the groove below which a direction is not seen.
const UNSEEN: f64 = 0.05;

/// A session through the calibration.
struct Through<'a> {
    model: &'a PhysicalModel,
    data: WhiskerData,
    system: WhiskerSystem,
    /// The calibration as it stands.
    stated: State,
}

/// What can be another than stated.
#[derive(Clone)]
struct State {
    trajectories: Vec<Trajectory>,
    is_moved: bool,
    terms: Vec<EffectTerm>,
    coefficients: DMatrix<f64>,
    /// Shifts that come to those of the readout, pm.
    added_pm: DMatrix<f64>,
}

/// Makes a change of a size.
type Apply<'a> = Box<dyn Fn(f64, &mut State) + 'a>;
/// What a displacement of the groove does to a trajectory.
type Displace = Box<dyn Fn(f64, &mut Trajectory)>;

/// A change that can be: what it is called, its unit, the step of its differences, and what it does.
struct Change<'a> {
    name: String,
    unit: &'static str,
    step: f64,
    is_required: bool,
    one_sided: bool,
    apply: Apply<'a>,
}

impl PhysicalModel {
    /// Judges the calibration by the readings of a session that it was not fitted to; none where
    /// none of them can be compared: poses without an equilibrium, or moments beyond the valid ones.
    ///
    /// # Errors
    /// Where the rest shape cannot be used.
    pub fn check_session(&self, data: &WhiskerData) -> Result<Option<CalibrationCheck>, RodError> {
        // New readings belong to the last seating that the calibration saw.
        let seating = self.seatings.saturating_sub(1);
        let mut data = data.clone();
        data.rows.iter_mut().for_each(|r| r.seating = seating);
        let system = self.system_of(&data)?;
        // A moved groove leaves the stage where it was read.
        for (row, reading) in system.path.rows.iter().zip(&system.path.readings) {
            data.rows[*row].stage_mm = Some(reading.x_mm);
        }
        let (count, readings) = (self.coefficients.len(), system.path.readings.len());
        let stated = State {
            trajectories: data.trajectories.clone(),
            is_moved: false,
            terms: self.terms().into_iter().map(|a| a.term).collect(),
            coefficients: DMatrix::from_fn(count, 2, |i, c| self.coefficients[i][c]),
            added_pm: DMatrix::zeros(readings, 2),
        };
        let through = Through {
            model: self,
            data,
            system,
            stated,
        };
        Ok(through.check())
    }

    fn system_of(&self, data: &WhiskerData) -> Result<WhiskerSystem, RodError> {
        let mut system = WhiskerSystem::new(data, &[])?;
        system.origin = self.readout_origin;
        Ok(system)
    }
}

impl Through<'_> {
    /// Shifts at the readings, pm.
    fn shifts(&self, state: &State) -> Option<DMatrix<f64>> {
        let of = |system: &WhiskerSystem| {
            Some(system.design(&state.terms)? * &state.coefficients + &state.added_pm)
        };
        if !state.is_moved {
            return of(&self.system);
        }
        let data = WhiskerData {
            trajectories: state.trajectories.clone(),
            ..self.data.clone()
        };
        of(&self.model.system_of(&data).ok()?)
    }

    fn check(&self) -> Option<CalibrationCheck> {
        let (system, model, stated) = (&self.system, self.model, &self.stated);
        let readings = &system.path.readings;
        let design = system.design(&stated.terms)?;
        let (_, base) = system.moments(&stated.terms)?;
        let predicted = &design * &stated.coefficients;
        let is_kept = |i: &usize| !readings[*i].unsteady && model.is_valid(base[*i]);
        let kept: Vec<usize> = (0..readings.len()).filter(is_kept).collect();
        let n = kept.len();
        if n == 0 {
            return None;
        }
        // Channel by channel.
        let stacked = |m: &DMatrix<f64>| DVector::from_fn(2 * n, |k, _| m[(kept[k % n], k / n)]);
        let used: Vec<Reading> = kept.iter().map(|&i| readings[i].clone()).collect();
        let noise = self.noise(&used);
        let slopes = self.slopes(&design, &predicted, &stacked);
        let theta = DMatrix::from_fn(slopes.ncols(), slopes.ncols(), |i, j| {
            model.covariance[i][j]
        });
        let shared = &slopes * theta * slopes.transpose();
        let changes = self.changes();
        let at = |sizes: &[f64]| {
            let mut state = stated.clone();
            let acting = changes.iter().zip(sizes).filter(|(_, size)| **size != 0.0);
            acting.for_each(|(change, size)| (change.apply)(*size, &mut state));
            self.shifts(&state).map(|shifts| stacked(&shifts))
        };
        let before = stacked(&predicted);
        let by = |k: usize| {
            let sizes: Vec<f64> = (0..changes.len())
                .map(|j| if j == k { changes[k].step } else { 0.0 })
                .collect();
            Some((at(&sizes)? - &before) / changes[k].step)
        };
        let values: Vec<Option<DVector<f64>>> = (0..changes.len()).map(by).collect();
        let [along, depth, sideways] = [0, 1, 2].map(|k| values[k].clone());
        let contact = Contact::new(&used, [along?, depth?, sideways?]);
        let column = |(change, values): (&Change, Option<DVector<f64>>)| {
            let values = values.unwrap_or_else(|| DVector::zeros(2 * n));
            Column {
                name: change.name.clone(),
                unit: change.unit.to_owned(),
                cost: contact.cost(&values),
                values,
                one_sided: change.one_sided,
                is_required: change.is_required,
            }
        };
        let sd = |m: &DMatrix<f64>| contact.sd(m);
        let new = NewReadings {
            readings: n,
            errors: stacked(system.measured()) - &before,
            dof: UNKNOWN_DOF,
            columns: changes.iter().zip(values).map(column).collect(),
            noise_cost: sd(&noise),
            shared_cost: sd(&shared),
            stated: NORMAL_95 * sd(&(&noise + &shared)),
            noise,
            shared,
            unit: contact.unit().to_owned(),
        };
        new.check(Some(&|sizes| Some(at(sizes)? - &before)))
    }

    /// Covariance of the readings' noise, channel by channel, pm^2.
    fn noise(&self, readings: &[Reading]) -> DMatrix<f64> {
        let (n, model) = (readings.len(), self.model);
        let sd = model.noise_of(readings);
        let gratings = self.system.shared_by_reference(model.noise_sd_pm);
        let (share, time_s) = model.correlated_noise.map_or((0.0, 1.0), |c| {
            let square = c.sd_pm.powi(2);
            (square / (square + c.own_sd_pm.powi(2)), c.time_constant_s)
        });
        DMatrix::from_fn(2 * n, 2 * n, |a, b| {
            let (i, j) = (a % n, b % n);
            let apart_s = (readings[i].t_s - readings[j].t_s).abs();
            let own = if i == j { 1.0 - share } else { 0.0 };
            let alike = own + share * (-apart_s / time_s).exp();
            gratings[(a / n, b / n)] * sd[i] * sd[j] * alike
        })
    }

    /// Derivatives by the coefficients, channel by channel, and by the effects' values.
    fn slopes(
        &self,
        design: &DMatrix<f64>,
        predicted: &DMatrix<f64>,
        stacked: &dyn Fn(&DMatrix<f64>) -> DVector<f64>,
    ) -> DMatrix<f64> {
        let (rows, count) = design.shape();
        let mut out = Vec::new();
        for slot in 0..2 * count {
            let mut only = DMatrix::zeros(rows, 2);
            only.set_column(slot / count, &design.column(slot % count));
            out.push(stacked(&only));
        }
        for (t, term) in self.stated.terms.iter().enumerate() {
            for k in 0..term.values.len() {
                let variance = self.model.covariance[out.len()][out.len()];
                let range = self.system.catalogue()[term.effect]
                    .law(term.law)
                    .parameters[k]
                    .range;
                let mut step = VALUE_STEP * variance.max(0.0).sqrt();
                // A law holds only within its range.
                if term.values[k] + step > range[1] {
                    step = -step;
                }
                let mut state = self.stated.clone();
                state.terms[t].values[k] += step;
                let changed = self.shifts(&state).filter(|_| step != 0.0);
                let slope = changed.map(|after| stacked(&((after - predicted) / step)));
                out.push(slope.unwrap_or_else(|| stacked(&DMatrix::zeros(rows, 2))));
            }
        }
        DMatrix::from_columns(&out)
    }

    /// Axis along the wire at its root, that of the mean push across it, and the third.
    fn axes(&self) -> [Vector3<f64>; 3] {
        let rod = self.system.rod_tables.rod(&RodParameters::default());
        let along = rod.map_or_else(Vector3::x, |r| {
            (r.shape.rest_point(1.0) - r.shape.rest_point(0.0)).normalize()
        });
        let sum: Vector3<f64> = self.used().map(|t| t.direction).sum();
        let across = sum - along * along.dot(&sum);
        // Directions all around have no mean one.
        let depth = across.try_normalize(0.1 * self.used().count() as f64);
        let depth = depth.unwrap_or_else(|| {
            let axis = Vector3::ith(along.iamin(), 1.0);
            (axis - along * along.dot(&axis)).normalize()
        });
        [along, depth, along.cross(&depth)]
    }

    /// Trajectories on which something was read.
    fn used(&self) -> impl Iterator<Item = &Trajectory> {
        let is_used = |t: &&Trajectory| self.data.rows.iter().any(|r| r.trajectory == Some(t.id));
        self.data.trajectories.iter().filter(is_used)
    }

    /// All changes that can be, three displacements of the groove across each other first.
    fn changes(&self) -> Vec<Change<'_>> {
        let (axes, path) = (self.axes(), &self.system.path);
        let mut all = Vec::new();
        let mut put = |name: &str, unit, step, one_sided, apply| {
            all.push(Change {
                name: name.to_owned(),
                unit,
                step,
                is_required: name == "gain" || name.starts_with("zero"),
                one_sided,
                apply,
            });
        };
        let mut add = |name: &str, unit, step, apply| put(name, unit, step, false, apply);
        let moved = |by: Displace| -> Apply<'_> {
            Box::new(move |size, state| {
                state.trajectories.iter_mut().for_each(|t| by(size, t));
                state.is_moved = true;
            })
        };
        for (axis, name) in axes
            .into_iter()
            .zip(["along the wire", "depth", "sideways"])
        {
            let shift = move |size, t: &mut Trajectory| t.origin_mm += axis * size;
            add(
                &format!("groove {name}"),
                "mm",
                STEP_MM,
                moved(Box::new(shift)),
            );
        }
        let along = Unit::new_unchecked(axes[0]);
        let turn = move |size: f64, t: &mut Trajectory| {
            let turn = Rotation3::from_axis_angle(&along, size.to_radians());
            (t.origin_mm, t.direction) = (turn * t.origin_mm, turn * t.direction);
        };
        add("groove turn", "deg", STEP_DEG, moved(Box::new(turn)));
        let directions: Vector3<f64> = self.used().map(|t| t.direction).sum();
        // Along one direction it is the depth.
        if directions.norm() < ONE_DIRECTION * self.used().count() as f64 {
            let deeper = |size, t: &mut Trajectory| t.origin_mm += t.direction * size;
            add("stage zero", "mm", STEP_MM, moved(Box::new(deeper)));
        }
        let gain = |of: std::ops::Range<usize>| -> Apply<'_> {
            Box::new(move |size, state| {
                // K stands behind the zero.
                let mut k = state.coefficients.view_mut((1, of.start), (2, of.len()));
                k *= 1.0 + size;
            })
        };
        add("gain", "1", STEP_SHARE, gain(0..2));
        for c in 0..2 {
            let of = |what: &str| format!("{what} of grating {}", c + 1);
            add(&of("gain"), "1", STEP_SHARE, gain(c..c + 1));
            let zero =
                move |size, state: &mut State| state.added_pm.column_mut(c).add_scalar_mut(size);
            add(&of("zero"), "pm", 1.0, Box::new(zero));
            if path.columns.temperature {
                let origin = self.system.origin.temperature_degc;
                let by = move |size: f64, state: &mut State| {
                    for (i, r) in path.readings.iter().enumerate() {
                        state.added_pm[(i, c)] += size * (r.temperature_loo_degc - origin);
                    }
                };
                add(&of("temperature coefficient"), "pm/degC", 1.0, Box::new(by));
            }
        }
        for (term, accepted) in self.stated.terms.iter().zip(&self.model.effects) {
            let law = self.system.catalogue()[term.effect].law(term.law);
            // Temperature stands above, grating by grating.
            if accepted.id == "temperature-mismatch" {
                continue;
            }
            let more = move |size: f64, state: &mut State| {
                let at = |t: &&mut EffectTerm| t.effect == term.effect && t.law == term.law;
                if let Some(t) = state.terms.iter_mut().find(at) {
                    for (value, p) in t.values.iter_mut().zip(&law.parameters) {
                        if matches!(p.role, Role::Amplitude { .. }) {
                            *value = (*value * (1.0 + size)).clamp(p.range[0], p.range[1]);
                        }
                    }
                }
                let own = self.columns_of(term);
                let mut rows = state.coefficients.rows_mut(own.start, own.len());
                rows *= 1.0 + size;
            };
            add(&accepted.id, "1", STEP_SHARE, Box::new(more));
        }
        for (index, effect) in self.system.catalogue().iter().enumerate() {
            let accepted = self.stated.terms.iter().any(|t| t.effect == index);
            let hidden = || self.system.not_observable(index).is_some();
            if accepted || !GROWING.contains(&effect.id) || hidden() {
                continue;
            }
            let law = effect.law(0);
            let probed = law.parameters.iter().map(|p| match p.role {
                Role::Amplitude { probe } => probe,
                Role::Shape { grid } => grid[grid.len() / 2],
            });
            let (probed, first): (Vec<f64>, _) = (probed.collect(), &law.parameters[0]);
            let [low, high] = first.range;
            let step = probed[0];
            let grown = move |size: f64, state: &mut State| {
                let mut values = probed.clone();
                values[0] = size.clamp(low, high);
                state.terms.push(EffectTerm {
                    effect: index,
                    law: 0,
                    values,
                });
            };
            // Neither friction nor play nor compliance lies below none.
            put(effect.id, first.unit, step, low >= 0.0, Box::new(grown));
        }
        all
    }

    /// Rows of the coefficients that a term brings.
    fn columns_of(&self, term: &EffectTerm) -> std::ops::Range<usize> {
        let count = |t: &EffectTerm| self.system.catalogue()[t.effect].law(t.law).linear.len();
        let behind = self.stated.terms.iter().skip_while(|t| *t != term);
        let start = self.stated.coefficients.nrows() - behind.map(count).sum::<usize>();
        start..start + count(term)
    }
}

/// Degrees of freedom of a noise whose number the calibration does not state.
const UNKNOWN_DOF: f64 = 1e3;

/// What an error of the shifts is worth as a displacement of the contact.
struct Contact {
    /// Of each loaded reading: its place, and G^+; none where no reading shows the groove.
    inverse: Vec<(usize, Matrix3x2<f64>)>,
    readings: usize,
}

impl Contact {
    /// `groove`: slopes of the stacked shifts by three displacements across each other.
    fn new(readings: &[Reading], groove: [DVector<f64>; 3]) -> Self {
        let n = readings.len();
        let slopes = |k: usize| Matrix2x3::from_fn(|c, j| groove[j][c * n + k]);
        let loaded: Vec<usize> = (0..n).filter(|k| !readings[*k].rest).collect();
        let largest = loaded.iter().map(|&k| slopes(k).norm()).fold(0.0, f64::max);
        let inverse = |&k: &usize| {
            let g = slopes(k).pseudo_inverse(UNSEEN * largest).ok()?;
            (g.norm() > 0.0).then_some((k, g))
        };
        Self {
            inverse: loaded.iter().filter_map(inverse).collect(),
            readings: n,
        }
    }

    fn unit(&self) -> &'static str {
        if self.inverse.is_empty() { "pm" } else { "mm" }
    }

    /// Root mean square of what `of` gives at the loaded readings; of pm at all where none shows the
    /// groove.
    fn rms(&self, of: impl Fn(&DMatrix<f64>, usize) -> f64) -> f64 {
        let squares: Vec<f64> = match self.inverse[..] {
            [] => (0..self.readings)
                .map(|k| of(&DMatrix::identity(2, 2), k).powi(2))
                .collect(),
            _ => (self.inverse.iter())
                .map(|(k, g)| of(&DMatrix::from_column_slice(3, 2, g.as_slice()), *k).powi(2))
                .collect(),
        };
        (squares.iter().sum::<f64>() / squares.len().max(1) as f64).sqrt()
    }

    /// Displacement that looks like `shifts`.
    fn cost(&self, shifts: &DVector<f64>) -> f64 {
        self.rms(|g, k| (g * Vector2::new(shifts[k], shifts[self.readings + k])).norm())
    }

    /// Standard deviation of the displacement under a covariance of the shifts.
    fn sd(&self, covariance: &DMatrix<f64>) -> f64 {
        self.rms(|g, k| {
            let at = [k, self.readings + k];
            let own = Matrix2::from_fn(|a, b| covariance[(at[a], at[b])]);
            (g * own * g.transpose()).trace().max(0.0).sqrt()
        })
    }
}
