//! The inner loop of counting correlation: for many places of an image at once, sums over shifts.
//!
//! A point of the batch adds, for every shift, the image's value below it. Shifts along a row of
//! the image are neighbours in memory, so a row of shifts is one strip of bytes, added as a vector.

use super::{Isa, Kernel};

/// Rows that are summed together, so that their sums stay in registers.
const ROWS: usize = 4;
/// Points that a 16-bit sum of bytes can take without overflow.
const BLOCK: usize = 257;

/// A grid of shifts over an image of bytes, `WIDTH` to a row.
#[derive(Debug, Clone, Copy)]
pub struct Strips<'a, const WIDTH: usize> {
    /// Row-major.
    pub image: &'a [u8],
    /// Bytes from one row of the image to the next row of shifts.
    pub stride: usize,
    /// Rows of shifts.
    pub rows: usize,
}

impl<const WIDTH: usize> Strips<'_, WIDTH> {
    /// True when the strips of a place lie inside the image.
    #[must_use]
    pub fn fits(&self, place: usize) -> bool {
        place + self.rows.saturating_sub(1) * self.stride + WIDTH <= self.image.len()
    }

    /// Adds to `sums[row][column]` the bytes at `place + row * stride + column` of every place.
    ///
    /// `sums` holds `rows` strips.
    ///
    /// # Panics
    /// When a place does not fit.
    pub fn add(&self, isa: Isa, places: &[u32], sums: &mut [[u32; WIDTH]]) {
        assert!(places.iter().max().is_none_or(|last| self.fits(*last as usize)), "places fit the image");
        for block in places.chunks(BLOCK) {
            isa.run(Block { strips: self, places: block, sums: &mut sums[..self.rows] });
        }
    }

    #[expect(clippy::inline_always, reason = "only what is inlined is compiled for an instruction set")]
    #[inline(always)]
    fn add_rows<const N: usize>(&self, places: &[u32], first: usize, sums: &mut [[u32; WIDTH]]) {
        let mut short = [[0_u16; WIDTH]; N];
        for place in places {
            let from = *place as usize + first * self.stride;
            for (row, short) in short.iter_mut().enumerate() {
                let from = from + row * self.stride;
                debug_assert!(from + WIDTH <= self.image.len());
                // SAFETY: `add` found that every place fits, so that the strips of all its rows end
                // inside the image; an array of bytes has no alignment.
                let strip = unsafe { self.image.as_ptr().add(from).cast::<[u8; WIDTH]>().read() };
                *short = added(*short, strip);
            }
        }
        for (sums, short) in sums.iter_mut().zip(&short) {
            for (sum, short) in sums.iter_mut().zip(short) {
                *sum += u32::from(*short);
            }
        }
    }
}

/// At most [`BLOCK`] places to be added.
struct Block<'a, const WIDTH: usize> {
    strips: &'a Strips<'a, WIDTH>,
    places: &'a [u32],
    sums: &'a mut [[u32; WIDTH]],
}

impl<const WIDTH: usize> Kernel for Block<'_, WIDTH> {
    type Out = ();

    #[expect(clippy::inline_always, reason = "only what is inlined is compiled for an instruction set")]
    #[inline(always)]
    fn run(self) {
        let mut groups = self.sums.chunks_exact_mut(ROWS);
        let mut first = 0;
        for group in &mut groups {
            self.strips.add_rows::<ROWS>(self.places, first, group);
            first += ROWS;
        }
        for row in groups.into_remainder().chunks_exact_mut(1) {
            self.strips.add_rows::<1>(self.places, first, row);
            first += 1;
        }
    }
}

#[expect(clippy::inline_always, reason = "only what is inlined is compiled for an instruction set")]
#[inline(always)]
fn added<const WIDTH: usize>(mut sums: [u16; WIDTH], strip: [u8; WIDTH]) -> [u16; WIDTH] {
    for i in 0..WIDTH {
        sums[i] += u16::from(strip[i]);
    }
    sums
}
