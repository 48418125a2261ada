//! What the store asks of the place where it is stored: small traits, in which there is no path and no database.
//!
//! - [`objects`]: immutable objects, for the checkpoint and for files of regions.
//! - [`segments`]: what a journal is appended to.
//! - [`manifests`]: the manifest, of which the newest counts.
//! - [`tables`]: tables of tiles.
//! - [`owner`]: whose store it is, and the key of its contributors' hashes.
//!
//! For tests: `memory`, a backend that forgets; `faulty`, which lets any other one fail; `conformance`, what each
//! backend must do.

#[cfg(test)]
pub(in crate::store) mod conformance;
#[cfg(test)]
pub(in crate::store) mod faulty;
pub(in crate::store) mod manifests;
#[cfg(test)]
pub(in crate::store) mod memory;
pub(in crate::store) mod objects;
pub(in crate::store) mod owner;
pub(in crate::store) mod segments;
pub(in crate::store) mod tables;

use std::sync::Arc;

use manifests::Manifests;
use objects::Objects;
use owner::{Fence, Pseudonyms};
use segments::Segments;
use tables::TileTables;

/// A place where a store is stored. Who opens it has it alone.
#[derive(Clone)]
pub(in crate::store) struct Backend {
    pub(in crate::store) objects: Arc<dyn Objects>,
    pub(in crate::store) segments: Arc<dyn Segments>,
    pub(in crate::store) manifests: Arc<dyn Manifests>,
    pub(in crate::store) tables: Arc<dyn TileTables>,
    pub(in crate::store) fence: Arc<dyn Fence>,
    pub(in crate::store) pseudonyms: Arc<dyn Pseudonyms>,
}
