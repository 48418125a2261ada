//! Where calls should go: the header that balancers hash.

use echofix_core::geo::{LatLon, RoutingRegion};
use echofix_proto::v1;
use tonic::Request;

/// Requests of one region go to one replica, where its tiles are warm.
const HEADER: &str = "x-echofix-region";

/// The region of a request's prior; `None` without one on the map.
pub(crate) fn region_of(request: &v1::LocalizeRequest) -> Option<RoutingRegion> {
    let pose = request.prior.as_ref()?.pose.as_ref()?;
    RoutingRegion::of(LatLon { lat_deg: pose.latitude_deg, lon_deg: pose.longitude_deg }).ok()
}

/// Names the region in a request's headers; nothing else of the place.
pub(crate) fn mark<T>(request: &mut Request<T>, region: Option<RoutingRegion>) {
    if let Some(value) = region.and_then(|region| region.to_string().parse().ok()) {
        request.metadata_mut().insert(HEADER, value);
    }
}
