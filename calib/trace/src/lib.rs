//! wcal-trace
