//! wcal-rod
