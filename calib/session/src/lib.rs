//! wcal-session
