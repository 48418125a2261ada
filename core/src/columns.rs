//! Columns of varints in a zstd frame, unpacked while they are read.
//!
//! A frame of some bytes may stand for megabytes. So neither is all of it unpacked before any of it is looked at, nor does
//! its header say how much memory is taken: a buffer of fixed size, and the frame's window up to [`MAX_WINDOW_LOG`].

use std::io::{BufRead, Read};

use zstd::stream::read::Decoder;
use zstd::zstd_safe::get_frame_content_size;

use crate::varint::{VarintReader, Varints};

/// Frames that look farther back are refused: 4 MiB. What is written here looks back 2 MiB at most.
const MAX_WINDOW_LOG: u32 = 22;
/// Bytes unpacked at once.
const BUFFER: usize = 64 << 10;
/// Bytes of the longest varint.
const LONGEST: usize = 10;

/// Takes values off a zstd frame.
pub(crate) struct ColumnReader<'a> {
    frame: Decoder<'a, &'a [u8]>,
    buffer: Vec<u8>,
    /// What of the buffer is unpacked and not yet taken.
    from: usize,
    to: usize,
    /// Bytes that may still be unpacked.
    left: usize,
    ended: bool,
}

impl<'a> ColumnReader<'a> {
    /// A reader of a frame; `None` when it is none, or holds more than `most` bytes as it says itself.
    pub(crate) fn new(frame: &'a [u8], most: usize) -> Option<Self> {
        let content = get_frame_content_size(frame).ok()?;
        let left = content.map_or(Some(most), |content| usize::try_from(content).ok())?;
        if left > most {
            return None;
        }
        let mut frame = Decoder::with_buffer(frame).ok()?.single_frame();
        frame.window_log_max(MAX_WINDOW_LOG).ok()?;
        let buffer = vec![0; BUFFER.min(left + 2 * LONGEST)];
        Some(Self { frame, buffer, from: 0, to: 0, left, ended: false })
    }

    /// Unpacks until a whole value lies in the buffer, or nothing is left.
    fn refill(&mut self) -> Option<()> {
        self.buffer.copy_within(self.from..self.to, 0);
        (self.from, self.to) = (0, self.to - self.from);
        while self.to < LONGEST && !self.ended {
            let read = self.frame.read(&mut self.buffer[self.to..]).ok()?;
            self.ended = read == 0;
            self.left = self.left.checked_sub(read)?;
            self.to += read;
        }
        Some(())
    }

    /// `Some` when nothing is left, neither in the frame nor behind it.
    pub(crate) fn finish(mut self) -> Option<()> {
        self.refill()?;
        let behind = self.frame.finish().fill_buf().ok()?.is_empty();
        (self.to == 0 && behind).then_some(())
    }
}

impl Varints for ColumnReader<'_> {
    fn value(&mut self) -> Option<u64> {
        if self.to - self.from < LONGEST && !self.ended {
            self.refill()?;
        }
        let mut input = VarintReader { rest: &self.buffer[self.from..self.to] };
        let value = input.value()?;
        self.from = self.to - input.rest.len();
        Some(value)
    }

    fn room(&self) -> usize {
        self.left + self.to - self.from
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sealed::compressed;
    use crate::varint::VarintWriter;
    use proptest::prelude::*;

    fn read(frame: &[u8], most: usize) -> Option<Vec<u64>> {
        let mut input = ColumnReader::new(frame, most)?;
        let mut values = Vec::new();
        while input.room() > 0 {
            values.push(input.value()?);
        }
        input.finish().map(|()| values)
    }

    proptest! {
        #[test]
        fn values_come_out_as_they_went_in(
            few in prop::collection::vec(any::<u64>(), 0..50), times in 1..2_000_usize, level in 1..19_i32,
        ) {
            let values = few.repeat(times);
            let mut out = VarintWriter::default();
            out.put_all(values.iter().copied());
            let frame = compressed(&out.bytes, level);
            prop_assert_eq!(read(&frame, out.bytes.len()), Some(values));
            if !out.bytes.is_empty() {
                prop_assert_eq!(read(&frame, out.bytes.len() - 1), None);
                prop_assert_eq!(read(&frame[..frame.len() - 1], out.bytes.len()), None);
            }
            prop_assert_eq!(read(&[&frame[..], &frame[..]].concat(), 2 * out.bytes.len()), None, "one frame only");
        }

        #[test]
        fn garbage_is_refused_without_panic(frame in prop::collection::vec(any::<u8>(), 0..200)) {
            let _ = read(&frame, 1 << 20);
            let _ = read(&[&[0x28, 0xb5, 0x2f, 0xfd][..], &frame].concat(), 1 << 20);
        }
    }

    /// A frame need not say how much it holds: then it is read no farther than allowed.
    #[test]
    fn frames_of_unknown_length_end_where_they_must() {
        let mut values = vec![1_u8; 1 << 20];
        let frame = zstd::stream::encode_all(&values[..], 1).unwrap();
        assert!(matches!(get_frame_content_size(&frame), Ok(None)));
        assert_eq!(read(&frame, values.len() - 1), None);
        values.truncate(3);
        let frame = zstd::stream::encode_all(&values[..], 1).unwrap();
        let mut input = ColumnReader::new(&frame, 100).unwrap();
        assert_eq!(
            [input.value(), input.value(), input.value(), input.value()],
            [Some(1), Some(1), Some(1), None]
        );
        assert_eq!(input.finish(), Some(()));
    }

    #[test]
    fn frames_that_look_back_too_far_are_refused() {
        let values = vec![1_u8; 9 << 20];
        assert!(read(&compressed(&values, 1), values.len()).is_some());
        assert_eq!(read(&compressed(&values, 19), values.len()), None);
    }
}
