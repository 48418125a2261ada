//! The bytes of an upload in the journal.
//!
//! ```text
//! version 2 or 3 (1 byte) | upload id (16 bytes) | contributor hash (8 bytes, LE) | varint head | contribution
//! ```
//!
//! The head holds LEB128 varints: day, forget-before day, in version 3 the declared sigmas of the poses (millimetres,
//! microradians; 0 where nothing was declared), the answer (length, bytes). The contribution is
//! [`echofix_core::evidence::codec`]'s.
//! A contributor is in here as a keyed hash only, and no column says when within the day, or on
//! which way, anything was seen. The upload's id and the answer are stored as they were sent: an id
//! with a timestamp, such as a UUID of version 7, says when it was made. A vehicle that does not want
//! that known uses ids without one.

use echofix_core::datum::PoseSigma;
use echofix_core::evidence::{EvidenceDelta, Pass, codec};
use echofix_core::geo::TileId;
use echofix_core::varint::{VarintReader, VarintWriter};
use uuid::Uuid;

use crate::store::api::UploadRecord;

/// Of before poses' sigmas were recorded.
const UNDECLARED: u8 = 2;
const VERSION: u8 = 3;
/// No upload the service accepts comes near this many bytes of cells.
const MAX_DECODED: usize = 256 << 20;

/// The bytes of an upload.
pub(in crate::store) fn encode(upload: &UploadRecord) -> Vec<u8> {
    let mut out = VarintWriter::default();
    out.bytes.push(if upload.declared.is_some() { VERSION } else { UNDECLARED });
    out.bytes.extend_from_slice(upload.id.as_bytes());
    out.bytes.extend_from_slice(&upload.pass.contributor.to_le_bytes());
    out.put(u64::from(upload.pass.day));
    out.put(u64::from(upload.forget_before));
    if let Some((position_mm, yaw_urad)) = upload.declared.map(PoseSigma::stored) {
        out.put(u64::from(position_mm));
        out.put(u64::from(yaw_urad));
    }
    out.put_bytes(&upload.answer);
    out.bytes.extend(codec::encode(&upload.contribution));
    out.bytes
}

/// What the journal's index needs of a record, without its cells.
#[derive(Debug, PartialEq)]
pub(super) struct UploadHead {
    pub(in crate::store) id: Uuid,
    pub(in crate::store) pass: Pass,
    pub(in crate::store) forget_before: u16,
    pub(in crate::store) answer: Vec<u8>,
    /// Tiles and their number of cells.
    pub(in crate::store) tiles: Vec<(TileId, usize)>,
}

/// The head of an upload's bytes; `None` when they do not follow the format.
pub(super) fn decode_head(bytes: &[u8]) -> Option<UploadHead> {
    let mut input = VarintReader { rest: bytes };
    let UploadRecord { id, pass, forget_before, answer, .. } = bare(&mut input)?;
    let tiles = codec::decode_header(input.rest).ok()?.tiles;
    Some(UploadHead { id, pass, forget_before, answer, tiles })
}

/// The upload of its bytes; `None` when they do not follow the format.
pub(in crate::store) fn decode(bytes: &[u8]) -> Option<UploadRecord> {
    let mut input = VarintReader { rest: bytes };
    let upload = bare(&mut input)?;
    Some(UploadRecord { contribution: codec::decode(input.rest, MAX_DECODED).ok()?, ..upload })
}

/// The upload without its contribution, which is what is left of the input.
fn bare(input: &mut VarintReader<'_>) -> Option<UploadRecord> {
    let version = *input.take(1)?.first()?;
    if ![UNDECLARED, VERSION].contains(&version) {
        return None;
    }
    let id = Uuid::from_slice(input.take(16)?).ok()?;
    let contributor = u64::from_le_bytes(input.take(8)?.try_into().ok()?);
    let pass = Pass { day: input.get()?, contributor };
    let forget_before = input.get()?;
    let declared = match version {
        VERSION => Some(PoseSigma::from_stored(input.get()?, input.get()?)?),
        _ => None,
    };
    let answer = input.bytes()?.to_vec();
    Some(UploadRecord { id, pass, forget_before, declared, contribution: EvidenceDelta::default(), answer })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::testing::uploads;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn an_upload_survives_its_bytes(upload in uploads()) {
            let bytes = encode(&upload);
            let head = decode_head(&bytes).unwrap();
            prop_assert_eq!(head.id, upload.id);
            prop_assert_eq!(head.tiles.len(), upload.contribution.tiles.len());
            prop_assert_eq!(decode(&bytes), Some(upload));
        }

        #[test]
        fn cut_or_changed_bytes_do_no_harm(upload in uploads(), at: prop::sample::Index, flip in 1..=255_u8) {
            let mut bytes = encode(&upload);
            let at = at.index(bytes.len());
            prop_assert_eq!(decode(&bytes[..at]), None);
            bytes[at] ^= flip;
            // The journal's checksum catches it; here it must only not panic or allocate without bound.
            let _ = decode(&bytes);
        }
    }
}
