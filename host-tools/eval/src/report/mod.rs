//! The report: one HTML file with tables and plots, nothing loaded from elsewhere.

pub(crate) mod plots;
mod timeline;
mod tables;
mod page;

pub use page::html;
