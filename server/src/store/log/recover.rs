//! What a segment holds after whatever happened to it.
//!
//! A crash can leave the newest group of records half written: these were never acknowledged and
//! are cut off. Anything else that does not pass its checks is damage to acknowledged uploads, and
//! an error. The two are distinguished by the records behind the bad one: one that was written when
//! the bad one was already on disk proves damage.

use super::segment::{self, FramedRecord};
use crate::store::backend::segments::HEADER;

/// A sound segment, or the sound beginning of one.
#[derive(Debug, PartialEq, Eq)]
pub(in crate::store) struct Sound {
    /// Number of the record that would come next.
    pub(in crate::store) next: u64,
    /// Bytes up to the end of the last sound record.
    pub(in crate::store) length: usize,
}

/// What is wrong, at which byte.
#[derive(Debug, PartialEq, Eq)]
pub(in crate::store) struct Damage {
    pub(in crate::store) at: usize,
    pub(in crate::store) reason: &'static str,
}

/// Walks over the records of a segment whose first record must be `first`, giving each with its
/// offset. `end` is the first record of the segment after it; only the last one, which has none, may end in a torn write.
/// What lies behind the record before `end` was never acknowledged: a write that failed, or one of a server that had lost
/// the directory. Whoever began the next segment had not seen it on disk.
pub(super) fn walk(
    bytes: &[u8],
    first: u64,
    end: Option<u64>,
    mut visit: impl FnMut(usize, &FramedRecord<'_>),
) -> Result<Sound, Damage> {
    let mut sound = Sound { next: first, length: HEADER };
    while sound.length < bytes.len() && end != Some(sound.next) {
        let rest = &bytes[sound.length..];
        match segment::parse_record(rest) {
            Some(record) if record.number == sound.next => {
                visit(sound.length, &record);
                sound = Sound { next: sound.next + 1, length: sound.length + record.len() };
            }
            Some(_) => return Err(Damage { at: sound.length, reason: "a record is out of order" }),
            None if end.is_none() && !proves_damage(rest, sound.next) => return Ok(sound),
            None => return Err(Damage { at: sound.length, reason: "a record does not match its checksum" }),
        }
    }
    Ok(sound)
}

/// Does a record behind the bad one say that the bad one had been on disk?
fn proves_damage(from_bad: &[u8], bad: u64) -> bool {
    (1..from_bad.len()).any(|at| {
        let bytes = &from_bad[at..];
        // The number filters before the checksum has to.
        segment::peek_number(bytes).is_some_and(|n| n > bad && n - bad < 1 << 24)
            && segment::parse_record(bytes).is_some_and(|record| record.synced >= bad)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use uuid::Uuid;

    /// Records in groups; each group was on disk before the next was written.
    fn written(groups: &[&[&[u8]]]) -> (Vec<u8>, Vec<usize>) {
        let mut bytes = segment::header(Uuid::nil(), 1).to_vec();
        let (mut number, mut ends) = (1, vec![HEADER]);
        for group in groups {
            let synced = number - 1;
            for payload in *group {
                segment::put_record(&mut bytes, number, synced, payload);
                ends.push(bytes.len());
                number += 1;
            }
        }
        (bytes, ends)
    }

    fn walked(bytes: &[u8], end: Option<u64>) -> Result<Sound, Damage> {
        walk(bytes, 1, end, |_, _| {})
    }

    #[test]
    fn every_truncation_keeps_the_whole_records_before_it() {
        let (bytes, ends) = written(&[&[b"one"], &[b"two", b"three"], &[b""]]);
        for length in HEADER..bytes.len() {
            let whole = ends.iter().filter(|end| **end <= length).count() - 1;
            let sound = Sound { next: whole as u64 + 1, length: ends[whole] };
            assert_eq!(walked(&bytes[..length], None), Ok(sound));
            if ends.contains(&length) {
                continue;
            }
            assert!(walked(&bytes[..length], Some(5)).is_err(), "only the last segment may be torn");
        }
    }

    #[test]
    fn a_flipped_bit_in_an_older_group_is_damage_and_named() {
        let (bytes, ends) = written(&[&[b"one"], &[b"two", b"three"], &[b"four"]]);
        for at in HEADER..bytes.len() {
            let mut bad = bytes.clone();
            bad[at] ^= 1;
            let record = ends.iter().filter(|end| **end <= at).count() - 1;
            let outcome = walked(&bad, None);
            if record < 3 {
                assert_eq!(outcome.map_err(|d| d.at), Err(ends[record]), "byte {at}");
            } else {
                assert_eq!(outcome, Ok(Sound { next: 4, length: ends[3] }), "the newest group may be torn");
            }
        }
    }

    #[test]
    fn a_group_whose_pages_reached_the_disk_out_of_order_is_torn_not_damaged() {
        let (mut bytes, ends) = written(&[&[b"one"], &[b"two", b"three"]]);
        bytes[ends[1]..ends[2]].fill(0);
        assert_eq!(walked(&bytes, None), Ok(Sound { next: 2, length: ends[1] }));
    }

    /// Catches: a journal that does not open because of what a failed write or a fenced server left behind.
    #[test]
    fn what_lies_behind_the_beginning_of_the_next_segment_does_not_count() {
        let (mut bytes, ends) = written(&[&[b"one"], &[b"two"], &[b"three"]]);
        assert_eq!(walked(&bytes, Some(3)), Ok(Sound { next: 3, length: ends[2] }));
        bytes.truncate(ends[2] + 5);
        assert_eq!(walked(&bytes, Some(3)), Ok(Sound { next: 3, length: ends[2] }), "torn");
        bytes[ends[1]] ^= 1;
        assert!(walked(&bytes, Some(3)).is_err(), "what was acknowledged must be sound");
    }
}
