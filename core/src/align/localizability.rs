//! How well can a place be told from its surroundings, by the map alone?
//!
//! The map's own structure around a place is taken as a batch that was seen from there, and aligned with
//! the map it comes from: how sharply the score falls off around the true pose is the covariance that a
//! fix there can have, and how far the next hill stays below is how surely it will not be mistaken.
//!
//! 1. Blocks of hits within reach are seen as often as a pass saw them: one vote a block, and no more of
//!    them than a batch has.
//! 2. They scatter as returns do. A map that is matched with itself to the centimetre would tell places
//!    apart by accidents of the one drive it was made from, even along an even wall.
//! 3. Curvature at the true pose gives the covariance, at the temperature of [`Integrity`] and with the
//!    map's own error, as in [`super::verdict`].
//! 4. The best summit elsewhere is the rival; its distance in nats the margin.
//!
//! What the next vehicle meets is worse than that: other cars are parked, odometry has drifted, structure is
//! hidden behind traffic. By how much was measured, and is part of the answer: [`SIGMA_FACTOR`],
//! [`SELF_MATCH_NATS`].

use std::sync::Arc;

use nalgebra::{Matrix3, SymmetricEigen};

use super::aligner::climbed;
use super::climb::Summit;
use super::correlation::Lattice;
use super::engine::{Engine, Fast, Peak, Question};
use super::score::Field;
use super::verdict::Integrity;
use super::view::MapView;
use super::weights::TileWeights;
use super::{Prior, Search};
use crate::batch::Batch;
use crate::pose::Pose2;
use crate::window::Frame;

/// Half width of the search for rivals, metres: what the prior of a vehicle that navigates leaves open.
pub const REACH_M: f64 = 6.0;
/// Half width of the search in heading, radians: what looks alike does so in nearly the same heading.
const REACH_RAD: f64 = 0.06;
/// Points of a batch of 5 s that lie on mapped structure, at most: of 3200 in a town.
const MOST_POINTS: f64 = 1500.0;
/// Share of a pass's hits on a structure that count towards its being seen again. A larger one takes in
/// every accident of the drive that made the map, and towns are no longer told from even walls.
const SHARE: f64 = 0.05;
/// Scatter of returns around the structure they come from, one sigma, metres.
const SCATTER_M: f64 = 0.3;
/// Realised error over the sigma of the self-match: 1.5 at the median and 1.6 at 95 % of the errors of usable
/// fixes in simulated towns, the map's own error apart (`echofix evaluate --only localizability`).
pub const SIGMA_FACTOR: f64 = 1.5;
/// What a self-match is better than its rivals by even where nothing tells places apart, nats: 4 to 20 in the
/// simulated scenes that are made to be mistaken, where fixes realise 0 to 5. In towns self-matches
/// have 46 and more, and fixes about as much.
pub const SELF_MATCH_NATS: f64 = 18.0;
/// Points with which a place is more than a few accidents: an open field has some 150, a street of parked cars 300.
const LEAST_POINTS: usize = 200;
/// Sigma where nothing holds a direction, metres; for the heading, in radians, [`UNHELD_RAD`].
pub const UNHELD_M: f64 = 10.0;
/// Sigma of the heading where nothing holds it, radians.
pub const UNHELD_RAD: f64 = 0.5;

/// What a fix at a place can be expected to be.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Localizability {
    /// Covariance of (east m, north m, yaw rad), the map's own error included.
    pub covariance: [[f64; 3]; 3],
    /// Log-likelihood by which a fix can be expected to exceed the best pose elsewhere, nats; below 0 where even
    /// less than chance tells them apart, infinite without any other.
    pub margin: f64,
    /// Where that pose is: metres east and north of the true one, radians.
    pub rival: Option<Pose2>,
    /// Points that a batch can be expected to have on mapped structure.
    pub points: usize,
}

/// What a fix at a place will most likely be told.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Expected {
    /// It can be used.
    Usable,
    /// A second place looks alike.
    Ambiguous,
    /// Nothing holds it in some direction.
    TooLittleStructure,
}

impl Localizability {
    /// Where nothing stands.
    pub const NONE: Self = Self {
        covariance: [
            [UNHELD_M * UNHELD_M, 0.0, 0.0],
            [0.0, UNHELD_M * UNHELD_M, 0.0],
            [0.0, 0.0, UNHELD_RAD * UNHELD_RAD],
        ],
        margin: 0.0,
        rival: None,
        points: 0,
    };

    /// Sigma of the position along its weakest axis, metres.
    #[must_use]
    pub fn weakest_m(&self) -> f64 {
        self.axes().0.sqrt()
    }

    /// Sigma of the position along its strongest axis, metres.
    #[must_use]
    pub fn strongest_m(&self) -> f64 {
        self.axes().1.max(0.0).sqrt()
    }

    /// Direction of the weakest axis, radians from grid east, in (-pi / 2, pi / 2].
    #[must_use]
    pub fn weak_direction_rad(&self) -> f64 {
        let [[xx, xy, _], [_, yy, _], _] = self.covariance;
        0.5 * (2.0 * xy).atan2(xx - yy)
    }

    /// Sigma of the heading, radians.
    #[must_use]
    pub fn sigma_yaw_rad(&self) -> f64 {
        self.covariance[2][2].sqrt()
    }

    /// Expected distance of a fix from the truth, root mean square, metres.
    #[must_use]
    pub fn sigma_horizontal_m(&self) -> f64 {
        (self.covariance[0][0] + self.covariance[1][1]).sqrt()
    }

    /// What a fix will most likely be told.
    #[must_use]
    pub fn expected(&self, integrity: &Integrity) -> Expected {
        if self.points < LEAST_POINTS || self.weakest_m() > integrity.max_sigma_m {
            Expected::TooLittleStructure
        } else if self.margin < integrity.min_margin {
            Expected::Ambiguous
        } else {
            Expected::Usable
        }
    }

    /// Eigenvalues of the position's covariance, the larger one first.
    fn axes(&self) -> (f64, f64) {
        let [[xx, xy, _], [_, yy, _], _] = self.covariance;
        let (mean, half) = (0.5 * (xx + yy), (0.5 * (xx - yy)).hypot(xy));
        (mean + half, mean - half)
    }
}

/// Assesses places, with the buffers that one thread reuses from place to place.
#[derive(Default)]
pub struct Assessor {
    view: MapView,
    fast: Fast,
    points: Vec<[f32; 3]>,
    peaks: Vec<Peak>,
    summits: Vec<Summit>,
}

impl Assessor {
    /// What a fix at a place (map metres) can be expected to be, from the tiles that exist in a square
    /// around it: it must hold the search's extent and [`REACH_M`] in every direction.
    ///
    /// The same tiles give the same answer, to the bit.
    pub fn assess(
        &mut self,
        frame: Frame,
        tiles: &[Arc<TileWeights>],
        place: [f64; 2],
        search: &Search,
        integrity: &Integrity,
    ) -> Localizability {
        expected_points(tiles, place, search.extent_m, &mut self.points);
        if self.points.is_empty() {
            return Localizability::NONE;
        }
        self.view.show(frame, tiles);
        let prior = Prior {
            pose: Pose2::new(place[0], place[1], 0.0),
            sigma_position_m: REACH_M / search.sigmas,
            sigma_yaw_rad: REACH_RAD / search.sigmas,
            scale: 1.0,
        };
        let (margin, rival) = self.rival(&prior, search, integrity);
        let slope = Field::of(&self.view).sharpened().slope(&self.points, &prior.pose, prior.scale);
        let [xx, xy, yy, xt, yt, tt] = slope.curvature.map(|c| -c / integrity.temperature);
        let mut covariance = held(Matrix3::new(xx, xy, xt, xy, yy, yt, xt, yt, tt)) * SIGMA_FACTOR.powi(2);
        let floor = integrity.map_variance(self.view.typical_passes());
        for (axis, floor) in [floor, floor, integrity.floor_yaw_rad.powi(2)].into_iter().enumerate() {
            covariance[(axis, axis)] += floor;
        }
        Localizability { covariance: covariance.into(), margin, rival, points: self.points.len() }
    }

    /// The best summit elsewhere, and by how many nats the true pose exceeds it.
    fn rival(&mut self, prior: &Prior, search: &Search, integrity: &Integrity) -> (f64, Option<Pose2>) {
        let (field, batch) = (Field::of(&self.view), Batch::default());
        let lattice = Lattice::of(prior, search);
        let question =
            Question { view: &self.view, batch: &batch, thinned: &self.points, prior, search, lattice };
        self.fast.search(&question, &mut self.peaks);
        climbed(&field, &self.points, prior, &self.peaks, &mut self.summits);
        let apart = |s: &&Summit| s.correction.distance_m(&Pose2::IDENTITY) >= search.separation_m;
        let Some(next) = self.summits.iter().find(apart) else { return (f64::INFINITY, None) };
        let here = field.slope(&self.points, &prior.pose, prior.scale).value;
        let above = here - next.score * self.points.len() as f64;
        (above / integrity.score_temperature - SELF_MATCH_NATS, Some(next.correction))
    }
}

/// What a batch can be expected to hold: ground metres from the place, a vote each.
fn expected_points(tiles: &[Arc<TileWeights>], place: [f64; 2], reach_m: f64, out: &mut Vec<[f32; 3]>) {
    out.clear();
    let seen = |hits: f32| 1.0 - (-SHARE * f64::from(hits)).exp();
    let mut near = Vec::new();
    for tile in tiles {
        let corner = tile.id.origin();
        for block in &*tile.blocks {
            let at = [0, 1].map(|axis| corner[axis] + f64::from(block.at[axis]) - place[axis]);
            if at[0].hypot(at[1]) <= reach_m {
                near.push((at, seen(block.hits)));
            }
        }
    }
    let all: f64 = near.iter().map(|(_, seen)| seen).sum();
    let share = (MOST_POINTS / all).min(1.0);
    // Every so often one is due: as many as expected, spread evenly, and the same each time.
    let mut due = 0.5;
    for (at, seen) in near {
        due += share * seen;
        if due >= 1.0 {
            due -= 1.0;
            let [dx, dy] = scatter(out.len());
            out.push([(at[0] + dx) as f32, (at[1] + dy) as f32, 1.0]);
        }
    }
}

/// A sequence of offsets that is normally distributed and has no chance in it.
fn scatter(number: usize) -> [f64; 2] {
    // The R2 sequence: the powers of the plastic number's inverse fill a square most evenly.
    const STEPS: [f64; 2] = [0.754_877_666_246_693, 0.569_840_290_998_053];
    let [u, v] = STEPS.map(|step| (0.5 + step * number as f64).fract());
    let (radius, turn) = (SCATTER_M * (-2.0 * (1.0 - u).ln()).sqrt(), std::f64::consts::TAU * v);
    [radius * turn.cos(), radius * turn.sin()]
}

/// The inverse of an information matrix over (east m, north m, yaw rad); directions that hardly anything
/// holds, or that curve the wrong way, get the sigma of what is not held.
fn held(information: Matrix3<f64>) -> Matrix3<f64> {
    let unit = Matrix3::from_diagonal(&[UNHELD_M, UNHELD_M, UNHELD_RAD].into());
    let SymmetricEigen { eigenvectors, eigenvalues } = SymmetricEigen::new(unit * information * unit);
    let variances = Matrix3::from_diagonal(&eigenvalues.map(|held| held.max(1.0).recip()));
    unit * eigenvectors * variances * eigenvectors.transpose() * unit
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::evidence::{Cell, presence};
    use crate::geo::{CellIndex, TileId, Zone};
    use crate::tile::Tile;
    use std::collections::BTreeMap;
    use std::f64::consts::FRAC_PI_2;

    const PLACE: [f64; 2] = [600_025.0, 3_300_021.0];

    /// A map of hits at offsets from the place.
    fn map(hits: impl IntoIterator<Item = [f64; 2]>) -> (Frame, Vec<Arc<TileWeights>>) {
        let zone = Zone::from_epsg(32614).unwrap();
        let mut tiles = BTreeMap::<TileId, BTreeMap<u32, Cell>>::new();
        for [x, y] in hits {
            let (id, index) = TileId::locate(zone, CellIndex::of([PLACE[0] + x, PLACE[1] + y]));
            let cell = tiles.entry(id).or_default().entry(index).or_default();
            (cell.hits, cell.passes, cell.contributors) = (cell.hits + 1, 1, 1);
            cell.presence = presence::ALWAYS;
            cell.offset_sum = [128 * cell.hits; 2];
        }
        let tiles: BTreeMap<_, _> = tiles
            .into_iter()
            .map(|(id, c)| (id, Tile::from_cells(c.into_iter().collect()).unwrap()))
            .collect();
        let frame = Frame::around(zone, PLACE, 50.0, REACH_M);
        let weights = |id: &TileId| Arc::new(TileWeights::new(*id, |at| tiles.get(&at)));
        (frame, tiles.keys().map(weights).collect())
    }

    fn assessed(hits: impl IntoIterator<Item = [f64; 2]>) -> Localizability {
        let (frame, tiles) = map(hits);
        Assessor::default().assess(frame, &tiles, PLACE, &Search::default(), &Integrity::default())
    }

    /// Numbers in [0, 1) that have no pattern a search could lock to.
    fn noise(seed: u64) -> impl Iterator<Item = f64> {
        let next = |state: &u64| {
            Some(state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407))
        };
        std::iter::successors(Some(seed), next)
            .skip(1)
            .map(|state| (state >> 11) as f64 / (1_u64 << 53) as f64)
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
        let floor = Integrity::default().map_variance(1.0);
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
        assert!(
            one.covariance.iter().flatten().all(|v| v.is_finite()) && one.sigma_yaw_rad() > 0.1,
            "{one:?}"
        );
    }

    #[test]
    fn the_same_tiles_give_the_same_bits_whatever_was_asked_before() {
        let (frame, tiles) = map(wall(8.0, 1));
        let (search, integrity) = (Search::default(), Integrity::default());
        let mut used = Assessor::default();
        let first = used.assess(frame, &tiles, PLACE, &search, &integrity);
        used.assess(frame, &tiles, [PLACE[0] + 3.0, PLACE[1]], &search, &integrity);
        assert_eq!(used.assess(frame, &tiles, PLACE, &search, &integrity), first);
    }
}
