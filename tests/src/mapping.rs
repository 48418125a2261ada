//! A drive goes to the map.

use std::time::Duration;

use echofix_client::drivelog::{DriveEvent, replay};
use echofix_client::upload::{PreparedUpload, Recorder, RecorderConfig, UploadForm};
use echofix_core::drive::Drive;
use echofix_proto::v1::mapping_service_client::MappingServiceClient;
use echofix_proto::v1::{UploadRequest, UploadResponse};
use tonic::Status;
use tonic::transport::Channel;

use crate::service::Service;
use crate::{grpc, http, until};

/// How drives are recorded here: the vehicle's way, but to their very ends, for the town is small.
pub fn whole() -> RecorderConfig {
    RecorderConfig { trim_ends_m: 0.0, ..RecorderConfig::default() }
}

/// A drive as the uploads the vehicle's recorder makes of it.
pub fn uploads(drive: &Drive) -> Vec<PreparedUpload> {
    uploads_as(drive, whole())
}

/// The same as scans.
pub fn scan_uploads(drive: &Drive) -> Vec<PreparedUpload> {
    uploads_as(drive, RecorderConfig { form: UploadForm::Scans, ..whole() })
}

/// The same, recorded in some other way.
pub fn uploads_as(drive: &Drive, config: RecorderConfig) -> Vec<PreparedUpload> {
    let mut recorder =
        Recorder::new(config, &drive.vehicle, drive.mounts.clone()).expect("the vehicle has a name");
    let mut uploads = Vec::new();
    for event in replay(drive) {
        match event {
            DriveEvent::Odometry(time_us, pose) => {
                recorder.push_odometry(time_us, pose).expect("odometry is in order");
            }
            DriveEvent::Scan(scan) => recorder.push_scan(scan.clone()).expect("a simulated scan is sound"),
            DriveEvent::Reference(pose) => {
                uploads.extend(recorder.push_pose(*pose).expect("poses are in order"))
            }
            DriveEvent::Truth(_) => {}
        }
    }
    uploads.extend(recorder.finish());
    assert!(!uploads.is_empty(), "the drive of `{}` makes no upload", drive.vehicle);
    uploads
}

/// Sends one upload.
///
/// # Errors
/// The service's refusal.
pub async fn send(
    client: &mut MappingServiceClient<Channel>,
    parts: &[UploadRequest],
) -> Result<UploadResponse, Status> {
    client.upload(tokio_stream::iter(parts.to_vec())).await.map(tonic::Response::into_inner)
}

/// Sends all uploads of a drive and waits until the map shows them; returns what was answered.
pub async fn contribute(service: &Service, drive: &Drive) -> Vec<UploadResponse> {
    let mut client = grpc::mapping(service).await;
    let mut answers = Vec::new();
    for upload in uploads(drive) {
        let answer = send(&mut client, upload.parts()).await;
        answers
            .push(answer.unwrap_or_else(|status| panic!("upload {} was refused: {status:?}", upload.id())));
    }
    settled(service).await;
    answers
}

/// Waits until the map shows everything that was acknowledged, as long as it goes on; returns its epoch.
pub async fn settled(service: &Service) -> u64 {
    let mut before = 0;
    loop {
        let (epoch, whole) = until("the map shows more uploads", Duration::from_mins(1), async || {
            let map = http::get(&format!("{}/api/v1/map", service.http)).json();
            let epoch = map["epoch"].as_u64()?;
            let whole = map["state"] == "serving" && map["epoch"] == map["journaled"];
            (whole || epoch > before).then_some((epoch, whole))
        })
        .await;
        if whole {
            return epoch;
        }
        before = epoch;
    }
}
