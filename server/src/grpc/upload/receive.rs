//! The messages of an upload, bounded in bytes and detections. How slowly they may come is the port's to say.

use echofix_core::evidence::build::{Chunk, RawUpload};
use echofix_core::scan::Mount;
use echofix_core::time::{DAY_US, day_of};
use echofix_proto::v1::upload_request::Part;
use echofix_proto::v1::{EvidenceChunk, UploadChunk, UploadHeader, UploadRequest};
use prost::Message;
use tokio_stream::{Stream, StreamExt};
use tonic::{Code, Status};
use uuid::Uuid;

use super::evidence::Evidence;
use crate::grpc::access::Counted;
use crate::grpc::decode::Told;
use crate::grpc::invalid_field::{InvalidField, require, required};
use crate::grpc::{decode, now_us, status};
use crate::mapping::MappingConfig;

/// Scans of one upload, at most: some that hold no detections cost few bytes to send.
const MAX_SCANS: usize = 65_536;
/// Poses of one upload, at most.
const MAX_POSES: usize = 262_144;
/// Chunks of one upload, at most: each takes memory beyond what it holds.
const MAX_CHUNKS: usize = 16_384;

/// An upload whose columns are sound.
pub(super) struct ReceivedUpload {
    pub(super) id: Uuid,
    pub(super) contributor: String,
    pub(super) day: u16,
    /// What the vehicle says of its data itself.
    pub(super) told: Told,
    pub(super) body: UploadBody,
}

/// What an upload holds.
pub(super) enum UploadBody {
    Scans(RawUpload),
    Evidence(Evidence),
}

/// Reads and decodes all messages.
pub(super) async fn all(
    mut requests: impl Stream<Item = Result<UploadRequest, Status>> + Unpin,
    config: &MappingConfig,
    counted: &Counted,
) -> Result<ReceivedUpload, Status> {
    let invalid = |violation| status::invalid(&violation);
    let Some(Part::Header(mut header)) = next(&mut requests).await? else {
        return Err(invalid(InvalidField::new("header", "must be the first message")));
    };
    let caller = &counted.caller;
    let contributor = caller.contributor(&header.contributor);
    let contributor =
        contributor.map_err(|error| status::denied(Code::PermissionDenied, "NOT_THE_CONTRIBUTOR", error))?;
    if caller.is_known() {
        header.contributor.clone_from(&contributor);
    }
    let mut receiving = UploadReceiver::of(&header, config).map_err(invalid)?;
    counted.count_for(&contributor)?;
    header.contributor = contributor;
    while let Some(part) = next(&mut requests).await? {
        receiving.take(part).map_err(invalid)?;
    }
    receiving.finish(&header).map_err(invalid)
}

async fn next(
    requests: &mut (impl Stream<Item = Result<UploadRequest, Status>> + Unpin),
) -> Result<Option<Part>, Status> {
    let Some(request) = requests.next().await else { return Ok(None) };
    let part = required(request?.part, "part").map_err(|violation| status::invalid(&violation))?;
    Ok(Some(part))
}

/// An upload whose messages are still coming.
struct UploadReceiver<'a> {
    config: &'a MappingConfig,
    id: Uuid,
    reference_time_us: i64,
    mounts: Vec<Mount>,
    size: UploadSize,
    chunks: Vec<Chunk>,
    evidence: Evidence,
}

impl<'a> UploadReceiver<'a> {
    fn of(header: &UploadHeader, config: &'a MappingConfig) -> Result<Self, InvalidField> {
        let named = Uuid::try_parse(&header.upload_id);
        let id = named.map_err(|e| InvalidField::new("header.upload_id", format!("is not a UUID: {e}")))?;
        let length = header.contributor.chars().count();
        require((1..=64).contains(&length), "header.contributor", "must have 1 to 64 characters")?;
        decode::reference_time(header.reference_time_us, "header.reference_time_us")?;
        // The newest day of the map ages all of it.
        let rule = "lies more than a day in the future; check the vehicle's clock";
        require(header.reference_time_us - now_us() <= DAY_US, "header.reference_time_us", rule)?;
        let mounts = match &header.mounts[..] {
            [] => Vec::new(),
            mounts => decode::mounts(mounts, "header.mounts")?,
        };
        let (size, chunks, evidence) = (UploadSize::default(), Vec::new(), Evidence::default());
        Ok(Self { config, id, reference_time_us: header.reference_time_us, mounts, size, chunks, evidence })
    }

    fn take(&mut self, part: Part) -> Result<(), InvalidField> {
        match part {
            Part::Header(_) => Err(InvalidField::new("header", "must be the first message only")),
            Part::Chunk(chunk) => self.scans(chunk),
            Part::Evidence(chunk) => self.evidence(&chunk),
        }
    }

    fn scans(&mut self, chunk: UploadChunk) -> Result<(), InvalidField> {
        require(self.evidence.is_empty(), "chunk", "comes after evidence; send chunks of one kind")?;
        require(!self.mounts.is_empty(), "header.mounts", "is empty; send the mount of every radar")?;
        self.size.add(&chunk);
        self.size.check(self.config)?;
        let scans = required(chunk.scans, "chunk.scans")?;
        let poses = required(chunk.poses, "chunk.poses")?;
        same_day(&poses.time_offset_us, "chunk.poses.time_offset_us")?;
        same_day(&scans.time_offset_us, "chunk.scans.time_offset_us")?;
        let mounts = self.mounts.len();
        self.chunks.push(Chunk {
            poses: decode::geo_poses(&poses, self.reference_time_us, "chunk.poses")?,
            scans: decode::scans(scans, self.reference_time_us, mounts, "chunk.scans")?.split(),
        });
        Ok(())
    }

    fn evidence(&mut self, chunk: &EvidenceChunk) -> Result<(), InvalidField> {
        require(self.chunks.is_empty(), "evidence", "comes after scans; send chunks of one kind")?;
        self.size.bytes += chunk.encoded_len();
        self.size.chunks += 1;
        self.size.check(self.config)?;
        self.evidence.add(chunk)
    }

    fn finish(self, header: &UploadHeader) -> Result<ReceivedUpload, InvalidField> {
        let sent = !self.chunks.is_empty() || !self.evidence.is_empty();
        require(sent, "chunk", "is missing; send at least one")?;
        let day = day_of(self.reference_time_us);
        let body = if self.chunks.is_empty() {
            UploadBody::Evidence(self.evidence)
        } else {
            UploadBody::Scans(RawUpload { mounts: self.mounts, chunks: self.chunks })
        };
        let told = Told::of(header.dropped, &header.suspected).inspected(header.inspected);
        Ok(ReceivedUpload { id: self.id, contributor: header.contributor.clone(), day, told, body })
    }
}

/// What an upload holds so far.
#[derive(Debug, Default)]
struct UploadSize {
    bytes: usize,
    chunks: usize,
    scans: usize,
    poses: usize,
    detections: usize,
}

impl UploadSize {
    fn add(&mut self, chunk: &UploadChunk) {
        self.bytes += chunk.encoded_len();
        self.chunks += 1;
        self.scans += chunk.scans.as_ref().map_or(0, |scans| scans.sensor.len());
        self.poses += chunk.poses.as_ref().map_or(0, |poses| poses.time_offset_us.len());
        self.detections += chunk.scans.as_ref().map_or(0, |scans| scans.range_m.len());
    }

    fn check(&self, config: &MappingConfig) -> Result<(), InvalidField> {
        let limits = [
            ("chunk", self.bytes, config.max_upload_bytes, "bytes"),
            ("chunk", self.chunks, MAX_CHUNKS, "chunks"),
            ("chunk.scans", self.scans, MAX_SCANS, "scans"),
            ("chunk.poses", self.poses, MAX_POSES, "poses"),
            ("chunk.scans", self.detections, config.max_upload_detections, "detections"),
        ];
        limits.into_iter().try_for_each(|(field, found, most, what)| {
            require(found <= most, field, &format!("exceeds {most} {what} in all; split the upload"))
        })
    }
}

/// The votes of an upload count for the day of its reference time, so nothing in it may lie far off.
fn same_day(offsets_us: &[i64], field: &str) -> Result<(), InvalidField> {
    match offsets_us.iter().position(|offset| !(-DAY_US..=DAY_US).contains(offset)) {
        Some(row) => {
            let rule = "lies more than 24 h from the upload's reference time; split the upload";
            Err(InvalidField::new(format!("{field}[{row}]"), rule))
        }
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use echofix_proto::v1::{PoseColumns, Scans, SensorMount};

    use super::*;

    /// The field at fault once `count` such chunks were sent.
    fn refused(chunk: &UploadChunk, count: usize) -> Option<String> {
        let mut size = UploadSize::default();
        (0..count).for_each(|_| size.add(chunk));
        size.check(&MappingConfig::default()).err().map(|violation| violation.field)
    }

    #[test]
    fn scans_and_poses_are_counted_over_all_chunks() {
        let scans = Scans { sensor: vec![0; 16_384], ..Scans::default() };
        let scans = UploadChunk { scans: Some(scans), poses: None };
        assert_eq!(refused(&scans, 4), None);
        assert_eq!(refused(&scans, 5).unwrap(), "chunk.scans");
        let poses = PoseColumns { time_offset_us: vec![0; 65_536], ..PoseColumns::default() };
        let poses = UploadChunk { scans: None, poses: Some(poses) };
        assert_eq!(refused(&poses, 4), None);
        assert_eq!(refused(&poses, 5).unwrap(), "chunk.poses");
    }

    #[test]
    fn times_from_the_future_or_far_from_the_reference_are_named() {
        let after = |days: i64| {
            let header = UploadHeader {
                upload_id: Uuid::nil().to_string(),
                contributor: "car-7".to_owned(),
                reference_time_us: now_us() + days * DAY_US,
                mounts: vec![SensorMount::default()],
                ..UploadHeader::default()
            };
            UploadReceiver::of(&header, &MappingConfig::default()).map(|_| ())
        };
        assert!(after(-300).is_ok() && after(0).is_ok());
        assert!(after(1).is_ok());
        let violation = after(2).err().unwrap();
        assert_eq!(violation.field, "header.reference_time_us");
        assert!(violation.description.contains("clock"), "{violation}");
        assert!(same_day(&[-DAY_US, 0, DAY_US], "t").is_ok());
        assert_eq!(same_day(&[0, DAY_US + 1], "t").unwrap_err().field, "t[1]");
        assert_eq!(same_day(&[i64::MIN], "t").unwrap_err().field, "t[0]");
    }
}
