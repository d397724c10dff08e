//! Readings that no fit may see, kept separate by type: they come out by [`Sealed::unseal`] alone,
//! once, against a decision that can no longer change.
//!
//! ```text
//! look n of the same files has the level alpha / (n (n + 1)):     sum over n of 1 / (n (n + 1)) = 1
//! ```
//!
//! K. K. G. Lan, D. L. DeMets, Biometrika 70 (1983), 659-663 (a level that is spent); C. Dwork et
//! al., Science 349 (2015), 636-638 (why a second decision on the same holdout is dearer than the
//! first).

use crate::provenance::{canonical_json, sha256_hex};
use std::collections::BTreeMap;
use std::fmt;
use std::sync::Arc;

/// Sealed rows. There is no way to their values but [`Sealed::unseal`]: they are not copied, not
/// written, not printed, and a check of admission gives no more than its answer. What works on them
/// is a function, not a closure, so that nothing is carried out.
///
/// ```compile_fail
/// let sealed = wcal_core::Sealed::new(vec![1.0]);
/// serde_json::to_string(&sealed).unwrap();
/// ```
///
/// A seal is broken once: the rows and the decision go in by value.
///
/// ```compile_fail,E0382
/// use wcal_core::{Decide, Ledger, Sealed};
/// struct Fitted(f64);
/// impl Decide for Fitted {
///     fn content(&self) -> serde_json::Value { self.0.into() }
/// }
/// let sealed = Sealed::new(vec![1.0]);
/// let first = sealed.unseal(Fitted(1.0), &Ledger::default());
/// let second = sealed.unseal(Fitted(2.0), &Ledger::default());
/// ```
///
/// What was decided cannot be changed by what came out.
///
/// ```compile_fail,E0594
/// use wcal_core::{Decide, Ledger, Sealed};
/// struct Fitted(f64);
/// impl Decide for Fitted {
///     fn content(&self) -> serde_json::Value { self.0.into() }
/// }
/// let opened = Sealed::new(vec![1.0]).unseal(Fitted(1.0), &Ledger::default()).unwrap();
/// opened.assess(|decision, rows, _| decision.0 = rows[0]);
/// ```
///
/// Control: the same with one look that only reads.
///
/// ```
/// use wcal_core::{Decide, Ledger, Sealed};
/// struct Fitted(f64);
/// impl Decide for Fitted {
///     fn content(&self) -> serde_json::Value { self.0.into() }
/// }
/// let opened = Sealed::new(vec![1.5]).unseal(Fitted(1.0), &Ledger::default()).unwrap();
/// let (_, error) = opened.assess(|decision, rows, _| rows[0] - decision.0);
/// assert_eq!(error, 0.5);
/// ```
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
    /// Series (replicate, cycle) of a transducer's or an axis' row.
    pub series: Option<u32>,
    /// Time, s.
    pub t_s: Option<f64>,
    /// It has a pair of pictures.
    pub pictured: bool,
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

/// Hash of a row by the numbers that were set and read, to ten digits: 16 hex digits. Form and
/// place in a table do not change it.
pub fn fingerprint(numbers: &[f64]) -> String {
    // A zero has no sign.
    let text: Vec<String> = numbers
        .iter()
        .map(|number| format!("{:.9e}", number + 0.0))
        .collect();
    sha256_hex(text.join(" ").as_bytes())
        .chars()
        .take(16)
        .collect()
}

/// A decision that holds still: what is hashed is what is judged.
pub trait Decide {
    /// Everything that the sealed rows could have changed: terms, values, noise, rule of the flags,
    /// claims. Numbers are rounded to a hundredth of their standard error, so that the same outcome
    /// by another seed or machine is the same decision.
    fn content(&self) -> serde_json::Value;
}

/// A decision that is about to meet the sealed rows.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Opening<'a> {
    /// Hash of the decision's content.
    pub decision_sha256: &'a str,
    /// Rows.
    pub rows: usize,
}

/// The look at the sealed rows that a decision has.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Look {
    /// Number of different decisions that these files have met, this one included.
    pub number: usize,
    /// Hash of the decision's content.
    pub decision_sha256: String,
}

impl Look {
    /// What of the level `alpha` this look may spend.
    pub fn level(&self, alpha: f64) -> f64 {
        let n = self.number.max(1) as f64;
        alpha / (n * (n + 1.0))
    }
}

type Record = dyn Fn(&Opening<'_>) -> Result<usize, String> + Send + Sync;

/// Writes down for good that a decision meets sealed rows, before they come out, and counts the
/// looks.
#[derive(Clone, Default)]
pub struct Ledger(Option<Arc<Record>>);

impl Ledger {
    /// One that records each opening and gives its number; its error keeps the rows sealed.
    pub fn new(
        record: impl Fn(&Opening<'_>) -> Result<usize, String> + Send + Sync + 'static,
    ) -> Self {
        Self(Some(Arc::new(record)))
    }
}

impl fmt::Debug for Ledger {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(if self.0.is_some() {
            "Ledger"
        } else {
            "no ledger"
        })
    }
}

/// Rows that came out, and the decision that they judge.
#[derive(Debug)]
pub struct Opened<R, D> {
    rows: Vec<R>,
    decision: D,
    look: Option<Look>,
}

impl<R, D> Opened<R, D> {
    /// The one use of the rows: the decision is read, the rows are read, numbers come out. None of
    /// a look where nothing was sealed.
    pub fn assess<A>(self, assess: impl FnOnce(&D, &[R], Option<&Look>) -> A) -> (D, A) {
        let found = assess(&self.decision, &self.rows, self.look.as_ref());
        (self.decision, found)
    }
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
    pub fn relabel<C: ?Sized>(&mut self, with: &C, change: fn(&mut R, &C)) {
        self.rows.iter_mut().for_each(|row| change(row, with));
    }

    /// The same rows in another form, still sealed.
    pub fn convert<T>(self, form: fn(R) -> T) -> Sealed<T> {
        Sealed {
            rows: self.rows.into_iter().map(form).collect(),
        }
    }

    /// Who the rows are.
    pub fn labels(&self) -> Vec<RowLabel>
    where
        R: Labelled,
    {
        self.rows.iter().map(Labelled::label).collect()
    }

    /// Hash of each row's `content`, and the file that it came from: rows are known again by it,
    /// and no value comes out.
    pub fn fingerprints<C: ?Sized>(
        &self,
        with: &C,
        content: fn(&R, &C) -> (String, Vec<f64>),
    ) -> BTreeMap<String, String> {
        let contents = self.rows.iter().map(|row| content(row, with));
        contents
            .map(|(file, numbers)| (fingerprint(&numbers), file))
            .collect()
    }

    /// Hands the rows to a check of admission, which decides whether the data can be used; only its
    /// refusal comes out, in a sentence.
    pub fn refusal<C: ?Sized>(
        &self,
        with: &C,
        check: fn(&[R], &C) -> Option<String>,
    ) -> Option<String> {
        check(&self.rows, with)
    }

    /// Breaks the seal for one decision, once that is written down.
    ///
    /// # Errors
    /// What the ledger says where it cannot be written: nothing comes out then.
    pub fn unseal<D: Decide>(self, decision: D, ledger: &Ledger) -> Result<Opened<R, D>, String> {
        if self.is_empty() {
            return Ok(Opened {
                rows: self.rows,
                decision,
                look: None,
            });
        }
        let decision_sha256 = sha256_hex(canonical_json(&decision.content()).as_bytes());
        let opening = Opening {
            decision_sha256: &decision_sha256,
            rows: self.rows.len(),
        };
        // Written down before the rows come out: a program that dies afterwards has looked, too.
        let number = ledger.0.as_ref().map_or(Ok(1), |record| record(&opening))?;
        Ok(Opened {
            rows: self.rows,
            decision,
            look: Some(Look {
                number,
                decision_sha256,
            }),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::Mutex;

    /// A number that was decided on.
    struct Value(f64);

    impl Decide for Value {
        fn content(&self) -> serde_json::Value {
            self.0.into()
        }
    }

    #[test]
    fn nothing_that_was_read_comes_out_of_a_seal() {
        let sealed = Sealed::new(vec![41.5, 42.5]);
        assert_eq!(format!("{sealed:?}"), "Sealed(2 rows)");
        let check: fn(&[f64], &f64) -> Option<String> =
            |rows, least| rows.iter().all(|r| r > least).then(|| "two".to_owned());
        assert_eq!(sealed.refusal(&41.0, check), Some("two".to_owned()));
        // Control: unsealed they are there.
        let opened = sealed.unseal(Value(0.0), &Ledger::default()).unwrap();
        assert_eq!(opened.assess(|_, rows, _| rows.to_vec()).1, [41.5, 42.5]);
    }

    #[test]
    fn a_row_is_known_by_its_numbers_to_ten_digits() {
        let known = |numbers: &[f64]| fingerprint(numbers);
        assert_eq!(
            known(&[1.0, 0.0]),
            known(&["1.00000000000001".parse().unwrap(), -0.0])
        );
        assert_ne!(
            known(&[1.0, 0.0]),
            known(&[0.0, 1.0]),
            "negative control: columns that are exchanged"
        );
        assert_ne!(
            known(&[1.0]),
            known(&[1.000_000_1]),
            "negative control: another reading"
        );
        let sealed = Sealed::new(vec![1.5, 1.5, 2.5]);
        assert_eq!(
            sealed
                .fingerprints("h.csv", |row, file| (file.to_owned(), vec![*row]))
                .len(),
            2
        );
    }

    #[test]
    fn a_look_has_its_number_and_what_is_left_of_the_level() {
        let known: Arc<Mutex<Vec<String>>> = Arc::default();
        let written = Arc::clone(&known);
        let ledger = Ledger::new(move |opening| {
            let mut all = written.lock().unwrap();
            let of = |all: &Vec<String>| all.iter().position(|d| d == opening.decision_sha256);
            if of(&all).is_none() {
                all.push(opening.decision_sha256.to_owned());
            }
            Ok(of(&all).unwrap() + 1)
        });
        let look = |value: f64| {
            let opened = Sealed::new(vec![1.0])
                .unseal(Value(value), &ledger)
                .unwrap();
            opened.assess(|_, _, look| look.unwrap().clone()).1
        };
        let [first, second, again] = [look(1.0), look(2.0), look(1.0)];
        assert_eq!(
            (first.number, second.number, again.number),
            (1, 2, 1),
            "the same decision is the same look"
        );
        assert_eq!(
            [first.level(0.6), second.level(0.6)],
            [0.6 / 2.0, 0.6 / 6.0]
        );
    }

    #[test]
    fn rows_come_out_after_the_ledger_is_written_and_not_without() {
        let full = Ledger::new(|_| Err("disk full".to_owned()));
        let error = Sealed::new(vec![1.0])
            .unseal(Value(0.0), &full)
            .map(|_| ())
            .unwrap_err();
        assert_eq!(error, "disk full");
        // Control: what is empty was not opened.
        let nothing = Sealed::<f64>::default().unseal(Value(0.0), &full).unwrap();
        assert!(nothing.assess(|_, _, look| look.is_none()).1);
    }
}
