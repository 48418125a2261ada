//! Where calls should go: the header that balancers hash, and the replica that an answer named.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use echofix_core::geo::{LatLon, RoutingRegion, TileId};
use echofix_proto::v1;
use tokio::time::Instant;
use tonic::Request;
use tonic::metadata::MetadataMap;

use crate::refusal::CallError;
use crate::service::{CallerChannel, ServiceEndpoint};

/// Requests of one region go to one replica, where its tiles are warm.
const HEADER: &str = "x-echofix-region";
/// The replica that keeps a region warm, in an answer.
const BETTER: &str = "x-echofix-better-asked-at";

/// Regions whose replica is remembered, at most: those of a day's drive.
const MOST_REGIONS: usize = 64;
/// Replicas that are connected to, at most.
const MOST_REPLICAS: usize = 16;
/// A region's replica is changed this often, at most: replicas that disagree cost no more than that.
const CHANGED_EVERY: Duration = Duration::from_secs(10);
/// A replica that did not answer is not followed to for this long.
const SHUNNED_FOR: Duration = Duration::from_mins(1);

/// The region of a request's prior; `None` without one on the map.
pub(crate) fn region_of(request: &v1::LocalizeRequest) -> Option<RoutingRegion> {
    let pose = request.prior.as_ref()?.pose.as_ref()?;
    region_at(LatLon { lat_deg: pose.latitude_deg, lon_deg: pose.longitude_deg })
}

/// The region of a place; `None` off the map.
pub(crate) fn region_at(at: LatLon) -> Option<RoutingRegion> {
    RoutingRegion::of(at).ok()
}

/// The region of most of these; the first of equals.
pub(crate) fn region_of_most(tiles: impl IntoIterator<Item = (TileId, u64)>) -> Option<RoutingRegion> {
    let mut counts = std::collections::BTreeMap::<_, u64>::new();
    for (tile, count) in tiles {
        *counts.entry(RoutingRegion::of_tile(tile)).or_default() += count;
    }
    counts.into_iter().rev().max_by_key(|(_, count)| *count).map(|(region, _)| region)
}

/// Names the region in a request's headers; nothing else of the place.
pub(crate) fn mark<T>(request: &mut Request<T>, region: Option<RoutingRegion>) {
    if let Some(value) = region.and_then(|region| region.to_string().parse().ok()) {
        request.metadata_mut().insert(HEADER, value);
    }
}

/// Whom a call is made to.
#[derive(Debug, Clone)]
pub(crate) struct Asked {
    pub(crate) channel: CallerChannel,
    /// The replica's address, where it is not the one that was configured.
    pub(crate) replica: Option<Arc<str>>,
}

/// Sends the calls of each region to the replica that keeps it warm, as far as answers have named one.
///
/// A replica's address is taken where it was configured, or where the same authority, which must be one of the vehicle's own,
/// vouches for it ([`ServiceEndpoint::follows`]). A call is never sent around: what an answer names counts for later ones. A
/// replica that does not answer is left for the configured address.
#[derive(Debug, Clone)]
pub(crate) struct Router {
    home: CallerChannel,
    endpoint: Arc<ServiceEndpoint>,
    state: Arc<Mutex<State>>,
}

#[derive(Debug, Default)]
struct State {
    regions: HashMap<RoutingRegion, (Arc<str>, Instant)>,
    channels: HashMap<Arc<str>, CallerChannel>,
    shunned: HashMap<Arc<str>, Instant>,
}

impl Router {
    /// Within a tokio runtime.
    pub(crate) fn new(endpoint: ServiceEndpoint) -> Self {
        Self { home: endpoint.connect_lazy(), endpoint: Arc::new(endpoint), state: Arc::default() }
    }

    /// Whom to ask about a region.
    pub(crate) fn ask(&self, region: Option<RoutingRegion>) -> Asked {
        let state = self.state();
        let known = region.and_then(|region| state.regions.get(&region));
        let found = known.and_then(|(replica, _)| Some((replica, state.channels.get(replica)?)));
        match found {
            Some((replica, channel)) => Asked { channel: channel.clone(), replica: Some(replica.clone()) },
            None => Asked { channel: self.home.clone(), replica: None },
        }
    }

    /// What an answer, or a refusal, says of where its region is better asked.
    pub(crate) fn heard(&self, region: Option<RoutingRegion>, answer: &MetadataMap) {
        let named = answer.get(BETTER).and_then(|named| named.to_str().ok());
        let Some((region, named)) = region.zip(named) else { return };
        let now = Instant::now();
        let mut state = self.state();
        let fresh = state.regions.get(&region).is_some_and(|(_, since)| now - *since < CHANGED_EVERY);
        state.shunned.retain(|_, until| *until > now);
        if fresh || state.shunned.contains_key(named) {
            return;
        }
        if !state.channels.contains_key(named) {
            let followed = self.endpoint.follows(named);
            let Some(followed) = followed.filter(|_| state.channels.len() < MOST_REPLICAS) else { return };
            state.channels.insert(named.into(), followed.connect_lazy());
        }
        if state.regions.len() >= MOST_REGIONS && !state.regions.contains_key(&region) {
            let oldest = state.regions.iter().min_by_key(|(_, (_, since))| *since).map(|(region, _)| *region);
            oldest.map(|oldest| state.regions.remove(&oldest));
        }
        state.regions.insert(region, (named.into(), now));
    }

    /// What is told of a call that failed. Where an answer had named the replica, that is left, and the call is to be made again at
    /// once.
    pub(crate) fn left(&self, replica: Option<&Arc<str>>, error: CallError) -> CallError {
        let Some(replica) = replica.filter(|_| error.is_transient()) else { return error };
        self.failed(replica);
        CallError::Unavailable { message: error.to_string(), retry_after: Some(Duration::ZERO) }
    }

    /// A replica that an answer had named does not answer.
    fn failed(&self, replica: &Arc<str>) {
        let mut state = self.state();
        state.regions.retain(|_, (named, _)| named != replica);
        state.channels.remove(replica);
        state.shunned.insert(replica.clone(), Instant::now() + SHUNNED_FOR);
    }

    fn state(&self) -> MutexGuard<'_, State> {
        // Each change leaves it whole.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests;
