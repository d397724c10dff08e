//! Test data: the measured set, and a smooth plant of known truth.

use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution as _, Normal};
use std::path::Path;
use wcal_gpr::MapTraining;

/// The measured set with the released labels (27 poses and rest).
pub(crate) fn whiskerfbg() -> MapTraining {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fixtures/whiskerfbg");
    let points = table(&folder.join("points.csv"));
    let twin = table(&folder.join("twin.csv"));
    let mut out = MapTraining::default();
    for row in &points {
        let number = |name: &str| {
            row.iter()
                .find(|(n, _)| n == name)
                .unwrap()
                .1
                .parse::<f64>()
        };
        let point = number("point").unwrap() as i64;
        let label = twin
            .iter()
            .find(|t| t[0].1.parse::<i64>().unwrap() == point)
            .unwrap();
        out.point.push(point);
        out.shifts_pm
            .push(["fbg_1_shift_nm", "fbg_2_shift_nm"].map(|name| 1e3 * number(name).unwrap()));
        out.moments_nmm
            .push([1, 2].map(|c| label[c].1.parse().unwrap()));
        let role = &row.iter().find(|(n, _)| n == "role").unwrap().1;
        out.trajectory
            .push((role != "rest").then(|| number("trajectory").unwrap() as u32));
    }
    out
}

fn table(path: &Path) -> Vec<Vec<(String, String)>> {
    let text = std::fs::read_to_string(path).unwrap();
    let mut lines = text.lines();
    let header: Vec<String> = lines
        .next()
        .unwrap()
        .split(',')
        .map(str::to_owned)
        .collect();
    lines
        .map(|l| {
            header
                .iter()
                .cloned()
                .zip(l.split(',').map(str::to_owned))
                .collect()
        })
        .collect()
}

/// Simulated sensor: K of the usual size, a bend of the law, and noise of the readings.
pub(crate) struct Plant {
    /// Quadratic part at 1 N mm, share of the linear one.
    pub bend: f64,
    /// Noise of each label, N mm.
    pub noise_nmm: f64,
}

impl Plant {
    /// True moments at a shift, N mm (simulated).
    pub(crate) fn moment_nmm(&self, s: [f64; 2]) -> [f64; 2] {
        let (a, b) = (s[0] / 80.0, s[1] / 80.0);
        let linear = [1.1 * a - 0.35 * b, 0.2 * a + 0.9 * b];
        [
            linear[0] + self.bend * (a * b + 0.4 * (1.5 * a).sin()),
            linear[1] + self.bend * (b * b - 0.3 * (1.3 * b).cos()),
        ]
    }

    /// `trajectories` x 3 readings and one at rest (simulated).
    pub(crate) fn draw(&self, trajectories: u32, seed: u64) -> MapTraining {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let noise = Normal::new(0.0, self.noise_nmm).unwrap();
        let mut out = MapTraining::default();
        let mut push = |s: [f64; 2], trajectory: Option<u32>, rng: &mut ChaCha8Rng| {
            out.point.push(out.point.len() as i64);
            out.shifts_pm.push(s);
            out.moments_nmm
                .push(self.moment_nmm(s).map(|m| m + noise.sample(rng)));
            out.trajectory.push(trajectory);
        };
        for t in 1..=trajectories {
            let angle: f64 = rng.random_range(0.0..std::f64::consts::TAU);
            for k in 1..=3 {
                let r = 40.0 * f64::from(k) * rng.random_range(0.8..1.0);
                push([r * angle.cos(), r * angle.sin()], Some(t), &mut rng);
            }
        }
        push([0.0, 0.0], None, &mut rng);
        out
    }
}
