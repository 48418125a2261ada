//! The experiment `demand`: a fleet that uploads what the service wants against one that uploads every drive.

use echofix_client::upload::Demand;
use echofix_core::demand::DemandPolicy;
use echofix_core::geo::TileId;
use echofix_proto::v1::{self, TileContribution, UploadResponse};
use echofix_sim::City;
use echofix_sim::city::Change;
use rayon::prelude::*;
use serde::Serialize;

use super::fixes::{Summary, fixes, ratio_p95, right_pairs};
use super::map::CrowdMap;
use super::town::{self, Way};
use super::uploads::{SentForm, VehicleUpload, cut};
use super::{CrowdSection, Scale, table};
use crate::evaluate::cells;
use crate::evaluate::condition::Experiment;
use crate::evaluate::map::{MapKey, Movers, RadarMap};
use crate::evaluate::method::MethodName;
use crate::evaluate::record::EpochRecord;
use crate::evaluate::statistics::bootstrap::Estimate;

/// Vehicles, each of which drives every day.
const VEHICLES: u64 = 5;
/// Contributors that must hit something near a cell before it is served.
const LEAST: u8 = 3;
/// Days on which the map is made; after them the streets are well known.
const LEARNING_DAYS: u32 = 15;
/// Days between localized drives.
const FIX_EVERY: u32 = 15;

/// One rule: its map, its uploads and what is localized on it.
struct Fleet {
    /// What each vehicle remembers; none where all is sent.
    demands: Vec<Demand>,
    map: CrowdMap,
    /// Uploads while the map was made, and after.
    sent: [usize; 2],
    fixes: Vec<EpochRecord>,
}

impl Fleet {
    fn offer(&mut self, who: u64, day: u32, uploads: &[VehicleUpload]) {
        let today = town::utc_day(day);
        // A vehicle learns after its drive what it is answered during it.
        let mut answers = Vec::new();
        for upload in uploads {
            let tiles = upload.delta.tiles.iter().map(|(id, evidence)| (*id, evidence.detections()));
            let demand = self.demands.get(who as usize);
            if demand.is_some_and(|demand| !demand.wants(tiles, today)) {
                continue;
            }
            self.sent[usize::from(day >= LEARNING_DAYS)] += 1;
            answers.push(self.answer(upload));
            self.map.offer(upload);
        }
        if let Some(demand) = self.demands.get(who as usize) {
            for answer in &answers {
                demand.learn(answer, today);
            }
        }
    }

    /// What the service says of the tiles of an upload.
    fn answer(&self, upload: &VehicleUpload) -> UploadResponse {
        let policy = DemandPolicy::default();
        let tile = |id: &TileId| TileContribution {
            tile: Some(v1::TileId { epsg: u32::from(id.zone.epsg()), x: id.x, y: id.y }),
            wanted_from_day: u32::from(policy.wanted_from(self.map.served_tile(*id, LEAST).as_ref())),
            ..TileContribution::default()
        };
        UploadResponse { tiles: upload.delta.tiles.keys().map(tile).collect(), ..UploadResponse::default() }
    }

    fn localize(&mut self, drive: &echofix_core::drive::Drive, day: u32, most: usize) -> anyhow::Result<()> {
        let key = MapKey { world: 0, contributors: VEHICLES as usize, movers: Movers::Excluded };
        let served = self.map.published(LEAST, Some(town::utc_day(day)));
        let map = RadarMap::of_tiles(key, self.map.zone(), served);
        self.fixes.extend(fixes(&map, drive, MethodName::Echofix, most)?);
        Ok(())
    }
}

/// A building disappears, and another one is built, when the streets are known.
fn changes(city: &City) -> Vec<Change> {
    let middle = city.network().streets().len() / 2;
    vec![
        Change::Demolished(town::plot(city, 0, true), 25),
        Change::Built(town::plot(city, middle, false), 35),
    ]
}

/// All that is sent, and what is wanted, in one town over some days.
fn town(seed: u64, days: u32, most: usize) -> anyhow::Result<[Fleet; 2]> {
    let city = town::small(seed)?;
    let changes = changes(&city);
    let city = city.changing(&changes)?;
    let folder = tempfile::tempdir()?;
    let open = |who: u64| Demand::open(&folder.path().join(who.to_string()), &format!("vehicle-{who}"));
    let remembered = (0..VEHICLES).map(open).collect::<std::io::Result<Vec<_>>>()?;
    let zone = city.site().zone();
    let fleet = |demands| Fleet { demands, map: CrowdMap::new(zone), sent: [0, 0], fixes: Vec::new() };
    let mut fleets = [fleet(Vec::new()), fleet(remembered)];
    for day in 0..days {
        let drives: Vec<_> = (0..VEHICLES)
            .into_par_iter()
            .map(|who| {
                let drive = town::drive(&city, day, Way::Errand, u64::from(day) * VEHICLES + who)?;
                cut(&drive, zone, SentForm::of(who))
            })
            .collect::<anyhow::Result<_>>()?;
        for (who, uploads) in (0..).zip(&drives) {
            fleets.par_iter_mut().for_each(|fleet| fleet.offer(who, day, uploads));
        }
        if day > LEARNING_DAYS && day % FIX_EVERY == FIX_EVERY - 1 {
            let drive = town::drive(&city, day, Way::Survey, 90_000 + u64::from(day))?;
            fleets.par_iter_mut().try_for_each(|fleet| fleet.localize(&drive, day, most))?;
        }
    }
    Ok(fleets)
}

/// A line of the table.
#[derive(Serialize)]
struct DemandLine {
    rule: &'static str,
    uploads_learning: usize,
    uploads_after: usize,
    /// 95 % error relative to that where all is sent.
    ratio_p95: Option<Estimate>,
    /// Of that town where it is largest.
    worst_ratio_p95: f64,
    #[serde(flatten)]
    summary: Summary,
}

impl DemandLine {
    fn of(which: usize, towns: &[[Fleet; 2]]) -> Self {
        let pairs =
            |(number, town): (usize, &[Fleet; 2])| right_pairs(number, &town[which].fixes, &town[0].fixes);
        let (ratio, worst_ratio_p95) = ratio_p95(&towns.iter().enumerate().map(pairs).collect::<Vec<_>>());
        let rows: Vec<_> = towns.iter().flat_map(|town| town[which].fixes.clone()).collect();
        let sent = |part: usize| towns.iter().map(|town| town[which].sent[part]).sum();
        Self {
            rule: ["everything is sent", "what is wanted is sent"][which],
            uploads_learning: sent(0),
            uploads_after: sent(1),
            ratio_p95: ratio.filter(|_| which > 0),
            worst_ratio_p95,
            summary: Summary::of(&rows),
        }
    }

    fn cells(&self) -> String {
        let Self { rule, uploads_learning, uploads_after, ratio_p95, worst_ratio_p95, summary } = self;
        let ratio = ratio_p95.map_or_else(|| "1".to_owned(), |r| cells::ratio(&r));
        format!(
            "{rule} | {uploads_learning} | {uploads_after} | {} | {ratio} | {worst_ratio_p95:.2} | {}",
            summary.fixes,
            summary.cells()
        )
    }
}

/// Runs the experiment.
///
/// # Errors
/// When a town or a drive cannot be simulated.
pub fn run(scale: &Scale) -> anyhow::Result<CrowdSection> {
    let towns = scale.towns(2);
    let (days, most) = if scale.quick { (30, 40) } else { (45, 250) };
    let all: Vec<_> = towns.iter().map(|seed| town(*seed, days, most)).collect::<anyhow::Result<_>>()?;
    let lines: Vec<_> = (0..2).map(|which| DemandLine::of(which, &all)).collect();
    let columns = [
        "",
        "uploads, days 0 to 14",
        "uploads after",
        "fixes",
        "95 % error against all",
        "worst",
        "95 % of the errors, cm",
        "wrong by > 1 m",
        "usable",
        "wrong, of the usable",
    ];
    let table = table(&columns, lines.iter().map(DemandLine::cells));
    CrowdSection::of_table(Experiment::Demand, &words(days), &table, towns, &lines)
}

fn words(days: u32) -> String {
    let DemandPolicy { enough_passes, refresh_days } = DemandPolicy::default();
    format!(
        "## Demand

Five vehicles drive 900 m each on every one of {days} days. Parked cars change every day; one building disappears on day 25, another is
built on day 35. Either all is uploaded, or what the service's answers say is wanted: what fewer than {enough_passes} passes have seen, and then
again {refresh_days} days after the newest, each vehicle as much later as its own name says. Every {FIX_EVERY} days after the first {LEARNING_DAYS} another vehicle is localized in
every street, on both maps with the same requests.
"
    )
}
