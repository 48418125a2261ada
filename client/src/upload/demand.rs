//! What the service said of which places are wanted, on which days.

use std::collections::HashMap;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::{fs, io};

use echofix_core::demand::turn_of;
use echofix_core::geo::{LatLon, TileId, Zone};
use echofix_proto::v1::{GetCoverageResponse, UploadResponse};

use crate::disk::write_durably;
use crate::wire::tile_id;

/// Tiles that are remembered, at most: some thousand kilometres of street.
const MOST_TILES: usize = 200_000;
/// Of its detections an upload must have this share in places that are wanted, to be sent.
const LEAST_SHARE: f64 = 0.25;
/// The first line of the file.
const HEAD: &str = "echofix demand 1";

/// Remembers, across trips, from which day on the service wants each place again. What it has not said anything of is wanted.
///
/// A [`Recorder`](super::Recorder) that [keeps to it](super::Recorder::keep_to) makes no upload of what is not wanted. It learns from the answers to uploads
/// ([`Demand::learn`]) and from coverage ([`Demand::learn_coverage`]). Where a fix says that the map is out of date there,
/// [`Demand::surprise`] asks for an upload all the same.
#[derive(Debug)]
pub struct Demand {
    /// Where it is kept from trip to trip, if it is.
    path: Option<PathBuf>,
    /// Of the vehicle; spreads a fleet over the days.
    hash: u32,
    days: Mutex<HashMap<TileId, u16>>,
}

impl Demand {
    /// Opens the memory of a vehicle under its stable pseudonym. A file that is not there, or cannot be read as one of these, means that
    /// everything is wanted.
    ///
    /// # Errors
    /// When the file is there and the file system refuses it.
    pub fn open(path: &Path, contributor: &str) -> io::Result<Self> {
        let text = match fs::read(path) {
            Ok(bytes) => String::from_utf8_lossy(&bytes).into_owned(),
            Err(error) if error.kind() == io::ErrorKind::NotFound => String::new(),
            Err(error) => return Err(error),
        };
        let days = parse(&text).unwrap_or_else(|| {
            if !text.is_empty() {
                tracing::warn!(path = %path.display(), "what is wanted cannot be read; all is, until the service says it again");
            }
            HashMap::new()
        });
        let path = Some(path.to_owned());
        Ok(Self { path, hash: crc32c::crc32c(contributor.as_bytes()), days: Mutex::new(days) })
    }

    /// One that knows nothing yet, and is not kept.
    #[must_use]
    pub fn of(contributor: &str) -> Self {
        Self { path: None, hash: crc32c::crc32c(contributor.as_bytes()), days: Mutex::default() }
    }

    /// Learns from the answer to an upload. `today` is the UTC day, counted from the Unix epoch.
    pub fn learn(&self, answer: &UploadResponse, today: u16) {
        for tile in &answer.tiles {
            if let Some(id) = tile.tile.as_ref().and_then(tile_id) {
                self.set(id, tile.wanted_from_day, today);
            }
        }
    }

    /// Learns from the answer about the points of a route.
    pub fn learn_coverage(&self, route: &[LatLon], answer: &GetCoverageResponse, today: u16) {
        for (at, day) in route.iter().zip(&answer.wanted_from_day) {
            if let Ok(id) = TileId::at(*at) {
                self.set(id, *day, today);
            }
        }
    }

    /// The map seems to have changed here: an upload is wanted, of this place and those around it.
    pub fn surprise(&self, at: LatLon) {
        if let Ok(id) = TileId::at(at) {
            let mut days = self.lock();
            for near in id.with_neighbours() {
                days.remove(&near);
            }
        }
    }

    /// From which day on an upload of a place is wanted of this vehicle; 0 for any day.
    #[must_use]
    pub fn wanted_from(&self, id: TileId) -> u16 {
        self.lock().get(&id).copied().unwrap_or(0)
    }

    /// Is an upload with so many detections in each of these tiles wanted on a day?
    #[must_use]
    pub fn wants(&self, tiles: impl IntoIterator<Item = (TileId, u64)>, day: u16) -> bool {
        let days = self.lock();
        let (mut wanted, mut all) = (0, 0);
        for (id, detections) in tiles {
            all += detections;
            if days.get(&id).is_none_or(|from| *from <= day) {
                wanted += detections;
            }
        }
        wanted as f64 >= LEAST_SHARE * all as f64
    }

    /// Writes it to disk, whole or not at all; nothing where it is not kept.
    ///
    /// # Errors
    /// When the file system refuses.
    pub fn save(&self) -> io::Result<()> {
        let Some(path) = &self.path else { return Ok(()) };
        let mut lines: Vec<_> = self.lock().iter().map(|(id, day)| (*id, *day)).collect();
        lines.sort_unstable();
        let mut text = format!("{HEAD}\n");
        for (id, day) in lines {
            let _ = writeln!(text, "{} {} {} {day}", id.zone.epsg(), id.x, id.y);
        }
        let dir = path.parent().filter(|dir| !dir.as_os_str().is_empty()).unwrap_or(Path::new("."));
        write_durably(dir, path, text.as_bytes())
    }

    fn set(&self, id: TileId, wanted_from: u32, today: u16) {
        let wanted_from = u16::try_from(wanted_from).unwrap_or(u16::MAX);
        let turn = turn_of(self.hash, wanted_from, today);
        let mut days = self.lock();
        if wanted_from == 0 {
            days.remove(&id);
        } else {
            // What is due is as good as forgotten.
            if days.len() >= MOST_TILES {
                days.retain(|_, day| *day > today);
            }
            if days.len() < MOST_TILES {
                days.insert(id, turn);
            }
        }
    }

    fn lock(&self) -> MutexGuard<'_, HashMap<TileId, u16>> {
        // Each change is one step.
        self.days.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

fn parse(text: &str) -> Option<HashMap<TileId, u16>> {
    let mut lines = text.lines();
    if lines.next()? != HEAD {
        return None;
    }
    let line = |line: &str| {
        let mut words = line.split(' ');
        let zone = Zone::from_epsg(words.next()?.parse().ok()?).ok()?;
        let (x, y) = (words.next()?.parse().ok()?, words.next()?.parse().ok()?);
        Some((TileId { zone, x, y }, words.next()?.parse().ok()?))
    };
    lines.take(MOST_TILES).map(line).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use echofix_proto::v1::{self, TileContribution};

    const HERE: LatLon = LatLon { lat_deg: 48.137, lon_deg: 11.575 };

    fn told(id: TileId, wanted_from_day: u32) -> UploadResponse {
        let tile = Some(v1::TileId { epsg: u32::from(id.zone.epsg()), x: id.x, y: id.y });
        let tiles = vec![TileContribution { tile, wanted_from_day, ..TileContribution::default() }];
        UploadResponse { tiles, ..UploadResponse::default() }
    }

    fn demand(dir: &Path) -> Demand {
        Demand::open(&dir.join("demand"), "vehicle").unwrap()
    }

    /// Catches: a vehicle that sends what is not wanted, or never sends again.
    #[test]
    fn a_place_is_left_alone_until_its_day() {
        let dir = tempfile::tempdir().unwrap();
        let demand = demand(dir.path());
        let id = TileId::at(HERE).unwrap();
        let other = TileId { x: id.x + 1, ..id };
        assert!(demand.wants([(id, 9)], 20_000), "nothing was said yet");
        demand.learn(&told(id, 20_014), 20_000);
        let turn = demand.wanted_from(id);
        assert!((20_014..=20_028).contains(&turn));
        assert!(!demand.wants([(id, 9)], turn - 1));
        assert!(demand.wants([(id, 9)], turn));
        assert!(demand.wants([(id, 75), (other, 25)], 20_001), "a quarter lies where it is wanted");
        assert!(!demand.wants([(id, 76), (other, 24)], 20_001));
        demand.surprise(HERE);
        assert!(demand.wants([(id, 9)], 20_001), "the map is out of date there");
        let coverage =
            GetCoverageResponse { wanted_from_day: vec![20_014], ..GetCoverageResponse::default() };
        demand.learn_coverage(&[HERE], &coverage, 20_000);
        assert_eq!(demand.wanted_from(id), turn);
        demand.learn(&told(id, 0), 20_000);
        assert!(demand.wants([(id, 9)], 20_001), "the service changed its mind");
    }

    /// Catches: a memory that ends with the trip, and a damaged file that keeps a vehicle silent.
    #[test]
    fn it_outlives_a_trip() {
        let dir = tempfile::tempdir().unwrap();
        let (first, id) = (demand(dir.path()), TileId::at(HERE).unwrap());
        first.learn(&told(id, 20_014), 20_000);
        first.save().unwrap();
        assert_eq!(demand(dir.path()).wanted_from(id), first.wanted_from(id));
        fs::write(dir.path().join("demand"), "echofix demand 1\nnot a tile\n").unwrap();
        assert_eq!(demand(dir.path()).wanted_from(id), 0);
        fs::write(dir.path().join("demand"), [0xff, 0xfe]).unwrap();
        assert_eq!(demand(dir.path()).wanted_from(id), 0);
    }
}
