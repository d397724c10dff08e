//! What a pair of cameras makes of the wire, without drawing pictures: `shapes.json` with noise,
//! errors that all pairs share, and faults of the cameras' setup (SIMULATED).
//!
//! ```text
//! z = true shape + own noise (each pair) + S q (shared: a shift and turn of the base's frame, the board's scale) + fault
//! ```

use nalgebra::{DMatrix, DVector, Vector3};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use serde_json::{Value, json};

type V3 = Vector3<f64>;

/// Spacing of the centre line's points, mm.
pub const STEP_MM: f64 = 0.5;
/// Every so many points of the line is a station.
const STATION_EVERY: usize = 8;

/// The wire at one pose, as it is.
#[derive(Debug, Clone, PartialEq)]
pub struct WireAtPose {
    /// The wire's centre in the groove, base frame, mm.
    pub groove_mm: V3,
    /// Arc length of the contact, mm.
    pub arclength_mm: f64,
    /// Tangent there.
    pub tangent: V3,
    /// Centre line from the root on, mm.
    pub line_mm: Vec<V3>,
    /// Arc lengths of its points, mm.
    pub arcs_mm: Vec<f64>,
}

/// How well the cameras see.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Cameras {
    /// Noise of each pair, every direction, mm.
    pub own_mm: f64,
    /// Shift that all pairs share, each axis, mm.
    pub shift_mm: f64,
    /// Turn that all pairs share, each axis, rad.
    pub turn_rad: f64,
    /// Error of the board's scale that is stated.
    pub scale: f64,
    /// What the pairs state of their own noise, as a share of what it is.
    pub stated: f64,
}

impl Default for Cameras {
    fn default() -> Self {
        Self {
            own_mm: 0.02,
            shift_mm: 0.01,
            turn_rad: 2e-4,
            scale: 1e-4,
            stated: 1.0,
        }
    }
}

impl Cameras {
    /// As usual, with a statement of their own noise that is too small, right, or too large, by the
    /// session's seed.
    pub fn of_session(seed: u64) -> Self {
        const STATED: [f64; 4] = [0.85, 1.0, 1.3, 1.7];
        Self {
            stated: STATED[(seed % 4) as usize],
            ..Self::default()
        }
    }
}

/// A fault of the cameras' setup.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Fault {
    /// None.
    None,
    /// Every length is off by this factor less one.
    BoardScale(f64),
    /// The rig tag sits this far off, mm.
    RigTag([f64; 3]),
    /// Everything is displaced by this much from this share of the pairs on, mm.
    Moved([f64; 3], f64),
}

/// What an error does: to the groove, the contact's arc length and the stations, mm.
struct Column {
    groove: V3,
    arc: f64,
    stations: Vec<V3>,
}

impl Column {
    fn json(&self, share: f64) -> Value {
        let three = |v: &V3| [v.x * share, v.y * share, v.z * share];
        json!({
            "centreline_mm": self.stations.iter().map(three).collect::<Vec<_>>(),
            "groove_mm": three(&self.groove),
            "contact_arclength_mm": self.arc * share,
            "length_mm": 0.0,
        })
    }
}

/// Size of a change of the contacts in standard deviations of what the cameras state: groove and
/// arc length, shared errors included.
pub fn contact_sigma(with: &[WireAtPose], without: &[WireAtPose], cameras: &Cameras) -> f64 {
    let rows = 4 * with.len();
    let mut change = DVector::zeros(rows);
    let mut own = DMatrix::zeros(rows, rows);
    let mut shared = DMatrix::zeros(rows, 7);
    let variance = cameras.own_mm.powi(2);
    for (k, (a, b)) in with.iter().zip(without).enumerate() {
        let at = 4 * k;
        change
            .fixed_rows_mut::<3>(at)
            .copy_from(&(a.groove_mm - b.groove_mm));
        change[at + 3] = a.arclength_mm - b.arclength_mm;
        // Along the wire the tag errs, and the foot with it; across it the wire does.
        own.fixed_view_mut::<3, 3>(at, at).fill_with_identity();
        own.fixed_view_mut::<3, 1>(at, at + 3).copy_from(&b.tangent);
        own.fixed_view_mut::<1, 3>(at + 3, at)
            .copy_from(&b.tangent.transpose());
        own[(at + 3, at + 3)] = 1.25;
        for (j, axis) in [V3::x(), V3::y(), V3::z()].iter().enumerate() {
            shared
                .fixed_view_mut::<3, 1>(at, j)
                .copy_from(&(axis * cameras.shift_mm));
            shared
                .fixed_view_mut::<3, 1>(at, 3 + j)
                .copy_from(&(axis.cross(&b.groove_mm) * cameras.turn_rad));
        }
        shared
            .fixed_view_mut::<3, 1>(at, 6)
            .copy_from(&(b.groove_mm * cameras.scale));
        shared[(at + 3, 6)] = b.arclength_mm * cameras.scale;
    }
    let covariance = own * variance + &shared * shared.transpose();
    covariance
        .cholesky()
        .map_or(f64::NAN, |c| change.dot(&c.solve(&change)).sqrt())
}

/// Two unit vectors across `t`.
fn across(t: &V3) -> [V3; 2] {
    let far = if t.y.abs() < 0.7 { V3::y() } else { V3::z() };
    let first = t.cross(&far).normalize();
    [first, t.cross(&first)]
}

/// Errors that a pair has of its own, as `stations` of its line see them.
fn own_errors(s: &WireAtPose, stations: &[usize], own_mm: f64) -> Vec<Column> {
    let zeros = || vec![V3::zeros(); stations.len()];
    let mut own = Vec::new();
    // Along the wire the tag errs, and the foot with it; across it the wire does.
    own.push(Column {
        groove: s.tangent * own_mm,
        arc: own_mm,
        stations: zeros(),
    });
    own.extend(across(&s.tangent).map(|n| Column {
        groove: n * own_mm,
        arc: 0.0,
        stations: zeros(),
    }));
    own.push(Column {
        groove: V3::zeros(),
        arc: 0.5 * own_mm,
        stations: zeros(),
    });
    for (i, at) in stations.iter().enumerate() {
        let next = s.line_mm[(at + 1).min(s.line_mm.len() - 1)];
        let before = s.line_mm[at.saturating_sub(1)];
        for n in across(&(next - before).normalize()) {
            let mut moved = zeros();
            moved[i] = n * own_mm;
            own.push(Column {
                groove: V3::zeros(),
                arc: 0.0,
                stations: moved,
            });
        }
    }
    own
}

/// Errors that all pairs share, in the order of `shared_parameters`, as `places` of a pair see
/// them.
fn shared_errors(s: &WireAtPose, places: &[V3]) -> Vec<Column> {
    let zeros = || vec![V3::zeros(); places.len()];
    let axes = [V3::x(), V3::y(), V3::z()];
    let mut shared: Vec<Column> = axes
        .iter()
        .map(|a| Column {
            groove: *a,
            arc: 0.0,
            stations: vec![*a; places.len()],
        })
        .collect();
    shared.extend(axes.iter().map(|a| Column {
        groove: a.cross(&s.groove_mm),
        arc: 0.0,
        stations: places.iter().map(|p| a.cross(p)).collect(),
    }));
    let scaled = || Column {
        groove: s.groove_mm,
        arc: s.arclength_mm,
        stations: places.to_vec(),
    };
    shared.push(scaled());
    // Taken as known by the pictures' evaluation: their derivatives say what a fault would do.
    shared.push(scaled());
    shared.extend(axes.iter().map(|a| {
        let along = s.tangent.dot(a);
        Column {
            groove: s.tangent * along,
            arc: along,
            stations: zeros(),
        }
    }));
    shared
}

/// Pair `k` of so many as pictures would give it: its errors drawn, and the fault.
fn pair_json(
    (point, s): (usize, &WireAtPose),
    cameras: &Cameras,
    (fault, k, count): (Fault, usize, usize),
    q: &[f64],
    normal: &mut dyn FnMut() -> f64,
) -> Value {
    let stations: Vec<usize> = (0..s.line_mm.len()).step_by(STATION_EVERY).collect();
    let places: Vec<V3> = stations.iter().map(|&i| s.line_mm[i]).collect();
    let own = own_errors(s, &stations, cameras.own_mm);
    let shared = shared_errors(s, &places);
    let (mut groove, mut arc, mut line) = (s.groove_mm, s.arclength_mm, s.line_mm.clone());
    // Errors and faults of groove and contact, by their derivatives.
    let mut sizes = q.to_vec();
    sizes.resize(shared.len(), 0.0);
    let later = |from: f64| k as f64 >= from * (count - 1) as f64;
    match fault {
        Fault::None => {}
        Fault::BoardScale(e) => sizes[7] += e,
        Fault::RigTag(offset) => (0..3).for_each(|a| sizes[8 + a] += offset[a]),
        Fault::Moved(by, from) if later(from) => (0..3).for_each(|a| sizes[a] += by[a]),
        Fault::Moved(..) => {}
    }
    for (c, size) in shared.iter().zip(&sizes) {
        groove += c.groove * *size;
        arc += c.arc * size;
    }
    // The line's points take the same shared errors and faults as the stations.
    let turn = V3::new(q[3], q[4], q[5]);
    let shift = V3::new(q[0], q[1], q[2]);
    for p in &mut line {
        let mut by = shift + turn.cross(p) + *p * q[6];
        match fault {
            Fault::BoardScale(e) => by += *p * e,
            Fault::Moved(m, from) if later(from) => by += V3::from(m),
            _ => {}
        }
        *p += by;
    }
    for c in &own {
        let size = normal();
        groove += c.groove * size;
        arc += c.arc * size;
        for (i, by) in stations.iter().zip(&c.stations) {
            line[*i] += by * size;
        }
    }
    let sd = (cameras.stated * cameras.own_mm).hypot(cameras.shift_mm);
    json!({
        "name": format!("{point:05}"),
        "status": "ok",
        "point": point,
        "centreline_mm": line.iter().map(|p| [p.x, p.y, p.z]).collect::<Vec<_>>(),
        "centreline_sd_mm": vec![sd; line.len()],
        "length_mm": s.arcs_mm.last(),
        "groove": {
            "position_mm": [groove.x, groove.y, groove.z],
            "sd_mm": [sd, sd, sd],
            "contact_arclength_mm": arc,
            "contact_arclength_sd_mm": sd,
            "axis": [s.tangent.x, s.tangent.y, s.tangent.z],
            "contact": "vertex",
        },
        "errors": {
            "stations": stations,
            "stations_mm": stations.iter().map(|i| s.arcs_mm[*i]).collect::<Vec<_>>(),
            "own": own.iter().map(|c| c.json(cameras.stated)).collect::<Vec<_>>(),
            "floor_mm": 1e-3,
            "shared": shared.iter().map(|c| c.json(1.0)).collect::<Vec<_>>(),
        },
    })
}

/// `shapes.json` of the poses `shown`, each with its point.
pub fn shapes_json(
    session: &str,
    shown: &[(usize, WireAtPose)],
    cameras: &Cameras,
    fault: Fault,
    seed: u64,
) -> Value {
    let mut rng = ChaCha8Rng::seed_from_u64(seed ^ 0x5eed_cafe);
    let mut normal = || -> f64 { StandardNormal.sample(&mut rng) };
    // A shift and a turn of the base's frame and the scale of the board: one draw for all pairs.
    let q: Vec<f64> = [cameras.shift_mm; 3]
        .iter()
        .chain(&[cameras.turn_rad; 3])
        .chain(&[cameras.scale])
        .map(|sd| sd * normal())
        .collect();
    let mut pairs = Vec::new();
    for (k, (point, s)) in shown.iter().enumerate() {
        pairs.push(pair_json(
            (*point, s),
            cameras,
            (fault, k, shown.len()),
            &q,
            &mut normal,
        ));
    }
    let named =
        |name: &str, unit: &str, cause: &str| json!({"name": name, "unit": unit, "cause": cause});
    let parameters = vec![
        named("base-tag x", "mm", "base-tag"),
        named("base-tag y", "mm", "base-tag"),
        named("base-tag z", "mm", "base-tag"),
        named("base-tag rx", "rad", "base-tag"),
        named("base-tag ry", "rad", "base-tag"),
        named("base-tag rz", "rad", "base-tag"),
        named("right_from_left scale", "1", "cameras"),
        named("board-scale", "1", "board-scale"),
        named("rig-tag x", "mm", "rig-tag"),
        named("rig-tag y", "mm", "rig-tag"),
        named("rig-tag z", "mm", "rig-tag"),
    ];
    let (s, t) = (cameras.shift_mm, cameras.turn_rad);
    let sds = [s, s, s, t, t, t, cameras.scale, 0.0, 0.0, 0.0, 0.0];
    let covariance: Vec<Vec<f64>> = (0..sds.len())
        .map(|i| {
            (0..sds.len())
                .map(|j| if i == j { sds[i] * sds[i] } else { 0.0 })
                .collect()
        })
        .collect();
    json!({
        "format": "wcal-shapes/1",
        "pairs": pairs,
        "shared_parameters": parameters,
        "shared_covariance": covariance,
        "source": {"cameras_sha256": "", "rig_sha256": "", "session": session},
        "warnings": ["SIMULATED by the examiner's plant"],
    })
}
