//! A gripper that grips harder when the module says slip: the generator's plant, the firmware's pipeline, real
//! messages on a modelled bus, and a re-grasp controller, in one loop. All of it is synthetic.
//!
//! ```text
//! tick ─ scan and samples ─> Pipeline ─ inference ─> slip message ─ CAN FD ─> Controller ─ command
//!   ^                                                                                        │
//!   └───────────── Plant: contact, friction, sensors <── actuator, 20 to 40 ms <─────────────┘
//! ```

mod controller;
mod link;
mod results;
mod trial;

pub use controller::{Controller, Flag, Reaction};
pub use link::{Heard, Link};
pub use results::{Facts, Failure, Spread, Totals};
pub use trial::{ACTUATOR_MS, Course, Loop, Outcome, inference_us, run};
