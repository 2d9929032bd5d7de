//! The log-mel image: a small palette PNG, embedded in the picture.

use std::ops::Range;

use anyhow::{Context, Result};
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use slipsense::params::MEL_BINS;

use super::scale::columns;

/// Pixel rows of one mel bin: viewers that smooth an enlarged image leave the bins' edges sharp.
const BIN_ROWS: usize = 6;
const WIDTH_MAX: usize = 1600;

/// Dark to bright and even to the eye, also in grey (matplotlib's "inferno", every 32nd colour).
const COLOURS: [[u8; 3]; 9] = [
    [0, 0, 4],
    [31, 12, 72],
    [85, 15, 109],
    [136, 34, 106],
    [186, 54, 85],
    [227, 89, 51],
    [249, 140, 10],
    [249, 201, 50],
    [252, 255, 164],
];

/// A `data:` URI with the log-mel values of one sensor: time runs right, frequency up. `level` gives the
/// value of a frame and bin; `range` goes from the darkest to the brightest colour.
pub(super) fn image(
    frames: Range<usize>,
    range: &Range<f64>,
    level: impl Fn(usize, usize) -> f64,
) -> Result<String> {
    let columns = columns(frames, WIDTH_MAX);
    let (width, height) = (columns.len(), MEL_BINS * BIN_ROWS);
    let mut pixels = Vec::with_capacity(width * height);
    for bin in (0..MEL_BINS).rev() {
        // Of frames that share a column the loudest shows: a slip may be short.
        let loudest = |frames: &Range<usize>| frames.clone().map(|f| level(f, bin)).fold(f64::MIN, f64::max);
        let row: Vec<u8> = columns.iter().map(|frames| index(loudest(frames), range)).collect();
        (0..BIN_ROWS).for_each(|_| pixels.extend(&row));
    }
    let png = encode(&pixels, width as u32, height as u32).context("log-mel image")?;
    Ok(format!("data:image/png;base64,{}", STANDARD.encode(png)))
}

/// The colour of a share 0 to 1 of the range, as SVG writes it.
pub(super) fn colour(share: f64) -> String {
    let [r, g, b] = mix(share);
    format!("#{r:02x}{g:02x}{b:02x}")
}

fn index(value: f64, range: &Range<f64>) -> u8 {
    (255.0 * (value - range.start) / (range.end - range.start).max(1e-9)).round() as u8
}

fn mix(share: f64) -> [u8; 3] {
    let place = share.clamp(0.0, 1.0) * (COLOURS.len() - 1) as f64;
    let below = (place as usize).min(COLOURS.len() - 2);
    let part = place - below as f64;
    std::array::from_fn(|c| {
        let (a, b) = (f64::from(COLOURS[below][c]), f64::from(COLOURS[below + 1][c]));
        (a + part * (b - a)).round() as u8
    })
}

fn encode(pixels: &[u8], width: u32, height: u32) -> Result<Vec<u8>, png::EncodingError> {
    let mut file = Vec::new();
    let mut encoder = png::Encoder::new(&mut file, width, height);
    encoder.set_color(png::ColorType::Indexed);
    encoder.set_depth(png::BitDepth::Eight);
    encoder.set_compression(png::Compression::High);
    encoder.set_palette((0..=255u8).flat_map(|i| mix(f64::from(i) / 255.0)).collect::<Vec<u8>>());
    let mut writer = encoder.write_header()?;
    writer.write_image_data(pixels)?;
    writer.finish()?;
    Ok(file)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_image_has_a_column_per_frame_and_the_highest_bin_on_top() {
        let uri = image(0..5, &(0.0..1.0), |f, bin| f64::from(u8::from((f, bin) == (2, 15)))).unwrap();
        let bytes = STANDARD.decode(uri.strip_prefix("data:image/png;base64,").unwrap()).unwrap();
        let mut reader = png::Decoder::new(std::io::Cursor::new(bytes)).read_info().unwrap();
        let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
        let info = reader.next_frame(&mut pixels).unwrap();
        assert_eq!((info.width, info.height), (5, 96));
        let bright: Vec<usize> = (0..pixels.len()).filter(|&i| pixels[i] == 255).collect();
        assert_eq!(bright, (0..BIN_ROWS).map(|row| row * 5 + 2).collect::<Vec<_>>());
    }

    #[test]
    fn values_outside_the_range_take_its_end_colours() {
        assert_eq!((index(-9.0, &(0.0..1.0)), index(9.0, &(0.0..1.0))), (0, 255));
        assert_eq!((colour(0.0), colour(1.0)), ("#000004".to_owned(), "#fcffa4".to_owned()));
    }
}
