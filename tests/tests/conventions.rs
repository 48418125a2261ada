//! Drives in other conventions than the contract's: the service refuses them, and asks for the convention.

use std::f64::consts::FRAC_PI_2;

use echofix_client::wire;
use echofix_core::convention::Convention;
use echofix_core::doppler::sensor_velocity;
use echofix_core::drive::Drive;
use echofix_core::scan::Scan;
use echofix_harness::questions::{DriveQuestions, QuestionPlan};
use echofix_harness::recording::{record, to_the_ends};
use echofix_proto::v1::upload_request::Part;
use echofix_proto::v1::{FixStatus, LocalizeRequest, Scans, UploadChunk, UploadHeader, UploadRequest};
use echofix_tests::service::Service;
use echofix_tests::world::World;
use echofix_tests::{grpc, mapping};
use tokio::sync::OnceCell;
use uuid::Uuid;

async fn world() -> &'static World {
    static WORLD: OnceCell<World> = OnceCell::const_new();
    WORLD.get_or_init(World::mapped).await
}

type Spoil = fn(&mut Drive);

fn each_scan(drive: &mut Drive, change: impl Fn(&mut Scan)) {
    drive.scans.iter_mut().for_each(change);
}

/// The radars' conventions of the contract, broken.
const RADAR: [(Convention, Spoil); 5] = [
    (Convention::RadialSpeedTowards, |drive| {
        each_scan(drive, |scan| scan.radial_speed_mps.iter_mut().for_each(|v| *v = -*v));
    }),
    (Convention::RadialSpeedKmh, |drive| {
        each_scan(drive, |scan| scan.radial_speed_mps.iter_mut().for_each(|v| *v *= 3.6));
    }),
    (Convention::RadialSpeedCompensated, |drive| {
        let (odometry, mounts) = (drive.odometry.clone(), drive.mounts.clone());
        each_scan(drive, |scan| {
            let velocity = odometry.velocity_at(scan.time_us).unwrap_or_default();
            let [vx, vy] = sensor_velocity(&mounts[scan.sensor], velocity);
            for (speed, azimuth) in scan.radial_speed_mps.iter_mut().zip(&scan.azimuth_rad) {
                let (s, c) = f64::from(*azimuth).sin_cos();
                *speed += (vx * c + vy * s) as f32;
            }
        });
    }),
    (Convention::AzimuthClockwise, |drive| {
        each_scan(drive, |scan| scan.azimuth_rad.iter_mut().for_each(|a| *a = -*a));
    }),
    (Convention::AzimuthDegrees, |drive| {
        each_scan(drive, |scan| scan.azimuth_rad.iter_mut().for_each(|a| *a = a.to_degrees()));
    }),
];

/// A part of a drive as another maker's vehicle would send it: all scans, with their radial speeds.
fn raw_upload(drive: &Drive) -> Vec<UploadRequest> {
    let reference_time_us = drive.reference[0].time_us;
    let header = UploadHeader {
        upload_id: Uuid::now_v7().to_string(),
        contributor: "another maker's".to_owned(),
        reference_time_us,
        mounts: drive.mounts.iter().map(wire::mount).collect(),
        ..UploadHeader::default()
    };
    let poses = &drive.reference[..drive.reference.len().min(400)];
    let within = |scan: &&Scan| (poses[0].time_us..=poses[poses.len() - 1].time_us).contains(&scan.time_us);
    let chunk = UploadChunk {
        poses: Some(wire::poses(poses, reference_time_us)),
        scans: Some(with_speeds(drive.scans.iter().filter(within), reference_time_us)),
    };
    [Part::Header(header), Part::Chunk(chunk)].map(|part| UploadRequest { part: Some(part) }).into()
}

fn with_speeds<'a>(scans: impl Iterator<Item = &'a Scan> + Clone, reference_time_us: i64) -> Scans {
    let radial_speed_mps = scans.clone().flat_map(|scan| &scan.radial_speed_mps).copied().collect();
    Scans { radial_speed_mps, ..wire::scans(scans, reference_time_us) }
}

/// Catches an upload in another convention that is counted, or refused without asking for it: of another maker's scans,
/// and of the library's evidence, which holds hits only.
#[tokio::test(flavor = "multi_thread")]
async fn uploads_in_another_convention_are_refused_and_asked_for_it() {
    let world = world().await;
    let service = Service::start();
    let mut client = grpc::mapping(&service).await;
    for (convention, spoil) in RADAR {
        let mut drive = world.visit(150.0);
        spoil(&mut drive);
        let status = mapping::send(&mut client, &raw_upload(&drive)).await.expect_err("it is refused");
        assert!(["MOSTLY_MOVING", "WRONG_CONVENTION"].contains(&&*grpc::reason(&status)), "{status:?}");
        assert!(status.message().contains(convention.question()), "{convention:?}: {}", status.message());
        let recorded = record(&drive, to_the_ends()).unwrap();
        let told = recorded.findings.iter().any(|finding| finding.suspects().contains(&convention));
        assert!(told, "{convention:?}: {:?}", recorded.findings);
        for upload in recorded.uploads.iter().skip(1) {
            let Err(status) = mapping::send(&mut client, upload.parts()).await else {
                panic!("{convention:?}: {:?} was counted", upload.header());
            };
            assert_eq!(grpc::reason(&status), "MOSTLY_MOVING");
            assert!(status.message().contains(convention.question()), "{convention:?}: {}", status.message());
        }
    }
    // What is right still counts.
    let drive = world.visit(150.0);
    mapping::send(&mut client, &raw_upload(&drive)).await.expect("it counts");
    assert!(record(&drive, to_the_ends()).unwrap().findings.is_empty());
}

/// Catches reference poses in another convention that make a map of nothing.
#[tokio::test(flavor = "multi_thread")]
async fn a_yaw_from_north_and_exchanged_coordinates_are_refused_and_asked_for() {
    let world = world().await;
    let service = Service::start();
    let mut client = grpc::mapping(&service).await;
    let mut north = world.visit(150.0);
    north.reference.iter_mut().for_each(|pose| pose.yaw_rad = FRAC_PI_2 - pose.yaw_rad);
    let status = mapping::send(&mut client, &raw_upload(&north)).await.expect_err("it is refused");
    assert!(status.message().contains(Convention::YawFromNorth.question()), "{}", status.message());
    // The library looks at it itself, and builds nothing.
    let recorded = record(&north, to_the_ends()).unwrap();
    assert!(recorded.uploads.is_empty(), "{} uploads", recorded.uploads.len());
    assert!(recorded.findings[0].suspects().contains(&Convention::YawFromNorth), "{:?}", recorded.findings);
    let mut swapped = world.visit(150.0);
    for pose in &mut swapped.reference {
        (pose.at.lat_deg, pose.at.lon_deg) = (pose.at.lon_deg, pose.at.lat_deg);
    }
    let status = mapping::send(&mut client, &raw_upload(&swapped)).await.expect_err("it is refused");
    assert_eq!(grpc::field(&status), "chunk.poses.latitude_deg[0]");
    assert!(status.message().contains(Convention::LatLonSwapped.question()), "{}", status.message());
}

/// What the service says of a question that it does not answer, in words.
async fn told(service: &Service, request: LocalizeRequest) -> String {
    match grpc::localizing(service).await.localize(request).await {
        Ok(answer) => {
            let answer = answer.into_inner();
            assert_ne!(answer.status(), FixStatus::Usable, "{answer:?}");
            answer.status_reason
        }
        Err(status) => status.message().to_owned(),
    }
}

/// Catches a batch in another convention that is told as a lack of structure, and nothing else.
#[tokio::test(flavor = "multi_thread")]
async fn batches_in_another_convention_are_asked_for_it() {
    let world = world().await;
    for (convention, spoil) in RADAR {
        let mut drive = world.visit(150.0);
        let sound = world.questions(150.0, 1.0).remove(3).request;
        spoil(&mut drive);
        // Another maker's: all detections, with their radial speeds.
        let mut request = sound.clone();
        let batch = request.batch.as_mut().unwrap();
        let reference_time_us = batch.reference_time_us;
        let window = reference_time_us - 5_000_000..=reference_time_us;
        let scans = drive.scans.iter().filter(|scan| window.contains(&scan.time_us));
        batch.scans = Some(with_speeds(scans, reference_time_us));
        batch.dropped = None;
        let text = told(&world.service, request).await;
        assert!(text.contains(convention.question()), "{convention:?}: {text}");
        // The library's own.
        let plan = QuestionPlan::every(1.0, world.seed);
        match DriveQuestions::of(&drive, &plan) {
            Ok(asked) => {
                let text =
                    told(&world.service, asked.questions.last().unwrap().question.request.clone()).await;
                assert!(text.contains(convention.question()), "{convention:?}: {text}");
            }
            Err(error) => {
                assert!(error.to_string().contains(convention.question()), "{convention:?}: {error}");
            }
        }
    }
}

/// Catches a prior in another convention that is told as nothing but wrong.
#[tokio::test(flavor = "multi_thread")]
async fn priors_in_another_convention_are_asked_for_it() {
    let world = world().await;
    let sound = world.questions(150.0, 1.0).remove(3).request;
    let spoiled = |change: fn(&mut echofix_proto::v1::GeodeticPose)| {
        let mut request = sound.clone();
        change(request.prior.as_mut().unwrap().pose.as_mut().unwrap());
        request
    };
    let swap = |pose: &mut echofix_proto::v1::GeodeticPose| {
        (pose.latitude_deg, pose.longitude_deg) = (pose.longitude_deg, pose.latitude_deg);
    };
    let text = told(&world.service, spoiled(swap)).await;
    assert!(text.contains(Convention::LatLonSwapped.question()), "{text}");
    let text = told(&world.service, spoiled(|pose| pose.yaw_rad = FRAC_PI_2 - pose.yaw_rad)).await;
    assert!(text.contains(Convention::YawFromNorth.question()), "{text}");
}
