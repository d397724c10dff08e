//! What was read and how: files by hash, program, command, seed.

use crate::input::ReportInput;
use crate::markup::{Table, TableCell};

/// The section.
pub(super) fn body(input: &ReportInput) -> String {
    let made = &input.provenance;
    let mut facts = Table::new("Program and command", &["what", "value"]);
    facts.row(vec![
        TableCell::Text("program".into()),
        TableCell::Text(made.program.clone()),
    ]);
    facts.row(vec![
        TableCell::Text("command".into()),
        TableCell::Code(made.command.join(" ")),
    ]);
    facts.row(vec![
        TableCell::Text("made".into()),
        TableCell::Text(made.created.clone()),
    ]);
    facts.row(vec![
        TableCell::Text("seed".into()),
        TableCell::Text(made.seed.to_string()),
    ]);
    if input.verify.seed != made.seed {
        facts.row(vec![
            TableCell::Text("seed of verify".into()),
            TableCell::Text(input.verify.seed.to_string()),
        ]);
    }
    facts.row(vec![
        TableCell::Text("result format".into()),
        TableCell::Text(input.verify.format.clone()),
    ]);
    for fact in &input.versions {
        facts.row(vec![
            TableCell::Text(fact.name.clone()),
            TableCell::Text(fact.value.clone()),
        ]);
    }
    let mut files = Table::new("Files read", &["file", "SHA-256"]);
    let own = input
        .verify
        .inputs
        .iter()
        .filter(|f| !made.inputs.contains(f));
    for file in made.inputs.iter().chain(own) {
        files.row(vec![
            TableCell::Code(file.path.clone()),
            TableCell::Code(file.sha256.clone()),
        ]);
    }
    let files = if files.is_empty() {
        super::parts::absent("No files were recorded.")
    } else {
        files.html()
    };
    facts.html() + &files
}
