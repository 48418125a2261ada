//! Parts of an upload, each as large as a batch, and where they lie on the map.

use std::collections::BTreeMap;
use std::sync::Arc;

use nalgebra::Matrix3;

use super::{MapSide, Share};
use crate::align::climb::{self, Summit};
use crate::align::engine::{Engine, Fast, Peak, Question};
use crate::align::score::Field;
use crate::align::thin::{BLOCK_M, Thinner};
use crate::align::view::MapView;
use crate::align::weights::TileWeights;
use crate::align::{Lattice, Prior, Search};
use crate::batch::Batch;
use crate::evidence::{CellHits, OFFSET_STEPS};
use crate::geo::{CELL_M, CELLS_PER_TILE, TileId, Zone};
use crate::pose::Pose2;
use crate::window::Frame;

/// How parts are made and placed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Probing {
    /// Cells farther from a part's middle belong to another part, metres.
    pub extent_m: f64,
    /// Half width of the search, metres.
    pub reach_m: f64,
    /// Half width of the search, radians.
    pub reach_yaw_rad: f64,
    /// Blocks a part must have, for it to tell anything.
    pub min_points: usize,
    /// Independent returns count for this many blocks, where hills are compared.
    pub score_temperature: f64,
    /// The same for the summit's curvature, on squared weights.
    pub temperature: f64,
    /// A place within this distance of where the part is expected, metres, is taken unless another one exceeds it
    /// by [`Probing::min_margin`].
    pub home_m: f64,
    /// The same for the turn, radians.
    pub home_yaw_rad: f64,
    /// Nats by which a place must exceed others to be told from them.
    pub min_margin: f64,
    /// A block lies where the map knows something when a map point is this near, metres.
    pub covered_within_m: f64,
}

impl Default for Probing {
    fn default() -> Self {
        Self {
            extent_m: 45.0,
            reach_m: 6.4,
            reach_yaw_rad: 4_f64.to_radians(),
            min_points: 300,
            score_temperature: 10.0,
            temperature: 2.0,
            home_m: 0.5,
            home_yaw_rad: 1_f64.to_radians(),
            min_margin: 12.0,
            covered_within_m: 2.0,
        }
    }
}

/// A part of an upload.
#[derive(Debug, Clone, PartialEq)]
pub struct Part {
    /// The zone of its cells.
    pub zone: Zone,
    /// Its middle, map metres; turns are about it.
    pub middle: [f64; 2],
    /// Its cells' mean places, map metres from its middle.
    pub points: Vec<[f32; 2]>,
}

/// Where a part lies on the map.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Placement {
    /// How far it lies from where it was expected: what is to be added to its places besides, so that they lie
    /// on the map; metres east and north, radians about its middle.
    pub error: Pose2,
    /// Covariance of (east m, north m, yaw rad); infinite where nothing holds the part.
    pub covariance: Matrix3<f64>,
    /// Blocks it was thinned to.
    pub points: usize,
    /// Share of them near which the map has anything.
    pub coverage: f64,
    /// Score relative to that of a random shift.
    pub contrast: f64,
    /// Log-likelihood by which the place exceeds the next one, nats; negative when it was taken for being the
    /// expected one.
    pub margin: f64,
    /// True when the place lies on the edge of what was searched.
    pub at_edge: bool,
}

/// Cuts an upload of one zone into parts around about every second tile, those with most cells first.
#[must_use]
pub fn parts(shares: &[Share], extent_m: f64) -> Vec<Part> {
    let mut by_cells: Vec<&Share> = shares.iter().filter(|(_, cells)| !cells.is_empty()).collect();
    by_cells.sort_by_key(|(id, cells)| (std::cmp::Reverse(cells.len()), *id));
    let mut chosen: Vec<&Share> = Vec::new();
    for share in by_cells {
        let apart = |other: &&Share| (other.0.x - share.0.x).abs().max((other.0.y - share.0.y).abs()) > 1;
        if chosen.iter().all(apart) {
            chosen.push(share);
        }
    }
    chosen.into_iter().map(|share| part_around(share, shares, extent_m)).collect()
}

fn part_around((id, cells): &Share, shares: &[Share], extent_m: f64) -> Part {
    let (mut sum, count) = ([0.0; 2], cells.len().max(1) as f64);
    for cell in *cells {
        let [x, y] = place(*id, cell);
        sum = [sum[0] + x / count, sum[1] + y / count];
    }
    let [x0, y0] = sum;
    let near = |share: &&Share| {
        let gap = |a: i32, b: i32| f64::from((a - b).abs() - 1) * CELLS_PER_TILE as f64 * CELL_M;
        share.0.zone == id.zone && gap(share.0.x, id.x).max(gap(share.0.y, id.y)) < extent_m
    };
    let mut points = Vec::new();
    for (id, cells) in shares.iter().filter(near) {
        points.extend(cells.iter().filter_map(|cell| {
            let [x, y] = place(*id, cell);
            let (dx, dy) = (x - x0, y - y0);
            (dx * dx + dy * dy <= extent_m * extent_m).then_some([dx as f32, dy as f32])
        }));
    }
    Part { zone: id.zone, middle: sum, points }
}

/// Mean place of a cell's hits, map metres.
fn place(id: TileId, cell: &CellHits) -> [f64; 2] {
    let side = CELLS_PER_TILE as u32;
    let [x0, y0] = id.origin();
    let mean = |sum: u32| (f64::from(sum) / f64::from(cell.hits.max(1)) + 0.5) / f64::from(OFFSET_STEPS);
    let [fx, fy] = cell.offset_sum.map(mean);
    [x0 + (f64::from(cell.index % side) + fx) * CELL_M, y0 + (f64::from(cell.index / side) + fy) * CELL_M]
}

/// One thread's engine and buffers.
#[derive(Default)]
pub struct Prober {
    view: MapView,
    fast: Fast,
    thinner: Thinner,
    thinned: Vec<[f32; 3]>,
    peaks: Vec<Peak>,
    summits: Vec<Summit>,
}

impl Prober {
    /// Places a part on the map, near where it is expected to lie: its own places and `expected`, metres and
    /// radians about its middle. `None` where the map has nothing at all, or the part too few blocks.
    ///
    /// `tiles` keeps the tiles that were asked for, for the next part.
    pub fn place(
        &mut self,
        part: &Part,
        expected: &Pose2,
        map: &dyn MapSide,
        tiles: &mut BTreeMap<TileId, Option<Arc<TileWeights>>>,
        probing: &Probing,
    ) -> Option<Placement> {
        self.thinner.thin(&part.points, probing.extent_m as f32, BLOCK_M, &mut self.thinned);
        if self.thinned.len() < probing.min_points {
            return None;
        }
        let frame = Frame::around(part.zone, part.middle, probing.extent_m, probing.reach_m);
        let known: Vec<_> = frame
            .tiles()
            .filter_map(|id| tiles.entry(id).or_insert_with(|| map.weights(id)).clone())
            .collect();
        if known.is_empty() {
            return None;
        }
        self.view.show(frame, &known);
        let [x, y] = part.middle;
        let prior = Prior {
            pose: Pose2::new(x + expected.x_m, y + expected.y_m, expected.yaw_rad),
            sigma_position_m: probing.reach_m,
            sigma_yaw_rad: probing.reach_yaw_rad,
            scale: 1.0,
        };
        Some(self.placed(&prior, probing))
    }

    fn placed(&mut self, prior: &Prior, probing: &Probing) -> Placement {
        let search = Search { sigmas: 1.0, extent_m: probing.extent_m, ..Search::default() };
        let lattice = Lattice::of(prior, &search);
        // The engine that is asked looks at the thinned points only.
        let batch = Batch::default();
        let (view, thinned) = (&self.view, &self.thinned[..]);
        let question = Question { view, batch: &batch, thinned, prior, search: &search, lattice };
        self.fast.search(&question, &mut self.peaks);
        self.peaks.push(Peak { correction: Pose2::IDENTITY, score: 0, at_edge: false });
        let field = Field::of(view);
        climbed(&field, thinned, prior, &self.peaks, &mut self.summits);
        let (best, margin) = chosen(&self.summits, thinned.len(), search.separation_m, probing);
        let foot = Peak { correction: best.correction, score: 0, at_edge: best.at_edge };
        let sharp = climb::climb(&field.sharpened(), thinned, prior, &foot);
        let (half_m, half_rad) = lattice.half_widths();
        let shift = sharp.correction.x_m.abs().max(sharp.correction.y_m.abs());
        let outside = shift > half_m - CELL_M || sharp.correction.yaw_rad.abs() > half_rad;
        let background = background(&field, thinned, prior, half_m);
        Placement {
            error: sharp.correction,
            covariance: covariance(&sharp, probing.temperature),
            points: thinned.len(),
            coverage: coverage(view, thinned, &prior.corrected(&sharp.correction), probing.covered_within_m),
            contrast: if background > 0.0 { best.score / background } else { 0.0 },
            margin,
            at_edge: best.at_edge || outside,
        }
    }
}

/// A hill with a score this much below the highest one's is not climbed.
const RIVAL: f64 = 0.9;

/// The summits, best first; hills that cannot be rivals keep the score of their foot. The last peak, the expected
/// place, is always climbed: it need not be near a summit.
fn climbed(field: &Field, points: &[[f32; 3]], prior: &Prior, peaks: &[Peak], summits: &mut Vec<Summit>) {
    summits.clear();
    summits.extend(peaks.iter().map(|peak| Summit::foot(field, points, prior, peak)));
    let highest = summits.iter().map(|foot| foot.score).fold(0.0, f64::max);
    for (index, (summit, peak)) in summits.iter_mut().zip(peaks).enumerate() {
        if summit.score > RIVAL * highest || index + 1 == peaks.len() {
            *summit = climb::climb(field, points, prior, peak);
        }
    }
    summits.sort_by(|a, b| b.score.total_cmp(&a.score));
}

/// The expected place unless another one is better by far, else the best one; and by how many nats it exceeds
/// the best one elsewhere.
fn chosen(summits: &[Summit], points: usize, apart_m: f64, probing: &Probing) -> (Summit, f64) {
    let Some(best) = summits.first() else { return (Summit::NONE, 0.0) };
    let nats = points as f64 / probing.score_temperature;
    let expected = |s: &&Summit| {
        s.correction.distance_m(&Pose2::IDENTITY) <= probing.home_m
            && s.correction.yaw_rad.abs() <= probing.home_yaw_rad
    };
    let home = summits.iter().find(expected).filter(|s| nats * (best.score - s.score) < probing.min_margin);
    let here = home.unwrap_or(best);
    let next = summits.iter().find(|s| s.correction.distance_m(&here.correction) >= apart_m);
    (*here, next.map_or(f64::INFINITY, |next| nats * (here.score - next.score)))
}

/// Points that fractions and backgrounds are counted on.
const SAMPLE: usize = 256;

fn sample(points: &[[f32; 3]]) -> impl Iterator<Item = &[f32; 3]> + Clone {
    points.iter().step_by(points.len() / SAMPLE + 1)
}

/// Share of the points near which the map has anything.
fn coverage(view: &MapView, points: &[[f32; 3]], pose: &Pose2, within_m: f64) -> f64 {
    let (mut all, mut covered) = (0_u32, 0_u32);
    for [x, y, _] in sample(points) {
        all += 1;
        let place = pose.transform([f64::from(*x), f64::from(*y)]);
        let nearest = view.tile_below(place).and_then(|tile| tile.points.distance_m(place));
        covered += u32::from(nearest.is_some_and(|d| d <= within_m));
    }
    f64::from(covered) / f64::from(all.max(1))
}

/// The score at a random shift: the mean over a lattice of the search.
fn background(field: &Field, points: &[[f32; 3]], prior: &Prior, half_m: f64) -> f64 {
    let steps = || [-1.0, -0.5, 0.0, 0.5, 1.0].into_iter();
    let shifts = steps().flat_map(|i| steps().map(move |j| Pose2::new(i * half_m, j * half_m, 0.0)));
    let sums = shifts.map(|shift| field.value(sample(points), &prior.corrected(&shift), prior.scale));
    sums.sum::<f64>() / (25 * sample(points).count().max(1)) as f64
}

fn covariance(summit: &Summit, temperature: f64) -> Matrix3<f64> {
    let inverse = summit.information.cholesky().map(|c| c.inverse() * temperature);
    inverse
        .filter(|c| c.iter().all(|v| v.is_finite()))
        .unwrap_or_else(|| Matrix3::from_diagonal_element(f64::INFINITY))
}
