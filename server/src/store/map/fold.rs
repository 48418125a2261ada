//! Journal to tiles: one way for records that just came, for those a crash left over, for a new
//! generation of tiles, and for a map of the past.

use echofix_core::geo::TileId;
use echofix_core::tile;

use super::generation::Generation;
use super::vetting::{Vetting, VettingOutcome};
use super::write_buffer::{Folded, InMemory, Source, WriteBuffer};
use crate::export::part;
use crate::store::api::{Error, QuarantinedRecord, UploadRecord};
use crate::store::log::entry::{self, RecordContent};
use crate::store::log::exclusion::Exclusion;
use crate::store::log::index::JournalIndex;
use crate::store::log::journal::Journal;
use crate::store::log::position::Written;

/// A map that is written to.
pub(in crate::store) trait Sink: Source {
    /// Writes changed tiles, and the uploads that were quarantined; the map goes up to the record
    /// `folded` with them.
    fn write(
        &mut self,
        changed: impl Iterator<Item = (TileId, Folded)>,
        quarantined: &[QuarantinedRecord],
        folded: u64,
    ) -> Result<(), Error>;
}

impl Sink for InMemory {
    fn write(
        &mut self,
        changed: impl Iterator<Item = (TileId, Folded)>,
        _: &[QuarantinedRecord],
        _: u64,
    ) -> Result<(), Error> {
        self.extend(changed);
        Ok(())
    }
}

impl Sink for &Generation {
    fn write(
        &mut self,
        changed: impl Iterator<Item = (TileId, Folded)>,
        quarantined: &[QuarantinedRecord],
        folded: u64,
    ) -> Result<(), Error> {
        self.put(changed, quarantined, folded)
    }
}

/// Folds one upload: the only place where an upload changes the map. What it does must follow from the
/// tiles on the canvas and the upload alone, so that a replay gives the same bytes.
fn fold(
    buffer: &mut WriteBuffer<'_>,
    number: u64,
    upload: &UploadRecord,
    vetting: &mut Vetting,
) -> Result<Option<QuarantinedRecord>, Error> {
    let counts = match vetting.vet(buffer, number, upload)? {
        VettingOutcome::Counts(counts) => counts,
        VettingOutcome::Quarantined(quarantined) => return Ok(Some(quarantined)),
    };
    let sigma = upload.declared.unwrap_or_default();
    for (id, evidence, offset) in counts {
        let folded = buffer.change(id, number)?;
        folded.ledger.forget_before(upload.forget_before);
        folded.tile.fold_moved(&mut folded.ledger, upload.pass, &evidence, offset, sigma);
    }
    Ok(None)
}

/// Folds a record of any kind.
fn fold_record(
    buffer: &mut WriteBuffer<'_>,
    number: u64,
    payload: &[u8],
    vetting: &mut Vetting,
) -> Result<Option<QuarantinedRecord>, Error> {
    match entry::decode(payload).ok_or_else(|| unreadable(number))? {
        RecordContent::Upload(upload) => fold(buffer, number, &upload, vetting),
        RecordContent::Import { tile: id, encoded } => {
            let imported = tile::decode(&encoded).map_err(|_| unreadable(number))?;
            let folded = buffer.change(id, number)?;
            folded.tile = folded.tile.merged(&imported);
            Ok(None)
        }
        RecordContent::Control => Ok(None),
    }
}

/// What came of a group of records.
pub(super) struct FoldedGroup {
    /// What vetting kept out.
    pub(super) kept_out: Vec<QuarantinedRecord>,
    /// The last record that is folded: that of the group, unless it was not to go on.
    pub(super) up_to: u64,
}

/// Folds a group of records, each tile read and written once, unless there are very many of them, or it shall not go on: it is
/// asked after each record, since one may take a while.
pub(super) fn fold_group(
    (journal, buffer_tiles): (&Journal, usize),
    sink: &mut impl Sink,
    counted: &[Written],
    folded: u64,
    (vetting, go_on): (&mut Vetting, &dyn Fn() -> bool),
) -> Result<FoldedGroup, Error> {
    let _folding = part!("fold").entered();
    let mut reader = journal.reader();
    let mut left = counted.iter();
    let mut kept_out = Vec::new();
    loop {
        let mut buffer = WriteBuffer::new(sink, buffer_tiles);
        let (mut quarantined, mut up_to) = (Vec::new(), folded);
        while let Some(written) = left.next() {
            let payload = reader.payload(written.at)?;
            quarantined.extend(fold_record(&mut buffer, written.number, &payload, vetting)?);
            if (buffer.is_full() || !go_on()) && !left.as_slice().is_empty() {
                up_to = written.number;
                break;
            }
        }
        let changed: Vec<_> = buffer.into_changed().collect();
        sink.write(changed.into_iter(), &quarantined, up_to)?;
        kept_out.append(&mut quarantined);
        if up_to == folded || !go_on() {
            return Ok(FoldedGroup { kept_out, up_to });
        }
    }
}

/// The journal without what is excluded.
pub(in crate::store) struct CountedRecords<'a> {
    pub(in crate::store) journal: &'a Journal,
    pub(in crate::store) index: &'a JournalIndex,
    pub(in crate::store) exclusion: &'a Exclusion,
    /// See [`crate::store::options::Options::write_buffer_tiles`].
    pub(in crate::store) buffer_tiles: usize,
}

/// Folds the records after `folded` up to `last`, but for the excluded ones. `report` is called before every step
/// and ends the replay by returning false; the number of the last record folded is returned.
pub(in crate::store) fn replay(
    records: &CountedRecords<'_>,
    sink: &mut impl Sink,
    mut folded: u64,
    last: u64,
    vetting: &mut Vetting,
    mut report: impl FnMut(u64) -> bool,
) -> Result<u64, Error> {
    let CountedRecords { journal, index, exclusion, buffer_tiles } = *records;
    while folded < last && report(folded) {
        let group = index.records(folded, last);
        let Some(newest) = group.last().map(|written| written.number) else { break };
        let (counted, go_on) = (index.counted(&group, exclusion), || !index.ended());
        folded = fold_group((journal, buffer_tiles), sink, &counted, newest, (vetting, &go_on))?.up_to;
    }
    Ok(folded)
}

/// A record whose checksum matches but whose content does not follow the format.
pub(in crate::store) fn unreadable(number: u64) -> Error {
    let reason = "its content does not follow the format; a newer version may have written it".to_owned();
    Error::Damaged { what: format!("journal record {number}"), reason }
}
