//! `wcal export`: a calibration as code, for where the reading is made.

use crate::output::{check_file, write_file};
use anyhow::ensure;
use clap::{Args, ValueEnum};
use std::fmt::Write;
use std::path::PathBuf;
use std::process::ExitCode;
use wcal_calibration::{
    CalibrationError, CalibrationModel, Export, export, read_calibration, trust_issues,
};
use wcal_core::CalibrationFile;
use wcal_core::text::{number, printable};

/// What is written.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum Target {
    /// A header in C99
    C,
    /// A module in Python
    Python,
    /// A calibrate_linear filter of ESPHome
    Yaml,
}

/// Arguments of `wcal export`.
#[derive(Debug, Args)]
#[command(after_help = "Example:
  wcal export result/calibration.json --to c --out cell.h

A function gives the value, the half width of its 95 % interval and a status: of a transducer the stimulus from the response, of an axis
the error (um) at the commanded position, of a whisker's map the moments from two wavelengths. Outside the valid range the value is NaN.
A temperature and a direction are further inputs where an accepted effect needs them. A self-test compares it with stored answers.
A calibration whose answer follows earlier readings, their times or a further column is refused: use wcal predict. Of a whisker the map
of wcal fit-gpr is exported.
--to yaml: straight pieces through at most 64 points, for a transducer with one input; the comment states the largest deviation.
Exit code 4: the calibration expired or failed verification (written all the same); --force turns this into a warning.")]
pub(crate) struct ExportArgs {
    /// calibration.json of verify or fit-gpr
    pub calibration: PathBuf,
    /// Language
    #[arg(long, value_enum)]
    pub to: Target,
    /// File to write; without it, stdout
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
    /// Beginning of every name in C
    #[arg(long, value_name = "NAME", default_value = "wcal")]
    pub name: String,
    /// Exit with 0 although the calibration expired or failed, and write although --out is another
    /// file
    #[arg(long)]
    pub force: bool,
}

/// Runs the command.
///
/// # Errors
/// A calibration that cannot be read or written as code, or a file that cannot be written.
pub(crate) fn run(args: &ExportArgs) -> anyhow::Result<ExitCode> {
    let name = &args.name;
    let sound = name.starts_with(|c: char| c.is_ascii_alphabetic())
        && name.chars().all(|c| c.is_ascii_alphanumeric() || c == '_');
    ensure!(
        sound,
        "--name: expected a name of C (letters, digits, _), found {name:?}"
    );
    if let Some(out) = &args.out {
        let own = |first: &str| first.contains("wcal export: written by");
        check_file(out, "export", own, args.force)?;
    }
    let file = read_calibration(&args.calibration)?;
    let doubts = trust_issues(&file, jiff::Timestamp::now())?;
    let exported = export(&file.model)?;
    let text = match args.to {
        Target::Yaml => yaml(&file, &exported)?,
        target => code(&file, &exported, target == Target::C, name)?,
    };
    match &args.out {
        Some(out) => {
            write_file(out, text.as_bytes())?;
            eprintln!("{}: its self-test compares stored answers", out.display());
        }
        None => print!("{text}"),
    }
    if file.provenance.simulated {
        eprintln!("SIMULATED: the calibration is not measured");
    }
    let word = if args.force {
        "warning"
    } else {
        "written, but not to be trusted"
    };
    doubts.iter().for_each(|doubt| eprintln!("{word}: {doubt}"));
    let good = doubts.is_empty() || args.force;
    Ok(ExitCode::from(if good { 0 } else { 4 }))
}

/// Who wrote it, and the mark of simulated data.
fn origin(file: &CalibrationFile<CalibrationModel>) -> String {
    let simulated = file.provenance.simulated;
    let mark = if simulated {
        " SIMULATED: not measured."
    } else {
        ""
    };
    let program = concat!("wcal ", env!("CARGO_PKG_VERSION"));
    format!("wcal export: written by {program}; do not edit.{mark}")
}

/// The templates of a language, filled.
fn code(
    file: &CalibrationFile<CalibrationModel>,
    export: &Export,
    c: bool,
    name: &str,
) -> anyhow::Result<String> {
    let template = match (c, export.template) {
        (true, "map") => [include_str!("export/head.h"), include_str!("export/map.h")],
        (true, _) => [
            include_str!("export/head.h"),
            include_str!("export/scalar.h"),
        ],
        (false, "map") => [
            include_str!("export/head.py"),
            include_str!("export/map.py"),
        ],
        (false, _) => [
            include_str!("export/head.py"),
            include_str!("export/scalar.py"),
        ],
    };
    let (kind, brackets) = if c {
        ("double ", ["{", "}"])
    } else {
        ("", ["[", "]"])
    };
    // The templates' names begin with cal_.
    let [lower, upper] = [name.to_owned(), name.to_uppercase()].map(|name| name + "_");
    let text = template
        .concat()
        .replace("cal_", &lower)
        .replace("CAL_", &upper);
    let inputs: Vec<&str> = export.inputs.iter().flatten().copied().collect();
    let parameters: Vec<String> = inputs
        .iter()
        .map(|input| format!("{kind}{input}"))
        .collect();
    let arguments = export.inputs.map(|input| input.unwrap_or("0.0"));
    let verification = serde_json::to_value(&file.verification)?;
    let fields = [
        ("ORIGIN", origin(file)),
        ("INPUTS", inputs.join(", ")),
        ("PARAMETERS", parameters.join(", ")),
        ("ARGUMENTS", arguments.join(", ")),
        ("SIMULATED", u8::from(file.provenance.simulated).to_string()),
    ];
    let stated = [
        ("SHA256", file.content_sha256.as_str()),
        ("VERIFICATION", verification.as_str().unwrap_or_default()),
        ("EXPIRES", file.expires.as_deref().unwrap_or_default()),
        ("INPUT_UNIT", &export.units[0]),
        ("OUTPUT_UNIT", &export.units[1]),
        ("SESSION", &file.session),
    ];
    let numbers = export
        .numbers
        .iter()
        .map(|(key, rows)| (*key, numbers(rows, brackets)));
    let all = fields
        .into_iter()
        .chain(stated.map(|(key, text)| (key, quoted(text))))
        .chain(numbers);
    Ok(all.fold(text, |text, (key, value)| {
        text.replace(&format!("@{key}@"), &value)
    }))
}

/// Rows of numbers as the elements of an array, each row of several in brackets of its own.
fn numbers(rows: &[Vec<f64>], [open, close]: [&str; 2]) -> String {
    // Shortest digits that read back as the same number.
    let digits = |v: &f64| format!("{v:?}").trim_end_matches(".0").to_owned();
    let joined = |row: &Vec<f64>| row.iter().map(digits).collect::<Vec<_>>().join(", ");
    let flat = rows.iter().all(|row| row.len() == 1);
    let element = |row: &Vec<f64>| match joined(row) {
        one if flat => one,
        several => format!("{open}{several}{close}"),
    };
    let line = |rows: &[Vec<f64>]| rows.iter().map(element).collect::<Vec<_>>().join(", ");
    let lines = rows.chunks(if flat { 5 } else { 1 }).map(line);
    lines.collect::<Vec<_>>().join(",\n    ")
}

/// A text between double quotes in C and in Python, without what either gives a meaning.
fn quoted(text: &str) -> String {
    let of = |c: char| match c {
        '"' | '\\' | '?' | '@' => format!("\\{:03o}", c as u32),
        c if c.is_control() => " ".to_owned(),
        c => c.to_string(),
    };
    text.chars().map(of).collect()
}

/// A list of points for ESPHome.
fn yaml(file: &CalibrationFile<CalibrationModel>, export: &Export) -> anyhow::Result<String> {
    let Some((points, deviation)) = &export.points else {
        let why = "yaml: expected a transducer with one input, found another calibration (--to c and --to python take it)";
        return Err(CalibrationError::NotExported(why.to_owned()).into());
    };
    let [input_unit, output_unit] = export.units.each_ref().map(|unit| printable(unit));
    let (first, last) = (points[0][0], points[points.len() - 1][0]);
    let mut out = format!(
        "# {}\n\
         # Session {}, calibration {}, expires {}.\n\
         # Response in {input_unit} to stimulus in {output_unit}; largest deviation of the stimulus from `wcal predict`: {},\n\
         # without the rounding of single precision. The first filter drops readings outside the valid range.\n\
         filters:\n  - clamp:\n      min_value: {first:?}\n      max_value: {last:?}\n      ignore_out_of_range: true\n\
         \x20 - calibrate_linear:\n      method: exact\n      datapoints:\n",
        origin(file),
        printable(&file.session),
        file.content_sha256,
        printable(file.expires.as_deref().unwrap_or("never")),
        number(*deviation, 2),
    );
    for [x, y] in points {
        writeln!(out, "        - {x:?} -> {y:?}")?;
    }
    Ok(out)
}
