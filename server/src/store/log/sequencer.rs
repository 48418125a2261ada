//! Who gives records their numbers: the journal itself, or something that several servers share.

use super::entry::RecordMeta;
use super::position::Written;
use crate::store::api::Error;

/// A record that is to be written.
#[derive(Debug)]
pub(in crate::store) struct NewRecord {
    pub(in crate::store) meta: RecordMeta,
    /// Begins a segment of its own.
    pub(in crate::store) fresh: bool,
    pub(in crate::store) payload: Vec<u8>,
    /// The number that it has elsewhere, and must get here; any, where it is new everywhere.
    pub(in crate::store) number: Option<u64>,
}

/// A record that is in the journal.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::store) struct Sequenced {
    pub(in crate::store) written: Written,
    /// It was there before: another server had written it.
    pub(in crate::store) known: bool,
}

/// Gives records the next numbers of an order that servers share, and writes them, with those of other servers before them,
/// to this server's journal.
pub(in crate::store) trait Sequencer: Send + Sync {
    /// Returns once the records are in the order, and in this server's journal.
    ///
    /// # Errors
    /// When that is not certain.
    fn sequence(&self, records: Vec<NewRecord>) -> Result<Vec<Sequenced>, Error>;
}
