//! Hits smoothed to the sensor's noise, and the weights that their masses become.

use std::f32::consts::{FRAC_1_SQRT_2, LN_2};
use std::sync::LazyLock;

use super::simd::{Isa, Kernel};
use crate::geo::{CELL_M, CELLS_PER_TILE};

/// Standard deviation of the smoothing, metres: about the spread of one structure's returns.
const SIGMA_M: f64 = 0.2;
/// Smoothed mass at which a weight starts to grow like a logarithm. Far below one hit: the true pose then
/// exceeds the candidates elsewhere by more; for the last centimetres the weights are squared (see
/// [`super::score::ScoreField::sharpened`]).
const KNEE: f32 = 0.01;
/// Bytes for a unit of the natural logarithm.
pub const STEPS: f32 = 28.0;

/// The kernel ends this many cells from its centre: at three sigmas.
const REACH: usize = (3.0 * SIGMA_M / CELL_M) as usize;
/// Cells beyond a tile's border whose hits still count within it.
pub(super) const HALO: i64 = REACH as i64 + 1;
/// Steps of a cell to which a kernel's centre is rounded.
const PHASES: usize = 8;
/// Taps of a kernel, those beyond its end being 0: what registers hold without a rest.
const TAPS: usize = 16;
const _: () = assert!(2 * REACH < TAPS);

const SIDE: usize = CELLS_PER_TILE;
/// Cells around the tile that kernels may write to, so that none must be clipped.
const MARGIN: usize = 16;
const _: () = assert!(HALO as usize + REACH <= MARGIN && HALO as usize + TAPS - REACH <= MARGIN + 1);
const STRIDE: usize = SIDE + 2 * MARGIN;

/// A mass and where it lies, in cells from the tile's south-west corner: in the tile, or less than [`HALO`] cells
/// from it.
#[derive(Debug, Clone, Copy)]
pub(super) struct CellMass {
    pub(super) at: [f64; 2],
    pub(super) mass: f32,
}

/// A tile's weights, row-major: [`STEPS`] times `ln(1 + smoothed mass / KNEE)`, rounded.
pub(super) fn weights(masses: &[CellMass]) -> Box<[u8]> {
    Isa::best().run(Weighing { masses })
}

/// Rows that are smoothed at a time: their sums stay in the processor's cache.
const BAND: usize = 64;
/// Columns that are looked at together: where no kernel reached, the weights are 0.
const BLOCK: usize = 16;
const _: () = assert!(SIDE.is_multiple_of(BAND) && MARGIN == BLOCK && TAPS <= BLOCK && STRIDE / BLOCK < 64);

struct Weighing<'a> {
    masses: &'a [CellMass],
}

impl Kernel for Weighing<'_> {
    type Out = Box<[u8]>;

    #[expect(clippy::inline_always, reason = "only what is inlined is compiled for an instruction set")]
    #[inline(always)]
    fn run(self) -> Box<[u8]> {
        let placed: Vec<Placed> = self.masses.iter().map(Placed::new).collect();
        let kernels = &*KERNELS;
        let mut sums = vec![0.0; BAND * STRIDE];
        let mut weights = vec![0; SIDE * SIDE];
        for (band, weights) in weights.chunks_exact_mut(BAND * SIDE).enumerate() {
            let from = MARGIN + band * BAND;
            let mut reached = 0_u64;
            for mass in &placed {
                if mass.row + TAPS > from && mass.row < from + BAND {
                    add(&mut sums, kernels, mass, from);
                    reached |= 1 << (mass.column / BLOCK) | 1 << ((mass.column + TAPS - 1) / BLOCK);
                }
            }
            for block in (0..STRIDE / BLOCK).filter(|block| reached >> block & 1 == 1) {
                weigh_block(&mut sums, weights, block);
            }
        }
        weights.into_boxed_slice()
    }
}

/// A mass with the first row and column of its kernel, counted from the margin's corner.
struct Placed {
    row: usize,
    column: usize,
    phases: [usize; 2],
    knees: f32,
}

impl Placed {
    fn new(mass: &CellMass) -> Self {
        let [x, y] = mass.at.map(|along| along + (MARGIN - REACH) as f64);
        let (column, row) = (x as i32, y as i32);
        // Masked, not clamped: in the cell there are no others.
        let phase =
            |along: f64, cell: i32| ((along - f64::from(cell)) * PHASES as f64) as i32 as usize % PHASES;
        let phases = [phase(x, column), phase(y, row)];
        Self { row: row as usize, column: column as usize, phases, knees: mass.mass / KNEE }
    }
}

/// Adds a mass to the sums of a band's rows, of which `from` is the first. Compiled for an instruction set with what calls
/// it, as are the next ones.
#[expect(clippy::inline_always, reason = "only what is inlined is compiled for an instruction set")]
#[inline(always)]
fn add(sums: &mut [f32], kernels: &[[f32; TAPS]; PHASES], mass: &Placed, from: usize) {
    let [kernel_x, kernel_y] = mass.phases.map(|phase| &kernels[phase % PHASES]);
    for (row, tap_y) in (mass.row..).zip(&kernel_y[..=2 * REACH]) {
        let weight = mass.knees * tap_y;
        // Rows before the band or after it are another band's.
        let at = row.wrapping_sub(from).wrapping_mul(STRIDE).wrapping_add(mass.column);
        if let Some(sums) = sums.get_mut(at..).and_then(|sums| sums.first_chunk_mut::<TAPS>()) {
            sums.iter_mut().zip(kernel_x).for_each(|(sum, tap_x)| *sum += weight * tap_x);
        }
    }
}

/// Makes weights of a block of columns of a band, and its sums 0 again.
#[expect(clippy::inline_always, reason = "only what is inlined is compiled for an instruction set")]
#[inline(always)]
fn weigh_block(sums: &mut [f32], weights: &mut [u8], block: usize) {
    let rows = sums.chunks_exact_mut(STRIDE).zip(weights.chunks_exact_mut(SIDE));
    for (sums, weights) in rows {
        let Some(sums) = sums[block * BLOCK..].first_chunk_mut::<BLOCK>() else { continue };
        // The margin has sums and no weights.
        let within = (block * BLOCK).checked_sub(MARGIN).and_then(|column| weights.get_mut(column..));
        if let Some(weights) = within.and_then(|weights| weights.first_chunk_mut::<BLOCK>()) {
            weights.iter_mut().zip(&*sums).for_each(|(weight, sum)| *weight = byte(*sum));
        }
        *sums = [0.0; BLOCK];
    }
}

/// The weight of a mass in knees. Compiled for an instruction set with what calls it, as is the next one.
#[inline(always)]
fn byte(mass: f32) -> u8 {
    /// Beyond it floats are whole numbers, so that a sum with it is rounded to one, in its last bits.
    const WHOLE: f32 = (1 << (f32::MANTISSA_DIGITS - 1)) as f32;
    ((STEPS * logarithm(1.0 + mass)).min(255.0) + WHOLE).to_bits() as u8
}

/// The natural logarithm to 2e-6, of what is 1 or more: the same bits on every machine, and many at a time.
#[inline(always)]
fn logarithm(value: f32) -> f32 {
    const EXPONENT: u32 = f32::MANTISSA_DIGITS - 1;
    let bits = value.to_bits() as i32;
    let halvings = (bits - FRAC_1_SQRT_2.to_bits() as i32) >> EXPONENT;
    // Between the square roots of 1/2 and of 2.
    let left = f32::from_bits((bits - (halvings << EXPONENT)) as u32);
    // ln x = 2 artanh((x - 1) / (x + 1)), as a series.
    let s = (left - 1.0) / (left + 1.0);
    let square = s * s;
    halvings as f32 * LN_2 + 2.0 * s * (1.0 + square * (1.0 / 3.0 + square * (1.0 / 5.0)))
}

/// Taps of a Gaussian along one axis, its centre in the cell [`REACH`], by phase.
static KERNELS: LazyLock<[[f32; TAPS]; PHASES]> = LazyLock::new(|| {
    std::array::from_fn(|phase| {
        let centre = REACH as f64 + (phase as f64 + 0.5) / PHASES as f64 - 0.5;
        let tap = |i: usize| (-0.5 * ((i as f64 - centre) * CELL_M / SIGMA_M).powi(2)).exp();
        let sum: f64 = (0..=2 * REACH).map(tap).sum();
        std::array::from_fn(|i| if i <= 2 * REACH { (tap(i) / sum) as f32 } else { 0.0 })
    })
});

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn a_byte_is_the_logarithm_rounded(mass in 0.0_f32..1000.0, scale in -6..5_i32) {
            let mass = mass * 10_f32.powi(scale);
            let exact = f64::from(STEPS) * f64::from(mass).ln_1p();
            let byte = f64::from(byte(mass));
            prop_assert!((byte - exact.min(255.0)).abs() <= 0.5 + 1e-4, "{mass}: {byte} for {exact}");
        }

        /// Fails when a sum's order depends on how many floats are added at once.
        #[test]
        fn every_instruction_set_weighs_alike(masses in masses()) {
            let plain = Isa::PLAIN.run(Weighing { masses: &masses });
            for isa in Isa::available() {
                prop_assert!(plain == isa.run(Weighing { masses: &masses }), "{isa:?}");
            }
        }
    }

    /// Masses on and off a tile.
    fn masses() -> impl Strategy<Value = Vec<CellMass>> {
        let (least, end) = (-HALO as f64, (SIDE as i64 + HALO) as f64);
        let masses =
            (least..end, least..end, 0.01_f32..20.0).prop_map(|(x, y, mass)| CellMass { at: [x, y], mass });
        prop::collection::vec(masses, 0..300)
    }

    #[test]
    fn a_mass_is_kept_wherever_it_lies() {
        let (low, high) = (-HALO as f64, (SIDE as i64 + HALO) as f64 - 1e-9);
        for [x, y] in [[low, low], [low, high], [high, low], [high, high], [0.0, 0.0], [300.3, 17.9]] {
            let mut sums = vec![0.0; STRIDE * STRIDE];
            add(&mut sums, &KERNELS, &Placed::new(&CellMass { at: [x, y], mass: 3.0 }), 0);
            let sum: f32 = sums.iter().sum();
            assert!((sum * KNEE - 3.0).abs() < 1e-4, "{x} {y}: {sum}");
        }
    }

    #[test]
    fn what_lies_a_halo_away_does_not_count() {
        let beyond = CellMass { at: [-HALO as f64, 100.0], mass: 1e3 };
        assert!(weights(&[beyond]).iter().all(|weight| *weight == 0));
        let within = CellMass { at: [1.0 - HALO as f64, 100.0], mass: 1e3 };
        assert!(weights(&[within]).iter().any(|weight| *weight > 0));
    }
}
