//! One node of the grid: a Gaussian in all that is not the arc length, updated reading by reading
//! (equations in [`super`]).

use crate::arc_posterior::normal_share;
use crate::known_motion::contact_path::{ACROSS, PLAY_MM, State, play};
use crate::known_motion::episode::{CorrelatedNoise, MotionRow, Settings, TABLE_MM, TABLE_SHARE};
use crate::known_motion::field::ContactMoments;
use crate::known_motion::field::MomentField;
use crate::known_motion::posterior::Creep;
use nalgebra::{DMatrix, DVector, Matrix2, Matrix2x3, Matrix2xX, Rotation3, Vector2, Vector3};

/// Standard deviation of noisy outliers in units of the noise.
const NOISY: f64 = 10.0;
/// Largest moment of a wire pressed near its root, N mm: outliers that are anything lie below.
const MAX_NMM: f64 = 3.0;
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
const COMMON: usize = 2;

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

impl Reading<'_> {
    /// Place of the two unknowns of a creeping contact in the state, and how far one standard
    /// deviation of each moves the point, mm.
    fn creep(&self) -> Option<(usize, [Vector3<f64>; 2])> {
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
struct Linearised {
    state: DVector<f64>,
    /// m(P), N mm.
    moment_nmm: Vector2<f64>,
    /// dy/dz.
    slope: Matrix2xX<f64>,
    /// Covariance of the reading's own noise, (N mm)^2, and of b where it has gone on for long.
    own: Matrix2<f64>,
    correlated: Matrix2<f64>,
    contact: Option<(f64, Vector3<f64>)>,
}

/// Variance along the push of what is not known of a reading's motion, mm^2.
fn moved_mm2(reading: &Reading<'_>) -> f64 {
    let clock_mm = reading.row.velocity_mm_s.dot(&reading.push) * reading.settings.clock_sd_s;
    reading.row.moved_sd_mm.powi(2) + clock_mm * clock_mm
}

fn ln_normal(squared: f64, determinant: f64) -> f64 {
    -0.5 * (squared + determinant.max(1e-300).ln()) - std::f64::consts::TAU.ln()
}

/// Expected inverse variance of a reading in units of that of its noise, and the logarithm of its
/// density, from the logarithms of its three parts (regular, noisy, anything).
fn inverse_variance(parts: &[f64; 3]) -> (f64, f64) {
    let largest = parts.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let ln = largest + parts.iter().map(|p| (p - largest).exp()).sum::<f64>().ln();
    let weight = (parts[0] - ln).exp() + (parts[1] - ln).exp() / (NOISY * NOISY);
    (weight.max(NO_WEIGHT), ln)
}

impl Linearised {
    /// Covariance that the correlated noise gives a reading, (N mm)^2.
    fn noise_of_draw(&self, reading: &Reading<'_>) -> Matrix2<f64> {
        if reading.settings.correlated.is_none() {
            return Matrix2::zeros();
        }
        let factor = self
            .slope
            .fixed_columns::<2>(COMMON + reading.row.shared_nmm.len() + 1);
        factor * self.correlated * factor.transpose()
    }
}

impl NodeFilter {
    /// Before any reading; none where the push runs along the wire. `range_mm`: width of the
    /// uniform prior of the onset.
    pub(crate) fn new(reading: &Reading<'_>, s_mm: f64, range_mm: f64) -> Option<Self> {
        let settings = reading.settings;
        let common = reading.row.shared_nmm.len();
        let size = COMMON + common + 1 + if settings.correlated.is_some() { 2 } else { 0 };
        let mut covariance = DMatrix::identity(size, size);
        covariance[(ONSET, ONSET)] = range_mm * range_mm / 12.0;
        covariance[(GAP, GAP)] = settings.gap_sd_mm.powi(2);
        covariance[(COMMON + common, COMMON + common)] = settings.clock_sd_s.powi(2);
        let mut node = Self {
            s_mm,
            wire_mm: Vector3::zeros(),
            across: Vector3::zeros(),
            mean: DVector::zeros(size),
            covariance,
            ln: 0.0,
            regular_ln: 0.0,
            chi2: [0.0; 2],
            outlier: 0.0,
            last_outlier: 0.0,
            bounded_mm: None,
            contact: None,
        };
        node.put(reading.field, &reading.push, s_mm)?;
        Some(node)
    }

    fn put(&mut self, field: &MomentField, push: &Vector3<f64>, s_mm: f64) -> Option<()> {
        let (wire, tangent) = field.free(s_mm);
        (self.s_mm, self.wire_mm) = (s_mm, wire);
        self.across = tangent.cross(push).try_normalize(ACROSS)?;
        Some(())
    }

    /// The first loaded reading: the onset that explains it best starts the iteration and is the
    /// middle of its prior.
    pub(crate) fn start(&mut self, reading: &Reading<'_>) {
        let y = Vector2::from(reading.row.moment_nmm);
        let trials = (0..TRIALS)
            .map(|k| FIRST_DEPTH_MM * f64::from(1 << k))
            .filter_map(|depth| {
                let place = self.wire_mm + reading.push * depth;
                let (held, _) = reading.field.held_and_rate(&place, 0.0)?;
                Some((depth, (Vector2::from(held.moment_nmm) - y).norm()))
            });
        let best = trials.min_by(|a, b| a.1.total_cmp(&b.1));
        self.mean[ONSET] = -best.map_or(FIRST_DEPTH_MM, |b| b.0);
        self.iterate(reading, FIRST_ITERATIONS, true);
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
        if reading.row.free || reading.loaded || depth_mm.abs() > near_mm {
            return self.iterate(
                reading,
                ITERATIONS,
                !reading.row.free && (reading.loaded || depth_mm > 0.0),
            );
        }
        // Readings of one pose bound the onset once.
        if self
            .bounded_mm
            .is_some_and(|at| (at - depth_mm - self.mean[ONSET]).abs() < BOUND_STEP_MM)
        {
            return self.iterate(reading, ITERATIONS, depth_mm > 0.0);
        }
        let mut held = self.clone();
        held.bound_onset(-1.0, depth_mm, blur_mm2);
        held.iterate(reading, ITERATIONS, true);
        self.bounded_mm = Some(depth_mm + self.mean[ONSET]);
        self.bound_onset(1.0, -depth_mm, blur_mm2);
        self.iterate(reading, ITERATIONS, false);
        self.join(held);
    }

    /// The mixture of this Gaussian and another as one of the same mean and covariance.
    fn join(&mut self, other: Self) {
        // Moments of a mixture of two: mean, and covariance with the spread of the means.
        let larger = self.ln.max(other.ln);
        let ln = larger + ((self.ln - larger).exp() + (other.ln - larger).exp()).ln();
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
        if b > a {
            self.contact = other.contact;
        }
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
        let share = if reading.row.velocity_mm_s.norm() > 0.0 {
            mu.moving_share
        } else {
            1.0
        };
        let steps = ((place - from).norm() / PLAY_MM).ceil().max(1.0) as usize;
        let mut held = None;
        for n in 1..=steps {
            let at = from + (place - from) * (n as f64 / steps as f64);
            held = Some(play(reading.field, &at, mu.coefficient * share, &mut s)?);
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
        let (held, rate) = self.held(reading, &place, &touch)?;
        found.moment_nmm = Vector2::from(held.moment_nmm);
        found.contact = Some((held.arclength_mm, place));
        found
            .slope
            .set_column(ONSET, &(rate * (reading.turn * -reading.push)));
        found
            .slope
            .set_column(GAP, &(rate * (reading.turn * self.across)));
        // The last common unknown but for those of a creeping point.
        if settings.stiffness_sd > 0.0 {
            let at = COMMON + common - 1 - if settings.creep_sd > 0.0 { 2 } else { 0 };
            found
                .slope
                .set_column(at, &(found.moment_nmm * settings.stiffness_sd));
        }
        // Errors of the displacement enter through dm/dP.
        for (j, way) in row.shared_displacement_mm.iter().enumerate() {
            let mut column = found.slope.column_mut(COMMON + j);
            column += rate * way;
        }
        for (j, changed) in field.changed.iter().enumerate() {
            // Without friction: its change by another coefficient is what it is at the edge of the
            // cone at most.
            let Some((there, here)) = changed.held(&place, 0.0).zip(field.held(&place, 0.0)) else {
                continue;
            };
            let mut column = found.slope.column_mut(COMMON + j);
            column += Vector2::from(there.moment_nmm) - Vector2::from(here.moment_nmm);
        }
        found
            .slope
            .set_column(COMMON + common, &(rate * row.velocity_mm_s));
        // Motion and table; where readings of one pose share a draw of the noise, they share these
        // too.
        let size2 = row.moment_nmm[0].powi(2) + row.moment_nmm[1].powi(2);
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

    /// Iterated Kalman update with the mixture of regular readings, noisy ones, and such that are
    /// anything.
    fn iterate(&mut self, reading: &Reading<'_>, iterations: usize, held: bool) {
        let Some(mut at) = self.linearised(reading, &self.mean, held) else {
            return self.unexplained();
        };
        self.carry_correlated(reading, &at.correlated);
        let (before, y) = (self.mean.clone(), Vector2::from(reading.row.moment_nmm));
        let mut z = before.clone();
        let share = reading.settings.gross_share;
        let creep = reading.creep().map(|(at, _)| at);
        for n in 1..=iterations {
            // Innovation at the prior mean by the slope at the present one; what moves the point
            // (onset, gap, creep) acts on more than a line.
            let innovation = y - at.moment_nmm - &at.slope * &before
                + at.slope.fixed_columns::<2>(0) * z.fixed_rows::<2>(0)
                + creep.map_or_else(Vector2::zeros, |k| {
                    at.slope.fixed_columns::<2>(k) * z.fixed_rows::<2>(k)
                });
            let to_state = &at.slope * &self.covariance;
            let known = &to_state * at.slope.transpose();
            let known = Matrix2::new(known[(0, 0)], known[(0, 1)], known[(1, 0)], known[(1, 1)]);
            // All of the reading's noise, the correlated part included: what an outlier has more
            // of.
            let noise = at.own + at.noise_of_draw(reading);
            let (regular, noisy) = (
                known + at.own,
                known + at.own + noise * (NOISY * NOISY - 1.0),
            );
            let (Some(inverse), Some(inverse_noisy)) = (regular.try_inverse(), noisy.try_inverse())
            else {
                return self.unexplained();
            };
            // Mahalanobis distances of the innovation as a regular reading and as a noisy one.
            let squared = innovation.dot(&(inverse * innovation));
            let squared_noisy = innovation.dot(&(inverse_noisy * innovation));
            let ln_share = share.max(1e-300).ln();
            let mut parts = [
                (1.0 - share).ln() + ln_normal(squared, regular.determinant()),
                ln_share + ln_normal(squared_noisy, noisy.determinant()),
                f64::NEG_INFINITY,
            ];
            // A step by the other two alone: where the slope is still that of a distant state, a
            // regular reading looks like anything.
            let used = regular + noise * (1.0 / inverse_variance(&parts).0 - 1.0);
            let Some(inverse_used) = used.try_inverse() else {
                return self.unexplained();
            };
            let next = &before + to_state.transpose() * inverse_used * innovation;
            let step = (next.fixed_rows::<2>(0) - z.fixed_rows::<2>(0)).norm();
            z = next;
            if n == iterations || step < SETTLED_MM {
                parts[2] = ln_share - (std::f64::consts::PI * MAX_NMM * MAX_NMM).ln();
                let (weight, ln) = inverse_variance(&parts);
                let used = regular + noise * (1.0 / weight - 1.0);
                let Some(inverse_used) = used.try_inverse() else {
                    return self.unexplained();
                };
                let gain = to_state.transpose() * inverse_used;
                self.mean = before + &gain * innovation;
                self.covariance -= gain * to_state;
                self.regular_ln = self.ln + parts[0];
                self.ln += ln;
                self.chi2[0] += squared;
                self.chi2[1] += innovation.dot(&(inverse_used * innovation));
                self.last_outlier = 1.0 - (parts[0] - ln).exp();
                self.outlier += self.last_outlier;
                self.contact = at.contact;
                return;
            }
            // A step out of the wire's reach is shortened.
            let step = &z - &at.state;
            let reached = (0..SHORTENED).find_map(|k| {
                let z = &at.state + &step * 0.5_f64.powi(k);
                self.linearised(reading, &z, held)
            });
            match reached {
                Some(next) => at = next,
                None => return self.unexplained(),
            }
            z.copy_from(&at.state);
        }
    }

    /// The wire has no equilibrium here, or the numbers have none: no state of this node.
    fn unexplained(&mut self) {
        (self.ln, self.regular_ln) = (f64::NEG_INFINITY, f64::NEG_INFINITY);
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
            (-0.5 * past * past).exp() / std::f64::consts::TAU.sqrt() / share
        };
        let column = self.covariance.column(ONSET).clone_owned() * (sign / scale);
        self.mean += &column * ratio;
        self.covariance -= &column * column.transpose() * (ratio * (ratio + past));
    }

    /// Before the lead, which goes back in time: b at the first loaded reading is kept beside the
    /// one that goes on.
    pub(crate) fn keep_correlated(&mut self) {
        let size = self.mean.len();
        let kept = |i: usize| if i < size { i } else { i - 2 };
        self.mean = DVector::from_fn(size + 2, |i, _| self.mean[kept(i)]);
        self.covariance = DMatrix::from_fn(size + 2, size + 2, |i, j| {
            self.covariance[(kept(i), kept(j))]
        });
    }

    /// After the lead: forwards in time from the first loaded reading.
    pub(crate) fn resume_correlated(&mut self) {
        let size = self.mean.len() - 2;
        let kept = |i: usize| if i < size - 2 { i } else { i + 2 };
        self.mean = DVector::from_fn(size, |i, _| self.mean[kept(i)]);
        self.covariance = DMatrix::from_fn(size, size, |i, j| self.covariance[(kept(i), kept(j))]);
    }
}
