//! Sound bytes, changed. Where a checksum would show every change, it is made to match.

use rand::RngExt;
use rand_chacha::ChaCha8Rng;

/// Bytes that numbers and lengths go wrong at.
const EDGES: [u8; 8] = [0, 1, 0x7f, 0x80, 0xff, 0xfe, 0x3f, 0x40];
/// Changes of one input, at most.
const CHANGES: usize = 8;

/// Where an input has its checksum.
#[derive(Debug, Clone, Copy)]
pub enum Seal {
    /// Nowhere, or within what a library reads.
    None,
    /// Evidence, tiles, ledgers: four bytes of kind, the sum of the rest.
    Sealed,
    /// Files of the spool: eight bytes of kind, the sum of the rest, its length.
    Spooled,
    /// Segments of the journal: a header of 32 bytes, then records: length, sum of all but itself, the rest.
    Journal,
}

/// Changes inputs.
pub struct Mutator {
    rng: ChaCha8Rng,
    seal: Seal,
}

impl Mutator {
    pub fn new(rng: ChaCha8Rng, seal: Seal) -> Self {
        Self { rng, seal }
    }

    /// One of the inputs, changed; now and then with a checksum that no longer matches.
    pub fn changed(&mut self, corpus: &[Vec<u8>]) -> Vec<u8> {
        let mut input = corpus[self.rng.random_range(0..corpus.len())].clone();
        for _ in 0..self.rng.random_range(1..=CHANGES) {
            self.change(&mut input, corpus);
        }
        if self.rng.random_range(0..16) != 0 {
            seal(&mut input, self.seal);
        }
        input
    }

    fn change(&mut self, input: &mut Vec<u8>, corpus: &[Vec<u8>]) {
        let at = self.at(input);
        let end = (at + self.rng.random_range(1..64_usize)).min(input.len());
        match self.rng.random_range(0..8) {
            0 if at < input.len() => input[at] ^= 1 << self.rng.random_range(0..8_u32),
            1 if at < input.len() => input[at] = EDGES[self.rng.random_range(0..EDGES.len())],
            2 if at < input.len() => input[at] = self.rng.random(),
            3 => input.truncate(at),
            4 => drop(input.drain(at..end)),
            5 => {
                let edge = EDGES[self.rng.random_range(0..EDGES.len())];
                input[at..end].fill(edge);
            }
            6 => {
                let again = input[at..end].to_vec();
                let times = self.rng.random_range(1..40_usize);
                drop(input.splice(at..at, again.repeat(times)));
            }
            _ => {
                let other = &corpus[self.rng.random_range(0..corpus.len())];
                let from = self.at(other);
                let part = other[from..(from + 64).min(other.len())].to_vec();
                drop(input.splice(at..end, part));
            }
        }
    }

    /// Somewhere in an input, in its head as often as in all the rest.
    fn at(&mut self, input: &[u8]) -> usize {
        let within = if self.rng.random() { input.len().min(64) } else { input.len() };
        self.rng.random_range(0..=within)
    }
}

/// Makes checksums match.
fn seal(input: &mut [u8], seal: Seal) {
    match seal {
        Seal::None => {}
        Seal::Sealed => put_sum(input, 4, 8..),
        Seal::Spooled => {
            let length = input.len().saturating_sub(20) as u64;
            if let Some(place) = input.get_mut(12..20) {
                place.copy_from_slice(&length.to_le_bytes());
            }
            put_sum(input, 8, 20..);
        }
        Seal::Journal => journal(input),
    }
}

fn put_sum(input: &mut [u8], at: usize, of: std::ops::RangeFrom<usize>) {
    let Some(sum) = input.get(of).map(crc32c::crc32c) else { return };
    if let Some(place) = input.get_mut(at..at + 4) {
        place.copy_from_slice(&sum.to_le_bytes());
    }
}

/// The records' sums, as far as their lengths lead.
fn journal(input: &mut [u8]) {
    let mut at = 32;
    while let Some(length) =
        input.get(at..at + 4).and_then(|bytes| bytes.try_into().ok()).map(u32::from_le_bytes)
    {
        let end = at + 24 + length as usize;
        let Some(record) = input.get_mut(at..end) else { return };
        let sum = crc32c::crc32c_append(crc32c::crc32c(&record[..4]), &record[8..]);
        record[4..8].copy_from_slice(&sum.to_le_bytes());
        at = end;
    }
}
