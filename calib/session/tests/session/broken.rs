//! Broken session folders, each with what the one error must say. Used here against the library
//! and, in the root package, against the program.

use std::fs;
use std::path::Path;

/// One way to break a good session.
pub(crate) struct Broken {
    /// Short name.
    pub name: &'static str,
    /// Session that is broken.
    pub base: Base,
    /// File to change.
    pub file: &'static str,
    /// The change.
    pub change: Change,
    /// What the message must say.
    pub says: &'static [&'static str],
}

/// A change of one file.
pub(crate) enum Change {
    /// Replaces the first occurrence of a text, which must be there.
    Text(&'static str, &'static str),
    /// Replaces the whole file.
    Whole(&'static [u8]),
    /// Removes the file.
    Remove,
}

/// Good sessions to start from.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Base {
    Whisker,
    Transducer,
    Axis,
}

pub(crate) const WHISKER_TOML: &str = r#"format = "wcal-session/1"
id = "w"
kind = "whisker"
medium = "air"

[files]
points = "points.csv"
twin = "twin.csv"

[whisker]
diameter_mm = 0.3
length_mm = 60.0
straight_mm = 28.0
arc_radius_mm = 20.0
youngs_gpa = 75.0
shear_gpa = 28.2

[fbg]
nominal_nm = [1545.0, 1543.0]

[[trajectory]]
id = 1
origin_mm = [18.0, 0.0, 0.0]
direction = [0.0, 0.0, 1.0]
"#;

pub(crate) const WHISKER_POINTS: &str = "\
point,role,trajectory,t_s,stage_mm,direction,speed_mm_s,groove_x_mm,groove_y_mm,groove_z_mm,temperature_degc,fbg_1_nm,fbg_2_nm,fbg_1_sd_pm,samples
0,rest,,1,,,0,,,,21.5,1545.01,1543.01,1.1,2000
1,calibration,1,2,1.25,1,0,18,0,1.25,21.6,1545.03,1543.04,1.2,2000
2,calibration,1,3,2.5,1,0,18,0,2.5,21.7,1545.05,1543.06,1.3,2000
";

const TWIN: &str = "point,moment_1_nmm,moment_2_nmm\n0,0,0\n1,-0.1,0.2\n2,-0.2,0.4\n";

const TRANSDUCER_TOML: &str = "format = \"wcal-session/1\"\nid = \"t\"\nkind = \"transducer\"\n[files]\npoints = \"points.csv\"\n\
    [transducer]\nstimulus_unit = \"N\"\nresponse_unit = \"V\"\nmodel = \"linear\"\n";
const TRANSDUCER_POINTS: &str = "point,role,stimulus,response,t_s,batch\n0,calibration,1,2.5,0,1\n1,calibration,2,4.5,1,1\n2,calibration,3,6.5,2,2\n";

const AXIS_TOML: &str =
    "format = \"wcal-session/1\"\nid = \"a\"\nkind = \"axis\"\n[files]\npoints = \"points.csv\"\n";
const AXIS_POINTS: &str = "point,role,commanded_mm,measured_mm,direction\n0,calibration,1,1.01,1\n1,calibration,2,2.02,1\n2,calibration,3,3.01,-1\n";

impl Base {
    /// Writes the good session.
    pub(crate) fn write(self, folder: &Path) {
        let (toml, points) = match self {
            Self::Whisker => (WHISKER_TOML, WHISKER_POINTS),
            Self::Transducer => (TRANSDUCER_TOML, TRANSDUCER_POINTS),
            Self::Axis => (AXIS_TOML, AXIS_POINTS),
        };
        fs::write(folder.join("session.toml"), toml).unwrap();
        fs::write(folder.join("points.csv"), points).unwrap();
        if self == Self::Whisker {
            fs::write(folder.join("twin.csv"), TWIN).unwrap();
        }
    }
}

impl Broken {
    /// Writes the broken session.
    pub(crate) fn write(&self, folder: &Path) {
        self.base.write(folder);
        let path = folder.join(self.file);
        match self.change {
            Change::Remove => fs::remove_file(path).unwrap(),
            Change::Whole(bytes) => fs::write(path, bytes).unwrap(),
            Change::Text(from, to) => {
                let text = fs::read_to_string(&path).unwrap();
                assert!(
                    text.contains(from),
                    "{}: {from:?} is not in {}",
                    self.name,
                    self.file
                );
                fs::write(path, text.replacen(from, to, 1)).unwrap();
            }
        }
    }
}

const fn whisker(
    name: &'static str,
    file: &'static str,
    change: Change,
    says: &'static [&'static str],
) -> Broken {
    Broken {
        name,
        base: Base::Whisker,
        file,
        change,
        says,
    }
}

const fn points(
    name: &'static str,
    from: &'static str,
    to: &'static str,
    says: &'static [&'static str],
) -> Broken {
    whisker(name, "points.csv", Change::Text(from, to), says)
}

const fn toml(
    name: &'static str,
    from: &'static str,
    to: &'static str,
    says: &'static [&'static str],
) -> Broken {
    whisker(name, "session.toml", Change::Text(from, to), says)
}

const fn other(
    base: Base,
    name: &'static str,
    from: &'static str,
    to: &'static str,
    says: &'static [&'static str],
) -> Broken {
    Broken {
        name,
        base,
        file: "points.csv",
        change: Change::Text(from, to),
        says,
    }
}

/// Every broken session.
pub(crate) const TABLE: &[Broken] = &[
    // Files.
    whisker("no session.toml", "session.toml", Change::Remove, &["session.toml"]),
    whisker("no points", "points.csv", Change::Remove, &["points.csv", "no such file"]),
    whisker("no twin", "twin.csv", Change::Remove, &["twin.csv", "no such file"]),
    whisker("nothing in points", "points.csv", Change::Whole(b""), &["points.csv", "header", "an empty file"]),
    whisker("session.toml is binary", "session.toml", Change::Whole(b"\xff\xfe\x00"), &["session.toml", "UTF-8"]),
    whisker("points are UTF-16", "points.csv", Change::Whole(b"\xff\xfep\0o\0"), &["points.csv", "UTF-16"]),
    whisker("not TOML", "session.toml", Change::Text("id = \"w\"", "id = w w"), &["session.toml", "line 2", "valid TOML"]),
    // Header.
    points("column missing", "groove_y_mm", "gy", &["points.csv", "line 1", "column groove_y_mm", "found"]),
    points("metres", "groove_x_mm", "groove_x_m", &["groove_x_mm in mm", "groove_x_m in m", "convert"]),
    points("micrometres", "groove_z_mm", "groove_z_um", &["groove_z_mm in mm", "groove_z_um in um"]),
    points("milliseconds", "t_s", "t_ms", &["t_s in s", "t_ms in ms"]),
    points("kelvin in the name", "temperature_degc", "temperature_k", &["temperature_degc", "temperature_k in k"]),
    points("noise in nm", "fbg_1_sd_pm", "fbg_1_sd_nm", &["fbg_1_sd_pm in pm", "fbg_1_sd_nm in nm"]),
    points("wavelength in um", "fbg_2_nm", "fbg_2_um", &["fbg_2_nm in nm", "fbg_2_um in um"]),
    points("column twice", "t_s,stage_mm", "t_s,t_s", &["points.csv", "line 1", "once", "t_s"]),
    whisker("semicolons", "points.csv", Change::Whole(b"point;role;trajectory\n1;rest;1\n"), &["commas", "semicolons"]),
    whisker("tabs", "points.csv", Change::Whole(b"point\trole\n1\trest\n"), &["commas", "tabs"]),
    // Cells.
    points("word for number", "1,0,18,0,1.25", "1,0,abc,0,1.25", &["line 3", "groove_x_mm", "a number", "\"abc\""]),
    points("NaN", "1,0,18,0,1.25", "1,0,18,NaN,1.25", &["line 3", "groove_y_mm", "finite", "NaN"]),
    points("infinity", "21.7", "-inf", &["line 4", "temperature_degc", "finite", "-inf"]),
    points("overflow", "1545.03", "1e999", &["line 3", "fbg_1_nm", "finite", "1e999"]),
    points("empty wavelength", "1543.06", "", &["line 4", "fbg_2_nm", "a number", "nothing"]),
    points("half a groove", "1,0,18,0,1.25", "1,0,18,,1.25", &["line 3", "groove_y_mm", "nothing"]),
    points("no groove", "1,0,18,0,1.25", "1,0,,,", &["line 3", "groove_x_mm", "only a rest row"]),
    points("point is no number", "2,calibration", "two,calibration", &["line 4", "point", "number", "\"two\""]),
    points("point with a fraction", "2,calibration", "2.5,calibration", &["line 4", "point", "whole number", "2.5"]),
    points("duplicate point", "2,calibration", "1,calibration", &["line 4", "point 1 again", "line 3"]),
    points("unknown role", "2,calibration", "2,calib", &["line 4", "role", "verification", "\"calib\""]),
    points("unknown trajectory", "calibration,1,2", "calibration,7,2", &["line 3", "trajectory", "[[trajectory]]", "found 7"]),
    points("no trajectory", "calibration,1,2", "calibration,,2", &["line 3", "trajectory", "nothing"]),
    points("direction 0", "1.25,1,0", "1.25,0,0", &["line 3", "direction", "1 or -1", "found 0"]),
    points("negative speed", "1.25,1,0", "1.25,1,-4", &["line 3", "speed_mm_s", "zero or more", "-4"]),
    points("no samples", "1.2,2000", "1.2,0", &["line 3", "samples", "at least 1", "found 0"]),
    points("negative sd", "1.2,2000", "-1.2,2000", &["line 3", "fbg_1_sd_pm", "zero or more"]),
    points("kelvin", "21.6", "294.75", &["line 3", "temperature_degc", "294.75", "kelvin"]),
    points("truncated", "1543.06,1.3,2000\n", "154", &["line 4", "15 fields", "13 fields", "truncated"]),
    points("decimal comma", "1545.05", "1545,05", &["line 4", "15 fields", "16 fields", "dot"]),
    whisker("no rows", "points.csv", Change::Whole(b"point,role,trajectory,groove_x_mm,groove_y_mm,groove_z_mm,fbg_1_nm,fbg_2_nm\n"),
        &["points.csv", "at least one row", "empty table"]),
    points("bytes that are no text", "calibration,1,3", "calibr\u{fffd}ion,1,3", &["line 4", "role"]),
    // Units and geometry.
    points("wavelength as shift", "1545.03", "0.03", &["line 3", "fbg_1_nm", "1400", "fbg_1_shift_nm"]),
    points("wavelength in pm", "1545.03", "1545030", &["line 3", "fbg_1_nm", "pm instead of nm"]),
    points("far from nominal", "1545.03", "1590.03", &["line 3", "fbg_1_nm", "at most 20 nm"]),
    points("stage in um", "3,2.5,1", "3,2500,1", &["line 4", "stage_mm", "factor of 1000", "um instead of mm"]),
    points("stage in m", "3,2.5,1", "3,0.0025,1", &["line 4", "stage_mm", "factor of 1000"]),
    points("groove in m", "18,0,2.5", "0.018,0,0.0025", &["line 4", "groove_x_mm", "factor of 1000", "m instead of mm"]),
    points("out of reach", "2.5,1,0,18,0,2.5", "80,1,0,18,0,80", &["line 4", "groove_x_mm", "60.000 mm", "82.000 mm"]),
    // session.toml.
    toml("mark that is no flag", "[files]", "[provenance]\nsimulated = \"yes\"\n[files]", &["provenance.simulated", "true or false", "yes"]),
    toml("newer format", "session/1", "session/2", &["session.toml", "format", "wcal-session/1", "wcal-session/2", "newer"]),
    toml("other format", "wcal-session/1", "wcal-map/1", &["format", "wcal-map/1"]),
    toml("no format", "format =", "fmt =", &["format", "wcal-session/1", "nothing"]),
    toml("unknown kind", "\"whisker\"", "\"thermometer\"", &["kind", "transducer", "thermometer"]),
    toml("no id", "id = \"w\"", "", &["field id", "nothing"]),
    toml("no files", "[files]", "[tables]", &["files", "nothing"]),
    toml("absolute path", "\"points.csv\"", "\"/points.csv\"", &["files.points", "relative", "/points.csv"]),
    toml("path out of the folder", "\"points.csv\"", "\"../points.csv\"", &["files.points", "without \"..\"", "../points.csv"]),
    toml("device", "\"twin.csv\"", "\"/dev/zero\"", &["files.twin", "relative", "/dev/zero"]),
    toml("folder for a file", "\"points.csv\"", "\".\"", &["files.points", "not a regular file"]),
    toml("no whisker", "[whisker]", "[wire]", &["whisker", "nothing"]),
    toml("diameter in um", "diameter_mm = 0.3", "diameter_mm = 300", &["whisker.diameter_mm", "found 300", "unit"]),
    toml("modulus in Pa", "youngs_gpa = 75.0", "youngs_gpa = 75e9", &["whisker.youngs_gpa", "unit"]),
    toml("text for number", "length_mm = 60.0", "length_mm = \"60\"", &["whisker.length_mm", "a number", "\"60\""]),
    toml("number is nan", "length_mm = 60.0", "length_mm = nan", &["whisker.length_mm", "NaN"]),
    toml("no radius", "arc_radius_mm = 20.0", "", &["whisker.arc_radius_mm", "rest_shape"]),
    toml("no nominal", "nominal_nm = [1545.0, 1543.0]", "", &["fbg.nominal_nm", "nothing"]),
    toml("one nominal", "[1545.0, 1543.0]", "[1545.0]", &["fbg.nominal_nm", "length 2", "length 1"]),
    toml("nominal in um", "[1545.0, 1543.0]", "[1.545, 1.543]", &["fbg.nominal_nm", "1.545", "1400"]),
    toml("no origin", "origin_mm = [18.0, 0.0, 0.0]", "", &["trajectory #1.origin_mm", "nothing"]),
    toml("no direction", "direction = [0.0, 0.0, 1.0]", "", &["trajectory #1.direction", "nothing"]),
    toml("direction is not unit", "[0.0, 0.0, 1.0]", "[0.0, 0.0, 2.0]", &["trajectory #1.direction", "length 2.0"]),
    toml("origin with two numbers", "[18.0, 0.0, 0.0]", "[18.0, 0.0]", &["trajectory #1.origin_mm", "length 3", "length 2"]),
    toml("origin in m", "[18.0, 0.0, 0.0]", "[0.018, 0.0, 0.0]", &["trajectory 1.origin_mm", "factor of 1000"]),
    toml("trajectory twice", "[[trajectory]]", "[[trajectory]]\nid = 1\norigin_mm = [9, 0, 0]\ndirection = [0, 0, 1]\n[[trajectory]]",
        &["trajectory #2.id", "trajectory 1 again"]),
    toml("trajectory as table", "[[trajectory]]", "[trajectory]", &["trajectory", "a sequence", "map"]),
    toml("moment sign", "[fbg]", "[moments]\nsign = 2\n[fbg]", &["moments.sign", "1 or -1", "found 2"]),
    toml("parallel moments", "[fbg]", "[moments]\naxes = [[1, 0, 0], [-1, 0, 0]]\n[fbg]", &["moments.axes", "parallel"]),
    // Twin labels.
    whisker("label of no point", "twin.csv", Change::Text("2,-0.2", "9,-0.2"), &["twin.csv", "line 4", "point", "found 9"]),
    whisker("label twice", "twin.csv", Change::Text("2,-0.2", "1,-0.2"), &["twin.csv", "line 4", "point 1 again"]),
    whisker("label in N m", "twin.csv", Change::Text("moment_1_nmm", "moment_1_n"), &["twin.csv", "moment_1_nmm", "moment_1_n"]),
    // Other kinds.
    other(Base::Transducer, "no response", "response", "answer", &["line 1", "a column response", "answer"]),
    other(Base::Transducer, "response is empty", "2,4.5", "2,", &["line 3", "response", "nothing"]),
    other(Base::Transducer, "covariate is empty", "6.5,2,2", "6.5,2,", &["line 4", "batch", "covariate", "nothing"]),
    other(Base::Transducer, "duplicate", "2,calibration", "0,calibration", &["line 4", "point 0 again", "line 2"]),
    Broken { name: "unknown model", base: Base::Transducer, file: "session.toml", change: Change::Text("linear", "cubic"),
        says: &["transducer.model", "quadratic", "cubic"] },
    Broken { name: "no unit", base: Base::Transducer, file: "session.toml", change: Change::Text("stimulus_unit", "unit"),
        says: &["transducer.stimulus_unit", "nothing"] },
    other(Base::Axis, "measured in um by name", "measured_mm", "measured_um", &["measured_mm in mm", "measured_um in um"]),
    Broken { name: "measured in um by value", base: Base::Axis, file: "points.csv",
        change: Change::Whole(b"point,role,commanded_mm,measured_mm\n0,calibration,1,1010\n1,calibration,2,2020\n2,calibration,3,3010\n"),
        says: &["measured_mm", "same unit", "COLUMN*0.001"] },
    other(Base::Axis, "direction 2", "3.01,-1", "3.01,2", &["line 4", "direction", "1 or -1", "found 2"]),
    other(Base::Axis, "holdout only", "0,calibration,1,1.01,1\n1,calibration,2,2.02,1\n2,calibration", "2,holdout",
        &["role", "not holdout", "holdout rows only"]),
];
