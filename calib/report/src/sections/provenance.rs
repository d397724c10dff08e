//! What was read and how: files by hash, program, command, seed.

use crate::input::ReportInput;
use crate::markup::{Cell, Table};

/// The section.
pub(super) fn body(input: &ReportInput) -> String {
    let made = &input.provenance;
    let mut facts = Table::new("Program and command", &["what", "value"]);
    facts.row(vec![Cell::Text("program".into()), Cell::Text(made.program.clone())]);
    facts.row(vec![Cell::Text("command".into()), Cell::Code(made.command.join(" "))]);
    facts.row(vec![Cell::Text("made".into()), Cell::Text(made.created.clone())]);
    facts.row(vec![Cell::Text("seed".into()), Cell::Text(made.seed.to_string())]);
    if input.verify.seed != made.seed {
        facts.row(vec![Cell::Text("seed of verify".into()), Cell::Text(input.verify.seed.to_string())]);
    }
    facts.row(vec![Cell::Text("result format".into()), Cell::Text(input.verify.format.clone())]);
    for fact in &input.versions {
        facts.row(vec![Cell::Text(fact.name.clone()), Cell::Text(fact.value.clone())]);
    }
    let mut files = Table::new("Files read", &["file", "SHA-256"]);
    let own = input.verify.inputs.iter().filter(|f| !made.inputs.contains(f));
    for file in made.inputs.iter().chain(own) {
        files.row(vec![Cell::Code(file.path.clone()), Cell::Code(file.sha256.clone())]);
    }
    let files = if files.is_empty() { super::absent("No files were recorded.") } else { files.html() };
    facts.html() + &files
}
