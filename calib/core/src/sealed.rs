//! Readings that no fit may see, kept separate by type: they come out by [`Sealed::unseal`] alone, which leaves a record.

use crate::provenance::InputFile;
use std::fmt;
use std::sync::Arc;

/// Sealed rows. There is no way to their values but `unseal`: they are not written, not printed, and a check of admission gives no more than
/// its answer.
///
/// ```compile_fail
/// let sealed = wcal_core::Sealed::new(vec![1.0]);
/// serde_json::to_string(&sealed).unwrap();
/// ```
#[derive(Clone, PartialEq)]
pub struct Sealed<R> {
    rows: Vec<R>,
}

impl<R> fmt::Debug for Sealed<R> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Sealed({} rows)", self.rows.len())
    }
}

/// Who a row is, not what was read there.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct RowLabel {
    /// Point.
    pub point: i64,
    /// Trajectory.
    pub trajectory: Option<u32>,
    /// Seating.
    pub seating: u32,
    /// Time, s.
    pub t_s: Option<f64>,
}

/// A row that can be sealed.
pub trait Labelled {
    /// Who it is.
    fn label(&self) -> RowLabel;
}

impl<R> Default for Sealed<R> {
    fn default() -> Self {
        Self { rows: Vec::new() }
    }
}

/// What is known of the files behind the seal before it is broken.
#[derive(Debug, Clone, Default)]
pub struct Seal {
    /// Files whose rows are sealed.
    pub files: Vec<InputFile>,
    /// Hashes of files that were unsealed before.
    pub opened_before: Vec<String>,
    /// Program that will break it.
    pub program: String,
    /// Where it is written that the seal is broken, before any row comes out.
    pub ledger: Ledger,
}

type Write = dyn Fn(&Unsealing) -> Result<(), String> + Send + Sync;

/// Writes down for good that a seal is broken.
#[derive(Clone, Default)]
pub struct Ledger(Option<Arc<Write>>);

impl Ledger {
    /// One that writes; its error keeps the rows sealed.
    pub fn new(write: impl Fn(&Unsealing) -> Result<(), String> + Send + Sync + 'static) -> Self {
        Self(Some(Arc::new(write)))
    }
}

impl fmt::Debug for Ledger {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(if self.0.is_some() { "Ledger" } else { "no ledger" })
    }
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
    pub fn new(rows: Vec<R>) -> Self {
        Self { rows }
    }

    /// Number of rows.
    pub fn len(&self) -> usize {
        self.rows.len()
    }

    /// Whether nothing is sealed.
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
    pub fn map<T>(&self, form: impl Fn(&R) -> T) -> Sealed<T> {
        Sealed { rows: self.rows.iter().map(form).collect() }
    }

    /// Who the rows are.
    pub fn labels(&self) -> Vec<RowLabel>
    where
        R: Labelled,
    {
        self.rows.iter().map(Labelled::label).collect()
    }

    /// For each row whether `is` holds: is it in the fitted table, too?
    pub fn which(&self, is: impl Fn(&R) -> bool) -> Vec<bool> {
        self.rows.iter().map(is).collect()
    }

    /// Hands the rows to a check of admission, which decides whether the data can be used; only its refusal comes out, in a sentence.
    pub fn refusal(&self, check: impl Fn(&[R]) -> Option<String>) -> Option<String> {
        check(&self.rows)
    }

    /// Breaks the seal, once that is written down.
    ///
    /// # Errors
    /// What the ledger says where it cannot be written: nothing comes out then.
    pub fn unseal(&self, seal: &Seal) -> Result<(&[R], Unsealing), String> {
        let seen_before = seal.files.iter().any(|f| seal.opened_before.contains(&f.sha256));
        let record = Unsealing {
            files: seal.files.clone(),
            seen_before,
            program: seal.program.clone(),
            rows: self.rows.len(),
        };
        if let Some(write) = seal.ledger.0.as_ref().filter(|_| !self.is_empty()) {
            write(&record)?;
        }
        Ok((&self.rows, record))
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
        let mut seal = Seal {
            files: vec![file("a")],
            opened_before: vec!["b".into()],
            program: "p".into(),
            ..Seal::default()
        };
        let (rows, first) = sealed.unseal(&seal).unwrap();
        assert_eq!((rows, first.seen_before, first.rows), (&[1, 2, 3][..], false, 3));
        seal.opened_before.push("a".into());
        assert!(sealed.unseal(&seal).unwrap().1.seen_before);
    }

    #[test]
    fn nothing_that_was_read_comes_out_of_a_seal() {
        let sealed = Sealed::new(vec![41.5, 42.5]);
        assert_eq!(format!("{sealed:?}"), "Sealed(2 rows)");
        assert_eq!(sealed.which(|r| *r > 42.0), [false, true]);
        assert_eq!(sealed.refusal(|rows| (rows.len() > 1).then(|| "two".to_owned())), Some("two".to_owned()));
        // Control: unsealed they are there.
        assert_eq!(sealed.unseal(&Seal::default()).unwrap().0, [41.5, 42.5]);
    }

    #[test]
    fn rows_come_out_after_the_ledger_is_written_and_not_without() {
        let written = Arc::new(std::sync::Mutex::new(0));
        let count = Arc::clone(&written);
        let ledger = Ledger::new(move |u| {
            *count.lock().unwrap() += u.rows;
            Ok(())
        });
        let sealed = Sealed::new(vec![1.0]);
        sealed.unseal(&Seal { ledger, ..Seal::default() }).unwrap();
        assert_eq!(*written.lock().unwrap(), 1);
        let full = Seal { ledger: Ledger::new(|_| Err("disk full".to_owned())), ..Seal::default() };
        assert_eq!(sealed.unseal(&full), Err("disk full".to_owned()));
        // Control: what is empty was not opened.
        assert!(Sealed::<f64>::default().unseal(&full).is_ok());
    }
}
