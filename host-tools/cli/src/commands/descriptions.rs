//! `slipsense dbc` and `slipsense c-header`: the slip message for programs that know no Cyphal.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use clap::Args as ClapArgs;
use serde_json::json;
use slipsense::wire::NodeId;

use super::convert::node_id;
use crate::output_dir::{check_file, write_whole};

/// Write a DBC file of the slip message, for cantools, python-can, PLCs and CAN analysers
///
/// The slip message is one CAN FD frame with a fixed 29-bit identifier for each address, so tools that know no
/// Cyphal can read it too. The raw messages have several frames and are not in the file.
#[derive(ClapArgs)]
#[command(after_help = "\
Examples:
  slipsense dbc --out slip.dbc
  slipsense dbc --node-id 43 > slip43.dbc
  cantools decode slip.dbc < can.log")]
pub struct DbcArgs {
    /// Address of the module, 0 to 127; 42 is what it has until told another
    #[arg(long, value_name = "N", default_value = "42", value_parser = node_id)]
    node_id: NodeId,
    /// File to write; standard output if not given
    #[arg(long, value_name = "FILE.dbc")]
    out: Option<PathBuf>,
    /// Print file and content as JSON
    #[arg(long)]
    json: bool,
}

/// Write a C header of the slip message: a structure and a function that decodes a frame
///
/// C99, no allocation, no library, either byte order. Generated from the message's definition.
#[derive(ClapArgs)]
#[command(after_help = "\
Examples:
  slipsense c-header --out slipsense_slip.h
  slipsense c-header | cc -std=c99 -fsyntax-only -x c -")]
pub struct CHeaderArgs {
    /// File to write; standard output if not given
    #[arg(long, value_name = "FILE.h")]
    out: Option<PathBuf>,
    /// Print file and content as JSON
    #[arg(long)]
    json: bool,
}

impl DbcArgs {
    pub(crate) fn run(self) -> Result<()> {
        hand_out(&slipsense_recording::dbc::text(self.node_id)?, self.out.as_deref(), self.json)
    }
}

impl CHeaderArgs {
    pub(crate) fn run(self) -> Result<()> {
        hand_out(&slipsense_recording::c_header::text()?, self.out.as_deref(), self.json)
    }
}

fn hand_out(text: &str, out: Option<&Path>, json: bool) -> Result<()> {
    if let Some(out) = out {
        check_file(out)?;
        write_whole(out, text).with_context(|| format!("{}: cannot write", out.display()))?;
    }
    let file = out.map(|out| out.display().to_string());
    match (json, file) {
        (true, file) => super::print_json(&json!({"file": file, "text": text})),
        (false, Some(file)) => super::print(&format!("{} lines: {file}\n", text.lines().count())),
        (false, None) => super::print(text),
    }
}
