//! LEB128 variable-length integers, the alphabet of the records.

/// Appends values to bytes.
#[derive(Debug, Default)]
pub(super) struct Writer {
    pub(super) bytes: Vec<u8>,
}

impl Writer {
    pub(super) fn put(&mut self, mut value: u64) {
        while value >= 0x80 {
            self.bytes.push(value as u8 | 0x80);
            value >>= 7;
        }
        self.bytes.push(value as u8);
    }

    /// A signed value: small ones of either sign stay short.
    pub(super) fn put_signed(&mut self, value: i64) {
        self.put(((value << 1) ^ (value >> 63)) as u64);
    }

    /// The length, then the bytes.
    pub(super) fn put_bytes(&mut self, bytes: &[u8]) {
        self.put(bytes.len() as u64);
        self.bytes.extend_from_slice(bytes);
    }
}

/// Takes values off bytes; `None` where they end too early or a value does not fit.
#[derive(Debug)]
pub(super) struct Reader<'a> {
    pub(super) rest: &'a [u8],
}

impl<'a> Reader<'a> {
    pub(super) fn get<T: TryFrom<u64>>(&mut self) -> Option<T> {
        let mut value = 0_u64;
        for shift in (0..64).step_by(7) {
            let (&byte, rest) = self.rest.split_first()?;
            self.rest = rest;
            let bits = u64::from(byte & 0x7f);
            if shift == 63 && bits > 1 {
                return None;
            }
            value |= bits << shift;
            if byte & 0x80 == 0 {
                return T::try_from(value).ok();
            }
        }
        None
    }

    pub(super) fn get_signed<T: TryFrom<i64>>(&mut self) -> Option<T> {
        let folded: u64 = self.get()?;
        T::try_from((folded >> 1) as i64 ^ -((folded & 1) as i64)).ok()
    }

    /// A count of things that take at least one byte each: never more than there are bytes left.
    pub(super) fn count(&mut self) -> Option<usize> {
        self.get().filter(|count| *count <= self.rest.len())
    }

    pub(super) fn take(&mut self, count: usize) -> Option<&'a [u8]> {
        let (taken, rest) = self.rest.split_at_checked(count)?;
        self.rest = rest;
        Some(taken)
    }

    /// What [`Writer::put_bytes`] wrote.
    pub(super) fn bytes(&mut self) -> Option<&'a [u8]> {
        let count = self.get()?;
        self.take(count)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn what_was_put_is_got(values: Vec<u64>, signed: Vec<i64>, bytes: Vec<u8>) {
            let mut out = Writer::default();
            for value in &values {
                out.put(*value);
            }
            for value in &signed {
                out.put_signed(*value);
            }
            out.put_bytes(&bytes);
            let mut input = Reader { rest: &out.bytes };
            for value in values {
                prop_assert_eq!(input.get::<u64>(), Some(value));
            }
            for value in signed {
                prop_assert_eq!(input.get_signed::<i64>(), Some(value));
            }
            prop_assert_eq!(input.bytes(), Some(&bytes[..]));
            prop_assert!(input.rest.is_empty());
        }

        #[test]
        fn any_bytes_are_read_without_harm(bytes: Vec<u8>) {
            let mut input = Reader { rest: &bytes };
            while input.get::<u32>().is_some() {}
        }
    }
}
