//! No circle between the files of a crate: a file stands on those below it, by its `use` lines and
//! by the paths in its text.

use crate::support::repository;
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

/// Names that lead to a module, or to something in it.
type Names = Vec<String>;

/// What a module says: its paths, and the names that it imports and hands on.
#[derive(Default)]
struct Module {
    file: String,
    paths: Vec<Names>,
    imported: BTreeMap<String, Names>,
    handed_on: BTreeMap<String, Names>,
}

/// A source without comments, texts and items below `#[cfg(test)]`.
fn program(source: &str) -> String {
    let lines = source
        .lines()
        .map(|line| line.split("//").next().unwrap_or_default());
    let code = lines.collect::<Vec<_>>().join("\n");
    let code = code.split('"').step_by(2).collect::<String>();
    let mut parts = code.split("#[cfg(test)]");
    let mut out = parts.next().unwrap_or_default().to_owned();
    for part in parts {
        let mut depth = 0_i32;
        let end = part.find(|c| {
            depth += i32::from(c == '{') - i32::from(c == '}');
            depth == 0 && (c == ';' || c == '}')
        });
        out += end.map_or("", |end| &part[end + 1..]);
    }
    out
}

/// The paths of a tree: of `a::{b, c::d as e}` these are `a::b` and `a::c::d`, each with its name
/// here.
fn branches(tree: &str) -> Vec<(Names, String)> {
    if let Some((head, inner)) = tree.split_once('{') {
        let inner = inner.trim_end().strip_suffix('}').unwrap_or(inner);
        let mut depth = 0_i32;
        let parts = inner.split(|c| {
            depth += i32::from(c == '{') - i32::from(c == '}');
            c == ',' && depth == 0
        });
        let parts = parts.filter(|part| !part.trim().is_empty());
        return parts
            .flat_map(|part| branches(&format!("{}{}", head.trim(), part.trim())))
            .collect();
    }
    let (path, alias) = tree
        .split_once(" as ")
        .map_or((tree, None), |(path, name)| (path, Some(name)));
    let mut names: Names = path.trim().split("::").map(str::to_owned).collect();
    names.pop_if(|last| last == "self");
    let name = alias
        .map(str::trim)
        .or(names.last().map(String::as_str))
        .unwrap_or_default()
        .to_owned();
    vec![(names, name)]
}

impl Module {
    fn of(file: &str, source: &str) -> Self {
        let mut module = Self {
            file: file.to_owned(),
            ..Self::default()
        };
        for piece in program(source).split(';') {
            let heads = ["use ", "pub use ", "pub(crate) use ", "pub(super) use "];
            let is_use = |line: &str| {
                heads
                    .iter()
                    .position(|head| line.trim_start().starts_with(head))
            };
            let mut at = 0;
            let found = piece.split_inclusive('\n').find_map(|line| {
                at += line.len();
                Some((at - line.trim_start().len(), heads[is_use(line)?]))
            });
            let (body, tree) = found.map_or((piece, None), |(at, head)| {
                (&piece[..at], Some((head, &piece[at + head.len()..])))
            });
            for (names, name) in tree.iter().flat_map(|(_, tree)| branches(tree)) {
                let own = tree.is_some_and(|(head, _)| head == "use ");
                let known = if own {
                    &mut module.imported
                } else {
                    &mut module.handed_on
                };
                known.insert(name, names);
            }
            let inline = body.split(|c: char| !(c.is_alphanumeric() || c == '_' || c == ':'));
            let inline = inline
                .map(|path| path.trim_matches(':'))
                .filter(|path| path.contains("::"));
            module
                .paths
                .extend(inline.map(|path| path.split("::").map(str::to_owned).collect()));
        }
        module
    }
}

/// The modules of a crate by their names; the root has none.
struct Crate(BTreeMap<Names, Module>);

impl Crate {
    /// Names from the root on; none of another crate's.
    fn absolute(&self, from: &Names, path: &[String]) -> Option<Names> {
        let (first, rest) = path.split_first()?;
        let below = |module: &[String], rest: &[String]| [module, rest].concat();
        match first.as_str() {
            "crate" => return Some(rest.to_vec()),
            "self" => return Some(below(from, rest)),
            "super" => {
                let up = from.split_last()?.1.to_vec();
                let again = rest.first().is_some_and(|next| next == "super");
                return if again {
                    self.absolute(&up, rest)
                } else {
                    Some(below(&up, rest))
                };
            }
            _ => {}
        }
        if self.0.contains_key(&below(from, &path[..1])) {
            return Some(below(from, path));
        }
        let module = &self.0[from];
        let meant = module.imported.get(first).or(module.handed_on.get(first))?;
        let meant = Some(meant)
            .filter(|path| path[0] != *first)
            .and_then(|path| self.absolute(from, path))?;
        Some(below(&meant, rest))
    }

    /// The module that has what the names lead to, past those that only hand it on.
    fn owner(&self, names: &Names) -> Names {
        let end = (0..=names.len())
            .rev()
            .find(|end| self.0.contains_key(&names[..*end]))
            .unwrap_or(0);
        let (module, rest) = (names[..end].to_vec(), &names[end..]);
        let meant = rest
            .first()
            .and_then(|name| self.0[&module].handed_on.get(name));
        let meant = meant
            .and_then(|path| self.absolute(&module, path))
            .filter(|path| path != names);
        meant.map_or(module, |path| self.owner(&[&path, &rest[1..]].concat()))
    }

    /// Modules on which one stands. An imported module is named only: what is taken from it says
    /// its path.
    fn stands_on(&self, from: &Names) -> BTreeSet<Names> {
        let module = &self.0[from];
        let all = module
            .imported
            .values()
            .chain(&module.paths)
            .filter_map(|path| self.absolute(from, path));
        let items = all.filter(|path| !path.is_empty() && !self.0.contains_key(path));
        items
            .map(|path| self.owner(&path))
            .filter(|owner| owner != from)
            .collect()
    }

    /// Arrows between files that lie on a circle.
    fn circles(&self) -> Vec<String> {
        let arrows: BTreeMap<&Names, BTreeSet<Names>> =
            self.0.keys().map(|m| (m, self.stands_on(m))).collect();
        let leads = |from: &Names, to: &Names| {
            let (mut seen, mut to_do) = (BTreeSet::new(), vec![from]);
            while let Some(next) = to_do.pop() {
                to_do.extend(arrows[next].iter().filter(|below| seen.insert(*below)));
            }
            seen.contains(to)
        };
        let text = |a: &Names, b: &Names| format!("{} -> {}", self.0[a].file, self.0[b].file);
        let back = |a: &Names| {
            arrows[a]
                .iter()
                .filter(|b| leads(b, a))
                .map(|b| text(a, b))
                .collect()
        };
        self.0
            .keys()
            .flat_map(|a| -> Vec<String> { back(a) })
            .collect()
    }

    /// The sources beside and below a crate's root, but for other targets' roots.
    fn read(root: &Path, targets: &[&Path]) -> Self {
        let (mut modules, home) = (BTreeMap::new(), root.parent().expect("a folder"));
        let mut folders = vec![home.to_owned()];
        while let Some(folder) = folders.pop() {
            for entry in std::fs::read_dir(&folder).expect("a folder of sources") {
                let path = entry.expect("an entry").path();
                if path.is_dir() {
                    folders.push(path);
                } else if path.extension().is_some_and(|e| e == "rs")
                    && (path == root || !targets.contains(&&*path))
                {
                    let names = path.with_extension("");
                    let names = names.strip_prefix(home).expect("below the root").iter();
                    let mut names: Names =
                        names.map(|n| n.to_string_lossy().into_owned()).collect();
                    names.pop_if(|last| last == "mod" || path == root);
                    let file = path
                        .strip_prefix(repository(""))
                        .expect("of the repository")
                        .display();
                    let source = std::fs::read_to_string(&path).expect("a source");
                    modules.insert(names, Module::of(&file.to_string(), &source));
                }
            }
        }
        Self(modules)
    }
}

#[test]
fn files_of_a_crate_stand_on_files_below_them() {
    let (metadata, mut found, mut files) = (super::layering::metadata(), Vec::new(), 0);
    for package in metadata["packages"].as_array().expect("packages") {
        let targets = package["targets"].as_array().expect("targets").iter();
        let of_kind = |kind: &str| {
            let of_it = targets.clone().filter(|t| {
                t["kind"]
                    .as_array()
                    .is_some_and(|k| k.contains(&kind.into()))
            });
            of_it
                .filter_map(|t| t["src_path"].as_str().map(Path::new))
                .collect::<Vec<_>>()
        };
        let programs = [of_kind("lib"), of_kind("bin")].concat();
        let read = Crate::read(programs.first().expect("a program or library"), &programs);
        files += read.0.len();
        found.extend(read.circles());
    }
    assert_eq!(found, Vec::<String>::new());
    assert!(files > 500, "{files} files");
}

#[test]
fn a_circle_is_seen_however_it_is_written() {
    let circles = |files: &[(&str, &str)]| {
        let module = |(name, text): &(&str, &str)| {
            let names = name
                .split('/')
                .filter(|n| !n.is_empty())
                .map(str::to_owned)
                .collect();
            (names, Module::of(name, text))
        };
        Crate(files.iter().map(module).collect()).circles()
    };
    let both = ["a -> b", "b -> a"];
    let ways = [
        "use crate::b::{c, D as E};",
        "fn f() { crate::b::c() }",
        "use super::b;\nfn f() { b::c() }",
        "use crate::D;",
    ];
    for way in ways {
        let files = [
            ("", "mod a;\nmod b;\npub use b::D;"),
            ("a", way),
            ("b", "use super::a::f;\npub struct D;"),
        ];
        assert_eq!(circles(&files), both, "{way}");
        let open = [
            files[0],
            files[1],
            (
                "b",
                "// crate::a::f\npub struct D;\n#[cfg(test)]\nmod t { use crate::a::f; }",
            ),
        ];
        assert_eq!(circles(&open), Vec::<String>::new(), "{way}");
    }
    let parent = [
        ("", "mod a;"),
        ("a", "mod b;\npub const C: u8 = b::f();"),
        ("a/b", "use super::C;"),
    ];
    assert_eq!(circles(&parent), ["a -> a/b", "a/b -> a"]);
}
