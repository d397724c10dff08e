//! wcal-map
