//! A gripper that grips harder when the module reports slip: the generator's plant, the firmware's pipeline, real
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

pub use controller::{Flag, Reaction};
pub use results::{Failure, Spread, Totals, TrialResult};
pub use trial::{ACTUATOR_MS, LoopConfig, Outcome, TrialSeries, inference_us, run};
