//! The experiment `upload`: the size of uploads against the accuracy of the map.

use std::collections::BTreeMap;

use echofix_core::evidence::{CellHits, EvidenceDelta, OFFSET_STEPS, SENT_STEPS, TileEvidence, codec};
use echofix_core::geo::{CELLS_PER_TILE, Zone};
use rayon::prelude::*;
use serde::Serialize;

use super::fixes::{Summary, fixes, right_pairs};
use super::map::CrowdMap;
use super::town::{self, Way};
use super::uploads::{SentForm, VehicleUpload, cut};
use super::{CrowdSection, Scale, table};
use crate::evaluate::cells;
use crate::evaluate::condition::Experiment;
use crate::evaluate::map::{MapKey, Movers, RadarMap};
use crate::evaluate::method::MethodName;
use crate::evaluate::record::EpochRecord;
use crate::evaluate::statistics::bootstrap::{Estimate, ratios};

const SIDE: u32 = CELLS_PER_TILE as u32;
/// Bytes of a raw detection: range and azimuth.
const DETECTION_BYTES: u64 = 8;
/// Number of contributors to each map. A cell is served with the support of all of them.
const CONTRIBUTORS: u64 = 3;

/// What an upload contains of a cell.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Form {
    /// The scans themselves, of which the map stores as much as it can.
    Scans,
    /// The sum of the hits' positions, in so many steps of a cell.
    Steps(u32),
    /// Cells of 20 cm, without positions in them.
    Wide,
}

const FORMS: [Form; 7] = [
    Form::Scans,
    Form::Steps(OFFSET_STEPS),
    Form::Steps(8),
    Form::Steps(4),
    Form::Steps(2),
    Form::Steps(1),
    Form::Wide,
];

impl Form {
    fn words(self) -> String {
        let now = if self == Self::Steps(SENT_STEPS) { " (as it is)" } else { "" };
        match self {
            Self::Scans => format!("scans, {DETECTION_BYTES} bytes a detection"),
            Self::Steps(1) => format!("cells, no positions within them{now}"),
            Self::Steps(steps) => format!("cells, positions within them to 1/{steps}{now}"),
            Self::Wide => "cells of 20 cm, no positions within them".to_owned(),
        }
    }

    fn steps(self) -> u32 {
        match self {
            Self::Scans => OFFSET_STEPS,
            Self::Steps(steps) => steps,
            Self::Wide => 1,
        }
    }

    /// Size of an upload, bytes.
    fn bytes(self, delta: &EvidenceDelta) -> u64 {
        let halved = |evidence: &TileEvidence| {
            let cells = widened(&evidence.cells, |x, y| y / 2 * (SIDE / 2) + x / 2);
            TileEvidence { cells, observed: evidence.observed }
        };
        match self {
            Self::Scans => DETECTION_BYTES * delta.detections,
            Self::Steps(_) => codec::encode(delta).len() as u64,
            Self::Wide => {
                let tiles = delta.tiles.iter().map(|(id, evidence)| (*id, halved(evidence))).collect();
                codec::encode(&EvidenceDelta { tiles, detections: delta.detections }).len() as u64
            }
        }
    }

    /// The upload as the map reads it.
    fn read(self, upload: &VehicleUpload) -> VehicleUpload {
        let mut upload = upload.clone();
        if self == Self::Wide {
            for evidence in upload.delta.tiles.values_mut() {
                // The middle of four cells is a corner of the last of them.
                let mut cells = widened(&evidence.cells, |x, y| (y | 1) * SIDE + (x | 1));
                for cell in &mut cells {
                    cell.offset_sum = [0, 0];
                }
                evidence.cells = cells;
            }
        }
        upload
    }
}

/// Cells of twice the width. `index` gives their index for the column and row of a cell.
fn widened(cells: &[CellHits], index: impl Fn(u32, u32) -> u32) -> Vec<CellHits> {
    let mut wide: BTreeMap<u32, u32> = BTreeMap::new();
    for cell in cells {
        *wide.entry(index(cell.index % SIDE, cell.index / SIDE)).or_default() += cell.hits;
    }
    let middle = |hits: u32| [hits * OFFSET_STEPS / 2; 2];
    wide.into_iter().map(|(index, hits)| CellHits { index, hits, offset_sum: middle(hits) }).collect()
}

/// Size of all uploads of a form, and the fixes on the map that is made of them.
struct Worth {
    bytes: u64,
    fixes: Vec<EpochRecord>,
}

/// Sizes and fixes of every form in one town, and the kilometres that its contributors drove.
fn town(seed: u64, most: usize) -> anyhow::Result<(Vec<Worth>, f64)> {
    let city = town::small(seed)?;
    let mapping = |who: u64| town::drive(&city, who as u32, Way::Survey, who);
    let mapping: Vec<_> = (0..CONTRIBUTORS).map(mapping).collect::<anyhow::Result<_>>()?;
    let localized = town::drive(&city, CONTRIBUTORS as u32 + 3, Way::Survey, CONTRIBUTORS)?;
    let zone = city.site().zone();
    let worth = |form: &Form| -> anyhow::Result<Worth> {
        let uploads = mapping
            .iter()
            .zip(0..)
            .map(|(drive, who)| cut(drive, zone, SentForm { steps: form.steps(), ..SentForm::of(who) }));
        let uploads = uploads.collect::<anyhow::Result<Vec<_>>>()?.concat();
        let fixes = fixes(&served(*form, &uploads, zone), &localized, MethodName::Echofix, most)?;
        Ok(Worth { bytes: uploads.iter().map(|upload| form.bytes(&upload.delta)).sum(), fixes })
    };
    let worths = FORMS.par_iter().map(worth).collect::<anyhow::Result<_>>()?;
    Ok((worths, mapping.iter().map(|drive| drive.odometry.travelled_m()).sum::<f64>() / 1e3))
}

/// The map that is served with these uploads.
fn served(form: Form, uploads: &[VehicleUpload], zone: Zone) -> RadarMap {
    let mut map = CrowdMap::new(zone);
    for upload in uploads {
        map.offer(&form.read(upload));
    }
    let key = MapKey { world: 0, contributors: CONTRIBUTORS as usize, movers: Movers::Excluded };
    RadarMap::of_tiles(key, zone, map.published(CONTRIBUTORS as u8, None))
}

/// A line of the table.
#[derive(Serialize)]
struct SizeLine {
    form: String,
    kilobytes_a_km: f64,
    /// 95 % error relative to the finest form's.
    ratio_p95: Option<Estimate>,
    /// Root mean square error relative to the finest form's.
    ratio_rms: Option<Estimate>,
    #[serde(flatten)]
    summary: Summary,
}

impl SizeLine {
    fn of(which: usize, all: &[(Vec<Worth>, f64)]) -> Self {
        let way_km: f64 = all.iter().map(|(_, km)| km).sum();
        let bytes: u64 = all.iter().map(|(worths, _)| worths[which].bytes).sum();
        let pairs = all.iter().enumerate();
        let pairs =
            pairs.flat_map(|(town, (worths, _))| right_pairs(town, &worths[which].fixes, &worths[0].fixes));
        let ratios = (which > 0).then(|| ratios(&pairs.collect::<Vec<_>>(), 0.95)).flatten();
        let rows: Vec<EpochRecord> = all.iter().flat_map(|(worths, _)| worths[which].fixes.clone()).collect();
        Self {
            form: FORMS[which].words(),
            kilobytes_a_km: bytes as f64 / 1e3 / way_km,
            ratio_p95: ratios.map(|[p95, _]| p95),
            ratio_rms: ratios.map(|[_, rms]| rms),
            summary: Summary::of(&rows),
        }
    }

    fn cells(&self) -> String {
        let Self { form, kilobytes_a_km, ratio_p95, ratio_rms, summary } = self;
        let ratio = |ratio: &Option<Estimate>| ratio.map_or_else(|| "1".to_owned(), |r| cells::ratio(&r));
        let (p95, rms) = (ratio(ratio_p95), ratio(ratio_rms));
        format!("{form} | {kilobytes_a_km:.0} | {} | {p95} | {rms} | {}", summary.fixes, summary.cells())
    }
}

const WORDS: &str = "## Upload size

How large the uploads of three contributors are, for each kilometre that one of them drives, and how well another vehicle is localized
days later on the map that is served of them. All maps get the same requests. The ratios compare the errors on a map with those on the
finest one, at requests where neither is wrong by a metre. Brackets hold 95 % intervals, by a bootstrap over blocks of two minutes that
draws both together. Every form is compressed and contains what was in view, as the uploads of vehicles do. The map smooths hits by
20 cm, so that the position of a hit within a cell of 10 cm hardly matters.
";

/// Runs the experiment.
///
/// # Errors
/// When a town or a drive cannot be simulated.
pub fn run(scale: &Scale) -> anyhow::Result<CrowdSection> {
    let towns = scale.towns(4);
    let most = if scale.quick { 100 } else { 250 };
    let all: Vec<_> = towns.iter().map(|seed| town(*seed, most)).collect::<anyhow::Result<_>>()?;
    let lines: Vec<_> = (0..FORMS.len()).map(|which| SizeLine::of(which, &all)).collect();
    let columns = [
        "",
        "kB a kilometre",
        "fixes",
        "95 % error against the finest",
        "RMS error against the finest",
        "95 % of the errors, cm",
        "wrong by > 1 m",
        "usable",
        "wrong, of the usable",
    ];
    let table = table(&columns, lines.iter().map(SizeLine::cells));
    CrowdSection::of_table(Experiment::Upload, WORDS, &table, towns, &lines)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Catches: cells widened across a row's end, and hits that are lost.
    #[test]
    fn wide_cells_hold_what_four_did() {
        let cell = |index, hits| CellHits { index, hits, offset_sum: [0, 0] };
        let cells = [cell(0, 1), cell(513, 3), cell(1023, 2)];
        let widened_by = |index: fn(u32, u32) -> u32| {
            widened(&cells, index).iter().map(|cell| (cell.index, cell.hits)).collect::<Vec<_>>()
        };
        assert_eq!(widened_by(|x, y| (y | 1) * SIDE + (x | 1)), [(513, 4), (1023, 2)]);
        assert_eq!(widened_by(|x, y| y / 2 * (SIDE / 2) + x / 2), [(0, 4), (255, 2)]);
    }
}
