//! Calibrations that no command may use.

use super::*;

/// A sealed calibration.json around a model.
pub(crate) fn calibration(model: serde_json::Value) -> serde_json::Value {
    let mut file = wcal_core::CalibrationFile {
        format: wcal_core::calibration::CALIBRATION_FORMAT.to_owned(),
        session: "s".to_owned(),
        verification: wcal_core::VerificationStatus::Verified,
        expires: None,
        model,
        provenance: wcal_core::Provenance::default(),
        whisker: None,
        contact_uncertainty: None,
        frame: None,
        noise: None,
        content_sha256: String::new(),
    };
    file.content_sha256 = file.compute_hash().unwrap();
    serde_json::to_value(&file).unwrap()
}

pub(crate) fn models() -> [serde_json::Value; 3] {
    let fbg = serde_json::json!({
        "nominal_nm": [1541.2, 1535.8], "reference_nominal_nm": null, "temperature_pm_per_degc": null,
        "reference_temperature_pm_per_degc": null, "temperature_compensated": true,
    });
    let square = |size: usize| vec![vec![0.0; size]; size];
    let physical = serde_json::json!({
        "kind": "physical", "coefficients": [[3.0, -2.0], [72.0, -6.0], [9.0, 78.0], [1.5, 0.3], [-0.4, 0.2], [0.6, -1.0]],
        "covariance": square(14), "noise_sd_pm": 0.5, "seatings": 1, "fbg": fbg, "largest_moment_nmm": 1.0,
        "effects": [
            {"id": "fbg-nonlinearity", "law": "quadratic", "values": [], "parameters": []},
            {"id": "hysteresis", "law": "play", "values": [0.02, 0.1], "parameters": []},
        ],
    });
    let output = serde_json::json!({
        "trend": "constant", "kernel": {"form": "none"}, "nugget": 0.01, "variance_nmm2": 1.0, "dof": null, "inflation": 1.0,
        "offset_nmm": 0.0, "beta": [0.1], "alpha": [],
    });
    let triangle = [[0.0, 0.0], [100.0, 0.0], [0.0, 100.0]];
    let map = serde_json::json!({
        "kind": "map", "version": 1, "name": "affine", "labels": "rod", "centre_pm": [0.0, 0.0], "scale_pm": 100.0,
        "training_pm": triangle, "outputs": [output, output], "fbg": fbg,
        "valid_region": {"kind": "hull", "vertices_pm": triangle, "margin_pm": 10.0},
        "law": {"zero_pm": [0.0, 0.0], "k_pm_per_nmm": [[72.0, 9.0], [-6.0, 78.0]], "residual_sd_pm": [1.0, 1.0]},
    });
    let scalar = serde_json::json!({
        "kind": "scalar", "session_kind": "transducer", "stimulus_unit": "N", "response_unit": "V", "covariates": [],
        "declared": {"polynomial": 1}, "effects": [{"id": "nonlinearity-quadratic", "law": "power-2", "values": []}],
        "scaling": {"mid": 5.0, "half": 5.0, "time": null, "temperature": null, "covariates": [], "count": 20},
        "coefficients": [1.0, 2.0, 0.1], "covariance": square(3), "variance": 0.01, "dof": 17.0, "offset": 0.0, "spread": null,
        "stimulus_range": [0.0, 10.0], "polynomial": null, "lack_of_fit": [null, null],
    });
    [physical, map, scalar]
}

/// A whisker's.
pub(crate) fn whisker_calibration() -> serde_json::Value {
    let [physical, ..] = models();
    let mut file: wcal_core::CalibrationFile<serde_json::Value> =
        serde_json::from_value(calibration(physical)).unwrap();
    file.whisker = Some(wcal_core::WhiskerSpec::nominal());
    file.content_sha256 = file.compute_hash().unwrap();
    serde_json::to_value(&file).unwrap()
}

#[test]
fn calibrations_are_refused_by_name_before_anything_is_computed() {
    let place = tempfile::tempdir().unwrap();
    fs::write(
        place.path().join("whisker.csv"),
        "fbg_1_nm,fbg_2_nm\n1541.21,1535.81\n",
    )
    .unwrap();
    fs::write(place.path().join("scalar.csv"), "stimulus\n1\n2\n").unwrap();
    let run = |file: &serde_json::Value, table: &str| {
        fs::write(place.path().join("c.json"), file.to_string()).unwrap();
        wcal(
            place.path(),
            &[
                "predict",
                table,
                "--calibration",
                "c.json",
                "--out",
                "out.csv",
            ],
        )
    };
    let [physical, map, scalar] = models();
    for (model, table) in [
        (&physical, "whisker.csv"),
        (&map, "whisker.csv"),
        (&scalar, "scalar.csv"),
    ] {
        // Control: as they are, they predict.
        judge(&run(&calibration(model.clone()), table), 0, &[])
            .unwrap_or_else(|e| panic!("{}: {e}", model["kind"]));
        fs::remove_file(place.path().join("out.csv")).unwrap();
    }
    let none: [f64; 0] = [];
    let far = 4_000_000_000_u32;
    let cases: &[(&serde_json::Value, &str, serde_json::Value, &[&str])] = &[
        (
            &physical,
            "/effects/0/id",
            "fbg-teleport".into(),
            &["catalogue", "fbg-teleport", "quadratic"],
        ),
        (
            &physical,
            "/effects/1/law",
            "quantum".into(),
            &["catalogue", "hysteresis", "quantum"],
        ),
        (
            &physical,
            "/effects/1/values",
            vec![0.02].into(),
            &["values of hysteresis (play)", "expected 2, found 1"],
        ),
        (
            &physical,
            "/seatings",
            far.into(),
            &["`seatings`", "expected 1", "found 4000000000"],
        ),
        (
            &physical,
            "/coefficients",
            vec![vec![3.0, -2.0]].into(),
            &["`coefficients`", "at least 6 rows, found 1"],
        ),
        (
            &physical,
            "/covariance",
            vec![vec![0.0]].into(),
            &["`covariance`", "12 to 14 rows", "found 1 rows"],
        ),
        (
            &physical,
            "/covariance/3",
            none[..].into(),
            &["covariance", "0 numbers in row 4"],
        ),
        (&physical, "/kind", "oracle".into(), &["c.json", "oracle"]),
        (&map, "/version", 2.into(), &["expected version 1, found 2"]),
        (
            &map,
            "/outputs/1/beta",
            none[..].into(),
            &["`outputs[1].beta` of 1 numbers", "found 0"],
        ),
        (
            &map,
            "/valid_region/kind",
            "sphere".into(),
            &["valid_region.kind", "sphere"],
        ),
        (
            &scalar,
            "/effects/0/id",
            "warp".into(),
            &["catalogue", "warp"],
        ),
        (
            &scalar,
            "/effects/0/law",
            "power-9".into(),
            &["catalogue", "power-9"],
        ),
        (
            &scalar,
            "/declared/polynomial",
            far.into(),
            &["`declared.polynomial`", "at most 2", "found 4000000000"],
        ),
        (
            &scalar,
            "/coefficients",
            vec![1.0].into(),
            &["`coefficients`", "expected 3, found 1"],
        ),
        (
            &scalar,
            "/covariance",
            vec![vec![0.0]].into(),
            &["`covariance`", "3 rows"],
        ),
        (
            &scalar,
            "/scaling/covariates",
            vec![vec![0.0, 1.0]].into(),
            &["`scaling.covariates`", "expected 0, found 1"],
        ),
    ];
    let mut wrong = Vec::new();
    for (model, pointer, value, says) in cases {
        let mut model = (*model).clone();
        *model.pointer_mut(pointer).unwrap() = value.clone();
        let table = if model["kind"] == "scalar" {
            "scalar.csv"
        } else {
            "whisker.csv"
        };
        if let Err(why) = judge(&run(&calibration(model), table), 1, says) {
            wrong.push(format!("{pointer}: {why}"));
        }
    }
    let mut newer = calibration(physical);
    newer["format"] = "wcal-calibration/2".into();
    wrong.extend(
        judge(
            &run(&newer, "whisker.csv"),
            1,
            &["`format`", "wcal-calibration/1", "wcal-calibration/2"],
        )
        .err(),
    );
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
    assert!(
        !place.path().join("out.csv").exists(),
        "nothing is half-written"
    );
}
