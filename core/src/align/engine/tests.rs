//! The exact engines find the same maximum, on every instruction set of this machine.

use std::sync::Arc;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::*;
use crate::align::simd::Isa;
use crate::align::thin::Thinner;
use crate::align::weights::TileWeights;
use crate::evidence::Cell;
use crate::geo::{CELL_M, CellIndex, TileId, Zone};
use crate::tile::Tile;
use crate::window::Frame;

const EXTENT_M: f64 = 6.0;

/// A small random scene: walls, posts and clutter; a batch that saw some of it, and some that is gone.
struct Scene {
    view: MapView,
    batch: Batch,
    thinned: Vec<[f32; 3]>,
    prior: Prior,
    search: Search,
}

impl Scene {
    fn new(seed: u64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let zone = Zone::from_epsg(32614).unwrap();
        // Near a corner of a tile, so that several tiles are shown.
        let truth = Pose2::new(
            TileId::of(zone, [600_020.0, 3_300_020.0]).origin()[0] + rng.random_range(-3.0..3.0),
            TileId::of(zone, [600_020.0, 3_300_020.0]).origin()[1] + rng.random_range(-3.0..3.0),
            rng.random_range(-3.0..3.0),
        );
        let structure = structure(&mut rng);
        let on_map: Vec<_> = structure.iter().map(|p| truth.transform(*p)).collect();
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
        let frame = Frame::around(zone, [prior.pose.x_m, prior.pose.y_m], EXTENT_M, 0.9);
        let mut view = MapView::default();
        view.show(frame, &weights(&frame, &on_map));
        let seen = structure.iter().filter(|_| rng.random_bool(0.7)).copied().collect::<Vec<_>>();
        let noisy = seen.iter().map(|p| p.map(|v| (v + rng.random_range(-0.15..0.15)) as f32));
        let points: Vec<[f32; 2]> = noisy.collect();
        let mut thinned = Vec::new();
        Thinner::default().thin(&points, EXTENT_M as f32, 0.4, &mut thinned);
        Self { view, batch: Batch { points, ..Batch::default() }, thinned, prior, search }
    }

    fn question(&self) -> Question<'_> {
        Question {
            view: &self.view,
            batch: &self.batch,
            thinned: &self.thinned,
            prior: &self.prior,
            search: &self.search,
            lattice: Lattice::of(&self.prior, &self.search),
        }
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

fn weights(frame: &Frame, points: &[[f64; 2]]) -> Vec<Arc<TileWeights>> {
    let tile = |id: TileId| {
        let mut cells = std::collections::BTreeMap::<u32, Cell>::new();
        for point in points.iter().filter(|p| TileId::of(frame.zone, **p) == id) {
            let cell = CellIndex::of(*point);
            let entry = cells.entry(TileId::locate(frame.zone, cell).1).or_default();
            entry.hits += 1;
            entry.passes = 1;
            entry.presence = crate::evidence::presence::ALWAYS;
            let fraction = |v: f64, c: i64| (((v / CELL_M) - c as f64) * 256.0) as u32;
            entry.offset_sum[0] += fraction(point[0], cell.x).min(255);
            entry.offset_sum[1] += fraction(point[1], cell.y).min(255);
        }
        Tile::from_cells(cells.into_iter().collect()).unwrap()
    };
    let tiles: Vec<_> = frame.tiles().map(|id| (id, tile(id))).collect();
    let find = |id| tiles.iter().find(|(at, _)| *at == id).map(|(_, tile)| tile);
    tiles.iter().map(|(id, _)| Arc::new(TileWeights::new(*id, find))).collect()
}

fn top(engine: &mut dyn Engine, scene: &Scene) -> (u32, Pose2) {
    let mut peaks = Vec::new();
    engine.search(&scene.question(), &mut peaks);
    (peaks[0].score, peaks[0].correction)
}

#[test]
fn exact_engines_find_the_maximum_of_the_reference() {
    let (mut reference, mut fft, mut bounded) = (Reference::default(), Fft::default(), Bounded::default());
    for seed in 0..1000 {
        let scene = Scene::new(seed);
        let expected = top(&mut reference, &scene);
        assert_eq!(top(&mut fft, &scene), expected, "fft, seed {seed}");
        assert_eq!(top(&mut bounded, &scene), expected, "bounded, seed {seed}");
    }
}

#[test]
fn every_instruction_set_gives_the_same_bits() {
    for seed in 2000..2100 {
        let scene = Scene::new(seed);
        let answers: Vec<_> = Isa::available()
            .into_iter()
            .map(|isa| {
                let mut peaks = Vec::new();
                Fast::on(isa).search(&scene.question(), &mut peaks);
                (peaks, top(&mut Bounded::on(isa), &scene))
            })
            .collect();
        assert!(answers.iter().all(|a| *a == answers[0]), "seed {seed}: {answers:?}");
    }
}

#[test]
fn the_papers_turned_spectrum_comes_near_the_maximum() {
    let (mut reference, mut paper) = (Reference::default(), Reference::as_printed());
    let mut near = 0;
    for seed in 0..40 {
        let scene = Scene::new(seed);
        let (_, exact) = top(&mut reference, &scene);
        let (_, shortcut) = top(&mut paper, &scene);
        near += u32::from(exact.distance_m(&shortcut) < 0.35);
    }
    assert!(near >= 28, "{near} of 40 within 35 cm");
}
