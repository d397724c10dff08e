//! The `wcal` program.
fn main() {}
