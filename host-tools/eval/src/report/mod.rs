//! The report: one HTML file with tables and plots, nothing loaded from elsewhere.

mod grids;
mod page;
mod parts;
mod plots;
mod timeline;

pub use page::html;
