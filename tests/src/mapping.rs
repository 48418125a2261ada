//! A drive goes to the map.

use echofix_client::upload::{PreparedUpload, RecorderConfig, UploadForm};
use echofix_core::drive::Drive;
use echofix_harness::recording::{record, to_the_ends};
use echofix_proto::v1::mapping_service_client::MappingServiceClient;
use echofix_proto::v1::{UploadRequest, UploadResponse};
use tonic::Status;
use tonic::transport::Channel;

use crate::grpc;
use crate::service::Service;

/// A drive as the uploads the vehicle's recorder makes of it.
pub fn uploads(drive: &Drive) -> Vec<PreparedUpload> {
    uploads_as(drive, to_the_ends())
}

/// The same as scans.
pub fn scan_uploads(drive: &Drive) -> Vec<PreparedUpload> {
    uploads_as(drive, RecorderConfig { form: UploadForm::Scans, ..to_the_ends() })
}

/// The same, recorded in some other way.
pub fn uploads_as(drive: &Drive, config: RecorderConfig) -> Vec<PreparedUpload> {
    let recorded = record(drive, config).unwrap_or_else(|error| panic!("{error:#}"));
    assert!(!recorded.uploads.is_empty(), "the drive of `{}` makes no upload", drive.vehicle);
    recorded.uploads
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
    folded(service).await;
    answers
}

/// Waits until the map shows everything that was acknowledged; returns its epoch.
pub async fn folded(service: &Service) -> u64 {
    let map = service.process().folded().await.unwrap_or_else(|error| panic!("{error:#}\n{}", service.log()));
    map["epoch"].as_u64().expect("a served map has an epoch")
}
