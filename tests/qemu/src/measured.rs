//! Files of the benchmark program. It writes one line of text per measurement, numbers in emulated instructions:
//!
//! - `check EXPECTED MEASURED`: of a loop, by its code and by the counter;
//! - `kernel MACS INSTRUCTIONS NAME`: a call, with 0 multiply-accumulates where there are none to speak of;
//! - `frame STEP WIRE`: of `Pipeline::step`, and from its result to CAN frames;
//! - `compressed BYTES INSTRUCTIONS`: one sensor's frame.

/// Name of a file whose presence asks for the path alone, because the emulator writes down all that is done.
pub const TRACE_FILE: &str = "trace.in";
/// Name of the file that it then makes before the last frame, waiting for the next.
pub const READY_FILE: &str = "ready.out";
pub const GO_FILE: &str = "go.in";
/// Name of a file whose presence asks for the compression alone, of every frame and sensor.
pub const COMPRESSION_FILE: &str = "compress.in";
/// Name of the file that the benchmark program writes.
pub const MEASURED_FILE: &str = "measured.txt";
/// Frames after which every window is full: their numbers are not measurements of a running stream.
pub const WARM_UP_FRAMES: usize = 60;
