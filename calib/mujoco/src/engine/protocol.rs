//! What `wcal` and `wcal-mujoco` say to each other: one request a line, one reply a line. SI units,
//! world frame.

use super::fluid::FluidLoads;
use serde::{Deserialize, Serialize};

/// What is asked.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(tag = "do", rename_all = "kebab-case")]
pub enum Request {
    /// Who is there.
    Hello,
    /// A model (MJCF); with the cable plugin where it needs it.
    Load {
        /// Text.
        xml: String,
        /// Whether the elasticity plugin is to be loaded first.
        cable_plugin: bool,
    },
    /// Steps with the slide `base` led: constant acceleration from `speed_m_s`; the solver sees its
    /// speed.
    Lead {
        /// Speed at the start, m/s.
        speed_m_s: f64,
        /// Acceleration, m/s^2.
        acceleration_m_s2: f64,
        /// Steps.
        steps: u64,
    },
    /// Steps under new control values until the body has moved by less than `moved_m` over the last
    /// ten of them.
    Control {
        /// One an actuator.
        control: Vec<f64>,
        /// Control values of ten more steps after each; empty: none. The body then ends near there.
        retreat: Vec<f64>,
        /// Whether the places before the request count among the ten.
        goes_on: bool,
        /// Body that is watched.
        body: String,
        /// Least movement, m.
        moved_m: f64,
        /// Most steps, without those of the retreat.
        steps: u64,
    },
    /// Steps.
    Run {
        /// How many.
        steps: u64,
    },
    /// Steps with a force on the wire; it grows over the first half of them. The force stays until
    /// the next request.
    Push {
        /// Link.
        body: String,
        /// Place on the link's axis, m.
        along_m: f64,
        /// Force, N.
        force_n: [f64; 3],
        /// Steps.
        steps: u64,
    },
    /// Steps with the base moment noted.
    Series {
        /// How many.
        steps: u64,
        /// Every so many.
        every: u64,
    },
    /// Weight, buoyancy and drag on the wire from now on, as forces on its links: MuJoCo's own
    /// fluid forces do not reach a joint's springs as a load does.
    Medium {
        /// In the library's own units (mm): the library computes the forces.
        medium: FluidLoads,
    },
    /// Goes back to the start.
    Reset,
    /// Convex parts of a closed surface.
    Decompose(Decompose),
}

/// A surface to be decomposed.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Decompose {
    /// Corners, any unit.
    pub points: Vec<[f64; 3]>,
    /// Triangles.
    pub triangles: Vec<[i32; 3]>,
    /// Largest concavity of a part, share of the size.
    pub threshold: f64,
    /// Most parts; -1: as many as it takes.
    pub most_parts: i32,
    /// Seed.
    pub seed: u32,
}

/// A convex part: its corners.
pub type Part = Vec<[f64; 3]>;

/// What is answered.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(tag = "is", rename_all = "kebab-case")]
pub enum Reply {
    /// The engine.
    Hello {
        /// Version of libmujoco.
        mujoco: String,
    },
    /// A model is loaded.
    LoadedModel(LoadedModel),
    /// State after the steps.
    Frame(Frame),
    /// Base moment over time.
    Series(Series),
    /// Convex parts.
    Parts {
        /// Their corners.
        parts: Vec<Part>,
    },
    /// It did not work.
    Refused {
        /// Why.
        why: String,
    },
}

/// A loaded model.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct LoadedModel {
    /// Degrees of freedom.
    pub freedoms: usize,
    /// Step, s.
    pub step_s: f64,
}

/// State after some steps; extremes are since the frame before.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Frame {
    /// Time, s.
    pub time_s: f64,
    /// Steps taken.
    pub steps: u64,
    /// Moment about the root that the first joint's springs and dampers carry, N m: it sees all
    /// forces. None in a model without them.
    pub base_moment_nm: Option<[f64; 3]>,
    /// The springs' share.
    pub base_elastic_nm: Option<[f64; 3]>,
    /// The torque sensor `torque`, turned into the world's axes, N m.
    pub sensor_nm: Option<[f64; 3]>,
    /// Touching pairs of geoms.
    pub contacts: Vec<Touching>,
    /// Fastest joint, rad/s or m/s.
    pub fastest: f64,
    /// Deepest overlap since the frame before, m.
    pub deepest_m: f64,
    /// Steps at which the wire as a whole came free or touched.
    pub toggles: u64,
    /// Whether MuJoCo warned of a bad number.
    pub bad: bool,
    /// Processor time of the program, s.
    pub core_s: f64,
    /// Origins of the links, m, root first; the tip's end is the last.
    pub links_m: Vec<[f64; 3]>,
}

/// A contact of two geoms.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Touching {
    /// Link, from the root.
    pub link: usize,
    /// Name of the other geom.
    pub other: String,
    /// Middle of the overlap, m.
    pub point_m: [f64; 3],
    /// Overlap below 0, gap above, m.
    pub gap_m: f64,
    /// Direction from the other body to the wire.
    pub normal: [f64; 3],
    /// Force on the wire, N.
    pub force_n: [f64; 3],
}

/// Base moment over time.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Series {
    /// Time, s.
    pub time_s: Vec<f64>,
    /// Elastic base moment, N m.
    pub base_elastic_nm: Vec<[f64; 3]>,
    /// Speed of the tip, m/s.
    pub tip_speed_m_s: Vec<f64>,
    /// Whether the wire touches something.
    pub touching: Vec<bool>,
    /// Whether MuJoCo warned of a bad number.
    pub bad: bool,
}
