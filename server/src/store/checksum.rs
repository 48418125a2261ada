//! Frames that begin with a CRC-32C of their rest.
//!
//! ```text
//! CRC-32C of the context and the rest (4), little-endian | the rest
//! ```
//!
//! The context is not in the frame: what it lies under, such as its key. A sound frame under another one is damage, too.

/// Bytes of the checksum.
pub(super) const SUM: usize = 4;

/// The CRC-32C of some bytes after others.
fn crc(context: &[u8], rest: &[u8]) -> u32 {
    crc32c::crc32c_append(crc32c::crc32c(context), rest)
}

/// Fills in the checksum of a frame, its first four bytes.
pub(super) fn seal(frame: &mut [u8], context: &[u8]) {
    let (sum, rest) = frame.split_at_mut(SUM);
    sum.copy_from_slice(&crc(context, rest).to_le_bytes());
}

/// The rest of a frame whose checksum matches; `None` for any other.
pub(super) fn sealed<'a>(frame: &'a [u8], context: &[u8]) -> Option<&'a [u8]> {
    let (sum, rest) = frame.split_first_chunk::<SUM>()?;
    (u32::from_le_bytes(*sum) == crc(context, rest)).then_some(rest)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn a_changed_frame_or_context_is_noticed(
            rest: Vec<u8>, context: Vec<u8>, at: prop::sample::Index, bit in 0..8_u8, other in 1..=255_u8,
        ) {
            let mut frame = [&[0; SUM][..], &rest].concat();
            seal(&mut frame, &context);
            prop_assert_eq!(sealed(&frame, &context), Some(&rest[..]));
            prop_assert_eq!(sealed(&frame, &[&context[..], &[other]].concat()), None);
            let at = at.index(frame.len());
            frame[at] ^= 1 << bit;
            prop_assert_eq!(sealed(&frame, &context), None);
        }
    }

    #[test]
    fn the_checksum_is_the_standard_one() {
        assert_eq!(crc(b"1234", b"56789"), 0xe306_9283);
        let mut frame = *b"....56789";
        seal(&mut frame, b"1234");
        assert_eq!(frame, *b"\x83\x92\x06\xe356789");
        assert_eq!(sealed(b"...", b""), None);
    }
}
