//! The attacks of bad contributors, and the uploads they send.

use std::collections::BTreeMap;

use echofix_core::drive::Drive;
use echofix_core::evidence::CellHits;
use echofix_core::geo::{CELL_M, CellIndex, TileId};
use echofix_core::pose::Pose2;
use echofix_core::scan::Mount;
use echofix_sim::City;

use super::uploads::{SentForm, VehicleUpload, cut, cut_wrong};

/// Length of the made-up wall, metres.
pub const WALL_M: f64 = 20.0;
/// Hits that an upload adds in each of its cells.
const WALL_HITS: u32 = 4;
/// How many times an upload is sent again.
const REPLAYS: usize = 4;

/// An attack of bad contributors.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Attack {
    /// No attack.
    None,
    /// They all make up the same wall across a street.
    Wall,
    /// They claim to have had everything in view, and to have hit hardly anything.
    Erase,
    /// All their poses are shifted to the east, metres.
    Shift(f64),
    /// Their front radar is turned to the left of its stated mount, radians.
    Mount(f64),
    /// They send each upload several times.
    Replay,
}

impl Attack {
    /// The attack in a few words.
    pub fn words(self) -> String {
        match self {
            Self::None => "honest".to_owned(),
            Self::Wall => "a wall made up".to_owned(),
            Self::Erase => "reporting nothing".to_owned(),
            Self::Shift(m) => format!("shifted by {m:.1} m"),
            Self::Mount(rad) => format!("a radar turned by {:.0} deg", rad.to_degrees()),
            Self::Replay => format!("each upload {REPLAYS} times more"),
        }
    }

    /// The uploads that a bad contributor makes of a drive. `honest` are those that a good one would send.
    ///
    /// # Errors
    /// When scans and poses do not fit together.
    pub fn uploads(
        self,
        city: &City,
        drive: &Drive,
        contributor: u64,
        honest: &[VehicleUpload],
    ) -> anyhow::Result<Vec<VehicleUpload>> {
        let (zone, sending) = (city.site().zone(), SentForm::of(contributor));
        match self {
            Self::None => Ok(honest.to_vec()),
            Self::Wall => {
                let (wall, mut uploads) = (wall(city), honest.to_vec());
                for upload in &mut uploads {
                    add(upload, &wall);
                }
                Ok(uploads)
            }
            Self::Erase => {
                let mut uploads = honest.to_vec();
                for evidence in uploads.iter_mut().flat_map(|upload| upload.contribution.tiles.values_mut()) {
                    evidence.cells.truncate(1);
                }
                Ok(uploads)
            }
            Self::Shift(m) => {
                let east = |_, _, pose: Pose2| Pose2 { x_m: pose.x_m + m, ..pose };
                cut_wrong(drive, zone, sending, east)
            }
            Self::Mount(rad) => {
                let mut drive = drive.clone();
                if let Some(Mount { yaw_rad, .. }) = drive.mounts.first_mut() {
                    *yaw_rad += rad;
                }
                cut(&drive, zone, sending)
            }
            Self::Replay => Ok(honest.iter().flat_map(|upload| vec![upload.clone(); 1 + REPLAYS]).collect()),
        }
    }
}

/// The hits of the made-up wall, across the middle of the town's first street.
pub fn wall(city: &City) -> BTreeMap<TileId, Vec<CellHits>> {
    let (street, site) = (&city.network().streets()[0], city.site());
    let middle = [0, 1].map(|axis| 0.5 * (street.a[axis] + street.b[axis]));
    let along = [0, 1].map(|axis| (street.b[axis] - street.a[axis]) / street.length_m());
    let across = [-along[1], along[0]];
    let steps = (WALL_M / CELL_M) as i32;
    let mut cells: BTreeMap<TileId, BTreeMap<u32, CellHits>> = BTreeMap::new();
    for step in -steps / 2..steps / 2 {
        let aside = f64::from(step) * CELL_M;
        let position = site.to_map([0, 1].map(|axis| middle[axis] + aside * across[axis]));
        let (id, index) = TileId::locate(site.zone(), CellIndex::of(position));
        let half = WALL_HITS * 128;
        let hit = CellHits { index, hits: WALL_HITS, offset_sum: [half, half] };
        cells.entry(id).or_default().insert(index, hit);
    }
    cells.into_iter().map(|(id, cells)| (id, cells.into_values().collect())).collect()
}

/// Adds hits to an upload, in the tiles that it has evidence for.
fn add(upload: &mut VehicleUpload, hits: &BTreeMap<TileId, Vec<CellHits>>) {
    for (id, more) in hits {
        let Some(evidence) = upload.contribution.tiles.get_mut(id) else { continue };
        for hit in more {
            match evidence.cells.binary_search_by_key(&hit.index, |cell| cell.index) {
                Ok(at) => evidence.cells[at] = *hit,
                Err(at) => evidence.cells.insert(at, *hit),
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::town;
    use super::*;

    /// Catches: cells out of order, and a wall elsewhere than in the street.
    #[test]
    fn the_wall_lies_across_the_street_and_joins_an_upload_in_order() {
        let city = town::small(21).unwrap();
        let wall = wall(&city);
        let count: usize = wall.values().map(Vec::len).sum();
        assert!((140..=200).contains(&count), "{count}");
        let drive = town::drive(&city, 0, town::Way::Errand, 1).unwrap();
        let total = |uploads: &[VehicleUpload]| -> usize {
            let evidence = uploads.iter().flat_map(|u| u.contribution.tiles.values());
            evidence.map(|evidence| evidence.cells.len()).sum()
        };
        let honest = cut(&drive, city.site().zone(), SentForm::of(1)).unwrap();
        let does = |attack: Attack| attack.uploads(&city, &drive, 1, &honest).unwrap();
        let bad = does(Attack::Wall);
        let ordered = |u: &VehicleUpload| {
            u.contribution.tiles.values().all(|s| s.cells.windows(2).all(|w| w[0].index < w[1].index))
        };
        assert!(bad.iter().all(ordered) && total(&bad) > total(&honest));
        assert!(total(&does(Attack::Erase)) < 20 * bad.len());
        assert_eq!(does(Attack::Replay).len(), (1 + REPLAYS) * honest.len());
    }
}
