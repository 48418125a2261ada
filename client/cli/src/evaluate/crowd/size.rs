//! Bytes of an upload against the accuracy of the map it makes.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use echofix_core::drive::Drive;
use echofix_core::evidence::{CellHits, Contribution, OFFSET_STEPS, Share, codec};
use echofix_core::geo::CELLS_PER_TILE;
use rayon::prelude::*;

use super::Scale;
use super::fixes::{Summary, fixes_on_map_of};
use super::map::CrowdMap;
use super::town::{self, Way};
use super::uploads::{Upload, cut};
use crate::evaluate::condition::Experiment;
use crate::evaluate::map::{MapKey, Movers};
use crate::evaluate::method::Name;
use crate::evaluate::record::Record;
use crate::evaluate::sections::Section;
use crate::evaluate::world::grid_of;
use crate::statistics::Percentiles;

const MAX_SIGMA_M: f64 = 0.3;
const SIDE: u32 = CELLS_PER_TILE as u32;
/// Bytes of a detection, sent as it is: range and azimuth.
const DETECTION_BYTES: u64 = 8;

/// What of a cell is sent.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Form {
    /// The scans, which are folded as they are.
    Scans,
    /// The sum of the offsets, as now.
    Sums,
    /// The mean offset in so many steps of a cell.
    Mean(u32),
    /// Cells of 20 cm, without offsets.
    Wide,
}

const FORMS: [Form; 6] = [Form::Scans, Form::Sums, Form::Mean(16), Form::Mean(8), Form::Mean(1), Form::Wide];

impl Form {
    fn words(self) -> String {
        match self {
            Self::Scans => format!("scans, {DETECTION_BYTES} bytes a detection"),
            Self::Sums => format!("cells, sums of offsets in 1/{OFFSET_STEPS}"),
            Self::Mean(1) => "cells, no offsets".to_owned(),
            Self::Mean(steps) => format!("cells, mean offset in 1/{steps}"),
            Self::Wide => "cells of 20 cm, no offsets".to_owned(),
        }
    }

    /// Bytes of an upload.
    fn bytes(self, contribution: &Contribution) -> u64 {
        let sent = |form: fn(Self, &[CellHits]) -> Vec<CellHits>| {
            let share = |share: &Share| Share { cells: form(self, &share.cells), observed: share.observed };
            let tiles = contribution.tiles.iter().map(|(id, told)| (*id, share(told))).collect();
            codec::encode(&Contribution { tiles, detections: contribution.detections }).len() as u64
        };
        match self {
            Self::Scans => DETECTION_BYTES * contribution.detections,
            _ => sent(Self::written),
        }
    }

    /// Cells with what is sent of them in place of the sums.
    fn written(self, cells: &[CellHits]) -> Vec<CellHits> {
        match self {
            Self::Scans | Self::Sums => cells.to_vec(),
            Self::Mean(steps) => {
                cells.iter().map(|cell| CellHits { offset_sum: stepped(cell, steps), ..*cell }).collect()
            }
            Self::Wide => widened(cells, |x, y| y / 2 * (SIDE / 2) + x / 2),
        }
    }

    /// Cells as the map gets them.
    fn read(self, cells: &[CellHits]) -> Vec<CellHits> {
        match self {
            Self::Scans | Self::Sums => cells.to_vec(),
            Self::Mean(steps) => {
                let sum = |hits: u32, step: u32| hits * (2 * step + 1) * OFFSET_STEPS / (2 * steps);
                let back = |cell: &CellHits| CellHits {
                    offset_sum: stepped(cell, steps).map(|step| sum(cell.hits, step)),
                    ..*cell
                };
                cells.iter().map(back).collect()
            }
            // The middle of four cells is a corner of the last of them.
            Self::Wide => widened(cells, |x, y| (y | 1) * SIDE + (x | 1)),
        }
    }
}

/// Step of the mean offset along each side.
fn stepped(cell: &CellHits, steps: u32) -> [u32; 2] {
    cell.centroid().map(|c| ((c * f64::from(steps)) as u32).min(steps - 1))
}

/// Cells of twice the width, by the index that `index` makes of column and row.
fn widened(cells: &[CellHits], index: impl Fn(u32, u32) -> u32) -> Vec<CellHits> {
    let mut wide: BTreeMap<u32, u32> = BTreeMap::new();
    for cell in cells {
        *wide.entry(index(cell.index % SIDE, cell.index / SIDE)).or_default() += cell.hits;
    }
    wide.into_iter().map(|(index, hits)| CellHits { index, hits, offset_sum: [0, 0] }).collect()
}

/// Kilobytes a kilometre, and the fixes on the map.
struct Worth {
    bytes: u64,
    fixes: Vec<Record>,
}

fn worth(
    form: Form,
    uploads: &[Upload],
    [mapping, localized]: [&Drive; 2],
    most: usize,
) -> anyhow::Result<Worth> {
    let mut map = CrowdMap::new(grid_of(mapping)?.zone());
    for upload in uploads {
        let mut upload = upload.clone();
        for share in upload.contribution.tiles.values_mut() {
            share.cells = form.read(&share.cells);
        }
        map.offer(&upload);
    }
    let key = MapKey { world: 0, contributors: 1, movers: Movers::Dropped };
    Ok(Worth {
        bytes: uploads.iter().map(|upload| form.bytes(&upload.contribution)).sum(),
        fixes: fixes_on_map_of(
            std::slice::from_ref(mapping),
            &map.whole(key),
            localized,
            Name::Echofix,
            most,
        )?,
    })
}

/// Every form's worth in one town, and the kilometres that were driven.
fn town(seed: u64, most: usize) -> anyhow::Result<(Vec<Worth>, f64)> {
    let city = town::small(seed)?;
    let mapping = town::drive(&city, 0, Way::Survey, 0)?;
    let localized = town::drive(&city, 3, Way::Survey, 1)?;
    let uploads = cut(&mapping, city.site().zone(), 0, MAX_SIGMA_M)?;
    let poses: Vec<_> = mapping.odometry.iter().map(|(_, pose)| pose).collect();
    let way_m: f64 = poses.windows(2).map(|two| two[1].distance_m(&two[0])).sum();
    let worths = FORMS.par_iter().map(|form| worth(*form, &uploads, [&mapping, &localized], most));
    Ok((worths.collect::<anyhow::Result<_>>()?, way_m / 1e3))
}

const WORDS: &str = "### Upload size

What an upload takes, and what a map of one contributor is then worth, a second drive days later. The map's own error is that of the
poses it was made from. Each form is sent as the
service's own contributions are: compressed, with what was in view.
";

/// The section.
///
/// # Errors
/// When a town or a drive cannot be simulated.
pub fn section(scale: &Scale) -> anyhow::Result<Section> {
    let towns = scale.towns(6);
    let most = if scale.quick { 100 } else { 250 };
    let all: Vec<_> = towns.iter().map(|seed| town(*seed, most)).collect::<anyhow::Result<_>>()?;
    let way_km: f64 = all.iter().map(|(_, km)| km).sum();
    let columns = [
        "kB a kilometre",
        "fixes",
        "without the map's own error: 50 / 95 %, cm",
        "95 % of the errors, cm",
        "wrong by > 1 m",
        "usable",
        "wrong, of the usable",
    ];
    let mut table = format!("| | {} |\n|{}\n", columns.join(" | "), "---|".repeat(columns.len() + 1));
    for (which, form) in FORMS.iter().enumerate() {
        let worths = || all.iter().map(|(worths, _)| &worths[which]);
        let kilobytes = worths().map(|worth| worth.bytes).sum::<u64>() as f64 / 1e3;
        let rows: Vec<Record> = worths().flat_map(|worth| worth.fixes.clone()).collect();
        let cells = Summary::of(&rows).cells();
        let net = Percentiles::of(rows.iter().filter_map(|row| row.net_m));
        let net = net.map_or_else(String::new, |p| format!("{:.1} / {:.1}", 100.0 * p.p50, 100.0 * p.p95));
        let (words, per_km) = (form.words(), kilobytes / way_km);
        let _ = writeln!(table, "| {words} | {per_km:.0} | {} | {net} | {cells} |", rows.len());
    }
    Ok(Section {
        experiment: Experiment::Upload,
        text: format!("{WORDS}\n{table}"),
        figures: Vec::new(),
        data: Some(super::places(towns)),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cell(index: u32, hits: u32, offset: u32) -> CellHits {
        CellHits { index, hits, offset_sum: [hits * offset, hits * offset] }
    }

    /// Catches: a step that is rounded the wrong way, and cells widened across a row's end.
    #[test]
    fn what_is_read_is_near_what_was_written() {
        let cells = [cell(0, 1, 3), cell(513, 3, 250), cell(1023, 2, 128)];
        for steps in [16, 8, 1] {
            for (read, cell) in Form::Mean(steps).read(&cells).iter().zip(&cells) {
                let off = [0, 1].map(|k| (read.centroid()[k] - cell.centroid()[k]).abs());
                assert!(off.iter().all(|off| *off < 0.51 / f64::from(steps) + 0.01), "{steps} {off:?}");
            }
        }
        let wide = Form::Wide.read(&cells);
        let told: Vec<_> = wide.iter().map(|cell| (cell.index, cell.hits)).collect();
        assert_eq!(told, [(513, 4), (1023, 2)]);
        let sent: Vec<_> = Form::Wide.written(&cells).iter().map(|cell| cell.index).collect();
        assert_eq!(sent, [0, 255]);
    }
}
