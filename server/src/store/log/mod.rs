//! The journal: what was acknowledged, in order, and what of it counts.
//!
//! - [`journal`]: append-only segments; [`segment`]: their bytes; [`recover`]: what one holds after a crash; [`medium`]:
//!   the one being written; [`writer`]: the thread that groups appends.
//! - [`sequencer`]: who gives records their numbers, where servers share a journal.
//! - [`position`]: where a record lies; [`reader`]: reads it again.
//! - [`entry`], [`record`]: the bytes of a record.
//! - [`index`]: which records there are; [`exclusion`]: which of them count.
//! - [`faults`]: deliberate defects, for harnesses that look for lost uploads.

pub(in crate::store) mod entry;
pub(in crate::store) mod exclusion;
mod faults;
pub(in crate::store) mod index;
pub(in crate::store) mod journal;
mod medium;
pub(in crate::store) mod position;
mod reader;
mod record;
mod recover;
pub(in crate::store) mod segment;
pub(in crate::store) mod sequencer;
mod writer;
