//! The journal that several servers append to. Its order is the order of its segments' names: each is put if it is absent, by
//! a server that has read all before it. So what is appended is known not to be there yet, and has its number.

use uuid::Uuid;

use super::chain::Chain;
use super::client::{Client, Put};
use super::manifest::Manifest;
use super::names::Shard;
use super::segment::{self, HEADER, Header};
use crate::store::api::Error;

/// Where the next segment is, and what number its first record has.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::store) struct Next {
    pub(in crate::store) seq: u64,
    pub(in crate::store) number: u64,
}

/// Records that are in the journal.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(in crate::store) struct SegmentRecords {
    /// Number of the first.
    pub(in crate::store) first: u64,
    pub(in crate::store) records: Vec<Vec<u8>>,
}

/// What there is in the next place.
#[derive(Debug, PartialEq, Eq)]
pub(in crate::store) enum Peeked {
    /// Nothing yet.
    Nothing,
    /// A segment.
    Segment(SegmentRecords),
    /// The floor has passed the place: whatever is there may have been created after it was freed.
    Passed,
}

/// What became of records that were to be appended.
#[derive(Debug, PartialEq, Eq)]
pub(in crate::store) enum Appended {
    /// They are in the journal, and may be acknowledged.
    Written(SegmentRecords),
    /// There is another segment in their place: read it first.
    Behind,
    /// The floor has passed the place where this server stands: what it has read is too old to go on from.
    Passed,
}

/// How it is seen whether a name that was created was one that collection had freed. Any but the first loses uploads: the
/// others are there for tests to show that.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(in crate::store) enum Check {
    /// By the floor of the newest manifest.
    #[default]
    Floor,
    /// By the name before it.
    #[cfg_attr(not(test), expect(dead_code, reason = "tests show what it loses"))]
    Predecessor,
    /// Not at all.
    #[cfg_attr(not(test), expect(dead_code, reason = "tests show what it loses"))]
    Nothing,
}

/// The journal, as one server has read it.
pub(in crate::store) struct SharedLog {
    client: Client,
    shard: Shard,
    cluster: Uuid,
    writer: Uuid,
    chain: Chain,
    next: Next,
    check: Check,
}

impl SharedLog {
    /// The journal of a cluster, from its floor on.
    ///
    /// # Errors
    /// When the store does not answer, or the newest manifest is damaged.
    pub(in crate::store) fn open(
        client: Client,
        shard: Shard,
        (cluster, writer): (Uuid, Uuid),
        check: Check,
    ) -> Result<Self, Error> {
        let mut chain = Chain::of(client.clone(), shard);
        let Manifest { floor, first, .. } = *chain.newest()?;
        Ok(Self { client, shard, cluster, writer, chain, next: Next { seq: floor, number: first }, check })
    }

    /// Where it stands.
    pub(in crate::store) fn next(&self) -> Next {
        self.next
    }

    /// The manifests, as far as they are known.
    pub(in crate::store) fn chain(&mut self) -> &mut Chain {
        &mut self.chain
    }

    /// Goes to the segment that holds a record, or would hold it as the next one.
    ///
    /// # Errors
    /// [`Error::Unusable`] when it lies below the floor or beyond the end; or when the store does not answer.
    pub(in crate::store) fn go_to(&mut self, number: u64) -> Result<(), Error> {
        let first = self.chain.newest()?.first;
        if number < first {
            return Err(Error::Unusable(format!(
                "record {number} is asked for, and the journal in the bucket begins at {first}"
            )));
        }
        let next = self.found(number)?;
        if number > next.number && self.header(next.seq)?.is_none() {
            return Err(Error::Unusable(format!(
                "record {number} is asked for, and the journal in the bucket ends at {}",
                next.number - 1
            )));
        }
        self.next = next;
        Ok(())
    }

    /// Goes behind the last segment.
    ///
    /// # Errors
    /// When the store does not answer, or a segment is damaged.
    pub(in crate::store) fn go_to_end(&mut self) -> Result<Next, Error> {
        self.chain.newest()?;
        self.next = self.found(u64::MAX)?;
        Ok(self.next)
    }

    /// The segment of a record, by the headers of few; the place behind the last where that ends before.
    fn found(&self, number: u64) -> Result<Next, Error> {
        let Manifest { floor, first, .. } = *self.chain.known();
        let mut next = Next { seq: floor, number: first };
        let mut step = 1;
        let mut at = floor;
        // Leaps, and smaller ones where a leap goes too far: from the floor on the names have no gap.
        while let Some(header) = self.header(at)?.filter(|header| header.first <= number) {
            next = Next { seq: at, number: header.first };
            if number < header.end() {
                break;
            }
            next = Next { seq: at + 1, number: header.end() };
            step *= 2;
            while step > 1 && self.header(at + step)?.is_none_or(|header| header.first > number) {
                step /= 2;
            }
            at += step;
        }
        Ok(next)
    }

    fn header(&self, seq: u64) -> Result<Option<Header>, Error> {
        let found = self.client.get_range(&self.shard.segment(seq), 0..HEADER as u64)?;
        found.map(|bytes| self.sound(seq, Header::parse(&bytes))).transpose()
    }

    fn sound(&self, seq: u64, header: Option<Header>) -> Result<Header, Error> {
        let ours = |header: &Header| header.seq == seq && header.cluster == self.cluster;
        header.filter(ours).ok_or_else(|| self.damaged(seq, "it is damaged, or of another journal"))
    }

    /// The next segment. The same is given until [`SharedLog::advance`] goes on. The rule for who creates a name holds for
    /// who reads it, too: a server that was stalled may have created it after it was freed.
    ///
    /// # Errors
    /// When the store does not answer, or the segment is damaged.
    pub(in crate::store) fn peek(&mut self) -> Result<Peeked, Error> {
        match self.client.get(&self.shard.segment(self.next.seq))? {
            None => Ok(Peeked::Nothing),
            Some(_) if self.is_void()? => Ok(Peeked::Passed),
            Some(bytes) => self.read(&bytes).map(Peeked::Segment),
        }
    }

    fn read(&self, bytes: &[u8]) -> Result<SegmentRecords, Error> {
        let Next { seq, number } = self.next;
        let (header, records) = segment::decode(bytes).unzip();
        let header = self.sound(seq, header)?;
        if header.first != number {
            return Err(self.damaged(seq, "it does not continue the segment before it"));
        }
        Ok(SegmentRecords { first: header.first, records: records.unwrap_or_default() })
    }

    /// The segment that was given is done with.
    pub(in crate::store) fn advance(&mut self, done: &SegmentRecords) {
        self.next = Next { seq: self.next.seq + 1, number: done.first + done.records.len() as u64 };
    }

    /// Has the floor passed the place where this server stands?
    ///
    /// # Errors
    /// When the store does not answer.
    pub(in crate::store) fn is_passed(&mut self) -> Result<bool, Error> {
        let seq = self.next.seq;
        Ok(self.chain.newest()?.floor > seq)
    }

    /// Appends records as the next segment. When they are written, [`SharedLog::advance`] goes on behind them.
    ///
    /// # Errors
    /// When the outcome is not known: the segment may be there, now or later. It is read as any other then.
    pub(in crate::store) fn append(&mut self, records: Vec<Vec<u8>>) -> Result<Appended, Error> {
        let Next { seq, number } = self.next;
        let body = segment::encode(self.cluster, self.writer, (seq, number), &records);
        match self.client.put_new(&self.shard.segment(seq), &body)? {
            Put::Theirs(_) => Ok(if self.is_passed()? { Appended::Passed } else { Appended::Behind }),
            Put::Ours if self.is_void()? => Ok(Appended::Passed),
            Put::Ours => Ok(Appended::Written(SegmentRecords { first: number, records })),
        }
    }

    /// Was a name created again that collection had freed? Nothing below a floor is deleted before the floor is published. So
    /// where the floor, read after the creation, is not beyond the name, it was never freed.
    fn is_void(&mut self) -> Result<bool, Error> {
        match self.check {
            Check::Floor => self.is_passed(),
            Check::Predecessor => {
                let seq = self.next.seq;
                Ok(seq > 1 && self.header(seq - 1)?.is_none())
            }
            Check::Nothing => Ok(false),
        }
    }

    fn damaged(&self, seq: u64, reason: &str) -> Error {
        let what = format!("the journal's segment {}", self.client.locate(&self.shard.segment(seq)));
        Error::Damaged { what, reason: reason.to_owned() }
    }
}
