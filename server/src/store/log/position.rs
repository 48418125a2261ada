//! Records that are in the journal, and where.

/// Where a record lies.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::store) struct RecordPosition {
    /// Number of the segment's first record.
    pub(in crate::store) segment: u64,
    /// Byte of the payload.
    pub(in crate::store) offset: u32,
    /// Bytes of the payload.
    pub(in crate::store) length: u32,
}

/// A record that is on disk.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::store) struct Written {
    /// 1 for the journal's first record.
    pub(in crate::store) number: u64,
    pub(in crate::store) at: RecordPosition,
}
