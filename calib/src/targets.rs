//! targets: to come
