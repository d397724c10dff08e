//! Information about what is constant and about the state now, and how a step of time changes it.
//!
//! With theta the constants, x the state before and x' now, relations `r . (theta, x, x')` of information I add `I r r'` to the matrix of
//! all three; x is then marginalised: `J_bb - J_ba J_aa^-1 J_ab` (Schur complement), a the rows of x, b those of (theta, x').

use nalgebra::{DMatrix, DVector, Matrix3};

/// Numbers of the state.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum State {
    /// Place on the curve, nodes.
    Q,
    /// True moments, N mm.
    MY,
    /// See `MY`.
    MZ,
    /// Velocity along the curve, nodes/mm.
    V,
    /// Speed of the base, mm/s.
    U,
    /// Zero of the moments, N mm.
    BY,
    /// See `BY`.
    BZ,
}

impl State {
    const COUNT: usize = 7;
    /// Those that a contact has.
    pub const CONTACT: [Self; 4] = [Self::Q, Self::MY, Self::MZ, Self::V];
}

/// A linear relation with its information.
#[derive(Debug, Clone, PartialEq)]
pub struct Relation {
    information: f64,
    before: [f64; State::COUNT],
    now: [f64; State::COUNT],
    /// Constants with their derivatives.
    pub shared: Vec<(usize, f64)>,
}

impl Relation {
    pub fn new(information: f64) -> Self {
        Self { information, before: [0.0; State::COUNT], now: [0.0; State::COUNT], shared: Vec::new() }
    }

    /// A number now is what is known of it beforehand.
    pub fn prior(state: State, information: f64) -> Self {
        let mut own = Self::new(information);
        own.now(state, 1.0);
        own
    }

    /// A number now is that of before.
    pub fn persists(state: State, information: f64) -> Self {
        let mut own = Self::prior(state, information);
        own.before(state, -1.0);
        own
    }

    pub fn before(&mut self, state: State, by: f64) {
        self.before[state as usize] += by;
    }

    pub fn now(&mut self, state: State, by: f64) {
        self.now[state as usize] += by;
    }

    /// Derivatives by place and moments before.
    pub fn before_contact(&mut self, by: &[f64; 3]) {
        self.before.iter_mut().zip(by).for_each(|(a, b)| *a += b);
    }

    /// Derivatives by place and moments now.
    pub fn now_contact(&mut self, by: &[f64; 3]) {
        self.now.iter_mut().zip(by).for_each(|(a, b)| *a += b);
    }
}

/// Information matrix over the constants, then the state.
#[derive(Debug, Clone, PartialEq)]
pub struct Information {
    matrix: DMatrix<f64>,
    shared: usize,
}

impl Information {
    /// Of nothing yet but the contact's numbers, which have no meaning before a contact.
    pub fn none(shared: usize) -> Self {
        let n = shared + State::COUNT;
        let mut own = Self { matrix: DMatrix::zeros(n, n), shared };
        State::CONTACT.into_iter().for_each(|state| own.add(state, 1.0));
        own
    }

    /// Adds a prior of a number.
    pub fn add(&mut self, state: State, information: f64) {
        let k = self.shared + state as usize;
        self.matrix[(k, k)] += information;
    }

    /// Adds a prior of a constant.
    pub fn add_shared(&mut self, k: usize, information: f64) {
        self.matrix[(k, k)] += information;
    }

    /// After a step of time; none where the relations leave the state before undetermined.
    pub fn advanced(&self, relations: &[Relation]) -> Option<Self> {
        let (t, n) = (self.shared, State::COUNT);
        // Order: state before, constants, state now.
        let mut all = DMatrix::zeros(n + t + n, n + t + n);
        all.view_mut((0, 0), (n, n)).copy_from(&self.matrix.view((t, t), (n, n)));
        all.view_mut((n, n), (t, t)).copy_from(&self.matrix.view((0, 0), (t, t)));
        all.view_mut((0, n), (n, t)).copy_from(&self.matrix.view((t, 0), (n, t)));
        all.view_mut((n, 0), (t, n)).copy_from(&self.matrix.view((0, t), (t, n)));
        for r in relations {
            let mut row = DVector::zeros(n + t + n);
            row.rows_mut(0, n).copy_from_slice(&r.before);
            row.rows_mut(n + t, n).copy_from_slice(&r.now);
            r.shared.iter().for_each(|(k, by)| row[n + k] += by);
            all.ger(r.information, &row, &row, 1.0);
        }
        // Schur complement over the state before.
        let before = all.view((0, 0), (n, n)).into_owned().cholesky()?;
        let cross = all.view((0, n), (n, t + n)).into_owned();
        let matrix = all.view((n, n), (t + n, t + n)) - cross.transpose() * before.solve(&cross);
        Some(Self { matrix: (&matrix + matrix.transpose()) * 0.5, shared: t })
    }

    /// Adds a reading, a relation of constants and state now.
    pub fn observe(&mut self, r: &Relation) {
        let mut row = DVector::zeros(self.shared + State::COUNT);
        row.rows_mut(self.shared, State::COUNT).copy_from_slice(&r.now);
        r.shared.iter().for_each(|(k, by)| row[*k] += by);
        self.matrix.ger(r.information, &row, &row, 1.0);
    }

    /// Variance of a number of the state.
    pub fn variance(&self, state: State) -> Option<f64> {
        let k = self.shared + state as usize;
        let inverse = self.matrix.clone().cholesky()?.inverse();
        Some(inverse[(k, k)]).filter(|v| v.is_finite() && *v > 0.0)
    }

    /// Covariance of place and moments.
    pub fn contact_covariance(&self) -> Option<Matrix3<f64>> {
        let inverse = self.matrix.clone().cholesky()?.inverse();
        Some(inverse.fixed_view::<3, 3>(self.shared, self.shared).into_owned())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Steps of a made-up chain with a constant: relations between neighbours, priors at the start, readings.
    fn chain(steps: usize) -> (Vec<Vec<Relation>>, Vec<Relation>) {
        let all = [State::Q, State::MY, State::MZ, State::V, State::U, State::BY, State::BZ];
        let relations = |k: usize| {
            let mut rows: Vec<Relation> =
                all.iter().map(|s| Relation::persists(*s, 0.5 + 0.1 * k as f64)).collect();
            let mut path = Relation::new(40.0);
            path.now(State::Q, 1.0);
            path.before(State::Q, -1.0);
            path.now(State::V, -0.3 - 0.05 * k as f64);
            rows.push(path);
            rows
        };
        let reading = |k: usize| {
            let mut row = Relation::new(3.0);
            row.now(State::MY, 1.0);
            row.now(State::Q, 0.2 * k as f64);
            row.now(State::BY, 1.0);
            row.shared.push((0, 0.7));
            row
        };
        ((1..=steps).map(relations).collect(), (1..=steps).map(reading).collect())
    }

    #[test]
    fn the_recursion_is_the_whole_information_marginalised() {
        const STEPS: usize = 4;
        let (relations, readings) = chain(STEPS);
        let mut own = Information::none(1);
        own.add_shared(0, 1.0);
        [State::U, State::BY, State::BZ].into_iter().for_each(|s| own.add(s, 2.0));
        let first = own.matrix.clone();
        for (r, y) in relations.iter().zip(&readings) {
            own = own.advanced(r).unwrap();
            own.observe(y);
        }
        // The same over all states at once, order: constant, then the states one after the other.
        let (n, size) = (State::COUNT, 1 + State::COUNT * (STEPS + 1));
        let mut whole = DMatrix::zeros(size, size);
        whole.view_mut((0, 0), (1 + n, 1 + n)).copy_from(&first);
        let mut add = |r: &Relation, k: usize| {
            let mut row = DVector::zeros(size);
            row.rows_mut(1 + n * (k - 1), n).copy_from_slice(&r.before);
            row.rows_mut(1 + n * k, n).copy_from_slice(&r.now);
            r.shared.iter().for_each(|(j, by)| row[*j] += by);
            whole.ger(r.information, &row, &row, 1.0);
        };
        for k in 1..=STEPS {
            relations[k - 1].iter().for_each(|r| add(r, k));
            add(&readings[k - 1], k);
        }
        let inverse = whole.cholesky().unwrap().inverse();
        let dense = inverse.fixed_view::<3, 3>(1 + n * STEPS, 1 + n * STEPS).into_owned();
        let recursive = own.contact_covariance().unwrap();
        assert!((dense - recursive).norm() < 1e-9 * dense.norm(), "{dense} {recursive}");
        // Control: without the constant's prior the bound is another.
        let mut without = Information::none(1);
        without.add_shared(0, 1e-3);
        [State::U, State::BY, State::BZ].into_iter().for_each(|s| without.add(s, 2.0));
        for (r, y) in relations.iter().zip(&readings) {
            without = without.advanced(r).unwrap();
            without.observe(y);
        }
        let wider = without.contact_covariance().unwrap();
        assert!(wider.trace() > recursive.trace() * 1.001, "{wider} {recursive}");
    }
}
