//! Flat Parquet tables: named columns in, bytes out, and back.

use parquet::basic::Compression;
use parquet::data_type::{ByteArray, ByteArrayType, DoubleType, Int64Type};
use parquet::errors::ParquetError;
use parquet::file::metadata::KeyValue;
use parquet::file::properties::WriterProperties;
use parquet::file::reader::{FileReader, SerializedFileReader};
use parquet::file::writer::SerializedFileWriter;
use parquet::record::Field;
use parquet::schema::parser::parse_message_type;
use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::Path;
use std::sync::Arc;

/// Values of a column, one a row.
#[derive(Debug, Clone, PartialEq)]
pub enum Column {
    /// Whole numbers.
    Whole(Vec<i64>),
    /// Numbers.
    Real(Vec<f64>),
    /// Numbers, some of which are not there.
    Maybe(Vec<Option<f64>>),
    /// Words.
    Text(Vec<String>),
}

/// A Parquet file of these columns; `about` goes into its key-value metadata.
///
/// # Errors
/// Where columns differ in length.
pub fn to_bytes(columns: &[(&str, Column)], about: &[(&str, String)]) -> Result<Vec<u8>, ParquetError> {
    let mut schema = String::from("message table {\n");
    for (name, column) in columns {
        let kind = match column {
            Column::Whole(_) => "REQUIRED INT64",
            Column::Real(_) => "REQUIRED DOUBLE",
            Column::Maybe(_) => "OPTIONAL DOUBLE",
            Column::Text(_) => "REQUIRED BYTE_ARRAY",
        };
        let word = if matches!(column, Column::Text(_)) { " (UTF8)" } else { "" };
        writeln!(schema, "{kind} {name}{word};").map_err(|e| ParquetError::General(e.to_string()))?;
    }
    schema.push('}');
    let about = about.iter().map(|(k, v)| KeyValue::new((*k).to_owned(), v.clone())).collect();
    let properties = WriterProperties::builder()
        .set_compression(Compression::SNAPPY)
        .set_key_value_metadata(Some(about))
        .build();
    let mut bytes = Vec::new();
    let mut file =
        SerializedFileWriter::new(&mut bytes, Arc::new(parse_message_type(&schema)?), Arc::new(properties))?;
    let mut group = file.next_row_group()?;
    for (_, column) in columns {
        let Some(mut writer) = group.next_column()? else { break };
        match column {
            Column::Whole(v) => writer.typed::<Int64Type>().write_batch(v, None, None)?,
            Column::Real(v) => writer.typed::<DoubleType>().write_batch(v, None, None)?,
            Column::Maybe(v) => {
                let there: Vec<f64> = v.iter().flatten().copied().collect();
                let levels: Vec<i16> = v.iter().map(|x| i16::from(x.is_some())).collect();
                writer.typed::<DoubleType>().write_batch(&there, Some(&levels), None)?
            }
            Column::Text(v) => {
                let v: Vec<ByteArray> = v.iter().map(|s| ByteArray::from(s.as_str())).collect();
                writer.typed::<ByteArrayType>().write_batch(&v, None, None)?
            }
        };
        writer.close()?;
    }
    group.close()?;
    file.close()?;
    Ok(bytes)
}

/// The columns of a table by name. A column of numbers comes as [`Column::Maybe`] whether values are missing or not.
///
/// # Errors
/// Where the file is no such table.
pub fn read(path: &Path) -> Result<BTreeMap<String, Column>, ParquetError> {
    let file = wcal_core::files::open(path).map_err(|e| ParquetError::General(e.to_string()))?;
    let mut columns: BTreeMap<String, Column> = BTreeMap::new();
    for row in SerializedFileReader::new(file)?.get_row_iter(None)? {
        for (name, field) in row?.get_column_iter() {
            let fits = match field {
                Field::Long(v) => match columns.entry(name.clone()).or_insert(Column::Whole(Vec::new())) {
                    Column::Whole(all) => {
                        all.push(*v);
                        true
                    }
                    _ => false,
                },
                Field::Str(v) => match columns.entry(name.clone()).or_insert(Column::Text(Vec::new())) {
                    Column::Text(all) => {
                        all.push(v.clone());
                        true
                    }
                    _ => false,
                },
                Field::Double(_) | Field::Null => {
                    match columns.entry(name.clone()).or_insert(Column::Maybe(Vec::new())) {
                        Column::Maybe(all) => {
                            all.push(if let Field::Double(v) = field { Some(*v) } else { None });
                            true
                        }
                        _ => false,
                    }
                }
                _ => false,
            };
            if !fits {
                return Err(ParquetError::General(format!(
                    "column {name}: expected whole numbers, numbers or words, found {field}"
                )));
            }
        }
    }
    Ok(columns)
}
