//! Manifests: a chain of names, each of which is put if it is absent. None is ever deleted: the newest is the last there
//! is, and who is late cannot take the place of one that went.

use super::client::{Client, Put};
use super::manifest::Manifest;
use super::names::Shard;
use crate::store::api::Error;

/// The manifests of a shard, as far as they are known.
#[derive(Clone)]
pub(in crate::store) struct Chain {
    client: Client,
    shard: Shard,
    newest: Manifest,
}

impl Chain {
    pub(in crate::store) fn of(client: Client, shard: Shard) -> Self {
        Self { client, shard, newest: Manifest::initial() }
    }

    /// The newest manifest that is known.
    pub(in crate::store) fn known(&self) -> &Manifest {
        &self.newest
    }

    /// The newest manifest, asked for.
    ///
    /// # Errors
    /// When the store does not answer, or a manifest is damaged.
    pub(in crate::store) fn newest(&mut self) -> Result<&Manifest, Error> {
        let mut step = 1;
        loop {
            // Leaps, and smaller ones where there is none: the names have no gap.
            let epoch = self.newest.epoch + step;
            match self.client.get(&self.shard.manifest(epoch))? {
                Some(bytes) => {
                    self.newest = self.sound(epoch, &bytes)?;
                    step *= 2;
                }
                None if step == 1 => return Ok(&self.newest),
                None => step = 1,
            }
        }
    }

    /// Publishes a manifest after the newest that is known; false when another was published there, which is known now: then
    /// look again whether this one is still right.
    ///
    /// # Errors
    /// When the outcome is not known, or the other one is damaged.
    pub(in crate::store) fn publish(&mut self, manifest: Manifest) -> Result<bool, Error> {
        let epoch = self.newest.epoch + 1;
        let manifest = Manifest { epoch, ..manifest };
        match self.client.put_new(&self.shard.manifest(epoch), &manifest.encode())? {
            Put::Ours => {
                self.newest = manifest;
                Ok(true)
            }
            Put::Theirs(bytes) => {
                self.newest = self.sound(epoch, &bytes)?;
                Ok(false)
            }
        }
    }

    fn sound(&self, epoch: u64, bytes: &[u8]) -> Result<Manifest, Error> {
        let manifest = Manifest::decode(bytes).filter(|manifest| manifest.epoch == epoch);
        manifest.ok_or_else(|| self.damaged(epoch, "it does not match its checksum"))
    }

    fn damaged(&self, epoch: u64, reason: &str) -> Error {
        let what = format!("the manifest {}", self.client.locate(&self.shard.manifest(epoch)));
        Error::Damaged { what, reason: reason.to_owned() }
    }
}
