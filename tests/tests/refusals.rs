//! What cannot be answered is refused, typed, over the real socket; and the service goes on.

#![expect(clippy::unwrap_used, reason = "helpers of tests are tests")]

use std::time::Duration;

use echofix_client::refusal::{CallError, RefusalReason};
use echofix_core::pose::wrap_angle;
use echofix_proto::v1::localization_service_client::LocalizationServiceClient;
use echofix_proto::v1::upload_request::Part;
use echofix_proto::v1::{FixStatus, GeodeticPose, LocalizeRequest, Odometry, Scans, UploadRequest};
use echofix_tests::service::Service;
use echofix_tests::world::World;
use echofix_tests::{grpc, mapping};
use tokio::sync::OnceCell;
use tonic::Status;
use tonic::transport::Channel;

async fn world() -> &'static World {
    static WORLD: OnceCell<World> = OnceCell::const_new();
    WORLD.get_or_init(World::mapped).await
}

type Client = LocalizationServiceClient<Channel>;
type Spoil = fn(&mut LocalizeRequest);
type SpoilUpload = fn(&mut Vec<UploadRequest>);

async fn refusal(client: &mut Client, request: LocalizeRequest) -> Status {
    client.localize(request).await.expect_err("the question is refused")
}

/// The sound question still has its answer.
async fn still_answers(client: &mut Client, sound: &LocalizeRequest) {
    let answer = client.localize(sound.clone()).await.expect("the service still answers").into_inner();
    assert_ne!(answer.status(), FixStatus::Unspecified);
}

fn pose(request: &mut LocalizeRequest) -> &mut GeodeticPose {
    request.prior.as_mut().unwrap().pose.as_mut().unwrap()
}

fn scans(request: &mut LocalizeRequest) -> &mut Scans {
    request.batch.as_mut().unwrap().scans.as_mut().unwrap()
}

/// Catches a refusal that comes as the wrong code, without details, as an empty answer, or not at all.
#[tokio::test(flavor = "multi_thread")]
async fn what_cannot_be_answered_is_refused_with_its_reason() {
    let world = world().await;
    let sound = world.questions(120.0, 1.0).remove(0).request;
    let mut client = grpc::localizing(&world.service).await;
    let spoils: [(&str, Spoil); 10] = [
        // Ten thousand kilometres around the globe.
        ("NO_MAP", |r| {
            pose(r).longitude_deg = wrap_angle((pose(r).longitude_deg + 104.0).to_radians()).to_degrees();
        }),
        ("NO_MAP", |r| pose(r).latitude_deg += 0.01),
        ("TOO_SLOW", |r| slower(r, 0.0)),
        ("TOO_SLOW", |r| slower(r, 0.05)),
        ("NO_DETECTIONS", |r| {
            let scans = scans(r);
            scans.detection_count.fill(0);
            for column in
                [&mut scans.range_m, &mut scans.azimuth_rad, &mut scans.radial_speed_mps, &mut scans.rcs_dbsm]
            {
                column.clear();
            }
        }),
        ("TOO_FEW_DETECTIONS", |r| scans(r).range_m.fill(51.0)),
        ("TOO_FEW_DETECTIONS", |r| {
            let detections = scans(r).range_m.len();
            scans(r).radial_speed_mps = vec![30.0; detections];
        }),
        ("PRIOR_TOO_UNCERTAIN", |r| r.prior.as_mut().unwrap().sigma_position_m = 5.1),
        ("PRIOR_TOO_UNCERTAIN", |r| r.prior.as_mut().unwrap().sigma_yaw_rad = 0.2),
        ("OUTSIDE_UTM", |r| pose(r).latitude_deg = 84.5),
    ];
    for (row, (reason, spoil)) in spoils.into_iter().enumerate() {
        let mut request = sound.clone();
        spoil(&mut request);
        let status = refusal(&mut client, request).await;
        assert_eq!(grpc::reason(&status), reason, "row {row}: {status:?}");
        let CallError::Refused { reason: typed, .. } = CallError::from(&status) else { panic!("{status:?}") };
        assert_ne!(typed, RefusalReason::Other(reason.to_owned()), "the vehicle library knows every reason");
        still_answers(&mut client, &sound).await;
    }
}

/// The odometry shrunk: the same scans, taken at a fraction of the speed.
fn slower(request: &mut LocalizeRequest, by: f64) {
    let odometry = request.batch.as_mut().unwrap().odometry.as_mut().unwrap();
    odometry.x_m.iter_mut().chain(&mut odometry.y_m).for_each(|m| *m *= by);
}

/// Catches a value that reaches the arithmetic unchecked, or a refusal that does not name its field.
#[tokio::test(flavor = "multi_thread")]
async fn what_is_malformed_is_refused_with_its_field() {
    let world = world().await;
    let sound = world.questions(120.0, 1.0).remove(0).request;
    let mut client = grpc::localizing(&world.service).await;
    let spoils: [(&str, Spoil); 20] = [
        ("batch", |r| r.batch = None),
        ("batch.scans", |r| r.batch.as_mut().unwrap().scans = None),
        ("batch.scans.sensor", |r| *scans(r) = Scans::default()),
        ("batch.mounts", |r| r.batch.as_mut().unwrap().mounts.clear()),
        ("batch.mounts[1]", |r| r.batch.as_mut().unwrap().mounts[1].x_m = f32::NAN),
        ("batch.reference_time_us", |r| r.batch.as_mut().unwrap().reference_time_us = i64::MIN),
        ("batch.scans.range_m", |r| scans(r).range_m[3] = f32::NAN),
        ("batch.scans.range_m", |r| scans(r).range_m[3] = -1.0),
        ("batch.scans.azimuth_rad", |r| scans(r).azimuth_rad[3] = f32::INFINITY),
        ("batch.scans.azimuth_rad", |r| scans(r).azimuth_rad.truncate(9)),
        ("batch.scans.radial_speed_mps", |r| scans(r).radial_speed_mps = vec![1.0; 3]),
        ("batch.scans.detection_count", |r| scans(r).detection_count[0] = u32::MAX),
        ("batch.scans.time_offset_us", |r| scans(r).time_offset_us.truncate(9)),
        ("batch.scans.sensor[0]", |r| scans(r).sensor[0] = 3),
        ("batch.odometry.x_m[0]", |r| r.batch.as_mut().unwrap().odometry.as_mut().unwrap().x_m[0] = f64::NAN),
        ("batch.odometry", |r| r.batch.as_mut().unwrap().odometry = Some(Odometry::default())),
        ("prior", |r| r.prior = None),
        ("prior.pose.latitude_deg", |r| pose(r).latitude_deg = 91.0),
        ("prior.pose.yaw_rad", |r| pose(r).yaw_rad = f64::NAN),
        ("prior.sigma_position_m", |r| r.prior.as_mut().unwrap().sigma_position_m = f64::NAN),
    ];
    for (row, (field, spoil)) in spoils.into_iter().enumerate() {
        let mut request = sound.clone();
        spoil(&mut request);
        let status = refusal(&mut client, request).await;
        assert_eq!(grpc::field(&status), field, "row {row}: {status:?}");
    }
    still_answers(&mut client, &sound).await;
}

/// Catches a service that has no map yet and breaks, or answers from nothing.
#[tokio::test(flavor = "multi_thread")]
async fn a_service_without_any_map_says_so() {
    let world = world().await;
    let empty = Service::start();
    let sound = world.questions(120.0, 1.0).remove(0).request;
    let mut client = grpc::localizing(&empty).await;
    assert_eq!(grpc::reason(&refusal(&mut client, sound).await), "NO_MAP");
}

/// Catches a question that is answered long after its vehicle gave up: the deadline is the client's.
#[tokio::test(flavor = "multi_thread")]
async fn a_deadline_that_cannot_be_kept_is_an_error_not_a_late_answer() {
    let world = world().await;
    let sound = world.questions(120.0, 1.0).remove(0).request;
    let mut client = grpc::localizing(&world.service).await;
    let mut request = tonic::Request::new(sound.clone());
    request.set_timeout(Duration::from_micros(50));
    let error = CallError::from(&client.localize(request).await.expect_err("50 us are not enough"));
    assert_eq!(error, CallError::Deadline);
    still_answers(&mut client, &sound).await;
}

/// Catches an upload that is counted although it is malformed or cannot be used.
#[tokio::test(flavor = "multi_thread")]
async fn uploads_that_cannot_be_used_are_refused_and_change_nothing() {
    let world = world().await;
    let service = Service::start();
    let upload = mapping::scan_uploads(&world.visit(150.0)).remove(0);
    let mut client = grpc::mapping(&service).await;
    let fields: [(&str, SpoilUpload); 8] = [
        ("header", |parts| drop(parts.remove(0))),
        ("header", |parts| parts.push(parts[0].clone())),
        ("chunk", |parts| parts.truncate(1)),
        ("part", |parts| parts.push(UploadRequest { part: None })),
        ("header.upload_id", |parts| header(parts).upload_id = "mine".to_owned()),
        ("header.contributor", |parts| header(parts).contributor.clear()),
        ("chunk.scans.sensor[0]", |parts| chunk(parts).scans.as_mut().unwrap().sensor[0] = 99),
        ("chunk.poses.latitude_deg[0]", |parts| {
            chunk(parts).poses.as_mut().unwrap().latitude_deg[0] = f64::NAN;
        }),
    ];
    for (row, (field, spoil)) in fields.into_iter().enumerate() {
        let mut parts = upload.parts().to_vec();
        spoil(&mut parts);
        let status = mapping::send(&mut client, &parts).await.expect_err("the upload is refused");
        assert_eq!(grpc::field(&status), field, "row {row}: {status:?}");
    }
    let reasons: [(&str, SpoilUpload); 4] = [
        ("POSE_TOO_UNCERTAIN", |parts| each_pose(parts, |poses| poses.sigma_position_m.fill(0.5))),
        ("TOO_SLOW", |parts| {
            each_pose(parts, |poses| {
                let (lat, lon) = (poses.latitude_deg[0], poses.longitude_deg[0]);
                poses.latitude_deg.fill(lat);
                poses.longitude_deg.fill(lon);
            });
        }),
        ("NO_DETECTIONS", |parts| {
            for part in parts {
                if let Some(Part::Chunk(chunk)) = &mut part.part {
                    chunk.scans.as_mut().unwrap().range_m.fill(60.0);
                }
            }
        }),
        ("OUTSIDE_UTM", |parts| {
            each_pose(parts, |poses| poses.latitude_deg.iter_mut().for_each(|lat| *lat += 55.0));
        }),
    ];
    for (reason, spoil) in reasons {
        let mut parts = upload.parts().to_vec();
        spoil(&mut parts);
        let status = mapping::send(&mut client, &parts).await.expect_err("the upload is refused");
        assert_eq!(grpc::reason(&status), reason, "{status:?}");
    }
    assert_eq!(mapping::folded(&service).await, 0);
    let counted = mapping::send(&mut client, upload.parts()).await.expect("the sound upload counts");
    assert!(!counted.duplicate && counted.epoch == 1, "no refusal has used its id up: {counted:?}");
}

fn header(parts: &mut [UploadRequest]) -> &mut echofix_proto::v1::UploadHeader {
    match &mut parts[0].part {
        Some(Part::Header(header)) => header,
        other => panic!("{other:?} is no header"),
    }
}

fn chunk(parts: &mut [UploadRequest]) -> &mut echofix_proto::v1::UploadChunk {
    match &mut parts[1].part {
        Some(Part::Chunk(chunk)) => chunk,
        other => panic!("{other:?} is no chunk"),
    }
}

fn each_pose(parts: &mut [UploadRequest], spoil: impl Fn(&mut echofix_proto::v1::PoseColumns)) {
    for part in parts {
        if let Some(Part::Chunk(chunk)) = &mut part.part {
            spoil(chunk.poses.as_mut().unwrap());
        }
    }
}
