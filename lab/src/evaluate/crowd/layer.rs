//! The experiment `layer`: the size of what a vehicle keeps of the map against the accuracy of its fixes.

use std::collections::BTreeMap;

use anyhow::Context;
use echofix_core::geo::TileId;
use echofix_core::tile::{self, Grain, Tile, decode_layer, encode_layer};
use rayon::prelude::*;
use serde::Serialize;

use super::fixes::{Summary, fixes, ratio_p95, right_pairs};
use super::map::CrowdMap;
use super::town::{self, Way};
use super::uploads::{SentForm, cut};
use super::{CrowdSection, Scale, table};
use crate::evaluate::cells;
use crate::evaluate::condition::Experiment;
use crate::evaluate::map::{MapKey, Movers, RadarMap};
use crate::evaluate::method::MethodName;
use crate::evaluate::record::EpochRecord;
use crate::evaluate::statistics::bootstrap::Estimate;

/// Numbers of contributors to a map. A cell is served with the support of all of them, of three at most.
const CONTRIBUTORS: [u64; 2] = [1, 5];

/// What a vehicle keeps of a tile.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Form {
    Whole,
    Layer(Grain),
}

const fn layer(side: usize, steps: usize, kept: f64) -> Form {
    Form::Layer(Grain { side, steps, kept })
}

const FORMS: [Form; 13] = [
    Form::Whole,
    layer(1, 15, 1.0),
    layer(2, 15, 1.0),
    layer(2, 3, 1.0),
    layer(2, 3, 0.8),
    layer(2, 3, 0.6),
    layer(4, 7, 1.0),
    layer(4, 3, 1.0),
    layer(4, 3, 0.9),
    layer(4, 3, 0.8),
    layer(4, 3, 0.6),
    layer(4, 3, 0.4),
    layer(4, 1, 0.8),
];

impl Form {
    fn words(self) -> String {
        match self {
            Self::Whole => "tiles".to_owned(),
            Self::Layer(grain) => {
                let Grain { side, steps, kept } = grain;
                let now = if grain == Grain::VEHICLE { " (as it is)" } else { "" };
                format!("cells of {} cm, {steps} steps, {:.0} % of the mass{now}", 10 * side, 100.0 * kept)
            }
        }
    }

    /// Bytes of a tile, and what is read of them.
    fn sent(self, tile: &Tile) -> anyhow::Result<(usize, Tile)> {
        match self {
            Self::Whole => Ok((tile::encode(tile).len(), tile.clone())),
            Self::Layer(grain) => {
                let bytes = encode_layer(tile, &grain);
                Ok((bytes.len(), decode_layer(&bytes).context("a layer cannot be read")?))
            }
        }
    }
}

/// Bytes of a map in a form, and the fixes on it.
struct Worth {
    bytes: usize,
    fixes: Vec<EpochRecord>,
}

/// A town's forms by the number of contributors, and its kilometres of street.
struct TownWorth {
    worths: Vec<Vec<Worth>>,
    street_km: f64,
}

fn town(seed: u64, most: usize) -> anyhow::Result<TownWorth> {
    let city = town::small(seed)?;
    let most_contributors = CONTRIBUTORS.into_iter().max().unwrap_or(1);
    let localized = town::drive(&city, most_contributors as u32 + 3, Way::Survey, most_contributors)?;
    let zone = city.site().zone();
    let mut map = CrowdMap::new(zone);
    let mut worths = Vec::new();
    for who in 0..most_contributors {
        let drive = town::drive(&city, who as u32, Way::Survey, who)?;
        for upload in cut(&drive, zone, SentForm::of(who))? {
            map.offer(&upload);
        }
        let contributors = who + 1;
        if !CONTRIBUTORS.contains(&contributors) {
            continue;
        }
        let served = map.published(contributors.min(3) as u8, None);
        let worth = |form: &Form| -> anyhow::Result<Worth> {
            let sent: BTreeMap<TileId, (usize, Tile)> =
                served.iter().map(|(id, tile)| Ok((*id, form.sent(tile)?))).collect::<anyhow::Result<_>>()?;
            let bytes = sent.values().map(|(bytes, _)| bytes).sum();
            let tiles = sent.into_iter().map(|(id, (_, tile))| (id, tile)).collect();
            let key = MapKey { world: 0, contributors: contributors as usize, movers: Movers::Excluded };
            let map = RadarMap::of_tiles(key, zone, tiles);
            Ok(Worth { bytes, fixes: fixes(&map, &localized, MethodName::Echofix, most)? })
        };
        worths.push(FORMS.par_iter().map(worth).collect::<anyhow::Result<_>>()?);
    }
    Ok(TownWorth { worths, street_km: city.streets_m() / 1e3 })
}

/// A line of the table.
#[derive(Serialize)]
struct LayerLine {
    contributors: u64,
    form: String,
    kilobytes_a_km: f64,
    /// 95 % error relative to that on whole tiles.
    ratio_p95: Option<Estimate>,
    /// The 95 % error of that town where it is largest, relative to that on whole tiles.
    worst_ratio_p95: f64,
    #[serde(flatten)]
    summary: Summary,
}

impl LayerLine {
    fn of(crowd: usize, which: usize, towns: &[TownWorth]) -> Self {
        let street_km: f64 = towns.iter().map(|town| town.street_km).sum();
        let bytes: usize = towns.iter().map(|town| town.worths[crowd][which].bytes).sum();
        let pairs = |(number, town): (usize, &TownWorth)| {
            let [ours, whole] = [which, 0].map(|form| &town.worths[crowd][form].fixes);
            right_pairs(number, ours, whole)
        };
        let (ratio, worst_ratio_p95) = ratio_p95(&towns.iter().enumerate().map(pairs).collect::<Vec<_>>());
        let rows: Vec<_> = towns.iter().flat_map(|town| town.worths[crowd][which].fixes.clone()).collect();
        Self {
            contributors: CONTRIBUTORS[crowd],
            form: FORMS[which].words(),
            kilobytes_a_km: bytes as f64 / 1e3 / street_km,
            ratio_p95: ratio.filter(|_| which > 0),
            worst_ratio_p95,
            summary: Summary::of(&rows),
        }
    }

    fn cells(&self) -> String {
        let Self { contributors, form, kilobytes_a_km, ratio_p95, worst_ratio_p95, summary } = self;
        let ratio = ratio_p95.map_or_else(|| "1".to_owned(), |r| cells::ratio(&r));
        let fixes = summary.fixes;
        format!(
            "{contributors} | {form} | {kilobytes_a_km:.0} | {fixes} | {ratio} | {worst_ratio_p95:.2} | {}",
            summary.cells()
        )
    }
}

const WORDS: &str = "## Vehicle layer

What a vehicle downloads of a kilometre of street, and how well it is localized with it days after the map was made. A layer holds the
mass of wider cells in few steps, of all of them or of the heaviest, which hold so much of the tile's mass. All forms get the same requests.
The ratios compare the errors with those on whole tiles, at requests where neither is wrong by a metre. Brackets hold 95 % intervals, by a
bootstrap over blocks of two minutes that draws both together; the worst is that of the town where the ratio is largest.
";

/// Runs the experiment.
///
/// # Errors
/// When a town or a drive cannot be simulated.
pub fn run(scale: &Scale) -> anyhow::Result<CrowdSection> {
    let towns = scale.towns(4);
    let most = if scale.quick { 100 } else { 250 };
    let all: Vec<_> = towns.iter().map(|seed| town(*seed, most)).collect::<anyhow::Result<_>>()?;
    let each = (0..CONTRIBUTORS.len()).flat_map(|crowd| (0..FORMS.len()).map(move |which| (crowd, which)));
    let lines: Vec<_> = each.map(|(crowd, which)| LayerLine::of(crowd, which, &all)).collect();
    let columns = [
        "contributors",
        "",
        "kB a kilometre of street",
        "fixes",
        "95 % error against tiles",
        "worst",
        "95 % of the errors, cm",
        "wrong by > 1 m",
        "usable",
        "wrong, of the usable",
    ];
    let table = table(&columns, lines.iter().map(LayerLine::cells));
    CrowdSection::of_table(Experiment::Layer, WORDS, &table, towns, &lines)
}
