//! How near each other contributors must have hit something for it to be served.

use std::collections::{BTreeMap, BTreeSet};

use echofix_core::agreement::PointIndex;
use echofix_core::geo::{CELL_M, CELLS_PER_TILE, CellIndex, TileId, Zone};
use echofix_core::tile::Tile;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use serde::Serialize;

use super::fixes::{Summary, fixes};
use super::map::CrowdMap;
use super::town::{self, Way};
use super::uploads::{Sending, cut};
use super::{Scale, Told, table};
use crate::evaluate::condition::Experiment;
use crate::evaluate::map::{MapKey, Movers, RadarMap};
use crate::evaluate::method::Name;
use crate::evaluate::record::Record;
use crate::evaluate::section::Section;

/// Contributors of the maps.
const CROWDS: [u64; 4] = [3, 5, 10, 20];
/// Contributors that must have told of a place.
const LEAST: usize = 3;
/// Places that one contributor makes up, tried in each town.
const MADE_UP: usize = 4000;
/// What lies nearer to anything that stands in the town may be a return of it, metres.
const GENUINE_M: f64 = 0.5;

/// Which hits support a cell.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Rule {
    /// Any.
    Any,
    /// Those in the same block of so many cells.
    Block(i64),
    /// Those in cells not farther off than this along each axis.
    Within(i64),
    /// The same, and not only three contributors' but those of so many in a hundred that were there.
    Share(i64, u8),
}

const RULES: [Rule; 10] = [
    Rule::Any,
    Rule::Block(8),
    Rule::Block(4),
    Rule::Within(2),
    Rule::Within(1),
    Rule::Share(2, 50),
    Rule::Share(2, 40),
    Rule::Share(1, 40),
    Rule::Share(1, 30),
    Rule::Share(1, 20),
];

impl Rule {
    fn words(self) -> String {
        match self {
            Self::Any => "everything".to_owned(),
            Self::Block(cells) => format!("within the same {:.1} m", CELL_M * cells as f64),
            Self::Within(cells) => format!("{cells} cells or less away"),
            Self::Share(cells, percent) => format!("{cells} cells or less away, by {percent} % of all"),
        }
    }

    /// Contributors that must have hit something, of so many.
    fn least(self, contributors: u64) -> usize {
        match self {
            Self::Any => 0,
            Self::Share(_, percent) => {
                LEAST.max((contributors as usize * usize::from(percent)).div_ceil(100))
            }
            _ => LEAST,
        }
    }

    /// Corners of the cells around one that support it.
    fn around(self, cell: (i64, i64)) -> [i64; 4] {
        let (x, y) = cell;
        match self {
            Self::Any => [x, x, y, y],
            Self::Block(side) => {
                let low = |v: i64| v.div_euclid(side) * side;
                [low(x), low(x) + side - 1, low(y), low(y) + side - 1]
            }
            Self::Within(cells) | Self::Share(cells, _) => [x - cells, x + cells, y - cells, y + cells],
        }
    }
}

/// Who hit which cell, counted from the zone's false origin.
#[derive(Default)]
struct Hits(BTreeMap<(i64, i64), BTreeSet<u64>>);

impl Hits {
    fn add(&mut self, id: TileId, index: u32, who: u64) {
        self.0.entry(cell(id, index)).or_default().insert(who);
    }

    fn count(&self, rule: Rule, at: (i64, i64)) -> usize {
        let [x0, x1, y0, y1] = rule.around(at);
        let near = (y0..=y1).flat_map(|y| self.0.range((y, x0)..=(y, x1)).flat_map(|(_, who)| who));
        near.collect::<BTreeSet<_>>().len()
    }
}

fn cell(id: TileId, index: u32) -> (i64, i64) {
    let (first, side) = (id.first_cell(), CELLS_PER_TILE as u32);
    (first.y + i64::from(index / side), first.x + i64::from(index % side))
}

#[derive(Default, Clone)]
struct Outcome {
    served: usize,
    cells: usize,
    phantoms: usize,
    tried: usize,
    fixes: Vec<Record>,
}

fn town(seed: u64, most: usize) -> anyhow::Result<Vec<Vec<Outcome>>> {
    let city = town::small(seed)?;
    let zone = city.site().zone();
    let [.., all] = CROWDS;
    let drive = |who: u64| town::drive(&city, who as u32, Way::Survey, who);
    let drives: Vec<_> = (0..all).into_par_iter().map(drive).collect::<anyhow::Result<_>>()?;
    let localized = town::drive(&city, all as u32 + 3, Way::Survey, 90_000)?;
    let genuine = PointIndex::new(city.structure().reflectors.iter().map(|r| city.site().to_map(r.at)));
    let mut map = CrowdMap::new(zone);
    let mut hits = Hits::default();
    let mut outcomes = Vec::new();
    // Somewhere in the lanes.
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let poses: Vec<_> = localized.truth.iter().collect();
    let grid = echofix_core::geo::Grid::new(zone)?;
    let mut made_up = Vec::new();
    while made_up.len() < MADE_UP {
        let pose = poses[rng.random_range(0..poses.len())];
        let pose = grid.pose_from_geodetic(pose.at, pose.yaw_rad)?;
        let at = pose.transform([0.0, rng.random_range(-3.0..3.0)]);
        if genuine.distance_m(at).is_none_or(|m| m > GENUINE_M) {
            let cell = CellIndex::of(at);
            made_up.push((cell.x, cell.y));
        }
    }
    for (who, drive) in (0..).zip(&drives) {
        for upload in cut(drive, zone, Sending::of(who))? {
            for (id, share) in map.offer(&upload).into_iter().flatten() {
                share.cells.iter().for_each(|cell| hits.add(id, cell.index, who));
            }
        }
        if CROWDS.contains(&(who + 1)) {
            let tiles = map.published(1, None);
            let of =
                |rule: &Rule| outcome((*rule, who + 1), &tiles, &hits, zone, (&localized, most), &made_up);
            outcomes.push(RULES.par_iter().map(of).collect::<anyhow::Result<Vec<_>>>()?);
        }
    }
    Ok(outcomes)
}

fn outcome(
    (rule, contributors): (Rule, u64),
    tiles: &BTreeMap<TileId, Tile>,
    hits: &Hits,
    zone: Zone,
    (localized, most): (&echofix_core::drive::Drive, usize),
    made_up: &[(i64, i64)],
) -> anyhow::Result<Outcome> {
    let mut outcome = Outcome { tried: made_up.len(), ..Outcome::default() };
    let mut served = BTreeMap::new();
    for (id, tile) in tiles {
        let kept = tile.cells().iter().filter(|(index, _)| {
            let (y, x) = cell(*id, *index);
            rule == Rule::Any || hits.count(rule, (x, y)) >= rule.least(contributors)
        });
        let kept: Vec<_> = kept.copied().collect();
        outcome.served += kept.len();
        outcome.cells += tile.len();
        served.extend(Tile::from_cells(kept).map(|tile| (*id, tile)));
    }
    outcome.phantoms =
        made_up.iter().filter(|at| hits.count(rule, **at) + 1 >= rule.least(contributors + 1)).count();
    let key = MapKey { world: 0, contributors: 3, movers: Movers::Dropped };
    outcome.fixes = fixes(&RadarMap::of_tiles(key, zone, served), localized, Name::Echofix, most)?;
    Ok(outcome)
}

#[derive(Serialize)]
struct Line {
    contributors: u64,
    rule: String,
    served: f64,
    made_up: f64,
    #[serde(flatten)]
    summary: Summary,
}

impl Line {
    fn cells(&self) -> String {
        let Self { contributors, rule, served, made_up, summary } = self;
        format!(
            "{contributors} | {rule} | {:.1} % | {:.2} % | {:.1} | {}",
            100.0 * served,
            100.0 * made_up,
            100.0 * summary.p95_m,
            summary.cells()
        )
    }
}

/// The experiment.
///
/// # Errors
/// When a town or a drive cannot be simulated.
pub fn run(scale: &Scale) -> anyhow::Result<Told> {
    let towns = scale.towns(2);
    let most = if scale.quick { 100 } else { 250 };
    let all: Vec<_> = towns.iter().map(|seed| town(*seed, most)).collect::<anyhow::Result<_>>()?;
    let mut lines = Vec::new();
    for (crowd, contributors) in CROWDS.into_iter().enumerate() {
        for (which, rule) in RULES.into_iter().enumerate() {
            let of = || all.iter().map(move |town| &town[crowd][which]);
            let share = |hits: usize, of: usize| hits as f64 / of.max(1) as f64;
            let rows: Vec<Record> = of().flat_map(|o| o.fixes.clone()).collect();
            lines.push(Line {
                contributors,
                rule: rule.words(),
                served: share(of().map(|o| o.served).sum(), of().map(|o| o.cells).sum()),
                made_up: share(of().map(|o| o.phantoms).sum(), of().map(|o| o.tried).sum()),
                summary: Summary::of(&rows),
            });
        }
    }
    let columns = [
        "contributors",
        "hits by three",
        "cells served",
        "made-up cells served",
        "p95",
        "95 %",
        "wrong",
        "usable",
        "wrong usable",
    ];
    let section = Section {
        experiment: Experiment::Support,
        text: format!("### Support\n\n{}", table(&columns, lines.iter().map(Line::cells))),
        figures: Vec::new(),
        data: Some(super::places(towns)),
    };
    Told::new(section, &lines)
}
