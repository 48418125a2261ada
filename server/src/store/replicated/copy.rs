//! The data directory of a server that shares its map: begun from the newest manifest, and brought up to the end of the
//! shared journal before anything is served. So no start answers from a map that lacks what was acknowledged before it.

use siphasher::sip::SipHasher24;
use uuid::Uuid;

use crate::store::api::Error;
use crate::store::backend::Backend;
use crate::store::local::seed;
use crate::store::log::entry;
use crate::store::log::journal::Journal;
use crate::store::log::segment;
use crate::store::log::sequencer::NewRecord;
use crate::store::map::context::Settings;
use crate::store::map::fold::unreadable;
use crate::store::object::client::Client;
use crate::store::object::cluster::Cluster;
use crate::store::object::manifest::Manifest;
use crate::store::object::shared_log::{Peeked, SegmentRecords, SharedLog};
use crate::store::options::Options;

/// Begins the directory, unless it was.
///
/// # Errors
/// When the store or the disk refuses.
pub(super) fn begin(
    client: &Client,
    options: &Options,
    (cluster, key): (&Cluster, &[u8; 16]),
    manifest: &Manifest,
) -> Result<(), Error> {
    if seed::is_begun(&options.data_dir)? {
        return Ok(());
    }
    let pack = match &manifest.pack {
        Some(name) => {
            let gone =
                || Error::Unknown(format!("{} was replaced meanwhile; start again", client.locate(name)));
            Some((format!("base-{}", manifest.next - 1), client.get(name)?.ok_or_else(gone)?))
        }
        None => None,
    };
    let pack = pack.as_ref().map(|(name, bytes)| (&name[..], &bytes[..]));
    let header = segment::header(cluster.journal, manifest.next);
    seed::begin(&options.data_dir, key, pack, (manifest.next, &header))
}

/// Are contributors called in the directory what they are called in the bucket?
///
/// # Errors
/// When they are not: then each would be another one here than on the other servers.
pub(super) fn has_key(backend: &Backend, key: &[u8; 16]) -> Result<(), Error> {
    const SOMEBODY: &str = "somebody";
    if backend.pseudonyms.hash(SOMEBODY) == SipHasher24::new_with_key(key).hash(SOMEBODY.as_bytes()) {
        return Ok(());
    }
    let reason = "the key in the data directory is not that of the bucket. Name an empty directory: it becomes a copy of what is \
                  in the bucket";
    Err(Error::Unusable(reason.to_owned()))
}

/// Writes to the directory's journal what the shared one has more.
///
/// # Errors
/// When the directory is of another map, or ends before the shared journal begins; or when the store or the disk refuses.
pub(super) fn catch_up(
    backend: &Backend,
    settings: &Settings,
    shared: Uuid,
    log: &mut SharedLog,
) -> Result<(), Error> {
    let found = Journal::recover(&*backend.segments, |_, _| Ok(()))?;
    if found.id() != shared {
        let reason = "the data directory holds another map than the bucket. Name an empty one: it is a copy of what is in \
                      the bucket. To bring a map into an empty bucket, see `echofix map migrate`";
        return Err(Error::Unusable(reason.to_owned()));
    }
    let mut end = found.end();
    if end + 1 < log.chain().known().first {
        return Err(Error::Unusable(format!(
            "the data directory is a copy up to record {end}, and the bucket begins behind that: remove it, or name an empty \
             one, and start again"
        )));
    }
    // What comes meanwhile is followed once this server serves: it may come faster than it is read.
    let until = log.go_to_end()?.number;
    log.go_to(end + 1)?;
    let (segments, fence) = (backend.segments.clone(), backend.fence.clone());
    let journal = Journal::start(segments, found, (settings.segment_bytes, fence), |_, _| {}, |_| {})?;
    while end + 1 < until {
        match log.peek()? {
            Peeked::Nothing => break,
            Peeked::Passed => return Err(passed()),
            Peeked::Segment(segment) => {
                end = write(&journal, &segment, end)?;
                log.advance(&segment);
            }
        }
    }
    Ok(())
}

/// Writes the records of a segment that the journal, which ends at `end`, does not have; returns where it ends then.
///
/// # Errors
/// When a record is damaged, or the disk refuses.
pub(super) fn write(journal: &Journal, segment: &SegmentRecords, end: u64) -> Result<u64, Error> {
    let missing = (segment.first..).zip(&segment.records).filter(|(number, _)| *number > end);
    let new = missing.map(|(number, payload)| {
        let meta = entry::meta(payload).ok_or_else(|| unreadable(number))?;
        let payload = payload.clone();
        Ok(NewRecord { fresh: meta.begins_segment(), meta, payload, number: Some(number) })
    });
    let new = new.collect::<Result<Vec<_>, Error>>()?;
    let Some(written) = journal.append_all(new)?.pop() else { return Ok(end) };
    let expected = segment.first + segment.records.len() as u64 - 1;
    if written.number != expected {
        let reason =
            format!("the copy ends at record {} where the shared journal has {expected}", written.number);
        return Err(Error::Stopped(reason));
    }
    Ok(expected)
}

/// The floor has passed where this server stands.
pub(super) fn passed() -> Error {
    Error::Stopped(
        "what this server has read is older than what the bucket still has: remove its data directory, and start again"
            .to_owned(),
    )
}
