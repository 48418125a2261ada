//! What folding makes of a journal stays the same, or `FOLDING` is raised.

use echofix_core::datum::Datum;
use echofix_core::evidence::{CellHits, EvidenceDelta, Pass, TileEvidence};
use echofix_core::geo::{CellIndex, Zone};
use echofix_core::vetting::VettingLimits;

use super::*;
use crate::store::map::policy::FOLDING;

/// Numbers as good as random ones.
fn noise(seed: i64) -> i64 {
    let mixed = (seed as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    ((mixed ^ (mixed >> 29)).wrapping_mul(0xbf58_476d_1ce4_e5b9) >> 40) as i64
}

/// Two fronts with bays of different depths, 120 m long, as a contributor sees them who is off by some cells.
fn street(contributor: u64, [east, north]: [i64; 2]) -> UploadRecord {
    let mut tiles: BTreeMap<TileId, BTreeMap<u32, CellHits>> = BTreeMap::new();
    for (x, side) in (0..1200).flat_map(|x| [(x, -1), (x, 1)]) {
        let depth = 100 + 15 * (noise(side * 1000 + x / 47) % 4);
        let rough = noise(contributor as i64 * 100_000 + 2 * x + side) % 3 - 1;
        let cell = CellIndex { x: 6_000_600 + x + east, y: 33_000_300 + side * depth + rough + north };
        let (id, index) = TileId::locate(Zone::from_epsg(32614).unwrap(), cell);
        tiles.entry(id).or_default().insert(index, CellHits { index, hits: 2, offset_sum: [200, 250] });
    }
    let evidence = |cells: BTreeMap<u32, CellHits>| TileEvidence::of_hits(cells.into_values().collect());
    let tiles: BTreeMap<_, _> = tiles.into_iter().map(|(id, cells)| (id, evidence(cells))).collect();
    let detections = tiles.values().map(TileEvidence::detections).sum();
    UploadRecord {
        id: Uuid::from_u128(contributor.into()),
        pass: Pass { day: 20_000, contributor },
        forget_before: 0,
        declared: None,
        contribution: EvidenceDelta { tiles, detections },
        answer: Vec::new(),
    }
}

/// All numbers of a tile, by no name of the code and in no codec: a rename or another compression is no other map.
fn numbers(id: TileId, tile: &Tile) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut put = |numbers: &[i64]| bytes.extend(numbers.iter().flat_map(|number| number.to_le_bytes()));
    put(&[id.zone.epsg().into(), id.x.into(), id.y.into(), tile.len() as i64]);
    for (index, cell) in tile.cells() {
        let Cell { hits, passes, contributors, presence, first_day, last_day, offset_sum: [x, y] } = *cell;
        put(&[(*index).into(), hits.into(), passes.into(), contributors.into(), presence.into()]);
        put(&[first_day.into(), last_day.into(), x.into(), y.into()]);
    }
    put(&tile.observed().map(i64::from));
    put(&tile.support().map(i64::from));
    let Datum { passes, shift_mm: [east, north], yaw_urad, .. } = tile.datum();
    put(&[passes.into(), east, north, yaw_urad]);
    bytes
}

/// Fails when folding makes something else of the same journal. Where that is meant, raise `FOLDING`, so that maps are
/// folded anew and callers take no version for what it no longer is; and put the new sum here.
#[test]
fn the_same_journal_gives_the_same_map_from_build_to_build() {
    let dir = tempfile::tempdir().unwrap();
    let policy = Policy { vetting: Some(VettingLimits::default()), ..Policy::trusting() };
    let store = EmbeddedStore::open(&Options { policy, ..options(dir.path()) }).unwrap();
    commit_all(&store, &[street(1, [0, 0]), street(2, [2, -1]), street(3, [-1, 2])]);
    caught_up(&store);
    assert_eq!(store.quarantined().unwrap(), []);
    let (mut sum, mut moved) = (0, 0);
    for id in map(&store).into_keys() {
        let tile = store.tile(id).unwrap().unwrap().tile;
        moved += tile.datum().shift_mm[0].abs();
        sum = crc32c::crc32c_append(sum, &numbers(id, &tile));
    }
    assert!(moved > 0, "they were compared with each other");
    assert_eq!((FOLDING, sum), (1, 0x0f15_2f1b), "{sum:#x}");
}
