//! `wcal-lab man`: every command and option of `wcal` stands in its page and in each completion.

use crate::support::{program, program_of, text};
use std::collections::BTreeSet;
use std::path::Path;

/// What `wcal` says of a command.
fn help(words: &[&str]) -> String {
    let run = program_of("verify").args(words).arg("--help").output();
    text(&run.unwrap().stdout)
}

/// Commands of `wcal`, as its help lists them.
fn commands() -> Vec<String> {
    let help = help(&[]);
    let listed = help.split("Commands:").nth(1).unwrap();
    let listed = listed.split("Options:").next().unwrap().lines();
    let names = listed.filter(|l| l.starts_with("  ") && !l.starts_with("   "));
    names
        .filter_map(|l| l.split_whitespace().next())
        .filter(|name| *name != "help")
        .map(str::to_owned)
        .collect()
}

/// Long options at the beginning of a line of help.
fn options(help: &str) -> BTreeSet<String> {
    let heads = help.lines().map(str::trim_start);
    let long = heads.filter_map(|l| l.strip_prefix("-h, ").unwrap_or(l).strip_prefix("--"));
    long.filter_map(|l| l.split([' ', '[']).next())
        .map(|name| format!("--{name}"))
        .collect()
}

/// Options that a manual page does not name; roff writes a hyphen as `\-`.
fn unnamed(page: &Path, options: &BTreeSet<String>) -> Vec<String> {
    let page = std::fs::read_to_string(page).unwrap().replace('\\', "");
    let named = |o: &&String| !page.contains(o.as_str());
    options.iter().filter(named).cloned().collect()
}

#[test]
fn every_command_has_its_page_and_completions() {
    let place = tempfile::tempdir().unwrap();
    let out = place.path().join("deeper/man");
    let write = || program().args(["man", "--out"]).arg(&out).output().unwrap();
    let run = write();
    assert_eq!(run.status.code(), Some(0), "{}", text(&run.stderr));
    let commands = commands();
    assert!(commands.len() >= 13, "{commands:?}");
    for name in &commands {
        let options = options(&help(&[name]));
        assert!(options.contains("--help"), "{name}: {options:?}");
        let page = out.join(format!("wcal-{name}.1"));
        assert_eq!(unnamed(&page, &options), Vec::<String>::new(), "{name}");
        for shell in ["wcal.bash", "_wcal", "wcal.fish"] {
            assert_eq!(unnamed(&out.join(shell), &[name.clone()].into()), [""; 0]);
            let lost = [format!("{name}-tea")];
            assert_eq!(unnamed(&out.join(shell), &lost.clone().into()), lost);
        }
    }
    // Negative control: options of one command are not in the page of another.
    let foreign = unnamed(&out.join("wcal-demo.1"), &options(&help(&["verify"])));
    assert!(foreign.contains(&"--accept".to_owned()), "{foreign:?}");
    // Examples stand on lines of their own, as the help has them; prose is filled.
    let page = std::fs::read_to_string(out.join("wcal-demo.1")).unwrap();
    let example = "\n.nf\n  wcal demo \\-\\-out demo\\-out\n.fi\n";
    assert!(page.contains(example) && !page.contains("EXTRA"), "{page}");
    // The same files again, in place of those that are there; none where a file stands in the way.
    let first = std::fs::read(out.join("wcal.1")).unwrap();
    assert_eq!(write().status.code(), Some(0));
    assert_eq!(std::fs::read(out.join("wcal.1")).unwrap(), first);
    std::fs::remove_dir_all(&out).unwrap();
    std::fs::write(&out, "in the way").unwrap();
    let run = write();
    assert_eq!(run.status.code(), Some(1));
    assert!(
        text(&run.stderr).contains("deeper/man"),
        "{}",
        text(&run.stderr)
    );
}
