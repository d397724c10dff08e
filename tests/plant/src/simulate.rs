//! Readings of a session under effects: stage, rod, memory and sensor, along the true sequence and
//! times.

use nalgebra::{DMatrix, DVector, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::sync::Arc;

use crate::PlantError;
use crate::bench::{Bench, Trajectory};
use crate::effects::{Effect, FBG_PM, Kind};
use crate::friction::{Grip, friction_drags};
use crate::layout::{Instant, PlannedRow, motion};
use crate::memory;
use crate::noise::{Covariance, Law};
use crate::rod::{Section, Wire};
use crate::section::{MomentLaw, WireSection, centre_line_arcs};
use crate::shapes::{STEP_MM, WireAtPose};
use crate::table::{Path, Table, dragged_equilibrium};

/// A session's bench, plan and motion, with the tables last used.
pub struct Plant {
    /// Bench.
    pub bench: Bench,
    /// Trajectories.
    pub trajectories: Vec<Trajectory>,
    /// Rows in order, points first.
    pub rows: Vec<PlannedRow>,
    /// True covariance of the readings of points.csv.
    pub covariance: Covariance,
    motion: Vec<Instant>,
    cache: Option<(Geometry, Vec<Table>)>,
}

/// What the tables depend on.
#[derive(Debug, Clone, PartialEq)]
struct Geometry {
    section: WireSection,
    root_compliance: [f64; 2],
    offset_mm: Vector3<f64>,
    friction: bool,
}

impl Geometry {
    fn wire(&self, bench: &Bench) -> Wire {
        let other = self.section != WireSection::default();
        Wire {
            root_compliance: self.root_compliance,
            section: other.then(|| Arc::new(self.section) as Arc<dyn Section>),
            ..bench.wire()
        }
    }

    /// Where the groove really runs on a trajectory.
    fn path(&self, trajectory: &Trajectory) -> Path {
        Path {
            offset_mm: trajectory.path.offset_mm + self.offset_mm,
            ..trajectory.path
        }
    }
}

/// The wire in the groove at one instant.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
struct GrooveLoad {
    /// Moment about y and z, N mm.
    moment_nmm: [f64; 2],
    /// Tangential part of the contact force over the normal one.
    drag: f64,
}

/// Noise-free answer of one row.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct NoiseFree {
    /// Base moment (y, z) in N mm, as the rod has it.
    pub moment_nmm: [f64; 2],
    /// Shift of both channels in pm without zero and without the declared temperature term.
    pub shift_pm: [f64; 2],
}

impl Plant {
    /// A plant for a bench and a plan under a law of noise.
    pub fn new(
        bench: Bench,
        trajectories: Vec<Trajectory>,
        rows: Vec<PlannedRow>,
        law: &Law,
    ) -> Self {
        let motion = motion(&rows);
        let covariance = Covariance::new(law, &bench, &rows, &trajectories);
        Self {
            bench,
            trajectories,
            rows,
            covariance,
            motion,
            cache: None,
        }
    }

    /// Noise-free answers of all rows under `effects`.
    ///
    /// # Errors
    /// [`PlantError::Wire`] when the rod does not settle.
    pub fn clean(&mut self, effects: &[Effect]) -> Result<Vec<NoiseFree>, PlantError> {
        let rod: Vec<[f64; 2]> = self
            .held(effects)?
            .into_iter()
            .map(|h| h.moment_nmm)
            .collect();
        let mut sensed = rod.clone();
        for effect in effects {
            sensed = memory::apply(effect, &self.motion, sensed);
        }
        let mut out = vec![NoiseFree::default(); self.rows.len()];
        for ((instant, rod), sensed) in self.motion.iter().zip(&rod).zip(&sensed) {
            let Some(row) = instant.row else { continue };
            out[row] = NoiseFree {
                moment_nmm: *rod,
                shift_pm: self.bench.shift_pm(*sensed),
            };
            for effect in effects {
                let add = self.sensor(effect, row, *sensed);
                out[row].shift_pm[0] += add[0];
                out[row].shift_pm[1] += add[1];
            }
        }
        for effect in effects.iter().filter(|e| e.kind == Kind::SlipOutliers) {
            self.slips(effect, &mut out);
        }
        Ok(out)
    }

    /// The wire in the groove at every loaded row that is settled, under `effects`; none elsewhere.
    ///
    /// # Errors
    /// [`PlantError::Wire`] when the rod does not settle.
    pub fn wires_in_groove(
        &mut self,
        effects: &[Effect],
    ) -> Result<Vec<Option<WireAtPose>>, PlantError> {
        let held = self.held(effects)?;
        let geometry = self.geometry(effects);
        let wire = geometry.wire(&self.bench);
        let mut out = vec![None; self.rows.len()];
        for ((instant, stage_mm), held) in self.motion.iter().zip(self.stages(effects)).zip(held) {
            let Some(row) = instant
                .row
                .filter(|_| instant.loaded && instant.velocity_mm_s == 0.0)
            else {
                continue;
            };
            let trajectory = &self.trajectories[instant.trajectory];
            let path = geometry.path(trajectory);
            let e = dragged_equilibrium(&wire, &path, held.drag, trajectory.reach_mm, stage_mm)?;
            let groove_mm = path.at(stage_mm);
            out[row] = Some(WireAtPose {
                groove_mm,
                arclength_mm: e.arclength_mm,
                tangent: e.tangent,
                line_mm: wire.centre_line(Some((&groove_mm, &e)), STEP_MM),
                arcs_mm: centre_line_arcs(&wire, e.arclength_mm, STEP_MM),
            });
        }
        Ok(out)
    }

    /// The wire in the groove at every instant.
    fn held(&mut self, effects: &[Effect]) -> Result<Vec<GrooveLoad>, PlantError> {
        let geometry = self.geometry(effects);
        if self.cache.as_ref().is_none_or(|(g, _)| *g != geometry) {
            let tables = self.tables(&geometry)?;
            self.cache = Some((geometry, tables));
        }
        let tables = self.cache.as_ref().map_or(&[][..], |(_, t)| t);
        Ok(self.rod(effects, tables, &self.stages(effects)))
    }

    fn geometry(&self, effects: &[Effect]) -> Geometry {
        let mut g = Geometry {
            section: WireSection::default(),
            root_compliance: [0.0; 2],
            offset_mm: Vector3::zeros(),
            friction: false,
        };
        for e in effects {
            match e.kind {
                Kind::OffsetGroove => {
                    g.offset_mm = Vector3::from_column_slice(&e.shape) * e.amplitude
                }
                Kind::ComplianceIsotropic => g.root_compliance = [e.amplitude; 2],
                Kind::ComplianceTwoAxes => {
                    g.root_compliance = [e.amplitude * e.shape[0], e.amplitude * e.shape[1]];
                }
                Kind::FrictionCoulomb | Kind::FrictionPresliding | Kind::FrictionStribeck => {
                    g.friction = true
                }
                _ => {}
            }
            if let Some(law) = e.moment_law() {
                g.section.law = law;
            }
            if let Some(taper) = e.taper() {
                g.section.taper = taper;
            }
        }
        g
    }

    fn tables(&self, g: &Geometry) -> Result<Vec<Table>, PlantError> {
        let drags = if g.friction {
            friction_drags()
        } else {
            vec![0.0]
        };
        // A moment law with a corner needs more nodes.
        let nodes = if g.section.law == MomentLaw::Linear {
            11
        } else {
            20
        };
        let wire = g.wire(&self.bench);
        self.trajectories
            .iter()
            .map(|t| {
                Ok(Table::build(
                    &wire,
                    &g.path(t),
                    1.04 * t.reach_mm + 0.2,
                    &drags,
                    nodes,
                )?)
            })
            .collect()
    }

    /// True stage position at every instant.
    fn stages(&self, effects: &[Effect]) -> Vec<f64> {
        let tau = std::f64::consts::TAU;
        let mut out: Vec<f64> = self.motion.iter().map(|i| i.commanded_mm).collect();
        for e in effects {
            let a = e.amplitude;
            let s = &e.shape;
            match e.kind {
                Kind::StageScale => out.iter_mut().for_each(|x| *x *= 1.0 + a),
                Kind::PeriodicLead | Kind::PeriodicDouble => {
                    out.iter_mut()
                        .for_each(|x| *x += a * (tau * *x / s[0] + s[1]).sin());
                }
                Kind::PeriodicHarmonics => out.iter_mut().for_each(|x| {
                    let turn = tau * *x / s[0];
                    *x += a * ((turn + s[1]).sin() + s[2] * (2.0 * turn + s[3]).sin());
                }),
                Kind::BacklashApproach | Kind::BacklashSymmetric => {
                    // The carriage hangs behind the screw: a play of width a.
                    let shift = if e.kind == Kind::BacklashSymmetric {
                        0.5 * a
                    } else {
                        0.0
                    };
                    let mut state = out[0];
                    let mut trajectory = usize::MAX;
                    for (x, i) in out.iter_mut().zip(&self.motion) {
                        if i.trajectory != trajectory {
                            (state, trajectory) = (*x, i.trajectory);
                        }
                        state = state.clamp(*x, *x + a);
                        *x = state - shift;
                    }
                }
                Kind::LagPose => {
                    for (x, i) in out.iter_mut().zip(&self.motion) {
                        *x -= a * i.velocity_mm_s;
                    }
                }
                _ => {}
            }
        }
        out
    }

    /// The rod at every instant.
    fn rod(&self, effects: &[Effect], tables: &[Table], stages: &[f64]) -> Vec<GrooveLoad> {
        let friction = effects.iter().find(|e| {
            matches!(
                e.kind,
                Kind::FrictionCoulomb | Kind::FrictionPresliding | Kind::FrictionStribeck
            )
        });
        let mut grip = Grip::default();
        let (mut drag, mut before) = (0.0, 0.0);
        let mut trajectory = usize::MAX;
        self.motion
            .iter()
            .zip(stages)
            .map(|(instant, &x)| {
                if !instant.loaded || instant.trajectory != trajectory {
                    (grip, drag, before, trajectory) =
                        (Grip::default(), 0.0, x, instant.trajectory);
                }
                if !instant.loaded {
                    return GrooveLoad::default();
                }
                let table = &tables[instant.trajectory];
                let held = |drag: f64| {
                    let at = table.at(x, drag);
                    GrooveLoad {
                        moment_nmm: [at[0], at[1]],
                        drag,
                    }
                };
                let Some(f) = friction else { return held(0.0) };
                if f.kind == Kind::FrictionPresliding {
                    // Dahl: the drag approaches its limit over a sliding length.
                    let travel = x - before;
                    before = x;
                    let limit = f.amplitude * travel.signum();
                    drag = limit + (drag - limit) * (-travel.abs() / f.shape[0]).exp();
                    return held(drag);
                }
                let slow = f.kind == Kind::FrictionStribeck && instant.velocity_mm_s != 0.0;
                let (moment_nmm, drag) =
                    grip.step(table, x, f.amplitude * if slow { f.shape[0] } else { 1.0 });
                GrooveLoad { moment_nmm, drag }
            })
            .collect()
    }

    /// Shift in pm that the sensor side adds to a row.
    fn sensor(&self, effect: &Effect, row: usize, m: [f64; 2]) -> [f64; 2] {
        let r = &self.rows[row];
        let (a, s) = (effect.amplitude, &effect.shape);
        let both = |size: f64| [a * s[0] * size, a * s[1] * size];
        let (t, warm) = (r.t_s, self.bench.thermal.at(r.t_s));
        let k = self.bench.shift_pm(m);
        match effect.kind {
            Kind::TemperatureLinear => both(warm),
            Kind::DriftLinear => both(t / 60.0),
            // Form read off the practice sessions: my^2 and my mz in channel 1, mz^2 in channel 2.
            Kind::FbgThree => [
                a * FBG_PM * (s[0] * m[0] * m[0] + s[1] * m[0] * m[1]),
                a * FBG_PM * s[2] * m[1] * m[1],
            ],
            Kind::FbgFull => {
                let q = [m[0] * m[0], m[0] * m[1], m[1] * m[1]];
                let dot = |c: &[f64]| a * FBG_PM * c.iter().zip(q).map(|(c, q)| c * q).sum::<f64>();
                [dot(&s[..3]), dot(&s[3..])]
            }
            Kind::FbgChannel => [
                a * s[0] * k[0] * k[0] / FBG_PM,
                a * s[1] * k[1] * k[1] / FBG_PM,
            ],
            Kind::UnknownSineTime => both((std::f64::consts::TAU * t / s[2] + s[3]).sin()),
            Kind::UnknownStepTime => both(f64::from(u8::from(t > s[2]))),
            Kind::UnknownExponentialTime => both((-t / s[2]).exp()),
            Kind::UnknownQuadraticDrift => both((t / s[2] - s[3]).powi(2)),
            Kind::UnknownDirectionSign if r.role != "rest" => both(f64::from(r.direction)),
            Kind::UnknownDepthKink if r.role != "rest" => both(
                (r.commanded_mm / self.trajectories[r.trajectory].reach_mm - s[2]).max(0.0)
                    / (1.0 - s[2]),
            ),
            Kind::UnknownTrajectoryGain => k.map(|k| a * s[r.trajectory] * k),
            Kind::UnknownRipple => {
                [0, 1].map(|c| a * (std::f64::consts::TAU * k[c] / s[0] + s[1 + c]).sin())
            }
            Kind::UnknownTemperatureGradient => both(warm - self.bench.thermal.behind(r.t_s, s[2])),
            Kind::UnknownTemperatureGain => k.map(|k| a * warm * k),
            _ => [0.0; 2],
        }
    }

    /// A few settled readings with the wire out of the vertex.
    fn slips(&self, effect: &Effect, out: &mut [NoiseFree]) {
        let mut rng = ChaCha8Rng::seed_from_u64(effect.shape[1] as u64);
        let settled: Vec<usize> = (0..self.rows.len())
            .filter(|&i| {
                !self.rows[i].holdout && self.rows[i].role != "rest" && self.rows[i].dwell_s > 0.0
            })
            .collect();
        let count = ((effect.shape[0] * settled.len() as f64).round() as usize).max(1);
        for _ in 0..count {
            let row = settled[rng.random_range(0..settled.len())];
            let (share, turn) = (rng.random_range(0.4..1.0), rng.random_range(-0.6..0.6));
            let m = out[row].moment_nmm;
            let lost = effect.amplitude * share;
            let slipped = [
                m[0] * (1.0 - lost) - lost * turn * m[1],
                m[1] * (1.0 - lost) + lost * turn * m[0],
            ];
            let (from, to) = (self.bench.shift_pm(m), self.bench.shift_pm(slipped));
            out[row].moment_nmm = slipped;
            for c in 0..2 {
                out[row].shift_pm[c] += to[c] - from[c];
            }
        }
    }

    /// Size in noises of what K and the zero cannot absorb, over the rows of points.csv (as
    /// truth.json counts it), measured against the true covariance of the noise.
    pub fn size(&self, with: &[NoiseFree], without: &[NoiseFree]) -> f64 {
        let rows = self.covariance.rows();
        let base = self.covariance.whiten(&moments(rows, without));
        (0..2)
            .map(|c| {
                let d = DVector::from_fn(rows.len(), |i, _| {
                    with[rows[i]].shift_pm[c] - without[rows[i]].shift_pm[c]
                });
                self.covariance.left_over(&base, d).powi(2)
            })
            .sum::<f64>()
            .sqrt()
    }
}

/// Columns that the zero and K take up: one, and both moments.
pub fn moments(rows: &[usize], clean: &[NoiseFree]) -> DMatrix<f64> {
    DMatrix::from_fn(rows.len(), 3, |i, j| {
        if j == 0 {
            1.0
        } else {
            clean[rows[i]].moment_nmm[j - 1]
        }
    })
}
