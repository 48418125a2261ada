//! A town that is mapped, and the service that holds its map: made once a test file.

use echofix_core::drive::Drive;
use echofix_proto::v1::UploadResponse;
use echofix_sim::City;

use crate::asking::{TruthRequest, requests};
use crate::mapping::contribute;
use crate::service::Service;
use crate::town;

/// Days after the mapping on which others drive: other cars are parked then.
const DAYS_LATER: u32 = 3;

/// A town and the service that holds its map.
pub struct World {
    /// The seed of everything.
    pub seed: u64,
    /// The town.
    pub city: City,
    /// The service.
    pub service: Service,
    /// What was answered to the mapping vehicles' uploads, in order.
    pub answers: Vec<UploadResponse>,
}

impl World {
    /// The names under which the town is mapped.
    pub const MAPPERS: [&str; 2] = ["mapper-anna", "mapper-boris"];

    /// A town in which two vehicles have driven through every street on day 0.
    pub async fn mapped() -> Self {
        Self::mapped_with(Service::start()).await
    }

    /// The same on a service that runs already.
    pub async fn mapped_with(service: Service) -> Self {
        let seed = town::seed();
        let city = town::town(seed);
        let mut answers = Vec::new();
        for (number, name) in (1..).zip(Self::MAPPERS) {
            let drive = town::survey(&city, 0, name, 1_000 * seed + number);
            answers.extend(contribute(&service, &drive).await);
        }
        Self { seed, city, service, answers }
    }

    /// A drive of another vehicle on another day.
    pub fn visit(&self, length_m: f64) -> Drive {
        town::wander(&self.city, DAYS_LATER, "visitor", 1_000 * self.seed + 999, length_m)
    }

    /// The questions of such a drive, one every so many seconds, from priors as rough as the paper's.
    pub fn questions(&self, length_m: f64, every_s: f64) -> Vec<TruthRequest> {
        requests(&self.visit(length_m), every_s, self.seed)
    }
}
