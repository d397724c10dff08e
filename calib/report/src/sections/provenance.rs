//! What was read and how: files by hash, program, command, seed.

use crate::input::ReportInput;
use crate::markup::{Table, TableCell};

/// The section.
pub(super) fn body(input: &ReportInput) -> String {
    let made = &input.provenance;
    let mut facts = Table::new("Program and command", &["what", "value"]);
    facts.row(["program".into(), made.program.clone()]);
    facts.row([
        TableCell::Text("command".into()),
        TableCell::Code(made.command.join(" ")),
    ]);
    facts.row(["made".into(), made.created.clone()]);
    facts.row(["seed".into(), made.seed.to_string()]);
    if input.verify.seed != made.seed {
        facts.row(["seed of verify".into(), input.verify.seed.to_string()]);
    }
    facts.row(["result format".into(), input.verify.format.clone()]);
    let mut files = Table::new("Files read", &["file", "SHA-256"]);
    let own = input
        .verify
        .inputs
        .iter()
        .filter(|f| !made.inputs.contains(f));
    for file in made.inputs.iter().chain(own) {
        files.row([
            TableCell::Code(file.path.clone()),
            TableCell::Code(file.sha256.clone()),
        ]);
    }
    let files = match files.html() {
        none if none.is_empty() => super::parts::absent("No files were recorded."),
        table => table,
    };
    facts.html() + &files
}
