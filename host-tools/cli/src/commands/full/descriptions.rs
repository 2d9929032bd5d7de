//! `slipsense dbc` and `slipsense c-header`: the slip message for programs without Cyphal.

use std::path::{Path, PathBuf};

use anyhow::Result;
use serde_json::json;
use slipsense::wire::NodeId;

use super::Print;
use super::convert::node_id;
use crate::output::{check_file, write_file};

/// Write a DBC file of the slip message, for cantools, python-can, PLCs and CAN analysers
///
/// The slip message is one CAN FD frame with a fixed 29-bit identifier for each address, so tools that know no
/// Cyphal can read it too. The raw messages have several frames and are not in the file.
#[derive(clap::Args)]
#[command(after_help = "\
Examples:
  slipsense dbc --out slip.dbc
  slipsense dbc --node-id 43 > slip43.dbc
  cantools decode slip.dbc < can.log")]
pub struct DbcArgs {
    /// Address of the module, 0 to 127; 42 unless configured otherwise
    #[arg(long, value_name = "N", default_value = "42", value_parser = node_id)]
    node_id: NodeId,
    /// File to write; standard output if not given
    #[arg(long, value_name = "FILE.dbc")]
    out: Option<PathBuf>,
    #[command(flatten)]
    print: Print,
}

/// Write a C header of the slip message: a structure and a function that decodes a frame
///
/// C99, no allocation, no library, either byte order. Generated from the message's definition.
#[derive(clap::Args)]
#[command(after_help = "\
Examples:
  slipsense c-header --out slipsense_slip.h
  slipsense c-header | cc -std=c99 -fsyntax-only -x c -")]
pub struct CHeaderArgs {
    /// File to write; standard output if not given
    #[arg(long, value_name = "FILE.h")]
    out: Option<PathBuf>,
    #[command(flatten)]
    print: Print,
}

impl DbcArgs {
    pub fn run(self) -> Result<()> {
        deliver(&slipsense_recording::dbc::text(self.node_id)?, self.out.as_deref(), &self.print)
    }
}

impl CHeaderArgs {
    pub fn run(self) -> Result<()> {
        deliver(&slipsense_recording::c_header::text()?, self.out.as_deref(), &self.print)
    }
}

/// To the file, or else to standard output.
fn deliver(text: &str, out: Option<&Path>, printer: &Print) -> Result<()> {
    if let Some(out) = out {
        check_file(out)?;
        write_file(out, text)?;
    }
    let file = out.map(|out| out.display().to_string());
    printer.show(&json!({"file": file, "text": text}), || match &file {
        Some(file) => format!("{} lines: {file}\n", text.lines().count()),
        None => text.to_owned(),
    })
}
