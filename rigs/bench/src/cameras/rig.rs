//! The bench's camera rig: where the cameras stand, tags, groove block, chessboard, and what can be
//! wrong with them.

use nalgebra::{Isometry3, Matrix3, Rotation3, Translation3, UnitQuaternion, Vector3};

use super::faces::{Face, Paint};
use super::lens::{Lens, look_at};
use super::scene::{Groove, View};
use super::tags::{TAG_CELLS, tag_cells};

type V3 = Vector3<f64>;

/// Reflectances: printed black and white, base, groove block.
const INK: [f64; 2] = [0.19, 0.80];
const BASE_SHADE: f64 = 0.47;
const BLOCK_SHADE: f64 = 0.60;
/// Depth of the V and breadth of the block on either side of it, mm.
const V_DEPTH_MM: f64 = 1.5;
const BLOCK_HALF_MM: f64 = 4.5;
const BLOCK_FLOOR_MM: f64 = 1.5;

/// Left and right camera of the bench: 290 mm before the wire (it sees the side of base y < 0), 120
/// mm apart, rolled by 45 degrees; lenses as in the ray-traced pictures of fixtures/stereo_bench
/// (focal length 3460 px at a width of 1280 px), scaled to the size.
pub fn default_pair(size_px: [usize; 2]) -> [Lens; 2] {
    let scale = size_px[0] as f64 / 1280.0;
    let target = V3::new(28.0, 0.0, -13.5);
    let lens = |focal: f64, centre: [f64; 2], distortion: [f64; 5], place: V3| {
        // A pixel of another size keeps the same field of view; the picture's height is cut about
        // its middle.
        let middle = 0.5 * (size_px[1] as f64 - 960.0 * scale);
        let centre_px = [
            scale * (centre[0] + 0.5) - 0.5,
            scale * (centre[1] + 0.5) - 0.5 + middle,
        ];
        let pose = look_at(&place, &target, &V3::new(1.0, 0.0, 1.0));
        Lens::new(
            size_px,
            [scale * focal, scale * (focal - 1.0)],
            centre_px,
            distortion,
            pose,
        )
    };
    [
        lens(
            3453.0,
            [652.5, 479.2],
            [-0.139, 0.2, -1.5e-4, 1.9e-4, 0.0],
            V3::new(-14.4, -288.6, -53.2),
        ),
        lens(
            3466.0,
            [636.3, 470.5],
            [-0.140, 0.2, 3.6e-4, -0.9e-4, 0.0],
            V3::new(71.3, -290.2, 30.3),
        ),
    ]
}

/// What is wrong with the rig and not declared; a camera that was moved since the board was shown
/// is another [`Lens`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CameraFaults {
    /// True over stated side of the board's squares.
    pub board_scale: f64,
    /// Where the rig tag truly is, seen from where the rig file puts it.
    pub rig_tag_moved: Isometry3<f64>,
}

impl Default for CameraFaults {
    fn default() -> Self {
        Self {
            board_scale: 1.0,
            rig_tag_moved: Isometry3::identity(),
        }
    }
}

/// A chessboard.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Board {
    /// Inner corners across and down.
    pub corners: [usize; 2],
    /// Stated side of a square, mm.
    pub square_mm: f64,
}

impl Default for Board {
    /// 9 x 6 inner corners of 6 mm.
    fn default() -> Self {
        Self {
            corners: [9, 6],
            square_mm: 6.0,
        }
    }
}

/// Tags and groove as the rig file states them.
#[derive(Debug, Clone, PartialEq)]
pub struct RigGeometry {
    /// Side of the tags' black squares, mm.
    pub tag_size_mm: f64,
    /// Ids of the tags on the base and on the rig.
    pub tag_ids: [u32; 2],
    /// Pose of the base's tag; the rig's tag has the same attitude, for the stage only shifts it.
    pub base_from_tag: Isometry3<f64>,
    /// The wire's centre in the vertex, rig tag's frame, mm.
    pub groove_in_tag_mm: V3,
    /// Half angle of the V, degrees.
    pub half_angle_deg: f64,
    /// Width of the groove along the wire, mm.
    pub groove_width_mm: f64,
    /// Wire diameter, mm.
    pub diameter_mm: f64,
    /// Board.
    pub board: Board,
    /// What is wrong.
    pub faults: CameraFaults,
}

impl Default for RigGeometry {
    /// The rig of fixtures/stereo_bench/rig.toml.
    fn default() -> Self {
        // Tag axes: x right (base -x), y down (base +z), z into the tag (base +y).
        let axes = Matrix3::new(-1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 1.0, 0.0);
        let turn = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(axes));
        Self {
            tag_size_mm: 10.0,
            tag_ids: [0, 1],
            base_from_tag: Isometry3::from_parts(Translation3::new(-6.0, -9.0, -12.0), turn),
            groove_in_tag_mm: V3::new(-10.0, 22.0, 6.0),
            half_angle_deg: 45.0,
            groove_width_mm: 3.0,
            diameter_mm: 0.3,
            board: Board::default(),
            faults: CameraFaults::default(),
        }
    }
}

impl RigGeometry {
    /// The bench with a wire (points from root to tip, base frame, mm) and the groove with its tag,
    /// where they are in view.
    pub fn scene(&self, wire: Vec<V3>, groove: Option<&Groove>) -> View {
        let mut faces = block([-16.0, -6.0, -5.0], [0.0, 6.0, 5.0]);
        faces.extend(self.tag(0, self.base_from_tag));
        if let Some(groove) = groove {
            let turn = self.base_from_tag.rotation;
            let place = groove.position_mm - turn * self.groove_in_tag_mm;
            let declared = Isometry3::from_parts(place.into(), turn);
            faces.extend(self.tag(1, declared * self.faults.rig_tag_moved));
            faces.extend(self.groove_block(groove));
        }
        View {
            faces,
            wire,
            diameter_mm: self.diameter_mm,
        }
    }

    /// The board in attitude `k`: about the middle of both pictures, tilted by up to 28 degrees, no
    /// two alike.
    pub fn board_view(&self, k: usize) -> View {
        // Fractional parts of multiples of the plastic number's powers fill the range evenly
        // (Roberts 2018, R_d sequences, d = 4).
        let spread =
            |n: i32| ((k as f64 + 1.0) * 0.856_674_883_854_502_9_f64.powi(n)).fract() * 2.0 - 1.0;
        let tilt = V3::new(0.48 * spread(1), 0.48 * spread(2), 0.25 * spread(3));
        // Facing the cameras, its long side along the pictures'.
        let x = V3::new(1.0, 0.0, 1.0).normalize();
        let shift = x * (13.0 * spread(4))
            + V3::y().cross(&x) * (8.0 * spread(2))
            + V3::y() * (8.0 * spread(3));
        let axes = Matrix3::from_columns(&[x, V3::y().cross(&x), V3::y()]);
        let facing = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(axes));
        let pose = Isometry3::from_parts(
            (V3::new(28.0, 0.0, -13.5) + shift).into(),
            facing * UnitQuaternion::from_scaled_axis(tilt),
        );
        let squares = self.board.corners.map(|n| n + 1);
        let square_mm = self.board.square_mm * self.faults.board_scale;
        // A white margin: without one detectors do not find the outer squares.
        let half = squares.map(|n| (0.5 * n as f64 + 0.7) * square_mm);
        let paint = Paint::Board {
            squares,
            square_mm,
            shades: INK,
        };
        View {
            faces: vec![Face::sheet(pose, half, paint)],
            wire: Vec::new(),
            diameter_mm: self.diameter_mm,
        }
    }

    fn tag(&self, which: usize, base_from_tag: Isometry3<f64>) -> Option<Face> {
        let cells = tag_cells(self.tag_ids[which])?;
        // Ten cells across, of which the black square has eight.
        let half = self.tag_size_mm * TAG_CELLS as f64 / 16.0;
        let paint = Paint::Tag {
            cells,
            size_mm: self.tag_size_mm,
            shades: INK,
        };
        Some(Face::sheet(base_from_tag, [half; 2], paint))
    }

    /// Block with a V along the wire; the wire's centre stands off the vertex by its radius over
    /// the sine of the half angle.
    fn groove_block(&self, groove: &Groove) -> Vec<Face> {
        let half_angle = self.half_angle_deg.to_radians();
        let along = groove.axis.normalize();
        let up = (groove.push - along * groove.push.dot(&along)).normalize();
        let side = along.cross(&up);
        let vertex = groove.position_mm - up * (0.5 * self.diameter_mm / half_angle.sin());
        let rim = V_DEPTH_MM * half_angle.tan();
        let half_width = 0.5 * self.groove_width_mm;
        let at = |s: f64, h: f64, end: f64| vertex + side * s + up * h + along * (end * half_width);
        let mut faces = Vec::new();
        // Flanks, tops, sides and floor are strips between two lines along the wire.
        let section = [
            (-BLOCK_HALF_MM, -BLOCK_FLOOR_MM, 0.80),
            (-BLOCK_HALF_MM, V_DEPTH_MM, 1.0),
            (-rim, V_DEPTH_MM, 0.92),
            (0.0, 0.0, 0.96),
            (rim, V_DEPTH_MM, 1.0),
            (BLOCK_HALF_MM, V_DEPTH_MM, 0.86),
            (BLOCK_HALF_MM, -BLOCK_FLOOR_MM, 0.78),
        ];
        for (k, &(s, h, light)) in section.iter().enumerate() {
            let (s1, h1, _) = section[(k + 1) % section.len()];
            let strip = [
                at(s, h, -1.0),
                at(s1, h1, -1.0),
                at(s1, h1, 1.0),
                at(s, h, 1.0),
            ];
            faces.extend(Face::through(&strip, BLOCK_SHADE * light));
        }
        for (end, light) in [(-1.0, 0.90), (1.0, 0.88)] {
            for sign in [-1.0, 1.0] {
                let half: Vec<V3> = [
                    (0.0, 0.0),
                    (rim, V_DEPTH_MM),
                    (BLOCK_HALF_MM, V_DEPTH_MM),
                    (BLOCK_HALF_MM, -BLOCK_FLOOR_MM),
                    (0.0, -BLOCK_FLOOR_MM),
                ]
                .iter()
                .map(|(s, h)| at(sign * s, *h, end))
                .collect();
                faces.extend(Face::through(&half, BLOCK_SHADE * light));
            }
        }
        faces
    }
}

/// An upright box between two corners, lit from the upper left.
fn block(low: [f64; 3], high: [f64; 3]) -> Vec<Face> {
    let corner = |k: usize| {
        V3::new(
            [low, high][k & 1][0],
            [low, high][k >> 1 & 1][1],
            [low, high][k >> 2 & 1][2],
        )
    };
    let sides = [
        ([0, 1, 5, 4], 1.0),
        ([2, 3, 7, 6], 1.0),
        ([0, 2, 6, 4], 0.9),
        ([1, 3, 7, 5], 0.86),
        ([0, 1, 3, 2], 0.8),
        ([4, 5, 7, 6], 1.1),
    ];
    sides
        .iter()
        .filter_map(|(c, light)| Face::through(&c.map(corner), BASE_SHADE * light))
        .collect()
}
