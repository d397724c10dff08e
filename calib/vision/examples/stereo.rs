//! The two picture commands as a program of their own: `stereo stereo-calibrate ...`, `stereo stereo-shape ...`.

use clap::Parser;
use std::process::ExitCode;

#[path = "../../cli/picture_output.rs"]
mod picture_output;
#[path = "../../cli/stereo_calibrate.rs"]
mod stereo_calibrate;
#[path = "../../cli/stereo_shape.rs"]
mod stereo_shape;

#[derive(Parser)]
enum Command {
    StereoCalibrate(stereo_calibrate::StereoCalibrateArgs),
    StereoShape(stereo_shape::StereoShapeArgs),
}

fn main() -> ExitCode {
    let result = match Command::parse() {
        Command::StereoCalibrate(args) => stereo_calibrate::run(&args),
        Command::StereoShape(args) => stereo_shape::run(&args),
    };
    result.unwrap_or_else(|error| {
        eprintln!("error: {error:#}");
        ExitCode::FAILURE
    })
}
