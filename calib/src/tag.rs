//! tags: to come
