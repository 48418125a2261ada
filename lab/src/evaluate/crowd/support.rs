//! The experiment `support`: how near each other must contributors have hit something for a cell to be served?

use std::collections::{BTreeMap, HashMap};

use echofix_core::agreement::MapPointIndex;
use echofix_core::drive::Drive;
use echofix_core::geo::{CELL_M, CellIndex, Grid, TileId};
use echofix_core::tile::Tile;
use echofix_sim::City;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use serde::Serialize;

use super::fixes::{Summary, fixes};
use super::map::CrowdMap;
use super::town::{self, Way};
use super::uploads::{SentForm, cut};
use super::{CrowdSection, Scale, table};
use crate::evaluate::condition::Experiment;
use crate::evaluate::map::{MapKey, Movers, RadarMap};
use crate::evaluate::method::MethodName;
use crate::evaluate::record::EpochRecord;

/// Numbers of contributors to the maps. Each contributor is a bit of a mask.
const CROWDS: [u32; 4] = [3, 5, 10, 20];
/// Number of contributors that must have hit something near a cell.
const LEAST: u32 = 3;
/// Number of them that must have hit the cell itself, under [`Rule::Own`].
const OWN: u32 = 2;
/// Number of made-up cells in each town.
const MADE_UP: usize = 4000;
/// Largest distance of made-up cells from the middle of the vehicle's path, metres: they lie in the lanes.
const LANES_M: f64 = 3.0;
/// Least distance of made-up cells from anything that stands in the town, metres: nearer hits may be returns of it.
const GENUINE_M: f64 = 0.5;

/// A rule by which a cell is served.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Rule {
    /// Every cell is served.
    Any,
    /// Three contributors hit something in the same block of so many cells along each axis.
    Block(i64),
    /// As [`Rule::Block`], and two of them hit the cell itself.
    Own(i64),
    /// Three contributors hit something in cells at most so many cells away along each axis.
    Within(i64),
    /// As [`Rule::Within`], with so many per cent of all contributors instead of three.
    Fraction(i64, u32),
}

const RULES: [Rule; 9] = [
    Rule::Any,
    Rule::Block(8),
    Rule::Block(4),
    Rule::Own(4),
    Rule::Within(2),
    Rule::Within(1),
    Rule::Fraction(2, 50),
    Rule::Fraction(1, 40),
    Rule::Fraction(1, 20),
];

impl Rule {
    fn words(self) -> String {
        let cm = |cells: i64| (100.0 * CELL_M) as i64 * cells;
        match self {
            Self::Any => "nothing".to_owned(),
            Self::Block(cells) => format!("three in the same block of {} cm", cm(cells)),
            Self::Own(side) => format!("three in the same block of {} cm, two of them in the cell", cm(side)),
            Self::Within(cells) => format!("three in cells {} cm off or less", cm(cells)),
            Self::Fraction(cells, percent) => {
                format!("{percent} % of all, at least three, in cells {} cm off or less", cm(cells))
            }
        }
    }

    /// How many of so many contributors must have hit something near a cell.
    fn least(self, contributors: u32) -> u32 {
        match self {
            Self::Any => 0,
            Self::Fraction(_, percent) => LEAST.max((contributors * percent).div_ceil(100)),
            _ => LEAST,
        }
    }

    /// First and last column, first and last row of the cells whose hits count for a cell.
    fn around(self, CellIndex { x, y }: CellIndex) -> [i64; 4] {
        match self {
            Self::Any => [x, x, y, y],
            Self::Block(side) | Self::Own(side) => {
                let low = |v: i64| v.div_euclid(side) * side;
                [low(x), low(x) + side - 1, low(y), low(y) + side - 1]
            }
            Self::Within(cells) | Self::Fraction(cells, _) => [x - cells, x + cells, y - cells, y + cells],
        }
    }
}

/// The contributors that hit each cell, a bit for each.
#[derive(Default)]
struct Hits(HashMap<(i64, i64), u32>);

impl Hits {
    fn add(&mut self, at: CellIndex, who: u32) {
        *self.0.entry((at.x, at.y)).or_default() |= 1 << who;
    }

    /// Whether a cell is served if so many more contributors hit it.
    fn serves(&self, rule: Rule, least: u32, at: CellIndex, more: u32) -> bool {
        let own = || self.0.get(&(at.x, at.y)).map_or(0, |who| who.count_ones());
        self.count(rule, at) + more >= least && (!matches!(rule, Rule::Own(_)) || own() + more >= OWN)
    }

    /// Number of contributors whose hits count for a cell.
    fn count(&self, rule: Rule, at: CellIndex) -> u32 {
        let [x0, x1, y0, y1] = rule.around(at);
        let cells = (y0..=y1).flat_map(|y| (x0..=x1).map(move |x| (x, y)));
        cells.filter_map(|cell| self.0.get(&cell)).fold(0, |all, who| all | who).count_ones()
    }
}

/// A town, and the drive of a vehicle that does not contribute to its map.
struct SupportVisit {
    city: City,
    drive: Drive,
    /// Largest number of fixes.
    most: usize,
    /// Made-up cells, in the lanes where nothing stands.
    made_up: Vec<CellIndex>,
}

impl SupportVisit {
    fn new(seed: u64, most: usize) -> anyhow::Result<Self> {
        let city = town::small(seed)?;
        let drive = town::drive(&city, CROWDS[CROWDS.len() - 1] + 3, Way::Survey, 90_000)?;
        let genuine =
            MapPointIndex::new(city.structure().reflectors.iter().map(|r| city.site().to_map(r.at)));
        let grid = Grid::new(city.site().zone())?;
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut made_up = Vec::new();
        while made_up.len() < MADE_UP {
            let pose = &drive.truth[rng.random_range(0..drive.truth.len())];
            let pose = grid.pose_from_geodetic(pose.at, pose.yaw_rad)?;
            let at = pose.transform([0.0, rng.random_range(-LANES_M..LANES_M)]).into();
            if genuine.distance_m(at).is_none_or(|m| m > GENUINE_M) {
                made_up.push(CellIndex::of(at));
            }
        }
        Ok(Self { city, drive, most, made_up })
    }

    fn outcome(
        &self,
        rule: Rule,
        contributors: u32,
        tiles: &BTreeMap<TileId, Tile>,
        hits: &Hits,
    ) -> anyhow::Result<SupportOutcome> {
        let least = rule.least(contributors);
        let mut outcome = SupportOutcome { made_up: [0, self.made_up.len()], ..SupportOutcome::default() };
        let mut served = BTreeMap::new();
        for (id, tile) in tiles {
            let is_served = |index: u32| least == 0 || hits.serves(rule, least, id.cell(index), 0);
            let served_cells: Vec<_> =
                tile.cells().iter().filter(|(index, _)| is_served(*index)).copied().collect();
            outcome.served[0] += served_cells.len();
            outcome.served[1] += tile.len();
            served.extend(Tile::from_cells(served_cells).map(|tile| (*id, tile)));
        }
        // The contributor who makes them up is one more.
        let least = rule.least(contributors + 1);
        outcome.made_up[0] = self.made_up.iter().filter(|at| hits.serves(rule, least, **at, 1)).count();
        let key = MapKey { world: 0, contributors: contributors as usize, movers: Movers::Excluded };
        let served = RadarMap::of_tiles(key, self.city.site().zone(), served);
        outcome.fixes = fixes(&served, &self.drive, MethodName::Echofix, self.most)?;
        Ok(outcome)
    }
}

/// The result of a rule.
#[derive(Default)]
struct SupportOutcome {
    /// Number of cells that are served, and of all cells.
    served: [usize; 2],
    /// Number of made-up cells that are served, and of all made-up cells.
    made_up: [usize; 2],
    fixes: Vec<EpochRecord>,
}

/// The results of all rules in a town, by the number of contributors.
fn town(seed: u64, most: usize) -> anyhow::Result<Vec<Vec<SupportOutcome>>> {
    let visit = SupportVisit::new(seed, most)?;
    let zone = visit.city.site().zone();
    let mut map = CrowdMap::new(zone);
    let mut hits = Hits::default();
    let mut outcomes = Vec::new();
    for who in 0..CROWDS[CROWDS.len() - 1] {
        let drive = town::drive(&visit.city, who, Way::Survey, u64::from(who))?;
        for upload in cut(&drive, zone, SentForm::of(u64::from(who)))? {
            for (id, evidence) in map.offer(&upload).into_iter().flatten() {
                evidence.cells.iter().for_each(|hit| hits.add(id.cell(hit.index), who));
            }
        }
        if CROWDS.contains(&(who + 1)) {
            let tiles = map.published(1, None);
            let of = |rule: &Rule| visit.outcome(*rule, who + 1, &tiles, &hits);
            outcomes.push(RULES.par_iter().map(of).collect::<anyhow::Result<_>>()?);
        }
    }
    Ok(outcomes)
}

/// A line of the table.
#[derive(Serialize)]
struct SupportLine {
    contributors: u32,
    rule: String,
    /// Fraction of the cells that are served.
    served: f64,
    /// Fraction of the made-up cells that are served.
    made_up: f64,
    #[serde(flatten)]
    summary: Summary,
}

impl SupportLine {
    fn of(contributors: u32, rule: Rule, outcomes: &[&SupportOutcome]) -> Self {
        let fraction = |of: fn(&SupportOutcome) -> [usize; 2]| {
            let sum = |k: usize| outcomes.iter().map(|outcome| of(outcome)[k]).sum::<usize>();
            sum(0) as f64 / sum(1).max(1) as f64
        };
        let rows: Vec<EpochRecord> = outcomes.iter().flat_map(|outcome| outcome.fixes.clone()).collect();
        Self {
            contributors,
            rule: rule.words(),
            served: fraction(|outcome| outcome.served),
            made_up: fraction(|outcome| outcome.made_up),
            summary: Summary::of(&rows),
        }
    }

    fn cells(&self) -> String {
        let Self { contributors, rule, served, made_up, summary } = self;
        let [served, made_up] = [served, made_up].map(|fraction| format!("{:.1} %", 100.0 * fraction));
        format!("{contributors} | {rule} | {served} | {made_up} | {}", summary.cells())
    }
}

const WORDS: &str = "## Support

A cell is served once three contributors have hit something near it. How near? Where two honest contributors saw clutter, a third can
add a hit that he made up, and a wide rule then serves it. A narrow rule serves less of what really stands. In this experiment each
contributor drives every street, on a day of his own. The made-up cells lie in the lanes, more than 50 cm from anything that stands in
the town. Clutter adds up: the more contributors drive, the less a fixed number of them protects. A fraction of them would always
protect, but the service does not ask for one: it would serve a new building only after most of those who ever drove there had come
again. The service asks for three in the same block of 40 cm. Where six passes had the cell in view, it also asks for two in the cell
itself, so that one contributor alone can get no cell served there.
";

const COLUMNS: [&str; 8] = [
    "contributors",
    "what is asked for",
    "cells served",
    "made-up cells served",
    "95 % of the errors, cm",
    "wrong by > 1 m",
    "usable",
    "wrong, of the usable",
];

/// Runs the experiment.
///
/// # Errors
/// When a town or a drive cannot be simulated.
pub fn run(scale: &Scale) -> anyhow::Result<CrowdSection> {
    let towns = scale.towns(1);
    let most = if scale.quick { 60 } else { 200 };
    let all: Vec<_> = towns.iter().map(|seed| town(*seed, most)).collect::<anyhow::Result<_>>()?;
    let mut lines = Vec::new();
    for (crowd, contributors) in CROWDS.into_iter().enumerate() {
        for (which, rule) in RULES.into_iter().enumerate() {
            let outcomes: Vec<_> = all.iter().map(|town| &town[crowd][which]).collect();
            lines.push(SupportLine::of(contributors, rule, &outcomes));
        }
    }
    let table = table(&COLUMNS, lines.iter().map(SupportLine::cells));
    CrowdSection::of_table(Experiment::Support, WORDS, &table, towns, &lines)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Catches: a contributor who counts twice, and hits of the next block.
    #[test]
    fn contributors_are_counted_near_a_cell() {
        let at = |x, y| CellIndex { x, y };
        let mut hits = Hits::default();
        for (cell, who) in [(at(-1, 0), 0), (at(0, 0), 1), (at(1, 1), 1), (at(3, 0), 2), (at(8, 0), 3)] {
            hits.add(cell, who);
        }
        let count = |rule| hits.count(rule, at(1, 0));
        assert_eq!(
            [Rule::Block(8), Rule::Block(4), Rule::Within(1), Rule::Within(2)].map(count),
            [2, 2, 1, 3]
        );
        assert_eq!([3, 10, 11].map(|all| Rule::Fraction(1, 40).least(all)), [3, 4, 5]);
    }
}
