//! Every rate, size and physical constant of the module, once, with its unit and its derivation.
//!
//! Numbers that belong to a trained network (channels, widths, scales) are not here: they come from
//! the model file ([`crate::net`]). What is here is what the sensors, the front end and the paper fix,
//! and the upper bounds that make the RAM of the firmware known at compile time.

/// Sensors (fingertips) behind one aggregation board, at most.
pub const MAX_SENSORS: usize = 3;

/// Rows of the piezoresistive array (paper, section 3: 32×32 grid).
pub const TAXEL_ROWS: usize = 32;
/// Columns of the piezoresistive array.
pub const TAXEL_COLS: usize = 32;
/// Cells of the grid, active or not.
pub const TAXELS: usize = TAXEL_ROWS * TAXEL_COLS;
/// Taxels that exist on the rounded pad (paper, section 3).
pub const ACTIVE_TAXELS: usize = 942;
/// Pitch between neighbouring columns, millimetres (paper: 0.7 × 0.92 mm).
pub const COL_PITCH_MM: f32 = 0.7;
/// Pitch between neighbouring rows, millimetres.
pub const ROW_PITCH_MM: f32 = 0.92;
/// Largest count of a taxel, 12 bits ([`transfer`](crate::transfer)).
pub const COUNT_MAX: u16 = 4095;

/// Cells cut from the left and from the right of each row, so that 942 of 1024 remain: 20 nearest to
/// each of the corners (0,0) and (0,31), 21 nearest to each of (31,0) and (31,31), distance measured in
/// cells, ties to the smaller row distance. The paper does not say which cells its 942 are.
pub const ROW_CUT: [u8; TAXEL_ROWS] = {
    let mut cut = [0; TAXEL_ROWS];
    let (top, bottom) = ([5, 5, 4, 4, 2], [2, 4, 5, 5, 5]);
    let mut i = 0;
    while i < 5 {
        cut[i] = top[i];
        cut[TAXEL_ROWS - 5 + i] = bottom[i];
        i += 1;
    }
    cut
};

/// Frames per second: one frame is one array scan and the accelerometer samples up to its tick.
pub const FRAME_RATE_HZ: u32 = 240;
/// Time from a tick to the next, rounded up to microseconds; a decision that takes longer is late.
pub const FRAME_PERIOD_US: u64 = 1_000_000u64.div_ceil(FRAME_RATE_HZ as u64);
/// Nominal accelerometer rate; a real part's own oscillator is off by 1–3 %, so nothing assumes
/// 33.33 samples per frame.
pub const XL_RATE_HZ: u32 = 8_000;
/// Accelerometer axes.
pub const XL_AXES: usize = 3;

/// Analysis window of the front end, samples: 16 ms at 8 kHz (paper, section 4).
pub const XL_WINDOW: usize = 128;
/// Samples that one frame brings at most: one analysis window, 16 ms or nearly four frames. More than
/// the FIFO of an ADXL380 holds (105).
pub const XL_BATCH_MAX: usize = XL_WINDOW;
/// Bins of the real FFT, DC and Nyquist included.
pub const FFT_BINS: usize = XL_WINDOW / 2 + 1;
/// Mel bins per frame (paper: F = 16).
pub const MEL_BINS: usize = 16;
/// Features that the network sees of an accelerometer: the standardised bins, and how far each is above its noise floor.
pub const XL_FEATURES: usize = 2 * MEL_BINS;
/// Lower edge of the first mel triangle, Hz.
pub const MEL_LOW_HZ: u32 = 20;
/// Upper edge of the last mel triangle, Hz.
pub const MEL_HIGH_HZ: u32 = 4_000;
/// Corner of the second-order Butterworth high-pass, Hz (paper: "10 Hz, empirical").
pub const HIGHPASS_HZ: u32 = 10;

/// A pad is touched when the sum of its active taxels reaches this many counts: the paper's universal
/// threshold, a mean of one ADC count, over the active taxels of one sensor.
pub const CONTACT_SUM_MIN: u32 = ACTIVE_TAXELS as u32;

/// A taxel counts towards the area and the centre of a contact from this many counts on: above the noise of an idle
/// taxel (0.5 to 1.5 LSB rms), so that idle taxels do not pull the centre to the middle of the pad.
pub const TAXEL_TOUCH_MIN: u16 = 8;

/// Channels that the network sees of an array: the counts, and their change ([`piezo`](crate::features::piezo)).
pub const PIEZO_CHANNELS: usize = 2;

/// Largest number in a map that a convolution takes, 14 bits and a sign; the least is one below its negative. The sum
/// or difference of two such numbers, which is what it multiplies, has 16 bits.
pub const CONV_INPUT_MAX: i32 = (1 << 14) - 1;

/// Classes of the network: no contact, contact without slip, slip (paper, section 5).
pub const CLASSES: usize = 3;
/// Outputs of the network: the logits of the classes, then the detector's log-odds of slip.
pub const OUTPUTS: usize = CLASSES + 1;

/// Upper bounds of a model file and of what it may ask for. They fix the size of the network's state.
pub mod limits {
    /// Bytes of the longest file that the firmware takes: two of them, one that runs and one that is tried, and all else
    /// fill 93 % of AXI SRAM.
    pub const MODEL_BYTES: usize = 126 * 1024;
    /// Channels after each of the three convolution blocks.
    pub const CONV_CHANNELS: [usize; 3] = [8, 16, 32];
    /// Width of one modality's embedding.
    pub const EMBED: usize = 64;
    /// Hidden channels of the accelerometer encoder.
    pub const XL_CHANNELS: usize = 96;
    /// Taps of the causal convolution over time.
    pub const XL_KERNEL: usize = 6;
    /// Attention heads.
    pub const HEADS: usize = 8;
    /// Frames an attention layer looks back over, the current one included.
    pub const WINDOW: usize = 60;
}

const _: () = {
    let mut active = 0;
    let mut row = 0;
    while row < TAXEL_ROWS {
        active += TAXEL_COLS - 2 * ROW_CUT[row] as usize;
        row += 1;
    }
    assert!(active == ACTIVE_TAXELS);
    assert!(MEL_HIGH_HZ * 2 == XL_RATE_HZ, "the last triangle ends at Nyquist");
    assert!(XL_WINDOW.is_power_of_two());
    assert!(TAXEL_ROWS.is_multiple_of(8) && TAXEL_COLS.is_multiple_of(8), "three 2×2 pools");
};
