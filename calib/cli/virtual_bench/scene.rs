//! What the virtual bench's cameras see: the plant's wire, groove and tags at the stage's position,
//! or its chessboard.

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use std::sync::{Mutex, PoisonError};
use wcal_bench::cameras::{
    Appearance, Board, CameraFaults, Groove, Lens, RigGeometry, View, clean, default_pair, exposed,
};
use wcal_bench::rod::Wire;
use wcal_bench::table::{Path, equilibrium};
use wcal_drivers::bench::scenario::{CameraScenario, WhiskerScenario};
use wcal_drivers::bench::scene::{Scene, SceneState};

/// Deepest push that is tabulated, as a share of the contact's arc length; the paper's go to 0.29.
pub(super) const REACH: f64 = 0.4;

/// Pieces of the drawn centre line, mm.
const STEP_MM: f64 = 0.25;

/// A trajectory's path, and the stage position past first declared contact at which it truly
/// touches, mm.
pub(crate) struct ScenePath {
    pub id: u32,
    pub path: Path,
    pub touch_mm: f64,
}

/// The bench before the cameras.
pub(crate) struct BenchScene {
    wire: Wire,
    paths: Vec<ScenePath>,
    rig: RigGeometry,
    look: Appearance,
    /// Width of the sensors, px.
    width_px: u32,
    /// Cameras of each size that was asked for.
    cameras: Mutex<Vec<([u32; 2], [Lens; 2])>>,
    /// Each camera's last picture before noise, which holds as long as nothing moves.
    last: [Mutex<Option<LastPicture>>; 2],
}

struct LastPicture {
    state: SceneState,
    size_px: [u32; 2],
    clean: Vec<f32>,
}

fn pose(mm: [f64; 3], deg: [f64; 3]) -> Isometry3<f64> {
    let turn = UnitQuaternion::from_scaled_axis(Vector3::from(deg).map(f64::to_radians));
    Isometry3::from_parts(Translation3::from(mm), turn)
}

impl BenchScene {
    /// The bench of a scenario.
    pub(crate) fn new(
        wire: Wire,
        whisker: &WhiskerScenario,
        paths: Vec<ScenePath>,
        cameras: &CameraScenario,
    ) -> Self {
        let errors = &cameras.errors;
        let faults = CameraFaults {
            board_scale: errors.board_scale,
            rig_tag_moved: pose(errors.rig_tag_mm, errors.rig_tag_deg),
        };
        let board = Board {
            corners: cameras.board_corners,
            square_mm: cameras.board_square_mm,
        };
        let rig = RigGeometry {
            diameter_mm: whisker.diameter_mm,
            board,
            faults,
            ..RigGeometry::default()
        };
        let look = Appearance {
            uneven: cameras.uneven_light,
            blur_px: cameras.blur_px,
            read_noise_dn: cameras.noise_dn,
            ..Appearance::default()
        };
        let width_px = cameras.size_px[0];
        Self {
            wire,
            paths,
            rig,
            look,
            width_px,
            cameras: Mutex::default(),
            last: Default::default(),
        }
    }

    fn lens(&self, camera: usize, state: &SceneState, size_px: [u32; 2]) -> Lens {
        let mut cameras = self.cameras.lock().unwrap_or_else(PoisonError::into_inner);
        if !cameras.iter().any(|(size, _)| *size == size_px) {
            cameras.push((size_px, default_pair(size_px.map(|s| s as usize))));
        }
        let found = cameras
            .iter()
            .find(|(size, _)| *size == size_px)
            .map_or(&cameras[0].1, |(_, pair)| pair);
        let lens = &found[camera.min(1)];
        // The board was shown before the second camera was knocked.
        if camera == 1 && state.board.is_none() {
            lens.moved(&pose(state.moved.0, state.moved.1))
        } else {
            lens.clone()
        }
    }

    fn view(&self, state: &SceneState) -> View {
        if let Some(k) = state.board {
            return self.rig.board_view(k);
        }
        let rest = || self.wire.centre_line(None, STEP_MM);
        let Some(ScenePath { path, touch_mm, .. }) =
            self.paths.iter().find(|p| p.id == state.trajectory)
        else {
            return self.rig.scene(rest(), None);
        };
        let reach_mm = REACH * path.arclength_mm;
        let depth_mm = state.depth_mm.min(reach_mm);
        let at = path.at(depth_mm);
        let groove = |axis| Groove {
            position_mm: at,
            axis,
            push: path.direction,
        };
        // Until it is touched the wire keeps its rest shape, and the groove lies along it.
        if depth_mm <= *touch_mm {
            let (_, tangent) = self.wire.rest(path.arclength_mm);
            return self.rig.scene(rest(), Some(&groove(tangent)));
        }
        match equilibrium(&self.wire, path, reach_mm, depth_mm) {
            Ok(e) => {
                let line = self.wire.centre_line(Some((&at, &e)), STEP_MM);
                self.rig.scene(line, Some(&groove(e.tangent)))
            }
            // No wire is drawn rather than a wrong one.
            Err(_) => self.rig.scene(Vec::new(), Some(&groove(Vector3::x()))),
        }
    }
}

impl Scene for BenchScene {
    fn picture(&self, camera: usize, state: &SceneState, size_px: [u32; 2], seed: u64) -> Vec<u8> {
        let mut last = self.last[camera.min(1)]
            .lock()
            .unwrap_or_else(PoisonError::into_inner);
        let lens = self.lens(camera, state, size_px);
        let look = Appearance {
            exposure_dn: self.look.exposure_dn * state.exposure,
            // The lens blurs fewer of the blocks that are read as one pixel.
            blur_px: self.look.blur_px * f64::from(size_px[0]) / f64::from(self.width_px),
            ..self.look
        };
        // While nothing moves, only the noise of the next picture is new.
        let kept = last
            .take()
            .filter(|l| l.state == *state && l.size_px == size_px);
        let kept = kept.unwrap_or_else(|| LastPicture {
            state: *state,
            size_px,
            clean: clean(&lens, &self.view(state), &look),
        });
        let grey = exposed(&kept.clean, &look, seed);
        *last = Some(kept);
        grey
    }
}
