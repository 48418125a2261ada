//! A store that many servers share: an object store that somebody else keeps alive.
//!
//! ```text
//! cluster                    put if absent, once: shards, size of a region, lineage
//! key                        put if absent, once: what contributors' pseudonyms are hashed with
//! s/{shard}/j/{seq}          a segment of the journal: who wrote it, and records in order
//! s/{shard}/m/{epoch}        a manifest: the floor, and the checkpoint for what lies below it
//! s/{shard}/p/{epoch}-{uuid}  a pack: a checkpoint, made for the manifest of that epoch
//! ```
//!
//! - [`bucket`]: single requests; [`remote`]: those of an S3-compatible store; [`client`]: tried again, with the outcome read
//!   back; [`probe`]: does the store keep its promises?
//! - [`body`]: what every object begins with; [`cluster`], [`segment`], [`manifest`]: what is in them; [`names`]: their names.
//! - [`chain`]: manifests, of which the newest counts; [`shared_log`]: the journal that all servers append to;
//!   [`collect`]: what is no longer needed goes.
//!
//! Four rules, none of which rests on a clock or a lease:
//!
//! 1. A floor is published before anything below it is deleted; and who created a name looks afterwards whether the floor
//!    has passed it: a name that was deleted can be created again, and nobody would read it. Who reads a name looks, too:
//!    a server that was stalled may have left something there, which does not count.
//! 2. That the name before one still exists says nothing: who deletes may die half-way, and leave holes.
//! 3. Nothing is swapped. Manifests are a chain of names, each of which is put if it is absent, and none is ever deleted.
//!    A pack is named by the manifest it is made for: only when that name is taken it can be told that nobody will name it.
//! 4. A store that ignores conditions is refused at the start.

pub(in crate::store) mod body;
pub(in crate::store) mod bucket;
pub(in crate::store) mod chain;
pub(in crate::store) mod client;
pub(in crate::store) mod cluster;
pub(in crate::store) mod collect;
pub(in crate::store) mod manifest;
pub(in crate::store) mod names;
pub(in crate::store) mod probe;
pub(in crate::store) mod remote;
pub(in crate::store) mod segment;
pub(in crate::store) mod shared_log;
#[cfg(test)]
pub(in crate::store) mod testing;
#[cfg(test)]
mod tests;
