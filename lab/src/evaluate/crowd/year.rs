//! The experiment `year`: how maps age while the town changes.

use echofix_core::drive::Drive;
use echofix_core::geo::Zone;
use echofix_sim::City;
use echofix_sim::city::Change;
use rayon::prelude::*;
use serde::Serialize;

use super::fixes::{Summary, fixes};
use super::map::CrowdMap;
use super::town::{self, Way};
use super::uploads::{self, SentForm};
use super::{CrowdSection, Scale, table};
use crate::evaluate::condition::Experiment;
use crate::evaluate::map::{MapKey, Movers, RadarMap};
use crate::evaluate::method::MethodName;
use crate::evaluate::plots::Curve;
use crate::evaluate::record::EpochRecord;
use crate::evaluate::section::{Figure, Section};

/// Number of vehicles that map the town.
const CONTRIBUTORS: u64 = 5;
/// Contributors that must hit something near a cell before it is served.
const LEAST: u8 = 3;
/// Largest standard deviation of a pose that is mapped from, metres.
const MAX_SIGMA_M: f64 = 0.3;

/// The days on which vehicles drive.
struct Calendar {
    /// Days between mapping drives.
    map_every: u32,
    /// Days between localized drives.
    fix_every: u32,
    /// Number of fixes of a localized drive.
    fixes: usize,
}

/// Number of days.
const YEAR: u32 = 360;

impl Calendar {
    fn of(scale: &Scale) -> Self {
        if scale.quick {
            Self { map_every: 40, fix_every: 120, fixes: 20 }
        } else {
            Self { map_every: 12, fix_every: 36, fixes: 90 }
        }
    }
}

/// The changes of a town: a building disappears, another one is built, and a street is a building site for four months.
fn changes(city: &City) -> Vec<Change> {
    let last = city.network().streets().len() - 1;
    vec![
        Change::Demolished(town::plot(city, 0, true), 90),
        Change::Built(town::plot(city, last / 2, false), 150),
        Change::Roadworks(last, 60..180),
    ]
}

/// The maps that are compared.
struct Maps {
    first: RadarMap,
    everything: RadarMap,
    crowd: CrowdMap,
    /// Number of uploads, and how many of them were quarantined.
    uploads: [usize; 2],
}

impl Maps {
    fn new(zone: Zone) -> Self {
        let plain = || RadarMap::new(MapKey { world: 0, contributors: 1, movers: Movers::Included }, zone);
        Self { first: plain(), everything: plain(), crowd: CrowdMap::new(zone), uploads: [0, 0] }
    }

    fn add(&mut self, drive: &Drive, contributor: u64, day: u32) -> anyhow::Result<()> {
        let mut one = RadarMap::new(self.first.key, self.crowd.zone());
        one.add(drive, contributor, MAX_SIGMA_M)?;
        self.everything.join(&one);
        if day == 0 {
            self.first.join(&one);
        }
        let uploads = uploads::cut(drive, self.crowd.zone(), SentForm::of(contributor))?;
        let counted = uploads.iter().filter(|upload| self.crowd.offer(upload).is_some()).count();
        self.uploads[0] += uploads.len();
        self.uploads[1] += uploads.len() - counted;
        Ok(())
    }

    /// The fixes of a drive on each of the three maps.
    fn fixes(&self, drive: &Drive, today: u16, most: usize) -> anyhow::Result<[Vec<EpochRecord>; 3]> {
        let key = MapKey { movers: Movers::Excluded, ..self.first.key };
        let served = RadarMap::of_tiles(key, self.crowd.zone(), self.crowd.published(LEAST, Some(today)));
        Ok([
            fixes(&self.first, drive, MethodName::Paper, most)?,
            fixes(&self.everything, drive, MethodName::Paper, most)?,
            fixes(&served, drive, MethodName::Echofix, most)?,
        ])
    }
}

/// The fixes of each localized drive, by its day and by the map.
type Days = Vec<(u32, [Vec<EpochRecord>; 3])>;

/// The fixes in one town, with the number of its uploads and of the quarantined ones.
fn year(seed: u64, calendar: &Calendar) -> anyhow::Result<(Days, [usize; 2])> {
    let city = town::small(seed)?;
    let changes = changes(&city);
    let city = city.changing(&changes)?;
    let mut maps = Maps::new(city.site().zone());
    let mut days = Vec::new();
    for day in 0..YEAR {
        if day % calendar.map_every == 0 {
            let turn = u64::from(day / calendar.map_every);
            let (way, who): (_, Vec<u64>) = match day {
                0 => (Way::Survey, (0..CONTRIBUTORS).collect()),
                _ => (Way::Errand, [turn, turn + 2].map(|k| k % CONTRIBUTORS).to_vec()),
            };
            let drives: Vec<_> = who
                .par_iter()
                .map(|who| town::drive(&city, day, way, u64::from(day) * CONTRIBUTORS + who))
                .collect::<anyhow::Result<_>>()?;
            for (who, drive) in who.iter().zip(&drives) {
                maps.add(drive, *who, day)?;
            }
        }
        if day % calendar.fix_every == calendar.fix_every / 2 {
            let drive = town::drive(&city, day, Way::Survey, 90_000 + u64::from(day))?;
            days.push((day, maps.fixes(&drive, town::utc_day(day), calendar.fixes)?));
        }
    }
    Ok((days, maps.uploads))
}

/// The names of the maps.
const NAMES: [&str; 3] = ["paper, map of day 0", "paper, everything added", "echofix"];

/// Runs the experiment.
///
/// # Errors
/// When a town or a drive cannot be simulated.
pub fn run(scale: &Scale) -> anyhow::Result<CrowdSection> {
    let calendar = Calendar::of(scale);
    let towns = scale.towns(1);
    let mut all: Days = Vec::new();
    let mut uploads = [0, 0];
    for seed in towns {
        let (days, counted) = year(*seed, &calendar)?;
        for (sum, count) in uploads.iter_mut().zip(counted) {
            *sum += count;
        }
        for (day, rows) in days {
            match all.iter_mut().find(|(known, _)| *known == day) {
                Some((_, known)) => known.iter_mut().zip(rows).for_each(|(all, more)| all.extend(more)),
                None => all.push((day, rows)),
            }
        }
    }
    let curve = |(colour, name): (usize, &&str)| Curve {
        name: (*name).to_owned(),
        colour,
        points: all.iter().map(|(day, rows)| (f64::from(*day), Summary::of(&rows[colour]).p95_m)).collect(),
    };
    let curves = NAMES.iter().enumerate().map(curve).collect();
    let title = "95 % of the errors, on days of a year".to_owned();
    let figure = Figure::Days(title, curves);
    let lines = lines(&all);
    let section = Section {
        experiment: Experiment::Year,
        text: format!(
            "{}\n{}\n![A year](figures/year.svg)\n",
            words(&calendar, uploads),
            table(&columns(), lines.iter().map(YearLine::cells))
        ),
        figures: vec![("year.svg", figure)],
        data: Some(super::towns_in_words(towns)),
    };
    CrowdSection::new(section, &lines)
}

fn words(calendar: &Calendar, [uploads, quarantined]: [usize; 2]) -> String {
    let every = calendar.map_every;
    format!(
        "## A year

All five vehicles map a town on day 0. After that, every {every} days, two of them drive 900 m each. Parked cars change every day. One
building disappears on day 90, and another one is built on day 150. From day 60 to 179 one street is a building site: containers,
with barriers before them, stand along both kerbs where cars parked, and hide the fronts. (Its lanes stay open, because nobody needs
a fix in a closed street.) On the days of the table another vehicle drives every street. `paper, map of day 0` never changes,
`paper, everything added` adds all hits up, and `echofix` is what the service serves with the support of at least three
contributors. Of {uploads} uploads {quarantined} were quarantined.
"
    )
}

fn columns() -> Vec<String> {
    let of_map = |name: &str| format!("{name}: 95 %, cm | wrong by > 1 m | usable | wrong, of the usable");
    ["day", "fixes"].map(str::to_owned).into_iter().chain(NAMES.map(of_map)).collect()
}

/// A line of the table.
#[derive(Serialize)]
struct YearLine {
    /// The day, or `all`.
    day: String,
    /// Name and summary of each map, in the order of the table.
    maps: [(&'static str, Summary); NAMES.len()],
}

impl YearLine {
    fn of(day: String, rows: [&[EpochRecord]; 3]) -> Self {
        Self { day, maps: [0, 1, 2].map(|map: usize| (NAMES[map], Summary::of(rows[map]))) }
    }

    fn cells(&self) -> String {
        let [(_, first), ..] = &self.maps;
        let cells = self.maps.each_ref().map(|(_, summary)| summary.cells()).join(" | ");
        format!("{} | {} | {cells}", self.day, first.fixes)
    }
}

fn lines(all: &Days) -> Vec<YearLine> {
    let of_day = |(day, rows): &(u32, [Vec<EpochRecord>; 3])| {
        YearLine::of(day.to_string(), rows.each_ref().map(Vec::as_slice))
    };
    let whole: [Vec<EpochRecord>; 3] =
        std::array::from_fn(|k| all.iter().flat_map(|(_, rows)| rows[k].clone()).collect());
    let last = YearLine::of("all".to_owned(), whole.each_ref().map(Vec::as_slice));
    all.iter().map(of_day).chain([last]).collect()
}
