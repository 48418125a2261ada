use super::*;
use crate::testing::{T0, decode};

fn poses() -> Vec<GeoPose> {
    (0..101).map(|i| GeoPose { time_us: T0 + i * 100_000, ..GeoPose::default() }).collect()
}

fn scan(time_us: i64, detections: usize) -> Scan {
    let azimuth_rad = (0..detections).map(|i| i as f32 * 1e-4).collect();
    Scan { time_us, range_m: vec![5.0; detections], azimuth_rad, ..Scan::default() }
}

fn upload(scans: &[Scan]) -> PreparedUpload {
    let mut upload = PreparedUpload::start("car", &[Mount::IDENTITY], T0);
    upload.add(&poses(), scans);
    upload
}

/// Catches: a drive that is mapped twice and counts twice, another that counts as the first, and ids out of the drive's order.
#[test]
fn an_id_follows_from_contributor_and_content() {
    let identified = |contributor: &str, range_m: f32, number: u64| {
        let mut upload = PreparedUpload::start(contributor, &[Mount::IDENTITY], T0);
        upload.add(&poses(), &[Scan { range_m: vec![range_m; 5], ..scan(T0 + 10, 5) }]);
        upload.identify(number);
        assert_eq!(upload.header().unwrap().upload_id, upload.id().to_string());
        upload.id()
    };
    let id = identified("car", 5.0, 3);
    assert_eq!(id, identified("car", 5.0, 3));
    assert_eq!((id.get_version_num(), id.get_variant()), (8, uuid::Variant::RFC4122));
    assert!(id != identified("bus", 5.0, 3) && id != identified("car", 6.0, 3));
    assert!(id < identified("car", 1.0, 4) && id > identified("car", 9.0, 2));
}

#[test]
fn chunks_are_small_cover_their_scans_and_lose_nothing() {
    let scans: Vec<_> = (0..100).map(|i| scan(T0 + i * 100_000 + 50_000, 1000)).collect();
    let upload = upload(&scans);
    assert_eq!(upload.detections(), 100_000);
    assert!(upload.chunks().count() >= 6);
    let mut again = Vec::new();
    for chunk in upload.chunks() {
        assert!(chunk.encoded_len() < 64 << 10);
        let poses = decode::poses(chunk.poses.as_ref().unwrap(), T0);
        let scans = decode::scans(chunk.scans.as_ref().unwrap(), T0);
        assert!(poses[0].time_us <= scans[0].time_us);
        assert!(poses.last().unwrap().time_us >= scans.last().unwrap().time_us);
        assert!(poses.len() <= scans.len() + 1, "poses that no scan needs");
        again.extend(scans);
    }
    assert_eq!(again, scans);
}

#[test]
fn a_huge_scan_is_cut() {
    let huge = scan(T0 + 1_050_000, 40_000);
    let upload = upload(std::slice::from_ref(&huge));
    assert_eq!((upload.chunks().count(), upload.detections()), (20, 40_000));
    let azimuths: Vec<f32> =
        upload.chunks().flat_map(|c| c.scans.as_ref().unwrap().azimuth_rad.clone()).collect();
    assert_eq!(azimuths, huge.azimuth_rad);
}

#[test]
fn a_lone_scan_on_a_pose_still_has_two_poses() {
    for time_us in [T0, T0 + 100_000, T0 + 10_000_000] {
        let upload = upload(&[scan(time_us, 1)]);
        let chunk = upload.chunks().next().unwrap();
        assert_eq!(chunk.poses.as_ref().unwrap().yaw_rad.len(), 2, "{time_us}");
    }
}

#[test]
fn bytes_come_back_as_the_same_upload() {
    let upload = upload(&[scan(T0 + 10, 20)]);
    let bytes = upload.encode();
    assert_eq!(PreparedUpload::decode(&bytes), Ok(upload));
    assert!(PreparedUpload::decode(&bytes[..bytes.len() - 1]).is_err());
    assert!(PreparedUpload::decode(&[]).is_err());
}

/// Catches: a file of 16 MB of nothing, which would decode to gigabytes.
#[test]
fn messages_of_nothing_are_no_upload() {
    let upload = upload(&[scan(T0 + 10, 20)]);
    let refused = |more: &[u8], times: usize| {
        let bytes = [upload.encode(), more.repeat(times)].concat();
        PreparedUpload::decode(&bytes).unwrap_err().to_string()
    };
    assert_eq!(refused(&[0], 1 << 24), "not an upload: a message is empty");
    let empty = v1::UploadRequest { part: Some(Part::Evidence(v1::EvidenceChunk::default())) };
    let more = refused(&empty.encode_length_delimited_to_vec(), MAX_PARTS);
    assert_eq!(more, "not an upload: it has more messages than any upload");
}
