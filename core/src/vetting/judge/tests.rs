//! Uploads of a street that is made of points.

use std::collections::BTreeMap;
use std::sync::Arc;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::*;
use crate::align::weights::TileWeights;
use crate::datum::{Datum, PoseSigma};
use crate::evidence::{Cell, CellHits, presence};
use crate::geo::{CELL_M, CellIndex, Zone};
use crate::point::MapPoint;
use crate::tile::Tile;
use crate::vetting::moved;

const MIDDLE: MapPoint = MapPoint::new(600_060.0, 3_300_030.0);

type Cells = BTreeMap<TileId, Vec<CellHits>>;

/// Points of a street, metres from its middle: two fronts with bays of different depths, poles, parked cars.
fn street(seed: u64, cars: u64) -> Vec<[f64; 2]> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut points = Vec::new();
    for side in [-1.0, 1.0] {
        let (mut x, mut depth) = (-60.0, 12.0);
        while x < 60.0 {
            x += 0.15;
            if rng.random_bool(0.02) {
                depth = rng.random_range(9.0..15.0);
            }
            points.push([x, side * depth]);
        }
        points.extend((0..15).map(|_| [rng.random_range(-60.0..60.0), side * 8.0]).flat_map(|p| [p; 6]));
    }
    let mut rng = ChaCha8Rng::seed_from_u64(cars);
    for _ in 0..12 {
        let [x, y]: [f64; 2] = [rng.random_range(-60.0..60.0), if rng.random() { 5.0 } else { -5.0 }];
        points.extend((0..30).map(|i| [x + 0.15 * f64::from(i), y]));
    }
    points
}

/// What a vehicle sees of points, with noise and clutter, and with a pose that is off.
fn seen(points: &[[f64; 2]], off: Pose2, noise: u64) -> Cells {
    seen_among(900, points, off, noise)
}

/// The same among so many returns of clutter.
fn seen_among(clutter: usize, points: &[[f64; 2]], off: Pose2, noise: u64) -> Cells {
    let mut rng = ChaCha8Rng::seed_from_u64(noise);
    let mut tiles: BTreeMap<TileId, BTreeMap<u32, CellHits>> = BTreeMap::new();
    let clutter: Vec<[f64; 2]> =
        (0..clutter).map(|_| [rng.random_range(-60.0..60.0), rng.random_range(-20.0..20.0)]).collect();
    for [x, y] in points.iter().chain(points).chain(points).chain(&clutter) {
        let noisy = [x + rng.random_range(-0.3..0.3), y + rng.random_range(-0.3..0.3)];
        let [x, y] = off.transform(noisy);
        let position = MIDDLE.moved(x, y);
        let cell = CellIndex::of(position);
        let (id, index) = TileId::locate(zone(), cell);
        let empty = CellHits { index, hits: 0, offset_sum: [0, 0] };
        let sum = tiles.entry(id).or_default().entry(index).or_insert(empty);
        sum.hits += 1;
        let steps = |value: f64, cell: i64| (((value / CELL_M - cell as f64) * 256.0) as u32).min(255);
        sum.offset_sum[0] += steps(position.x_m, cell.x);
        sum.offset_sum[1] += steps(position.y_m, cell.y);
    }
    tiles.into_iter().map(|(id, cells)| (id, cells.into_values().collect())).collect()
}

fn zone() -> Zone {
    Zone::from_epsg(32614).expect("a zone")
}

struct Map {
    tiles: BTreeMap<TileId, Tile>,
    datum: Datum,
}

impl Map {
    /// The map of what one vehicle saw; `err` is its own offset, by ten passes.
    fn of(cells: &Cells, err: Offset) -> Self {
        let cell = |hit: &CellHits| {
            let (passes, contributors, presence) = (1, 1, presence::ALWAYS);
            let seen = Cell { passes, contributors, presence, ..Cell::default() };
            (hit.index, Cell { hits: hit.hits, offset_sum: hit.offset_sum, ..seen })
        };
        let tile =
            |hits: &Vec<CellHits>| Tile::from_cells(hits.iter().map(cell).collect()).expect("in order");
        let mut datum = Datum::default();
        (0..10).for_each(|_| datum.add(err, PoseSigma::default()));
        Self { tiles: cells.iter().map(|(id, hits)| (*id, tile(hits))).collect(), datum }
    }
}

impl MapSide for Map {
    fn weights(&self, id: TileId) -> Option<Arc<TileWeights>> {
        self.tiles.get(&id)?;
        Some(Arc::new(TileWeights::new(id, |at| self.tiles.get(&at))))
    }

    fn datum(&self, id: TileId) -> Datum {
        if self.tiles.contains_key(&id) { self.datum } else { Datum::default() }
    }
}

fn tile_hits(cells: &Cells) -> Vec<TileHits<'_>> {
    cells.iter().map(|(id, cells)| (*id, &cells[..])).collect()
}

fn vetted(cells: &Cells, map: &Map) -> Vetted {
    Vetter::default().vet(&tile_hits(cells), map, &VettingLimits::default(), Some(PoseSigma::default()))
}

fn true_map() -> Map {
    Map::of(&seen(&street(1, 1), Pose2::IDENTITY, 1), Offset::default())
}

/// The offset in the middle of what agrees.
fn agreed(vetted: &Vetted) -> Pose2 {
    let Vetted::Agrees(offsets) = vetted else { panic!("{vetted:?}") };
    offsets.at(MIDDLE)
}

/// Catches: an offset with the wrong sign or about the wrong position.
#[test]
fn an_honest_upload_agrees_and_lies_on_the_map_once_it_is_moved() {
    let map = true_map();
    let upload = seen(&street(1, 1), Pose2::new(0.2, -0.1, 0.004), 2);
    let first = vetted(&upload, &map);
    let by = agreed(&first);
    // The front hardly determines the shift along itself, which is drawn to zero.
    assert!((-0.22..-0.1).contains(&by.x_m) && (by.y_m - 0.1).abs() < 0.05, "{by:?}");
    assert!((by.yaw_rad + 0.004).abs() < 0.002, "{by:?}");
    let Vetted::Agrees(offsets) = first else { unreachable!("it agreed") };
    let rest = agreed(&vetted(&moved(&tile_hits(&upload), &offsets), &map));
    assert!(rest.x_m.hypot(rest.y_m) < 0.1 && rest.yaw_rad.abs() < 0.001, "{rest:?}");
}

/// Catches: a search that ends within the limit, and an expected position that is preferred to a better one.
#[test]
fn shifts_and_turns_are_quarantined_with_their_size() {
    let map = true_map();
    for (x, y) in [(0.7, 0.0), (0.0, -1.5), (3.0, 2.0), (-5.0, 0.0)] {
        let found = vetted(&seen(&street(1, 1), Pose2::new(x, y, 0.0), 3), &map);
        let Vetted::Quarantined { reason: Reason::Shifted, offset: Some(offset) } = found else {
            panic!("{x} {y}: {found:?}");
        };
        let off = offset.pose();
        assert!((off.x_m + x).hypot(off.y_m + y) < 0.15, "{x} {y}: {off:?}");
    }
    for degrees in [2.0, -3.0_f64] {
        let found = vetted(&seen(&street(1, 1), Pose2::new(0.0, 0.0, degrees.to_radians()), 3), &map);
        assert!(matches!(found, Vetted::Quarantined { reason: Reason::Rotated, .. }), "{degrees}: {found:?}");
    }
}

#[test]
fn another_street_disagrees_and_an_empty_map_says_nothing() {
    let upload = seen(&street(2, 2), Pose2::IDENTITY, 4);
    let found = vetted(&upload, &true_map());
    assert!(matches!(found, Vetted::Quarantined { .. }), "{found:?}");
    let empty = Map { tiles: BTreeMap::new(), datum: Datum::default() };
    let Vetted::New(offsets) = vetted(&upload, &empty) else { panic!("an empty map cannot disagree") };
    assert_eq!(offsets.at(MIDDLE), Pose2::IDENTITY);
}

/// Catches: honest uploads that are kept out where a radar sees much clutter, and there is never a map; and one of another street
/// that hides in it.
#[test]
fn an_honest_upload_agrees_among_clutter_and_another_street_does_not() {
    let among = |points: &[[f64; 2]], off, noise| seen_among(12_000, points, off, noise);
    let map = Map::of(&among(&street(1, 1), Pose2::IDENTITY, 1), Offset::default());
    let by = agreed(&vetted(&among(&street(1, 77), Pose2::new(0.1, 0.1, 0.0), 2), &map));
    assert!((by.x_m + 0.1).hypot(by.y_m + 0.1) < 0.1, "{by:?}");
    for other in 2..8 {
        let found = vetted(&among(&street(other, other), Pose2::IDENTITY, 10 + other), &map);
        assert!(!matches!(found, Vetted::Agrees(_)), "street {other}: {found:?}");
    }
}

/// Catches: a fraction of matched returns as the criterion, which changes in a street would lower.
#[test]
fn other_parked_cars_and_a_building_less_still_agree() {
    let map = true_map();
    let by = agreed(&vetted(&seen(&street(1, 77), Pose2::new(0.1, 0.1, 0.0), 5), &map));
    assert!((by.x_m + 0.1).hypot(by.y_m + 0.1) < 0.06, "{by:?}");
    let mut points = street(1, 77);
    points.retain(|[x, y]| !((-15.0..15.0).contains(x) && *y > 7.0));
    let by = agreed(&vetted(&seen(&points, Pose2::new(0.1, 0.1, 0.0), 6), &map));
    assert!((by.x_m + 0.1).hypot(by.y_m + 0.1) < 0.06, "{by:?}");
}

/// Catches: a limit around the map as it is, and not around the map less its own offset.
#[test]
fn the_crowds_mean_is_what_an_upload_is_held_against() {
    let map = Map::of(
        &seen(&street(1, 1), Pose2::new(0.35, 0.0, 0.0), 1),
        Offset { east_mm: 350, north_mm: 0, yaw_urad: 0 },
    );
    let by = agreed(&vetted(&seen(&street(1, 1), Pose2::new(-0.2, 0.0, 0.0), 7), &map));
    assert!((0.45..0.6).contains(&by.x_m) && by.y_m.abs() < 0.05, "{by:?}");
    let found = vetted(&seen(&street(1, 1), Pose2::new(0.75, 0.0, 0.0), 7), &map);
    let Vetted::Quarantined { reason: Reason::Shifted, offset: Some(offset) } = found else {
        panic!("{found:?}")
    };
    assert!((offset.pose().x_m + 0.75).abs() < 0.15, "{offset:?}");
}

/// Catches: a limit that an honest contributor of declared 0.3 m keeps in four cases of five only, and old uploads that are
/// judged anew.
#[test]
fn what_is_declared_to_be_uncertain_may_be_farther_off() {
    let map = true_map();
    let upload = seen(&street(1, 1), Pose2::new(0.0, -0.75, 0.0), 8);
    let judged =
        |declared| Vetter::default().vet(&tile_hits(&upload), &map, &VettingLimits::default(), declared);
    assert!((agreed(&judged(Some(PoseSigma::declared(0.3, 0.007)))).y_m - 0.75).abs() < 0.1);
    for strict in [None, Some(PoseSigma::default()), Some(PoseSigma::declared(0.03, 0.001))] {
        assert!(matches!(judged(strict), Vetted::Quarantined { reason: Reason::Shifted, .. }), "{strict:?}");
    }
}
