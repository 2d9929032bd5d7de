//! uavcan.node.ExecuteCommand, service 435.
//!
//! What is done at once is answered at once. What takes the board a while (storing, a self test) is answered
//! when the board says how it went, so that a success can be relied on.

use heapless::Vec;

use super::action::Action;
use super::fields::Fields;
use super::file_read::{FilePath, FileRef, PATH_MAX, UpdateTarget};
use crate::calibration::{Request, What};
use crate::wire::NodeId;
use crate::wire::bytes::Writer;

/// Service of uavcan.node.ExecuteCommand.1.3.
pub const COMMAND_PORT: u16 = 435;
/// Start the board anew.
pub const RESTART: u16 = 65_535;
/// Take in a firmware: the parameter is the file's path on the node that sends the command.
pub const BEGIN_SOFTWARE_UPDATE: u16 = 65_533;
/// All settings to their defaults, also in flash.
pub const FACTORY_RESET: u16 = 65_532;
/// Store the settings in flash.
pub const STORE: u16 = 65_530;
/// Show which board this is.
pub const IDENTIFY: u16 = 65_529;
/// Test the sensors; a command of our own.
pub const SELF_TEST: u16 = 0;
/// As [`BEGIN_SOFTWARE_UPDATE`], for the model; a command of our own.
pub const BEGIN_MODEL_UPDATE: u16 = 1;
/// Unlock a locked node until its next start: the parameter is the signature of [`UNLOCK_PREFIX`] and the challenge; a
/// command of our own.
///
/// [`UNLOCK_PREFIX`]: super::UNLOCK_PREFIX
pub const UNLOCK: u16 = 2;

/// Measure an untouched array; a command of our own. The parameter is its number and how many seconds, in decimal:
/// `0 10`. The answer says that it began, registers how it goes on. With 0 seconds: forget its calibration.
pub const CALIBRATE: u16 = 3;
/// Multiply the gains of an array; a command of our own. The parameter is its number and the factor, 1/2048, in
/// decimal: `0 2150`.
pub const SCALE_GAIN: u16 = 4;

/// Longest answer text: what version 1.3 of the command began with.
pub(super) const OUTPUT_MAX: usize = 46;
pub(super) const RESPONSE_BYTES: usize = 1 + 1 + OUTPUT_MAX;

/// How a command went, as the standard numbers it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
#[expect(missing_docs, reason = "the names are those of the standard")]
pub enum CommandStatus {
    /// Done, or begun.
    Success = 0,
    Failure = 1,
    BadCommand = 3,
    BadParameter = 4,
    BadState = 5,
}

/// What a request of `client` asks for.
pub(super) fn decode(request: &[u8], client: NodeId) -> Result<Action, CommandStatus> {
    let mut fields = Fields::new(request);
    let command = fields.unsigned::<2>() as u16;
    let length = fields.unsigned::<1>() as usize;
    let parameter = fields.slice(length);
    if !fields.is_whole() {
        return Err(CommandStatus::BadParameter);
    }
    Ok(match command {
        RESTART => Action::Restart,
        IDENTIFY => Action::Identify,
        STORE => Action::Store,
        FACTORY_RESET => Action::FactoryReset,
        SELF_TEST => Action::SelfTest,
        UNLOCK => Action::Unlock(parameter.try_into().map_err(|_| CommandStatus::BadParameter)?),
        BEGIN_SOFTWARE_UPDATE | BEGIN_MODEL_UPDATE => {
            let path: FilePath = Vec::from_slice(parameter).map_err(|_| CommandStatus::BadParameter)?;
            if path.is_empty() {
                return Err(CommandStatus::BadParameter);
            }
            let target =
                if command == BEGIN_MODEL_UPDATE { UpdateTarget::Model } else { UpdateTarget::Firmware };
            Action::BeginUpdate { target, file: FileRef { server: client, path } }
        }
        CALIBRATE => Action::Calibrate(calibration(parameter, |seconds| match seconds {
            0 => Some(What::Forget),
            _ => u8::try_from(seconds).ok().map(What::Measure),
        })?),
        SCALE_GAIN => Action::Calibrate(calibration(parameter, |factor| Some(What::Scale(factor)))?),
        _ => return Err(CommandStatus::BadCommand),
    })
}

/// Two decimal numbers: an array's, and what to do with it.
fn calibration(parameter: &[u8], what: fn(u16) -> Option<What>) -> Result<Request, CommandStatus> {
    let (mut sensor, mut number, mut digits) = (None, 0u16, 0);
    for &byte in parameter {
        if byte == b' ' && sensor.is_none() && digits > 0 {
            (sensor, number, digits) = (u8::try_from(number).ok(), 0, 0);
            continue;
        }
        let digit = byte.wrapping_sub(b'0');
        let next = number.checked_mul(10).and_then(|tens| tens.checked_add(digit.into()));
        (number, digits) = (next.filter(|_| digit < 10).ok_or(CommandStatus::BadParameter)?, digits + 1);
    }
    match (sensor, what(number)) {
        (Some(sensor), Some(what)) if digits > 0 => Ok(Request { sensor, what }),
        _ => Err(CommandStatus::BadParameter),
    }
}

/// The response; its length. Text beyond [`OUTPUT_MAX`] is cut.
pub(super) fn encode(status: CommandStatus, output: &str, out: &mut [u8; RESPONSE_BYTES]) -> usize {
    let output = output.as_bytes();
    let output = output.get(..OUTPUT_MAX).unwrap_or(output);
    let mut writer = Writer::new(out);
    writer.put(&[status as u8, output.len() as u8]);
    writer.put(output);
    writer.len()
}

const _: () = assert!(PATH_MAX == 255, "as long as a parameter may be");
