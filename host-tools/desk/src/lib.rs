//! What an engineer with a module on a bus needs on the desk: recordings of the bus in the formats that people use,
//! where frames come from and go to, the load of a bus, and what other programs need to read a slip message.

mod asc;
pub mod busload;
pub mod c_header;
pub mod dbc;
pub mod decode;
pub mod layout;
pub mod link;
pub mod log_file;
pub mod mcap_file;
mod quiet;
pub mod rebuild;
pub mod recorder;
mod slcan;
mod vector;

pub use slipsense_bus::LogEntry;
