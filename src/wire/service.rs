//! The identifiers that are not those of a plain message: service calls, which have a destination, and
//! messages of a node that has no address yet (OpenCyphal specification 1.0, section 4.2.2).

use super::cyphal::{
    CAN_ID_MAX, ID_ANONYMOUS, ID_ONES, ID_SERVICE, ID_ZERO, IdError, MessageId, NodeId, PORT_MAX, Priority,
};

/// Largest service identifier, 9 bits.
pub const SERVICE_PORT_MAX: u16 = 511;

const ID_REQUEST: u32 = 1 << 24;

/// Which half of a service call a transfer is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ServiceRole {
    /// From the client to the server.
    Request,
    /// From the server to the client, with the transfer identifier of the request.
    Response,
}

/// What the 29-bit identifier of a service call says.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ServiceId {
    /// Priority of the transfer; a response has that of its request.
    pub priority: Priority,
    /// Request or response.
    pub role: ServiceRole,
    /// Service identifier, 0 to [`SERVICE_PORT_MAX`]; higher bits are dropped.
    pub port: u16,
    /// The node that is to receive.
    pub destination: NodeId,
    /// The node that sends.
    pub source: NodeId,
}

impl ServiceId {
    /// The identifier on the bus.
    pub const fn to_can(self) -> u32 {
        let role = match self.role {
            ServiceRole::Request => ID_REQUEST,
            ServiceRole::Response => 0,
        };
        let port = ((self.port & SERVICE_PORT_MAX) as u32) << 14;
        let (destination, source) = (self.destination.get() as u32, self.source.get() as u32);
        (self.priority as u32) << 26 | ID_SERVICE | role | port | destination << 7 | source
    }

    /// The identifier of the answer to this request.
    #[must_use]
    pub const fn response(self) -> Self {
        let (destination, source) = (self.source, self.destination);
        Self { role: ServiceRole::Response, destination, source, ..self }
    }
}

/// What the 29-bit identifier of a message without a sender says. Its transfers have one frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct AnonymousId {
    /// Priority of the transfer.
    pub priority: Priority,
    /// Subject identifier, 0 to 8191; higher bits are dropped.
    pub port: u16,
    /// Stands where the sender's address would, and keeps two nodes without address from sending different
    /// frames under one identifier: derived from the payload, no address.
    pub pseudo_source: u8,
}

impl AnonymousId {
    /// The identifier on the bus.
    pub const fn to_can(self) -> u32 {
        let port = ((self.port & PORT_MAX) as u32) << 8;
        let source = (self.pseudo_source & 127) as u32;
        (self.priority as u32) << 26 | ID_ANONYMOUS | ID_ONES | port | source
    }
}

/// What the identifier of any Cyphal frame says.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TransferId {
    /// A message with a sender.
    Message(MessageId),
    /// A message without one.
    Anonymous(AnonymousId),
    /// A service call.
    Service(ServiceId),
}

impl TransferId {
    /// The identifier on the bus.
    pub const fn to_can(self) -> u32 {
        match self {
            Self::Message(id) => id.to_can(),
            Self::Anonymous(id) => id.to_can(),
            Self::Service(id) => id.to_can(),
        }
    }

    /// Read an identifier. A service call from a node to itself has no meaning and is refused as reserved.
    pub const fn from_can(id: u32) -> Result<Self, IdError> {
        if id <= CAN_ID_MAX && id & ID_SERVICE != 0 {
            let (destination, source) = (NodeId::of_bits(id >> 7), NodeId::of_bits(id));
            if id & ID_ZERO != 0 || destination.get() == source.get() {
                return Err(IdError::Reserved);
            }
            let role = if id & ID_REQUEST != 0 { ServiceRole::Request } else { ServiceRole::Response };
            let port = (id >> 14) as u16 & SERVICE_PORT_MAX;
            let priority = Priority::of_can(id);
            return Ok(Self::Service(ServiceId { priority, role, port, destination, source }));
        }
        match MessageId::from_can(id) {
            Ok(message) => Ok(Self::Message(message)),
            Err(IdError::Anonymous) => Ok(Self::Anonymous(AnonymousId {
                priority: Priority::of_can(id),
                port: (id >> 8) as u16 & PORT_MAX,
                pseudo_source: id as u8 & 127,
            })),
            Err(error) => Err(error),
        }
    }
}

impl From<MessageId> for TransferId {
    fn from(id: MessageId) -> Self {
        Self::Message(id)
    }
}

impl From<AnonymousId> for TransferId {
    fn from(id: AnonymousId) -> Self {
        Self::Anonymous(id)
    }
}

impl From<ServiceId> for TransferId {
    fn from(id: ServiceId) -> Self {
        Self::Service(id)
    }
}
