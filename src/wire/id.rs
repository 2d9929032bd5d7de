//! The 29-bit identifiers of Cyphal/CAN: messages, service calls, and messages of a node that has no address yet
//! (OpenCyphal specification 1.0, section 4.2.2).

use core::fmt;

/// Largest CAN identifier, 29 bits.
pub const CAN_ID_MAX: u32 = (1 << 29) - 1;

/// Priority of a transfer, the three leading bits of its identifier: the smaller number wins the bus.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
#[repr(u8)]
#[expect(missing_docs, reason = "the names are those of the specification")]
pub enum Priority {
    Exceptional = 0,
    Immediate = 1,
    Fast = 2,
    High = 3,
    Nominal = 4,
    Low = 5,
    Slow = 6,
    Optional = 7,
}

impl Priority {
    /// Of an identifier of 29 bits.
    const fn from_can(id: u32) -> Self {
        use Priority::{Exceptional, Fast, High, Immediate, Low, Nominal, Optional, Slow};
        [Exceptional, Immediate, Fast, High, Nominal, Low, Slow, Optional][(id >> 26 & 7) as usize]
    }
}

/// Address of a node on the bus, 0 to 127.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct NodeId(u8);

impl NodeId {
    /// The address of a module until it gets another one.
    pub const DEFAULT: Self = Self(42);

    /// `None` above 127.
    pub const fn new(id: u8) -> Option<Self> {
        if id <= 127 { Some(Self(id)) } else { None }
    }

    /// The number.
    pub const fn get(self) -> u8 {
        self.0
    }

    /// The low seven bits.
    const fn from_bits(bits: u32) -> Self {
        Self(bits as u8 & 127)
    }
}

/// What the 29-bit identifier of a message says.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[expect(missing_docs, reason = "the fields are named after what they are")]
pub struct MessageId {
    pub priority: Priority,
    /// Subject identifier, 0 to 8191; higher bits are dropped.
    pub port: u16,
    pub node: NodeId,
}

/// Why an identifier is not that of a message with a sender.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[expect(missing_docs, reason = "the fields are named after what they are, and the text says it")]
pub enum IdError {
    TooLarge { id: u32 },
    Service,
    Anonymous,
    Reserved,
}

/// Largest subject identifier.
const PORT_MAX: u16 = 8191;
/// Set in the identifier of a service call.
const ID_SERVICE: u32 = 1 << 25;
/// Set in the identifier of an anonymous message.
const ID_ANONYMOUS: u32 = 1 << 24;
/// Sent as ones, ignored on reception.
const ID_ONES: u32 = 3 << 21;
/// Reserved in every identifier.
const ID_ZERO: u32 = 1 << 23;
const ID_ZEROS: u32 = ID_ZERO | 1 << 7;

impl MessageId {
    /// The identifier on the bus.
    pub const fn to_can(self) -> u32 {
        (self.priority as u32) << 26 | ID_ONES | ((self.port & PORT_MAX) as u32) << 8 | self.node.0 as u32
    }

    /// Read an identifier.
    pub const fn from_can(id: u32) -> Result<Self, IdError> {
        if id > CAN_ID_MAX {
            return Err(IdError::TooLarge { id });
        }
        if id & ID_SERVICE != 0 {
            return Err(IdError::Service);
        }
        if id & ID_ZEROS != 0 {
            return Err(IdError::Reserved);
        }
        if id & ID_ANONYMOUS != 0 {
            return Err(IdError::Anonymous);
        }
        let priority = Priority::from_can(id);
        Ok(Self { priority, port: (id >> 8) as u16 & PORT_MAX, node: NodeId::from_bits(id) })
    }
}

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
#[expect(missing_docs, reason = "the fields are named after what they are")]
pub struct ServiceId {
    /// Priority of the transfer; a response has that of its request, at most [`Priority::Fast`].
    pub priority: Priority,
    pub role: ServiceRole,
    /// Service identifier, 0 to [`SERVICE_PORT_MAX`]; higher bits are dropped.
    pub port: u16,
    pub destination: NodeId,
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

    /// The identifier of the answer to this request: of its priority, but always behind the slip message.
    #[must_use]
    pub const fn response(self) -> Self {
        let (destination, source) = (self.source, self.destination);
        let priority = match self.priority {
            Priority::Exceptional | Priority::Immediate => Priority::Fast,
            priority => priority,
        };
        Self { role: ServiceRole::Response, destination, source, priority, ..self }
    }
}

/// What the 29-bit identifier of a message without a sender says. Its transfers have one frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct AnonymousId {
    /// Priority of the transfer.
    pub priority: Priority,
    /// Subject identifier, 0 to 8191; higher bits are dropped.
    pub port: u16,
    /// In place of the sender's address, derived from the payload: keeps two nodes without address from sending different
    /// frames under one identifier.
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
#[expect(missing_docs, reason = "each is documented where it is defined")]
pub enum TransferId {
    Message(MessageId),
    Anonymous(AnonymousId),
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
            let (destination, source) = (NodeId::from_bits(id >> 7), NodeId::from_bits(id));
            if id & ID_ZERO != 0 || destination.get() == source.get() {
                return Err(IdError::Reserved);
            }
            let role = if id & ID_REQUEST != 0 { ServiceRole::Request } else { ServiceRole::Response };
            let port = (id >> 14) as u16 & SERVICE_PORT_MAX;
            let priority = Priority::from_can(id);
            return Ok(Self::Service(ServiceId { priority, role, port, destination, source }));
        }
        match MessageId::from_can(id) {
            Ok(message) => Ok(Self::Message(message)),
            Err(IdError::Anonymous) => Ok(Self::Anonymous(AnonymousId {
                priority: Priority::from_can(id),
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

impl fmt::Display for IdError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::TooLarge { id } => write!(f, "identifier {id:X} has more than 29 bits"),
            Self::Service => f.write_str("identifier of a service call, not of a message"),
            Self::Anonymous => f.write_str("message of a node without an address"),
            Self::Reserved => f.write_str("a reserved bit of the identifier is set"),
        }
    }
}

impl core::error::Error for IdError {}
