//! Projection, its slopes and its inverse.

use nalgebra::{Vector2, Vector3};
use wcal_vision::camera::{Camera, INTRINSICS};

fn camera() -> Camera {
    Camera {
        image_size_px: [640, 480],
        focal_px: [535.0, 530.0],
        centre_px: [335.0, 240.0],
        distortion: [-0.27, 0.06, 0.001, -0.002, 0.03],
    }
}

#[test]
fn jacobians_agree_with_finite_differences() {
    let (camera, p) = (camera(), Vector3::new(0.31, -0.22, 1.1));
    let (_, by_point, by_camera) = camera.project_with_jacobian(&p).unwrap();
    for k in 0..3 {
        let h = 1e-6;
        let (mut a, mut b) = (p, p);
        a[k] -= h;
        b[k] += h;
        let numeric = (camera.project(&b).unwrap() - camera.project(&a).unwrap()) / (2.0 * h);
        assert!((numeric - by_point.column(k)).norm() < 1e-5 * numeric.norm().max(1.0));
    }
    for k in 0..INTRINSICS {
        let h = 1e-6 * camera.parameters()[k].abs().max(1.0);
        let (mut a, mut b) = (camera.parameters(), camera.parameters());
        a[k] -= h;
        b[k] += h;
        let numeric = (camera.with_parameters(&b).project(&p).unwrap()
            - camera.with_parameters(&a).project(&p).unwrap())
            / (2.0 * h);
        assert!((numeric - by_camera.column(k)).norm() < 1e-5 * numeric.norm().max(1.0), "{k}");
    }
}

#[test]
fn undistortion_inverts_projection() {
    let camera = camera();
    for (x, y) in [(0.5, 0.4), (-0.5, 0.1), (0.0, 0.0)] {
        let px = camera.project(&Vector3::new(x, y, 1.0)).unwrap();
        let n = camera.undistort(&px).unwrap();
        assert!((n - Vector2::new(x, y)).norm() < 1e-10);
    }
}
