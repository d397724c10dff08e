//! Writes sample pages from invented data, to look at:
//! `cargo run -p wcal-report --example sample -- FOLDER`.

#![allow(clippy::print_stdout)]

mod data;

use std::{env, fs, io, path::PathBuf};
use wcal_report::{render, render_index};

fn main() -> io::Result<()> {
    let folder = PathBuf::from(env::args().nth(1).unwrap_or_else(|| ".".into()));
    fs::create_dir_all(&folder)?;
    let mut reports = Vec::new();
    for input in data::all() {
        let name = format!("{}.html", input.verify.session);
        fs::write(folder.join(&name), render(&input))?;
        reports.push((name, input));
    }
    let introduction = ["Invented sessions that show what a report looks like."];
    fs::write(
        folder.join("index.html"),
        render_index("Sample reports", &introduction, &reports),
    )?;
    println!("{}", folder.join("index.html").display());
    Ok(())
}
