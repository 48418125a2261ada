//! A server on free ports in a fresh directory, and a vehicle that drives past a wall.

#![expect(dead_code, reason = "each test file uses its share")]

use std::net::SocketAddr;
use std::path::Path;

use echofix_proto::v1::map_service_client::MapServiceClient;
use echofix_proto::v1::mapping_service_client::MappingServiceClient;
use echofix_proto::v1::upload_request::Part;
use echofix_proto::v1::{
    PoseColumns, Scans, SensorMount, UploadChunk, UploadHeader, UploadRequest, UploadResponse,
};
use echofix_server::config::{Config, Sources};
use echofix_server::listen::ListenAddress;
use echofix_server::run::{Error, Server};
use tokio::sync::oneshot;
use tokio::task::JoinHandle;
use tonic::Status;
use tonic::transport::Channel;
use uuid::Uuid;

/// 2026-01-01 noon, UTC.
pub const NOON_US: i64 = 1_767_268_800_000_000;

pub struct TestServer {
    pub grpc: SocketAddr,
    pub http: SocketAddr,
    stop: oneshot::Sender<()>,
    task: JoinHandle<Result<(), Error>>,
}

pub fn config(dir: &Path, settings: &[(&str, &str)]) -> Config {
    let dir = dir.display().to_string();
    // One vehicle is enough to make a map.
    let ours = [
        ("grpc.listen", "127.0.0.1:0"),
        ("http.listen", "127.0.0.1:0"),
        ("store.data_dir", &dir),
        ("mapping.publish_contributors", "1"),
    ];
    let settings = ours.iter().chain(settings).map(|(k, v)| ((*k).to_owned(), (*v).to_owned())).collect();
    Config::load(&Sources { settings, ..Sources::default() }).unwrap()
}

impl TestServer {
    pub async fn start(dir: &Path) -> Self {
        Self::with(dir, &[]).await
    }

    pub async fn with(dir: &Path, settings: &[(&str, &str)]) -> Self {
        let server = Server::bind(config(dir, settings)).await.unwrap();
        let (grpc, http) = (tcp(&server.addresses().grpc), tcp(&server.addresses().http));
        let (stop, stopped) = oneshot::channel();
        let task = tokio::spawn(server.run(async {
            let _ = stopped.await;
        }));
        Self { grpc, http, stop, task }
    }

    pub async fn channel(&self) -> Channel {
        Channel::from_shared(format!("http://{}", self.grpc)).unwrap().connect().await.unwrap()
    }

    pub async fn map(&self) -> MapServiceClient<Channel> {
        MapServiceClient::new(self.channel().await)
    }

    pub async fn upload(&self, messages: Vec<UploadRequest>) -> Result<UploadResponse, Status> {
        let mut client = MappingServiceClient::new(self.channel().await);
        client.upload(tokio_stream::iter(messages)).await.map(tonic::Response::into_inner)
    }

    pub async fn stop(self) {
        let _ = self.stop.send(());
        self.task.await.unwrap().unwrap();
    }
}

/// The address of a port that is one.
fn tcp(address: &ListenAddress) -> SocketAddr {
    address.to_string().parse().unwrap()
}

/// A vehicle that drives north at 10 m/s for two seconds, past a wall 20 m east.
pub fn drive(id: Uuid, lat_deg: f64, lon_deg: f64) -> Vec<UploadRequest> {
    let rows = 21;
    let poses = PoseColumns {
        time_offset_us: (0..rows).map(|i| i * 100_000).collect(),
        latitude_deg: (0..rows).map(|i| lat_deg + i as f64 / 111_132.0).collect(),
        longitude_deg: vec![lon_deg; rows as usize],
        yaw_rad: vec![std::f64::consts::FRAC_PI_2; rows as usize],
        sigma_position_m: vec![0.1; rows as usize],
        sigma_yaw_rad: vec![0.001; rows as usize],
    };
    // The wall's points at right angles, ahead and behind: all stationary by their radial speed.
    let azimuths = [-1.2_f32, -1.5, -1.8];
    let scans = Scans {
        sensor: vec![0; rows as usize],
        time_offset_us: poses.time_offset_us.clone(),
        detection_count: vec![azimuths.len() as u32; rows as usize],
        range_m: (0..rows).flat_map(|_| azimuths.map(|a| 20.0 / -a.sin())).collect(),
        azimuth_rad: (0..rows).flat_map(|_| azimuths).collect(),
        radial_speed_mps: (0..rows).flat_map(|_| azimuths.map(|a| -10.0 * a.cos())).collect(),
        ..Scans::default()
    };
    vec![header(id), chunk(UploadChunk { poses: Some(poses), scans: Some(scans) })]
}

pub fn header(id: Uuid) -> UploadRequest {
    let header = UploadHeader {
        upload_id: id.to_string(),
        contributor: "car-7".to_owned(),
        reference_time_us: NOON_US,
        mounts: vec![SensorMount::default()],
        ..UploadHeader::default()
    };
    UploadRequest { part: Some(Part::Header(header)) }
}

pub fn chunk(chunk: UploadChunk) -> UploadRequest {
    UploadRequest { part: Some(Part::Chunk(chunk)) }
}

/// The header of an upload, to be changed.
pub fn header_of(messages: &mut [UploadRequest]) -> &mut UploadHeader {
    match messages[0].part.as_mut() {
        Some(Part::Header(header)) => header,
        _ => panic!("the first message is the header"),
    }
}

/// The poses and scans of an upload, to be changed.
pub fn chunk_of(messages: &mut [UploadRequest]) -> (&mut PoseColumns, &mut Scans) {
    match messages[1].part.as_mut() {
        Some(Part::Chunk(chunk)) => (chunk.poses.as_mut().unwrap(), chunk.scans.as_mut().unwrap()),
        _ => panic!("the second message is a chunk"),
    }
}
