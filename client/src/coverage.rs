//! What the service knows of a way: where it has a map, and which uploads it wants.

use std::time::Duration;

use echofix_core::geo::LatLon;
use echofix_proto::v1::map_service_client::MapServiceClient;
use echofix_proto::v1::{GetCoverageRequest, GetCoverageResponse};
use tonic::Request;

use crate::refusal::CallError;
use crate::routing;
use crate::service::{CallerChannel, ServiceEndpoint};

/// Points of one question, at most: what the service takes.
const POINTS: usize = 4_096;
/// An answer is waited for this long.
const PATIENCE: Duration = Duration::from_secs(10);

/// A connection to the service's map.
#[derive(Debug, Clone)]
pub struct CoverageClient {
    client: MapServiceClient<CallerChannel>,
}

impl CoverageClient {
    /// Prepares the connection, which is made with the first question.
    ///
    /// Must be called within a tokio runtime.
    #[must_use]
    pub fn new(service: &ServiceEndpoint) -> Self {
        Self { client: MapServiceClient::new(service.connect_lazy()) }
    }

    /// Asks about points, in one call for each few thousand of them. Each answer comes with the points that it is about, as
    /// [`Demand::learn_coverage`](crate::upload::Demand::learn_coverage) takes them. Without points, one answer tells of the map
    /// as a whole.
    ///
    /// # Errors
    /// When the service cannot be reached or refuses.
    pub async fn ask<'a>(
        &self,
        points: &'a [LatLon],
    ) -> Result<Vec<(&'a [LatLon], GetCoverageResponse)>, CallError> {
        let mut answers = Vec::new();
        for part in points.chunks(POINTS) {
            answers.push((part, self.ask_part(part).await?));
        }
        if points.is_empty() {
            answers.push((points, self.ask_part(points).await?));
        }
        Ok(answers)
    }

    async fn ask_part(&self, points: &[LatLon]) -> Result<GetCoverageResponse, CallError> {
        let mut request = Request::new(GetCoverageRequest {
            latitude_deg: points.iter().map(|at| at.lat_deg).collect(),
            longitude_deg: points.iter().map(|at| at.lon_deg).collect(),
            expectations: false,
        });
        routing::mark(&mut request, points.first().and_then(|at| routing::region_at(*at)));
        request.set_timeout(PATIENCE);
        match tokio::time::timeout(PATIENCE, self.client.clone().get_coverage(request)).await {
            Ok(answer) => answer.map(tonic::Response::into_inner).map_err(|status| CallError::from(&status)),
            Err(_) => Err(CallError::Deadline),
        }
    }
}
