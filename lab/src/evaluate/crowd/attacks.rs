//! The experiment `attacks`: what bad contributors can do to the map of twenty contributors.

use std::collections::{BTreeMap, BTreeSet};

use echofix_core::drive::Drive;
use echofix_core::evidence::CellHits;
use echofix_core::geo::{CELLS_PER_TILE, TileId};
use echofix_sim::City;
use rayon::prelude::*;
use serde::Serialize;

use super::attack::{self, Attack, WALL_M};
use super::fixes::{Summary, fixes};
use super::map::CrowdMap;
use super::town::{self, Way};
use super::uploads::{SentForm, VehicleUpload, cut};
use super::{CrowdSection, Scale, table};
use crate::evaluate::condition::Experiment;
use crate::evaluate::map::{MapKey, Movers, RadarMap};
use crate::evaluate::method::MethodName;
use crate::evaluate::record::EpochRecord;

/// Contributors that must hit something near a cell before it is served.
const LEAST: u8 = 3;
/// Number of days on which a bad contributor drives; a good one drives on one day.
const BAD_DAYS: u32 = 3;

/// The attacks, with their numbers of bad contributors.
const TRIED: [(Attack, usize); 11] = [
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
];

/// A town and the drives of all contributors in it.
struct Stage {
    city: City,
    drives: Vec<AttackTrip>,
    localized: Drive,
    /// Cells of the made-up wall and a little around it, because vetting moves uploads.
    wall: BTreeSet<(TileId, u32)>,
    contributors: u64,
}

/// A drive of a contributor.
struct AttackTrip {
    who: u64,
    drive: Drive,
    /// The uploads that a good contributor makes of it.
    honest: Vec<VehicleUpload>,
}

/// The map after some of the drives, and what became of their uploads.
struct Course {
    map: CrowdMap,
    /// By good and by bad contributors: number of uploads, and how many of them were quarantined.
    uploads: [[usize; 2]; 2],
    /// Cells around the wall that were hit by good and by bad contributors.
    hit: [BTreeSet<(TileId, u32)>; 2],
}

/// The result of an attack.
#[derive(Default)]
struct AttackOutcome {
    /// See [`Course::uploads`].
    uploads: [[usize; 2]; 2],
    /// Number of served cells around the wall that only bad contributors hit.
    phantoms: usize,
    fixes: Vec<EpochRecord>,
}

impl Stage {
    fn new(seed: u64, contributors: u64) -> anyhow::Result<Self> {
        let city = town::small(seed)?;
        let zone = city.site().zone();
        let bad = bad(contributors, 3);
        let days = |who: u64| if bad.contains(&who) { BAD_DAYS } else { 1 };
        let trips: Vec<_> = (0..contributors)
            .flat_map(|who| (0..days(who)).map(move |day| (who, who as u32 + day)))
            .collect();
        let trip = |(number, (who, day)): (usize, &(u64, u32))| {
            let drive = town::drive(&city, *day, Way::Errand, number as u64)?;
            Ok(AttackTrip { who: *who, honest: cut(&drive, zone, SentForm::of(*who))?, drive })
        };
        let drives = trips.par_iter().enumerate().map(trip).collect::<anyhow::Result<_>>()?;
        let localized = town::drive(&city, contributors as u32 + 3, Way::Survey, 90_000)?;
        Ok(Self { wall: around(&attack::wall(&city)), city, drives, localized, contributors })
    }

    /// The map after the drives before the first bad contributor's. It is the same for all attacks.
    fn before(&self, count: usize) -> anyhow::Result<Course> {
        let first = bad(self.contributors, count)[0];
        let map = CrowdMap::new(self.city.site().zone());
        let mut course = Course { map, uploads: Default::default(), hit: Default::default() };
        for trip in self.drives.iter().take_while(|trip| trip.who < first) {
            self.add(&mut course, trip, Attack::None, false)?;
        }
        Ok(course)
    }

    /// The result after all other drives, with an attack of `count` contributors.
    fn attacked(
        &self,
        attack: Attack,
        count: usize,
        before: &Course,
        most: usize,
    ) -> anyhow::Result<AttackOutcome> {
        let bad = bad(self.contributors, count);
        let (map, hit) = (before.map.fork(), before.hit.clone());
        let mut course = Course { map, uploads: before.uploads, hit };
        for trip in self.drives.iter().skip_while(|trip| trip.who < bad[0]) {
            let is_bad = bad.contains(&trip.who);
            self.add(&mut course, trip, if is_bad { attack } else { Attack::None }, is_bad)?;
        }
        let served = course.map.published(LEAST, None);
        let cells = served.iter().flat_map(|(id, tile)| tile.cells().iter().map(|(index, _)| (*id, *index)));
        let phantoms = cells.filter(|cell| course.hit[1].contains(cell) && !course.hit[0].contains(cell));
        let phantoms = phantoms.count();
        let key = MapKey { world: 0, contributors: count, movers: Movers::Excluded };
        let served = RadarMap::of_tiles(key, course.map.zone(), served);
        let fixes = fixes(&served, &self.localized, MethodName::Echofix, most)?;
        Ok(AttackOutcome { uploads: course.uploads, phantoms, fixes })
    }

    fn add(
        &self,
        course: &mut Course,
        trip: &AttackTrip,
        attack: Attack,
        is_bad: bool,
    ) -> anyhow::Result<()> {
        for upload in attack.uploads(&self.city, &trip.drive, trip.who, &trip.honest)? {
            let folded = course.map.offer(&upload);
            let [all, quarantined] = &mut course.uploads[usize::from(is_bad)];
            *all += 1;
            *quarantined += usize::from(folded.is_none());
            let evidence = folded.iter().flatten();
            let cells =
                evidence.flat_map(|(id, evidence)| evidence.cells.iter().map(|cell| (*id, cell.index)));
            course.hit[usize::from(is_bad)].extend(cells.filter(|cell| self.wall.contains(cell)));
        }
        Ok(())
    }
}

/// Cells at most two cells away from those of a wall, within its tiles.
fn around(wall: &BTreeMap<TileId, Vec<CellHits>>) -> BTreeSet<(TileId, u32)> {
    let side = CELLS_PER_TILE as i64;
    let near = |id: TileId, index: u32| {
        let (x, y) = (i64::from(index) % side, i64::from(index) / side);
        let steps = (-2..=2).flat_map(move |dy| (-2..=2).map(move |dx| (x + dx, y + dy)));
        let within = steps.filter(move |(x, y)| (0..side).contains(x) && (0..side).contains(y));
        within.map(move |(x, y)| (id, (y * side + x) as u32))
    };
    wall.iter().flat_map(|(id, cells)| cells.iter().flat_map(move |cell| near(*id, cell.index))).collect()
}

/// The numbers of the bad contributors. They are spread among the others, and none of them is the first.
fn bad(contributors: u64, count: usize) -> Vec<u64> {
    let count = count as u64;
    (1..=count).map(|k| k * contributors / (count + 1)).collect()
}

impl AttackOutcome {
    fn join(&mut self, other: Self) {
        for (sums, more) in self.uploads.iter_mut().zip(other.uploads) {
            sums.iter_mut().zip(more).for_each(|(sum, more)| *sum += more);
        }
        self.phantoms += other.phantoms;
        self.fixes.extend(other.fixes);
    }
}

/// Runs the experiment.
///
/// # Errors
/// When a town or a drive cannot be simulated.
pub fn run(scale: &Scale) -> anyhow::Result<CrowdSection> {
    let (contributors, most) = if scale.quick { (8, 40) } else { (20, 150) };
    let towns = scale.towns(1);
    let mut all: Vec<AttackOutcome> = TRIED.iter().map(|_| AttackOutcome::default()).collect();
    for seed in towns {
        let stage = Stage::new(*seed, contributors)?;
        let before: Vec<_> =
            [1, 3].par_iter().map(|count| stage.before(*count)).collect::<anyhow::Result<_>>()?;
        let tried = TRIED
            .par_iter()
            .map(|(attack, count)| stage.attacked(*attack, *count, &before[usize::from(*count > 1)], most));
        let tried: Vec<_> = tried.collect::<anyhow::Result<_>>()?;
        all.iter_mut().zip(tried).for_each(|(all, one)| all.join(one));
    }
    let lines: Vec<_> =
        TRIED.iter().zip(&all).map(|(tried, outcome)| AttackLine::of(*tried, outcome)).collect();
    let table = table(&COLUMNS, lines.iter().map(AttackLine::cells));
    CrowdSection::of_table(Experiment::Attacks, &words(contributors), &table, towns, &lines)
}

fn words(contributors: u64) -> String {
    format!(
        "## Bad contributors

Each of {contributors} contributors drives 900 m on a day of his own; a bad one drives on {BAD_DAYS} days. The map serves what at least {LEAST}
contributors support. The made-up wall is {WALL_M} m long and crosses a street. The table counts the served cells less than 30 cm from it
that only bad contributors hit. In the honest line the same vehicles drive as often and do nothing bad: it shows the clutter that is
served there anyway, and the error without an attack.
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
    "cells of the wall served",
    "95 % of the errors, cm",
    "wrong by > 1 m",
    "usable",
    "wrong, of the usable",
];

/// A line of the table.
#[derive(Serialize)]
struct AttackLine {
    attack: String,
    attackers: usize,
    uploads: usize,
    quarantined: usize,
    others_uploads: usize,
    others_quarantined: usize,
    wall_cells: usize,
    #[serde(flatten)]
    summary: Summary,
}

impl AttackLine {
    fn of((attack, attackers): (Attack, usize), outcome: &AttackOutcome) -> Self {
        let AttackOutcome { uploads: [good, [uploads, quarantined]], phantoms, fixes } = outcome;
        Self {
            attack: attack.words(),
            attackers,
            uploads: *uploads,
            quarantined: *quarantined,
            others_uploads: good[0],
            others_quarantined: good[1],
            wall_cells: *phantoms,
            summary: Summary::of(fixes),
        }
    }

    fn cells(&self) -> String {
        let Self { attack, attackers, uploads, quarantined, .. } = self;
        let Self { others_uploads, others_quarantined, wall_cells, summary, .. } = self;
        let counts = format!("{uploads} | {quarantined} | {others_uploads} | {others_quarantined}");
        format!("{attack} | {attackers} | {counts} | {wall_cells} | {}", summary.cells())
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
