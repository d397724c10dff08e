//! The whisker session as a system: pose -> rod -> moment -> memory -> wavelength, with effects at every stage.

use super::pictures::{Pictures, Seen};
use crate::effect::{Effect, EffectModel, EffectTerm, Need, Values};
use crate::measurement_model::MeasurementModel;
use crate::method::fit::{Fit, Weights};
use crate::whisker::effects;
use crate::whisker::path::{WhiskerPath, temperature_walk};
use crate::whisker::rod_tables::{RodParameters, RodTables};
use crate::whisker::temperature::RandomWalkModel;
use nalgebra::{DMatrix, DVector, Matrix2, Matrix3, Vector2, Vector3};
use std::sync::Arc;
use wcal_core::observation::{RestShape, WhiskerData, WhiskerRow};

/// Two moment components a reading, N mm.
pub type Moments = Vec<[f64; 2]>;

/// A sensor whose answer depends on what came before.
pub trait Memory: Send {
    /// What is sensed of a moment (N mm) `dt_s` after the one before, none at the first; nothing is remembered.
    fn sensed(&self, dt_s: Option<f64>, moment_nmm: [f64; 2]) -> [f64; 2];
    /// Remembers that moment.
    fn accept(&mut self, dt_s: Option<f64>, moment_nmm: [f64; 2]);
}

/// Who sees a change of the poses.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Observers {
    /// Where the groove really was: gratings and cameras.
    Both,
    /// Gratings alone: their readings are late.
    Gratings,
    /// Cameras alone: their pictures are late.
    Cameras,
}

/// Where an effect of the whisker acts; every hook does nothing by default.
pub trait WhiskerEffect: Effect {
    /// Who sees the poses that it changes: the gratings, the cameras, or both.
    fn observers(&self) -> Observers {
        Observers::Both
    }
    /// Changes the effective stage position of every node, mm.
    fn pose(&self, _values: &Values, _path: &WhiskerPath, _xs_mm: &mut [f64]) {}
    /// Changes the mechanics of wire, root and groove.
    fn rod(&self, _values: &Values, _rod: &mut RodParameters) {}
    /// What the gratings sense of moments that come one after the other; none where they sense them as they are.
    fn memory(&self, _values: &Values) -> Option<Box<dyn Memory>> {
        None
    }
    /// Changes the moments that the gratings sense at every node, N mm.
    fn sensor(&self, values: &Values, path: &WhiskerPath, moments_nmm: &mut [[f64; 2]]) {
        let Some(mut memory) = self.memory(values) else { return };
        let mut last_s = None;
        for (m, node) in moments_nmm.iter_mut().zip(&path.nodes) {
            let dt_s = last_s.map(|last| node.t_s - last);
            last_s = Some(node.t_s);
            let sensed = memory.sensed(dt_s, *m);
            memory.accept(dt_s, *m);
            *m = sensed;
        }
    }
    /// Changes what pairs of pictures show: faults of the cameras' setup.
    fn pictures(&self, _values: &Values, _seen: &mut [Seen]) {}
    /// Appends readout columns (one value a reading) whose coefficients are free in each channel.
    fn columns(
        &self,
        _values: &Values,
        _path: &WhiskerPath,
        _moments_nmm: &[[f64; 2]],
        _out: &mut Vec<Vec<f64>>,
    ) {
    }
}

/// An effect that acts: its law and values.
pub struct ActiveEffect {
    /// The effect.
    pub effect: Arc<dyn WhiskerEffect>,
    law: EffectModel,
    term: EffectTerm,
}

impl ActiveEffect {
    /// `term` of a catalogue's effect.
    #[must_use]
    pub fn new(effect: Arc<dyn WhiskerEffect>, term: EffectTerm) -> Self {
        Self { law: effect.law(term.law), effect, term }
    }

    /// What its law needs of a session.
    #[must_use]
    pub fn needs(&self) -> &[Need] {
        &self.law.needs
    }

    /// Its place in the catalogue, law and values.
    #[must_use]
    pub fn into_term(self) -> EffectTerm {
        self.term
    }

    /// Physical ranges of its values.
    pub fn ranges(&self) -> impl Iterator<Item = [f64; 2]> {
        self.law.parameters.iter().map(|p| p.range)
    }

    /// Values of its parameters, by name.
    #[must_use]
    pub fn values(&self) -> Values<'_> {
        Values::new(&self.law, self.term.law, &self.term.values)
    }
}

/// A whisker session, its declared model and the catalogue.
#[derive(Clone)]
pub struct WhiskerSystem {
    /// The session.
    pub data: WhiskerData,
    /// The readings on their path.
    pub path: WhiskerPath,
    /// The rod's tables.
    pub rod_tables: Arc<RodTables>,
    effects: Vec<Arc<dyn WhiskerEffect>>,
    catalogue: Vec<Arc<dyn Effect>>,
    measured: DMatrix<f64>,
    known: DMatrix<f64>,
    groups: Vec<u32>,
    rows: Arc<Vec<WhiskerRow>>,
    sealed: Vec<bool>,
    scored: Vec<bool>,
    seatings: u32,
    walk: Option<RandomWalkModel>,
    whitening: Matrix2<f64>,
    pictures: Option<Arc<Pictures>>,
    picture_scale: f64,
}

/// Points of the loaded wire at arc lengths, mm: cubic in between its nodes, whose tangents are known.
fn points_at(nodes: &[(f64, Vector3<f64>, Matrix3<f64>)], arclengths_mm: &[f64]) -> Vec<Vector3<f64>> {
    let at = |s: &f64| {
        let j = nodes.partition_point(|n| n.0 <= *s).clamp(1, nodes.len() - 1);
        let (a, b) = (&nodes[j - 1], &nodes[j]);
        let h = b.0 - a.0;
        if h <= 0.0 {
            return b.1;
        }
        let x = (s - a.0) / h;
        let (x2, x3) = (x * x, x * x * x);
        a.1 * (2.0 * x3 - 3.0 * x2 + 1.0)
            + a.2.column(0) * (h * (x3 - 2.0 * x2 + x))
            + b.1 * (3.0 * x2 - 2.0 * x3)
            + b.2.column(0) * (h * (x3 - x2))
    };
    arclengths_mm.iter().map(at).collect()
}

/// Rate of the temperature at each reading, deg C/s, over the readings on both sides of it.
fn rates(readings: &[crate::whisker::path::Reading]) -> Vec<f64> {
    const SIDE: usize = 3;
    (0..readings.len())
        .map(|i| {
            let (a, b) = (i.saturating_sub(SIDE), (i + SIDE).min(readings.len() - 1));
            let dt_s = readings[b].t_s - readings[a].t_s;
            let rise = readings[b].temperature_loo_degc - readings[a].temperature_loo_degc;
            if dt_s > 0.0 { rise / dt_s } else { 0.0 }
        })
        .collect()
}

/// Density of air, kg/m^3.
pub(crate) const AIR_KG_M3: f64 = 1.2;

/// Density of the medium, kg/m^3.
fn fluid_kg_m3(medium: &str) -> f64 {
    match medium {
        "water" => 998.2,
        _ => AIR_KG_M3,
    }
}

fn owned(rows: &[&WhiskerRow]) -> Arc<Vec<WhiskerRow>> {
    Arc::new(rows.iter().map(|r| (*r).clone()).collect())
}

fn dynamic(m: &Matrix2<f64>) -> DMatrix<f64> {
    DMatrix::from_column_slice(2, 2, m.as_slice())
}

impl WhiskerSystem {
    /// System of the given rows (points, or points and sealed rows for prediction).
    ///
    /// # Errors
    /// Where the rest shape cannot be used.
    pub fn new(data: &WhiskerData, rows: &[&WhiskerRow]) -> Result<Self, wcal_rod::RodError> {
        // The sealed rows have no part in it, not even by their temperature.
        let walk = temperature_walk(&data.rows.iter().collect::<Vec<_>>(), &data.fbg);
        let path = Self::path(data, rows, walk);
        let rod_tables = RodTables::new(&data.whisker, fluid_kg_m3(&data.medium), &path)?;
        let rows = owned(rows);
        let pictures = Pictures::new(&rows, &path, data.shapes.as_ref()).map(Arc::new);
        let blank = Self::assemble(data, path, rows, walk, Arc::new(rod_tables), Matrix2::identity());
        Ok(Self { pictures, ..blank })
    }

    /// The same rod with other rows, none deeper than those that it was made for, and without pictures.
    #[must_use]
    pub fn with_rows(&self, rows: &[&WhiskerRow]) -> Self {
        Self::assemble(
            &self.data,
            Self::path(&self.data, rows, self.walk),
            owned(rows),
            self.walk,
            self.rod_tables.clone(),
            self.whitening,
        )
    }

    fn path(data: &WhiskerData, rows: &[&WhiskerRow], walk: Option<RandomWalkModel>) -> WhiskerPath {
        let gravity = data.whisker.gravity_direction;
        WhiskerPath::new(rows, &data.trajectories, &data.moments, &data.fbg, gravity, walk.as_ref())
    }

    fn assemble(
        data: &WhiskerData,
        path: WhiskerPath,
        rows: Arc<Vec<WhiskerRow>>,
        walk: Option<RandomWalkModel>,
        rod_tables: Arc<RodTables>,
        whitening: Matrix2<f64>,
    ) -> Self {
        let effects = effects::whisker_catalogue();
        let catalogue = effects.iter().map(|e| e.clone() as Arc<dyn Effect>).collect();
        let n = path.readings.len();
        let shifts = DMatrix::from_fn(n, 2, |i, c| path.readings[i].shift_pm[c]);
        Self {
            pictures: None,
            picture_scale: 1.0,
            // Never singular: a unit matrix with one direction stretched.
            measured: shifts * dynamic(&whitening.try_inverse().unwrap_or_else(Matrix2::identity)),
            whitening,
            known: DMatrix::from_fn(n, 2, |i, c| path.readings[i].sample_sd_pm[c]),
            groups: path.readings.iter().map(|r| r.group).collect(),
            // Unsealed rows stand behind those of the points table.
            sealed: path.rows.iter().map(|row| *row >= data.rows.len()).collect(),
            scored: path.readings.iter().map(|r| r.holdout).collect(),
            rows,
            seatings: data.rows.iter().map(|r| r.seating + 1).max().unwrap_or(1),
            data: data.clone(),
            walk,
            path,
            rod_tables,
            effects,
            catalogue,
        }
    }

    /// The effects of `terms` with their values by name.
    fn active(&self, terms: &[EffectTerm]) -> Vec<ActiveEffect> {
        terms.iter().map(|t| ActiveEffect::new(self.effects[t.effect].clone(), t.clone())).collect()
    }

    /// Why the session does not give what a law needs; none where it does.
    fn unmet(&self, need: Need) -> Option<&'static str> {
        let has = &self.path.columns;
        let moving = |p: &Arc<Pictures>| p.each().any(|(i, ..)| self.path.readings[i].velocity_mm_s != 0.0);
        match need {
            Need::Time | Need::Clock => (!has.time).then_some("the session has no time stamps"),
            Need::Temperature => (!has.temperature).then_some("the session has no temperature"),
            Need::Motion => (!has.speeds).then_some("no reading was taken while the stage moved"),
            Need::MovingBase => Some("the base does not move on the stage, so the fluid does not drag on it"),
            Need::Weight if !has.gravity => Some("the session does not give the direction of gravity"),
            Need::Weight => {
                let known = self.data.whisker.density_kg_m3.is_some();
                (!known).then_some("the session does not give the density of the wire")
            }
            Need::BothDirections => {
                (!has.both_directions).then_some("the session has no readings of both directions")
            }
            Need::Pictures => self
                .pictures
                .is_none()
                .then_some("the session has no pictures (shapes.json) that can be used"),
            Need::StraightArc => {
                let given = matches!(self.data.whisker.rest_shape, RestShape::StraightArc { .. });
                (!given).then_some("the session declares the wire's points, not a straight part and an arc")
            }
            Need::MovingPictures => {
                let none = !self.pictures.as_ref().is_some_and(moving);
                none.then_some("no pair of pictures was taken while the stage moved")
            }
            Need::Order | Need::Slope | Need::Covariate => None,
        }
    }

    /// Effective stage positions of the nodes, mm, and the rod, without what only `unseen` see.
    fn driven(&self, active: &[ActiveEffect], unseen: Observers) -> (Vec<f64>, RodParameters) {
        let mut xs: Vec<f64> = self.path.nodes.iter().map(|n| n.x_mm).collect();
        let mut rod_parameters = RodParameters::default();
        for a in active.iter().filter(|a| a.effect.observers() != unseen) {
            a.effect.pose(&a.values(), &self.path, &mut xs);
            a.effect.rod(&a.values(), &mut rod_parameters);
        }
        (xs, rod_parameters)
    }

    /// What the pairs would show under `terms`, in their order; none where the model has no solution.
    #[must_use]
    pub fn seen(&self, terms: &[EffectTerm]) -> Option<Vec<Seen>> {
        let Some(pictures) = &self.pictures else { return Some(Vec::new()) };
        let active = self.active(terms);
        let (xs, rod_parameters) = self.driven(&active, Observers::Gratings);
        let nodes = pictures.nodes();
        let held = self.rod_tables.contacts(&self.path.nodes, &xs, &rod_parameters, &nodes)?;
        let rod = self.rod_tables.rod(&rod_parameters)?;
        let mut seen = Vec::with_capacity(nodes.len());
        for ((node, e), (_, stations_mm, shown)) in nodes.iter().zip(held).zip(pictures.each()) {
            let l = self.path.nodes[*node].line?;
            let groove_mm = self.rod_tables.line(l, &rod_parameters).point(xs[*node]);
            seen.push(match e {
                Some(e) => Seen {
                    groove_mm,
                    arclength_mm: e.arclength_mm,
                    tangent: e.tangent,
                    stations_mm: points_at(&rod.loaded_shape(&e), stations_mm),
                    ..shown.clone()
                },
                // Before first touch the wire is where it rests.
                None => Seen {
                    groove_mm,
                    arclength_mm: self.rod_tables.touch(&rod, l, &rod_parameters).arclength_mm,
                    stations_mm: stations_mm.iter().map(|s| rod.shape.rest_point(*s)).collect(),
                    ..shown.clone()
                },
            });
        }
        for a in &active {
            a.effect.pictures(&a.values(), &mut seen);
        }
        Some(seen)
    }

    /// The pairs that count beside the wavelengths.
    #[must_use]
    pub fn pictures(&self) -> Option<&Pictures> {
        self.pictures.as_deref()
    }

    /// The same readings beside pictures whose stated standard deviation weighs as much as `sd` of a reading, in the engine's channels.
    #[must_use]
    pub fn with_picture_scale(mut self, sd: f64) -> Self {
        self.picture_scale = sd;
        self
    }

    /// The same readings beside pictures of which `share` of the stated own errors counts.
    #[must_use]
    pub fn with_own_share(mut self, share: f64) -> Self {
        self.pictures = self.pictures.map(|p| Arc::new(p.with_own_share(share)));
        self
    }

    /// What a stated standard deviation of the pictures weighs, in the engine's channels.
    #[must_use]
    pub fn picture_scale(&self) -> f64 {
        self.picture_scale
    }

    /// The same readings without the pictures.
    #[must_use]
    pub fn without_pictures(mut self) -> Self {
        self.pictures = None;
        self
    }

    /// Effective moments at the readings, N mm, memory included, and the base moments before it.
    #[must_use]
    pub fn moments(&self, terms: &[EffectTerm]) -> Option<(Moments, Moments)> {
        let path = &self.path;
        let active = self.active(terms);
        let (xs, rod_parameters) = self.driven(&active, Observers::Cameras);
        let base = self.rod_tables.moments(&path.nodes, &xs, &rod_parameters)?;
        let mut sensed = base.clone();
        for a in &active {
            a.effect.sensor(&a.values(), path, &mut sensed);
        }
        let pick = |all: &[[f64; 2]]| -> Vec<[f64; 2]> {
            path.nodes.iter().zip(all).filter(|(n, _)| n.reading.is_some()).map(|(_, m)| *m).collect()
        };
        Some((pick(&sensed), pick(&base)))
    }

    /// The same readings in channels whose noise is alike and apart, as far as `fit` shows it.
    ///
    /// Both gratings are compensated with one reference reading, so its noise, `k_T` times the temperature's, is in both: their covariance
    /// is `s^2 I + k_T k_T' s_T^2`. Across `k_T` nothing is shared, which gives `s`; the temperature's walk gives `s_T`. K, zero and every
    /// column have coefficients of their own in each channel, so a mixture of channels is the same model.
    #[must_use]
    pub fn whitened(self, fit: &Fit) -> Self {
        let whitening = self.shared_noise(fit).unwrap_or_else(Matrix2::identity);
        self.in_channels(whitening)
    }

    /// The same readings in other channels.
    fn in_channels(self, whitening: Matrix2<f64>) -> Self {
        let (pictures, picture_scale) = (self.pictures, self.picture_scale);
        let same = Self::assemble(&self.data, self.path, self.rows, self.walk, self.rod_tables, whitening);
        Self { pictures, picture_scale, ..same }
    }

    /// Mixture that gives the gratings' noise from noise that is alike and apart, pm; none where no reference noise is shared.
    fn shared_noise(&self, fit: &Fit) -> Option<Matrix2<f64>> {
        let compensated =
            self.data.fbg.needs_reference() && self.data.rows.iter().all(|r| r.reference_shift_pm.is_some());
        let k = Vector2::from(self.data.fbg.temperature_pm_per_degc.filter(|_| compensated)?);
        let along = k.try_normalize(0.0)?;
        let across = Vector2::new(-along[1], along[0]);
        let own = (&fit.residual * across).norm_squared() / (0.5 * fit.readings_dof()).max(1.0);
        let shared = k.norm_squared() * self.walk?.noise_sd().powi(2);
        let stretch = (1.0 + shared / own).sqrt();
        stretch.is_finite().then(|| Matrix2::identity() + along * along.transpose() * (stretch - 1.0))
    }

    /// The same readings in the channels of `other`, its pictures weighed alike.
    #[must_use]
    pub fn with_whitening_of(self, other: &Self) -> Self {
        let share = other.pictures.as_ref().map_or(1.0, |p| p.own_share());
        self.in_channels(other.whitening).with_picture_scale(other.picture_scale).with_own_share(share)
    }

    /// How far apart two systems' mixtures of channels are: largest ratio of their shared noise.
    #[must_use]
    pub fn whitening_change(&self, other: &Self) -> f64 {
        let (a, b) = (self.whitening.determinant(), other.whitening.determinant());
        (a / b).max(b / a)
    }

    /// Standard deviation of one compensated shift under `fit`, pm: mean of both gratings.
    #[must_use]
    pub fn noise_sd_pm(&self, fit: &Fit) -> f64 {
        (fit.variance() * self.whitening.norm_squared() / 2.0).sqrt()
    }

    /// From the noise in the engine's channels to that of a compensated shift, pm: mean of both gratings.
    #[must_use]
    pub fn noise_factor(&self) -> f64 {
        (self.whitening.norm_squared() / 2.0).sqrt()
    }

    /// Seatings in the points table.
    #[must_use]
    pub fn seatings(&self) -> u32 {
        self.seatings
    }

    /// The row of a reading.
    #[must_use]
    pub fn row(&self, reading: usize) -> &WhiskerRow {
        &self.rows[self.path.rows[reading]]
    }

    /// Readings whose rows were sealed, and those of them that count in the held-out error.
    #[must_use]
    pub fn held_out(&self) -> [&[bool]; 2] {
        [&self.sealed, &self.scored]
    }

    /// The effects with their hooks.
    #[must_use]
    pub fn effects(&self) -> &[Arc<dyn WhiskerEffect>] {
        &self.effects
    }
}

impl MeasurementModel for WhiskerSystem {
    fn channels_pm(&self) -> DMatrix<f64> {
        dynamic(&self.whitening)
    }

    fn measured(&self) -> &DMatrix<f64> {
        &self.measured
    }

    fn design(&self, terms: &[EffectTerm]) -> Option<DMatrix<f64>> {
        let (sensed, _) = self.moments(terms)?;
        let mut columns = vec![
            vec![1.0; sensed.len()],
            sensed.iter().map(|m| m[0]).collect(),
            sensed.iter().map(|m| m[1]).collect(),
        ];
        columns.extend(self.path.seating_columns(self.seatings));
        for a in self.active(terms) {
            a.effect.columns(&a.values(), &self.path, &sensed, &mut columns);
        }
        let design = DMatrix::from_fn(sensed.len(), columns.len(), |i, j| columns[j][i]);
        design.iter().all(|v| v.is_finite()).then_some(design)
    }

    fn witness(&self, terms: &[EffectTerm], weights: &Weights) -> Option<DVector<f64>> {
        let Some(pictures) = &self.pictures else { return Some(DVector::zeros(0)) };
        let seen = self.seen(terms)?;
        let w = pictures.whitened(&seen, |i| weights.counts(i)) * self.picture_scale;
        w.iter().all(|v| v.is_finite()).then_some(w)
    }

    fn witness_readings(&self) -> Arc<Vec<usize>> {
        self.pictures.as_ref().map_or_else(Arc::default, |p| p.readings())
    }

    fn witness_variance(&self) -> f64 {
        self.picture_scale.powi(2)
    }

    fn catalogue(&self) -> &[Arc<dyn Effect>] {
        &self.catalogue
    }

    fn not_observable(&self, effect: usize) -> Option<String> {
        let needs = self.effects[effect].needs();
        needs.into_iter().find_map(|need| self.unmet(need)).map(str::to_owned)
    }

    fn groups(&self) -> &[u32] {
        &self.groups
    }

    fn covariates(&self) -> Vec<(String, Vec<f64>)> {
        let r = &self.path.readings;
        let column =
            |f: &dyn Fn(&crate::whisker::path::Reading) -> f64| r.iter().map(f).collect::<Vec<f64>>();
        let mut out = vec![("stage_mm".to_owned(), column(&|r| r.x_mm))];
        if let Some((sensed, _)) = self.moments(&[]) {
            out.push(("moment_1_nmm".to_owned(), sensed.iter().map(|m| m[0]).collect()));
            out.push(("moment_2_nmm".to_owned(), sensed.iter().map(|m| m[1]).collect()));
            out.push(("moment_nmm".to_owned(), sensed.iter().map(|m| m[0].hypot(m[1])).collect()));
        }
        out.push(("trajectory".to_owned(), column(&|r| f64::from(r.group))));
        out.push(("order".to_owned(), (0..r.len()).map(|k| k as f64).collect()));
        if self.path.columns.time {
            out.push(("t_s".to_owned(), column(&|r| r.t_s)));
            out.push(("dwell_s".to_owned(), column(&|r| r.dwell_s)));
        }
        if self.path.columns.temperature {
            out.push(("temperature_degc".to_owned(), column(&|r| r.temperature_loo_degc)));
            if self.path.columns.time {
                out.push(("temperature_rate_degc_s".to_owned(), rates(r)));
            }
        }
        if self.path.columns.both_directions {
            out.push(("direction".to_owned(), column(&|r| if r.rest { 0.0 } else { r.direction })));
        }
        if self.path.columns.speeds {
            out.push(("speed_mm_s".to_owned(), column(&|r| r.velocity_mm_s)));
        }
        let arclength = |r: &crate::whisker::path::Reading| {
            r.line.filter(|_| !r.rest).and_then(|l| self.rod_tables.arclength_mm(l, r.x_mm)).unwrap_or(0.0)
        };
        out.push(("contact_arclength_mm".to_owned(), column(&arclength)));
        out
    }

    fn known_noise(&self) -> &DMatrix<f64> {
        &self.known
    }

    fn noise_inputs(&self) -> crate::method::noise::NoiseInputs {
        super::noise::noise_inputs(&self.data, &self.path)
    }
}
