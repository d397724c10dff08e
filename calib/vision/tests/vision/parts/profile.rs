//! The table of erf.

use wcal_vision::profile::erf_with_slope;

#[test]
fn erf_and_its_slope_agree_with_statrs() {
    for k in -5400..=5400 {
        let x = f64::from(k) * 1e-3 + 3e-4;
        let (value, slope) = erf_with_slope(x);
        assert!((value - statrs::function::erf::erf(x)).abs() < 2e-8, "{x}");
        let exact = std::f64::consts::FRAC_2_SQRT_PI * (-x * x).exp();
        assert!((slope - exact).abs() < 1e-5, "{x}");
    }
    assert_eq!(erf_with_slope(f64::NAN).1, 0.0);
}
