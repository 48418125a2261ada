//! What is no longer needed goes: only after the manifest that says so was published.

use std::time::Duration;

use super::client::Client;
use super::manifest::Manifest;
use super::names::{Shard, epoch_of, seq_of};
use crate::store::api::Error;

/// What a sweep did.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(in crate::store) struct Swept {
    /// Segments below the floor that were deleted.
    pub(in crate::store) segments: u64,
    /// Packs that no manifest names that were deleted.
    pub(in crate::store) packs: u64,
    /// What is too young to go yet.
    pub(in crate::store) young: u64,
}

/// Deletes what a published manifest put below its floor, and packs that can be in no manifest to come: the name of the one
/// they were made for is taken, so who made them has lost, or died, or was replaced since. Both only when they are older
/// than `age` by the store's clock, by which `now_us` must be: who reads them still has that long. A wrong clock delays this,
/// or disturbs a slow reader, which begins again.
///
/// # Errors
/// When the store does not answer; what was not deleted goes the next time.
pub(in crate::store) fn sweep(
    client: &Client,
    shard: Shard,
    published: &Manifest,
    (now_us, age): (i64, Duration),
) -> Result<Swept, Error> {
    let mut swept = Swept::default();
    let old = |modified_us: i64| now_us.saturating_sub(modified_us) >= age.as_micros() as i64;
    for segment in client.list(&shard.journal())? {
        if seq_of(&segment.name).is_none_or(|seq| seq >= published.floor) {
            continue;
        }
        if old(segment.modified_us) {
            client.delete(&segment.name)?;
            swept.segments += 1;
        } else {
            swept.young += 1;
        }
    }
    for pack in client.list(&shard.packs())? {
        let settled = epoch_of(&pack.name).is_some_and(|epoch| epoch <= published.epoch);
        if !settled || Some(&pack.name) == published.pack.as_ref() {
            continue;
        }
        if old(pack.modified_us) {
            client.delete(&pack.name)?;
            swept.packs += 1;
        } else {
            swept.young += 1;
        }
    }
    Ok(swept)
}
