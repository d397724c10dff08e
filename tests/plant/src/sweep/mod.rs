//! Hidden sweeps: a foreign wire slides over an object; where it touches is known at every reading.
//! SIMULATED.
//!
//! A sweep is drawn from its seed: wire (length, straight part, radius of the arc, diameter,
//! modulus), linear map of the wavelengths with the zero and the noise of a bench, an extruded
//! outline ([`body`]), the direction of the motion, friction, rate and speed. The equilibrium is
//! that of [`slide`]. Draws that jam, snap, touch twice or are over at once are drawn again, and
//! counted.

pub mod body;
pub mod slide;

use crate::bench::Bench;
use crate::case::{Case, CaseKind, Request, put};
use crate::layout::Design;
use crate::rod::Wire;
use crate::{PlantError, WireError, session};
use body::{Body, Outline};
use nalgebra::{Rotation3, Vector3};
use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use slide::{Slide, Touch};
use std::fmt::Write as _;
use std::path::Path;

type V3 = Vector3<f64>;

/// Free way before first touch, mm, and free readings at the end.
const LEAD_MM: f64 = 8.0;
const FREE_READINGS: usize = 6;
/// Longest way of a sweep, mm, and largest change of curvature at the root, 1/mm.
const MAX_WAY_MM: f64 = 90.0;
const MAX_BEND_PER_MM: f64 = 0.08;
/// Fewer readings in contact are no sweep; nearer to the root nothing touches, mm; deeper there is
/// a second contact, mm.
const MIN_TOUCHES: usize = 16;
const MIN_ARC_MM: f64 = 12.0;
const MAX_OVERLAP_MM: f64 = 0.03;
/// Steps in which it is looked for where the wire slips off a body, and how deep the free wire lies
/// there in the next body, mm.
const SNAP_STEP_MM: f64 = 0.5;
const SNAP_DEPTH_MM: [f64; 2] = [1.0, 5.0];
/// Radius of a needle, mm; relative standard deviation of another wire's diameter; time that a base
/// stands where it turns, s.
const NEEDLE_MM: f64 = 0.3;
const OTHER_DIAMETER: f64 = 0.01;
const HOLD_S: f64 = 0.5;
/// Draws before it is given up.
const MAX_DRAWS: u32 = 60;

/// What a sweep is of.
#[derive(Debug, Clone, PartialEq)]
pub struct Scene {
    /// Wire, map and noise; moves with the base.
    pub bench: Bench,
    /// At rest in the world.
    pub body: Body,
    /// At rest beyond it: what the wire snaps onto when it slips off the first.
    pub beyond: Option<Body>,
    /// Friction coefficient.
    pub friction: f64,
    /// Unit vector of the base's motion, world frame.
    pub direction: V3,
    /// mm/s.
    pub speed_mm_s: f64,
    /// Readings a second.
    pub rate_hz: f64,
    /// White noise of a reading, pm, and drift of the zero over the sweep, pm.
    pub noise_pm: f64,
    /// See `noise_pm`.
    pub drift_pm: [f64; 2],
    /// Diameter of the wire that is swept over that of the bench's, on which the map was measured.
    pub thicker: f64,
    /// Whether the base turns when two thirds of the readings in contact are taken, and goes back
    /// after a hold.
    pub returns: bool,
}

/// What is drawn of a sweep beside the usual: the bench follows from the seed alone, so that all
/// kinds of a seed share a calibration.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SweepKind {
    /// Over ellipses and rounded boxes.
    OneWay,
    /// The same, held for half a second and back the same way.
    ThereAndBack,
    /// Over ellipses of half axes of 4 to 8 mm.
    SmallEllipse,
    /// Past a round needle of 0.3 mm radius, across the motion.
    Needle,
    /// One way by another wire than the calibration's: its diameter is off by 1 % (standard
    /// deviation), its stiffness by 4 %; its map is the same.
    OtherWire,
}

impl SweepKind {
    fn outline(self, rng: &mut impl Rng) -> Outline {
        match self {
            Self::SmallEllipse => Outline::Ellipse {
                a_mm: rng.random_range(4.0..8.0),
                b_mm: rng.random_range(4.0..8.0),
            },
            Self::Needle => Outline::Ellipse {
                a_mm: NEEDLE_MM,
                b_mm: NEEDLE_MM,
            },
            _ => Outline::draw(rng),
        }
    }
}

/// A reading of a sweep with its truth.
#[derive(Debug, Clone, PartialEq)]
pub struct SweepReading {
    /// s.
    pub t_s: f64,
    /// Place of the base in the world, whose axes are the base's, mm.
    pub base_mm: V3,
    /// Wavelengths as read, nm.
    pub fbg_nm: [f64; 2],
    /// True moments about base y and z, N mm.
    pub moment_nmm: [f64; 2],
    /// True contact; none where the wire is free.
    pub touch: Option<Touch>,
}

/// A drawn sweep.
#[derive(Debug, Clone, PartialEq)]
pub struct SweepCase {
    /// Seed.
    pub seed: u64,
    /// Scenes that were drawn before this one and are no sweeps.
    pub rejected: u32,
    /// What it is of.
    pub scene: Scene,
    /// In order of time.
    pub readings: Vec<SweepReading>,
}

/// Bench of a foreign wire, and the gain of its map over that of the usual diameter.
fn foreign_bench(rng: &mut impl Rng) -> (Bench, f64) {
    let usual = Bench::draw(rng);
    let diameter_mm = rng.random_range(0.22..0.36_f64);
    let gain = (crate::bench::DIAMETER_MM / diameter_mm).powi(3);
    let straight_mm = rng.random_range(18.0..38.0_f64);
    let youngs_gpa = rng.random_range(55.0..80.0_f64).round();
    let bench = Bench {
        diameter_mm: (1e3 * diameter_mm).round() / 1e3,
        straight_mm: straight_mm.round(),
        arc_radius_mm: rng.random_range(15.0..40.0_f64).round(),
        length_mm: (straight_mm + rng.random_range(18.0..32.0_f64)).round(),
        youngs_gpa,
        shear_gpa: (1e4 * youngs_gpa / 2.66).round() / 1e4,
        k: usual.k.map(|row| row.map(|v| gain * v)),
        ..usual
    };
    (bench, gain)
}

impl Scene {
    fn draw(rng: &mut impl Rng) -> Self {
        let bench = foreign_bench(rng);
        Self::on(bench, rng, Outline::draw)
    }

    /// On a bench.
    fn on<R: Rng>(
        (bench, gain): (Bench, f64),
        rng: &mut R,
        outline: impl Fn(&mut R) -> Outline,
    ) -> Self {
        let wire = bench.wire();
        let side = if rng.random_bool(0.5) { 1.0 } else { -1.0 };
        let [a, b, c] = [0.18, 0.12, 0.18].map(|most: f64| rng.random_range(-most..most));
        let direction = Rotation3::from_euler_angles(a, b, 0.0) * V3::z() * side;
        let outline = outline(rng);
        let body = Body::draw(outline, rng, &wire, c, a);
        let drift = |rng: &mut R| rng.random_range(-0.5..0.5);
        Self {
            friction: if rng.random_bool(0.3) {
                0.0
            } else {
                rng.random_range(0.0..0.3)
            },
            noise_pm: gain * rng.random_range(0.05..0.4),
            drift_pm: [drift(rng), drift(rng)],
            speed_mm_s: rng.random_range(3.0..6.0),
            rate_hz: rng.random_range(5.0..20.0_f64).round(),
            bench,
            body,
            beyond: None,
            direction,
            thicker: 1.0,
            returns: false,
        }
    }

    /// The wire that is swept.
    fn wire(&self) -> Wire {
        Bench {
            diameter_mm: self.bench.diameter_mm * self.thicker,
            ..self.bench.clone()
        }
        .wire()
    }

    /// With a second body, where the wire snaps onto it when it slips off the first; none where it
    /// does not slip off at once.
    fn with_body_beyond(mut self, rng: &mut impl Rng) -> Option<Self> {
        let wire = self.wire();
        let start = self.start(&wire)?;
        // Without friction: where about it slips off is enough.
        let mut slide = Slide::new(&wire, &self.body, 0.0, start);
        let mut touched = false;
        let off_mm = (0..(MAX_WAY_MM / SNAP_STEP_MM) as u32)
            .map(|k| SNAP_STEP_MM * f64::from(k))
            .find(|way| {
                let left = slide.advance(&(start + self.direction * *way)).is_err();
                let was = std::mem::replace(&mut touched, slide.touch.is_some());
                left || (was && !touched)
            })?;
        let [a, c] = [0.18, 0.18].map(|most: f64| rng.random_range(-most..most));
        let outline = Outline::draw(rng);
        let mut beyond = Body::draw(outline, rng, &wire, c, a);
        let depth_mm = rng.random_range(SNAP_DEPTH_MM[0]..SNAP_DEPTH_MM[1]);
        let first = Self {
            body: beyond.clone(),
            ..self.clone()
        }
        .start(&wire)?
            + self.direction * LEAD_MM;
        // The free wire lies so deep in it where it leaves the first.
        beyond.centre_mm += start + self.direction * (off_mm - depth_mm) - first;
        self.beyond = Some(beyond);
        Some(self)
    }

    /// Where the base starts: a little before first touch.
    fn start(&self, wire: &crate::rod::Wire) -> Option<V3> {
        let probe = Slide::new(wire, &self.body, 0.0, V3::zeros());
        // The body's extent along the motion is below 60 mm, that of the wire, too.
        let mut way = -120.0;
        while way < 70.0 {
            if probe.free_gap(&(self.direction * way)).0 < 0.0 {
                return Some(self.direction * (way - LEAD_MM));
            }
            way += 0.5;
        }
        None
    }

    /// Runs the sweep; none where it is none.
    fn run(&self, rng: &mut impl Rng) -> Option<Vec<SweepReading>> {
        let mut readings = self.pass(None)?;
        if self.returns {
            let touches: Vec<f64> = readings
                .iter()
                .filter(|r| r.touch.is_some())
                .map(|r| r.t_s)
                .collect();
            readings = self.pass(touches.get(2 * touches.len() / 3).copied())?;
        }
        self.read(&mut readings, rng);
        Some(readings)
    }

    /// How far the base has gone, mm: on, or from the turn on, after the hold, back as it came.
    fn way_mm(&self, t_s: f64, turn_s: Option<f64>) -> f64 {
        let t_s = match turn_s {
            Some(turn_s) => t_s.min(turn_s) - (t_s - turn_s - HOLD_S).max(0.0),
            None => t_s,
        };
        self.speed_mm_s * t_s + 0.1 * (0.7 * t_s).sin()
    }

    /// True readings of a sweep that turns at a time, or does not.
    fn pass(&self, turn_s: Option<f64>) -> Option<Vec<SweepReading>> {
        let wire = self.wire();
        let start = self.start(&wire)?;
        let mut slide = Slide::new(&wire, &self.body, self.friction, start);
        let mut second = self
            .beyond
            .as_ref()
            .map(|b| Slide::new(&wire, b, self.friction, start));
        let bodies = || std::iter::once(&self.body).chain(&self.beyond);
        let max_moment = wire.ei_nmm2 * MAX_BEND_PER_MM;
        let (mut readings, mut touches, mut free) = (Vec::new(), 0, 0);
        for k in 0.. {
            let t_s = f64::from(k) / self.rate_hz;
            let way = self.way_mm(t_s, turn_s);
            let base_mm = start + self.direction * way;
            slide.advance(&base_mm).ok()?;
            if let Some(next) = second
                .as_mut()
                .filter(|_| slide.touch.is_none() && touches > 0)
            {
                // The wire comes from the first body's side, as if it had met the second alone.
                next.advance(&base_mm).ok()?;
                (slide, second) = (second?, None);
            }
            match &slide.touch {
                Some(t) => {
                    let [y, z] = [t.moment_nmm.y, t.moment_nmm.z];
                    if t.arclength_mm < MIN_ARC_MM
                        || y.hypot(z) > max_moment
                        || bodies().any(|b| slide.overlap_mm(b) > MAX_OVERLAP_MM)
                    {
                        return None;
                    }
                    (touches, free) = (touches + 1, 0);
                }
                None => free += 1,
            }
            let moment_nmm = slide
                .touch
                .map_or([0.0; 2], |t| [t.moment_nmm.y, t.moment_nmm.z]);
            readings.push(SweepReading {
                t_s,
                base_mm,
                fbg_nm: [0.0; 2],
                moment_nmm,
                touch: slide.touch,
            });
            if touches > 0 && free >= FREE_READINGS {
                break;
            }
            if way > MAX_WAY_MM {
                return None;
            }
        }
        (touches >= MIN_TOUCHES).then_some(readings)
    }

    /// Wavelengths of the true moments: map, zero, drift, noise.
    fn read(&self, readings: &mut [SweepReading], rng: &mut impl Rng) {
        let end_s = readings.last().map_or(1.0, |r| r.t_s);
        for r in readings {
            let shift = self.bench.shift_pm(r.moment_nmm);
            r.fbg_nm = [0, 1].map(|c| {
                let noise: f64 = StandardNormal.sample(rng);
                let drift = self.drift_pm[c] * r.t_s / end_s;
                let pm = shift[c] + self.bench.zero_pm[c] + drift + self.noise_pm * noise;
                self.bench.nominal_nm[c] + 1e-3 * pm
            });
        }
    }
}

impl SweepCase {
    /// Draws a sweep.
    ///
    /// # Errors
    /// [`PlantError::Wire`] where no draw is a sweep.
    pub fn draw(seed: u64) -> Result<Self, PlantError> {
        Self::of(seed, |rng| Some(Scene::draw(rng)))
    }

    /// Draws a sweep in which the wire slips off a body and snaps onto another: the contact leaps.
    ///
    /// # Errors
    /// As [`SweepCase::draw`].
    pub fn draw_with_slip(seed: u64) -> Result<Self, PlantError> {
        Self::of(seed, |rng| Scene::draw(rng).with_body_beyond(rng))
    }

    /// Draws a sweep of a kind.
    ///
    /// # Errors
    /// As [`SweepCase::draw`].
    pub fn draw_kind(seed: u64, kind: SweepKind) -> Result<Self, PlantError> {
        let bench = foreign_bench(&mut ChaCha8Rng::seed_from_u64(seed));
        Self::of(seed ^ ((kind as u64 + 1) << 40), |rng| {
            let scene = Scene::on(bench.clone(), rng, |rng| kind.outline(rng));
            let off: f64 = StandardNormal.sample(rng);
            let thicker = if kind == SweepKind::OtherWire {
                1.0 + OTHER_DIAMETER * off
            } else {
                1.0
            };
            Some(Scene {
                thicker,
                returns: kind == SweepKind::ThereAndBack,
                ..scene
            })
        })
    }

    /// The same scene under another friction, with other noise; none where that is no sweep.
    pub fn under_friction(&self, friction: f64) -> Option<Self> {
        let scene = Scene {
            friction,
            ..self.scene.clone()
        };
        let readings = scene.run(&mut ChaCha8Rng::seed_from_u64(!self.seed))?;
        Some(Self {
            scene,
            readings,
            ..self.clone()
        })
    }

    fn of(seed: u64, scene: impl Fn(&mut ChaCha8Rng) -> Option<Scene>) -> Result<Self, PlantError> {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        for rejected in 0..MAX_DRAWS {
            let Some(scene) = scene(&mut rng) else {
                continue;
            };
            if let Some(readings) = scene.run(&mut rng) {
                return Ok(Self {
                    seed,
                    rejected,
                    scene,
                    readings,
                });
            }
        }
        Err(WireError::NoEquilibrium {
            residual: f64::INFINITY,
        }
        .into())
    }

    /// The 27 poses of the same sensor.
    ///
    /// # Errors
    /// As [`session::draw`].
    pub fn session(&self) -> Result<Case, PlantError> {
        let request = Request {
            seed: self.seed,
            design: Design::Paper,
            want: CaseKind::Null,
            target_sigma: 0.0,
            rivals: false,
        };
        session::draw_on(&request, self.scene.bench.clone())
    }

    /// Standard deviation of the moments by the noise of a reading, N mm.
    pub fn noise_nmm(&self) -> f64 {
        let [[a, b], [c, d]] = self.scene.bench.k;
        self.scene.noise_pm / (a * d - b * c).abs().sqrt()
    }

    /// Writes `session/` (27 poses), and the files of [`SweepCase::write_record`] into a folder.
    ///
    /// # Errors
    /// [`PlantError::Write`] with the file that could not be written, and those of
    /// [`SweepCase::session`].
    pub fn write(&self, folder: &Path) -> Result<(), PlantError> {
        self.session()?.write(&folder.join("session"))?;
        self.write_record(folder)
    }

    /// Writes `readings.csv`, `base.csv`, `object.stl` (world frame) and `truth.csv` into a folder.
    ///
    /// # Errors
    /// [`PlantError::Write`] with the file that could not be written.
    pub fn write_record(&self, folder: &Path) -> Result<(), PlantError> {
        let mut readings = "k,t_s,fbg_ref_nm,temperature_degc,fbg_1_nm,fbg_2_nm\n".to_owned();
        let mut base = "t_s,base_x_mm,base_y_mm,base_z_mm\n".to_owned();
        let mut truth =
            "k,t_s,contact,arclength_mm,axis_x_mm,axis_y_mm,axis_z_mm,mobilised,moment_1_nmm,moment_2_nmm\n"
                .to_owned();
        for (k, r) in self.readings.iter().enumerate() {
            let [a, b] = r.fbg_nm;
            let reference = self.scene.bench.reference_nominal_nm;
            let _ = writeln!(
                readings,
                "{k},{:.6},{reference:.6},{:.3},{a:.7},{b:.7}",
                r.t_s,
                crate::bench::REFERENCE_DEGC
            );
            let _ = writeln!(
                base,
                "{:.6},{:.5},{:.5},{:.5}",
                r.t_s, r.base_mm.x, r.base_mm.y, r.base_mm.z
            );
            let place = r.touch.as_ref().map_or_else(
                || "0,,,,,".to_owned(),
                |t| {
                    let p = t.axis_mm;
                    format!(
                        "1,{:.4},{:.5},{:.5},{:.5},{:.3}",
                        t.arclength_mm, p.x, p.y, p.z, t.mobilised
                    )
                },
            );
            let _ = writeln!(
                truth,
                "{k},{:.6},{place},{:.6},{:.6}",
                r.t_s, r.moment_nmm[0], r.moment_nmm[1]
            );
        }
        put(&folder.join("SIMULATED"), "")?;
        put(&folder.join("readings.csv"), &readings)?;
        put(&folder.join("base.csv"), &base)?;
        put(&folder.join("truth.csv"), &truth)?;
        let bodies = [Some(&self.scene.body), self.scene.beyond.as_ref()];
        let facets: String = bodies.into_iter().flatten().map(Body::facets).collect();
        put(
            &folder.join("object.stl"),
            &format!("solid body\n{facets}endsolid body\n"),
        )
    }
}
