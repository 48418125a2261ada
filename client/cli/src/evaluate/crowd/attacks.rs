//! What bad contributors reach among twenty.

use std::collections::{BTreeMap, BTreeSet};

use echofix_core::agreement::PointIndex;
use echofix_core::drive::Drive;
use echofix_core::geo::{CELL_M, CELLS_PER_TILE, TileId};
use echofix_core::tile::Tile;
use echofix_sim::City;
use rayon::prelude::*;
use serde::Serialize;

use super::attack::Attack;
use super::fixes::{Summary, fixes};
use super::map::CrowdMap;
use super::town::{self, Way};
use super::{Scale, Told, table};
use crate::evaluate::condition::Experiment;
use crate::evaluate::map::{MapKey, Movers, RadarMap};
use crate::evaluate::method::Name;
use crate::evaluate::record::Record;
use crate::evaluate::section::Section;

/// Contributors that tell of a place before it is served.
const LEAST: u8 = 3;
/// Days that a bad contributor drives on, where a good one drives on one.
const BAD_DAYS: u32 = 3;
/// What lies nearer to anything that stands in the town may be a return of it, metres.
const GENUINE_M: f64 = 0.5;

/// What is tried: by how many contributors.
const TRIED: [(Attack, usize); 13] = [
    (Attack::None, 1),
    (Attack::None, 3),
    (Attack::Wall, 1),
    (Attack::Wall, 3),
    (Attack::Erase, 1),
    (Attack::Erase, 3),
    (Attack::Shift(0.4), 1),
    (Attack::Shift(0.4), 3),
    (Attack::Shift(1.0), 1),
    (Attack::Shift(1.0), 3),
    (Attack::Mount(2.0 * std::f64::consts::PI / 180.0), 1),
    (Attack::Replay, 1),
    (Attack::Replay, 3),
];

/// A town and everybody's drives in it.
struct Stage {
    city: City,
    /// Whose, and which, in order of the days.
    drives: Vec<(u64, Drive)>,
    localized: Drive,
    /// What stands in the town, map metres.
    genuine: PointIndex,
    contributors: u64,
}

/// What came of an attack.
#[derive(Default)]
struct Outcome {
    /// Uploads of the bad contributors, and how many of them were quarantined.
    bad: [usize; 2],
    /// The same of the good ones.
    good: [usize; 2],
    /// Served cells that only bad ones hit, far from what stands there.
    phantoms: usize,
    fixes: Vec<Record>,
}

impl Stage {
    fn new(seed: u64, contributors: u64) -> anyhow::Result<Self> {
        let city = town::small(seed)?;
        let bad = bad(contributors, 3);
        let days = |who: u64| if bad.contains(&who) { BAD_DAYS } else { 1 };
        let trips: Vec<_> = (0..contributors)
            .flat_map(|who| (0..days(who)).map(move |day| (who, who as u32 + day)))
            .collect();
        let drive = |(number, (who, day)): (usize, &(u64, u32))| {
            Ok((*who, town::drive(&city, *day, Way::Errand, number as u64)?))
        };
        let drives = trips.par_iter().enumerate().map(drive).collect::<anyhow::Result<_>>()?;
        let localized = town::drive(&city, contributors as u32 + 3, Way::Survey, 90_000)?;
        let structure = city.structure().reflectors.iter().map(|r| city.site().to_map(r.at));
        Ok(Self { genuine: PointIndex::new(structure), city, drives, localized, contributors })
    }

    fn attacked(&self, attack: Attack, count: usize, most: usize) -> anyhow::Result<Outcome> {
        let bad = bad(self.contributors, count);
        let mut map = CrowdMap::new(self.city.site().zone());
        let mut outcome = Outcome::default();
        let mut hit: [BTreeSet<(TileId, u32)>; 2] = Default::default();
        for (who, drive) in &self.drives {
            let is_bad = bad.contains(who);
            let does = if is_bad { attack } else { Attack::None };
            for upload in does.uploads(&self.city, drive, *who)? {
                let folded = map.offer(&upload);
                let counts = if is_bad { &mut outcome.bad } else { &mut outcome.good };
                counts[0] += 1;
                counts[1] += usize::from(folded.is_none());
                let cells = folded
                    .iter()
                    .flatten()
                    .flat_map(|(id, share)| share.cells.iter().map(|cell| (*id, cell.index)));
                hit[usize::from(is_bad)].extend(cells);
            }
        }
        let served = map.published(LEAST, None);
        outcome.phantoms = self.phantoms(&served, &hit);
        let key = MapKey { world: 0, contributors: count, movers: Movers::Dropped };
        let served = RadarMap::of_tiles(key, map.zone(), served);
        outcome.fixes = fixes(&served, &self.localized, Name::Echofix, most)?;
        Ok(outcome)
    }

    fn phantoms(&self, served: &BTreeMap<TileId, Tile>, hit: &[BTreeSet<(TileId, u32)>; 2]) -> usize {
        let cells = served.iter().flat_map(|(id, tile)| tile.cells().iter().map(|(index, _)| (*id, *index)));
        let by_bad = |cell: &(TileId, u32)| hit[1].contains(cell) && !hit[0].contains(cell);
        let is_far = |(id, index): &(TileId, u32)| {
            let side = CELLS_PER_TILE as u32;
            let [x, y] = id.origin();
            let at = [index % side, index / side].map(|c| (f64::from(c) + 0.5) * CELL_M);
            self.genuine.distance_m([x + at[0], y + at[1]]).is_none_or(|m| m > GENUINE_M)
        };
        cells.filter(by_bad).filter(is_far).count()
    }
}

/// Who is bad: spread among the others, none of them the first.
fn bad(contributors: u64, count: usize) -> Vec<u64> {
    let count = count as u64;
    (1..=count).map(|k| k * contributors / (count + 1)).collect()
}

impl Outcome {
    fn join(&mut self, other: Self) {
        for k in 0..2 {
            self.bad[k] += other.bad[k];
            self.good[k] += other.good[k];
        }
        self.phantoms += other.phantoms;
        self.fixes.extend(other.fixes);
    }
}

/// The experiment.
///
/// # Errors
/// When a town or a drive cannot be simulated.
pub fn run(scale: &Scale) -> anyhow::Result<Told> {
    let (contributors, most) = if scale.quick { (8, 40) } else { (20, 150) };
    let towns = scale.towns(2);
    let mut all: Vec<Outcome> = TRIED.iter().map(|_| Outcome::default()).collect();
    for seed in towns {
        let stage = Stage::new(*seed, contributors)?;
        let tried = TRIED.par_iter().map(|(attack, count)| stage.attacked(*attack, *count, most));
        let tried: Vec<_> = tried.collect::<anyhow::Result<_>>()?;
        all.iter_mut().zip(tried).for_each(|(all, one)| all.join(one));
    }
    let lines: Vec<_> = TRIED.iter().zip(&all).map(|(tried, outcome)| Line::of(*tried, outcome)).collect();
    let section = Section {
        experiment: Experiment::Attacks,
        text: format!("{}\n{}", words(contributors), table(&COLUMNS, lines.iter().map(Line::cells))),
        figures: Vec::new(),
        data: Some(super::places(towns)),
    };
    Told::new(section, &lines)
}

fn words(contributors: u64) -> String {
    format!(
        "### Bad contributors

{contributors} contributors drive 900 m each, on a day of their own; the bad ones among them on {BAD_DAYS} days. Served is what at least {LEAST}
contributors told. Made-up cells are served cells that only bad contributors hit, more than {GENUINE_M} m from anything that stands in
the town every day: the honest lines say how many of them are cars that nobody else saw, and clutter. In the honest lines the
same vehicles drive as often and do nothing bad.
"
    )
}

const COLUMNS: [&str; 11] = [
    "",
    "by",
    "their uploads",
    "quarantined",
    "others' uploads",
    "quarantined",
    "made-up cells served",
    "95 % of the errors, cm",
    "wrong by > 1 m",
    "usable",
    "wrong, of the usable",
];

/// A line of the table.
#[derive(Serialize)]
struct Line {
    attack: String,
    attackers: usize,
    uploads: usize,
    quarantined: usize,
    others_uploads: usize,
    others_quarantined: usize,
    made_up_cells: usize,
    #[serde(flatten)]
    summary: Summary,
}

impl Line {
    fn of((attack, attackers): (Attack, usize), outcome: &Outcome) -> Self {
        let Outcome { bad: [uploads, quarantined], good, phantoms, fixes } = outcome;
        Self {
            attack: attack.words(),
            attackers,
            uploads: *uploads,
            quarantined: *quarantined,
            others_uploads: good[0],
            others_quarantined: good[1],
            made_up_cells: *phantoms,
            summary: Summary::of(fixes),
        }
    }

    fn cells(&self) -> String {
        let Self { attack, attackers, uploads, quarantined, .. } = self;
        let Self { others_uploads, others_quarantined, made_up_cells, summary, .. } = self;
        let counts = format!("{uploads} | {quarantined} | {others_uploads} | {others_quarantined}");
        format!("{attack} | {attackers} | {counts} | {made_up_cells} | {}", summary.cells())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bad_ones_are_spread_among_the_others() {
        assert_eq!(bad(20, 1), [10]);
        assert_eq!(bad(20, 3), [5, 10, 15]);
        assert_eq!(bad(8, 3), [2, 4, 6]);
    }
}
