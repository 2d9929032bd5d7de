//! Tests of the crate through what it makes public.

mod c_header;
mod canadensis;
mod candump;
mod files;
mod formats;
mod fuzz;
mod killed;
mod regulated_types;
mod round_trip;
mod rules;
mod slip_receiver;
mod stand_log;
mod support;
