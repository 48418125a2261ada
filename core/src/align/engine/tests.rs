//! The exact engines find the same maximum, on every instruction set of this machine.

use std::sync::Arc;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::*;
use crate::align::simd::Isa;
use crate::align::thin::Thinner;
use crate::align::view::MapView;
use crate::align::weights::TileWeights;
use crate::align::{Prior, Search};
use crate::batch::Batch;
use crate::evidence::Cell;
use crate::geo::{CELL_M, CellIndex, TileId, Zone};
use crate::point::{BodyPoint, MapPoint, WeightedPoint};
use crate::tile::Tile;
use crate::window::MapSquare;

const EXTENT_M: f64 = 6.0;

/// A small random scene: walls, posts and clutter; a batch that saw a part of it.
struct SearchScene {
    view: MapView,
    batch: Batch,
    thinned: Vec<WeightedPoint>,
    prior: Prior,
    search: Search,
}

impl SearchScene {
    fn new(seed: u64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let zone = Zone::from_epsg(32614).unwrap();
        // Near a corner of a tile, so that several tiles are assembled.
        let corner = TileId::of(zone, MapPoint::new(600_020.0, 3_300_020.0)).origin();
        let truth = Pose2::new(
            corner.x_m + rng.random_range(-3.0..3.0),
            corner.y_m + rng.random_range(-3.0..3.0),
            rng.random_range(-3.0..3.0),
        );
        let structure = structure(&mut rng);
        let on_map: Vec<_> = structure.iter().map(|p| truth.transform(*p).into()).collect();
        let prior = Prior {
            pose: Pose2::new(
                truth.x_m + rng.random_range(-0.8..0.8),
                truth.y_m + rng.random_range(-0.8..0.8),
                truth.yaw_rad + rng.random_range(-0.05..0.05),
            ),
            sigma_position_m: 0.3,
            sigma_yaw_rad: 1_f64.to_radians(),
            scale: 0.9997,
        };
        let search = Search { extent_m: EXTENT_M, ..Search::default() };
        let square = MapSquare::around(zone, MapPoint::of(&prior.pose), EXTENT_M, 0.9);
        let mut view = MapView::default();
        view.assemble(square, &weights(&square, &on_map));
        let seen = structure.iter().filter(|_| rng.random_bool(0.7)).copied().collect::<Vec<_>>();
        let mut noisy = |v: f64| (v + rng.random_range(-0.15..0.15)) as f32;
        let points: Vec<_> = seen.iter().map(|[x, y]| BodyPoint::new(noisy(*x), noisy(*y))).collect();
        let mut thinned = Vec::new();
        Thinner::default().thin(&points, EXTENT_M as f32, 0.4, &mut thinned);
        Self { view, batch: Batch { points, ..Batch::default() }, thinned, prior, search }
    }

    fn question(&self) -> SearchQuestion<'_> {
        SearchQuestion::new(&self.view, &self.batch, &self.thinned, &self.prior, &self.search)
    }
}

/// Points in the body's frame, metres.
fn structure(rng: &mut ChaCha8Rng) -> Vec<[f64; 2]> {
    let mut points = Vec::new();
    for _ in 0..rng.random_range(0..4) {
        let (offset, turned, pitch) =
            (rng.random_range(-5.0..5.0), rng.random_bool(0.5), rng.random_range(0.05..1.5));
        let wall = (0..).map(|i| -5.0 + f64::from(i) * pitch).take_while(|along| *along < 5.0);
        points.extend(wall.map(|along| if turned { [offset, along] } else { [along, offset] }));
    }
    for _ in 0..rng.random_range(5..60) {
        points.push([rng.random_range(-5.5..5.5), rng.random_range(-5.5..5.5)]);
    }
    points
}

fn weights(square: &MapSquare, points: &[MapPoint]) -> Vec<Arc<TileWeights>> {
    let tile = |id: TileId| {
        let mut cells = std::collections::BTreeMap::<u32, Cell>::new();
        for point in points.iter().filter(|p| TileId::of(square.zone, **p) == id) {
            let cell = CellIndex::of(*point);
            let entry = cells.entry(TileId::locate(square.zone, cell).1).or_default();
            entry.hits += 1;
            entry.passes = 1;
            entry.presence = crate::evidence::presence::ALWAYS;
            let fraction = |v: f64, c: i64| (((v / CELL_M) - c as f64) * 256.0) as u32;
            entry.offset_sum[0] += fraction(point.x_m, cell.x).min(255);
            entry.offset_sum[1] += fraction(point.y_m, cell.y).min(255);
        }
        Tile::from_cells(cells.into_iter().collect()).unwrap()
    };
    let tiles: Vec<_> = square.tiles().map(|id| (id, tile(id))).collect();
    let find = |id| tiles.iter().find(|(at, _)| *at == id).map(|(_, tile)| tile);
    tiles.iter().map(|(id, _)| Arc::new(TileWeights::new(*id, find))).collect()
}

fn top(engine: &dyn Engine, workspace: &mut EngineWorkspace, scene: &SearchScene) -> (f64, Pose2) {
    let mut candidates = Vec::new();
    engine.search(&scene.question(), workspace, &mut candidates);
    (candidates[0].score, candidates[0].correction)
}

/// Catches a bound that is one too low, a transform that is too coarse, and scores in another unit.
#[test]
fn exact_engines_find_the_maximum_of_the_reference() {
    let workspace = &mut EngineWorkspace::default();
    for seed in 0..1000 {
        let scene = SearchScene::new(seed);
        let expected = top(&Reference::default(), workspace, &scene);
        assert_eq!(top(&Fft, workspace, &scene), expected, "fft, seed {seed}");
        assert_eq!(top(&Bounded::BEST, workspace, &scene), expected, "bounded, seed {seed}");
    }
}

#[test]
fn every_instruction_set_gives_the_same_bits() {
    let workspace = &mut EngineWorkspace::default();
    for seed in 2000..2100 {
        let scene = SearchScene::new(seed);
        let mut answer = |isa| {
            let mut candidates = Vec::new();
            Fast::on(isa).search(&scene.question(), workspace, &mut candidates);
            (candidates, top(&Bounded::on(isa), workspace, &scene))
        };
        let answers: Vec<_> = Isa::available().into_iter().map(&mut answer).collect();
        assert!(answers.iter().all(|a| *a == answers[0]), "seed {seed}: {answers:?}");
    }
}

/// Catches an engine that answers the first of several questions only, or mixes their buffers up.
#[test]
fn many_questions_at_once_are_answered_like_one_after_the_other() {
    let scenes: Vec<_> = (3000..3004).map(SearchScene::new).collect();
    let questions: Vec<_> = scenes.iter().map(SearchScene::question).collect();
    let engines: [&dyn Engine; 4] = [&Fast::BEST, &Bounded::BEST, &Fft, &Reference::default()];
    for engine in engines {
        let mut together = vec![Vec::new(); questions.len()];
        engine.search_all(&questions, &mut EngineWorkspace::default(), &mut together);
        for (question, together) in questions.iter().zip(&together) {
            let mut alone = Vec::new();
            engine.search(question, &mut EngineWorkspace::default(), &mut alone);
            assert!(!alone.is_empty() && alone == *together, "{}", engine.name());
        }
    }
}

/// Catches a score that is a sum: `fast` counts a part of the points, and its sums would be smaller by as much.
#[test]
fn scores_of_all_engines_are_in_one_unit() {
    let workspace = &mut EngineWorkspace::default();
    for seed in 0..50 {
        let scene = SearchScene::new(seed);
        let ((exact, at), (fast, near)) = (top(&Fft, workspace, &scene), top(&Fast::BEST, workspace, &scene));
        assert!(at != near || (0.6..1.7).contains(&(fast / exact)), "seed {seed}: {fast} {exact}");
    }
}

#[test]
fn the_papers_turned_spectrum_comes_near_the_maximum() {
    let workspace = &mut EngineWorkspace::default();
    let mut near = 0;
    for seed in 0..40 {
        let scene = SearchScene::new(seed);
        let (_, exact) = top(&Reference::default(), workspace, &scene);
        let (_, shortcut) = top(&Reference::as_printed(), workspace, &scene);
        near += u32::from(exact.distance_m(&shortcut) < 0.35);
    }
    assert!(near >= 28, "{near} of 40 within 35 cm");
}
