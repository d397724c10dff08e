//! A wavelength-to-moment map as the coefficients of its formula.
//!
//! mean = offset + k(z) alpha + h(z) beta, half width = t95 f sqrt(s2 (k(0) - |v|^2 + |w|^2 + nu)),
//! F [v; w] = [k; h]: `wcal_gpr::Process`.

use crate::error::CalibrationError;
use crate::exported::Export;
use wcal_gpr::{Kernel, MapArtefact, MapPredictor, half95};

/// The covariance factor has half of the square of the readings in numbers.
const MAX_READINGS: usize = 512;
/// Readings whose answers are kept for the self-test.
const KEPT: usize = 16;

pub(crate) fn of_map(map: &MapArtefact) -> Result<Export, CalibrationError> {
    let refuse = |why: String| Err(CalibrationError::NotExported(why));
    let (predictor, fbg) = (MapPredictor::new(map)?, &map.fbg);
    let count = map.training_pm.len();
    if count > MAX_READINGS {
        return refuse(format!(
            "expected a map of at most {MAX_READINGS} readings, found {count}"
        ));
    }
    // Shifts count from nominal wavelengths, where the table has wavelengths.
    let (by_wavelength, referenced) = (fbg.nominal_nm.is_some(), fbg.needs_reference());
    if by_wavelength && referenced && fbg.reference_nominal_nm.is_none() {
        return refuse("expected `reference_nominal_nm` in the map, found none".to_owned());
    }
    let [a, b] = fbg.nominal_nm.unwrap_or_default();
    let reference = fbg.reference_nominal_nm.filter(|_| by_wavelength);
    let nominal_nm = [a, b, reference.unwrap_or_default()];
    let [first, second, third] = if by_wavelength {
        ["fbg_1_nm", "fbg_2_nm", "fbg_ref_nm"]
    } else {
        ["fbg_1_shift_nm", "fbg_2_shift_nm", "fbg_ref_shift_nm"]
    };
    // What comes off for each pm of the reference grating.
    let own = fbg.temperature_pm_per_degc.filter(|_| referenced);
    let other = fbg.reference_temperature_pm_per_degc.unwrap_or(1.0);
    let shares = own.unwrap_or_default().map(|k| k / other);
    // Answers beside readings of the fit, and one far outside.
    let beside = |s: &[f64; 2]| [s[0] + 0.01 * map.scale_pm, s[1] - 0.02 * map.scale_pm];
    let far = map.centre_pm[0] + 10.0 * map.valid_region.margin_pm + 100.0 * map.scale_pm;
    let kept = map.training_pm.iter().step_by(count.div_ceil(KEPT));
    let (mut stored, mut largest) = (Vec::new(), [0.0_f64; 2]);
    for shift_pm in kept.map(beside).chain([[far, map.centre_pm[1]]]) {
        // The reference grating is 50 pm off, where there is one.
        let [x, y] = [0, 1].map(|c| nominal_nm[c] + 1e-3 * (shift_pm[c] + 50.0 * shares[c]));
        let p = predictor.predict(shift_pm);
        let ([m, n], [h, i]) = (p.moment_nmm, p.half95_nmm);
        let outside = f64::from(u8::from(!p.is_valid()));
        stored.push(vec![x, y, nominal_nm[2] + 0.05, m, n, h, i, outside]);
        let of = [m.abs().max(n.abs()), h.max(i)];
        largest = [0, 1].map(|c| largest[c].max((1.0 - outside) * of[c]));
    }
    let moments = map.outputs.iter().map(|out| {
        let form = match out.kernel {
            Kernel::None => 0.0,
            Kernel::ThinPlate { .. } => 1.0,
            Kernel::Matern52 { .. } => 2.0,
        };
        vec![
            out.alpha.len() as f64,
            out.beta.len() as f64,
            form,
            out.kernel.shape().unwrap_or(1.0),
            out.offset_nmm,
            out.variance_nmm2,
            out.nugget,
            half95(out.dof) * out.inflation,
        ]
    });
    let scaled = |s: &[f64; 2]| {
        [0, 1]
            .map(|c| (s[c] - map.centre_pm[c]) / map.scale_pm)
            .to_vec()
    };
    let flat = |values: Vec<f64>| values.into_iter().map(|v| vec![v]).collect::<Vec<_>>();
    let [factor_1, factor_2] = predictor.factors();
    let [one, two] = &map.outputs;
    Ok(Export {
        template: "map",
        inputs: [Some(first), Some(second), referenced.then_some(third)],
        units: ["nm".to_owned(), "N mm".to_owned()],
        numbers: vec![
            ("READINGS", vec![vec![count as f64]]),
            (
                "CORNERS",
                vec![vec![map.valid_region.vertices_pm.len() as f64]],
            ),
            ("NOMINAL", flat(nominal_nm.to_vec())),
            ("SHARES", flat(shares.to_vec())),
            ("CENTRE", flat(map.centre_pm.to_vec())),
            ("SCALE", vec![vec![map.scale_pm]]),
            ("FITTED", map.training_pm.iter().map(scaled).collect()),
            (
                "HULL",
                map.valid_region
                    .vertices_pm
                    .iter()
                    .map(|v| v.to_vec())
                    .collect(),
            ),
            ("MARGIN", vec![vec![map.valid_region.margin_pm]]),
            ("MOMENTS", moments.collect()),
            ("COEFFICIENTS_1", flat([&one.alpha[..], &one.beta].concat())),
            ("COEFFICIENTS_2", flat([&two.alpha[..], &two.beta].concat())),
            ("FACTOR_1", flat(factor_1)),
            ("FACTOR_2", flat(factor_2)),
            ("STORED", stored),
            ("TOLERANCE", flat(largest.map(|v| 1e-6 * v).to_vec())),
        ],
        points: None,
    })
}
