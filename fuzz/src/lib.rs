//! The fuzz targets of Platelight: one for each format, see [`formats`].

pub mod formats;
