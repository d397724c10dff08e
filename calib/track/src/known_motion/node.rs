//! One node of the grid: a Gaussian in all that is not the arc length, updated reading by reading
//! (equations in [`super::recursive`]).
//!
//! ```text
//! contact     (P_k - P_0) . u > 0,   else the wire is free and m = 0
//! window      m = m(P + (d' - d) u),   d' = d Phi(d / w) + w phi(d / w)         mean depth over the window of the moments, its free part as none
//! friction    s_c(k) = clamp(s_c(k-1), s(P_k, -mu), s(P_k, +mu))               stick, then slip: a play operator
//! ```
//!
//! Source of the play operator: M. A. Krasnosel'skii, A. V. Pokrovskii, "Systems with Hysteresis",
//! 1989.

use super::contact_path::{ACROSS, State};
use super::episode::{CorrelatedNoise, LN_ANYTHING, MotionRow, Settings, TABLE_MM, TABLE_SHARE};
use super::field::{ContactMoments, MomentField};
use super::posterior::Creep;
use crate::arc_posterior::{ln_sum, normal_share};
use crate::reading::squares;
use nalgebra::{DMatrix, DVector, Matrix2, Matrix2x3, Matrix2xX, Rotation3, Vector2, Vector3};

/// Longest step over which stick and slip are integrated, mm.
const PLAY_MM: f64 = 0.25;
/// Standard deviation of noisy outliers in units of the noise.
const NOISY: f64 = 10.0;
/// Least inverse variance of a reading in units of that of its noise: a certain outlier has no
/// weight.
const NO_WEIGHT: f64 = 1e-9;
/// Onset and gap at which an iteration has settled, mm.
const SETTLED_MM: f64 = 0.01;
/// Iterations of an update; more at the first reading, before which the onset is not known.
const ITERATIONS: usize = 3;
const FIRST_ITERATIONS: usize = 12;
/// Halvings of a step that leads out of the wire's reach.
const SHORTENED: i32 = 4;
/// A reading so many standard deviations from first touch is on one side of it, and bounds so far
/// from each other say something new, mm.
const NEAR_SDS: f64 = 4.0;
const BOUND_STEP_MM: f64 = 0.1;
/// Trial depths at the first reading, mm, each twice the one before.
const FIRST_DEPTH_MM: f64 = 0.05;
const TRIALS: usize = 9;
/// Place of onset and gap in the state; the common unknowns come after them.
const ONSET: usize = 0;
const GAP: usize = 1;
pub(super) const COMMON: usize = 2;

/// A reading as every node sees it.
pub(super) struct Reading<'a> {
    pub field: &'a MomentField,
    pub settings: &'a Settings,
    pub push: Vector3<f64>,
    pub row: &'a MotionRow,
    /// Motion since the reference: `P_k = turn P + displacement`, mm.
    pub turn: Rotation3<f64>,
    pub displacement_mm: Vector3<f64>,
    /// Correlation rho of the correlated noise with that of the reading before.
    pub correlation: f64,
    /// Loaded beyond its noise: the wire is held.
    pub loaded: bool,
    /// The contact was left since the reading before: friction remembers nothing.
    pub touched_anew: bool,
}

impl<'a> Reading<'a> {
    /// A reading after another one, whose displacements along the push count from the reference.
    pub(super) fn new(
        (field, settings): (&'a MomentField, &'a Settings),
        (push, reference): (Vector3<f64>, &MotionRow),
        before: &MotionRow,
        row: &'a MotionRow,
    ) -> Self {
        let (turn, displacement_mm) = row.since(reference);
        let moved = |row: &MotionRow| row.displacement_mm(reference, &field.middle_mm());
        let correlation = |c: CorrelatedNoise| {
            c.correlation((moved(row) - moved(before)).norm(), row.t_s - before.t_s)
        };
        Self {
            field,
            settings,
            push,
            row,
            turn,
            displacement_mm,
            correlation: settings.correlated.map_or(0.0, correlation),
            loaded: settings.is_loaded(row),
            touched_anew: row.contact_segment != before.contact_segment,
        }
    }

    /// Standard deviation along the push of the places within the reading's window, mm.
    fn window_mm(&self) -> f64 {
        self.row.velocity_mm_s.dot(&self.push).abs() * self.settings.window_sd_s
    }

    /// Mean depth over the reading's window, the free part as none, from that of its mean place, mm,
    /// and its slope.
    fn mean_depth_mm(&self, depth_mm: f64) -> (f64, f64) {
        let window_mm = self.window_mm();
        if window_mm <= 0.0 || depth_mm > NEAR_SDS * window_mm {
            return (depth_mm, 1.0);
        }
        // Near first touch the moment goes with the depth past it; of a Gaussian depth the mean of
        // its positive part.
        let z = depth_mm / window_mm;
        let (share, density) = (normal_share(z), normal_density(z));
        (depth_mm * share + window_mm * density, share)
    }

    /// Place of the two unknowns of a creeping contact in the state, and how far one standard
    /// deviation of each moves the point, mm.
    fn creep(&self) -> Option<(usize, [Vector3<f64>; 2])> {
        // The two shares of a creeping point are the last of the common unknowns.
        let [.., a, b] = self.row.shared_displacement_mm[..] else {
            return None;
        };
        (self.settings.creep_sd > 0.0).then_some((COMMON + self.row.shared_nmm.len() - 2, [a, b]))
    }
}

/// Gaussian of (x, g, c, tau, b) given the arc length; while the lead is taken, b at the first
/// loaded reading stands after it.
#[derive(Debug, Clone)]
pub(super) struct NodeFilter {
    pub s_mm: f64,
    wire_mm: Vector3<f64>,
    across: Vector3<f64>,
    mean: DVector<f64>,
    covariance: DMatrix<f64>,
    /// Logarithm of the probability per arc length, not normalised.
    pub ln: f64,
    /// The same with the last reading taken as a regular one: where all nodes take it for an
    /// outlier, it says which is nearest to explaining it.
    pub regular_ln: f64,
    /// Chi-squared of the innovations so far: every reading as regular, and with the larger noise
    /// of the outliers.
    pub chi2: [f64; 2],
    /// Readings that were outliers, by probability; and that of the last.
    pub outlier: f64,
    pub last_outlier: f64,
    /// Displacement along the push at which a reading bounded the onset last, mm.
    bounded_mm: Option<f64>,
    /// Contact's arc length and place at the reading before, where the wire was held: friction
    /// remembers them.
    contact: Option<(f64, Vector3<f64>)>,
}

/// The reading linearised at a state.
pub(super) struct Linearised {
    state: DVector<f64>,
    /// m(P), N mm.
    pub moment_nmm: Vector2<f64>,
    /// dy/dz.
    pub slope: Matrix2xX<f64>,
    /// Covariance of the reading's own noise, (N mm)^2, and of b where it has gone on for long.
    pub own: Matrix2<f64>,
    correlated: Matrix2<f64>,
    pub contact: Option<(f64, Vector3<f64>)>,
}

/// Variance along the push of what is not known of a reading's motion, its window included, mm^2.
fn moved_mm2(reading: &Reading<'_>) -> f64 {
    // An offset of the clock moves the point along the push by (v . u) times it.
    let clock_mm = reading.row.velocity_mm_s.dot(&reading.push) * reading.settings.clock_sd_s;
    reading.row.moved_sd_mm.powi(2) + clock_mm * clock_mm + reading.window_mm().powi(2)
}

fn normal_density(z: f64) -> f64 {
    (-0.5 * z * z).exp() / std::f64::consts::TAU.sqrt()
}

fn ln_normal(squared: f64, determinant: f64) -> f64 {
    // ln N(i; 0, S) in two dimensions, from i' S^-1 i and |S|.
    -0.5 * (squared + determinant.max(1e-300).ln()) - std::f64::consts::TAU.ln()
}

/// Expected inverse variance of a reading in units of that of its noise, and the logarithm of its
/// density, from the logarithms of its three parts (regular, noisy, anything).
fn inverse_variance(parts: &[f64; 3]) -> (f64, f64) {
    let ln = ln_sum(parts);
    let weight = (parts[0] - ln).exp() + (parts[1] - ln).exp() / (NOISY * NOISY);
    (weight.max(NO_WEIGHT), ln)
}

impl NodeFilter {
    /// Before any reading; none where the push runs along the wire. `range_mm`: width of the
    /// uniform prior of the onset.
    pub(crate) fn new(reading: &Reading<'_>, s_mm: f64, range_mm: f64) -> Option<Self> {
        let settings = reading.settings;
        let common = reading.row.shared_nmm.len();
        let size = COMMON + common + 1 + if settings.correlated.is_some() { 2 } else { 0 };
        // The prior: a uniform onset by its variance L^2 / 12, the gap, unit unknowns, the clock.
        let mut covariance = DMatrix::identity(size, size);
        covariance[(ONSET, ONSET)] = range_mm * range_mm / 12.0;
        covariance[(GAP, GAP)] = settings.gap_sd_mm.powi(2);
        covariance[(COMMON + common, COMMON + common)] = settings.clock_sd_s.powi(2);
        let (wire_mm, tangent) = reading.field.free(s_mm);
        Some(Self {
            s_mm,
            wire_mm,
            across: tangent.cross(&reading.push).try_normalize(ACROSS)?,
            mean: DVector::zeros(size),
            covariance,
            ln: 0.0,
            regular_ln: 0.0,
            chi2: [0.0; 2],
            outlier: 0.0,
            last_outlier: 0.0,
            bounded_mm: None,
            contact: None,
        })
    }

    /// The first loaded reading: the onset that explains it best starts the iteration and is the
    /// middle of its prior.
    pub(crate) fn start(&mut self, reading: &Reading<'_>) {
        let y = Vector2::from(reading.row.moment_nmm);
        // A depth of the right order is enough: the iteration goes on from there.
        let trials = (0..TRIALS)
            .map(|k| FIRST_DEPTH_MM * f64::from(1 << k))
            .filter_map(|depth| {
                let place = self.wire_mm + reading.push * depth;
                let (held, _) = reading.field.held_and_rate(&place, 0.0)?;
                Some((depth, (Vector2::from(held.moment_nmm) - y).norm()))
            });
        let best = trials.min_by(|a, b| a.1.total_cmp(&b.1));
        // Displacements count from this reading: a depth d here means first touch at x = -d.
        self.mean[ONSET] = -best.map_or(FIRST_DEPTH_MM, |b| b.0);
        self.take(reading, FIRST_ITERATIONS, true);
        // A loaded wire is held: the onset lies before this reading.
        let past = self.depth_mm(reading);
        self.bound_onset(-1.0, past, moved_mm2(reading));
    }

    /// A further reading. One that may or may not be past first touch is taken both ways, and the
    /// two Gaussians are joined.
    pub(crate) fn update(&mut self, reading: &Reading<'_>) {
        let depth_mm = self.depth_mm(reading);
        let blur_mm2 = moved_mm2(reading);
        let near_mm = NEAR_SDS * (self.covariance[(ONSET, ONSET)] + blur_mm2).sqrt();
        // Its load, or a distance of 4 sd from first touch, says on which side of it a reading is.
        let is_sure = reading.row.free || reading.loaded || depth_mm.abs() > near_mm;
        // Readings of one pose bound the onset once.
        let is_near = |at: f64| (at - depth_mm - self.mean[ONSET]).abs() < BOUND_STEP_MM;
        if is_sure || self.bounded_mm.is_some_and(is_near) {
            let held = !reading.row.free && (reading.loaded || depth_mm > 0.0);
            return self.take(reading, ITERATIONS, held);
        }
        let mut held = self.clone();
        held.bound_onset(-1.0, depth_mm, blur_mm2);
        held.take(reading, ITERATIONS, true);
        self.bounded_mm = Some(depth_mm + self.mean[ONSET]);
        self.bound_onset(1.0, -depth_mm, blur_mm2);
        self.take(reading, ITERATIONS, false);
        self.join(held);
    }

    /// The mixture of this Gaussian and another as one of the same mean and covariance.
    fn join(&mut self, other: Self) {
        // Moments of a mixture of two: mean, and covariance with the spread of the means.
        let ln = ln_sum(&[self.ln, other.ln]);
        let [a, b] = [self.ln, other.ln].map(|l| (l - ln).exp());
        let off = &other.mean - &self.mean;
        self.covariance =
            &self.covariance * a + &other.covariance * b + &off * off.transpose() * (a * b);
        self.mean += off * b;
        self.ln = ln;
        self.regular_ln = self.regular_ln.max(other.regular_ln);
        self.chi2 = [0, 1].map(|k| a * self.chi2[k] + b * other.chi2[k]);
        self.outlier = a * self.outlier + b * other.outlier;
        self.last_outlier = a * self.last_outlier + b * other.last_outlier;
        // Stick and slip have no mean of two branches: the likelier one's contact is remembered.
        if b > a {
            self.contact = other.contact;
        }
    }

    /// Readings linearised at one state, the contact carried from each to the next; none where the
    /// wire has no equilibrium.
    pub(crate) fn along(readings: &[Reading<'_>], state: &State) -> Option<Vec<Linearised>> {
        let mut node = Self::new(readings.first()?, state.s_mm, 0.0)?;
        (node.mean[ONSET], node.mean[GAP]) = (state.onset_mm, state.gap_mm);
        let one = |reading: &Reading<'_>| {
            let held = !reading.row.free && node.depth_mm(reading) > 0.0;
            let found = node.linearised(reading, &node.mean, held)?;
            node.contact = found.contact;
            Some(found)
        };
        readings.iter().map(one).collect()
    }

    /// State of the contact with its covariance.
    pub(crate) fn state(&self) -> (State, Matrix2<f64>) {
        let state = State {
            s_mm: self.s_mm,
            onset_mm: self.mean[ONSET],
            gap_mm: self.mean[GAP],
        };
        (state, self.covariance.fixed_view::<2, 2>(0, 0).into())
    }

    /// The last two of `common + 2` common unknowns, those of a creeping contact.
    pub(crate) fn creep(&self, common: usize) -> Creep {
        let at = COMMON + common;
        Creep {
            mean: self.mean.fixed_rows::<2>(at).into(),
            covariance: self.covariance.fixed_view::<2, 2>(at, at).into(),
            with_state: self.covariance.fixed_view::<2, 2>(0, at).into(),
        }
    }

    /// Displacement along the push past first touch at the mean, mm.
    pub(crate) fn depth_mm(&self, reading: &Reading<'_>) -> f64 {
        // The point goes along the push; it holds the wire from first touch on.
        (self.place_mm(reading, &self.mean) - self.touch_mm(&self.mean)).dot(&reading.push)
    }

    fn touch_mm(&self, z: &DVector<f64>) -> Vector3<f64> {
        self.wire_mm + self.across * z[GAP]
    }

    fn place_mm(&self, reading: &Reading<'_>, z: &DVector<f64>) -> Vector3<f64> {
        let crept = reading.creep().map_or_else(Vector3::zeros, |(at, way)| {
            way[0] * z[at] + way[1] * z[at + 1]
        });
        reading.turn * (self.touch_mm(z) - reading.push * z[ONSET])
            + reading.displacement_mm
            + crept
    }

    /// Moments, slope and contact of the held wire; none where it has no equilibrium.
    fn held(
        &self,
        reading: &Reading<'_>,
        place: &Vector3<f64>,
        touch: &Vector3<f64>,
    ) -> Option<(ContactMoments, Matrix2x3<f64>)> {
        let (free, rate) = reading.field.held_and_rate(place, 0.0)?;
        let mu = reading.field.friction();
        if mu.coefficient <= 0.0 {
            return Some((free, rate));
        }
        // Stick and slip from the reading before, or from first touch; the slope is that without
        // friction.
        let depth = (place - touch).dot(&reading.push);
        let start = (self.s_mm, place - reading.push * (depth - depth.min(1e-3)));
        let (mut s, from) = self
            .contact
            .filter(|_| !reading.touched_anew)
            .unwrap_or(start);
        // Kinetic friction while the object moves, static friction at standstill.
        let moving = reading.row.velocity_mm_s.norm() > 0.0;
        let friction = mu.coefficient * if moving { mu.moving_share } else { 1.0 };
        // Friction depends on the path and not only on its end: long ways go in short steps.
        let steps = ((place - from).norm() / PLAY_MM).ceil().max(1.0) as usize;
        let mut held = None;
        for n in 1..=steps {
            let at = from + (place - from) * (n as f64 / steps as f64);
            held = Some(play(reading.field, &at, friction, &mut s)?);
        }
        Some((held?, rate))
    }

    /// With the wire held, or free.
    fn linearised(
        &self,
        reading: &Reading<'_>,
        z: &DVector<f64>,
        held: bool,
    ) -> Option<Linearised> {
        let Reading {
            field,
            settings,
            row,
            ..
        } = reading;
        let common = row.shared_nmm.len();
        let mut slope = Matrix2xX::zeros(z.len());
        for (j, h) in row.shared_nmm.iter().enumerate() {
            slope.set_column(COMMON + j, &Vector2::from(*h));
        }
        if let Some(noise) = &settings.correlated {
            slope
                .fixed_columns_mut::<2>(COMMON + common + 1)
                .copy_from(&noise.factor(row)?);
        }
        let (place, touch) = (self.place_mm(reading, z), self.touch_mm(z));
        let mut found = Linearised {
            state: z.clone(),
            moment_nmm: Vector2::zeros(),
            slope,
            own: settings
                .correlated
                .map_or(row.noise_nmm2, |c| c.own_nmm2(row)),
            correlated: settings.correlated.map_or(Matrix2::zeros(), |c| c.draw()),
            contact: None,
        };
        if !held {
            return Some(found);
        }
        let depth_mm = (place - touch).dot(&reading.push);
        let (mean_mm, share) = reading.mean_depth_mm(depth_mm);
        let place = place + reading.push * (mean_mm - depth_mm);
        let (held, rate) = self.held(reading, &place, &touch)?;
        let rate = rate * share;
        found.moment_nmm = Vector2::from(held.moment_nmm);
        found.contact = Some((held.arclength_mm, place));
        let slope = &mut found.slope;
        // dP/dx = -Q u and dP/dg = Q n, by the definition of the place.
        slope.set_column(ONSET, &(rate * (reading.turn * -reading.push)));
        slope.set_column(GAP, &(rate * (reading.turn * self.across)));
        // The last common unknown but for those of a creeping point.
        if settings.stiffness_sd > 0.0 {
            let at = COMMON + common - 1 - if settings.creep_sd > 0.0 { 2 } else { 0 };
            slope.set_column(at, &(found.moment_nmm * settings.stiffness_sd));
        }
        // Errors of the displacement enter through dm/dP.
        for (j, way) in row.shared_displacement_mm.iter().enumerate() {
            let mut column = slope.column_mut(COMMON + j);
            column += rate * way;
        }
        for (j, changed) in field.changed.iter().enumerate() {
            // Without friction: its change by another coefficient is what it is at the edge of the
            // cone at most.
            if let Some((there, here)) = changed.held(&place, 0.0).zip(field.held(&place, 0.0)) {
                let mut column = slope.column_mut(COMMON + j);
                column += Vector2::from(there.moment_nmm) - Vector2::from(here.moment_nmm);
            }
        }
        // An offset tau of the clock moves the point by v tau.
        slope.set_column(COMMON + common, &(rate * row.velocity_mm_s));
        // Motion and table; where readings of one pose share a draw of the noise, they share these
        // too.
        let size2 = squares(&[row.moment_nmm]);
        let by_pose = rate * rate.transpose() * (row.moved_sd_mm.powi(2) + TABLE_MM.powi(2))
            + Matrix2::identity() * TABLE_SHARE.powi(2) * size2;
        match settings.correlated {
            Some(CorrelatedNoise::ByPose { .. }) => found.correlated += by_pose,
            _ => found.own += by_pose,
        }
        Some(found)
    }

    /// b_k = rho b_(k-1) + noise of covariance (1 - rho^2) B.
    fn carry_correlated(&mut self, reading: &Reading<'_>, correlated: &Matrix2<f64>) {
        if reading.settings.correlated.is_none() {
            return;
        }
        let (rho, at) = (
            reading.correlation,
            COMMON + reading.row.shared_nmm.len() + 1,
        );
        self.mean.rows_mut(at, 2).scale_mut(rho);
        self.covariance.rows_mut(at, 2).scale_mut(rho);
        self.covariance.columns_mut(at, 2).scale_mut(rho);
        // A first-order Gauss-Markov process keeps its variance: what is forgotten is drawn anew.
        let mut block = self.covariance.fixed_view_mut::<2, 2>(at, at);
        block += correlated * (1.0 - rho * rho);
    }

    /// Takes a reading with the wire held, or free. Where the wire has no equilibrium, or the
    /// numbers have none, nothing is left of the node.
    fn take(&mut self, reading: &Reading<'_>, iterations: usize, held: bool) {
        if self.iterate(reading, iterations, held).is_none() {
            (self.ln, self.regular_ln) = (f64::NEG_INFINITY, f64::NEG_INFINITY);
        }
    }

    /// Iterated Kalman update with the mixture of regular readings, noisy ones, and such that are
    /// anything.
    fn iterate(&mut self, reading: &Reading<'_>, iterations: usize, held: bool) -> Option<()> {
        let mut at = self.linearised(reading, &self.mean, held)?;
        self.carry_correlated(reading, &at.correlated);
        let (before, y) = (self.mean.clone(), Vector2::from(reading.row.moment_nmm));
        let mut z = before.clone();
        let share = reading.settings.gross_share;
        let ln_share = share.max(1e-300).ln();
        let creep = reading.creep().map(|(at, _)| at);
        let draw = COMMON + reading.row.shared_nmm.len() + 1;
        for n in 1..=iterations {
            // Innovation at the prior mean by the slope at the present one; what moves the point
            // (onset, gap, creep) acts on more than a line.
            let of_pair = |k: usize| at.slope.fixed_columns::<2>(k) * z.fixed_rows::<2>(k);
            let innovation = y - at.moment_nmm - &at.slope * &before
                + of_pair(ONSET)
                + creep.map_or_else(Vector2::zeros, of_pair);
            let to_state = &at.slope * &self.covariance;
            // All of the reading's noise, the correlated part included: what an outlier has more
            // of.
            let noise = match reading.settings.correlated {
                Some(_) => {
                    let factor = at.slope.fixed_columns::<2>(draw);
                    at.own + factor * at.correlated * factor.transpose()
                }
                None => at.own,
            };
            let regular = &to_state * at.slope.transpose() + at.own;
            let noisy = regular + noise * (NOISY * NOISY - 1.0);
            // Mahalanobis distances of the innovation as a regular reading and as a noisy one.
            let squared = |s: &Matrix2<f64>| Some(innovation.dot(&(s.try_inverse()? * innovation)));
            let mut parts = [
                (1.0 - share).ln() + ln_normal(squared(&regular)?, regular.determinant()),
                ln_share + ln_normal(squared(&noisy)?, noisy.determinant()),
                f64::NEG_INFINITY,
            ];
            let used = |weight: f64| regular + noise * (1.0 / weight - 1.0);
            // A step by the other two alone: where the slope is still that of a distant state, a
            // regular reading looks like anything.
            let gain = to_state.transpose() * used(inverse_variance(&parts).0).try_inverse()?;
            let next = &before + gain * innovation;
            let step = (next.fixed_rows::<2>(0) - z.fixed_rows::<2>(0)).norm();
            z = next;
            if n == iterations || step < SETTLED_MM {
                parts[2] = ln_share + LN_ANYTHING;
                let (weight, ln) = inverse_variance(&parts);
                let used = used(weight);
                let gain = to_state.transpose() * used.try_inverse()?;
                self.mean = before + &gain * innovation;
                self.covariance -= gain * to_state;
                self.regular_ln = self.ln + parts[0];
                self.ln += ln;
                self.chi2[0] += squared(&regular)?;
                self.chi2[1] += squared(&used)?;
                self.last_outlier = 1.0 - (parts[0] - ln).exp();
                self.outlier += self.last_outlier;
                self.contact = at.contact;
                return Some(());
            }
            // A step out of the wire's reach is shortened.
            let step = &z - &at.state;
            at = (0..SHORTENED).find_map(|k| {
                let z = &at.state + &step * 0.5_f64.powi(k);
                self.linearised(reading, &z, held)
            })?;
            z.copy_from(&at.state);
        }
        None
    }

    /// `p(x) <- p(x) Phi(past / w)`, `past = sign (x - x_k)`, moments matched (C. E. Rasmussen, C.
    /// K. I. Williams, "Gaussian Processes for Machine Learning", 2006, 3.9).
    fn bound_onset(&mut self, sign: f64, past_mm: f64, blur_mm2: f64) {
        let scale = (self.covariance[(ONSET, ONSET)] + blur_mm2).sqrt();
        let past = past_mm / scale;
        let share = normal_share(past).max(1e-300);
        self.ln += share.ln();
        // Ratio of density to probability; far outside its asymptote.
        let ratio = if past < -30.0 {
            -past
        } else {
            normal_density(past) / share
        };
        let column = self.covariance.column(ONSET).clone_owned() * (sign / scale);
        self.mean += &column * ratio;
        self.covariance -= &column * column.transpose() * (ratio * (ratio + past));
    }

    /// Before the lead, which goes back in time: b at the first loaded reading is kept beside the
    /// one that goes on.
    pub(crate) fn keep_correlated(&mut self) {
        let size = self.mean.len();
        self.rearrange(size + 2, |i| if i < size { i } else { i - 2 });
    }

    /// After the lead: forwards in time from the first loaded reading.
    pub(crate) fn resume_correlated(&mut self) {
        let size = self.mean.len() - 2;
        self.rearrange(size, |i| if i < size - 2 { i } else { i + 2 });
    }

    /// The state of unknowns in another order.
    fn rearrange(&mut self, size: usize, from: impl Fn(usize) -> usize) {
        self.mean = DVector::from_fn(size, |i, _| self.mean[from(i)]);
        self.covariance = DMatrix::from_fn(size, size, |i, j| self.covariance[(from(i), from(j))]);
    }
}

/// One step of the contact: it sticks up to the edge of the friction cone, then slips at it.
fn play(
    field: &MomentField,
    at: &Vector3<f64>,
    friction: f64,
    s_mm: &mut f64,
) -> Option<ContactMoments> {
    let here = field.at_place(at)?;
    // Arc lengths at both edges of the friction cone and without friction.
    let [low, free, high] =
        [-friction, 0.0, friction].map(|r| here.held(r).map(|h| h.arclength_mm));
    let (low, free, high) = (low?, free?, high?);
    *s_mm = s_mm.clamp(low.min(high), low.max(high));
    // Ratio of tangential to normal force whose equilibrium has this arc length, by regula falsi.
    let (mut a, mut b) = ((-friction, low - *s_mm), (friction, high - *s_mm));
    let mut ratio = 0.0;
    let mut value = free - *s_mm;
    for _ in 0..8 {
        if value.abs() < 1e-7 {
            break;
        }
        if (value > 0.0) == (a.1 > 0.0) {
            a = (ratio, value)
        } else {
            b = (ratio, value)
        }
        if (b.1 - a.1).abs() < 1e-12 {
            break;
        }
        ratio = a.0 - a.1 * (b.0 - a.0) / (b.1 - a.1);
        value = here.held(ratio)?.arclength_mm - *s_mm;
    }
    here.held(ratio)
}
