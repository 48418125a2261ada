//! Tiles, folded from the journal.
//!
//! - [`fold`]: records to tiles, through [`vetting`] and a [`write_buffer`].
//! - [`tiles`], [`pieces`], [`key`], [`quarantine`]: what is stored, and its bytes; [`catalog`]: all tiles in numbers.
//! - [`generation`]: the map as folded under some controls; [`build`]: how a new one is made; [`manifest`]: which one is
//!   served; [`checkpoint`] and [`stream`]: what stands for compacted records.
//! - [`policy`]: which evidence counts, and what of it is published.
//! - [`resume`]: what a start goes on with; [`context`] and [`fold_worker`]: the thread that folds; [`serving`]: what is served
//!   is prepared for before; [`attempt`]: work that may fail or panic.

pub(in crate::store) mod attempt;
pub(in crate::store) mod build;
pub(in crate::store) mod catalog;
pub(in crate::store) mod checkpoint;
pub(in crate::store) mod context;
pub(in crate::store) mod fold;
pub(in crate::store) mod fold_worker;
pub(in crate::store) mod generation;
mod key;
pub(in crate::store) mod manifest;
pub(in crate::store) mod pieces;
pub(in crate::store) mod policy;
mod quarantine;
pub(in crate::store) mod resume;
mod serving;
pub(in crate::store) mod stream;
pub(in crate::store) mod tiles;
pub(in crate::store) mod vetting;
pub(in crate::store) mod write_buffer;
