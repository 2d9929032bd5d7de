//! The front end's FFT by CMSIS-DSP, beside ours in [`crate::kernels`].

use core::hint::black_box;

use slipsense::features::XlFrontEnd;
use slipsense::features::cmsis::{Work, rfft, windowed_fft};
use slipsense::params::XL_WINDOW;

use crate::emulated::Bench;
use crate::kernels::{noise, samples};

/// Measure everything.
pub fn measure(bench: &mut Bench) {
    let (mut window, mut spectrum) = ([0; XL_WINDOW], [0; 2 * XL_WINDOW]);
    window.iter_mut().zip(noise()).for_each(|(x, noise)| *x = i32::from(noise) << 12);
    let mut work = Work::default();
    bench.peer("CMSIS-DSP q31: Hann window and real FFT 128", 0, &mut || {
        windowed_fft(black_box(&window), &mut work, |_, bin| _ = black_box(bin));
    });
    bench.peer("CMSIS-DSP q31: XlFrontEnd::log_mel with it", 0, &mut {
        let mut front_end = XlFrontEnd::new();
        front_end.push(&samples());
        move || _ = black_box(black_box(&front_end).log_mel())
    });
    bench.peer("CMSIS-DSP q31: real FFT 128", 0, &mut || {
        rfft(black_box(&mut window), black_box(&mut spectrum))
    });
}
