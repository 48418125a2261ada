//! Who asks, and whether they may. The caller goes with the request to its handler, which takes it as an argument:
//! `Extension<Arc<Caller>>`.

use std::sync::Arc;

use axum::extract::{MatchedPath, Request, State};
use axum::http::{HeaderValue, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};

use super::App;
use super::error::Error;
use crate::access_log::NotedRoles;
use crate::identity::access::{Call, methods};
use crate::identity::{Rated, Refusal, RemoteEnd};
use crate::shares;

/// What load balancers ask, however often.
const PROBES: [&str; 2] = ["/healthz", "/readyz"];

/// Lets through only what the caller may ask for, and no oftener than the rates say.
pub async fn guard(State(app): State<Arc<App>>, mut request: Request, next: Next) -> Response {
    let probe =
        request.extensions().get::<MatchedPath>().is_some_and(|route| PROBES.contains(&route.as_str()));
    if !probe && let Err(refusal) = counted(&app, &request) {
        return refusal.into_response();
    }
    // Where there is no route, nothing is answered but that.
    let Some(route) = request.extensions().get::<MatchedPath>().cloned() else {
        return next.run(request).await;
    };
    let call = Call::Http(request.method().as_str(), route.as_str());
    let peer = request.extensions().get::<Arc<RemoteEnd>>().map(Arc::as_ref);
    match app.gate.admit(call, peer, request.headers()) {
        Ok(caller) => {
            if !probe && let Err(wait) = app.rates.count(Rated::Http, &caller) {
                return Error::TooOften { who: "this caller", wait }.into_response();
            }
            NotedRoles::note(&request, caller.roles);
            request.extensions_mut().insert(Arc::new(caller));
            next.run(request).await
        }
        Err(Refusal::NotServed) => not_served(route.as_str()),
        Err(refusal) => {
            if let Refusal::Forbidden { roles, .. } = &refusal {
                NotedRoles::note(&request, *roles);
            }
            Error::from(refusal).into_response()
        }
    }
}

/// Counts a request for its address, where that is not the proxy's or this machine's own.
fn counted(app: &App, request: &Request) -> Result<(), Error> {
    let extensions = request.extensions();
    let address = extensions.get::<shares::Peer>().copied();
    let end = extensions.get::<Arc<RemoteEnd>>().map(Arc::as_ref);
    match address.filter(|_| app.gate.counts(end)) {
        Some(address) => {
            let count = app.rates.count_address(address);
            count.map_err(|wait| Error::TooOften { who: "this address", wait })
        }
        None => Ok(()),
    }
}

/// A method that the table does not have for this route.
fn not_served(route: &str) -> Response {
    let mut allowed: Vec<_> = methods(route).collect();
    if allowed.contains(&"GET") {
        allowed.push("HEAD");
    }
    let mut response = Error::MethodNotAllowed.into_response();
    if let Ok(allowed) = HeaderValue::from_str(&allowed.join(",")) {
        response.headers_mut().insert(header::ALLOW, allowed);
    }
    response
}
