//! An adaptive binary range coder: bits that are likely take little, whichever they are.
//!
//! The coder of LZMA (Igor Pavlov, after G. N. N. Martin, "Range encoding", 1979), with probabilities that are learnt from counts:
//! exact for the first bits of a context, and then of the last [`MEMORY`] or so. The libraries that do the same are of
//! licences that do not suit, or bring a tower of numerics; it is a screen.

/// Bits of a probability.
const BITS: u32 = 16;
/// Bits of a context that count.
const MEMORY: u16 = 250;
/// A range below this takes another byte.
const TOP: u32 = 1 << 24;

/// What is known of a bit in one context: how likely it is not set.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Likelihood {
    /// In 65536ths.
    unset: u16,
    seen: u16,
}

impl Likelihood {
    /// Of a bit that is not set with a probability, in 65536ths, as well known as after two bits.
    pub(crate) const fn of(unset: u16) -> Self {
        Self { unset, seen: 2 }
    }

    fn learn(&mut self, set: bool) {
        let target = if set { 0_i32 } else { 65535 };
        self.seen = (self.seen + 1).min(MEMORY);
        let moved = i32::from(self.unset) + (target - i32::from(self.unset)) / i32::from(self.seen);
        // Nothing is impossible.
        self.unset = moved.clamp(32, 65535 - 32) as u16;
    }

    fn bound(self, range: u32) -> u32 {
        (range >> BITS) * u32::from(self.unset)
    }
}

/// Writes bits.
pub(crate) struct RangeEncoder {
    low: u64,
    range: u32,
    /// The last byte that a carry may still reach, and how many bytes of ones follow it.
    last: u8,
    ones: u64,
    first: bool,
    bytes: Vec<u8>,
}

impl Default for RangeEncoder {
    fn default() -> Self {
        Self { low: 0, range: u32::MAX, last: 0, ones: 0, first: true, bytes: Vec::new() }
    }
}

impl RangeEncoder {
    /// Writes a bit, and learns from it.
    pub(crate) fn put(&mut self, set: bool, likelihood: &mut Likelihood) {
        let bound = likelihood.bound(self.range);
        if set {
            self.low += u64::from(bound);
            self.range -= bound;
        } else {
            self.range = bound;
        }
        likelihood.learn(set);
        while self.range < TOP {
            self.range <<= 8;
            self.shift();
        }
    }

    fn shift(&mut self) {
        if self.low < 0xff00_0000 || self.low > u64::from(u32::MAX) {
            let carry = (self.low >> 32) as u8;
            if !self.first {
                self.bytes.push(self.last.wrapping_add(carry));
            }
            self.first = false;
            for _ in 0..self.ones {
                self.bytes.push(0xff_u8.wrapping_add(carry));
            }
            self.ones = 0;
            self.last = (self.low >> 24) as u8;
        } else {
            self.ones += 1;
        }
        self.low = (self.low & 0x00ff_ffff) << 8;
    }

    /// The bytes. Zeros at their end are left out: the decoder reads zeros where they end.
    pub(crate) fn finish(mut self) -> Vec<u8> {
        for _ in 0..5 {
            self.shift();
        }
        while self.bytes.last() == Some(&0) {
            self.bytes.pop();
        }
        self.bytes
    }
}

/// Reads what a [`RangeEncoder`] wrote. Of other bytes it makes some bits, and never fails.
pub(crate) struct RangeDecoder<'a> {
    range: u32,
    code: u32,
    bytes: std::slice::Iter<'a, u8>,
}

impl<'a> RangeDecoder<'a> {
    pub(crate) fn new(bytes: &'a [u8]) -> Self {
        let mut decoder = Self { range: u32::MAX, code: 0, bytes: bytes.iter() };
        for _ in 0..4 {
            decoder.shift();
        }
        decoder
    }

    /// Reads a bit, and learns from it as the encoder did.
    pub(crate) fn get(&mut self, likelihood: &mut Likelihood) -> bool {
        let bound = likelihood.bound(self.range);
        let set = self.code >= bound;
        if set {
            self.code -= bound;
            self.range -= bound;
        } else {
            self.range = bound;
        }
        likelihood.learn(set);
        while self.range < TOP {
            self.range <<= 8;
            self.shift();
        }
        set
    }

    fn shift(&mut self) {
        self.code = self.code << 8 | u32::from(self.bytes.next().copied().unwrap_or(0));
    }

    /// Are bytes left that no bit came from?
    pub(crate) fn has_rest(&self) -> bool {
        !self.bytes.as_slice().is_empty()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn coded(bits: &[(usize, bool)]) -> Vec<u8> {
        let mut contexts = [Likelihood::of(1 << 15); 4];
        let mut encoder = RangeEncoder::default();
        for (context, bit) in bits {
            encoder.put(*bit, &mut contexts[*context]);
        }
        encoder.finish()
    }

    proptest! {
        /// Catches: a carry that is lost, a byte too few at the end, encoder and decoder that learn differently.
        #[test]
        fn bits_come_out_as_they_went_in(
            bits in prop::collection::vec((0..4_usize, any::<u8>()), 0..3_000), rarely in 0..=255_u8,
        ) {
            let bits: Vec<_> = bits.into_iter().map(|(context, value)| (context, value > rarely)).collect();
            let bytes = coded(&bits);
            let mut contexts = [Likelihood::of(1 << 15); 4];
            let mut decoder = RangeDecoder::new(&bytes);
            for (context, bit) in bits {
                prop_assert_eq!(decoder.get(&mut contexts[context]), bit);
            }
            prop_assert!(!decoder.has_rest());
        }
    }

    #[test]
    fn what_is_likely_takes_little() {
        let rare: Vec<_> = (0..65_536).map(|i| (0, i % 1_000 == 0)).collect();
        // Entropy 0.0114 bits each: 94 bytes.
        assert!(coded(&rare).len() < 130, "{}", coded(&rare).len());
        let even: Vec<_> = (0..8_000_u32).map(|i| (0, i.wrapping_mul(2_654_435_761) >> 31 == 1)).collect();
        assert!(coded(&even).len() < 1_020, "{}", coded(&even).len());
    }
}
