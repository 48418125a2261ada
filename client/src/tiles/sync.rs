//! Bringing a cache up to date.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use echofix_core::geo::TileId;
use echofix_core::tile::{self, DecodeError, Grain};
use echofix_proto::v1::get_tiles_response::Part;
use echofix_proto::v1::map_service_client::MapServiceClient;
use echofix_proto::v1::{GetTilesRequest, GetTilesResponse, TilesSummary};
use tonic::Streaming;

use super::assembly::{Assembly, Whole};
use super::name::{Form, TileVersionName};
use super::{CacheInner, Error, TileCache, Want};
use crate::refusal::CallError;
use crate::service::{CallerChannel, ServiceEndpoint};
use crate::wire::tile_id;

/// The next message of an answer is waited for this long.
const PATIENCE: Duration = Duration::from_secs(30);

/// What a sync did.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Synced {
    /// Epoch of the map: no tile wanted is older. 0 when none was wanted.
    pub epoch: u64,
    /// Tiles that were downloaded.
    pub fetched: u32,
    /// Bytes of the tiles that were downloaded.
    pub bytes: u64,
    /// Tiles that were up to date.
    pub unchanged: u32,
    /// Tiles removed because the map no longer holds them.
    pub removed: u32,
    /// Tiles removed to make room.
    pub evicted: u32,
}

impl TileCache {
    /// Asks the service for what changed of the tiles wanted, and takes it.
    ///
    /// One attempt: after a transient [`CallError`] ask again; what came stays. Syncs of one cache wait for each
    /// other. Dropping the future ends the sync; the cache stays sound.
    ///
    /// Must be called within a tokio runtime.
    ///
    /// # Errors
    /// When the service cannot be reached, refuses, or answers nonsense, what is wanted does not fit, or the file
    /// system refuses.
    pub async fn sync(&self, service: &ServiceEndpoint, want: &Want) -> Result<Synced, Error> {
        self.sync_as(Form::Tile, service, want).await
    }

    /// As [`TileCache::sync`], but takes the vehicle layer of the tiles: what stands, and how much of it a pass hits, in a sixth to an
    /// eightieth of the bytes. Of a service that knows no layers it takes the tiles, and keeps their layers.
    ///
    /// # Errors
    /// As [`TileCache::sync`].
    pub async fn sync_layer(&self, service: &ServiceEndpoint, want: &Want) -> Result<Synced, Error> {
        self.sync_as(Form::Layer, service, want).await
    }

    async fn sync_as(&self, form: Form, service: &ServiceEndpoint, want: &Want) -> Result<Synced, Error> {
        let _one = self.inner.syncing.lock().await;
        let (since, have) = {
            let mut index = self.inner.index();
            // What is there in the other form must come again, whatever its version, or go where the map holds nothing.
            let version =
                |name: TileVersionName| if name.form == form { name.version } else { !name.version };
            let have: BTreeMap<_, _> = index.names().map(|name| (name.id, version(name))).collect();
            (index.tick(), have)
        };
        let requests = want.requests(form, &have);
        for held in requests.iter().flat_map(|request| &request.have) {
            // Before anything comes: what is wanted makes no room for what is wanted, too.
            held.tile.as_ref().and_then(tile_id).map(|id| self.inner.index().touch(id));
        }
        let mut client = MapServiceClient::new(service.connect_lazy());
        let mut done = Synced::default();
        for request in requests {
            let summary = self.take(&mut client, (form, request), since, &mut done).await?;
            done.epoch = if done.epoch == 0 { summary.epoch } else { done.epoch.min(summary.epoch) };
            done.unchanged += summary.unchanged;
            let absent: Vec<TileId> = summary.absent.iter().filter_map(tile_id).collect();
            done.removed += self.on_disk(move |cache| cache.remove_all(&absent)).await?;
        }
        Ok(done)
    }

    /// Takes the tiles of one answer.
    async fn take(
        &self,
        client: &mut MapServiceClient<CallerChannel>,
        (form, request): (Form, GetTilesRequest),
        since: u64,
        done: &mut Synced,
    ) -> Result<TilesSummary, Error> {
        let answer = tokio::time::timeout(PATIENCE, client.get_tiles(request)).await;
        let mut answer =
            answer.map_err(|_| CallError::Deadline)?.map_err(|s| CallError::from(&s))?.into_inner();
        let mut assembly = Assembly::default();
        loop {
            let whole = match next(&mut answer).await? {
                Part::Tile(tile) => assembly.begin(tile)?,
                Part::Piece(piece) => assembly.go_on(piece)?,
                Part::Summary(summary) => return assembly.end().map(|()| summary),
            };
            if let Some(whole) = whole {
                done.fetched += 1;
                done.bytes += whole.encoded.len() as u64;
                done.evicted += self.on_disk(move |cache| cache.store(whole, form, since)).await?;
            }
        }
    }

    async fn on_disk<T: Send + 'static>(
        &self,
        work: impl FnOnce(&CacheInner) -> Result<T, Error> + Send + 'static,
    ) -> Result<T, Error> {
        let inner = Arc::clone(&self.inner);
        let done = tokio::task::spawn_blocking(move || work(&inner)).await;
        done.unwrap_or_else(|e| {
            Err(Error::Io { path: self.inner.dir.clone(), source: std::io::Error::other(e) })
        })
    }
}

async fn next(answer: &mut Streaming<GetTilesResponse>) -> Result<Part, Error> {
    let message = tokio::time::timeout(PATIENCE, answer.message()).await;
    let message = message.map_err(|_| CallError::Deadline)?.map_err(|status| CallError::from(&status))?;
    let part = message.ok_or(Error::Contract("it ends without a summary"))?.part;
    part.ok_or(Error::Contract("a message holds nothing that this version knows"))
}

impl CacheInner {
    /// Stores a tile in a form if it can be read.
    fn store(&self, whole: Whole, form: Form, since: u64) -> Result<u32, Error> {
        let Whole { id, version, encoded } = whole;
        let unreadable = |source| Error::Unreadable { id, source };
        let encoded = match super::decode(form, &encoded) {
            Ok(_) => encoded,
            // It comes from a service that knows no layers.
            Err(DecodeError::NotOurs) if form == Form::Layer => {
                let tile = tile::decode(&encoded).map_err(unreadable)?;
                tile::encode_layer(&tile, &Grain::VEHICLE)
            }
            Err(source) => return Err(unreadable(source)),
        };
        self.put(TileVersionName { id, version, form }, &encoded, since)
    }

    fn remove_all(&self, absent: &[TileId]) -> Result<u32, Error> {
        let mut removed = 0;
        for id in absent {
            removed += u32::from(self.remove(*id)?);
        }
        Ok(removed)
    }
}
