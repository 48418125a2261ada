//! The inner loop of counting correlation: for many pixels of an image at once, sums over shifts.
//!
//! A point of the batch adds, for every shift, the image's value below it. Shifts along a row of
//! the image are neighbours in memory, so a row of shifts is one strip of bytes, added as a vector.

use super::{Isa, Kernel};

/// Rows that are summed together, so that their sums stay in registers.
const ROWS: usize = 4;
/// Points that a 16-bit sum of bytes can take without overflow.
const CHUNK: usize = 257;

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
    /// True when the strips of a pixel lie inside the image.
    #[must_use]
    pub fn fits(&self, pixel: usize) -> bool {
        // What overflows fits nowhere: the reads below rest on this.
        let rows = self.rows.saturating_sub(1).checked_mul(self.stride);
        let end = rows.and_then(|rows| rows.checked_add(pixel)?.checked_add(WIDTH));
        end.is_some_and(|end| end <= self.image.len())
    }

    /// Adds to `sums[row][column]` the bytes at `pixel + row * stride + column` of every pixel.
    ///
    /// `sums` holds `rows` strips.
    ///
    /// # Panics
    /// When a pixel does not fit.
    pub fn add(&self, isa: Isa, pixels: &[u32], sums: &mut [[u32; WIDTH]]) {
        self.add_means_of::<1>(isa, pixels, sums);
    }

    /// Adds to `sums[row][column]` the rounded means of the bytes of four pixels each: about a quarter of what
    /// [`Strips::add`] adds, at a third of its time. What is left of the pixels, fewer than four, is not counted.
    ///
    /// # Panics
    /// When a pixel does not fit.
    pub fn add_means(&self, isa: Isa, pixels: &[u32], sums: &mut [[u32; WIDTH]]) {
        self.add_means_of::<4>(isa, pixels, sums);
    }

    /// Adds the means of `OF` pixels each, a power of two: of one its bytes.
    fn add_means_of<const OF: usize>(&self, isa: Isa, pixels: &[u32], sums: &mut [[u32; WIDTH]]) {
        assert!(pixels.iter().max().is_none_or(|last| self.fits(*last as usize)), "pixels fit the image");
        for chunk in pixels.chunks(OF * CHUNK) {
            let (groups, _) = chunk.as_chunks::<OF>();
            isa.run(PixelChunk { strips: self, groups, sums: &mut sums[..self.rows] });
        }
    }

    #[expect(clippy::inline_always, reason = "only what is inlined is compiled for an instruction set")]
    #[inline(always)]
    fn add_rows<const ROWS: usize, const OF: usize>(
        &self,
        groups: &[[u32; OF]],
        first: usize,
        sums: &mut [[u32; WIDTH]],
    ) {
        let mut short = [[0_u16; WIDTH]; ROWS];
        for group in groups {
            for (row, short) in short.iter_mut().enumerate() {
                let from = (first + row) * self.stride;
                *short = added(*short, mean_of(group.map(|pixel| self.strip(pixel as usize + from))));
            }
        }
        for (sums, short) in sums.iter_mut().zip(&short) {
            for (sum, short) in sums.iter_mut().zip(short) {
                *sum += u32::from(*short);
            }
        }
    }

    /// The strip from an index on, which is one of a row of a pixel that fits.
    #[expect(clippy::inline_always, reason = "only what is inlined is compiled for an instruction set")]
    #[inline(always)]
    fn strip(&self, from: usize) -> [u8; WIDTH] {
        #[cfg(test)]
        assert!(from + WIDTH <= self.image.len());
        // SAFETY: `add_means_of` found that every pixel fits, so that the strips of all its rows end
        // inside the image; an array of bytes has no alignment.
        unsafe { self.image.as_ptr().add(from).cast::<[u8; WIDTH]>().read() }
    }
}

/// At most [`CHUNK`] groups of pixels, of which the means are added.
struct PixelChunk<'a, const WIDTH: usize, const OF: usize> {
    strips: &'a Strips<'a, WIDTH>,
    groups: &'a [[u32; OF]],
    sums: &'a mut [[u32; WIDTH]],
}

impl<const WIDTH: usize, const OF: usize> Kernel for PixelChunk<'_, WIDTH, OF> {
    type Out = ();

    #[expect(clippy::inline_always, reason = "only what is inlined is compiled for an instruction set")]
    #[inline(always)]
    fn run(self) {
        let mut first = 0;
        for rows in self.sums.chunks_mut(ROWS) {
            match rows.len() {
                3 => self.strips.add_rows::<3, OF>(self.groups, first, rows),
                2 => self.strips.add_rows::<2, OF>(self.groups, first, rows),
                1 => self.strips.add_rows::<1, OF>(self.groups, first, rows),
                _ => self.strips.add_rows::<ROWS, OF>(self.groups, first, rows),
            }
            first += rows.len();
        }
    }
}

/// The mean of strips, a power of two of them, by pairs.
#[expect(clippy::inline_always, reason = "only what is inlined is compiled for an instruction set")]
#[inline(always)]
fn mean_of<const WIDTH: usize, const OF: usize>(mut strips: [[u8; WIDTH]; OF]) -> [u8; WIDTH] {
    let mut left = OF;
    while left > 1 {
        left /= 2;
        for i in 0..left {
            strips[i] = mean(strips[2 * i], strips[2 * i + 1]);
        }
    }
    strips[0]
}

/// Means, a half rounded up: one instruction for a register of bytes. In bytes throughout, for the compiler splits what
/// is wider for a moment.
#[expect(clippy::inline_always, reason = "only what is inlined is compiled for an instruction set")]
#[inline(always)]
fn mean<const WIDTH: usize>(a: [u8; WIDTH], b: [u8; WIDTH]) -> [u8; WIDTH] {
    let mut means = [0; WIDTH];
    for i in 0..WIDTH {
        means[i] = (a[i] | b[i]) - ((a[i] ^ b[i]) >> 1);
    }
    means
}

#[expect(clippy::inline_always, reason = "only what is inlined is compiled for an instruction set")]
#[inline(always)]
fn added<const WIDTH: usize>(mut sums: [u16; WIDTH], strip: [u8; WIDTH]) -> [u16; WIDTH] {
    for i in 0..WIDTH {
        sums[i] += u16::from(strip[i]);
    }
    sums
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Miri takes some ten thousand times as long; fewer pixels than a chunk holds would miss its seam.
    const SEEDS: u64 = if cfg!(miri) { 2 } else { 200 };

    /// Numbers without a library, for Miri reads all of it.
    fn random(state: &mut u64) -> usize {
        *state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (*state >> 33) as usize
    }

    /// Strips of a random image that end with it, and pixels of which one is the last that fits.
    fn every_set_sums_like_the_definition<const WIDTH: usize>(seed: u64) {
        let state = &mut { seed };
        let (stride, rows) = (WIDTH + random(state) % 9, 1 + random(state) % 11);
        let last = random(state) % 40;
        // An allocation of its own, as long as it must be: a read beyond it is one beyond the memory.
        // The largest bytes are those that overflow.
        let byte = |_| if seed.is_multiple_of(4) { 255 } else { random(state) as u8 };
        let image: Box<[u8]> = (0..last + (rows - 1) * stride + WIDTH).map(byte).collect();
        let mut pixels: Vec<u32> = (0..600).map(|_| (random(state) % (last + 1)) as u32).collect();
        pixels[random(state) % 600] = last as u32;
        let strips = Strips::<WIDTH> { image: &image, stride, rows };
        assert!(strips.fits(last) && !strips.fits(last + 1));
        let at = |row: usize, column: usize| {
            let values = pixels.iter().map(|pixel| image[*pixel as usize + row * stride + column]);
            7 + values.map(u32::from).sum::<u32>()
        };
        // 599 are 149 fours and a rest.
        let mean_at = |row: usize, column: usize| {
            let value = |pixel: u32| u32::from(image[pixel as usize + row * stride + column]);
            let mean = |a: u32, b: u32| (a + b).div_ceil(2);
            let fours = pixels[..596].chunks(4).map(|four| {
                let [a, b, c, d] = [0, 1, 2, 3].map(|i: usize| value(four[i]));
                mean(mean(a, b), mean(c, d))
            });
            7 + fours.sum::<u32>()
        };
        for isa in Isa::available() {
            let mut sums = vec![[7_u32; WIDTH]; rows + 1];
            strips.add(isa, &pixels, &mut sums);
            for (row, sums) in sums[..rows].iter().enumerate() {
                assert_eq!(*sums, std::array::from_fn(|column| at(row, column)), "{isa:?}, seed {seed}");
            }
            assert_eq!(sums[rows], [7; WIDTH], "{isa:?} writes no further");
            let mut means = vec![[7_u32; WIDTH]; rows + 1];
            strips.add_means(isa, &pixels[..599], &mut means);
            for (row, means) in means[..rows].iter().enumerate() {
                assert_eq!(
                    *means,
                    std::array::from_fn(|column| mean_at(row, column)),
                    "{isa:?}, seed {seed}"
                );
            }
            assert_eq!(means[rows], [7; WIDTH], "{isa:?} writes no further");
        }
    }

    /// Catches a 16-bit sum that overflows, a row that is left out, and a read beyond the image: that one
    /// under Miri.
    #[test]
    fn sums_are_those_of_the_definition_on_every_instruction_set() {
        for seed in 0..SEEDS {
            every_set_sums_like_the_definition::<16>(seed);
            every_set_sums_like_the_definition::<32>(seed);
        }
    }

    #[test]
    fn what_overflows_does_not_fit() {
        let strips = Strips::<16> { image: &[0; 64], stride: usize::MAX / 2 + 1, rows: 3 };
        assert!(!strips.fits(0));
        assert!(!Strips::<16> { stride: 1, rows: 1, ..strips }.fits(usize::MAX));
    }

    #[test]
    #[should_panic(expected = "pixels fit the image")]
    fn a_pixel_that_does_not_fit_is_not_read() {
        let strips = Strips::<16> { image: &[0; 64], stride: 16, rows: 4 };
        strips.add(Isa::PLAIN, &[0, 1], &mut [[0; 16]; 4]);
    }
}
