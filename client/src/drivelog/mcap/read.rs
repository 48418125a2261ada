//! Reading a drive from MCAP.

use std::collections::{BTreeMap, HashMap};
use std::fs::File;
use std::io::{BufReader, Read};
use std::path::{Path, PathBuf};

use echofix_core::drive::{Drive, GeoPose};
use echofix_core::pose::Pose2;
use echofix_core::scan::Mount;
use mcap::McapError;
use mcap::records::{Record, op};
use mcap::sans_io::linear_reader::{LinearReadEvent, LinearReader, LinearReaderOptions};
use prost::Message;

use super::super::Problem;
use super::super::error::{Error, io_error, is_finite};
use super::messages::{self, log};
use super::topic;

/// A record, packed or not, that is larger than this is damage and no measurement; room is made for what a record says it
/// takes.
const MAX_RECORD: usize = 16 << 20;

pub(in super::super) fn read(path: &Path) -> Result<Drive, Error> {
    let mut file = BufReader::new(File::open(path).map_err(|e| io_error(path, e))?);
    let options =
        LinearReaderOptions::default().with_prevalidate_chunk_crcs(true).with_record_length_limit(MAX_RECORD);
    let mut reader = LinearReader::new_with_options(options);
    let mut log = LogReader::new(path);
    while let Some(event) = reader.next_event() {
        match event.map_err(|e| log.damaged(e))? {
            LinearReadEvent::ReadRequest(need) => {
                let read = file.read(reader.insert(need)).map_err(|e| io_error(path, e))?;
                reader.notify_read(read);
            }
            LinearReadEvent::Record { opcode, data } => log.record(opcode, data)?,
        }
    }
    log.finish()
}

/// What has been read so far.
struct LogReader {
    path: PathBuf,
    topics: HashMap<u16, String>,
    counts: HashMap<u16, u64>,
    metadata: Option<BTreeMap<String, String>>,
    drive: Drive,
}

impl LogReader {
    fn new(path: &Path) -> Self {
        let (topics, counts) = (HashMap::new(), HashMap::new());
        Self { path: path.to_owned(), topics, counts, metadata: None, drive: Drive::default() }
    }

    fn record(&mut self, opcode: u8, data: &[u8]) -> Result<(), Error> {
        if ![op::CHANNEL, op::MESSAGE, op::METADATA].contains(&opcode) {
            return Ok(());
        }
        match mcap::parse_record(opcode, data).map_err(|e| self.damaged(e))? {
            Record::Channel(channel) => {
                self.topics.insert(channel.id, channel.topic);
            }
            Record::Metadata(record) if record.name == topic::DRIVE => self.metadata = Some(record.metadata),
            Record::Message { header, data } => {
                let number = self.counts.entry(header.channel_id).or_default();
                *number += 1;
                let number = *number;
                let topic = self.topics.get(&header.channel_id).cloned().unwrap_or_default();
                let path = self.path.clone();
                self.message(&topic, &data).map_err(|problem| Error::Message {
                    path,
                    topic,
                    number,
                    problem,
                })?;
            }
            _ => {}
        }
        Ok(())
    }

    fn message(&mut self, topic: &str, data: &[u8]) -> Result<(), Problem> {
        match topic {
            topic::SCANS => {
                let scan = messages::scan_from(decode::<log::RadarScan>(data)?);
                scan.validate()?;
                self.drive.scans.push(scan);
            }
            topic::ODOMETRY => {
                let (time_us, pose) = messages::odometry_from(&decode::<log::OdometryPose>(data)?);
                self.drive.odometry.push(time_us, pose)?;
            }
            topic::REFERENCE => self.drive.reference.push(geodetic(data)?),
            topic::TRUTH => self.drive.truth.push(geodetic(data)?),
            _ => {}
        }
        Ok(())
    }

    fn finish(self) -> Result<Drive, Error> {
        let not_a_drive = |problem: String| Error::NotADrive { path: self.path.clone(), problem };
        let metadata = self.metadata.as_ref().ok_or_else(|| {
            not_a_drive(format!("it has no metadata record `{}`; was it written by Echofix?", topic::DRIVE))
        })?;
        let mut drive = self.drive;
        drive.vehicle = metadata.get("vehicle").cloned().unwrap_or_default();
        while let Some(text) = metadata.get(&format!("sensor.{}", drive.mounts.len())) {
            let mount = parse_mount(text).ok_or_else(|| {
                let i = drive.mounts.len();
                not_a_drive(format!(
                    "`sensor.{i}` is `{text}`; expected x_m, y_m and yaw_rad with spaces between"
                ))
            })?;
            drive.mounts.push(mount);
        }
        match drive.scans.iter().find(|scan| scan.sensor >= drive.mounts.len()) {
            Some(scan) => Err(not_a_drive(format!(
                "the scan at {} us names sensor {}, but the metadata has {} sensors",
                scan.time_us,
                scan.sensor,
                drive.mounts.len()
            ))),
            None => Ok(drive),
        }
    }

    fn damaged(&self, source: McapError) -> Error {
        match source {
            McapError::BadMagic => Error::NotADriveLog { path: self.path.clone() },
            source => Error::Damaged { path: self.path.clone(), source },
        }
    }
}

fn decode<M: Message + Default>(data: &[u8]) -> Result<M, Problem> {
    Ok(M::decode(data)?)
}

fn geodetic(data: &[u8]) -> Result<GeoPose, Problem> {
    let pose = messages::geodetic_from(&decode::<log::GeodeticPose>(data)?);
    if is_finite(&pose) { Ok(pose) } else { Err(Problem::NotFinite) }
}

fn parse_mount(text: &str) -> Option<Mount> {
    let mut numbers = text.split(' ').map(|n| n.parse::<f64>().ok().filter(|v| v.is_finite()));
    let (x, y, yaw) = (numbers.next()??, numbers.next()??, numbers.next()??);
    numbers.next().is_none().then(|| Pose2::new(x, y, yaw))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::drivelog;
    use crate::testing::T0;
    use echofix_core::odometry::Trajectory;
    use echofix_core::scan::Scan;

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
            let error = drivelog::read(&path).unwrap_err();
            assert!(error.to_string().contains("d.mcap"), "{error}");
        }
        for at in (0..good.len()).step_by(13) {
            let mut bad = good.clone();
            bad[at] ^= 0x20;
            std::fs::write(&path, &bad).unwrap();
            if let Ok(drive) = drivelog::read(&path) {
                // A flip outside the chunks may go unseen; the measurements are checksummed.
                assert_eq!(drive.scans.len(), 20);
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
}
