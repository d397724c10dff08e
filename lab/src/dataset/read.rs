//! Reads the dataset's tables back.

use super::columns::Column;
use super::shard::{self, Manifest};
use crate::LabError;
use parquet::basic::Type;
use parquet::column::reader::ColumnReader;
use parquet::file::reader::{FileReader, SerializedFileReader};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// A table of a shard, by the columns' names.
#[derive(Debug, Clone)]
pub struct Table {
    path: PathBuf,
    columns: BTreeMap<String, Column>,
}

impl Table {
    /// Whole numbers of a column.
    ///
    /// # Errors
    /// Where there is no such column of that kind.
    pub fn whole(&self, name: &str) -> Result<&[i64], LabError> {
        match self.columns.get(name) {
            Some(Column::Whole(v)) => Ok(v),
            other => Err(self.wrong(name, "whole numbers", other)),
        }
    }

    /// Numbers of a column, finite all of them.
    ///
    /// # Errors
    /// Where there is no such column of that kind, or a value is not finite.
    pub fn real(&self, name: &str) -> Result<&[f64], LabError> {
        match self.columns.get(name) {
            Some(Column::Real(v)) => match v.iter().position(|x| !x.is_finite()) {
                None => Ok(v),
                Some(row) => Err(self.broken(format!(
                    "row {row}, {name}: expected a number, found {}",
                    v[row]
                ))),
            },
            other => Err(self.wrong(name, "numbers", other)),
        }
    }

    /// Numbers of a column that may be absent.
    ///
    /// # Errors
    /// Where there is no such column of that kind, or a value is not finite.
    pub fn maybe(&self, name: &str) -> Result<&[Option<f64>], LabError> {
        match self.columns.get(name) {
            Some(Column::Maybe(v)) => {
                match v.iter().position(|x| x.is_some_and(|x| !x.is_finite())) {
                    None => Ok(v),
                    Some(row) => Err(self.broken(format!(
                        "row {row}, {name}: expected a number, found {:?}",
                        v[row]
                    ))),
                }
            }
            other => Err(self.wrong(name, "numbers or nothing", other)),
        }
    }

    /// Words of a column.
    ///
    /// # Errors
    /// Where there is no such column of that kind.
    pub fn text(&self, name: &str) -> Result<&[String], LabError> {
        match self.columns.get(name) {
            Some(Column::Text(v)) => Ok(v),
            other => Err(self.wrong(name, "words", other)),
        }
    }

    fn wrong(&self, name: &str, expected: &str, found: Option<&Column>) -> LabError {
        let found = found.map_or("no such column", |_| "another kind of column");
        self.broken(format!("{name}: expected {expected}, found {found}"))
    }

    fn broken(&self, detail: String) -> LabError {
        LabError::Shard {
            path: self.path.clone(),
            detail,
        }
    }
}

/// Reads one Parquet table.
///
/// # Errors
/// Where the file cannot be read or is not such a table.
pub fn table(path: &Path) -> Result<Table, LabError> {
    let file = wcal_core::files::open(path)?;
    let broken = |detail: String| LabError::Shard {
        path: path.to_owned(),
        detail,
    };
    let columns = columns(file).map_err(|e| broken(e.to_string()))?;
    Ok(Table {
        path: path.to_owned(),
        columns,
    })
}

fn columns(file: std::fs::File) -> Result<BTreeMap<String, Column>, parquet::errors::ParquetError> {
    let reader = SerializedFileReader::new(file)?;
    let mut all: BTreeMap<String, Column> = BTreeMap::new();
    for g in 0..reader.num_row_groups() {
        let group = reader.get_row_group(g)?;
        let rows = usize::try_from(group.metadata().num_rows()).unwrap_or(0);
        for c in 0..group.num_columns() {
            let about = group.metadata().column(c).column_descr_ptr();
            let mut levels: Vec<i16> = Vec::new();
            let part = match (about.physical_type(), group.get_column_reader(c)?) {
                (Type::INT64, ColumnReader::Int64ColumnReader(mut r)) => {
                    let mut values = Vec::with_capacity(rows);
                    r.read_records(rows, None, None, &mut values)?;
                    Column::Whole(values)
                }
                (Type::DOUBLE, ColumnReader::DoubleColumnReader(mut r)) => {
                    let mut values: Vec<f64> = Vec::with_capacity(rows);
                    if about.max_def_level() == 0 {
                        r.read_records(rows, None, None, &mut values)?;
                        Column::Real(values)
                    } else {
                        r.read_records(rows, Some(&mut levels), None, &mut values)?;
                        let mut there = values.into_iter();
                        Column::Maybe(
                            levels
                                .iter()
                                .map(|l| if *l > 0 { there.next() } else { None })
                                .collect(),
                        )
                    }
                }
                (Type::BYTE_ARRAY, ColumnReader::ByteArrayColumnReader(mut r)) => {
                    let mut values = Vec::with_capacity(rows);
                    r.read_records(rows, None, None, &mut values)?;
                    let word = |b: &parquet::data_type::ByteArray| {
                        String::from_utf8_lossy(b.data()).into_owned()
                    };
                    Column::Text(values.iter().map(word).collect())
                }
                _ => continue,
            };
            match (all.get_mut(about.name()), part) {
                (Some(Column::Whole(a)), Column::Whole(b)) => a.extend(b),
                (Some(Column::Real(a)), Column::Real(b)) => a.extend(b),
                (Some(Column::Maybe(a)), Column::Maybe(b)) => a.extend(b),
                (Some(Column::Text(a)), Column::Text(b)) => a.extend(b),
                (_, part) => {
                    all.insert(about.name().to_owned(), part);
                }
            }
        }
    }
    Ok(all)
}

/// Manifests of a dataset's folder in the order of their names, each checked against its tables.
///
/// # Errors
/// Where the folder or a manifest cannot be read, or a table differs from its checksum.
pub fn manifests(folder: &Path) -> Result<Vec<(String, Manifest)>, LabError> {
    let entries = std::fs::read_dir(folder).map_err(LabError::file("reading", folder))?;
    let mut names: Vec<String> = entries
        .filter_map(|e| e.ok()?.file_name().into_string().ok())
        .filter_map(|n| n.strip_suffix(".sweeps.parquet").map(str::to_owned))
        .collect();
    names.sort_unstable();
    names
        .into_iter()
        .map(|name| {
            let manifest = shard::read_manifest(&folder.join(format!("{name}.json")))?;
            shard::check(folder, &manifest)?;
            Ok((name, manifest))
        })
        .collect()
}
