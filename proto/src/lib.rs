//! The contract of Echofix, generated from `proto/echofix/v1/*.proto`, and what both ends must do
//! alike: the [`codec`] it travels by, and the [`delta`] form of batches.
//!
//! The `.proto` files are the reference: every field says its unit, frame and sign there.

pub mod codec;
pub mod delta;

/// Version 1 of the contract.
#[allow(clippy::large_enum_variant, reason = "generated; the variants are the contract's")]
pub mod v1 {
    tonic::include_proto!("echofix.v1");

    /// The compiled `.proto` files, for server reflection and self-describing logs.
    pub const FILE_DESCRIPTOR_SET: &[u8] = tonic::include_file_descriptor_set!("echofix.v1");
}
