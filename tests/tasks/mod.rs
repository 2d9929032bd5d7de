//! Tasks above the seam on a modelled bus, in virtual time: what is lost, what never is, and that it is all counted.

mod fault_plan;
mod faults;
mod full_bus;
mod crash_record;
mod queue;
mod self_check;
mod services;
mod services_alone;
mod soak;
mod supervise;
mod transmit;
pub mod world;
