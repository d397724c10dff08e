//! The wire as rigid links with springs at their joints: energy, balance and stiffness in absolute
//! link rotations.
//!
//! With link frames R_j, length h, joint rotation w_j = log(R_(j-1)^T R_j), rest w0_j, stiffness
//! K_j = diag(GJ, EI, EI) / span_j and the dead load q_j of link j:
//!
//! E = sum_j 1/2 (w_j - w0_j) . K_j (w_j - w0_j) - sum_j F_j . h R_j e1, F_j = q_j h / 2 + sum_(i >
//! j) q_i h, dw_j = J_r^-1(w_j) R_j^T (phi_j - phi_(j-1)), with phi_j the spatial rotation
//! increment of link j, grad_j = m_j - m_(j+1) - h R_j e1 x F_j, m_j = R_j J_r^-T(w_j) K_j (w_j -
//! w0_j).
//!
//! Joints lie between link centres; the clamp's spring spans half a link, which makes the scheme
//! second order at the root. In the phi_j the Hessian is block tridiagonal, loads included, so that
//! a Newton step costs O(links). Past the onset of softening K depends on the bending angle
//! ([`Softening`]). Source: M. Bergou et al., "Discrete Elastic Rods", ACM TOG 27 (2008), with
//! rigid links for the inextensible wire; the Jacobian J_r of the rotation vector: G. Chirikjian,
//! "Stochastic Models, Information Theory, and Lie Groups" 2 (2012), ch. 10.

use super::centre_line::{self, CurvePoint};
use super::configuration::Configuration;
use nalgebra::{Matrix3, Rotation3, Vector3};
use wcal_rod::{DiscreteRod, RodError, Section, Shape, Softening};

/// A joint: rest turn (rad, frame of the link beyond it), stiffness (N mm/rad), and the wire that
/// it stands for (mm).
#[derive(Debug, Clone, Copy, PartialEq)]
struct Joint {
    rest: Vector3<f64>,
    stiffness: Vector3<f64>,
    span_mm: f64,
}

/// Links of equal length from a clamp.
#[derive(Debug, Clone, PartialEq)]
pub struct ContactRod {
    /// Length of a link, mm.
    pub link_mm: f64,
    /// Radius of the wire, mm.
    pub radius_mm: f64,
    /// Load along each link, N/mm (weight less buoyancy, drag); empty: none. It keeps its direction
    /// as the links turn.
    pub loads_n_per_mm: Vec<Vector3<f64>>,
    /// How the joints soften past a change of curvature.
    pub softening: Option<Softening>,
    joints: Vec<Joint>,
    clamp: Matrix3<f64>,
    /// Places at which the surface is evaluated in every step.
    pub(crate) middles: Vec<CurvePoint>,
}

/// Energy, its gradient and its Hessian by blocks, at some place of the links.
#[derive(Debug, Clone)]
pub(crate) struct Balance {
    pub energy_nmm: f64,
    /// Elastic gradient less that of the load, a link.
    pub gradient: Vec<Vector3<f64>>,
    /// Diagonal blocks, and the block to the link before.
    pub diagonal: Vec<Matrix3<f64>>,
    pub before: Vec<Matrix3<f64>>,
    /// Further stiffness, as rows with their weights.
    pub dyads: Vec<(Vec<Vector3<f64>>, f64)>,
}

impl ContactRod {
    /// `links` rigid links for a wire of `section` and `diameter_mm` (mm) that is at rest in
    /// `shape`.
    ///
    /// # Errors
    /// As [`DiscreteRod::new`].
    pub fn new(
        section: &Section,
        shape: &Shape,
        diameter_mm: f64,
        links: usize,
    ) -> Result<Self, RodError> {
        let laws = DiscreteRod::new(section, shape, diameter_mm, links)?;
        // A joint stands for the wire between the middles of its two links; the first from the
        // clamp to the middle of link 0.
        let span = |j: usize| {
            if j == 0 {
                laws.link_mm / 2.0
            } else {
                laws.link_mm
            }
        };
        let joint = |(j, &(rest, stiffness))| Joint {
            rest,
            stiffness,
            span_mm: span(j),
        };
        Ok(Self {
            link_mm: laws.link_mm,
            radius_mm: laws.radius_mm,
            loads_n_per_mm: Vec::new(),
            softening: section.softening,
            joints: laws.joints().iter().enumerate().map(joint).collect(),
            clamp: laws.clamp_frame(),
            middles: centre_line::middles(links),
        })
    }

    /// Number of links.
    pub fn links(&self) -> usize {
        self.joints.len()
    }

    /// The stress-free wire.
    pub fn at_rest(&self) -> Configuration {
        let mut frame = self.clamp;
        let frames = self
            .joints
            .iter()
            .map(|joint| {
                frame *= Rotation3::from_scaled_axis(joint.rest).matrix();
                frame
            })
            .collect();
        self.from_frames(frames)
    }

    #[allow(
        clippy::wrong_self_convention,
        reason = "a configuration of this rod from frames"
    )]
    fn from_frames(&self, frames: Vec<Matrix3<f64>>) -> Configuration {
        let mut node = Vector3::zeros();
        let mut nodes_mm = vec![node];
        for frame in &frames {
            node += frame.column(0) * self.link_mm;
            nodes_mm.push(node);
        }
        Configuration {
            frames,
            nodes_mm,
            clamp: self.clamp,
            link_mm: self.link_mm,
        }
    }

    /// The links turned by spatial rotation vectors (rad).
    pub(crate) fn rotated(&self, links: &Configuration, by: &[Vector3<f64>]) -> Configuration {
        let turn = |(frame, phi): (&Matrix3<f64>, &Vector3<f64>)| {
            orthonormal(Rotation3::from_scaled_axis(*phi).matrix() * frame)
        };
        self.from_frames(links.frames.iter().zip(by).map(turn).collect())
    }

    /// What the clamp's spring carries, N mm: the moment a little before the first link's middle.
    pub(crate) fn root_spring_nmm(&self, links: &Configuration) -> Vector3<f64> {
        self.joint(links, 0).0
    }

    /// Largest change of curvature from rest, 1/mm.
    pub fn largest_bend_per_mm(&self, links: &Configuration) -> f64 {
        let bend = |j: usize| {
            let Joint { rest, span_mm, .. } = self.joints[j];
            (self.relative(links, j) - rest).yz().norm() / span_mm
        };
        (0..self.links()).map(bend).fold(0.0, f64::max)
    }

    fn relative(&self, links: &Configuration, j: usize) -> Vector3<f64> {
        let frame = if j == 0 {
            &self.clamp
        } else {
            &links.frames[j - 1]
        };
        let relative = frame.transpose() * links.frames[j];
        rotation_vector(&relative)
    }

    /// Spatial moment, stiffness block and energy of a joint.
    fn joint(&self, links: &Configuration, j: usize) -> (Vector3<f64>, Matrix3<f64>, f64) {
        let w = self.relative(links, j);
        let (stress, tangent, energy) =
            self.joints[j].response(&(w - self.joints[j].rest), self.softening);
        // dw = B (phi_j - phi_{j-1}): inverse right Jacobian of the rotation vector, in the frame
        // of link j.
        let b = inverse_right_jacobian(&w) * links.frames[j].transpose();
        let bt = b.transpose();
        (bt * stress, bt * tangent * b, energy)
    }

    /// Energy, gradient and Hessian of the elastic joints and the dead loads.
    pub(crate) fn balance(&self, links: &Configuration) -> Balance {
        let n = self.links();
        let mut all = Balance {
            energy_nmm: 0.0,
            gradient: vec![Vector3::zeros(); n],
            diagonal: vec![Matrix3::zeros(); n],
            before: vec![Matrix3::zeros(); n],
            dyads: Vec::new(),
        };
        for j in 0..n {
            let (moment, block, energy) = self.joint(links, j);
            all.energy_nmm += energy;
            all.gradient[j] += moment;
            all.diagonal[j] += block;
            if j > 0 {
                all.gradient[j - 1] -= moment;
                all.diagonal[j - 1] += block;
                // log(exp(-a) exp(b)) = b - a - a x b / 2: the moment turns with the links.
                all.before[j] = -block - moment.cross_matrix() * 0.5;
            }
        }
        self.add_loads(links, &mut all);
        all
    }

    /// Dead loads along the wire: what lies beyond a link pulls at its end, its own half at its
    /// middle.
    fn add_loads(&self, links: &Configuration, all: &mut Balance) {
        let mut beyond_n = Vector3::zeros();
        for (j, load) in self
            .loads_n_per_mm
            .iter()
            .enumerate()
            .take(self.links())
            .rev()
        {
            let own_n = load * self.link_mm;
            let force = beyond_n + own_n * 0.5;
            beyond_n += own_n;
            let arm: Vector3<f64> = links.frames[j].column(0) * self.link_mm;
            all.energy_nmm -= force.dot(&arm);
            all.gradient[j] -= arm.cross(&force);
            all.diagonal[j] += load_stiffness(&arm, &force);
        }
    }
}

impl Joint {
    /// Moment, its derivative, and energy at a turn `off` (rad) from rest, in the frame of the link
    /// beyond.
    fn response(
        &self,
        off: &Vector3<f64>,
        softening: Option<Softening>,
    ) -> (Vector3<f64>, Matrix3<f64>, f64) {
        let linear = self.stiffness.component_mul(off);
        let plain = (
            linear,
            Matrix3::from_diagonal(&self.stiffness),
            0.5 * linear.dot(off),
        );
        let Some(softening) = softening else {
            return plain;
        };
        // Bending past the onset, isotropic in the section's plane; torsion stays linear.
        let onset_rad = softening.onset_per_mm() * self.span_mm;
        let bend = Vector3::new(0.0, off.y, off.z);
        let x = bend.norm() / onset_rad;
        if x <= 1.0 {
            return plain;
        }
        let (moment, slope) = softening.relative_moment(x);
        let (gain, along) = (moment / x, bend / bend.norm());
        let [twist, k] = [self.stiffness.x, self.stiffness.y];
        // Secant stiffness across the bend, tangent stiffness along it.
        let bent = Matrix3::from_diagonal(&Vector3::new(0.0, k * gain, k * gain));
        let energy =
            0.5 * twist * off.x * off.x + k * onset_rad * onset_rad * softening.relative_energy(x);
        let tangent = bent
            + along * along.transpose() * (k * (slope - gain))
            + Matrix3::from_diagonal(&Vector3::new(twist, 0.0, 0.0));
        (
            Vector3::new(twist * off.x, k * gain * off.y, k * gain * off.z),
            tangent,
            energy,
        )
    }
}

/// Hessian of `-force . R arm` in the rotation of a link.
pub(crate) fn load_stiffness(arm: &Vector3<f64>, force: &Vector3<f64>) -> Matrix3<f64> {
    let outer = arm * force.transpose();
    Matrix3::identity() * arm.dot(force) - (outer + outer.transpose()) * 0.5
}

/// Logarithm of a rotation below half a turn; exact near none, where the arc cosine is not.
fn rotation_vector(r: &Matrix3<f64>) -> Vector3<f64> {
    let twice_sine = Vector3::new(
        r[(2, 1)] - r[(1, 2)],
        r[(0, 2)] - r[(2, 0)],
        r[(1, 0)] - r[(0, 1)],
    );
    let sine = twice_sine.norm() / 2.0;
    let angle = sine.atan2((r.trace() - 1.0) / 2.0);
    twice_sine
        * if sine > 1e-12 {
            angle / (2.0 * sine)
        } else {
            0.5
        }
}

/// J_r^-1(w) = 1 + [w]/2 + k [w]^2, k = 1/w^2 - (1 + cos w) / (2 w sin w).
fn inverse_right_jacobian(w: &Vector3<f64>) -> Matrix3<f64> {
    let angle2 = w.norm_squared();
    let k = if angle2 < 1e-6 {
        1.0 / 12.0 + angle2 / 720.0
    } else {
        let angle = angle2.sqrt();
        1.0 / angle2 - (1.0 + angle.cos()) / (2.0 * angle * angle.sin())
    };
    let hat = w.cross_matrix();
    Matrix3::identity() + hat * 0.5 + hat * hat * k
}

/// Gram-Schmidt, so that rounding does not build up over many steps.
fn orthonormal(m: Matrix3<f64>) -> Matrix3<f64> {
    let x: Vector3<f64> = m.column(0).normalize();
    let z = x.cross(&Vector3::from(m.column(1))).normalize();
    Matrix3::from_columns(&[x, z.cross(&x), z])
}

#[cfg(test)]
mod tests {
    use super::ContactRod;
    use nalgebra::Vector3;
    use wcal_core::observation::RestShape;
    use wcal_rod::{Section, Shape, Softening};

    fn rod() -> ContactRod {
        let rest = RestShape::StraightArc {
            straight_mm: 30.0,
            arc_radius_mm: 20.0,
            length_mm: 60.0,
        };
        let mut rod = ContactRod::new(
            &Section::round(0.3, 75.0, 28.2),
            &Shape::new(&rest, 0.5).unwrap(),
            0.3,
            12,
        )
        .unwrap();
        rod.loads_n_per_mm = (0..12)
            .map(|k| Vector3::new(1e-3, -2e-3, 3e-3) * (1.0 + k as f64 / 6.0))
            .collect();
        rod
    }

    fn softened(softening: Softening) -> ContactRod {
        ContactRod {
            softening: Some(softening),
            ..rod()
        }
    }

    fn turns(size: f64, seed: usize) -> Vec<Vector3<f64>> {
        let wave = |k: usize| ((k * 37 + seed * 11) as f64).sin() * size;
        (0..12)
            .map(|j| Vector3::new(wave(3 * j), wave(3 * j + 1), wave(3 * j + 2)))
            .collect()
    }

    /// Gradient and Hessian against differences of the energy, at a bent place.
    #[test]
    fn gradient_and_stiffness_are_the_energys() {
        agrees(&rod());
        // Most joints of the bent place are past this onset.
        agrees(&softened(Softening::Section {
            onset_per_m: 8.0,
            hardening: 0.1,
        }));
        agrees(&softened(Softening::Bilinear {
            onset_per_m: 8.0,
            ratio: 0.4,
        }));
    }

    fn agrees(rod: &ContactRod) {
        let links = rod.rotated(&rod.at_rest(), &turns(0.05, 1));
        let balance = rod.balance(&links);
        let energy = |t: f64, by: &[Vector3<f64>]| {
            let by: Vec<_> = by.iter().map(|v| v * t).collect();
            rod.balance(&rod.rotated(&links, &by)).energy_nmm
        };
        for seed in 2..6 {
            let by = turns(1.0, seed);
            let t = 1e-4;
            let slope = (energy(t, &by) - energy(-t, &by)) / (2.0 * t);
            let stated: f64 = balance
                .gradient
                .iter()
                .zip(&by)
                .map(|(g, v)| g.dot(v))
                .sum();
            assert!(
                (slope - stated).abs() < 1e-4 * stated.abs().max(1.0),
                "{slope} {stated}"
            );
            let bend = (energy(t, &by) - 2.0 * energy(0.0, &by) + energy(-t, &by)) / (t * t);
            let mut stated = 0.0;
            for j in 0..12 {
                stated += by[j].dot(&(balance.diagonal[j] * by[j]));
                if j > 0 {
                    stated += 2.0 * by[j].dot(&(balance.before[j] * by[j - 1]));
                }
            }
            // What is left out is of the size of a joint's turn times its moment.
            assert!(
                (bend - stated).abs() < 0.02 * stated.abs(),
                "{bend} {stated}"
            );
        }
    }
}
