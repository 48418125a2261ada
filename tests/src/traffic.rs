//! Vehicles that upload without pause, and the list of what was acknowledged to them: the judge of crashes.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};

use echofix_client::upload::{PreparedUpload, RecorderConfig};
use echofix_core::geo::LatLon;
use echofix_harness::recording::to_the_ends;
use echofix_proto::v1::mapping_service_client::MappingServiceClient;
use echofix_proto::v1::upload_request::Part;
use echofix_proto::v1::{UploadRequest, UploadResponse};
use echofix_sim::CityParams;
use tokio::task::JoinSet;
use tonic::transport::Channel;
use uuid::Uuid;

use crate::service::Service;
use crate::{grpc, mapping, town};

/// Vehicles that upload at once.
const VEHICLES: u32 = 4;
/// Latitude between two towns, degrees: 1.1 km.
const TOWNS_APART_DEG: f64 = 0.01;

/// Towns to which the uploads go in turn: `ECHOFIX_TOWNS`, 1 unless set. The long runs need many, or every tile would take
/// thousands of passes, which no street sees.
fn towns() -> u32 {
    std::env::var("ECHOFIX_TOWNS").map_or(1, |text| text.parse().expect("ECHOFIX_TOWNS is a number"))
}

/// Short uploads without end, by their number.
pub struct Uploads {
    seed: u64,
    /// Half a second of driving each.
    templates: Vec<Vec<UploadRequest>>,
    next: AtomicU32,
}

impl Uploads {
    /// Parts of a drive through each town.
    pub fn new(seed: u64) -> Self {
        let templates = (0..towns()).flat_map(|town| Self::of_town(seed, town)).collect();
        Self { seed, templates, next: AtomicU32::new(0) }
    }

    fn of_town(seed: u64, town: u32) -> Vec<Vec<UploadRequest>> {
        let origin = CityParams::default().origin;
        let origin = LatLon { lat_deg: origin.lat_deg + TOWNS_APART_DEG * f64::from(town), ..origin };
        let city = town::town_at(seed + u64::from(town), origin);
        let drive = town::wander(&city, 0, "mapper", seed, 300.0);
        let short = RecorderConfig { cut_after_s: 0.5, cut_after_m: 5.0, ..to_the_ends() };
        mapping::uploads_as(&drive, short).into_iter().map(PreparedUpload::into_parts).collect()
    }

    /// The number of an upload that was not sent yet.
    pub fn fresh(&self) -> u32 {
        self.next.fetch_add(1, Ordering::Relaxed)
    }

    /// An upload's messages: the same each time, under an id and from a contributor of its own.
    pub fn parts(&self, number: u32) -> Vec<UploadRequest> {
        let mut parts = self.templates[number as usize % self.templates.len()].clone();
        if let Some(Part::Header(header)) = &mut parts[0].part {
            header.upload_id = Uuid::from_u64_pair(self.seed, u64::from(number)).to_string();
            header.contributor = format!("vehicle-{number}");
        }
        parts
    }
}

/// What the vehicles know of their uploads.
#[derive(Debug, Default)]
pub struct Acknowledgements {
    /// What was answered first.
    pub answers: BTreeMap<u32, UploadResponse>,
    /// Sent, but nobody knows whether they arrived.
    pub open: Vec<u32>,
}

impl Acknowledgements {
    /// Uploads without pause until the service is gone, which `end` brings about.
    pub async fn until_gone(
        &mut self,
        uploads: &Arc<Uploads>,
        service: &mut Service,
        end: impl AsyncFnOnce(&mut Service),
    ) {
        let mut vehicles = JoinSet::new();
        for _ in 0..VEHICLES {
            vehicles.spawn(drive_on(grpc::mapping(service).await, Arc::clone(uploads)));
        }
        end(service).await;
        while let Some(known) = vehicles.join_next().await {
            let known = known.expect("a vehicle does not panic");
            self.answers.extend(known.answers);
            self.open.extend(known.open);
        }
    }

    /// Sends again whatever was acknowledged of the uploads from a number on, which must be known by now, and
    /// all that nobody knows of; returns the acknowledged ones that the service has lost. Afterwards all that was
    /// ever sent is acknowledged.
    pub async fn judge(&mut self, uploads: &Uploads, service: &Service, from: u32) -> Vec<u32> {
        let mut client = grpc::mapping(service).await;
        let mut lost = Vec::new();
        for (number, first) in self.answers.range_mut(from..) {
            let again = mapping::send(&mut client, &uploads.parts(*number)).await;
            let again = again.expect("a retry is answered");
            if !again.duplicate {
                lost.push(*number);
                *first = again;
            }
        }
        for number in std::mem::take(&mut self.open) {
            let answer =
                mapping::send(&mut client, &uploads.parts(number)).await.expect("a retry is answered");
            self.answers.insert(number, answer);
        }
        lost
    }
}

/// One vehicle: upload after upload, until one fails.
async fn drive_on(mut client: MappingServiceClient<Channel>, uploads: Arc<Uploads>) -> Acknowledgements {
    let mut known = Acknowledgements::default();
    loop {
        let number = uploads.fresh();
        let Ok(answer) = mapping::send(&mut client, &uploads.parts(number)).await else {
            known.open.push(number);
            return known;
        };
        known.answers.insert(number, answer);
    }
}
