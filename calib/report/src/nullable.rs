//! Numbers that JSON writes as null: what is no number is read back as NaN.

use serde::{Deserialize, Deserializer};

/// Numbers that may be NaN, which JSON has as null.
pub(crate) trait Nullable: Sized {
    /// The same with null in such places.
    type Written: for<'de> Deserialize<'de>;
    /// NaN where null stands.
    fn read(written: Self::Written) -> Self;
}

impl Nullable for f64 {
    type Written = Option<Self>;
    fn read(written: Self::Written) -> Self {
        written.unwrap_or(Self::NAN)
    }
}

impl Nullable for [f64; 2] {
    type Written = [Option<f64>; 2];
    fn read(written: Self::Written) -> Self {
        written.map(f64::read)
    }
}

impl<T: Nullable> Nullable for Vec<T> {
    type Written = Vec<T::Written>;
    fn read(written: Self::Written) -> Self {
        written.into_iter().map(T::read).collect()
    }
}

impl<T: Nullable> Nullable for Option<T> {
    type Written = Option<T::Written>;
    fn read(written: Self::Written) -> Self {
        written.map(T::read)
    }
}

/// For `deserialize_with`.
pub(crate) fn or_nan<'de, D: Deserializer<'de>, T: Nullable>(numbers: D) -> Result<T, D::Error> {
    T::Written::deserialize(numbers).map(T::read)
}
