//! The input file: a header, the model file, then the frames ([`slipsense::board::replay`]).

use slipsense::params::MAX_SENSORS;
use slipsense::wire::NodeId;

use crate::bytes::Reader;

const MAGIC: [u8; 8] = *b"SLIPQEMU";
pub const HEADER_BYTES: usize = 8 + 5 * 4;
/// Bytes that a model file may have here.
pub const MODEL_BYTES_MAX: usize = 1 << 20;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Header {
    /// Length of the model file that follows, bytes.
    pub model_bytes: u32,
    pub sensors: u32,
    pub frames: u32,
    pub node: NodeId,
    pub compress_raw: bool,
}

impl Header {
    pub fn encode(&self) -> [u8; HEADER_BYTES] {
        let node = u32::from(self.node.get());
        let numbers = [self.model_bytes, self.sensors, self.frames, node, u32::from(self.compress_raw)];
        let mut out = [0; HEADER_BYTES];
        let (magic, rest) = out.split_at_mut(MAGIC.len());
        magic.copy_from_slice(&MAGIC);
        rest.copy_from_slice(bytemuck::bytes_of(&numbers));
        out
    }

    /// `None` if these bytes are no header or ask for more than the emulated board has.
    pub fn decode(bytes: &[u8; HEADER_BYTES]) -> Option<Self> {
        let mut reader = Reader(bytes);
        if reader.next::<[u8; 8]>()? != MAGIC {
            return None;
        }
        let [model_bytes, sensors, frames, node, compress_raw]: [u32; 5] = reader.next()?;
        let node = NodeId::new(u8::try_from(node).ok()?)?;
        let fits = model_bytes as usize <= MODEL_BYTES_MAX && (1..=MAX_SENSORS as u32).contains(&sensors);
        fits.then_some(Self { model_bytes, sensors, frames, node, compress_raw: compress_raw != 0 })
    }
}
