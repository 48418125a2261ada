//! The batches that the service keeps for streams, so that vehicles send only what is new.

use std::collections::{BTreeMap, HashMap};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use echofix_proto::delta::{self, Unfit};
use echofix_proto::v1::{Batch, BatchDelta, LocalizeRequest, Odometry, Scans};
use tonic::Status;

use crate::grpc::invalid_field::InvalidField;
use crate::grpc::status;
use crate::shares::Peer;

/// Bytes of one batch in memory, at most: a hundred thousand detections. A larger one is not kept.
const MAX_BATCH_BYTES: usize = 1 << 20;
/// What a batch takes beside its columns.
const OVERHEAD_BYTES: usize = 512;

/// Batches of all streams, within one room. The one that was asked of longest ago makes place for a new one: its stream then
/// asks with a whole batch again.
#[derive(Debug)]
pub(super) struct KeptBatches {
    most_bytes: usize,
    /// Of which one peer may have so many.
    each_bytes: usize,
    held: Mutex<Held>,
}

#[derive(Debug, Default)]
struct Held {
    bytes: usize,
    next: u64,
    by_peer: HashMap<Peer, usize>,
    /// By their tickets, which grow: the first is the oldest.
    batches: BTreeMap<u64, Kept>,
}

#[derive(Debug)]
struct Kept {
    batch: Arc<Batch>,
    bytes: usize,
    peer: Peer,
}

impl KeptBatches {
    /// Room for so many bytes, of which one peer may have a share, 0 to 1.
    pub(super) fn new(most_bytes: usize, share: f64) -> Arc<Self> {
        let each_bytes = crate::shares::part(most_bytes, share);
        Arc::new(Self { most_bytes, each_bytes, held: Mutex::default() })
    }

    /// The batch of a ticket, where it is still there.
    fn get(&self, ticket: u64) -> Option<Arc<Batch>> {
        self.lock().batches.get(&ticket).map(|kept| Arc::clone(&kept.batch))
    }

    /// Keeps a batch where there is room for it.
    fn put(&self, batch: Batch, peer: Peer) -> Option<u64> {
        let bytes = batch_bytes(&batch);
        let mut held = self.lock();
        let own = held.by_peer.get(&peer).copied().unwrap_or(0);
        if bytes > MAX_BATCH_BYTES || bytes > self.most_bytes || own + bytes > self.each_bytes {
            return None;
        }
        while held.bytes + bytes > self.most_bytes {
            let (oldest, _) = held.batches.first_key_value()?;
            let oldest = *oldest;
            held.remove(oldest);
        }
        let ticket = held.next;
        held.next += 1;
        held.bytes += bytes;
        *held.by_peer.entry(peer).or_default() += bytes;
        held.batches.insert(ticket, Kept { batch: Arc::new(batch), bytes, peer });
        Some(ticket)
    }

    fn lock(&self) -> MutexGuard<'_, Held> {
        // All sums change under one lock, and nothing between them panics.
        self.held.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Held {
    fn remove(&mut self, ticket: u64) {
        let Some(Kept { bytes, peer, .. }) = self.batches.remove(&ticket) else { return };
        self.bytes -= bytes;
        if let Some(own) = self.by_peer.get_mut(&peer) {
            *own -= bytes;
            if *own == 0 {
                self.by_peer.remove(&peer);
            }
        }
    }
}

/// The batch that is kept for one stream; given up with it.
#[derive(Debug)]
pub(super) struct StreamBatch {
    all: Arc<KeptBatches>,
    peer: Peer,
    /// The question it is from, and its ticket.
    kept: Option<(u64, u64)>,
}

impl StreamBatch {
    pub(super) fn new(all: Arc<KeptBatches>, peer: Peer) -> Self {
        Self { all, peer, kept: None }
    }

    /// The number of the question whose batch is kept now.
    pub(super) fn number(&self) -> Option<u64> {
        let (number, ticket) = self.kept?;
        self.all.lock().batches.contains_key(&ticket).then_some(number)
    }

    /// A question with all of its batch, which is kept for the next one where that is wanted.
    ///
    /// # Errors
    /// `NEEDS_WHOLE_BATCH` where the delta's base is not kept, and the field of a delta that fits no base.
    pub(super) fn complete(
        &mut self,
        sequence: u64,
        mut request: LocalizeRequest,
        delta: Option<BatchDelta>,
        keep: bool,
    ) -> Result<LocalizeRequest, Status> {
        let keep = keep || delta.is_some();
        if let Some(delta) = delta {
            if request.batch.is_some() {
                let both = "comes beside `request.batch`; send one of them";
                return Err(status::invalid(&InvalidField::new("delta", both)));
            }
            request.batch = Some(self.applied(delta)?);
        }
        self.forget();
        if let Some(batch) = request.batch.as_ref().filter(|_| keep) {
            self.kept = self.all.put(batch.clone(), self.peer).map(|ticket| (sequence, ticket));
        }
        Ok(request)
    }

    fn applied(&self, delta: BatchDelta) -> Result<Batch, Status> {
        let base = self.kept.filter(|(number, _)| *number == delta.base);
        let Some(base) = base.and_then(|(_, ticket)| self.all.get(ticket)) else {
            let message = format!("the batch of question {} is not kept; send a whole batch", delta.base);
            return Err(status::refused("NEEDS_WHOLE_BATCH", message, &[]));
        };
        let unfit = |field: &str, problem: &str| {
            status::invalid(&InvalidField::new(format!("delta.{field}"), problem))
        };
        let batch = delta::applied(&base, delta).map_err(|Unfit { field, problem }| unfit(field, problem))?;
        if batch_bytes(&batch) > MAX_BATCH_BYTES {
            return Err(unfit("scans", "makes a batch of more than a megabyte; keep less of the base"));
        }
        Ok(batch)
    }

    fn forget(&mut self) {
        if let Some((_, ticket)) = self.kept.take() {
            self.all.lock().remove(ticket);
        }
    }
}

impl Drop for StreamBatch {
    fn drop(&mut self) {
        self.forget();
    }
}

/// What a batch takes in memory.
fn batch_bytes(batch: &Batch) -> usize {
    let scans = batch.scans.as_ref().map_or(0, |scans: &Scans| {
        size_of_val(&scans.sensor[..])
            + size_of_val(&scans.time_offset_us[..])
            + size_of_val(&scans.detection_count[..])
            + [
                &scans.range_m,
                &scans.azimuth_rad,
                &scans.radial_speed_mps,
                &scans.rcs_dbsm,
                &scans.elevation_rad,
            ]
            .map(|column| size_of_val(&column[..]))
            .iter()
            .sum::<usize>()
            + size_of_val(&scans.detection_time_offset_us[..])
    });
    let odometry = batch.odometry.as_ref().map_or(0, |way: &Odometry| {
        size_of_val(&way.time_offset_us[..])
            + [&way.x_m, &way.y_m, &way.yaw_rad].map(|column| size_of_val(&column[..])).iter().sum::<usize>()
    });
    OVERHEAD_BYTES + scans + odometry + size_of_val(&batch.mounts[..]) + size_of_val(&batch.suspected[..])
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::net::IpAddr;
    use tonic::Code;
    use tonic_types::StatusExt;

    fn question(detections: usize) -> LocalizeRequest {
        let scans = Scans {
            sensor: vec![0],
            time_offset_us: vec![0],
            detection_count: vec![detections as u32],
            range_m: vec![1.0; detections],
            azimuth_rad: vec![0.0; detections],
            ..Scans::default()
        };
        let batch = Batch { scans: Some(scans), ..Batch::default() };
        LocalizeRequest { batch: Some(batch), ..LocalizeRequest::default() }
    }

    fn delta(base: u64, scans_kept: u32, detections: usize) -> BatchDelta {
        let scans = question(detections).batch.unwrap().scans;
        BatchDelta { base, scans_kept, scans, ..BatchDelta::default() }
    }

    fn stream(all: &Arc<KeptBatches>, peer: u8) -> StreamBatch {
        StreamBatch::new(Arc::clone(all), Peer::at(IpAddr::from([10, 0, 0, peer])))
    }

    fn reason(status: &Status) -> String {
        status.get_details_error_info().map(|info| info.reason).unwrap_or_default()
    }

    /// Catches: a delta that is answered from another base than it names, and a base that a refused delta takes away.
    #[test]
    fn a_delta_counts_from_the_base_it_names_and_from_no_other() {
        let all = KeptBatches::new(1 << 20, 1.0);
        let mut stream = stream(&all, 1);
        stream.complete(1, question(2), None, true).unwrap();
        assert_eq!(stream.number(), Some(1));
        let error = stream.complete(2, LocalizeRequest::default(), Some(delta(0, 1, 1)), true).unwrap_err();
        assert_eq!((error.code(), &*reason(&error)), (Code::FailedPrecondition, "NEEDS_WHOLE_BATCH"));
        let error = stream.complete(2, LocalizeRequest::default(), Some(delta(1, 2, 1)), true).unwrap_err();
        assert_eq!(error.code(), Code::InvalidArgument);
        let error = stream.complete(2, question(1), Some(delta(1, 1, 1)), true).unwrap_err();
        assert_eq!(error.code(), Code::InvalidArgument);
        assert_eq!(stream.number(), Some(1), "what was refused changes nothing");
        let whole = stream.complete(2, LocalizeRequest::default(), Some(delta(1, 1, 3)), false).unwrap();
        assert_eq!(whole.batch.unwrap().scans.unwrap().range_m.len(), 5);
        assert_eq!(stream.number(), Some(2));
        // Who does not ask for it is not kept for.
        stream.complete(3, question(2), None, false).unwrap();
        assert_eq!((stream.number(), all.lock().bytes), (None, 0));
    }

    /// Catches: a batch that an attacker lets grow without end, delta by delta, and one that is kept beyond all bounds.
    #[test]
    fn a_batch_does_not_grow_without_end() {
        let all = KeptBatches::new(8 << 20, 1.0);
        let mut stream = stream(&all, 1);
        stream.complete(0, question(50_000), None, true).unwrap();
        let mut base = (0, 1);
        let error = loop {
            match stream.complete(
                base.0 + 1,
                LocalizeRequest::default(),
                Some(delta(base.0, base.1, 50_000)),
                true,
            ) {
                Ok(_) => base = (base.0 + 1, base.1 + 1),
                Err(error) => break error,
            }
            assert!(all.lock().bytes <= MAX_BATCH_BYTES && base.0 < 9);
        };
        assert_eq!(error.code(), Code::InvalidArgument, "{error}");
        stream.complete(9, question(200_000), None, true).unwrap();
        assert_eq!(stream.number(), None);
    }

    /// Catches: memory that grows with the number of streams, one peer that takes all of it, and what ended streams leave.
    #[test]
    fn all_batches_together_stay_within_their_room() {
        let room = 10 * (batch_bytes(question(100).batch.as_ref().unwrap()));
        let all = KeptBatches::new(room, 0.5);
        let mut streams: Vec<_> = (0..40_u8).map(|number| stream(&all, number / 8)).collect();
        for stream in &mut streams {
            stream.complete(1, question(100), None, true).unwrap();
            assert!(all.lock().bytes <= room);
        }
        let kept: Vec<_> = streams.iter().map(|stream| stream.number().is_some()).collect();
        assert_eq!(kept.iter().filter(|kept| **kept).count(), 10);
        assert!(kept[32..37].iter().all(|kept| *kept) && !kept[37], "five of the newest peer's eight");
        let error =
            streams[0].complete(2, LocalizeRequest::default(), Some(delta(1, 1, 1)), true).unwrap_err();
        assert_eq!(reason(&error), "NEEDS_WHOLE_BATCH");
        drop(streams);
        assert!(all.lock().batches.is_empty() && all.lock().by_peer.is_empty() && all.lock().bytes == 0);
    }
}
