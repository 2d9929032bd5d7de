//! The `slipsense` command.

use std::process::ExitCode;

fn main() -> ExitCode {
    slipsense_cli::main()
}
