//! Calls that name the region of a place which another living service keeps warm are answered, and told where they are better
//! asked. Any service answers any call, so this saves work and decides nothing.

use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};

use axum::http::{HeaderName, HeaderValue, Request, Response};
use echofix_core::geo::RoutingRegion;
use tokio::sync::watch;
use tower::{Layer, Service};

use crate::store::MapStore;

/// The region of a call's place, by the caller.
const REGION: HeaderName = HeaderName::from_static("x-echofix-region");
/// The address of the service that keeps the region warm.
const BETTER: HeaderName = HeaderName::from_static("x-echofix-better-asked-at");

/// Tells callers of other services.
#[derive(Clone)]
pub(super) struct RoutingLayer(Option<Replicas>);

/// Those who live, and which of them this one is.
#[derive(Clone)]
struct Replicas {
    own: Arc<str>,
    living: watch::Receiver<Vec<String>>,
}

impl RoutingLayer {
    /// Of a service that is reached at an address, where it shares its map.
    pub(super) fn of(store: &dyn MapStore, own: &str) -> Self {
        Self(store.replicas().map(|living| Replicas { own: own.into(), living }))
    }
}

impl Replicas {
    /// Where a region's calls are better asked than here.
    fn better(&self, region: &HeaderValue) -> Option<HeaderValue> {
        let region: RoutingRegion = region.to_str().ok()?.parse().ok()?;
        let living = self.living.borrow();
        let best = living.get(region.best_of(&*living)?)?;
        if **best == *self.own { None } else { HeaderValue::from_str(best).ok() }
    }
}

impl<S> Layer<S> for RoutingLayer {
    type Service = Routing<S>;

    fn layer(&self, inner: S) -> Routing<S> {
        Routing { replicas: self.0.clone(), inner }
    }
}

/// A service whose callers are told of others.
#[derive(Clone)]
pub(super) struct Routing<S> {
    replicas: Option<Replicas>,
    inner: S,
}

impl<S, B, R> Service<Request<B>> for Routing<S>
where
    S: Service<Request<B>, Response = Response<R>>,
    S::Future: Send + 'static,
{
    type Response = Response<R>;
    type Error = S::Error;
    type Future = Pin<Box<dyn Future<Output = Result<Response<R>, S::Error>> + Send>>;

    fn poll_ready(&mut self, context: &mut Context<'_>) -> Poll<Result<(), S::Error>> {
        self.inner.poll_ready(context)
    }

    fn call(&mut self, request: Request<B>) -> Self::Future {
        let better = self.replicas.as_ref().zip(request.headers().get(REGION));
        let better = better.and_then(|(replicas, region)| replicas.better(region));
        let answer = self.inner.call(request);
        let Some(better) = better else { return Box::pin(answer) };
        Box::pin(async move {
            let mut answer = answer.await?;
            answer.headers_mut().insert(BETTER, better);
            Ok(answer)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Catches: replicas that send a call around in a circle, a region that nobody keeps, and a header that is believed
    /// although it names no region.
    #[test]
    fn all_replicas_name_the_same_one_and_it_names_nobody() {
        let names = ["http://a:1", "http://b:1", "http://c:1"].map(str::to_owned);
        let (_tell, living) = watch::channel(names.to_vec());
        let replicas = names.clone().map(|own| Replicas { own: own.into(), living: living.clone() });
        for x in 0..200 {
            let region = HeaderValue::from_str(&format!("32614/{x}/511")).unwrap();
            let told: Vec<_> = replicas.iter().filter_map(|replica| replica.better(&region)).collect();
            assert!(told.len() == 2 && told[0] == told[1], "{told:?}");
            let keeper = names.iter().position(|name| told[0] == name.as_str()).unwrap();
            assert!(replicas[keeper].better(&region).is_none());
        }
        for text in ["", "32614/1", "nonsense", "32614/1/2/3"] {
            assert!(replicas.iter().all(|replica| replica.better(&HeaderValue::from_static(text)).is_none()));
        }
    }

    /// Catches: a service that stands alone and names another, or an empty address.
    #[test]
    fn who_is_alone_names_nobody() {
        let (tell, living) = watch::channel(vec!["http://a:1".to_owned()]);
        let alone = Replicas { own: "http://a:1".into(), living };
        let region = HeaderValue::from_static("32614/94/511");
        assert!(alone.better(&region).is_none());
        tell.send_replace(Vec::new());
        assert!(alone.better(&region).is_none());
    }
}
