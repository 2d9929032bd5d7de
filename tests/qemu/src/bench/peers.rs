//! Kernels of other libraries in Rust, at the shapes of [`crate::kernels`].

use core::array;
use core::hint::black_box;

use microflow::activation::FusedActivation;
use microflow::buffer::Buffer2D;
use microflow::ops::{Conv2DOptions, FullyConnectedOptions, conv_2d, fully_connected};
use microflow::tensor::{Tensor2D, Tensor4D, TensorViewPadding};

use crate::emulated::Bench;
use crate::kernels::noise;

/// Measure everything.
pub fn measure(bench: &mut Bench) {
    let mut samples = [0f32; 128];
    samples.iter_mut().zip(noise()).for_each(|(sample, x)| *sample = f32::from(x));
    bench.peer("microfft 0.6 (f32): real FFT 128", 0, &mut || {
        black_box(microfft::real::rfft_128(black_box(&mut samples)));
    });
    conv::<32, 1, 8>(bench, "microflow 0.1.3 (s8): conv 3x3 32x32x1->8, ReLU, no pool");
    conv::<16, 8, 16>(bench, "microflow 0.1.3 (s8): conv 3x3 16x16x8->16, ReLU, no pool");
    conv::<8, 16, 32>(bench, "microflow 0.1.3 (s8): conv 3x3 8x8x16->32, ReLU, no pool");
    dense(bench);
}

fn conv<const SIDE: usize, const INPUTS: usize, const OUTPUTS: usize>(bench: &mut Bench, name: &str) {
    let mut x = bytes();
    let image = [Buffer2D::<[i8; INPUTS], SIDE, SIDE>::from_fn(|_, _| array::from_fn(|_| x()))];
    let mut image = Some(Tensor4D::new(image, [0.1], [0]));
    let filters = array::from_fn(|_| Buffer2D::<[i8; INPUTS], 3, 3>::from_fn(|_, _| array::from_fn(|_| x())));
    let filters: Tensor4D<i8, OUTPUTS, 3, 3, INPUTS, 1> = Tensor4D::new(filters, [0.1], [0]);
    bench.peer(name, SIDE * SIDE * 9 * INPUTS * OUTPUTS, &mut || {
        let options = Conv2DOptions {
            fused_activation: FusedActivation::Relu,
            view_padding: TensorViewPadding::Same,
            strides: (1, 1),
        };
        let constants = (Buffer2D::<f32, OUTPUTS, 1>::repeat(1.0), Buffer2D::<f32, 1, 1>::repeat(0.001));
        let image = black_box(&mut image).take().expect("measured once");
        let out: Tensor4D<i8, 1, SIDE, SIDE, OUTPUTS, 1> =
            conv_2d(image, black_box(&filters), [0.1], [0], options, black_box(constants));
        black_box(&out);
    });
}

fn dense(bench: &mut Bench) {
    const INPUTS: usize = 512;
    const OUTPUTS: usize = 128;
    let mut x = bytes();
    let mut input = Some(Tensor2D::new(Buffer2D::<i8, 1, INPUTS>::from_fn(|_, _| x()), [0.1], [0]));
    let weights = Tensor2D::new(Buffer2D::<i8, INPUTS, OUTPUTS>::from_fn(|_, _| x()), [0.1], [0]);
    bench.peer("microflow 0.1.3 (s8): dense 512->128", INPUTS * OUTPUTS, &mut || {
        let options = FullyConnectedOptions { fused_activation: FusedActivation::None };
        let constants =
            (Buffer2D::<f32, OUTPUTS, 1>::repeat(1.0), 0.001, Buffer2D::<i32, 1, OUTPUTS>::repeat(3), 5);
        let input = black_box(&mut input).take().expect("measured once");
        black_box(fully_connected(input, black_box(&weights), [0.1], [0], options, black_box(constants)));
    });
}

fn bytes() -> impl FnMut() -> i8 {
    let mut source = noise();
    move || source.next().map_or(0, |x| (x >> 8) as i8)
}
