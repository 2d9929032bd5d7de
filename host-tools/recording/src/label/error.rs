//! What is wrong with what labels are made from.

/// A rule that is broken, naming the place where there is one, in one line.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct LabelError(pub(super) String);
