//! A request that no slot could take is refused on its headers: its body is neither unpacked nor decoded.

use std::sync::Arc;

use axum::http::Request;
use tonic::Status;

use super::heads::Look;
use super::localize::turned_away;
use crate::locating::Locator;
use crate::metrics::Metrics;

/// The call whose work is bounded by slots.
const LOCALIZE: &str = "/echofix.v1.LocalizationService/Localize";

/// Looks at the slots.
#[derive(Clone)]
pub struct Admission {
    locator: Arc<Locator>,
    metrics: Arc<Metrics>,
}

impl Admission {
    /// For requests that a locator answers; refusals are counted in `metrics`.
    #[must_use]
    pub fn new(locator: Arc<Locator>, metrics: Arc<Metrics>) -> Self {
        Self { locator, metrics }
    }
}

impl Look for Admission {
    fn look<B>(&self, request: &mut Request<B>) -> Result<(), Status> {
        if request.uri().path() == LOCALIZE {
            let arriving = self.locator.expect().map_err(|refusal| turned_away(&self.metrics, &refusal))?;
            request.extensions_mut().insert(Arc::new(arriving));
        }
        Ok(())
    }
}
