//! The metrics, each in its own file with its definition. They return numbers; the tables are in the report.
//!
//! A field's name says what it is and carries the unit: `_frames` of 1/240 s, `_share` from 0 to 1, `_per_hour`,
//! `_hours`, `_mm`. A number that does not exist is `None`: infinite, or nothing to divide by.

pub mod statistics;
pub mod frames;
pub(crate) mod alarms;
pub(crate) mod events;
pub(crate) mod figures;
pub(crate) mod bootstrap;
pub(crate) mod groups;
pub(crate) mod operating;
