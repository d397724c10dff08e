//! A calibration as numbers by the names of templates.

/// What can be written as code.
#[derive(Debug, Clone, PartialEq)]
pub struct Export {
    /// Its template: `scalar` or `map`.
    pub template: &'static str,
    /// Names of the inputs; none: one that does not matter.
    pub inputs: [Option<&'static str>; 3],
    /// Units of the first input and of the value.
    pub units: [String; 2],
    /// Numbers by their names in the template, row by row.
    pub numbers: Vec<(&'static str, Vec<Vec<f64>>)>,
    /// Of a transducer with one input a piecewise linear function, rising, and its largest
    /// deviation.
    pub points: Option<(Vec<[f64; 2]>, f64)>,
}
