//! The sealed rows of a session, whatever its kind, and what of them may be known.

use crate::observation::{TransducerRow, WhiskerRow};
use crate::sealed::{Labelled, RowLabel, Sealed};

/// Sealed rows of a session of any kind.
#[derive(Debug)]
pub enum SealedRows {
    /// Of a whisker.
    Whisker(Sealed<WhiskerRow>),
    /// Of a transducer or an axis.
    Transducer(Sealed<TransducerRow>),
}

impl Default for SealedRows {
    fn default() -> Self {
        Self::Whisker(Sealed::default())
    }
}

impl SealedRows {
    /// Those of a whisker; none of another kind of session.
    pub fn whisker(self) -> Sealed<WhiskerRow> {
        match self {
            Self::Whisker(rows) => rows,
            Self::Transducer(_) => Sealed::default(),
        }
    }

    /// Those of a transducer or an axis; none of a whisker.
    pub fn transducer(self) -> Sealed<TransducerRow> {
        match self {
            Self::Transducer(rows) => rows,
            Self::Whisker(_) => Sealed::default(),
        }
    }

    /// Number of rows.
    pub fn len(&self) -> usize {
        match self {
            Self::Whisker(rows) => rows.len(),
            Self::Transducer(rows) => rows.len(),
        }
    }

    /// Whether nothing is sealed.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
}

impl Labelled for WhiskerRow {
    fn label(&self) -> RowLabel {
        RowLabel {
            point: self.point,
            trajectory: self.trajectory,
            seating: self.seating,
            series: None,
            t_s: self.t_s,
            pictured: self.pair.is_some(),
        }
    }
}

impl Labelled for TransducerRow {
    fn label(&self) -> RowLabel {
        RowLabel {
            point: self.point,
            t_s: self.t_s,
            series: self.replicate,
            ..RowLabel::default()
        }
    }
}
