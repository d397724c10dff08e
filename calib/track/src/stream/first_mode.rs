//! First mode of the free wire.

use wcal_core::observation::{RestShape, WhiskerSpec};

/// First bending mode of a straight clamped wire of the whisker's length, in air, Hz: 1.8751^2 / (2 pi L^2) sqrt(E I / (rho A)).
///
/// A pre-curved wire and water differ by some ten percent (34 Hz in water, docs/src/system.md); its users allow for that.
pub fn first_mode_hz(whisker: &WhiskerSpec) -> f64 {
    let length_mm = match &whisker.rest_shape {
        RestShape::StraightArc { length_mm, .. } => *length_mm,
        RestShape::Polyline(points) => points.windows(2).map(|w| (w[1] - w[0]).norm()).sum(),
    };
    let (d, l) = (whisker.diameter_mm * 1e-3, length_mm * 1e-3);
    // sqrt(E I / (rho A)) of a round wire: d / 4 sqrt(E / rho).
    let speed = d / 4.0 * (whisker.youngs_gpa * 1e9 / whisker.density_or_niti_kg_m3()).sqrt();
    1.875_104_f64.powi(2) / (std::f64::consts::TAU * l * l) * speed
}

#[cfg(test)]
mod tests {
    use super::first_mode_hz;
    use wcal_core::observation::WhiskerSpec;

    #[test]
    fn the_papers_wire_rings_near_forty_hertz() {
        let whisker = WhiskerSpec::nominal();
        let hz = first_mode_hz(&whisker);
        assert!((hz - 39.75).abs() < 0.1, "{hz}");
        // 34 Hz in water lies in the band of the detector.
        assert!((0.6 * hz..1.5 * hz).contains(&34.0));
        assert!((first_mode_hz(&WhiskerSpec { diameter_mm: 0.6, ..whisker }) / hz - 2.0).abs() < 1e-9);
    }
}
