//! Maps made of walls, poles and parked cars.

use super::*;
use crate::datum::MapVariance;
use crate::evidence::{Cell, presence};
use crate::geo::{CellIndex, TileId, Zone};
use crate::tile::Tile;
use std::collections::BTreeMap;
use std::f64::consts::FRAC_PI_2;

const PLACE: MapPoint = MapPoint::new(600_025.0, 3_300_021.0);

/// A map of hits at offsets from the position.
fn map(hits: impl IntoIterator<Item = [f64; 2]>) -> (MapSquare, Vec<Arc<TileWeights>>) {
    let zone = Zone::from_epsg(32614).unwrap();
    let mut tiles = BTreeMap::<TileId, BTreeMap<u32, Cell>>::new();
    for [x, y] in hits {
        let (id, index) = TileId::locate(zone, CellIndex::of(PLACE.moved(x, y)));
        let cell = tiles.entry(id).or_default().entry(index).or_default();
        (cell.hits, cell.passes, cell.contributors) = (cell.hits + 1, 1, 1);
        cell.presence = presence::ALWAYS;
        cell.offset_sum = [128 * cell.hits; 2];
    }
    let tiles: BTreeMap<_, _> =
        tiles.into_iter().map(|(id, c)| (id, Tile::from_cells(c.into_iter().collect()).unwrap())).collect();
    let square = MapSquare::around(zone, PLACE, 50.0, REACH_M);
    let weights = |id: &TileId| Arc::new(TileWeights::new(*id, |at| tiles.get(&at)));
    (square, tiles.keys().map(weights).collect())
}

fn assessed(hits: impl IntoIterator<Item = [f64; 2]>) -> Localizability {
    let (square, tiles) = map(hits);
    Assessor::default().assess(square, &tiles, PLACE, &Search::default(), &Integrity::default())
}

/// Numbers in [0, 1) that have no pattern a search could lock to.
fn noise(seed: u64) -> impl Iterator<Item = f64> {
    let next = |state: &u64| {
        Some(state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407))
    };
    std::iter::successors(Some(seed), next).skip(1).map(|state| (state >> 11) as f64 / (1_u64 << 53) as f64)
}

/// Returns of a wall along x, whose every decimetre answers alike.
fn wall(y: f64, seed: u64) -> impl Iterator<Item = [f64; 2]> {
    let mut noise = noise(seed);
    (0..4000).map(move |_| {
        let mut next = || noise.next().unwrap_or_default();
        [160.0 * (next() - 0.5), y + 0.2 * (next() + next() - 1.0)]
    })
}

/// A pole's returns.
fn pole(at: [f64; 2]) -> impl Iterator<Item = [f64; 2]> {
    (0..12).map(move |i| [at[0] + 0.05 * f64::from(i % 4), at[1] + 0.05 * f64::from(i / 4)])
}

#[test]
fn an_even_wall_is_weak_along_itself() {
    let along_x = assessed(wall(8.0, 1).chain(wall(-9.0, 2)));
    assert!(along_x.weak_direction_rad().abs() < 0.1, "{along_x:?}");
    let floor = Integrity::default().map_variance(&MapVariance { position_m2: 0.0064, yaw_rad2: 0.0 })[0];
    let [along, across] = [0, 1].map(|axis: usize| along_x.covariance[axis][axis] - floor);
    assert!(along > 9.0 * across, "{along_x:?}");
    let along_y = assessed(wall(8.0, 1).chain(wall(-9.0, 2)).map(|[x, y]| [y, x]));
    assert!(along_y.weak_direction_rad().abs() > FRAC_PI_2 - 0.1, "{along_y:?}");
    assert_ne!(along_x.expected(&Integrity::default()), Expected::Usable);
}

#[test]
fn a_corner_with_poles_holds_in_every_direction() {
    let poles = noise(5).zip(noise(6)).take(40).map(|(u, v)| [80.0 * (u - 0.5), 80.0 * (v - 0.5)]);
    let corner = wall(8.0, 1).chain(wall(-12.0, 2).map(|[x, y]| [y, x]));
    let here = assessed(corner.chain(poles.flat_map(pole)));
    assert_eq!(here.expected(&Integrity::default()), Expected::Usable, "{here:?}");
    assert!(here.weakest_m() < 0.2 && here.sigma_yaw_rad() < 0.01, "{here:?}");
}

#[test]
fn what_repeats_is_ambiguous_and_the_rival_is_one_pitch_away() {
    let cars = (-16..=16).flat_map(|k| [4.0, -5.0, 9.0, -10.0].map(|y| [5.0 * f64::from(k), y]));
    let car = |[x, y]: [f64; 2]| {
        (0..200).map(move |i| [x + 0.1 * f64::from(i % 20), y + 1.6 * f64::from(i / 20 % 2)])
    };
    let here = assessed(cars.flat_map(car));
    assert_eq!(here.expected(&Integrity::default()), Expected::Ambiguous, "{here:?}");
    let rival = here.rival.unwrap();
    assert!((rival.x_m.abs() - 5.0).abs() < 0.2 && rival.y_m.abs() < 0.2, "{rival:?}");
}

#[test]
fn nothing_holds_where_nothing_stands() {
    let here = assessed([]);
    assert_eq!((here.points, here.expected(&Integrity::default())), (0, Expected::TooLittleStructure));
    let one = assessed(pole([3.0, 4.0]));
    assert_eq!(one.expected(&Integrity::default()), Expected::TooLittleStructure);
    assert!(one.covariance.iter().flatten().all(|v| v.is_finite()) && one.sigma_yaw_rad() > 0.1, "{one:?}");
}

#[test]
fn the_same_tiles_give_the_same_bits_whatever_was_asked_before() {
    let (square, tiles) = map(wall(8.0, 1));
    let (search, integrity) = (Search::default(), Integrity::default());
    let mut used = Assessor::default();
    let first = used.assess(square, &tiles, PLACE, &search, &integrity);
    used.assess(square, &tiles, PLACE.moved(3.0, 0.0), &search, &integrity);
    assert_eq!(used.assess(square, &tiles, PLACE, &search, &integrity), first);
}
