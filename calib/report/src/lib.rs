//! wcal-report
