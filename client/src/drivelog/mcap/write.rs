//! Writing a drive to MCAP.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::BufWriter;
use std::path::Path;

use echofix_core::drive::Drive;
use mcap::records::{MessageHeader, Metadata};
use mcap::{Compression, McapError, McapResult, WriteOptions, Writer};
use prost::Message;

use super::super::error::{Error, io_error};
use super::super::{DriveEvent, replay};
use super::{messages, schema, topic};

const LOG: &str = "echofix/log/v1/drive.proto";
const FIX: &str = "foxglove/location_fix.proto";

pub(in super::super) fn write(path: &Path, drive: &Drive) -> Result<(), Error> {
    let part = path.with_extension("mcap.part");
    let file = File::create(&part).map_err(|e| io_error(&part, e))?;
    LogWriter::start(file, drive).and_then(|log| log.fill(drive)).map_err(|error| match error {
        McapError::Io(source) => io_error(&part, source),
        other => Error::Unwritable(other.to_string()),
    })?;
    std::fs::rename(&part, path).map_err(|e| io_error(path, e))
}

struct LogWriter {
    writer: Writer<BufWriter<File>>,
    scans: u16,
    odometry: u16,
    /// Channels of the pose and of its fix.
    reference: [u16; 2],
    truth: [u16; 2],
}

impl LogWriter {
    fn start(file: File, drive: &Drive) -> McapResult<Self> {
        let options = WriteOptions::new().compression(Some(Compression::Zstd)).profile("echofix");
        let mut writer = options.create(BufWriter::new(file))?;
        writer.write_metadata(&metadata(drive))?;
        let mut schema = |name: &str, file: &str| -> McapResult<u16> {
            let definition = schema::of_file(file).map_err(std::io::Error::other)?;
            writer.add_schema(name, "protobuf", &definition)
        };
        let scan = schema("echofix.log.v1.RadarScan", LOG)?;
        let odometry = schema("echofix.log.v1.OdometryPose", LOG)?;
        let pose = schema("echofix.log.v1.GeodeticPose", LOG)?;
        let fix = schema("foxglove.LocationFix", FIX)?;
        let mut channel =
            |schema: u16, topic: &str| writer.add_channel(schema, topic, "protobuf", &BTreeMap::new());
        let scans = channel(scan, topic::SCANS)?;
        let odometry = channel(odometry, topic::ODOMETRY)?;
        let reference = [channel(pose, topic::REFERENCE)?, channel(fix, topic::REFERENCE_FIX)?];
        let truth = [channel(pose, topic::TRUTH)?, channel(fix, topic::TRUTH_FIX)?];
        Ok(Self { writer, scans, odometry, reference, truth })
    }

    fn fill(mut self, drive: &Drive) -> McapResult<()> {
        for event in replay(drive) {
            let time_us = event.time_us();
            match event {
                DriveEvent::Scan(scan) => self.put(self.scans, time_us, &messages::scan(scan))?,
                DriveEvent::Odometry(_, pose) => {
                    self.put(self.odometry, time_us, &messages::odometry(time_us, pose))?;
                }
                DriveEvent::Reference(pose) | DriveEvent::Truth(pose) => {
                    let is_truth = matches!(event, DriveEvent::Truth(_));
                    let [exact, fix] = if is_truth { self.truth } else { self.reference };
                    self.put(exact, time_us, &messages::geodetic(pose))?;
                    self.put(fix, time_us, &messages::location_fix(pose))?;
                }
            }
        }
        self.writer.finish()?;
        let file = self.writer.into_inner().into_inner().map_err(std::io::IntoInnerError::into_error)?;
        Ok(file.sync_all()?)
    }

    fn put(&mut self, channel_id: u16, time_us: i64, message: &impl Message) -> McapResult<()> {
        // MCAP counts nanoseconds from the epoch; the message itself holds the exact time.
        let log_time = u64::try_from(time_us).unwrap_or(0).saturating_mul(1000);
        let header = MessageHeader { channel_id, sequence: 0, log_time, publish_time: log_time };
        self.writer.write_to_known_channel(&header, &message.encode_to_vec())
    }
}

fn metadata(drive: &Drive) -> Metadata {
    let mut metadata = BTreeMap::from([("vehicle".to_owned(), drive.vehicle.clone())]);
    for (i, mount) in drive.mounts.iter().enumerate() {
        metadata.insert(format!("sensor.{i}"), format!("{} {} {}", mount.x_m, mount.y_m, mount.yaw_rad));
    }
    Metadata { name: topic::DRIVE.to_owned(), metadata }
}
