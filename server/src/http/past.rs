//! The map as it was at an epoch, which is folded anew when somebody looks, and kept while somebody does.

use std::collections::HashMap;
use std::convert::Infallible;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use axum::extract::rejection::QueryRejection;
use axum::extract::{FromRequestParts, Query};
use axum::http::request::Parts;
use moka::sync::Cache;
use serde::Deserialize;
use tokio::sync::watch;
use tracing::Instrument;

use super::App;
use super::error::Error;
use super::operations::work;
use super::raster::Artist;
use crate::identity::Caller;
use crate::shares::{Peer, Place, Pool};
use crate::store::MapStore;

/// Maps of the past in memory at once: the two that somebody compares.
const KEPT: u64 = 2;
/// How long one is kept that nobody looks at.
const IDLE: Duration = Duration::from_mins(5);

/// Maps that may be sought at once, the one that is being folded among them; and by one caller: the two that are compared.
const QUEUE: usize = 8;
const EACH: usize = 2;

/// `?epoch=`; without it, the map that is served now.
#[derive(Debug, Clone, Copy, Default, Deserialize, utoipa::IntoParams)]
#[into_params(parameter_in = Query)]
pub struct EpochQuery {
    /// The map as it was at this epoch; without it, as it is served. It is folded when it is first asked for.
    epoch: Option<u64>,
}

/// The epoch that a request names, and who asks for it, where that is known.
pub struct EpochParameter {
    query: Result<Query<EpochQuery>, QueryRejection>,
    caller: Option<String>,
}

impl EpochParameter {
    /// The query that asks for the same epoch.
    pub fn query(&self) -> Option<String> {
        self.query.as_ref().ok()?.0.epoch.map(|epoch| format!("?epoch={epoch}"))
    }
}

impl<S: Send + Sync> FromRequestParts<S> for EpochParameter {
    type Rejection = Infallible;

    async fn from_request_parts(parts: &mut Parts, state: &S) -> Result<Self, Infallible> {
        let caller = parts.extensions.get::<Arc<Caller>>().filter(|caller| caller.is_known());
        let caller = caller.map(|caller| caller.name.clone());
        Ok(Self { query: Query::from_request_parts(parts, state).await, caller })
    }
}

/// A map to look at, of now or of then.
#[derive(Clone)]
pub struct Shown {
    pub store: Arc<dyn MapStore>,
    pub artist: Arc<Artist>,
}

/// Maps of the past that are looked at. One is folded at a time: it takes a core, and the memory of a map.
pub struct PastMaps {
    maps: Cache<u64, Shown>,
    /// Those that are sought: under way, or in the queue.
    sought: Mutex<HashMap<u64, Sought>>,
    queue: Arc<Pool>,
    /// Held while one is folded.
    folding: Arc<tokio::sync::Mutex<()>>,
}

/// A map that is sought.
struct Sought {
    /// Who was the first to ask for it.
    by: String,
    told: Arc<watch::Sender<Option<Outcome>>>,
}

/// What came of it.
type Outcome = Result<Shown, Arc<Error>>;

impl PastMaps {
    /// Nothing yet; one address may have a share of the queue.
    pub fn new(share: f64) -> Self {
        // An epoch is the same map for ever.
        let maps = Cache::builder().max_capacity(KEPT).time_to_idle(IDLE).build();
        Self { maps, sought: Mutex::default(), queue: Pool::new(QUEUE, share), folding: Arc::default() }
    }

    fn sought(&self) -> MutexGuard<'_, HashMap<u64, Sought>> {
        // Entries are put in and taken out whole.
        self.sought.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The fold of an epoch that is sought already, or else a new one in the queue, which is to be made.
    fn join(
        &self,
        epoch: u64,
        by: String,
        peer: Peer,
    ) -> Result<(watch::Receiver<Option<Outcome>>, Option<Fold>), Error> {
        let mut sought = self.sought();
        if let Some(known) = sought.get(&epoch) {
            return Ok((known.told.subscribe(), None));
        }
        // What nobody waits for any more leaves the queue when its turn comes.
        let own = sought.values().filter(|other| other.by == by && other.told.receiver_count() > 0).count();
        let place = self.queue.take(peer).filter(|_| own < EACH);
        let place = place.ok_or(Error::Saturated("other epochs of the map are being folded"))?;
        let told = Arc::new(watch::Sender::new(None));
        let outcome = told.subscribe();
        sought.insert(epoch, Sought { by, told: Arc::clone(&told) });
        Ok((outcome, Some(Fold { epoch, told, _place: place })))
    }
}

/// A map that is to be folded, and its place in the queue.
struct Fold {
    epoch: u64,
    told: Arc<watch::Sender<Option<Outcome>>>,
    _place: Place,
}

impl App {
    /// The map that a request is about.
    ///
    /// # Errors
    /// When there is no such epoch, its map cannot be folded, or too many others are sought.
    pub(super) async fn shown(self: &Arc<Self>, peer: Peer, epoch: EpochParameter) -> Result<Shown, Error> {
        let EpochParameter { query, caller } = epoch;
        let Some(epoch) = query?.0.epoch else {
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
        let by = caller.unwrap_or_else(|| peer.to_string());
        let (mut outcome, fold) = self.past.join(epoch, by, peer)?;
        if let Some(fold) = fold {
            tokio::spawn(Arc::clone(self).fold(fold, peer).in_current_span());
        }
        let told = outcome.wait_for(Option::is_some).await.map(|told| told.clone());
        match told {
            Ok(Some(told)) => told.map_err(Error::Shared),
            Ok(None) | Err(_) => Err(Error::Saturated("the fold of this epoch was given up")),
        }
    }

    /// Folds a map once it is its turn, unless nobody waits for it any more. What takes longer than a request may is there for
    /// the next one.
    async fn fold(self: Arc<Self>, fold: Fold, peer: Peer) {
        let Fold { epoch, told, _place } = &fold;
        let turn = self.past.folding.lock().await;
        // Whoever joins meanwhile holds the list.
        let given_up = {
            let mut sought = self.past.sought();
            let alone = told.receiver_count() == 0;
            if alone {
                sought.remove(epoch);
            }
            alone
        };
        if given_up {
            return;
        }
        let outcome = match self.past.maps.get(epoch) {
            Some(shown) => Ok(shown),
            None => self.folded(*epoch, peer).await.map_err(Arc::new),
        };
        if let Ok(shown) = &outcome {
            self.past.maps.insert(*epoch, shown.clone());
        }
        self.past.sought().remove(epoch);
        told.send_replace(Some(outcome));
        drop(turn);
    }

    async fn folded(&self, epoch: u64, peer: Peer) -> Result<Shown, Error> {
        let expectations = Arc::clone(&self.state.expectations);
        work(self, peer, move |operations| {
            let store = operations.served_at(epoch)?;
            let expectations = Arc::new(expectations.over(Arc::clone(&store)));
            let artist = Arc::new(Artist::new(Arc::clone(&store), expectations));
            Ok(Shown { store, artist })
        })
        .await
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::http::testing::{TestSite, json_of};
    use axum::http::StatusCode;
    use std::sync::atomic::Ordering;

    /// Catches: viewers who start a fold of the whole journal for every epoch that they name, many at once, or the same one
    /// again and again.
    #[tokio::test]
    async fn one_past_map_is_folded_at_a_time_and_the_queue_is_bounded() {
        let site = Arc::new(TestSite::default());
        site.store.publish_epoch(100);
        let folds = site.store.hold_folds();
        let ask = |epoch: u64| {
            let site = Arc::clone(&site);
            tokio::spawn(async move { site.get(&format!("/api/v1/map?epoch={epoch}")).await })
        };
        let first: Vec<_> = (0..5).map(|_| ask(7)).collect();
        folds.begun(1).await;
        let second: Vec<_> = (0..5).map(|_| ask(8)).collect();
        for _ in 0..20 {
            tokio::task::yield_now().await;
        }
        // So much is one caller's share: the rest is refused at once, whatever epoch it names.
        for epoch in 10..30 {
            let refused = site.get(&format!("/api/v1/map?epoch={epoch}")).await;
            assert_eq!(refused.status(), StatusCode::SERVICE_UNAVAILABLE);
            assert_eq!(refused.headers()["retry-after"], "1");
            assert_eq!(json_of(refused).await["error"]["code"], "saturated");
        }
        assert_eq!(folds.most_at_once.load(Ordering::Relaxed), 1);
        folds.release();
        for answer in first.into_iter().chain(second) {
            assert_eq!(answer.await.unwrap().status(), StatusCode::OK);
        }
        for epoch in [7, 8, 7, 8] {
            assert_eq!(site.get(&format!("/api/v1/map?epoch={epoch}")).await.status(), StatusCode::OK);
        }
        assert_eq!(folds.all.load(Ordering::Relaxed), 2, "what was folded is kept");
        assert_eq!(folds.most_at_once.load(Ordering::Relaxed), 1);
    }
}
