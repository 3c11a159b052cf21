//! What a person looks at: report.json, report.html, overlays, charts.
//!
//! Everything above → files for eyes. This room never computes a picture it reports on.
