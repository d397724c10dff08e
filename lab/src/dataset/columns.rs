//! Flat Parquet tables: named columns in, bytes out.

use parquet::basic::Compression;
use parquet::data_type::{ByteArray, ByteArrayType, DoubleType, Int64Type};
use parquet::errors::ParquetError;
use parquet::file::metadata::KeyValue;
use parquet::file::properties::WriterProperties;
use parquet::file::writer::SerializedFileWriter;
use parquet::schema::parser::parse_message_type;
use std::fmt::Write as _;
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
pub fn to_bytes(
    columns: &[(&str, Column)],
    about: &[(&str, String)],
) -> Result<Vec<u8>, ParquetError> {
    let mut schema = String::from("message table {\n");
    for (name, column) in columns {
        let kind = match column {
            Column::Whole(_) => "REQUIRED INT64",
            Column::Real(_) => "REQUIRED DOUBLE",
            Column::Maybe(_) => "OPTIONAL DOUBLE",
            Column::Text(_) => "REQUIRED BYTE_ARRAY",
        };
        let word = if matches!(column, Column::Text(_)) {
            " (UTF8)"
        } else {
            ""
        };
        writeln!(schema, "{kind} {name}{word};")
            .map_err(|e| ParquetError::General(e.to_string()))?;
    }
    schema.push('}');
    let about = about
        .iter()
        .map(|(k, v)| KeyValue::new((*k).to_owned(), v.clone()))
        .collect();
    let properties = WriterProperties::builder()
        .set_compression(Compression::SNAPPY)
        .set_key_value_metadata(Some(about))
        .build();
    let mut bytes = Vec::new();
    let mut file = SerializedFileWriter::new(
        &mut bytes,
        Arc::new(parse_message_type(&schema)?),
        Arc::new(properties),
    )?;
    let mut group = file.next_row_group()?;
    for (_, column) in columns {
        let Some(mut writer) = group.next_column()? else {
            break;
        };
        match column {
            Column::Whole(v) => writer.typed::<Int64Type>().write_batch(v, None, None)?,
            Column::Real(v) => writer.typed::<DoubleType>().write_batch(v, None, None)?,
            Column::Maybe(v) => {
                let there: Vec<f64> = v.iter().flatten().copied().collect();
                let levels: Vec<i16> = v.iter().map(|x| i16::from(x.is_some())).collect();
                writer
                    .typed::<DoubleType>()
                    .write_batch(&there, Some(&levels), None)?
            }
            Column::Text(v) => {
                let v: Vec<ByteArray> = v.iter().map(|s| ByteArray::from(s.as_str())).collect();
                writer
                    .typed::<ByteArrayType>()
                    .write_batch(&v, None, None)?
            }
        };
        writer.close()?;
    }
    group.close()?;
    file.close()?;
    Ok(bytes)
}
