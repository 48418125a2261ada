//! The map as it was at an epoch, which is folded anew when somebody looks, and kept while somebody does.

use std::sync::Arc;
use std::time::Duration;

use axum::extract::Query;
use axum::extract::rejection::QueryRejection;
use moka::sync::Cache;
use serde::Deserialize;
use tokio::sync::Mutex;

use super::App;
use super::error::Error;
use super::operations::work;
use super::raster::Artist;
use crate::shares::Peer;
use crate::store::MapStore;

/// Maps of the past in memory at once: the two that somebody compares.
const KEPT: u64 = 2;
/// How long one is kept that nobody looks at.
const IDLE: Duration = Duration::from_mins(5);

/// `?epoch=`; without it, the map that is served now.
#[derive(Debug, Clone, Copy, Default, Deserialize)]
pub struct EpochQuery {
    epoch: Option<u64>,
}

impl EpochQuery {
    /// The query that asks for the same epoch.
    pub fn query(self) -> Option<String> {
        self.epoch.map(|epoch| format!("?epoch={epoch}"))
    }
}

/// A query's part that names an epoch.
pub type EpochParameter = Result<Query<EpochQuery>, QueryRejection>;

/// A map to look at, of now or of then.
#[derive(Clone)]
pub struct Shown {
    pub store: Arc<dyn MapStore>,
    pub artist: Arc<Artist>,
}

/// Maps of the past that are looked at.
pub struct PastMaps {
    maps: Cache<u64, Shown>,
    /// Held while one is folded: requests at the same time wait for it instead of folding it, too, or being refused.
    folding: Arc<Mutex<()>>,
}

impl Default for PastMaps {
    fn default() -> Self {
        // An epoch is the same map for ever.
        let maps = Cache::builder().max_capacity(KEPT).time_to_idle(IDLE).build();
        Self { maps, folding: Arc::default() }
    }
}

impl App {
    /// The map that a request is about.
    ///
    /// # Errors
    /// When there is no such epoch, or its map cannot be folded for the moment.
    pub(super) async fn shown(self: &Arc<Self>, peer: Peer, epoch: EpochParameter) -> Result<Shown, Error> {
        let Some(epoch) = epoch?.0.epoch else {
            return Ok(Shown { store: Arc::clone(&self.state.store), artist: Arc::clone(&self.artist) });
        };
        // What was compacted meanwhile is not shown, even if it is still at hand.
        let (oldest, newest) = self.state.operations.epochs();
        if !(oldest..=newest).contains(&epoch) {
            let reason = format!("epoch {epoch} cannot be had: the journal goes from {oldest} to {newest}");
            return Err(Error::NotFound(reason));
        }
        if let Some(shown) = self.past.maps.get(&epoch) {
            return Ok(shown);
        }
        let folding = Arc::clone(&self.past.folding).lock_owned().await;
        if let Some(shown) = self.past.maps.get(&epoch) {
            return Ok(shown);
        }
        let (expectations, maps) = (Arc::clone(&self.state.expectations), self.past.maps.clone());
        work(self, peer, move |operations| {
            // Both by the work, not by the request: what takes longer than a request may is there for the next one.
            let _folding = folding;
            let store = operations.served_at(epoch)?;
            let expectations = Arc::new(expectations.over(Arc::clone(&store)));
            let artist = Arc::new(Artist::new(Arc::clone(&store), expectations));
            let shown = Shown { store, artist };
            maps.insert(epoch, shown.clone());
            Ok(shown)
        })
        .await
    }
}
