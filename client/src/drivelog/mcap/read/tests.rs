use super::*;
use crate::drivelog;
use crate::testing::T0;
use echofix_core::odometry::Trajectory;
use echofix_core::scan::Scan;

/// Puts messages into a log of ours, or of others.
fn write_log(
    path: &Path,
    compression: Option<mcap::Compression>,
    ours: bool,
    put: impl FnOnce(&mut TestLog),
) {
    let options = mcap::WriteOptions::new().compression(compression).chunk_size(Some(1 << 16));
    let mut writer = options.create(io::BufWriter::new(File::create(path).unwrap())).unwrap();
    if ours {
        let metadata = [("vehicle", "v"), ("sensor.0", "1 0 0")].map(|(k, v)| (k.to_owned(), v.to_owned()));
        let (name, metadata) = (topic::DRIVE.to_owned(), BTreeMap::from(metadata));
        writer.write_metadata(&mcap::records::Metadata { name, metadata }).unwrap();
    }
    put(&mut TestLog { writer: &mut writer, channels: HashMap::new() });
    writer.finish().unwrap();
}

struct TestLog<'a> {
    writer: &'a mut mcap::Writer<io::BufWriter<File>>,
    channels: HashMap<&'static str, u16>,
}

impl TestLog<'_> {
    fn put(&mut self, topic: &'static str, data: &[u8]) {
        let writer = &mut *self.writer;
        let channel_id = *self.channels.entry(topic).or_insert_with(|| {
            let schema = writer.add_schema("some.Type", "protobuf", &[1]).unwrap();
            writer.add_channel(schema, topic, "protobuf", &BTreeMap::new()).unwrap()
        });
        let header = mcap::records::MessageHeader { channel_id, sequence: 0, log_time: 0, publish_time: 0 };
        self.writer.write_to_known_channel(&header, data).unwrap();
    }

    fn put_drive(&mut self, drive: &Drive) {
        for scan in &drive.scans {
            self.put(topic::SCANS, &messages::scan(scan).encode_to_vec());
        }
        for (time_us, pose) in drive.odometry.iter() {
            self.put(topic::ODOMETRY, &messages::odometry(time_us, pose).encode_to_vec());
        }
    }
}

/// Catches: a log that another recorder packed, or that holds images, and is called damaged.
#[test]
fn logs_of_other_recorders_are_read_however_packed() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("d.mcap");
    let image = vec![7; 70_000_000];
    for compression in [None, Some(mcap::Compression::Lz4), Some(mcap::Compression::Zstd)] {
        write_log(&path, compression, true, |log| {
            log.put("/camera/image", &image);
            log.put_drive(&small());
            log.put("/camera/image", &image[..100]);
        });
        let log = drivelog::read(&path).unwrap();
        assert!(log.flaws.is_empty(), "{compression:?}: {}", log.flaws);
        assert_eq!((log.drive.scans, log.drive.odometry), (small().scans, small().odometry));
    }
}

/// Catches: one bad message that ends the drive, or is dropped without a word.
#[test]
fn bad_messages_are_skipped_and_told() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("d.mcap");
    write_log(&path, Some(mcap::Compression::Lz4), true, |log| {
        let bad = Scan { range_m: vec![f32::NAN; 3], azimuth_rad: vec![0.0; 3], ..small().scans[5].clone() };
        let torn = Scan { range_m: vec![1.0; 3], azimuth_rad: vec![0.0; 2], ..Scan::default() };
        let foreign = Scan { sensor: 3, time_us: T0, ..Scan::default() };
        log.put(topic::SCANS, b"garbage");
        log.put_drive(&small());
        for scan in [&bad, &torn, &foreign, &small().scans[2]] {
            log.put(topic::SCANS, &messages::scan(scan).encode_to_vec());
        }
        let late = messages::odometry(T0 - 86_400_000_000, Pose2::IDENTITY);
        let nowhere = messages::odometry(T0 + 1, Pose2::new(f64::NAN, 0.0, 0.0));
        let off =
            GeoPose { at: echofix_core::geo::LatLon { lat_deg: 200.0, lon_deg: 11.0 }, ..GeoPose::default() };
        log.put(topic::ODOMETRY, &late.encode_to_vec());
        log.put(topic::ODOMETRY, &nowhere.encode_to_vec());
        log.put(topic::REFERENCE, &messages::geodetic(&off).encode_to_vec());
        log.put(topic::SCANS, &vec![0; 20 << 20]);
    });
    let DriveLog { drive, flaws } = drivelog::read(&path).unwrap();
    let sizes: Vec<_> = drive.scans.iter().filter(|scan| !scan.is_empty()).map(Scan::len).collect();
    assert_eq!((sizes, drive.odometry.len(), drive.reference.len()), (vec![200; 20], 20, 0), "{flaws}");
    for (reason, count) in [
        ("unreadable", 2),
        ("not_finite", 4),
        ("incomplete", 1),
        ("unknown_sensor", 1),
        ("doubled", 1),
        ("out_of_order", 1),
        ("out_of_range", 1),
    ] {
        assert_eq!(flaws.count(reason), count, "{reason}: {flaws}");
    }
    assert!(flaws.to_string().contains("the first at /radar/scans:1: it does not decode"), "{flaws}");
}

/// Catches: a log of another recorder that is refused without saying what is missing, and how it is imported.
#[test]
fn a_log_without_metadata_says_what_to_do() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("foreign.mcap");
    write_log(&path, None, false, |log| log.put("/lidar/points", b"x"));
    let told = drivelog::read(&path).unwrap_err().to_string();
    for words in ["echofix.drive", "/lidar/points (some.Type)", "mcap add metadata", "scans.csv"] {
        assert!(told.contains(words), "{told}");
    }
}

/// Catches: radars that are missing in the metadata, all of whose scans are then called unknown, and numbers that are told apart by
/// more than one blank.
#[test]
fn the_metadata_says_where_every_radar_sits() {
    let of = |pairs: &[(&str, &str)]| {
        let pairs = pairs.iter().map(|(key, value)| ((*key).to_owned(), (*value).to_owned()));
        mounts(&pairs.collect(), true)
    };
    let two = of(&[("vehicle", "v"), ("sensor.0", "1  2 0.5"), ("sensor.1", "1, 2,\t0.5 ")]).unwrap();
    assert_eq!(two, vec![Mount::new(1.0, 2.0, 0.5); 2]);
    for (missing, pairs) in [
        ("`sensor.0`", &[("vehicle", "v")][..]),
        ("`sensor.0`", &[("sensor.1", "1 2 0")]),
        ("`sensor.1`", &[("sensor.0", "1 2 0"), ("sensor.2", "1 2 0")]),
        ("`left`", &[("sensor.0", "left")]),
    ] {
        let told = of(pairs).unwrap_err();
        assert!(told.contains(missing), "{told}");
    }
}

fn small() -> Drive {
    let scan = |i: i64| Scan {
        time_us: T0 + i * 50_000,
        range_m: vec![i as f32; 200],
        azimuth_rad: vec![0.5; 200],
        ..Scan::default()
    };
    let odometry = Trajectory::new((0..20).map(|i| (T0 + i * 50_000, Pose2::IDENTITY))).unwrap();
    let (vehicle, mounts) = ("v".to_owned(), vec![Mount::IDENTITY]);
    Drive { vehicle, mounts, scans: (0..20).map(scan).collect(), odometry, ..Drive::default() }
}

#[test]
fn damage_is_told_and_never_a_panic() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("d.mcap");
    drivelog::write(&path, &small()).unwrap();
    let good = std::fs::read(&path).unwrap();
    for cut in (0..good.len()).step_by(97) {
        std::fs::write(&path, &good[..cut]).unwrap();
        match drivelog::read(&path) {
            Ok(log) => {
                assert!(log.flaws.count("cut_off") == 1 || log.drive == small(), "{cut}: {}", log.flaws);
            }
            Err(error) => assert!(error.to_string().contains("d.mcap"), "{error}"),
        }
    }
    for at in (0..good.len()).step_by(13) {
        let mut bad = good.clone();
        bad[at] ^= 0x20;
        std::fs::write(&path, &bad).unwrap();
        if let Ok(log) = drivelog::read(&path) {
            // A flip outside the chunks may go unseen; the measurements are checksummed.
            assert!(log.drive.scans.len() == 20 || !log.flaws.is_empty(), "{at}");
        }
    }
}

#[test]
fn schemas_travel_with_the_log() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("d.mcap");
    drivelog::write(&path, &small()).unwrap();
    let bytes = std::fs::read(&path).unwrap();
    let summary = mcap::Summary::read(&bytes).unwrap().unwrap();
    let mut names: Vec<_> = summary.schemas.values().map(|s| s.name.clone()).collect();
    names.sort();
    let log = |name: &str| format!("echofix.log.v1.{name}");
    let expected =
        [log("GeodeticPose"), log("OdometryPose"), log("RadarScan"), "foxglove.LocationFix".into()];
    assert_eq!(names, expected);
    assert!(summary.schemas.values().all(|s| s.encoding == "protobuf" && !s.data.is_empty()));
    assert_eq!(summary.stats.unwrap().message_count, 40);
}
