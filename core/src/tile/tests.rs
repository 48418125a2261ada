use std::collections::{BTreeMap, BTreeSet};

use proptest::prelude::*;

use super::*;
use crate::evidence::presence::{self, ALWAYS, MEMORY};
use crate::evidence::{CellHits, Pass, TileEvidence, VIEW_BLOCK_CELLS, ViewBlocks};

/// Hits as (index, count), as tile evidence holds them.
pub(crate) fn hits(cells: &BTreeMap<u32, u32>) -> Vec<CellHits> {
    cells
        .iter()
        .map(|(index, hits)| CellHits { index: *index, hits: *hits, offset_sum: [hits * 10, hits * 200] })
        .collect()
}

/// Uploads of few contributors on few days, so that they meet: fewer passes than make a cell fade.
pub(crate) fn uploads() -> impl Strategy<Value = Vec<(Pass, TileEvidence)>> {
    let pass = (20_000..20_003_u16, 0..3_u64).prop_map(|(day, contributor)| Pass { day, contributor });
    let cells = prop::collection::btree_map(0..40_u32, 1..5_u32, 0..12).prop_map(|c| hits(&c));
    let evidence = (cells, prop::collection::vec(0..4_usize, 0..4)).prop_map(|(cells, seen)| {
        let observed = TileEvidence::of_hits(cells.clone()).observed.union(&seen.into_iter().collect());
        TileEvidence { cells, observed }
    });
    prop::collection::vec((pass, evidence), 1..10)
}

pub(crate) fn folded(uploads: &[(Pass, TileEvidence)]) -> (Tile, Ledger) {
    let (mut tile, mut ledger) = (Tile::default(), Ledger::default());
    for (pass, evidence) in uploads {
        tile.fold(&mut ledger, *pass, evidence);
    }
    (tile, ledger)
}

/// A pass over block 0 that hits these cells.
fn look(cells: impl IntoIterator<Item = u32>) -> TileEvidence {
    let cells = hits(&cells.into_iter().map(|index| (index, 1)).collect());
    TileEvidence { cells, observed: [0].into_iter().collect() }
}

/// Passes by contributors that never come again.
fn passes(parts: impl IntoIterator<Item = TileEvidence>) -> Tile {
    let (mut tile, mut ledger) = (Tile::default(), Ledger::default());
    for (contributor, evidence) in (0..).zip(parts) {
        tile.fold(&mut ledger, Pass { day: 20_000, contributor }, &evidence);
    }
    tile
}

/// The tile with all presences put to 0: what does not depend on the order of uploads.
fn without_presence(tile: &Tile) -> Tile {
    let cells = tile.cells.iter().map(|(index, cell)| (*index, Cell { presence: 0, ..*cell }));
    Tile { cells: cells.collect(), ..tile.clone() }
}

/// Evidence that says all that others of the same pass do.
fn together(parts: &[&TileEvidence]) -> TileEvidence {
    let (mut cells, mut observed) = (BTreeMap::<u32, CellHits>::new(), ViewBlocks::default());
    for evidence in parts {
        observed = observed.union(&evidence.observed);
        for hit in &evidence.cells {
            let sum = cells.entry(hit.index).or_insert(CellHits { hits: 0, offset_sum: [0, 0], ..*hit });
            sum.hits += hit.hits;
            sum.offset_sum = [0, 1].map(|axis| sum.offset_sum[axis] + hit.offset_sum[axis]);
        }
    }
    TileEvidence { cells: cells.into_values().collect(), observed }
}

proptest! {
    #[test]
    fn the_order_of_uploads_matters_to_nothing_but_presence(mut uploads in uploads()) {
        let (forward, ledger) = folded(&uploads);
        uploads.reverse();
        let (backward, same) = folded(&uploads);
        prop_assert_eq!(without_presence(&forward), without_presence(&backward));
        prop_assert_eq!(ledger, same);
        // With so few passes it is a mean, and differs by rounding alone.
        for ((_, a), (_, b)) in forward.cells().iter().zip(backward.cells()) {
            prop_assert!(a.presence.abs_diff(b.presence) <= 16, "{} {}", a.presence, b.presence);
        }
    }

    #[test]
    fn passes_contributors_and_days_are_those_that_hit(uploads in uploads()) {
        let (tile, _) = folded(&uploads);
        for (index, cell) in tile.cells() {
            let hitters: BTreeSet<_> =
                uploads.iter().filter(|(_, s)| s.cells.iter().any(|h| h.index == *index)).map(|(p, _)| *p).collect();
            let contributors: BTreeSet<_> = hitters.iter().map(|pass| pass.contributor).collect();
            prop_assert_eq!(cell.passes as usize, hitters.len());
            prop_assert_eq!(usize::from(cell.contributors), contributors.len());
            let days = || hitters.iter().map(|p| p.day);
            prop_assert_eq!(Some(cell.first_day), days().min());
            prop_assert_eq!(Some(cell.last_day), days().max());
            let block = view_block(*index);
            let lookers: BTreeSet<_> = uploads.iter().filter(|(_, s)| s.observed.contains(block)).map(|(p, _)| *p).collect();
            prop_assert_eq!(usize::from(tile.observed()[block]), lookers.len());
            let expected = hitters.len() as f64 / lookers.len() as f64;
            prop_assert!((presence::fraction(cell.presence) - expected).abs() < 5e-4);
        }
    }

    /// Fails when a later upload of a pass counts as another look, or its hits come too late.
    #[test]
    fn uploads_of_one_pass_are_as_one(uploads in uploads(), before in 0..40_u64) {
        let earlier = (0..before).map(|i| (Pass { day: 19_999, contributor: 100 + i }, look([(i % 7) as u32])));
        let pass = Pass { day: 20_001, contributor: 0 };
        let parts: Vec<_> = uploads.iter().map(|(_, evidence)| evidence).collect();
        let apart = earlier.clone().chain(parts.iter().map(|evidence| (pass, (*evidence).clone())));
        let whole = earlier.chain([(pass, together(&parts))]);
        let (apart, _) = folded(&apart.collect::<Vec<_>>());
        let (whole, _) = folded(&whole.collect::<Vec<_>>());
        prop_assert_eq!(without_presence(&apart), without_presence(&whole));
        for ((_, a), (_, b)) in apart.cells().iter().zip(whole.cells()) {
            prop_assert!(a.presence.abs_diff(b.presence) <= 1, "{} {}", a.presence, b.presence);
        }
    }

    #[test]
    fn what_every_pass_hits_is_always_present(count in 1..100_usize) {
        let tile = passes((0..count).map(|_| look([3])));
        prop_assert_eq!(tile.cells()[0].1.presence, ALWAYS);
        prop_assert_eq!(usize::from(tile.observed()[0]), count);
    }

    #[test]
    fn what_has_vanished_fades_steadily_and_is_dropped(stood in 1..60_usize) {
        let mut looks: Vec<_> = (0..stood).map(|_| look([3])).collect();
        let mut before = ALWAYS;
        for gone in 1..=66 {
            looks.push(look([]));
            let tile = passes(looks.iter().cloned());
            let Some((_, cell)) = tile.cells().first() else {
                prop_assert!(gone + stood >= usize::from(MEMORY), "dropped after {} passes", gone);
                return Ok(());
            };
            prop_assert!(cell.presence < before);
            before = cell.presence;
        }
        prop_assert!(false, "it is still there");
    }
}

/// Fails when faded cells stay: there would be thousands.
#[test]
fn a_tile_under_endless_clutter_stays_bounded() {
    let side = VIEW_BLOCK_CELLS as u32;
    let cells_of_block = |i: u32| i % side + i / side % side * CELLS_PER_TILE as u32;
    // A new cell each pass would be 256 different ones after as many passes; the wall is always hit.
    let tile = passes((0..600_u32).map(|i| look([0, cells_of_block(1 + i * 37 % 255)])));
    assert!(tile.len() <= 1 + 23, "{} cells", tile.len());
    assert_eq!(tile.cells()[0].1.presence, ALWAYS);
}

#[test]
fn cells_whose_block_is_not_in_view_stay_as_they_are() {
    let far = TileEvidence { cells: hits(&[(100, 1)].into()), observed: ViewBlocks::default() };
    let tile = passes(std::iter::once(look([3])).chain(std::iter::repeat_n(far, 50)));
    assert_eq!(tile.cells()[0], passes([look([3])]).cells()[0]);
    assert_eq!(tile.observed()[view_block(100)], 50, "a hit block was in view, said or not");
}

#[test]
fn a_cell_that_had_faded_starts_again() {
    let vanished = std::iter::once(look([3])).chain(std::iter::repeat_n(look([]), 40));
    let tile = passes(vanished.chain([look([3])]));
    let (_, cell) = tile.cells()[0];
    assert_eq!((cell.hits, cell.passes, cell.contributors), (1, 1, 1));
    assert_eq!(cell.presence, ALWAYS / MEMORY + 1, "rounded");
}

#[test]
fn cells_out_of_order_do_not_make_a_tile() {
    let cell = Cell::default();
    assert!(Tile::from_cells(vec![(1, cell), (1, cell)]).is_none());
    assert!(Tile::from_cells(vec![(CELLS, cell)]).is_none());
    assert!(Tile::from_cells(vec![(0, cell), (CELLS - 1, cell)]).is_some());
}
