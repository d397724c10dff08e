//! Readings that no fit may see, kept separate by type: they come out by [`Sealed::unseal`] alone, which leaves a record.

use crate::provenance::InputFile;
use serde::{Deserialize, Serialize};

/// Sealed rows. There is no way to them but `unseal`; what checks of admission need is asked for by name.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Sealed<R> {
    rows: Vec<R>,
}

impl<R> Default for Sealed<R> {
    fn default() -> Self {
        Self { rows: Vec::new() }
    }
}

/// What is known of the files behind the seal before it is broken.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Seal {
    /// Files whose rows are sealed.
    pub files: Vec<InputFile>,
    /// Hashes of files that were unsealed before.
    pub opened_before: Vec<String>,
    /// Program that will break it.
    pub program: String,
}

/// Record of an unsealing.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Unsealing {
    /// Files whose rows came out, by hash.
    pub files: Vec<InputFile>,
    /// One of them had been unsealed before: the error is not of the first use.
    pub seen_before: bool,
    /// By which program.
    pub program: String,
    /// Rows.
    pub rows: usize,
}

impl<R> Sealed<R> {
    /// Seals rows.
    #[must_use]
    pub fn new(rows: Vec<R>) -> Self {
        Self { rows }
    }

    /// Number of rows.
    #[must_use]
    pub fn len(&self) -> usize {
        self.rows.len()
    }

    /// Whether nothing is sealed.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.rows.is_empty()
    }

    /// Seals further rows.
    pub fn extend(&mut self, rows: impl IntoIterator<Item = R>) {
        self.rows.extend(rows);
    }

    /// Takes over what another seal holds.
    pub fn join(&mut self, other: Self) {
        self.rows.extend(other.rows);
    }

    /// Changes names, frames or times, as joining sessions asks for; nothing comes out.
    pub fn relabel(&mut self, change: impl FnMut(&mut R)) {
        self.rows.iter_mut().for_each(change);
    }

    /// The same rows in another form, still sealed.
    #[must_use]
    pub fn map<T>(&self, form: impl Fn(&R) -> T) -> Sealed<T> {
        Sealed { rows: self.rows.iter().map(form).collect() }
    }

    /// One property of each row for checks of admission (is it in the fitted table, too? is its time in order?), which decide whether the
    /// data can be used and nothing else.
    pub fn admission<T>(&self, property: impl Fn(&R) -> T) -> Vec<T> {
        self.rows.iter().map(property).collect()
    }

    /// Breaks the seal.
    #[must_use]
    pub fn unseal(&self, seal: &Seal) -> (&[R], Unsealing) {
        let seen_before = seal.files.iter().any(|f| seal.opened_before.contains(&f.sha256));
        let record = Unsealing {
            files: seal.files.clone(),
            seen_before,
            program: seal.program.clone(),
            rows: self.rows.len(),
        };
        (&self.rows, record)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_unsealing_says_what_came_out_and_whether_it_had_before() {
        let file = |name: &str| InputFile {
            path: name.to_owned(),
            sha256: name.to_owned(),
            purpose: crate::Purpose::Holdout,
        };
        let mut sealed = Sealed::new(vec![1, 2]);
        sealed.join(Sealed::new(vec![3]));
        let mut seal = Seal { files: vec![file("a")], opened_before: vec!["b".into()], program: "p".into() };
        let (rows, first) = sealed.unseal(&seal);
        assert_eq!((rows, first.seen_before, first.rows), (&[1, 2, 3][..], false, 3));
        seal.opened_before.push("a".into());
        assert!(sealed.unseal(&seal).1.seen_before);
    }
}
