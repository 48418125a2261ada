//! A recorder on a straight drive east at 30 degrees north.

use super::*;
use crate::testing::{T0, decode};
use echofix_core::geo::LatLon;
use echofix_proto::v1;

const METRES_PER_DEGREE: f64 = 96_486.0;

fn pose(ms: i64, east_m: f64) -> GeoPose {
    GeoPose {
        time_us: T0 + ms * 1000,
        at: LatLon { lat_deg: 30.0, lon_deg: -97.0 + east_m / METRES_PER_DEGREE },
        yaw_rad: 0.0,
        sigma_position_m: 0.1,
        sigma_yaw_rad: 0.001,
    }
}

fn scan(ms: i64) -> Scan {
    let columns = || vec![10.0, 20.0];
    Scan { time_us: T0 + ms * 1000, range_m: columns(), azimuth_rad: vec![0.1, 0.2], ..Scan::default() }
}

/// Records a trip to its very ends.
fn whole() -> RecorderConfig {
    RecorderConfig { trim_ends_m: 0.0, ..RecorderConfig::default() }
}

fn recorder(config: RecorderConfig) -> Recorder {
    Recorder::new(RecorderConfig { form: UploadForm::Scans, ..config }, "car-1", vec![Mount::IDENTITY])
        .unwrap()
}

/// Poses every 0.1 s at 10 m/s, changed by `edit`, and a scan 50 ms after each.
fn record(recorder: &mut Recorder, tenths: i64, edit: impl Fn(i64, &mut GeoPose)) -> Vec<PreparedUpload> {
    let mut uploads = Vec::new();
    for i in 0..=tenths {
        let mut p = pose(i * 100, i as f64);
        edit(i, &mut p);
        uploads.extend(recorder.push_pose(p).unwrap());
        recorder.push_scan(scan(i * 100 + 50)).unwrap();
    }
    uploads
}

fn scan_times(uploads: &[PreparedUpload]) -> Vec<i64> {
    let mut times = Vec::new();
    for upload in uploads {
        let reference = upload.header().unwrap().reference_time_us;
        for chunk in upload.chunks() {
            let scans = decode::scans(chunk.scans.as_ref().unwrap(), reference);
            times.extend(scans.iter().map(|s| (s.time_us - T0) / 1000));
        }
    }
    times
}

#[test]
fn a_drive_becomes_uploads_that_hold_every_scan_once() {
    let mut r = recorder(RecorderConfig { cut_after_m: 1e9, ..whole() });
    let mut uploads = record(&mut r, 305, |_, _| ());
    assert_eq!(uploads.len(), 3, "30.5 s less the lateness, in pieces of 10 s");
    uploads.extend(r.finish().upload);
    let times = scan_times(&uploads);
    let expected: Vec<i64> = (0..305).map(|i| i * 100 + 50).collect();
    assert_eq!(times, expected, "the last scan is beyond the last pose");
    assert!(uploads.is_sorted_by_key(PreparedUpload::id));
    let header = uploads[0].header().unwrap();
    assert_eq!((header.contributor.as_str(), header.mounts.len()), ("car-1", 1));
    assert_eq!(header.upload_id, uploads[0].id().to_string());
}

#[test]
fn a_long_way_cuts_as_well() {
    let mut r = recorder(RecorderConfig { cut_after_m: 50.0, ..whole() });
    assert_eq!(record(&mut r, 200, |_, _| ()).len(), 3);
}

#[test]
fn scans_late_by_less_than_allowed_are_kept_and_later_ones_refused() {
    let mut r = recorder(RecorderConfig { cut_after_s: 1.0, ..whole() });
    let mut uploads = Vec::new();
    for i in 0..=30 {
        uploads.extend(r.push_pose(pose(i * 100, i as f64)).unwrap());
        if i >= 4 {
            r.push_scan(scan((i - 4) * 100)).unwrap();
        }
    }
    assert!(matches!(r.push_scan(scan(100)), Err(Error::TooLate { .. })));
    uploads.extend(r.finish().upload);
    assert_eq!(scan_times(&uploads), (0..=26).map(|i| i * 100).collect::<Vec<_>>());
}

#[test]
fn doubtful_poses_leave_a_hole_and_are_counted() {
    let mut r = recorder(whole());
    let mut uploads = record(&mut r, 90, |i, p| {
        if (30..40).contains(&i) {
            p.sigma_position_m = 0.5;
        }
    });
    assert_eq!(r.dropped().total(), 0, "nothing is cut before the end");
    let FinishedTrip { upload: last, dropped, .. } = r.finish();
    uploads.extend(last);
    let times = scan_times(&uploads);
    assert!(times.iter().all(|t| *t <= 2900 || *t >= 4000), "{times:?}");
    assert_eq!(uploads.iter().flat_map(PreparedUpload::chunks).count(), 2);
    // Catches: what the last upload leaves out, counted by nobody. Each scan has two detections.
    assert_eq!(dropped.without_pose, 2 * (91 - times.len() as u64), "{dropped:?}");
}

#[test]
fn standstill_is_not_recorded() {
    let mut r = recorder(whole());
    let mut uploads = Vec::new();
    for i in 0..300 {
        uploads.extend(r.push_pose(pose(i * 100, 0.0)).unwrap());
        r.push_scan(scan(i * 100 + 50)).unwrap();
    }
    assert!(uploads.is_empty());
    assert!(r.dropped().too_slow > 300, "{:?}", r.dropped());
    assert_eq!(r.finish().upload, None);
}

#[test]
fn odometry_tells_movers_where_poses_jitter() {
    let mut r = recorder(whole());
    for i in 0..=20 {
        // Poses jitter by 0.2 m; by their differences everything would move.
        let jitter = if i % 2 == 0 { 0.2 } else { -0.2 };
        r.push_pose(pose(i * 100, i as f64 + jitter)).unwrap();
        r.push_odometry(T0 + i * 100_000, Pose2::new(i as f64, 0.0, 0.0)).unwrap();
        let radial_speed_mps = vec![-10.0 * 0.1_f32.cos(), -2.0];
        r.push_scan(Scan { radial_speed_mps, ..scan(i * 100 + 50) }).unwrap();
    }
    let upload = r.finish().upload.unwrap();
    assert_eq!(upload.detections(), 20, "one of two in each of the 20 scans that poses cover");
}

#[test]
fn the_ends_of_a_trip_stay_private() {
    let mut r = recorder(RecorderConfig { trim_ends_m: 20.0, cut_after_s: 5.0, ..RecorderConfig::default() });
    let mut uploads = record(&mut r, 200, |_, _| ());
    uploads.extend(r.finish().upload);
    let times = scan_times(&uploads);
    assert!(times[0] >= 1950 && *times.last().unwrap() <= 18_050, "{:?}", (times[0], times.last()));
    assert!(times.len() > 150);
    for chunk in uploads.iter().flat_map(PreparedUpload::chunks) {
        let poses = chunk.poses.as_ref().unwrap();
        let east_m = |lon: &f64| (lon + 97.0) * METRES_PER_DEGREE;
        assert!(poses.longitude_deg.iter().map(east_m).all(|e| (19.9..=180.1).contains(&e)));
    }
}

/// Breaks when a vehicle that sets nothing shows where it was parked.
#[test]
fn the_ends_stay_private_unless_somebody_asks_for_them() {
    let mut r = recorder(RecorderConfig::default());
    assert!(record(&mut r, 95, |_, _| ()).is_empty(), "95 m from the start");
    let mut r = recorder(RecorderConfig::default());
    let mut uploads = record(&mut r, 400, |_, _| ());
    uploads.extend(r.finish().upload);
    let times = scan_times(&uploads);
    assert!(times[0] >= 9_950 && *times.last().unwrap() <= 30_050, "{:?}", (times[0], times.last()));
}

#[test]
fn a_parked_vehicle_has_arrived_and_holds_nothing_back() {
    let mut r = recorder(RecorderConfig { trim_ends_m: 20.0, ..RecorderConfig::default() });
    let mut uploads = record(&mut r, 200, |_, _| ());
    for i in 201..5000 {
        // Parked 200 m on, the receiver jittering by a decimetre.
        uploads.extend(r.push_pose(pose(i * 100, 200.0 + 0.1 * (i % 2) as f64)).unwrap());
        r.push_scan(scan(i * 100 + 50)).unwrap();
    }
    assert!(r.poses.len() < 10 && r.scans.len() < 10, "{} {}", r.poses.len(), r.scans.len());
    assert!(scan_times(&uploads).iter().all(|t| *t <= 18_050));
    assert_eq!(r.finish().upload, None);
}

#[test]
fn without_poses_scans_do_not_pile_up() {
    let mut r = recorder(whole());
    for i in 0..10_000 {
        r.push_scan(scan(i * 50)).unwrap();
    }
    assert!(r.scans.len() < 250, "{}", r.scans.len());
    assert!(r.dropped().without_pose > 19_000);
}

#[test]
fn what_cannot_be_recorded_is_refused() {
    assert!(matches!(Recorder::new(RecorderConfig::default(), "", vec![]), Err(Error::Contributor(_))));
    let mut r = recorder(whole());
    r.push_pose(pose(0, 0.0)).unwrap();
    assert!(matches!(r.push_pose(pose(0, 0.0)), Err(Error::TooLate { .. })));
    let nan = GeoPose { yaw_rad: f64::NAN, ..pose(1, 0.0) };
    assert!(matches!(r.push_pose(nan), Err(Error::NotAPose { .. })));
    let lost = GeoPose { at: LatLon { lat_deg: f64::NAN, lon_deg: 0.0 }, ..pose(1, 0.0) };
    assert!(matches!(r.push_pose(lost), Err(Error::OffTheMap(_))));
    assert!(matches!(r.push_scan(Scan { sensor: 1, ..scan(10) }), Err(Error::UnknownSensor { .. })));
}

/// Fails when evidence is built from other detections than the scans that would be sent, or shows more of the
/// trip than the day.
#[test]
fn evidence_is_what_the_scans_would_have_come_to() {
    let config = RecorderConfig { trim_ends_m: 20.0, ..RecorderConfig::default() };
    let mut scans = recorder(config);
    let mut evidence = Recorder::new(config, "car-1", vec![Mount::IDENTITY]).unwrap();
    let (mut sent, mut gathered) =
        (record(&mut scans, 300, |_, _| ()), record(&mut evidence, 300, |_, _| ()));
    sent.extend(scans.finish().upload);
    gathered.extend(evidence.finish().upload);
    assert_eq!(sent.len(), gathered.len());
    for (sent, gathered) in sent.iter().zip(&gathered) {
        let header = sent.header().unwrap();
        let chunk = |chunk: &v1::UploadChunk| Chunk {
            poses: decode::poses(chunk.poses.as_ref().unwrap(), header.reference_time_us),
            scans: decode::scans(chunk.scans.as_ref().unwrap(), header.reference_time_us),
        };
        let raw = RawUpload { mounts: vec![Mount::IDENTITY], chunks: sent.chunks().map(chunk).collect() };
        let expected = build_evidence(raw, &config.evidence()).unwrap().delta;
        assert_eq!(gathered.evidence().unwrap(), expected);
        assert_eq!(gathered.detections(), sent.detections());
        let header = gathered.header().unwrap();
        assert!(header.mounts.is_empty() && header.reference_time_us % DAY_US == 0);
    }
}

/// A trip of 10 s at 10 m/s past posts, changed by `edit`.
fn past_posts(form: UploadForm, edit: impl Fn(&mut GeoPose, &mut Scan)) -> FinishedTrip {
    let config = RecorderConfig { form, cut_after_m: 1e3, cut_after_s: 1e3, ..whole() };
    let mut recorder = Recorder::new(config, "car-1", vec![Mount::IDENTITY]).unwrap();
    for i in 0..=100 {
        let azimuth_rad: Vec<f32> = (0..20).map(|post| 0.1 * post as f32 - 1.0).collect();
        let radial_speed_mps = azimuth_rad.iter().map(|a| -10.0 * a.cos()).collect();
        let (mut pose, mut scan) = (pose(i * 100, i as f64), scan(i * 100));
        scan = Scan { range_m: vec![20.0; 20], azimuth_rad, radial_speed_mps, ..scan };
        edit(&mut pose, &mut scan);
        recorder.push_pose(pose).unwrap();
        recorder.push_scan(scan).unwrap();
    }
    recorder.finish()
}

/// Catches an upload that keeps to itself what was left out of it, and what is suspected.
#[test]
fn an_upload_tells_what_was_left_out_of_it() {
    for form in [UploadForm::Scans, UploadForm::Evidence] {
        let sound = past_posts(form, |_, _| ());
        assert_eq!((&sound.findings[..], sound.dropped.moving), (&[][..], 0));
        assert!(sound.upload.unwrap().header().unwrap().suspected.is_empty());
        // The sign is wrong but for two posts of twenty.
        let trip = past_posts(form, |_, scan| scan.radial_speed_mps[2..].iter_mut().for_each(|v| *v = -*v));
        let upload = trip.upload.unwrap();
        let header = upload.header().unwrap();
        assert_eq!(header.suspected, [v1::Convention::RadialSpeedTowards as i32]);
        assert_eq!(header.dropped.unwrap().moving, trip.dropped.moving);
        assert!(trip.dropped.moving > 1700, "{:?}", trip.dropped);
        assert!(
            trip.findings[0].to_string().contains("positive away from the sensor?"),
            "{:?}",
            trip.findings
        );
    }
}

/// Catches evidence that is built with a yaw across the direction of travel.
#[test]
fn a_yaw_from_north_builds_no_evidence_and_is_told() {
    let trip = past_posts(UploadForm::Evidence, |pose, scan| {
        pose.yaw_rad = std::f64::consts::FRAC_PI_2 - pose.yaw_rad;
        scan.radial_speed_mps.clear();
    });
    assert_eq!((trip.upload, trip.dropped.without_pose), (None, 101 * 20));
    let text = trip.findings[0].to_string();
    assert!(text.starts_with("the reference poses' yaw is 90 degrees off the direction of travel"), "{text}");
    assert!(text.contains("not clockwise from north?"), "{text}");
}
