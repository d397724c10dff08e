//! Projection, its slopes and its inverse, for every lens.

use nalgebra::{Vector2, Vector3};
use wcal_vision::camera::Camera;
use wcal_vision::camera::{FISHEYE, Lens, MAX_COEFFICIENTS, OPENCV5, lenses};

fn camera_with(lens: &'static dyn Lens) -> Camera {
    let own = if lens == OPENCV5 {
        [-0.27, 0.06, 0.001, -0.002, 0.03]
    } else {
        [-0.04, 0.012, -0.006, 0.001, 0.0]
    };
    let mut distortion = [0.0; MAX_COEFFICIENTS];
    let count = lens.coefficient_names().len();
    distortion[..count].copy_from_slice(&own[..count]);
    Camera {
        image_size_px: [640, 480],
        focal_px: [535.0, 530.0],
        centre_px: [335.0, 240.0],
        lens,
        distortion,
    }
}

/// Largest difference of the analytic derivatives from central differences, over the derivative's
/// own size.
fn worst_difference(camera: &Camera, p: Vector3<f64>) -> f64 {
    let (_, by_point, by_camera) = camera.project_with_jacobian(&p).unwrap();
    let mut worst = 0.0f64;
    for k in 0..3 {
        let h = 1e-6;
        let (mut a, mut b) = (p, p);
        a[k] -= h;
        b[k] += h;
        let numeric = (camera.project(&b).unwrap() - camera.project(&a).unwrap()) / (2.0 * h);
        worst = worst.max((numeric - by_point.column(k)).norm() / numeric.norm().max(1.0));
    }
    for k in 0..camera.intrinsics() {
        let h = 1e-6 * camera.parameters()[k].abs().max(1.0);
        let (mut a, mut b) = (camera.parameters(), camera.parameters());
        a[k] -= h;
        b[k] += h;
        let numeric = (camera.with_parameters(&b).project(&p).unwrap()
            - camera.with_parameters(&a).project(&p).unwrap())
            / (2.0 * h);
        worst = worst.max((numeric - by_camera.column(k)).norm() / numeric.norm().max(1.0));
    }
    worst
}

#[test]
fn jacobians_agree_with_finite_differences() {
    for camera in lenses().map(camera_with) {
        // Off the axis, near it, and so near that quotients are taken by their series.
        for p in [(0.31, -0.22), (0.02, 0.03), (3e-5, -4e-5), (0.0, 0.0)] {
            let worst = worst_difference(&camera, Vector3::new(p.0, p.1, 1.1));
            assert!(worst < 1e-5, "{} at {p:?}: {worst}", camera.lens.model());
        }
    }
    // Negative control: the derivative at one place is not that at another.
    let fisheye = camera_with(FISHEYE);
    let wide = Vector3::new(1.5, 0.8, 1.0);
    assert!(worst_difference(&fisheye, wide) < 1e-5);
    let there = fisheye
        .project_with_jacobian(&Vector3::new(1.6, 0.8, 1.0))
        .unwrap()
        .1;
    let here = fisheye.project_with_jacobian(&wide).unwrap().1;
    assert!((here - there).norm() > 1e-2 * here.norm());
}

#[test]
fn undistortion_inverts_projection() {
    let (cameras, fisheye) = (lenses().map(camera_with), camera_with(FISHEYE));
    let near = [(0.5, 0.4), (-0.5, 0.1), (1e-5, 2e-5), (0.0, 0.0)];
    // 76 degrees from the axis.
    let wide = [(3.0, 2.6), (-1.2, 2.0)];
    let near = cameras
        .iter()
        .flat_map(|camera| near.iter().map(move |n| (camera, n)));
    let each = near.chain(wide.iter().map(|n| (&fisheye, n)));
    for (camera, &(x, y)) in each {
        let px = camera.project(&Vector3::new(x, y, 1.0)).unwrap();
        let n = camera.undistort(&px).unwrap();
        assert!(
            (n - Vector2::new(x, y)).norm() < 1e-10 * n.norm().max(1.0),
            "{} {n}",
            camera.lens.model()
        );
    }
    // What no direction before the camera shows has none.
    assert_eq!(
        fisheye.undistort(&Vector2::new(335.0 + 535.0 * 1.9, 240.0)),
        None
    );
}

#[test]
fn a_fisheye_sees_behind_its_plane() {
    let fisheye = camera_with(FISHEYE);
    // 84 to 116 degrees from the axis, and along it.
    for p in [
        (2.0, 0.3, 0.2),
        (2.0, -0.3, 0.0),
        (-1.0, 0.6, -0.1),
        (0.3, 0.8, -0.4),
        (0.0, 0.0, 1.0),
    ] {
        let p = Vector3::new(p.0, p.1, p.2);
        assert!(worst_difference(&fisheye, p) < 1e-5, "{p}");
        let ray = fisheye.ray(&fisheye.project(&p).unwrap()).unwrap();
        assert!(
            (ray.normalize() - p.normalize()).norm() < 1e-9,
            "{ray} for {p}"
        );
    }
    assert_eq!(fisheye.project(&Vector3::new(0.0, 0.0, -1.0)), None);
    // Negative control: a pinhole sees nothing there.
    assert_eq!(
        camera_with(OPENCV5).project(&Vector3::new(2.0, 0.3, -0.1)),
        None
    );
}

/// The fisheye as the equation in OpenCV's documentation gives it, worked out by hand for theta =
/// 45 degrees along x.
#[test]
fn the_fisheye_is_opencvs() {
    let fisheye = camera_with(FISHEYE);
    let theta = std::f64::consts::FRAC_PI_4;
    let [k1, k2, k3, k4, _] = fisheye.distortion;
    let bent = theta
        * (1.0 + k1 * theta.powi(2) + k2 * theta.powi(4) + k3 * theta.powi(6) + k4 * theta.powi(8));
    let px = fisheye.project(&Vector3::new(2.0, 0.0, 2.0)).unwrap();
    assert!(
        (px - Vector2::new(535.0 * bent + 335.0, 240.0)).norm() < 1e-9,
        "{px}"
    );
}
