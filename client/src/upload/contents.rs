//! One upload: a part of a drive under one id.

use echofix_core::convention::Finding;
use echofix_core::drive::GeoPose;
use echofix_core::evidence::{EvidenceDelta, codec};
use echofix_core::gate::Dropped;
use echofix_core::geo::{LatLon, RoutingRegion};
use echofix_core::scan::{Mount, Scan};
use echofix_core::tile::DecodeError;
use echofix_core::time::DAY_US;
use echofix_proto::v1;
use echofix_proto::v1::upload_request::Part;
use prost::Message;
use uuid::Uuid;

use crate::{routing, wire};

/// Detections in a chunk, at most: some 20 kB. A chunk must cross within the time the service waits for
/// a silent caller, on slow networks, too.
const CHUNK_DETECTIONS: usize = 2048;
/// Bytes of evidence in a chunk, at most.
const CHUNK_BYTES: usize = 16 << 10;
/// Messages of an upload that is read, at most: empty ones take a hundred times their bytes.
const MAX_PARTS: usize = 16_384;
/// Bytes of an upload's evidence, unpacked, at most: several times what the service takes.
const MAX_EVIDENCE: usize = 64 << 20;

/// The name space of ids that follow from contents.
const CONTENT: Uuid = Uuid::from_u128(0x8d0c_27e4_5b1f_4a6e_9c37_60f2_a1d4_53be);

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
        // Until it is identified by what it holds.
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

    /// Gives it the id that follows from who contributes it and what it holds: the same part of the same drive is the same upload,
    /// however often it is recorded, and counts once. `number` counts the parts of the drive.
    ///
    /// The id is a UUID of version 8: the day's beginning in milliseconds and the number, so that the order of ids stays the order
    /// of the drive, then 62 bits of a hash. Nothing but the day can be read from it.
    pub(crate) fn identify(&mut self, number: u64) {
        let Some(header) = self.header() else { return };
        let reference_time_us = header.reference_time_us;
        let content = v1::UploadHeader { upload_id: String::new(), ..header.clone() };
        let rest = self.parts[1..].iter().flat_map(Message::encode_length_delimited_to_vec);
        let bytes: Vec<u8> = content.encode_length_delimited_to_vec().into_iter().chain(rest).collect();
        let mut id = *Uuid::new_v5(&CONTENT, &bytes).as_bytes();
        let day_ms = (reference_time_us - reference_time_us.rem_euclid(DAY_US)).max(0) / 1000;
        id[..6].copy_from_slice(&day_ms.to_be_bytes()[2..]);
        id[6..8].copy_from_slice(&(number.min(0xfff) as u16).to_be_bytes());
        self.id = Uuid::new_v8(id);
        let id = self.id.to_string();
        if let Some(header) = self.header_mut() {
            header.upload_id = id;
        }
    }

    /// Says what the vehicle left out of it, that it has looked at its own data, and what it suspects of them.
    pub(crate) fn tell(&mut self, dropped: &Dropped, findings: &[Finding]) {
        if let Some(header) = self.header_mut() {
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

    fn header_mut(&mut self) -> Option<&mut v1::UploadHeader> {
        match self.parts.first_mut()?.part.as_mut()? {
            Part::Header(header) => Some(header),
            Part::Chunk(_) | Part::Evidence(_) => None,
        }
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

    /// The region where most of its evidence lies, or a raw one's first pose; `None` where nothing says it.
    pub(crate) fn region(&self) -> Option<RoutingRegion> {
        let poses = self.chunks().find_map(|chunk| chunk.poses.as_ref());
        let first =
            poses.and_then(|poses| Some((*poses.latitude_deg.first()?, *poses.longitude_deg.first()?)));
        if let Some((lat_deg, lon_deg)) = first {
            return routing::region_at(LatLon { lat_deg, lon_deg });
        }
        let delta = self.evidence().ok()?;
        routing::region_of_most(delta.tiles.iter().map(|(id, tile)| (*id, tile.detections())))
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
mod tests;
