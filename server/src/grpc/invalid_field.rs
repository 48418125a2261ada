//! A field of a request that breaks a rule.

use std::fmt::Display;

/// What is wrong with which field; becomes `google.rpc.BadRequest`.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{field}: {description}")]
pub struct InvalidField {
    /// Path of the field, for instance `batch.scans.range_m`.
    pub field: String,
    /// What is wrong with it, and what would be right.
    pub description: String,
}

impl InvalidField {
    /// A violation of a field.
    pub fn new(field: impl Into<String>, description: impl Display) -> Self {
        Self { field: field.into(), description: description.to_string() }
    }
}

/// An error unless the condition holds.
pub(super) fn require(holds: bool, field: &str, description: &str) -> Result<(), InvalidField> {
    if holds { Ok(()) } else { Err(InvalidField::new(field, description)) }
}

/// A message that must be there.
pub(super) fn required<T>(message: Option<T>, field: &str) -> Result<T, InvalidField> {
    message.ok_or_else(|| InvalidField::new(field, "is missing"))
}
