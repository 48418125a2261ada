//! Reading a drive from MCAP.

use std::collections::{BTreeMap, HashMap};
use std::fs::File;
use std::io;
use std::path::Path;

use echofix_core::drive::{Drive, GeoPose};
use echofix_core::odometry::Trajectory;
use echofix_core::pose::Pose2;
use echofix_core::scan::{self, Mount, Scan};
use mcap::records::Record;
use prost::Message;

use super::super::error::{Error, apart_m, check_pose, io_error, is_nowhere};
use super::super::jumps::without_jumps;
use super::super::order::in_order;
use super::super::scans::ReadScans;
use super::super::{DriveLog, Flaws, Problem};
use super::messages::{self, log};
use super::records::{self, Records};
use super::topic;

pub(in super::super) fn read(path: &Path) -> Result<DriveLog, Error> {
    let file = File::open(path).map_err(|e| io_error(path, e))?;
    let mut log = LogReader::default();
    records::read(file, &mut log).map_err(|e| match e.kind() {
        io::ErrorKind::InvalidData => Error::NotADriveLog { path: path.to_owned() },
        _ => io_error(path, e),
    })?;
    log.finish(path)
}

/// What has been read so far.
#[derive(Default)]
struct LogReader {
    schemas: HashMap<u16, String>,
    channels: HashMap<u16, Channel>,
    metadata: Option<BTreeMap<String, String>>,
    /// With the number of each message in its topic.
    scans: Vec<(Scan, u64)>,
    odometry: Vec<(i64, u64, Pose2)>,
    reference: Vec<(i64, u64, GeoPose)>,
    truth: Vec<(i64, u64, GeoPose)>,
    flaws: Flaws,
}

struct Channel {
    topic: String,
    schema: u16,
    messages: u64,
}

impl Records for LogReader {
    fn record(&mut self, opcode: u8, data: &[u8]) -> Result<(), Problem> {
        match mcap::parse_record(opcode, data).map_err(|e| Problem::Unparsable(e.to_string()))? {
            Record::Schema { header, .. } => {
                self.schemas.insert(header.id, header.name);
            }
            Record::Channel(channel) => {
                let (topic, schema) = (channel.topic, channel.schema_id);
                self.channels.entry(channel.id).or_insert(Channel { topic, schema, messages: 0 });
            }
            Record::Metadata(record) if record.name == topic::DRIVE => self.metadata = Some(record.metadata),
            _ => {}
        }
        Ok(())
    }

    fn wants(&self, channel: u16) -> bool {
        let read = [topic::SCANS, topic::ODOMETRY, topic::REFERENCE, topic::TRUTH];
        self.channels.get(&channel).is_some_and(|channel| read.contains(&&*channel.topic))
    }

    fn message(&mut self, channel: u16, data: Result<&[u8], u64>) {
        let Some(channel) = self.channels.get_mut(&channel) else { return };
        channel.messages += 1;
        let (topic, number) = (channel.topic.clone(), channel.messages);
        let taken = match data {
            Ok(data) => self.take(&topic, number, data),
            Err(bytes) => Err(Problem::TooLarge { bytes }),
        };
        if let Err(problem) = taken {
            self.flaws.skip(&topic, number, &problem);
        }
    }

    fn flaw(&mut self, at: u64, problem: &Problem) {
        self.flaws.skip("byte", at, problem);
    }
}

impl LogReader {
    fn take(&mut self, topic: &str, number: u64, data: &[u8]) -> Result<(), Problem> {
        match topic {
            topic::SCANS => {
                let scan = messages::scan_from(log::RadarScan::decode(data)?);
                // Single detections are looked at later.
                if let Err(error @ scan::Error::ColumnLength { .. }) = scan.validate() {
                    return Err(error.into());
                }
                self.scans.push((scan, number));
            }
            topic::ODOMETRY => {
                let (time_us, pose) = messages::odometry_from(&log::OdometryPose::decode(data)?);
                if !pose.is_finite() {
                    return Err(Problem::NotFinite);
                }
                self.odometry.push((time_us, number, pose));
            }
            topic::REFERENCE => self.reference.push(geodetic(number, data)?),
            topic::TRUTH => self.truth.push(geodetic(number, data)?),
            _ => {}
        }
        Ok(())
    }

    fn finish(mut self, path: &Path) -> Result<DriveLog, Error> {
        let Some(metadata) = self.metadata.take() else { return Err(self.without_metadata(path)) };
        let mounts = mounts(&metadata, !self.scans.is_empty())
            .map_err(|problem| Error::NotADrive { path: path.to_owned(), problem })?;
        let mut flaws = self.flaws;
        let sensors = mounts.len();
        self.scans.retain(|(scan, number)| {
            let known = scan.sensor < sensors;
            if !known {
                let problem = Problem::UnknownSensor { sensor: scan.sensor, sensors };
                flaws.skip(topic::SCANS, *number, &problem);
            }
            known
        });
        let mut odometry = Trajectory::default();
        let poses = in_order(self.odometry, topic::ODOMETRY, &mut flaws);
        let metres = |a: &Pose2, b: &Pose2| a.distance_m(b);
        for (time_us, pose) in without_jumps(poses, topic::ODOMETRY, &mut flaws, metres, |_| false) {
            let unusable = |problem: Problem| Error::Unusable { path: path.to_owned(), problem };
            odometry.push(time_us, pose).map_err(|e| unusable(e.into()))?;
        }
        let mut poses = |poses, topic| -> Vec<GeoPose> {
            let poses = in_order(poses, topic, &mut flaws);
            let kept = without_jumps(poses, topic, &mut flaws, apart_m, is_nowhere);
            kept.into_iter().map(|(_, pose)| pose).collect()
        };
        let (reference, truth) = (poses(self.reference, topic::REFERENCE), poses(self.truth, topic::TRUTH));
        let scans = ReadScans { part: topic::SCANS, scans: self.scans }.finish(&mut flaws);
        if scans.is_empty() && odometry.is_empty() && flaws.total() > 0 {
            return Err(Error::Damaged { path: path.to_owned(), problem: flaws.to_string() });
        }
        let vehicle = metadata.get("vehicle").cloned().unwrap_or_default();
        Ok(DriveLog { drive: Drive { vehicle, mounts, scans, odometry, reference, truth }, flaws })
    }

    /// What to do with a log that is not ours.
    fn without_metadata(&self, path: &Path) -> Error {
        let path = path.to_owned();
        if self.channels.is_empty() && self.flaws.total() > 0 {
            return Error::Damaged { path, problem: self.flaws.to_string() };
        }
        let mut topics: Vec<_> = self
            .channels
            .values()
            .map(|Channel { topic, schema, .. }| {
                format!("{topic} ({})", self.schemas.get(schema).map_or("no schema", String::as_str))
            })
            .collect();
        topics.sort();
        let holds = if topics.is_empty() { "nothing".to_owned() } else { topics.join(", ") };
        Error::NotADrive {
            path,
            problem: format!(
                "it has no metadata record `{}`, which names the vehicle and where its radars sit. The log holds {holds}. \
                 If it holds {}, {} and {} as Echofix writes them, add the record: `mcap add metadata FILE --name {} --key \
                 vehicle=NAME --key \"sensor.0=X_M Y_M YAW_RAD\"`. Other messages must be converted: write a folder with \
                 sensors.csv, scans.csv, odometry.csv and reference.csv, whose columns docs/drivelog.md describes",
                topic::DRIVE,
                topic::SCANS,
                topic::ODOMETRY,
                topic::REFERENCE,
                topic::DRIVE
            ),
        }
    }
}

fn geodetic(number: u64, data: &[u8]) -> Result<(i64, u64, GeoPose), Problem> {
    let pose = messages::geodetic_from(&log::GeodeticPose::decode(data)?);
    check_pose(&pose)?;
    Ok((pose.time_us, number, pose))
}

/// The radars, of which there must be some where there are scans.
fn mounts(metadata: &BTreeMap<String, String>, are_needed: bool) -> Result<Vec<Mount>, String> {
    let texts: Vec<_> = (0..).map_while(|i| metadata.get(&format!("sensor.{i}"))).collect();
    let named = metadata.keys().filter(|key| key.starts_with("sensor.")).count();
    if texts.len() < named.max(usize::from(are_needed)) {
        return Err(format!(
            "the metadata record `{}` has no `sensor.{}`; radars count from 0, each with `x_m y_m yaw_rad`",
            topic::DRIVE,
            texts.len()
        ));
    }
    let mount = |(i, text): (usize, &String)| {
        parse_mount(text).ok_or_else(|| {
            format!("`sensor.{i}` is `{text}`; expected x_m, y_m and yaw_rad with spaces between")
        })
    };
    texts.into_iter().enumerate().map(mount).collect()
}

fn parse_mount(text: &str) -> Option<Mount> {
    let texts = text.split(|c: char| c.is_whitespace() || c == ',').filter(|text| !text.is_empty());
    let mut numbers = texts.map(|n| n.parse::<f64>().ok().filter(|v| v.is_finite()));
    let (x, y, yaw) = (numbers.next()??, numbers.next()??, numbers.next()??);
    numbers.next().is_none().then(|| Pose2::new(x, y, yaw))
}

#[cfg(test)]
mod tests;
