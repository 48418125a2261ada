//! The vehicle layer: a tile in a few hundred bytes, for vehicles that localize from it.
//!
//! A vehicle needs neither days nor passes nor who was where: it needs what stands, and how much of it a pass hits. So a
//! layer keeps masses ([`Cell::mass`]) of wider cells, in few steps, and where bytes are short, only the heaviest of them. It is made of what is served, and what is
//! decoded is a tile again, so that all that works on tiles works on layers.
//!
//! ```text
//! magic "EFV" | format version 1 (1 byte) | CRC-32C of all that follows (4 bytes, LE)
//! | varints: cells along a wide cell's side, steps, newest day, passes, datum, mass of each step | bits
//! ```
//!
//! The bits are those of a [`crate::range_coder`]: for each wide cell, row by row, is it occupied, and if so by which step. What is
//! beside it and below it, and was read before, says how likely that is: things stand in rows.

use super::codec::{datum, put_datum};
use super::{DecodeError, Tile};
use crate::evidence::presence::ALWAYS;
use crate::evidence::{Cell, OFFSET_STEPS};
use crate::geo::CELLS_PER_TILE;
use crate::range_coder::{Likelihood, RangeDecoder, RangeEncoder};
use crate::sealed::SealedFormat;
use crate::varint::{VarintReader, VarintWriter};

const LAYER: SealedFormat = SealedFormat { magic: *b"EFV", version: 1 };
/// Steps of mass at most.
const MAX_STEPS: usize = 15;
/// Passes at most, as a tile's mean.
const MAX_PASSES: u32 = 65_535;
/// Units of a mass on the wire to one doubling; a mass of 1 is [`MASS_ONE`].
const MASS_UNITS: f64 = 16.0;
const MASS_ONE: f64 = 256.0;

/// How coarse a layer is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Grain {
    /// Cells of 10 cm along the side of a wide cell: 1, 2 or 4.
    pub side: usize,
    /// Steps of mass, 1 to 15.
    pub steps: usize,
    /// The fraction of the mass that is kept, the heaviest cells first.
    pub kept: f64,
}

impl Grain {
    /// What the service sends to vehicles: see "Vehicle layer" in `docs/benchmarks/layer.md`.
    pub const VEHICLE: Self = Self { side: 4, steps: 3, kept: 1.0 };
}

/// The bytes of a tile's vehicle layer.
///
/// # Panics
/// When the grain is none of those that [`Grain`] allows.
#[must_use]
pub fn encode_layer(tile: &Tile, grain: &Grain) -> Vec<u8> {
    assert!(
        matches!(grain.side, 1 | 2 | 4) && (1..=MAX_STEPS).contains(&grain.steps),
        "a grain that no layer has: {grain:?}"
    );
    let masses = wide_masses(tile, grain.side);
    let steps = Steps::of(&masses, grain);
    let mut out = VarintWriter::default();
    out.put_all([grain.side, grain.steps].map(|v| v as u64).into_iter());
    out.put(u64::from(tile.newest_day()));
    // What an answer says of the map where a tile knows nothing of its passes.
    out.put(tile.mean_passes().round().clamp(1.0, f64::from(MAX_PASSES)) as u64);
    out.put(u64::from(tile.datum.declared.passes > 0));
    put_datum(&mut out, &tile.datum);
    out.put_all(steps.units.iter().map(|unit| u64::from(*unit)));
    let image: Vec<u8> = masses.iter().map(|mass| steps.step(*mass)).collect();
    let (mut contexts, mut coder) = (Contexts::default(), RangeEncoder::default());
    let wide = CELLS_PER_TILE / grain.side;
    for at in 0..image.len() {
        let near = Near::of(&image, wide, at);
        coder.put(image[at] > 0, contexts.occupied(&near));
        for step in 1..grain.steps as u8 {
            if image[at] < step {
                break;
            }
            coder.put(image[at] > step, contexts.heavier(&near, step));
        }
    }
    out.bytes.extend(coder.finish());
    LAYER.seal(&out.bytes)
}

/// The tile of a layer's bytes: each wide cell as a cell in its middle that weighs what it did. All were seen on the tile's newest day,
/// and nothing is known of blocks.
///
/// # Errors
/// When the bytes are not a layer's, are damaged, or break the format.
pub fn decode_layer(bytes: &[u8]) -> Result<Tile, DecodeError> {
    let mut input = VarintReader { rest: LAYER.unseal(bytes)? };
    layer(&mut input).ok_or(DecodeError::Malformed)
}

fn layer(input: &mut VarintReader<'_>) -> Option<Tile> {
    let side: usize = input.get().filter(|side| matches!(side, 1 | 2 | 4))?;
    let count: usize = input.get().filter(|steps| (1..=MAX_STEPS).contains(steps))?;
    let (day, passes): (u16, u32) =
        (input.get()?, input.get().filter(|passes| (1..=MAX_PASSES).contains(passes))?);
    let has_declared = input.get::<u8>().filter(|declared| *declared < 2)? == 1;
    let datum = datum(input, has_declared)?;
    let masses: Vec<f64> = (0..count).map(|_| input.get().map(mass_of)).collect::<Option<_>>()?;
    let wide = CELLS_PER_TILE / side;
    let (mut contexts, mut coder) = (Contexts::default(), RangeDecoder::new(input.rest));
    let mut image = vec![0_u8; wide * wide];
    for at in 0..image.len() {
        let near = Near::of(&image, wide, at);
        if !coder.get(contexts.occupied(&near)) {
            continue;
        }
        let mut step = 1_u8;
        while usize::from(step) < count && coder.get(contexts.heavier(&near, step)) {
            step += 1;
        }
        image[at] = step;
    }
    if coder.has_rest() {
        return None;
    }
    let mut cells = Vec::with_capacity(image.iter().filter(|step| **step > 0).count());
    let occupied = image.iter().enumerate().filter(|(_, step)| **step > 0);
    cells.extend(
        occupied
            .map(|(at, step)| cell(at % wide, at / wide, side, masses[usize::from(*step) - 1], passes, day)),
    );
    let tile = Tile::from_cells(cells)?;
    Some(Tile { datum, ..tile })
}

/// A cell in the middle of a wide one, of a mass.
fn cell(x: usize, y: usize, side: usize, mass: f64, passes: u32, day: u16) -> (u32, Cell) {
    let half = side / 2;
    let index = (y * side + half) * CELLS_PER_TILE + x * side + half;
    let of_a_pass = mass.ceil().clamp(1.0, 255.0) as u32;
    let hits = of_a_pass * passes;
    // The middle of four cells is a corner of the last of them.
    let offset = if side == 1 { OFFSET_STEPS / 2 } else { 0 };
    let presence = (mass / f64::from(of_a_pass) * f64::from(ALWAYS)).round().clamp(1.0, f64::from(ALWAYS));
    let cell = Cell {
        hits,
        passes,
        contributors: 0,
        presence: presence as u16,
        first_day: day,
        last_day: day,
        offset_sum: [hits * offset; 2],
    };
    (index as u32, cell)
}

/// The masses of wide cells, row by row.
fn wide_masses(tile: &Tile, side: usize) -> Vec<f32> {
    let wide = CELLS_PER_TILE / side;
    let mut masses = vec![0.0_f32; wide * wide];
    for (index, cell) in &tile.cells {
        let (x, y) = (*index as usize % CELLS_PER_TILE, *index as usize / CELLS_PER_TILE);
        masses[y / side * wide + x / side] += cell.mass() as f32;
    }
    masses
}

/// The masses that are told apart.
struct Steps {
    /// The lightest mass that is kept.
    least: f32,
    /// On the wire, ascending.
    units: Vec<u16>,
}

impl Steps {
    /// Steps of a tile's masses: those that describe the logarithms of the masses that are kept best (Lloyd's algorithm).
    fn of(masses: &[f32], grain: &Grain) -> Self {
        let mut sorted: Vec<f32> = masses.iter().copied().filter(|mass| *mass > 0.0).collect();
        sorted.sort_unstable_by(|a, b| b.total_cmp(a));
        let whole: f64 = sorted.iter().map(|mass| f64::from(*mass)).sum();
        let mut before = 0.0;
        let kept = sorted.iter().take_while(|mass| {
            let kept = before < whole * grain.kept;
            before += f64::from(**mass);
            kept
        });
        let kept = kept.count();
        sorted.truncate(kept);
        let least = sorted.last().copied().unwrap_or(f32::INFINITY);
        let logs: Vec<f64> = sorted.iter().rev().map(|mass| f64::from(*mass).log2()).collect();
        Self { least, units: lloyd(&logs, grain.steps) }
    }

    /// The step of a mass, from 1; 0 where nothing is kept.
    fn step(&self, mass: f32) -> u8 {
        if mass < self.least || mass <= 0.0 {
            return 0;
        }
        let at = units(f64::from(mass).log2());
        let distance = |unit: u16| (f64::from(unit) - at).abs();
        let nearest = (0..self.units.len())
            .min_by(|a, b| distance(self.units[*a]).total_cmp(&distance(self.units[*b])));
        nearest.map_or(0, |step| step as u8 + 1)
    }
}

fn units(log2: f64) -> f64 {
    (log2 * MASS_UNITS + MASS_ONE).clamp(0.0, 65_535.0)
}

fn mass_of(unit: u16) -> f64 {
    ((f64::from(unit) - MASS_ONE) / MASS_UNITS).exp2()
}

/// The means of so many groups of ascending values, on the wire's scale.
fn lloyd(logs: &[f64], count: usize) -> Vec<u16> {
    const ROUNDS: usize = 20;
    let quantile = |k: usize| logs.get((2 * k + 1) * logs.len() / (2 * count)).copied().unwrap_or(0.0);
    let mut means: Vec<f64> = (0..count).map(quantile).collect();
    for _ in 0..ROUNDS {
        let mut from = 0;
        for k in 0..count {
            let end = means.get(k + 1).map(|next| f64::midpoint(means[k], *next));
            let to = end.map_or(logs.len(), |end| logs.partition_point(|log| *log < end)).max(from);
            if to > from {
                means[k] = logs[from..to].iter().sum::<f64>() / (to - from) as f64;
            }
            from = to;
        }
    }
    means.iter().map(|mean| units(*mean).round() as u16).collect()
}

/// What was coded beside a cell: to the west, and in the rows to the south.
struct Near {
    /// The heaviest step of the four that touch it.
    heaviest: u8,
    /// Which of them are occupied, a bit each.
    touching: usize,
    /// How many of those two cells away are.
    beyond: usize,
}

impl Near {
    fn of(image: &[u8], wide: usize, at: usize) -> Self {
        let (x, y) = (at % wide, at / wide);
        let step = |left: isize, down: usize| {
            let x = x.checked_add_signed(left).filter(|x| *x < wide);
            x.zip(y.checked_sub(down)).map_or(0, |(x, y)| image[y * wide + x])
        };
        let touching = [step(-1, 0), step(-1, 1), step(0, 1), step(1, 1)];
        let beyond = [step(-2, 0), step(0, 2), step(-2, 1), step(2, 1), step(-1, 2), step(1, 2)];
        Self {
            heaviest: touching.into_iter().max().unwrap_or(0),
            touching: touching.iter().fold(0, |bits, step| bits << 1 | usize::from(*step > 0)),
            beyond: beyond.iter().filter(|step| **step > 0).count().min(3),
        }
    }
}

/// What has been learnt of the bits.
struct Contexts {
    occupied: [[Likelihood; 4]; 16],
    heavier: [[Likelihood; MAX_STEPS + 1]; MAX_STEPS],
}

impl Default for Contexts {
    fn default() -> Self {
        // Alone, a cell is hardly ever occupied; between others, as often as not.
        let occupied = std::array::from_fn(|touching: usize| {
            std::array::from_fn(|beyond| match touching.count_ones() as usize + beyond {
                0 => Likelihood::of(65_000),
                1 => Likelihood::of(56_000),
                2 => Likelihood::of(50_000),
                _ => Likelihood::of(40_000),
            })
        });
        Self { occupied, heavier: [[Likelihood::of(1 << 15); MAX_STEPS + 1]; MAX_STEPS] }
    }
}

impl Contexts {
    fn occupied(&mut self, near: &Near) -> &mut Likelihood {
        &mut self.occupied[near.touching][near.beyond]
    }

    fn heavier(&mut self, near: &Near, step: u8) -> &mut Likelihood {
        &mut self.heavier[usize::from(step) - 1][usize::from(near.heaviest)]
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::{folded, uploads};
    use super::*;
    use proptest::prelude::*;

    const GRAINS: [Grain; 4] = [
        Grain::VEHICLE,
        Grain { side: 1, steps: 15, kept: 1.0 },
        Grain { side: 2, steps: 3, kept: 0.8 },
        Grain { side: 2, steps: 2, kept: 0.0 },
    ];

    proptest! {
        /// Catches: a mass that lands in another cell, datum or day that are lost, cells kept that are lighter than others left out.
        #[test]
        fn a_layer_holds_the_heaviest_cells(uploads in uploads(), which in 0..GRAINS.len()) {
            let (tile, _) = folded(&uploads);
            let grain = GRAINS[which];
            let layer = decode_layer(&encode_layer(&tile, &grain)).unwrap();
            prop_assert_eq!(layer.datum(), tile.datum());
            prop_assert_eq!(layer.is_empty(), tile.is_empty() || grain.kept == 0.0);
            prop_assert!(layer.is_empty() || layer.newest_day() == tile.newest_day());
            let (before, after) = (wide_masses(&tile, grain.side), wide_masses(&layer, grain.side));
            let (mut least, mut most_left_out, mut kept, mut whole) = (f32::INFINITY, 0.0_f32, 0.0, 0.0);
            for (before, after) in before.iter().zip(&after) {
                whole += before;
                if *after > 0.0 {
                    prop_assert!(*before > 0.0);
                    (least, kept) = (least.min(*before), kept + before);
                } else {
                    most_left_out = most_left_out.max(*before);
                }
            }
            prop_assert!(most_left_out <= least);
            let enough = whole * grain.kept as f32;
            prop_assert!(kept >= enough * 0.999, "{} of {}", kept, whole);
            // Those as heavy as the lightest come along.
            let as_light: f32 = before.iter().filter(|mass| mass.total_cmp(&least).is_eq()).sum();
            prop_assert!(kept <= enough + as_light + whole * 0.001, "{} of {}", kept, whole);
        }

        /// Catches: what a layer is decoded to is made another layer of: a copy of a copy would fade.
        #[test]
        fn a_layer_of_a_layer_is_the_layer(uploads in uploads()) {
            let (tile, _) = folded(&uploads);
            let grain = Grain::VEHICLE;
            let layer = decode_layer(&encode_layer(&tile, &grain)).unwrap();
            let again = decode_layer(&encode_layer(&layer, &grain)).unwrap();
            let cells = |tile: &Tile| tile.cells().iter().map(|(index, _)| *index).collect::<Vec<_>>();
            prop_assert_eq!(cells(&again), cells(&layer));
        }

        #[test]
        fn garbage_is_refused_without_panic(body in prop::collection::vec(any::<u8>(), 0..300)) {
            let _ = decode_layer(&body);
            if let Ok(tile) = decode_layer(&LAYER.seal(&body)) {
                prop_assert!(tile.len() <= 512 * 512);
            }
        }
    }

    #[test]
    fn other_kinds_and_damage_are_told() {
        let layer = encode_layer(&Tile::default(), &Grain::VEHICLE);
        assert_eq!(decode_layer(&layer), Ok(Tile::default()));
        assert_eq!(decode_layer(&super::super::encode(&Tile::default())), Err(DecodeError::NotOurs));
        let mut damaged = layer.clone();
        damaged[9] ^= 1;
        assert_eq!(decode_layer(&damaged), Err(DecodeError::Checksum));
        assert_eq!(decode_layer(&LAYER.seal(&[3, 1, 0, 1])), Err(DecodeError::Malformed));
    }
}
