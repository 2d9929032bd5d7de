//! uavcan.node.GetInfo, service 430: what a node is.

use super::identity::{Identity, NODE_NAME, PROTOCOL_VERSION};
use crate::wire::bytes::Writer;

/// Service of uavcan.node.GetInfo.1.0.
pub const GET_INFO_PORT: u16 = 430;
/// Bytes of the longest response of this node: three versions, commit, unique id, name, one hash, no
/// certificate.
pub(super) const GET_INFO_BYTES: usize = 30 + 1 + NODE_NAME.len() + 1 + 8 + 1;

/// The response; its length.
pub(super) fn encode(identity: &Identity, out: &mut [u8; GET_INFO_BYTES]) -> usize {
    let mut writer = Writer::new(out);
    for version in [PROTOCOL_VERSION, identity.hardware_version, identity.software_version] {
        writer.put(&[version.major, version.minor]);
    }
    writer.put(&identity.vcs_revision.to_le_bytes());
    writer.put(&identity.unique_id);
    writer.put(&[NODE_NAME.len() as u8]);
    writer.put(NODE_NAME.as_bytes());
    match identity.model_revision() {
        Some(revision) => {
            writer.put(&[1]);
            writer.put(&revision.to_le_bytes());
        }
        None => writer.put(&[0]),
    }
    // No certificate of authenticity.
    writer.put(&[0]);
    writer.len()
}
