//! LEB128 variable-length integers, the alphabet of tiles, evidence deltas and journal records.

/// Appends values to bytes.
#[derive(Debug, Default)]
pub struct VarintWriter {
    /// What was written so far.
    pub bytes: Vec<u8>,
}

impl VarintWriter {
    /// A value: seven bits a byte, the lowest first.
    pub fn put(&mut self, mut value: u64) {
        while value >= 0x80 {
            self.bytes.push(value as u8 | 0x80);
            value >>= 7;
        }
        self.bytes.push(value as u8);
    }

    /// One value after the other.
    pub fn put_all(&mut self, values: impl Iterator<Item = u64>) {
        values.for_each(|value| self.put(value));
    }

    /// A signed value: small ones of either sign stay short.
    pub fn put_signed(&mut self, value: i64) {
        self.put(((value << 1) ^ (value >> 63)) as u64);
    }

    /// Strictly increasing values, as the distance from the one before (the first from -1), less 1.
    pub fn put_ascending(&mut self, values: impl Iterator<Item = u32>) {
        let mut next = 0;
        for value in values {
            self.put(u64::from(value - next));
            next = value + 1;
        }
    }

    /// The length, then the bytes.
    pub fn put_bytes(&mut self, bytes: &[u8]) {
        self.put(bytes.len() as u64);
        self.bytes.extend_from_slice(bytes);
    }
}

/// Where varints come from; `None` where they end too early or a value does not fit.
///
/// All that says how much follows is held against [`Varints::room`] before anything is allocated for it: the bytes may be
/// a stranger's.
pub trait Varints {
    /// The next value.
    fn value(&mut self) -> Option<u64>;

    /// Bytes that may still come, at most.
    fn room(&self) -> usize;

    /// The next value, if it fits the type.
    fn get<T: TryFrom<u64>>(&mut self) -> Option<T> {
        T::try_from(self.value()?).ok()
    }

    /// What [`VarintWriter::put_signed`] wrote.
    fn get_signed<T: TryFrom<i64>>(&mut self) -> Option<T> {
        let folded = self.value()?;
        T::try_from((folded >> 1) as i64 ^ -((folded & 1) as i64)).ok()
    }

    /// A count of things that take at least so many bytes each: never more than there is room for.
    fn count_of(&mut self, bytes_each: usize) -> Option<usize> {
        self.get().filter(|count| *count <= self.room() / bytes_each)
    }

    /// So many values below `limit`, as [`VarintWriter::put_ascending`] wrote them, after those in `values`.
    fn ascending(&mut self, count: usize, limit: u32, values: &mut Vec<u32>) -> Option<()> {
        if count > self.room() {
            return None;
        }
        let mut next = 0_u32;
        for _ in 0..count {
            let value = next.checked_add(self.get()?).filter(|value| *value < limit)?;
            next = value + 1;
            values.push(value);
        }
        Some(())
    }
}

/// Takes values off bytes; `None` where they end too early or a value does not fit.
#[derive(Debug)]
pub struct VarintReader<'a> {
    /// What is left.
    pub rest: &'a [u8],
}

impl Varints for VarintReader<'_> {
    fn value(&mut self) -> Option<u64> {
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
                return Some(value);
            }
        }
        None
    }

    fn room(&self) -> usize {
        self.rest.len()
    }
}

impl<'a> VarintReader<'a> {
    /// The next value.
    pub fn get<T: TryFrom<u64>>(&mut self) -> Option<T> {
        Varints::get(self)
    }

    /// What [`VarintWriter::put_signed`] wrote.
    pub fn get_signed<T: TryFrom<i64>>(&mut self) -> Option<T> {
        Varints::get_signed(self)
    }

    /// So many bytes as they are.
    pub fn take(&mut self, count: usize) -> Option<&'a [u8]> {
        let (taken, rest) = self.rest.split_at_checked(count)?;
        self.rest = rest;
        Some(taken)
    }

    /// What [`VarintWriter::put_bytes`] wrote.
    pub fn bytes(&mut self) -> Option<&'a [u8]> {
        let count = self.get()?;
        self.take(count)
    }

    /// `Some` when nothing is left.
    #[must_use]
    pub fn finish(&self) -> Option<()> {
        self.rest.is_empty().then_some(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn ascending(input: &mut VarintReader<'_>, count: usize, limit: u32) -> Option<Vec<u32>> {
        let mut values = Vec::new();
        input.ascending(count, limit, &mut values).map(|()| values)
    }

    proptest! {
        #[test]
        fn what_was_put_is_got(
            values: Vec<u64>, signed: Vec<i64>, bytes: Vec<u8>,
            rising in prop::collection::btree_set(0..10_000_u32, 0..20),
        ) {
            let mut out = VarintWriter::default();
            out.put_all(values.iter().copied());
            for value in &signed {
                out.put_signed(*value);
            }
            out.put_bytes(&bytes);
            out.put_ascending(rising.iter().copied());
            let mut input = VarintReader { rest: &out.bytes };
            for value in values {
                prop_assert_eq!(input.get::<u64>(), Some(value));
            }
            for value in signed {
                prop_assert_eq!(input.get_signed::<i64>(), Some(value));
            }
            prop_assert_eq!(input.bytes(), Some(&bytes[..]));
            let rising: Vec<u32> = rising.into_iter().collect();
            prop_assert_eq!(ascending(&mut input, rising.len(), 10_000), Some(rising));
            prop_assert_eq!(input.finish(), Some(()));
        }

        #[test]
        fn any_bytes_are_read_without_harm(bytes: Vec<u8>, count: u32) {
            let mut input = VarintReader { rest: &bytes };
            while input.get::<u32>().is_some() {}
            let _ = ascending(&mut VarintReader { rest: &bytes }, count as usize, 1 << 18);
        }
    }

    #[test]
    fn values_beyond_the_limit_or_the_type_are_refused() {
        let mut out = VarintWriter::default();
        out.put_ascending([3, 9].into_iter());
        assert_eq!(ascending(&mut VarintReader { rest: &out.bytes }, 2, 10), Some(vec![3, 9]));
        assert_eq!(ascending(&mut VarintReader { rest: &out.bytes }, 2, 9), None);
        let mut out = VarintWriter::default();
        out.put(300);
        assert_eq!(VarintReader { rest: &out.bytes }.get::<u8>(), None);
    }
}
