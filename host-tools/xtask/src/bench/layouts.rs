//! Instructions of the rows of `slipsense reproduce` whose layout the firmware takes.

use anyhow::{Context, Result, anyhow};
use slipsense::net::Model;
use slipsense::net::format::Dims;
use slipsense::params::MAX_SENSORS;
use slipsense_qemu::measured::WARM_UP_FRAMES;
use slipsense_recording::model_file::random_model;

use super::emulated::{PROGRAM, path};
use super::inputs::Input;
use crate::qemu::machine::Machine;
use crate::table::{Table, thousands};

/// Networks of random weights: a kernel takes as many instructions for any.
pub fn print(shipped: &[u8], frames: usize) -> Result<()> {
    let machine = Machine::build(PROGRAM)?;
    let base = Model::parse(shipped).context("the shipped model")?.dims;
    let rows = [
        ("base", base),
        ("t6", Dims { window: 6, ..base }),
        ("t15", Dims { window: 15, ..base }),
        ("t30", Dims { window: 30, ..base }),
        ("xl-mlp", Dims { xl_kernel: 1, ..base }),
    ];
    let mut table = Table::new(
        "Instructions of a frame from samples to CAN frames, full contact, median, exact, emulated Cortex-M7",
        &["row", "1 sensor", "2 sensors", "3 sensors", "bytes of the file"],
    );
    for (name, dims) in rows {
        let model = random_model(dims, 1).to_bytes().map_err(|error| anyhow!("row {name}: {error}"))?;
        let mut cells = vec![name.to_owned()];
        for sensors in 1..=MAX_SENSORS {
            let measured = path(&machine, &model, Input::Full, sensors, WARM_UP_FRAMES + frames)?;
            cells.push(thousands(measured.median_and_worst_path()[0]));
        }
        cells.push(thousands(model.len() as u64));
        table.row(cells);
    }
    print!("{table}");
    Ok(())
}
