//! The program `slipsense`.

use std::process::ExitCode;

fn main() -> ExitCode {
    ExitCode::from(slipsense_cli::main(std::env::args_os()))
}
