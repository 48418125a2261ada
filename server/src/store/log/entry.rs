//! The bytes of a journal record: an upload, or a control that says what of the others counts.
//!
//! ```text
//! version (1 byte) | varint day it was written on | kind (1 byte) | content
//! ```
//!
//! | kind | content |
//! |---|---|
//! | 0 upload | see [`crate::store::log::record`] |
//! | 1 revoke contributor | hash (8 bytes, LE), varint time |
//! | 2 revoke upload | id (16 bytes), varint time |
//! | 3 roll back | varint epoch, varint time |
//! | 4 compact | varint last record compacted, varint time |
//! | 5 import | id of the file (16 bytes), EPSG code, x, y, the encoded tile |
//! | 6 undo | varint number of the control that is undone, varint time |
//!
//! Times are microseconds since the Unix epoch. A control may end in a remark: who decided and why, each as a varint length
//! and UTF-8. Without one, and in journals of before there were remarks, it ends with the time.

use echofix_core::geo::{TileId, Zone};
use echofix_core::varint::{VarintReader, VarintWriter};
use uuid::Uuid;

use super::record;
use crate::store::api::{Remark, UploadRecord};

const VERSION: u8 = 0xe1;
const UPLOAD: u8 = 0;
const REVOKE_CONTRIBUTOR: u8 = 1;
const REVOKE_UPLOAD: u8 = 2;
const ROLLBACK: u8 = 3;
const COMPACT: u8 = 4;
const IMPORT: u8 = 5;
const UNDO: u8 = 6;

/// What the index needs of a record.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(in crate::store) struct RecordMeta {
    /// UTC day the record was written on, counted from the Unix epoch.
    pub(in crate::store) day: u16,
    pub(in crate::store) what: RecordSubject,
}

impl RecordMeta {
    /// Does it begin a segment of its own? What is compacted ends where the compaction begins.
    pub(in crate::store) fn begins_segment(&self) -> bool {
        matches!(self.what, RecordSubject::Control(Control { action: Action::Compact(_), .. }))
    }
}

/// What a record is about.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(in crate::store) enum RecordSubject {
    /// A vehicle's upload.
    Upload { id: Uuid, contributor: u64 },
    /// A tile of another map's file.
    Import { file: Uuid, tile: TileId },
    /// An operator's decision.
    Control(Control),
}

/// The kind of a record, and by what it may be excluded.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::store) enum RecordKind {
    Upload { contributor: u64 },
    Import { file: Uuid },
    Control,
}

/// A decision about the records before it. Applying one takes a new generation of tiles.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(in crate::store) struct Control {
    /// When, microseconds since the Unix epoch.
    pub(in crate::store) at_us: i64,
    pub(in crate::store) action: Action,
    /// Who decided, and why.
    pub(in crate::store) remark: Remark,
}

/// What was decided.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::store) enum Action {
    /// All earlier uploads of a contributor, named by the keyed hash, do not count.
    RevokeContributor(u64),
    /// An upload, or all tiles of an imported file, does not count.
    RevokeUpload(Uuid),
    /// No earlier upload or import after this epoch counts.
    Rollback(u64),
    /// An earlier control of another kind than compaction has no effect any more.
    Undo(u64),
    /// The records up to this one are in the checkpoint, whatever is decided later.
    Compact(u64),
}

impl Action {
    /// Its word in the log, which says nothing about whom it concerns.
    pub(in crate::store) fn word(self) -> &'static str {
        match self {
            Self::RevokeContributor(_) => "revoke_contributor",
            Self::RevokeUpload(_) => "revoke_upload",
            Self::Rollback(_) => "rollback",
            Self::Undo(_) => "undo",
            Self::Compact(_) => "compact",
        }
    }
}

/// What folding does with a record.
#[derive(Debug)]
pub(in crate::store) enum RecordContent {
    Upload(Box<UploadRecord>),
    Import { tile: TileId, encoded: Vec<u8> },
    Control,
}

pub(in crate::store) fn upload(day: u16, upload: &UploadRecord) -> (RecordMeta, Vec<u8>) {
    let mut out = begun(day, UPLOAD);
    out.bytes.extend(record::encode(upload));
    let what = RecordSubject::Upload { id: upload.id, contributor: upload.pass.contributor };
    (RecordMeta { day, what }, out.bytes)
}

pub(in crate::store) fn control(day: u16, control: &Control) -> (RecordMeta, Vec<u8>) {
    let (kind, content) = match control.action {
        Action::RevokeContributor(hash) => (REVOKE_CONTRIBUTOR, hash.to_le_bytes().to_vec()),
        Action::RevokeUpload(id) => (REVOKE_UPLOAD, id.as_bytes().to_vec()),
        Action::Rollback(epoch) => (ROLLBACK, varint(epoch)),
        Action::Undo(number) => (UNDO, varint(number)),
        Action::Compact(last) => (COMPACT, varint(last)),
    };
    let mut out = begun(day, kind);
    out.bytes.extend(content);
    out.put(control.at_us as u64);
    if !control.remark.is_empty() {
        for words in [&control.remark.by, &control.remark.reason] {
            out.put_bytes(words.as_deref().unwrap_or_default().as_bytes());
        }
    }
    (RecordMeta { day, what: RecordSubject::Control(control.clone()) }, out.bytes)
}

pub(in crate::store) fn import(day: u16, file: Uuid, tile: TileId, encoded: &[u8]) -> (RecordMeta, Vec<u8>) {
    let mut out = begun(day, IMPORT);
    out.bytes.extend_from_slice(file.as_bytes());
    out.put(u64::from(tile.zone.epsg()));
    out.put_signed(i64::from(tile.x));
    out.put_signed(i64::from(tile.y));
    out.bytes.extend_from_slice(encoded);
    (RecordMeta { day, what: RecordSubject::Import { file, tile } }, out.bytes)
}

fn begun(day: u16, kind: u8) -> VarintWriter {
    let mut out = VarintWriter::default();
    out.bytes.push(VERSION);
    out.put(u64::from(day));
    out.bytes.push(kind);
    out
}

fn varint(value: u64) -> Vec<u8> {
    let mut out = VarintWriter::default();
    out.put(value);
    out.bytes
}

/// The index's part of a record; `None` when the bytes do not follow the format.
pub(in crate::store) fn meta(bytes: &[u8]) -> Option<RecordMeta> {
    let (day, kind, mut rest) = open(bytes)?;
    let what = match kind {
        UPLOAD => {
            let head = record::decode_head(rest.rest)?;
            RecordSubject::Upload { id: head.id, contributor: head.pass.contributor }
        }
        IMPORT => {
            let (file, tile) = import_head(&mut rest)?;
            RecordSubject::Import { file, tile }
        }
        _ => {
            let action = action(kind, &mut rest)?;
            let at_us = rest.get::<u64>()? as i64;
            let remark = remark(&mut rest)?;
            rest.rest.is_empty().then_some(RecordSubject::Control(Control { at_us, action, remark }))?
        }
    };
    Some(RecordMeta { day, what })
}

/// The answer in an upload's record; `None` when it is no upload.
pub(in crate::store) fn answer(bytes: &[u8]) -> Option<Vec<u8>> {
    let (_, kind, rest) = open(bytes)?;
    let head = (kind == UPLOAD).then(|| record::decode_head(rest.rest))?;
    Some(head?.answer)
}

/// The whole of a record; `None` when the bytes do not follow the format.
pub(in crate::store) fn decode(bytes: &[u8]) -> Option<RecordContent> {
    let (_, kind, mut rest) = open(bytes)?;
    Some(match kind {
        UPLOAD => RecordContent::Upload(Box::new(record::decode(rest.rest)?)),
        IMPORT => {
            let (_, tile) = import_head(&mut rest)?;
            RecordContent::Import { tile, encoded: rest.rest.to_vec() }
        }
        _ => action(kind, &mut rest).map(|_| RecordContent::Control)?,
    })
}

fn open(bytes: &[u8]) -> Option<(u16, u8, VarintReader<'_>)> {
    let mut input = VarintReader { rest: bytes };
    if input.take(1)? != [VERSION] {
        return None;
    }
    let day = input.get()?;
    let kind = input.take(1)?[0];
    Some((day, kind, input))
}

fn import_head(input: &mut VarintReader<'_>) -> Option<(Uuid, TileId)> {
    let file = Uuid::from_slice(input.take(16)?).ok()?;
    let zone = Zone::from_epsg(input.get()?).ok()?;
    let (x, y) = (input.get_signed()?, input.get_signed()?);
    Some((file, TileId { zone, y, x }))
}

fn action(kind: u8, input: &mut VarintReader<'_>) -> Option<Action> {
    Some(match kind {
        REVOKE_CONTRIBUTOR => Action::RevokeContributor(u64::from_le_bytes(input.take(8)?.try_into().ok()?)),
        REVOKE_UPLOAD => Action::RevokeUpload(Uuid::from_slice(input.take(16)?).ok()?),
        ROLLBACK => Action::Rollback(input.get()?),
        UNDO => Action::Undo(input.get()?),
        COMPACT => Action::Compact(input.get()?),
        _ => return None,
    })
}

/// What may stand at the end of a control.
fn remark(input: &mut VarintReader<'_>) -> Option<Remark> {
    if input.rest.is_empty() {
        return Some(Remark::default());
    }
    let mut words = || {
        let words = std::str::from_utf8(input.bytes()?).ok()?;
        Some((!words.is_empty()).then(|| words.to_owned()))
    };
    Some(Remark { by: words()?, reason: words()? })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::testing::uploads;
    use proptest::prelude::*;

    fn controls() -> impl Strategy<Value = Control> {
        let action = prop_oneof![
            any::<u64>().prop_map(Action::RevokeContributor),
            any::<u128>().prop_map(|id| Action::RevokeUpload(Uuid::from_u128(id))),
            any::<u64>().prop_map(Action::Rollback),
            any::<u64>().prop_map(Action::Undo),
            any::<u64>().prop_map(Action::Compact),
        ];
        let words = || prop::option::of("[^\\x00]{1,20}");
        let remark = (words(), words()).prop_map(|(by, reason)| Remark { by, reason });
        (any::<i64>(), action, remark).prop_map(|(at_us, action, remark)| Control { at_us, action, remark })
    }

    /// Catches: controls of earlier journals that are no longer read, or written otherwise when nothing is remarked.
    #[test]
    fn a_control_without_a_remark_is_as_it_always_was() {
        let control = Control { at_us: 300, action: Action::Rollback(5), remark: Remark::default() };
        let (_, bytes) = super::control(7, &control);
        assert_eq!(bytes, [VERSION, 7, ROLLBACK, 5, 0xac, 2]);
        assert_eq!(meta(&bytes).unwrap().what, RecordSubject::Control(control));
    }

    proptest! {
        #[test]
        fn records_of_every_kind_survive_their_bytes(upload in uploads(), control in controls(), day: u16) {
            let (written, bytes) = super::upload(day, &upload);
            prop_assert_eq!(meta(&bytes), Some(written));
            prop_assert_eq!(answer(&bytes), Some(upload.answer.clone()));
            let Some(RecordContent::Upload(decoded)) = decode(&bytes) else { panic!("no upload") };
            prop_assert_eq!(*decoded, upload.clone());

            let (written, bytes) = super::control(day, &control);
            prop_assert_eq!(meta(&bytes), Some(written));
            prop_assert!(matches!(decode(&bytes), Some(RecordContent::Control)));
            prop_assert_eq!(answer(&bytes), None);

            let at = *upload.contribution.tiles.keys().next().unwrap();
            let (written, bytes) = import(day, upload.id, at, b"tile");
            prop_assert_eq!(meta(&bytes), Some(written));
            let Some(RecordContent::Import { tile, encoded }) = decode(&bytes) else { panic!("no import") };
            prop_assert_eq!((tile, &encoded[..]), (at, &b"tile"[..]));
        }

        #[test]
        fn any_bytes_are_read_without_harm(mut bytes: Vec<u8>, kind in 0..8_u8) {
            let _ = (meta(&bytes), decode(&bytes), answer(&bytes));
            bytes.splice(..0, [VERSION, 7, kind]);
            let _ = (meta(&bytes), decode(&bytes), answer(&bytes));
        }
    }
}
