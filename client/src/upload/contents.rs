//! One upload: a part of a drive under one id.

use echofix_core::convention::Finding;
use echofix_core::drive::GeoPose;
use echofix_core::evidence::{EvidenceDelta, codec};
use echofix_core::gate::Dropped;
use echofix_core::scan::{Mount, Scan};
use echofix_core::tile::DecodeError;
use echofix_proto::v1;
use echofix_proto::v1::upload_request::Part;
use prost::Message;
use uuid::Uuid;

use crate::wire;

/// Detections in a chunk, at most: some 20 kB. A chunk must cross within the time the service waits for
/// a silent caller, on slow networks, too.
const CHUNK_DETECTIONS: usize = 2048;
/// Bytes of evidence in a chunk, at most.
const CHUNK_BYTES: usize = 16 << 10;
/// Messages of an upload that is read, at most: empty ones take a hundred times their bytes.
const MAX_PARTS: usize = 16_384;
/// Bytes of an upload's evidence, unpacked, at most: several times what the service takes.
const MAX_EVIDENCE: usize = 64 << 20;

/// Bytes that are not an upload.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("not an upload: {0}")]
pub struct DamagedUpload(pub(super) &'static str);

/// A part of a drive, ready to be sent; its id never changes.
#[derive(Debug, Clone, PartialEq)]
pub struct PreparedUpload {
    id: Uuid,
    parts: Vec<v1::UploadRequest>,
}

impl PreparedUpload {
    /// An upload under a fresh id, without chunks yet.
    pub(crate) fn start(contributor: &str, mounts: &[Mount], reference_time_us: i64) -> Self {
        // Version 7 ids sort by time: the spool's order is the order of the drive.
        let id = Uuid::now_v7();
        let header = v1::UploadHeader {
            upload_id: id.to_string(),
            contributor: contributor.to_owned(),
            reference_time_us,
            mounts: mounts.iter().map(wire::mount).collect(),
            ..v1::UploadHeader::default()
        };
        Self { id, parts: vec![v1::UploadRequest { part: Some(Part::Header(header)) }] }
    }

    /// Adds scans and the poses they were taken from, both oldest first and the scans within the
    /// poses' time, as one chunk or several.
    pub(crate) fn add(&mut self, poses: &[GeoPose], scans: &[Scan]) {
        let reference_time_us = self.header().map_or(0, |h| h.reference_time_us);
        let mut pieces = scans.iter().flat_map(pieces).peekable();
        while pieces.peek().is_some() {
            let mut detections = 0;
            let mut chunk = Vec::new();
            while let Some(piece) =
                pieces.next_if(|p| chunk.is_empty() || detections + p.len() <= CHUNK_DETECTIONS)
            {
                detections += piece.len();
                chunk.push(piece);
            }
            let (Some(first), Some(last)) = (chunk.first(), chunk.last()) else { return };
            let poses = covering(poses, first.time_us, last.time_us);
            let chunk = v1::UploadChunk {
                poses: Some(wire::poses(poses, reference_time_us)),
                scans: Some(wire::scans(&chunk, reference_time_us)),
            };
            self.parts.push(v1::UploadRequest { part: Some(Part::Chunk(chunk)) });
        }
    }

    /// Adds the evidence that the vehicle has built; `sigmas` are the largest of the poses it was mapped from
    /// (metres, radians).
    pub(crate) fn add_evidence(&mut self, delta: &EvidenceDelta, sigmas: [f64; 2]) {
        let bytes = codec::encode(delta);
        let [sigma_position_m, sigma_yaw_rad] = sigmas.map(|sigma| sigma as f32);
        for piece in bytes.chunks(CHUNK_BYTES) {
            let chunk = v1::EvidenceChunk { contribution: piece.to_vec(), sigma_position_m, sigma_yaw_rad };
            self.parts.push(v1::UploadRequest { part: Some(Part::Evidence(chunk)) });
        }
    }

    /// Says what the vehicle left out of it, that it has looked at its own data, and what it suspects of them.
    pub(crate) fn tell(&mut self, dropped: &Dropped, findings: &[Finding]) {
        if let Some(Part::Header(header)) = self.parts.first_mut().and_then(|first| first.part.as_mut()) {
            header.dropped = (dropped.total() > 0).then(|| wire::dropped(dropped));
            header.suspected = wire::suspected(findings);
            header.inspected = true;
        }
    }

    /// The id.
    #[must_use]
    pub fn id(&self) -> Uuid {
        self.id
    }

    /// The messages of the upload: a header, then the chunks.
    #[must_use]
    pub fn parts(&self) -> &[v1::UploadRequest] {
        &self.parts
    }

    /// The messages of the upload, to be sent.
    #[must_use]
    pub fn into_parts(self) -> Vec<v1::UploadRequest> {
        self.parts
    }

    /// What all chunks have in common.
    #[must_use]
    pub fn header(&self) -> Option<&v1::UploadHeader> {
        match self.parts.first()?.part.as_ref()? {
            Part::Header(header) => Some(header),
            Part::Chunk(_) | Part::Evidence(_) => None,
        }
    }

    /// The chunks.
    pub fn chunks(&self) -> impl Iterator<Item = &v1::UploadChunk> {
        self.parts.iter().filter_map(|request| match request.part.as_ref()? {
            Part::Chunk(chunk) => Some(chunk),
            Part::Header(_) | Part::Evidence(_) => None,
        })
    }

    /// The evidence, of one that has any.
    ///
    /// # Errors
    /// When its bytes are not an evidence delta's.
    pub fn evidence(&self) -> Result<EvidenceDelta, DecodeError> {
        codec::decode(&self.evidence_bytes(), MAX_EVIDENCE)
    }

    fn evidence_bytes(&self) -> Vec<u8> {
        let piece = |request: &v1::UploadRequest| match request.part.as_ref()? {
            Part::Evidence(chunk) => Some(chunk.contribution.clone()),
            Part::Header(_) | Part::Chunk(_) => None,
        };
        self.parts.iter().filter_map(piece).flatten().collect()
    }

    /// Detections in all of it.
    #[must_use]
    pub fn detections(&self) -> usize {
        let scans: usize =
            self.chunks().filter_map(|chunk| chunk.scans.as_ref()).map(|scans| scans.range_m.len()).sum();
        let evidence = codec::decode_header(&self.evidence_bytes()).map_or(0, |head| head.detections);
        scans + evidence as usize
    }

    /// Bytes on the wire, without gRPC's own framing.
    #[must_use]
    pub fn bytes(&self) -> usize {
        self.parts.iter().map(Message::encoded_len).sum()
    }

    /// The messages, each preceded by its length.
    pub(super) fn encode(&self) -> Vec<u8> {
        self.parts.iter().flat_map(Message::encode_length_delimited_to_vec).collect()
    }

    pub(super) fn decode(mut bytes: &[u8]) -> Result<Self, DamagedUpload> {
        let mut parts = Vec::new();
        while !bytes.is_empty() {
            let part = v1::UploadRequest::decode_length_delimited(&mut bytes);
            let part = part.map_err(|_| DamagedUpload("a message does not decode"))?;
            if part.part.is_none() {
                return Err(DamagedUpload("a message is empty"));
            }
            if parts.len() == MAX_PARTS {
                return Err(DamagedUpload("it has more messages than any upload"));
            }
            parts.push(part);
        }
        let upload = Self { id: Uuid::nil(), parts };
        let header = upload.header().ok_or(DamagedUpload("it does not begin with a header"))?;
        let id = Uuid::parse_str(&header.upload_id).map_err(|_| DamagedUpload("its id is not a UUID"))?;
        Ok(Self { id, ..upload })
    }
}

/// The geometry of a scan, split where it would not fit a chunk.
fn pieces(scan: &Scan) -> impl Iterator<Item = Scan> + '_ {
    let cut = |column: &[f32], at: usize| -> Vec<f32> {
        column.chunks(CHUNK_DETECTIONS).nth(at).unwrap_or_default().to_vec()
    };
    (0..scan.len().div_ceil(CHUNK_DETECTIONS)).map(move |at| Scan {
        sensor: scan.sensor,
        time_us: scan.time_us,
        range_m: cut(&scan.range_m, at),
        azimuth_rad: cut(&scan.azimuth_rad, at),
        ..Scan::default()
    })
}

/// The poses needed to interpolate between two times.
fn covering(poses: &[GeoPose], from_us: i64, to_us: i64) -> &[GeoPose] {
    let from = poses.partition_point(|p| p.time_us <= from_us).saturating_sub(1);
    let to = poses.partition_point(|p| p.time_us < to_us).saturating_add(1).min(poses.len());
    // One pose alone gives no velocity.
    let from = from.min(to.saturating_sub(2));
    &poses[from..to.max(from + 2).min(poses.len())]
}

#[cfg(test)]
mod tests {
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
}
