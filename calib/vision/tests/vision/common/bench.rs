//! A bench drawn by the tests themselves (simulated pictures): two cameras, a base tag, wires with
//! a highlight across them, uneven background, blur, tone curve and noise. The wires' shapes are
//! known to the micrometre.

use nalgebra::{Isometry3, Matrix3, Point3, Rotation3, UnitQuaternion, Vector2, Vector3};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use rand_distr::{Distribution, Normal};
use std::collections::HashMap;
use wcal_vision::camera::Camera;
use wcal_vision::camera::OPENCV5;
use wcal_vision::picture::Picture;
use wcal_vision::tags::apriltag_ffi::draw_tag;

pub const WIDTH: usize = 1280;
pub const HEIGHT: usize = 960;
pub const LENGTH_MM: f64 = 60.0;

/// How a bench looks.
#[derive(Debug, Clone, Copy)]
pub struct Style {
    pub diameter_mm: f64,
    /// Grey values of the wire, of a highlight on it, and of the background behind it.
    pub wire_dn: f64,
    pub highlight_dn: f64,
    pub background_dn: f64,
    /// Amplitude of waves in the background.
    pub texture_dn: f64,
    pub blur_px: f64,
    pub noise_dn: f64,
    /// Arc lengths between which a block 3 mm wide hides the wire from both cameras, mm; equal:
    /// none.
    pub covered_mm: [f64; 2],
}

impl Default for Style {
    fn default() -> Self {
        Self {
            diameter_mm: 0.3,
            wire_dn: 62.0,
            highlight_dn: 35.0,
            background_dn: 170.0,
            texture_dn: 12.0,
            blur_px: 0.75,
            noise_dn: 1.2,
            covered_mm: [0.0; 2],
        }
    }
}

/// The rig file of the drawn bench.
pub const RIG: &str = r#"
[whisker]
diameter_mm = 0.3
length_mm = 60.0
straight_mm = 30.0
arc_radius_mm = 20.0
[[tags]]
id = 0
family = "tag36h11"
size_mm = 10.0
body = "base"
base_from_tag = [[1, 0, 0, -6], [0, 0, 1, -9], [0, -1, 0, -12], [0, 0, 0, 1]]
"#;

pub fn cameras() -> [Camera; 2] {
    let camera = |f: f64, cx: f64| Camera {
        image_size_px: [WIDTH, HEIGHT],
        focal_px: [f, f + 2.0],
        centre_px: [cx, 470.0],
        lens: OPENCV5,
        distortion: [-0.14, 0.2, 2e-4, -1e-4, 0.0],
    };
    [camera(3450.0, 650.0), camera(3465.0, 636.0)]
}

/// Both cameras look at the middle of the wire from 290 mm, 120 mm apart.
pub fn camera_from_base(camera: usize) -> Isometry3<f64> {
    // Camera axes in the base frame: x along x, y along -z, z along y.
    let facing = Rotation3::from_matrix_unchecked(Matrix3::new(
        1.0, 0.0, 0.0, 0.0, 0.0, -1.0, 0.0, 1.0, 0.0,
    ));
    let turn = UnitQuaternion::from_scaled_axis(Vector3::new(0.02, [0.207, -0.207][camera], 0.01));
    Isometry3::from_parts(
        Vector3::new(0.0, 0.0, 290.0).into(),
        turn * UnitQuaternion::from_rotation_matrix(&facing),
    ) * Isometry3::translation(-24.0, 0.0, 8.0)
}

/// A wire from the root: nominal shape and a smooth bend that grows from `seed`; points every 0.05
/// mm.
pub fn wire(seed: u64) -> Vec<Vector3<f64>> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let normal = Normal::new(0.0, 0.008).unwrap();
    let waves: Vec<[f64; 2]> = (0..3)
        .map(|_| [normal.sample(&mut rng), normal.sample(&mut rng)])
        .collect();
    let step = 0.05;
    let (mut p, mut frame) = (Vector3::zeros(), Matrix3::identity());
    let mut points = vec![p];
    for k in 0..(LENGTH_MM / step).round() as usize {
        let s = (k as f64 + 0.5) * step;
        let nominal = if s > 30.0 { 0.05 } else { 0.0 };
        let bend = |d: usize| -> f64 {
            waves
                .iter()
                .enumerate()
                .map(|(n, w)| w[d] * (n as f64 * std::f64::consts::PI * s / LENGTH_MM).cos())
                .sum()
        };
        let turn = Vector3::new(0.0, -(bend(1) - nominal), bend(0)) * (0.5 * step);
        let half = Rotation3::from_scaled_axis(turn);
        let middle = frame * half.matrix();
        p += middle.column(0) * step;
        frame = middle * half.matrix();
        points.push(p);
    }
    points
}

/// A piece of a wire's image, px, and whether it is the wire's first or last.
#[derive(Clone, Copy)]
struct Segment {
    a: Vector2<f64>,
    b: Vector2<f64>,
    half: f64,
    first: bool,
    last: bool,
    cover: bool,
}

/// Draws what one camera sees.
pub fn draw(camera: usize, wires: &[&[Vector3<f64>]], seed: u64, style: &Style) -> Picture {
    let eye = &cameras()[camera];
    let pose = camera_from_base(camera);
    // Segments of 0.25 mm, listed at every pixel that they may touch.
    let mut segments: Vec<Segment> = Vec::new();
    let mut near: HashMap<(i64, i64), Vec<usize>> = HashMap::new();
    for wire in wires {
        let see = |p: &Vector3<f64>| {
            let x = pose * Point3::from(*p);
            (
                eye.project(&x.coords).unwrap(),
                0.5 * style.diameter_mm * eye.focal_px[0] / x.z,
            )
        };
        let places: Vec<_> = wire.iter().step_by(5).map(see).collect();
        let count = places.len() - 1;
        for (k, w) in places.windows(2).enumerate() {
            let (a, b, half) = (w[0].0, w[1].0, w[0].1);
            let arc_mm = k as f64 * 0.25;
            let cover = arc_mm >= style.covered_mm[0] && arc_mm < style.covered_mm[1];
            let half = if cover {
                half * 3.0 / style.diameter_mm
            } else {
                half
            };
            let (lo, hi) = (a.inf(&b), a.sup(&b));
            let reach = half + 1.5;
            for y in (lo.y - reach) as i64..=(hi.y + reach) as i64 {
                for x in (lo.x - reach) as i64..=(hi.x + reach) as i64 {
                    near.entry((x, y)).or_default().push(segments.len());
                }
            }
            segments.push(Segment {
                a,
                b,
                half,
                first: k == 0,
                last: k + 1 == count,
                cover,
            });
        }
    }
    let tag = draw_tag("tag36h11", 0).unwrap();
    let base_from_tag = Isometry3::from_parts(
        Vector3::new(-6.0, -9.0, -12.0).into(),
        UnitQuaternion::from_matrix(&Matrix3::new(1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, -1.0, 0.0)),
    );
    let tag_pose = pose * base_from_tag;
    let centre = eye.project(&tag_pose.translation.vector).unwrap();
    let surface = |x: f64, y: f64| -> f64 {
        let waves = (0.011 * x).sin() * (0.013 * y).cos();
        let background = style.background_dn + 0.02 * (x - 640.0) + style.texture_dn * waves;
        if (x - centre.x).abs() > 110.0 || (y - centre.y).abs() > 110.0 {
            return background;
        }
        match super::on_plane(eye, &tag_pose, x, y) {
            // 8 cells between the corners of 10 mm, one more of white around them.
            Some(p) if p.x.abs() < 6.25 && p.y.abs() < 6.25 => {
                let cell = |v: f64| ((v / 1.25 + 5.0) as usize).min(9);
                40.0 + f64::from(tag.data[cell(p.y) * tag.width + cell(p.x)]) / 255.0 * 170.0
            }
            _ => background,
        }
    };
    let level = |x: f64, y: f64, list: &[usize]| -> f64 {
        let p = Vector2::new(x, y);
        let mut best: Option<f64> = None;
        for &k in list {
            let Segment {
                a,
                b,
                half,
                first,
                last,
                cover,
            } = segments[k];
            let run = b - a;
            let along = (p - a).dot(&run) / run.norm_squared();
            // The wire's ends are cut square.
            if (along < 0.0 && first) || (along > 1.0 && last) {
                continue;
            }
            let t = along.clamp(0.0, 1.0);
            let off = p - a - run * t;
            let across = off.norm() / half * run.perp(&off).signum();
            if cover && across.abs() < 1.0 {
                return 120.0;
            }
            if across.abs() < 1.0 && best.is_none_or(|o| across.abs() < o.abs()) {
                best = Some(across);
            }
        }
        // Darker toward one side, with a highlight off the middle.
        let lit = |u: f64| style.highlight_dn * (-((u + 0.35) / 0.3).powi(2)).exp();
        best.map_or_else(|| surface(x, y), |u| style.wire_dn + 10.0 * u + lit(u))
    };
    let mut light = vec![0.0f64; WIDTH * HEIGHT];
    for y in 0..HEIGHT {
        for x in 0..WIDTH {
            let list = near.get(&(x as i64, y as i64)).map_or(&[][..], |l| l);
            let (fx, fy) = (x as f64, y as f64);
            let on_tag = (fx - centre.x).abs() < 111.0 && (fy - centre.y).abs() < 111.0;
            light[y * WIDTH + x] = if list.is_empty() && !on_tag {
                surface(fx, fy)
            } else {
                let at = |k: i32| (f64::from(k) + 0.5) / 5.0 - 0.5;
                (0..25)
                    .map(|k| level(fx + at(k % 5), fy + at(k / 5), list))
                    .sum::<f64>()
                    / 25.0
            };
        }
    }
    finish(&light, seed, style)
}

/// Lens blur, the camera's tone curve, noise and 8 bits.
fn finish(light: &[f64], seed: u64, style: &Style) -> Picture {
    let blurred = super::blurred(light, WIDTH, HEIGHT, style.blur_px);
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let normal = Normal::new(0.0, style.noise_dn).unwrap();
    let data = blurred
        .iter()
        .map(|v| {
            let toned = 255.0 * (v / 255.0).clamp(0.0, 1.0).powf(0.9);
            (toned + normal.sample(&mut rng)).round().clamp(0.0, 255.0) as u8
        })
        .collect();
    Picture::new(WIDTH, HEIGHT, data).unwrap()
}
